import numpy as np
import pytest

from usdface.core.errors import InputError
from usdface.model.mapping.motion_space import fit_motion_space


def clips() -> list[np.ndarray]:
    rng = np.random.default_rng(0)
    basis = rng.normal(size=(4, 30))
    return [
        (rng.normal(size=(n, 4)) @ basis + 100.0).reshape(n, 10, 3).astype(np.float32)
        for n in (500, 1500)
    ]


def test_two_clips_span_the_space_of_both_together() -> None:
    first, second = clips()
    apart = fit_motion_space([first, second], dimensions=4)
    together = fit_motion_space([np.concatenate([first, second])], dimensions=4)
    np.testing.assert_allclose(apart.components, together.components, atol=1e-7)
    np.testing.assert_allclose(apart.variances, together.variances, rtol=1e-9)
    np.testing.assert_array_equal(apart.sample, together.sample)


def test_the_sample_is_spread_over_all_takes() -> None:
    space = fit_motion_space(clips(), dimensions=4, sample_count=200)
    assert space.sample.shape == (200, 4)
    assert space.sample_starts == (0, 50)
    np.testing.assert_allclose(space.sample.mean(axis=0), 0.0, atol=3 * space.sample.std() / 14)


def test_dimensions_stop_at_what_the_takes_hold() -> None:
    few = fit_motion_space([clips()[0][:6]], dimensions=60)
    assert len(few.components) == 5
    assert few.sample.shape == (6, 5)


def test_takes_that_span_nothing_are_refused() -> None:
    first, second = clips()
    with pytest.raises(InputError, match="7 and 10 markers share no motion space"):
        fit_motion_space([first, second[:, :7]])
    with pytest.raises(InputError, match="at least 2 frames, got 0"):
        fit_motion_space([])
    with pytest.raises(InputError, match="no marker moves in 40 frames"):
        fit_motion_space([np.ones((40, 10, 3), dtype=np.float32)])
    broken = first.copy()
    broken[3, 2] = np.nan
    with pytest.raises(InputError, match="not finite; clean the takes first"):
        fit_motion_space([broken])
