"""A neutral frame that smiles, and one that does not."""

from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest
from scipy.optimize import nnls

from usdface.core.arrays import FloatArray
from usdface.model.selection.neutral_check import find_better_neutral

RNG = np.random.default_rng(4)
NEUTRAL = RNG.uniform(-60, 60, size=(20, 3))
SHAPES = RNG.normal(size=(4, 20, 3)) * 4.0


@dataclass(frozen=True)
class Equation:
    """What the check asks of the baseline, with non-negative least squares as its solver."""

    neutral: FloatArray

    def propose(self, positions: FloatArray) -> FloatArray:
        matrix = SHAPES.reshape(len(SHAPES), -1).T
        return np.array([nnls(matrix, (frame - self.neutral).ravel())[0] for frame in positions])

    def residual_mm(self, positions: FloatArray, weights: FloatArray) -> FloatArray:
        away = positions - self.neutral - np.einsum("fs,smc->fmc", weights, SHAPES)
        return np.asarray(np.sqrt((away**2).sum(axis=2).mean(axis=1)))


def check(neutral: FloatArray, positions: FloatArray) -> Any:
    return find_better_neutral(Equation(neutral), positions, np.arange(len(positions)))  # type: ignore[arg-type]


@pytest.fixture
def weights() -> FloatArray:
    time = np.arange(600)[:, None] / 60
    waves = np.sin(time * np.array([1.1, 1.7, 2.3, 0.9]) + np.array([0.0, 1.0, 2.0, 3.0]))
    return np.clip(waves, 0.0, 1.0)


def test_a_smiling_neutral_is_said_with_a_frame_that_smiles_less(weights: FloatArray) -> None:
    positions = NEUTRAL + np.einsum("fs,smc->fmc", weights, SHAPES)
    smiling = int(weights.sum(axis=1).argmax())
    found = check(positions[smiling], positions)
    assert found is not None
    assert weights[found.row].sum() < weights[smiling].sum() / 3
    assert found.residual_mm < found.stated_mm


def test_a_neutral_frame_is_left_alone(weights: FloatArray) -> None:
    positions = NEUTRAL + np.einsum("fs,smc->fmc", weights, SHAPES)
    assert check(NEUTRAL, positions + 0.3 * RNG.normal(size=positions.shape)) is None


def test_few_frames_say_nothing(weights: FloatArray) -> None:
    positions = NEUTRAL + np.einsum("fs,smc->fmc", weights[:10], SHAPES)
    assert check(positions[3], positions) is None
