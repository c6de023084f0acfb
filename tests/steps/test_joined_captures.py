"""Markers of one capture and weights of another, laid on one clock."""

from dataclasses import replace
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest

from usdface.assets import Markers, Take, WeightsClip
from usdface.errors import InputError
from usdface.steps.joined_captures import join_captures
from usdface.timecode import shift_timecode

FILES = (Path("a.c3d"), Path("b.csv"))


def markers_take(timecode: str = "01:00:00:00", frames: int = 240) -> Take:
    cloud = Markers(
        names=("a", "b"),
        positions=np.ones((frames, 2, 3), np.float32),
        visible=np.ones((frames, 2), np.bool_),
        confidence=np.ones((frames, 2), np.float32),
    )
    return Take("a", Fraction(120), 101, markers=cloud, timecode_start=timecode)


def weights_take(timecode: str = "01:00:00:15") -> Take:
    """One channel that counts seconds since 01:00:00:00, at 30 frames per second."""
    start = 0.5 if timecode else 0.0
    ramp = (start + np.arange(60) / 30).astype(np.float32)[:, None]
    clip = WeightsClip(("seconds",), ramp, 1, Fraction(30))
    return Take("b", Fraction(30), 1, source=clip, timecode_start=timecode)


def test_timecode_lays_the_weights_where_they_belong() -> None:
    joined = join_captures([markers_take(), weights_take()], FILES)
    source = joined.take.source
    assert (source.rate, source.first_frame, len(source.values)) == (120, 101, 240)
    seconds = np.arange(240) / 120
    inside = seconds >= 0.5
    np.testing.assert_allclose(source.values[inside, 0], seconds[inside], atol=1e-6)
    np.testing.assert_allclose(source.values[~inside, 0], 0.5)
    assert any("+0.500 s" in note for note in joined.notes)
    assert any("holding its ends: 60 frames" in note for note in joined.notes)


def test_without_timecode_they_start_together_and_that_is_said() -> None:
    joined = join_captures([markers_take(), weights_take("")], FILES)
    assert joined.take.source.values[120, 0] == pytest.approx(1.0)
    assert any("taken to start together" in note for note in joined.notes)
    assert joined.take.timecode_start == "01:00:00:00"


@pytest.mark.parametrize(
    ("rate", "given", "at", "told"),
    [
        (Fraction(60), "01:00:00:27", Fraction(100), "01:00:00:22"),
        (Fraction(60), "01:00:00:27", Fraction(120), "01:00:00:27"),
        (Fraction(60000, 1001), "01:00:00;10", Fraction(100), "01:00:00:08"),
        (Fraction(60), "01:00:00:27", Fraction(143), ""),
        (Fraction(60), "", Fraction(100), ""),
    ],
)
def test_the_timecode_of_the_weights_becomes_one_of_the_markers_rate(
    rate: Fraction, given: str, at: Fraction, told: str
) -> None:
    clip = WeightsClip(("a",), np.zeros((60, 1), np.float32), 1, rate)
    weights = Take("b", rate, 1, source=clip, timecode_start=given)
    joined = join_captures([replace(markers_take(""), rate=at), weights], FILES)
    assert joined.take.timecode_start == told
    if told:
        assert shift_timecode(told, 1, at)
    assert any("was left out" in note for note in joined.notes) == (bool(given) and not told)


def test_midnight_between_the_two_starts_is_no_day() -> None:
    late = markers_take("23:59:59:15")
    joined = join_captures([late, weights_take("00:00:00:00")], FILES)
    assert any("+0.500 s" in note for note in joined.notes)


def test_captures_of_other_moments_are_refused() -> None:
    with pytest.raises(InputError, match="share no moment"):
        join_captures([markers_take(), weights_take("05:00:00:00")], FILES)


def test_two_sets_of_markers_are_two_takes() -> None:
    with pytest.raises(InputError, match="more than one has markers"):
        join_captures([markers_take(), markers_take()], FILES)


def test_one_capture_stays_as_it_is() -> None:
    take = replace(markers_take(), performer="Ada")
    assert join_captures([take], FILES[:1]).take is take
