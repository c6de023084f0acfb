"""The choice of a method: the default, unless another is better by more than chance."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.stats import ttest_rel

from tests.model.synthetic import (
    MARKERS,
    RIGID,
    SyntheticFace,
    references_of,
    synthetic_face,
)
from usdface.model.mapping import candidates, train
from usdface.model.mapping.candidates import paired_t, time_blocks
from usdface.model.mapping.predict import WeightPredictor
from usdface.model.mapping.train import train_mapping
from usdface.model.regressions import forward_model


def test_blocks_are_of_a_take_and_of_time() -> None:
    blocks = time_blocks(np.array([1, 100, 130, 500, 100]), ("a", "a", "a", "a", "b"), length=120)
    assert blocks[0] == blocks[1]
    assert len(set(blocks.tolist())) == 4


@pytest.mark.parametrize("rate", [24.0, 60.0])
def test_folds_and_blocks_are_of_seconds_at_any_rate(
    rate: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    made: list[candidates.PairFolds] = []

    class Recorded(candidates.PairFolds):
        def __init__(self, *given: Any) -> None:
            super().__init__(*given)
            made.append(self)

    monkeypatch.setattr(train, "PairFolds", Recorded)
    face = synthetic_face(frames=round(20 * rate))
    keyed = np.arange(0, 20 * rate, rate).astype(int)  # one a second
    references = replace(references_of(face, keyed), rate=rate)
    train_mapping(references, ranges=face.ranges, gram=face.gram, method="ridge")
    (folds,) = made
    assert len(set(folds.blocks.tolist())) == 10  # of two seconds
    for fold in folds.folds:  # none is within half a second of another
        assert len(fold.train) + len(fold.test) == len(keyed)


def test_t_is_that_of_scipy_over_means_of_blocks() -> None:
    rng = np.random.default_rng(0)
    usual, other = rng.normal(size=(60, 4)), 0.9 * rng.normal(size=(60, 4))
    blocks = np.arange(60) // 3
    means = [(each**2).sum(axis=1).reshape(-1, 3).mean(axis=1) for each in (usual, other)]
    wanted = ttest_rel(*means).statistic
    np.testing.assert_allclose(paired_t(usual, other, np.eye(4), blocks), wanted)
    assert paired_t(usual, usual, np.eye(4), blocks) == 0.0


def _dense_face(name: str) -> SyntheticFace:
    """Eight landmarks each where the face has a marker, with its error and hardly any of their own.

    Parameters
    ----------
    name : str
        What the names begin with.
    """
    near, frames = 8, 4800
    rng = np.random.default_rng(0)
    face = synthetic_face(frames=frames, noise=4.0)
    own = 0.05 * rng.normal(size=(frames, near * MARKERS, 3))
    names = tuple(f"{name}{k}" for k in range(near * MARKERS))
    return replace(
        face,
        neutral=np.repeat(face.neutral, near, axis=0) + rng.normal(size=(near * MARKERS, 3)),
        positions=np.repeat(face.positions, near, axis=1) + own,
        names=names,
        rigid=names[: near * RIGID],
    )


@pytest.mark.usefixtures("without_comparison")
@pytest.mark.parametrize(("name", "apart"), [("m", 60), ("m", 480), ("iris_", 480)])
def test_landmarks_that_err_together_are_believed_less(
    monkeypatch: pytest.MonkeyPatch, name: str, apart: int
) -> None:
    dense = _dense_face(name)
    frames = len(dense.positions)
    references = references_of(dense, np.arange(0, frames, apart))
    mapping = train_mapping(references, ranges=dense.ranges, gram=dense.gram, method="face_map")
    between = dense.positions[apart // 2 :: apart]
    common = WeightPredictor(mapping).predict(between)
    monkeypatch.setattr(forward_model, "_COMMON_ERRORS", 0)
    independent = WeightPredictor(mapping).predict(between)
    assert (common.residuals_mm**2).mean() > 1.01 * (independent.residuals_mm**2).mean()
    assert np.median(common.uncertainty / independent.uncertainty) > 1.05
