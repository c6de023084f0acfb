from typing import Any

import array_api_strict
import numpy as np
import pytest

from usdface.numerics.array_namespace import CPU, ArrayDevice
from usdface.numerics.regression.local_sums import SINGLE_NORM, LocalSums

STRICT = ArrayDevice("strict", array_api_strict, array_api_strict.Device("CPU_DEVICE"))
PAIRS, OUTPUTS, GIVEN, KEPT = 30, 7, 9, 4


def parts(*, shared: bool = False) -> dict[str, Any]:
    rng = np.random.default_rng(0)
    many = () if shared else (OUTPUTS,)
    dual = rng.normal(size=(PAIRS, OUTPUTS))
    dual *= np.array([0.0, 0.1, 0.5, 1.0, 5.0, 20.0, 100.0]) / np.linalg.norm(dual, axis=0)
    return {
        "projection": rng.normal(size=(*many, GIVEN, KEPT)),
        "centres": 3 * rng.normal(size=(*many, PAIRS, KEPT)),
        "exponent": -rng.uniform(0.01, 0.1, size=(1, PAIRS) if shared else (OUTPUTS, 1)),
        "dual": dual,
    }


def direct(
    points: np.ndarray,
    *,
    projection: np.ndarray,
    centres: np.ndarray,
    exponent: np.ndarray,
    dual: np.ndarray,
) -> np.ndarray:
    """Every sum by itself, from differences."""
    out = np.empty((len(points), OUTPUTS))
    for j in range(OUTPUTS):
        own = j if projection.ndim == 3 else ...
        rows = points @ projection[own]
        away = ((rows[:, None] - centres[own][None]) ** 2).sum(axis=2)
        out[:, j] = np.exp(exponent[0 if projection.ndim == 2 else j] * away) @ dual[:, j]
    return out


@pytest.mark.parametrize("shared", [False, True], ids=["a kernel each", "one kernel for all"])
@pytest.mark.parametrize("frames", [0, 1, 300])
@pytest.mark.parametrize("device", [CPU, STRICT], ids=["numpy", "strict"])
def test_sums_side_by_side_equal_those_taken_one_by_one(
    shared: bool, frames: int, device: ArrayDevice
) -> None:
    given = parts(shared=shared)
    points = np.random.default_rng(1).normal(size=(frames, GIVEN))
    sums = LocalSums(**given, device=device)
    found = device.fetch(sums(device.put(points)))
    np.testing.assert_allclose(found, direct(points, **given), atol=1e-12)


def test_only_sums_of_small_duals_are_rounded_and_by_less_than_a_millionth() -> None:
    given = parts()
    points = np.random.default_rng(1).normal(size=(2000, GIVEN))
    exact, rounded = LocalSums(**given)(points), LocalSums(**given, single=True)(points)
    away = np.abs(rounded - exact).max(axis=0)
    small = np.linalg.norm(given["dual"], axis=0) <= SINGLE_NORM
    assert 0 < away[small].max() < 1e-6
    assert not away[~small].any()


def test_points_do_not_depend_on_how_many_there_are() -> None:
    sums = LocalSums(**parts(), single=True)
    points = np.random.default_rng(1).normal(size=(3000, GIVEN))
    np.testing.assert_allclose(sums(points)[1000:1010], sums(points[1000:1010]), atol=1e-6)


def test_without_any_dual_there_is_nothing_to_add() -> None:
    given = parts() | {"dual": np.zeros((PAIRS, OUTPUTS))}
    assert not LocalSums(**given)(np.ones((5, GIVEN))).any()
