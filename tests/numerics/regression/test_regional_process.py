"""What part of the face each shape moves, and Gaussian processes over it."""

from typing import Any

import numpy as np
import pytest
from sklearn.gaussian_process import GaussianProcessRegressor
from sklearn.gaussian_process.kernels import RBF, ConstantKernel, DotProduct

from usdface.numerics.regression.gaussian_process import OFFSET_VARIANCE
from usdface.numerics.regression.regional_process import (
    RegionalProcesses,
    marker_relevance,
    regional_features,
)

PAIRS, OUTPUTS, GIVEN, KEPT = 30, 7, 9, 4


def test_relevance_names_the_markers_that_a_shape_moves() -> None:
    rng = np.random.default_rng(0)
    moves = np.zeros((2, 10, 3))
    moves[0, :4] = rng.normal(size=(4, 3)) * 20  # centimetres
    moves[1, 6:] = rng.normal(size=(4, 3))  # millimetres
    weights = rng.uniform(0, 1, size=(500, 2))
    packed = np.einsum("fs,smc->fmc", weights, moves).reshape(500, -1)
    components = np.linalg.svd(packed - packed.mean(axis=0), full_matrices=False)[2][:2]
    sample = (packed - packed.mean(axis=0)) @ components.T
    relevance = marker_relevance(sample, weights, components)
    assert (relevance[0, :4] > relevance[0, 4:].max()).all()
    assert (relevance[1, 6:] > relevance[1, :6].max()).all()
    np.testing.assert_allclose(relevance.max(axis=1), 1.0)
    assert relevance.min() >= 0.05


def test_regional_features_are_uncorrelated_and_measure_the_region() -> None:
    rng = np.random.default_rng(0)
    components = np.linalg.qr(rng.normal(size=(30, 5)))[0].T
    sample = rng.normal(size=(4000, 5)) * [5.0, 3.0, 2.0, 1.0, 0.5]
    relevance = rng.uniform(0.05, 1.0, size=10)
    covariance = np.cov(sample.T)
    region = regional_features(components, covariance, relevance)
    rows = sample @ region.projection
    np.testing.assert_allclose(np.cov(rows.T), np.diag(region.variances), atol=1e-6)
    np.testing.assert_allclose((sample @ components) @ region.axes, rows, atol=1e-5)
    weighed = (sample @ components) * np.repeat(relevance, 3)
    distance = np.linalg.norm(weighed[0] - weighed[1])
    assert np.linalg.norm(rows[0] - rows[1]) == pytest.approx(distance, rel=1e-5)


def parts(*, regions: int = OUTPUTS) -> dict[str, Any]:
    rng = np.random.default_rng(0)
    dual = rng.normal(size=(PAIRS, OUTPUTS))
    dual *= np.array([0.0, 0.1, 0.5, 1.0, 5.0, 20.0, 100.0]) / np.linalg.norm(dual, axis=0)
    return {
        "projection": rng.normal(size=(regions, GIVEN, KEPT)),
        "centres": 3 * rng.normal(size=(regions, PAIRS, KEPT)),
        "exponent": -rng.uniform(0.01, 0.1, size=regions),
        "noise": 10.0 ** rng.integers(-3, 1, size=regions),
        "radial": 3.0,
        "dual": dual,
        "region": np.minimum(np.arange(OUTPUTS)[::-1], regions - 1),
    }


def direct(points: np.ndarray, given: dict[str, Any]) -> np.ndarray:
    """Every sum by itself, from differences."""
    out = np.empty((len(points), OUTPUTS))
    for j, k in enumerate(given["region"]):
        rows = points @ given["projection"][k]
        squared = ((rows[:, None] - given["centres"][k][None]) ** 2).sum(axis=2)
        out[:, j] = np.exp(given["exponent"][k] * squared) @ given["dual"][:, j]
    return out


@pytest.mark.parametrize("regions", [1, 3, OUTPUTS])
@pytest.mark.parametrize("frames", [0, 1, 300])
def test_sums_side_by_side_equal_those_taken_one_by_one(regions: int, frames: int) -> None:
    given = parts(regions=regions)
    points = np.random.default_rng(1).normal(size=(frames, GIVEN))
    found, _ = RegionalProcesses(**given)(points)
    rounding = 1e-6 * np.maximum(np.linalg.norm(given["dual"], axis=0), 0.1)
    assert (np.abs(found - direct(points, given)) < rounding).all()


def test_variances_are_those_of_sklearns_processes() -> None:
    given, points = parts(), np.random.default_rng(1).normal(size=(50, GIVEN))
    _, variance = RegionalProcesses(**given)(points)
    for k in range(OUTPUTS):
        width = np.sqrt(-0.5 / given["exponent"][k])
        kernel = DotProduct(0.0, "fixed") + ConstantKernel(OFFSET_VARIANCE, "fixed")
        kernel += ConstantKernel(given["radial"], "fixed") * RBF(width, "fixed")
        theirs = GaussianProcessRegressor(kernel, alpha=given["noise"][k], optimizer=None)
        theirs.fit(given["centres"][k], given["dual"])
        _, deviation = theirs.predict(points @ given["projection"][k], return_std=True)
        np.testing.assert_allclose(variance[:, k], deviation[:, 0] ** 2, rtol=2e-3, atol=1e-4)


def test_points_do_not_depend_on_how_many_there_are() -> None:
    processes = RegionalProcesses(**parts())
    points = np.random.default_rng(1).normal(size=(3000, GIVEN))
    for whole, some in zip(processes(points), processes(points[1000:1010]), strict=True):
        np.testing.assert_allclose(whole[1000:1010], some, rtol=1e-4, atol=1e-5)
