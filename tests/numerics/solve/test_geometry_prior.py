"""Box projection: what a limit pushes aside moves the other weights along."""

import array_api_strict
import numpy as np
from scipy.optimize import lsq_linear

from usdface.numerics.array_namespace import ArrayDevice
from usdface.numerics.solve.box_projection import BoxProjection, project_to_box

SHAPES = 6


def test_projection_is_the_nearest_point_of_the_box_under_the_metric() -> None:
    rng = np.random.default_rng(0)
    factor = rng.normal(size=(SHAPES, SHAPES)) + 2 * np.eye(SHAPES)
    metric = factor.T @ factor
    wanted = rng.uniform(-0.5, 1.5, size=(12, SHAPES))
    low, high = np.zeros(SHAPES), np.ones(SHAPES)
    found = project_to_box(wanted, metric, lower=low, upper=high, steps=2000)
    for row, result in zip(wanted, found, strict=True):
        exact = lsq_linear(factor, factor @ row, bounds=(low, high), tol=1e-12).x
        np.testing.assert_allclose(result, exact, atol=1e-5)


def test_projection_in_single_precision_or_on_a_device_is_the_same() -> None:
    rng = np.random.default_rng(0)
    factor = rng.normal(size=(SHAPES, SHAPES)) + 2 * np.eye(SHAPES)
    metric, wanted = 100 * factor.T @ factor, rng.uniform(-0.2, 1.2, size=(500, SHAPES))
    low, high = np.zeros(SHAPES), np.ones(SHAPES)
    found = project_to_box(wanted, metric, lower=low, upper=high)
    single = BoxProjection(metric, lower=low, upper=high, single=True)(wanted)
    np.testing.assert_allclose(single, found, atol=1e-6)
    device = ArrayDevice("strict", array_api_strict, array_api_strict.Device("CPU_DEVICE"))
    there = BoxProjection(metric, lower=low, upper=high, device=device)(device.put(wanted))
    np.testing.assert_allclose(device.fetch(there), found, atol=1e-12)


def test_a_metric_given_by_its_factor_is_the_same_metric() -> None:
    rng = np.random.default_rng(0)
    factor, diagonal = rng.normal(size=(40, 5)), rng.uniform(0.5, 2, 40)
    low, high = np.zeros(40), np.ones(40)
    wanted = rng.uniform(-0.4, 1.4, size=(30, 40))
    whole = project_to_box(wanted, np.diag(diagonal) + factor @ factor.T, lower=low, upper=high)
    for single, tolerance in ((False, 1e-12), (True, 1e-6)):
        thin = BoxProjection(diagonal, factor=factor, lower=low, upper=high, single=single)
        np.testing.assert_allclose(thin(wanted), whole, atol=tolerance)
    assert np.abs(whole - np.clip(wanted, 0, 1)).max() > 0.01


def test_rows_within_their_limits_are_left_alone_and_a_diagonal_metric_only_cuts() -> None:
    rng = np.random.default_rng(0)
    inside = rng.uniform(0.1, 0.9, size=(5, 3))
    metric = np.array([[2.0, 1.0, 0.0], [1.0, 3.0, 0.5], [0.0, 0.5, 1.0]])
    low, high = np.zeros(3), np.ones(3)
    np.testing.assert_array_equal(project_to_box(inside, metric, lower=low, upper=high), inside)
    outside = rng.uniform(-1, 2, size=(5, 3))
    cut = project_to_box(outside, np.diag([1.0, 5.0, 9.0]), lower=low, upper=high)
    np.testing.assert_allclose(cut, np.clip(outside, 0, 1), atol=1e-12)
