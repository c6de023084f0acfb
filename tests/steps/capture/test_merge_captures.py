"""Markers of one capture and weights of another, laid on one clock."""

from dataclasses import replace
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest

from tests.c3d_write import write_c3d
from tests.capture.text_samples import live_link_csv
from usdface.core.assets import Markers, Take, WeightsClip
from usdface.core.errors import InputError
from usdface.core.rates import shift_timecode
from usdface.runner.execute import execute
from usdface.specs.capture import IngestSpec
from usdface.steps.capture.merge_captures import join_captures
from usdface.usdio.take.read import read_take

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
    joined, notes = join_captures([markers_take(), weights_take()], FILES)
    source = joined.source
    assert (source.rate, source.first_frame, len(source.values)) == (120, 101, 240)
    seconds = np.arange(240) / 120
    inside = seconds >= 0.5
    np.testing.assert_allclose(source.values[inside, 0], seconds[inside], atol=1e-6)
    np.testing.assert_allclose(source.values[~inside, 0], 0.5)
    assert any("+0.500 s" in note for note in notes)
    assert any("60 frames outside the recording" in note for note in notes)


def test_what_the_weights_do_not_show_lies_where_they_do() -> None:
    weights = weights_take()
    late = replace(weights, source=replace(weights.source, gaps=((31, 45),)))
    joined, _ = join_captures([markers_take(), late], FILES)
    assert joined.source.gaps == ((101 + 180, 101 + 236),)  # 1.5 s, and 44 / 30 + 0.5 s
    early = weights_take("00:59:59:00")
    early = replace(early, source=replace(early.source, gaps=((1, 10), (25, 35))))
    joined, _ = join_captures([markers_take(), early], FILES)
    assert joined.source.gaps == ((101, 101 + 16),)  # the first is over before the markers begin


def test_without_timecode_they_start_together_and_that_is_said() -> None:
    joined, notes = join_captures([markers_take(), weights_take("")], FILES)
    assert joined.source.values[120, 0] == pytest.approx(1.0)
    assert any("assumed to start together" in note for note in notes)
    assert joined.timecode_start == "01:00:00:00"


@pytest.mark.parametrize(
    ("rate", "given", "at", "told"),
    [
        (Fraction(60), "01:00:00:27", Fraction(100), "01:00:00:22"),
        (Fraction(60), "01:00:00:27", Fraction(120), "01:00:00:27"),
        (Fraction(60000, 1001), "01:00:00;10", Fraction(100), "01:00:00:08"),
        (Fraction(60), "01:00:00:27", Fraction(143), ""),
        (Fraction(60), "", Fraction(100), ""),
        (Fraction(60), "10:00:00:10", Fraction(120_000, 1001), "10:00:00:10"),
        (Fraction(30_000, 1001), "10:00:00:10", Fraction(120), "10:00:00:10"),
        (Fraction(30_000, 1001), "10:00:00:10", Fraction(60_000, 1001), "10:00:00:10"),
        (Fraction(30_000, 1001), "10:00:00;10", Fraction(60_000, 1001), "10:00:00;10"),
    ],
)
def test_the_timecode_of_the_weights_becomes_one_of_the_markers_rate(
    rate: Fraction, given: str, at: Fraction, told: str
) -> None:
    clip = WeightsClip(("a",), np.zeros((60, 1), np.float32), 1, rate)
    weights = Take("b", rate, 1, source=clip, timecode_start=given)
    joined, notes = join_captures([replace(markers_take(""), rate=at), weights], FILES)
    assert joined.timecode_start == told
    if told:
        assert shift_timecode(told, 1, at)
    assert any("is not stored" in note for note in notes) == (bool(given) and not told)


@pytest.mark.parametrize(
    ("rates", "labels", "seconds"),
    [
        # One reads its labels at 29.97, the other at 30: they agree as they read.
        ((Fraction(120_000, 1001), 30), ("10:00:00:00", "10:00:00:15"), 0.5),
        ((120, Fraction(30_000, 1001)), ("10:00:00:00", "10:00:00:15"), 0.5),
        # Both count at 29.97: a second of labels lasts 1.001 seconds, through midnight too.
        ((Fraction(120_000, 1001),) * 2, ("10:00:00:00", "10:00:00:15"), 0.5005),
        ((Fraction(120_000, 1001),) * 2, ("23:59:59:15", "00:00:00:00"), 0.5005),
        ((Fraction(120_000, 1001),) * 2, ("23:59:59;15", "00:00:00;00"), 0.5005),
    ],
)
def test_labels_at_29_97_and_at_30_agree_as_they_read(rates, labels, seconds) -> None:
    markers = replace(markers_take(labels[0]), rate=Fraction(rates[0]))
    weights = weights_take(labels[1])
    clip = replace(weights.source, rate=Fraction(rates[1]))
    weights = replace(weights, rate=Fraction(rates[1]), source=clip)
    joined, notes = join_captures([markers, weights], FILES)
    start = int(np.flatnonzero(joined.source.values[:, 0] > 0.5)[0])
    assert start == pytest.approx(seconds * float(rates[0]), abs=1.5)
    assert any(f"{seconds:+.3f} s" in note for note in notes)
    same = rates[0] == rates[1]
    assert any("do not count the same seconds" in note for note in notes) != same


def test_the_timecode_that_the_user_names_lays_the_weights_too(tmp_path: Path) -> None:
    cloud, seen = np.random.default_rng(0).normal(0, 50, (240, 4, 3)), np.ones((240, 4), np.bool_)
    write_c3d(tmp_path / "a.c3d", cloud, seen, "abcd", rate=120)
    (tmp_path / "a.csv").write_text(live_link_csv(start="09:59:59:53"))
    sources = (tmp_path / "a.csv", tmp_path / "a.c3d")
    spec = IngestSpec(sources=sources, out=tmp_path / "a.take.usda", timecode="09:59:59:00")
    report = execute(spec)
    assert any("the weights start +0.867 s after" in note for note in report.notes)
    assert read_take(tmp_path / "a.take.usda").timecode_start == "09:59:59:00"
    other = spec.model_copy(update={"timecode": "03:00:00:00", "out": tmp_path / "b.take.usda"})
    with pytest.raises(InputError, match="do not overlap in time"):
        execute(other)


def test_midnight_between_the_two_starts_is_no_day() -> None:
    late = markers_take("23:59:59:15")
    _, notes = join_captures([late, weights_take("00:00:00:00")], FILES)
    assert any("+0.500 s" in note for note in notes)


def test_captures_of_other_moments_are_refused() -> None:
    with pytest.raises(InputError, match="do not overlap in time"):
        join_captures([markers_take(), weights_take("05:00:00:00")], FILES)


def test_two_sets_of_markers_are_two_takes() -> None:
    with pytest.raises(InputError, match="more than one has markers"):
        join_captures([markers_take(), markers_take()], FILES)


def test_one_capture_stays_as_it_is() -> None:
    take = replace(markers_take(), performer="Ada")
    assert join_captures([take], FILES[:1])[0] is take
