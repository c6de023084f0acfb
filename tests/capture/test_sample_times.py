"""Rates recovered from times as recorders round them."""

from fractions import Fraction

import numpy as np
import pytest

from usdface.capture.sample_times import check_rate, rate_of_times, resolve_device_times
from usdface.core.errors import InputError

NTSC = [Fraction(24000, 1001), Fraction(30000, 1001), Fraction(60000, 1001)]


@pytest.mark.parametrize("decimals", [2, 3, 5])
@pytest.mark.parametrize("rate", [24, 25, 30, 50, 60, 90, 100, 120, 240, 300, *NTSC], ids=str)
def test_the_rate_is_exact_though_times_are_rounded(rate, decimals):
    frames = np.arange(5, 20_000)
    seconds = np.round(frames / float(rate), decimals)
    assert rate_of_times(seconds, frames, where="take") == rate


@pytest.mark.parametrize("rate", [24, 25, 30, 50, 60, 100, 120])
def test_two_frames_tell_the_nearest_usual_rate(rate):
    seconds = np.round(np.arange(2) / rate, 3)
    assert rate_of_times(seconds, np.arange(2), where="take") == rate


@pytest.mark.parametrize("error", [-8e-4, 0, 8e-4], ids=["slow", "exact", "fast"])
@pytest.mark.parametrize("rate", [24, 30, 60, 120])
def test_a_clock_that_is_off_loses_no_frame_of_a_long_take(rate, error):
    rng = np.random.default_rng(0)
    kept = np.union1d(np.flatnonzero(rng.random(30_000) > 0.01), [0, 29_999])
    seconds = np.round(kept / rate * (1 + error), 3)
    times = resolve_device_times(seconds, kept, where="take")
    assert times.even
    assert times.rate == rate
    np.testing.assert_array_equal(times.frames, kept)
    assert times.clock_error == pytest.approx(-error, abs=5e-6)


@pytest.mark.parametrize("rate", NTSC, ids=str)
def test_a_device_in_step_with_video_has_the_rate_of_video(rate):
    times = resolve_device_times(
        np.round(np.arange(6000) / float(rate), 3), np.arange(6000), where="take"
    )
    assert times.even
    assert times.rate == rate
    assert abs(times.clock_error) < 1e-5


@pytest.mark.parametrize("frames", [60, 120, 300])
@pytest.mark.parametrize("rate", [*NTSC, Fraction(120_000, 1001)], ids=str)
def test_a_short_take_is_of_a_rate_that_video_has(rate, frames):
    """Of 60 frames at 29.97 the times, in milliseconds, told 29.9644."""
    seconds = np.round(np.arange(frames) / float(rate), 3)
    told = rate_of_times(seconds, np.arange(frames), where="take")
    assert told in (rate, round(rate))  # 60 and 59.94 may fit such times both
    if abs(round(rate) / rate - 1) * frames / rate > 2e-3:
        assert told == rate


@pytest.mark.parametrize("kind", ["renumbered", "back", "jump", "two rates"])
def test_times_that_contradict_the_frame_numbers_are_refused(kind):
    """The rate was that of the first and last rows: 55, 86, 20 and 80 for 60."""
    seconds = np.arange(600) / 60
    if kind == "renumbered":
        seconds = np.delete(seconds, slice(200, 230))
    elif kind == "back":
        seconds[450:] -= 3
    elif kind == "jump":
        seconds[300:] += 20
    else:
        seconds[300:] = 5 + np.arange(300) / 120
    frames = np.arange(len(seconds))
    with pytest.raises(InputError, match=r"frame numbers of the rows differ by up to .* s"):
        rate_of_times(seconds, frames, where="take")
    with pytest.raises(InputError, match=r"frame numbers of the rows differ by up to .* s"):
        check_rate(Fraction(60), "DataRate", seconds, frames, where="take")


def test_times_of_arrival_may_be_uneven():
    late = np.random.default_rng(0).exponential(0.008, 600)
    seconds = np.maximum.accumulate(np.arange(600) / 60 + late) + 1e-6 * np.arange(600)
    assert float(rate_of_times(seconds, np.arange(600), where="take")) == pytest.approx(60, 1e-2)
