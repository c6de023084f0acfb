"""Timecode, against counting every label by hand."""

import math
from fractions import Fraction

import pytest

from usdface.core.errors import InputError
from usdface.core.rates import exact_rate, frames_of, shift_timecode, timecode_of

NTSC = Fraction(30000, 1001)


def test_drop_frame_equals_counting_the_labels_of_two_hours() -> None:
    """Labels that are left out, the first of some minutes, change all that follow."""
    frame = 0
    for minute in range(120):
        for second in range(60):
            for label in range(30):
                if minute % 10 and second == 0 and label < 2:
                    continue
                if second in (0, 1, 59):
                    text = f"{minute // 60:02d}:{minute % 60:02d}:{second:02d};{label:02d}"
                    assert timecode_of(frame, NTSC, drop=True) == text
                    assert frames_of(text, NTSC) == frame
                frame += 1


@pytest.mark.parametrize(
    ("rate", "frames", "label"),
    [
        (Fraction(24), 24 * 3600 + 23, "01:00:00:23"),
        (Fraction(25), 49, "00:00:01:24"),
        (Fraction(30), 29, "00:00:00:29"),
        (Fraction(24000, 1001), 24, "00:00:01:00"),
        (Fraction(48), 47, "00:00:00:23"),
        (Fraction(50), 99, "00:00:01:24"),
        (Fraction(60), 119, "00:00:01:29"),
        (Fraction(120), 123, "00:00:01:00"),
        (Fraction(120000, 1001), 120, "00:00:01:00"),
    ],
)
def test_a_fast_capture_counts_several_frames_to_a_label(rate, frames, label) -> None:
    assert timecode_of(frames, rate) == label


def test_shift_keeps_drop_frame_and_wraps_at_midnight() -> None:
    assert shift_timecode("00:00:59;29", 1, NTSC) == "00:01:00;02"
    assert shift_timecode("23:59:59:23", 1, Fraction(24)) == "00:00:00:00"
    assert shift_timecode("", 5, Fraction(24)) == ""


@pytest.mark.parametrize(
    ("label", "rate", "message"),
    [
        ("00:01:00;00", NTSC, "does not exist: drop frame leaves out"),
        ("00:00:00:30", Fraction(30), "does not exist at 30 labels"),
        ("24:00:00:00", Fraction(24), "does not exist at 24 labels"),
        ("1:2:3:4", Fraction(30), "is not hh:mm:ss:ff"),
        ("00:00:10;00", Fraction(25), "drop frame exists only at multiples of 29.97"),
        ("00:00:10:00", Fraction(37), "cannot label 37 frames per second"),
    ],
)
def test_a_label_that_does_not_exist_is_refused(label, rate, message) -> None:
    with pytest.raises(InputError, match=message):
        frames_of(label, rate)


@pytest.mark.parametrize("rate", [math.nan, 0.0, -24.0, 1e-320, 1e6, math.inf])
def test_a_rate_of_no_camera_is_refused(rate: float) -> None:
    with pytest.raises(InputError, match=r"x: frame rate .*; it must be at least 0\.001 and at"):
        exact_rate(rate, where="x")
    assert exact_rate(0.001, where="x") == Fraction(1, 1000)


@pytest.mark.parametrize(("rounded", "base"), [(11.988, 12), (11.99, 12), (14.985, 15)])
def test_fractions_of_29_97_are_exact_rates_as_its_multiples_are(rounded: float, base: int) -> None:
    assert exact_rate(rounded, where="x") == Fraction(1000 * base, 1001)
