import array_api_strict
import numpy as np
import pytest

from tests.numerics.solve.test_banded_smoothing import example
from usdface.numerics.array_namespace import CPU, ArrayDevice
from usdface.numerics.solve.banded_smoothing import smooth_within_bounds
from usdface.numerics.solve.projected_gradient_smoothing import smooth_on_device, steps_needed

STRICT = ArrayDevice("strict", array_api_strict, array_api_strict.Device("CPU_DEVICE"))


@pytest.mark.parametrize("device", [CPU, STRICT], ids=["numpy", "strict"])
@pytest.mark.parametrize("penalty", [0.0, 0.1, 1.0, 50.0])
def test_steps_end_where_the_banded_solve_does(penalty: float, device: ArrayDevice) -> None:
    tracks, trust = example(200)
    given = {"penalty": penalty, "trust": trust, "lower": np.zeros(3), "upper": np.ones(3)}
    wanted = smooth_within_bounds(tracks, **given)  # type: ignore[arg-type]
    found = smooth_on_device(tracks, device=device, **given)  # type: ignore[arg-type]
    np.testing.assert_allclose(found, wanted, atol=1e-7)
    assert (wanted == 0).any()
    assert (wanted == 1).any()


def test_a_step_looks_at_no_more_than_two_frames_on_either_side() -> None:
    """What all steps together hear ends where it is as faint as what they leave undone."""
    tracks, trust = example(400)
    given = {"penalty": 1.0, "lower": np.zeros(3), "upper": np.ones(3), "device": CPU}
    whole = smooth_on_device(tracks, trust=trust, **given)  # type: ignore[arg-type]
    part = smooth_on_device(tracks[100:300], trust=trust[100:300], **given)  # type: ignore[arg-type]
    np.testing.assert_allclose(part[64:-64], whole[164:236], atol=1e-8)


def test_steps_grow_with_the_root_of_the_condition() -> None:
    ones = np.ones(10)
    few, many = steps_needed(100.0, ones), steps_needed(10_000.0, ones)
    assert many == pytest.approx(10 * few, rel=0.01)
    assert steps_needed(1.0, np.full(10, 0.25)) < 250


@pytest.mark.parametrize("frames", [0, 1, 2, 3])
def test_few_frames_are_brought_within_their_bounds(frames: int) -> None:
    tracks, trust = example()
    given = {"penalty": 2.0, "lower": np.zeros(3), "upper": np.ones(3)}
    found = smooth_on_device(tracks[:frames], trust=trust[:frames], device=CPU, **given)  # type: ignore[arg-type]
    wanted = smooth_within_bounds(tracks[:frames], trust=trust[:frames], **given)  # type: ignore[arg-type]
    np.testing.assert_allclose(found, wanted, atol=1e-7)


def test_what_cannot_be_smoothed_is_refused() -> None:
    bounds = {"lower": np.zeros(1), "upper": np.ones(1), "device": CPU}
    with pytest.raises(ValueError, match="not finite"):
        smooth_on_device(np.full((5, 1), np.nan), penalty=1.0, trust=np.ones(5), **bounds)  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="5 positive numbers"):
        smooth_on_device(np.ones((5, 1)), penalty=1.0, trust=np.zeros(5), **bounds)  # type: ignore[arg-type]
