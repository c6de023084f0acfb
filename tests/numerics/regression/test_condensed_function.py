import array_api_strict
import numpy as np
import pytest

from usdface.numerics.array_namespace import CPU, ArrayDevice
from usdface.numerics.regression.condensed_function import (
    AGREED,
    FEWEST_POINTS,
    ROUGH,
    CondensedFunction,
    condense,
)
from usdface.numerics.regression.local_sums import SINGLE_NORM

STRICT = ArrayDevice("strict", array_api_strict, array_api_strict.Device("CPU_DEVICE"))
DIMENSIONS = 6


def smooth(points: np.ndarray) -> np.ndarray:
    """Three outputs that any few kernels can say."""
    return np.stack(
        [
            np.sin(points[:, 0] / 4),
            np.exp(-((points[:, 1] - 1) ** 2) / 40),
            0.1 * points[:, 2] + 0.05 * points[:, 3] * points[:, 4] / 3,
        ],
        axis=1,
    )


def rough_too(points: np.ndarray) -> np.ndarray:
    return np.concatenate([smooth(points), np.sin(25 * points[:, :1])], axis=1)


def sample(count: int = 2000, seed: int = 0) -> np.ndarray:
    spread = np.array([3.0, 2.0, 1.5, 1.0, 1.0, 0.2])
    return np.random.default_rng(seed).uniform(-1, 1, size=(count, DIMENSIONS)) * spread


def test_points_like_the_sample_are_told_without_asking() -> None:
    arrays = condense(smooth, sample(), noise=0.05)
    assert arrays is not None
    assert arrays["smooth"].tolist() == [1, 1, 1]
    unseen = sample(seed=1)
    mean, agree = CondensedFunction(arrays).both(unseen)
    assert agree.mean() > 0.9
    error = np.abs(mean - smooth(unseen))[agree]
    assert np.sqrt((error**2).mean()) < 0.1 * ROUGH
    assert np.quantile(error, 0.999) < ROUGH


@pytest.mark.parametrize("device", [CPU, STRICT], ids=["numpy", "strict"])
def test_where_the_fits_disagree_the_function_is_asked(device: ArrayDevice) -> None:
    arrays = condense(smooth, sample(), noise=0.05)
    assert arrays is not None
    near, far = sample(40, seed=1), 3 * sample(60, seed=2)
    points = np.concatenate([near, far])[np.random.default_rng(3).permutation(100)]
    asked: list[np.ndarray] = []

    def told(some: np.ndarray) -> np.ndarray:
        asked.append(device.fetch(some))
        return device.put(smooth(asked[-1]))

    found = CondensedFunction(arrays, device=device)
    mean, agree = (device.fetch(each) for each in found.both(device.put(points)))
    assert 0.2 < agree.mean() < 0.8
    answer = device.fetch(found(device.put(points), told))
    np.testing.assert_array_equal(asked[0], points[~agree])
    np.testing.assert_array_equal(answer[~agree], smooth(points[~agree]))
    np.testing.assert_array_equal(answer[agree], mean[agree])


def test_both_fits_are_kernels_and_a_line_summed_one_by_one() -> None:
    arrays = condense(smooth, sample(), noise=0.05)
    assert arrays is not None
    points = sample(50, seed=4)
    rows = points * arrays["scale"]
    fits = []
    for centres, dual, line in zip(arrays["centres"], arrays["dual"], arrays["line"], strict=True):
        away = ((rows[:, None] - centres[None]) ** 2).sum(axis=2)
        fits.append(np.exp(arrays["exponent"][0] * away) @ dual + rows @ line[:-1] + line[-1])
    mean, agree = CondensedFunction(arrays).both(points)
    np.testing.assert_allclose(mean, (fits[0] + fits[1]) / 2, atol=1e-7)
    np.testing.assert_array_equal(agree, np.abs(fits[0] - fits[1]).max(axis=1) <= AGREED)


def test_small_duals_are_rounded_and_large_ones_never() -> None:
    arrays = condense(smooth, sample(), noise=0.05)
    assert arrays is not None
    points = sample(seed=4)
    norm = np.linalg.norm(arrays["dual"], axis=1).max()
    for size, most in ((0.9 * SINGLE_NORM / norm, 1e-6), (1.1 * SINGLE_NORM / norm, 0.0)):
        own = arrays | {name: size * arrays[name] for name in ("dual", "line")}
        exact, _ = CondensedFunction(own).both(points)
        found, _ = CondensedFunction(own, single=True).both(points)
        assert found.dtype == np.float64
        error = np.abs(found - exact).max()
        assert error <= most
        assert (error > 0) == (most > 0)


def test_rough_outputs_are_left_out() -> None:
    arrays = condense(rough_too, sample(), noise=0.05)
    assert arrays is not None
    assert arrays["smooth"].tolist() == [1, 1, 1, 0]
    mean, _ = CondensedFunction(arrays).both(sample(seed=1))
    assert not mean[:, 3].any()
    assert not np.allclose(mean[:, :3], 0)


def test_nothing_is_condensed_from_few_points_or_where_most_is_rough() -> None:
    assert condense(smooth, sample(FEWEST_POINTS), noise=0.05) is None
    assert condense(lambda points: np.sin(25 * points), sample(), noise=0.05) is None


def test_points_that_are_all_the_same_are_no_sample() -> None:
    assert condense(smooth, np.tile(sample(1), (1000, 1)), noise=0.05) is None


def test_no_points_are_no_points() -> None:
    arrays = condense(smooth, sample(), noise=0.05)
    assert arrays is not None
    assert CondensedFunction(arrays)(np.zeros((0, DIMENSIONS)), smooth).shape == (0, 3)


def test_two_fits_that_disagree_in_one_output_alone_are_not_believed() -> None:
    line = np.zeros((2, DIMENSIONS + 1, 3))
    line[1, 0, 2] = 1.0  # the last output, along the first direction
    arrays = {
        "scale": np.ones(DIMENSIONS),
        "centres": np.zeros((2, 1, DIMENSIONS)),
        "exponent": np.array([-1.0]),
        "dual": np.zeros((2, 1, 3)),
        "line": line,
    }
    points = np.zeros((3, DIMENSIONS))
    points[:, 0] = 0.0, 0.9 * AGREED, 1.1 * AGREED
    _, agree = CondensedFunction(arrays).both(points)
    assert agree.tolist() == [True, True, False]
