"""Curves before and after: what is chosen, what is shown, what is where."""

from itertools import pairwise

import numpy as np
import pytest

from usdface.core.errors import InputError
from usdface.media.charts.motion_curves import (
    MOST_WINDOWS,
    Curve,
    FrameSpan,
    Panel,
    before_and_after,
    draw_motion_curves,
    windows_around,
)
from usdface.media.picture.color import SERIES_COLORS

NAMES = ("still", "left", "right", "angle", "little")


def motions() -> tuple[np.ndarray, np.ndarray]:
    time = np.linspace(0, 1, 300)
    before = np.stack([0.3 + 0 * time, time, 1 - time, 40 * time, 0.5 + 0 * time], axis=1)
    bump = np.exp(-(((time - 0.5) / 0.05) ** 2))
    late = np.exp(-(((time - 0.8) / 0.05) ** 2))
    change = np.stack([0 * bump, 0.8 * bump, 0.8 * bump, 20 * late, 0.05 * np.sin(60 * time)], 1)
    return before, before + change


def test_what_changes_most_comes_first_and_what_changes_alike_once() -> None:
    panels = before_and_after(NAMES, *motions())
    assert [panel.caption for panel in panels] == ["left", "angle", "little"]
    assert [curve.label for curve in panels[0].curves] == ["before", "after"]


def test_windows_show_each_sequence_with_its_surroundings() -> None:
    spans = [FrameSpan(100 * k, 100 * k + 30, "joy") for k in range(1, 8)]
    windows = windows_around(spans, first_frame=80, last_frame=900)
    assert windows[:2] == ((80, 170), (160, 270))
    assert len(windows) == MOST_WINDOWS


def test_the_curve_lies_where_its_values_are_and_the_span_is_shaded() -> None:
    panel = Panel("weight", "", (Curve("w", np.linspace(0, 1, 101), (255, 0, 0)),))
    plain = draw_motion_curves("t", (), [panel], first_frame=1)
    red = (plain[..., 0] > 200) & (plain[..., 1] < 60) & (plain[..., 2] < 60)
    red[:, -40:] = False  # the curve's name
    rows, columns = np.nonzero(red)
    rising = np.polyfit(columns, rows, 1)[0]
    assert rising < 0  # up the picture as the weight grows
    assert np.ptp(columns) > 1500
    shaded = draw_motion_curves("t", (), [panel], first_frame=1, spans=[FrameSpan(40, 60, "joy")])
    changed = np.nonzero((shaded != plain).any(axis=(0, 2)))[0]
    assert changed.min() > 0.35 * 1800
    assert changed.max() < 0.68 * 1800


def test_steps_of_several_frames_are_put_at_their_frames() -> None:
    every = Panel("e", "", (Curve("a", np.linspace(0, 1, 201), (255, 0, 0)),))
    third = Panel("e", "", (Curve("a", np.linspace(0, 1, 201)[::4], (255, 0, 0)),))
    one = draw_motion_curves("t", (), [every], first_frame=10)
    other = draw_motion_curves("t", (), [third], first_frame=10, step=4)
    assert one.shape == other.shape
    assert (one != other).any(axis=2).mean() < 0.01


def test_nothing_that_changes_is_nothing_to_draw() -> None:
    before, _ = motions()
    with pytest.raises(InputError, match="nothing changes"):
        draw_motion_curves("t", (), before_and_after(NAMES, before, before), first_frame=1)


def test_the_name_of_a_span_is_read_where_a_curve_passes() -> None:
    values = np.where(np.arange(60) < 59, 1.0, 0.0)
    flat = Panel("weight", "", (Curve("w", values, (255, 0, 0)),))
    plain = draw_motion_curves("t", (), [flat], first_frame=1)
    named = draw_motion_curves("t", (), [flat], first_frame=1, spans=[FrameSpan(20, 40, "joy")])
    # The curve lies at the top of its panel, where the name is: a ground of its own covers it.
    red = (plain == (255, 0, 0)).all(axis=2)
    covered = red & (np.abs(named.astype(int) - plain).max(axis=2) > 60)
    assert 20 < covered.any(axis=0).sum() < 80


def test_every_curve_is_named_at_its_end_and_no_name_lies_on_another() -> None:
    colors = SERIES_COLORS[:5]
    curves = tuple(
        Curve(f"method {k}", np.full(60, 1 + 1e-3 * k), color) for k, color in enumerate(colors)
    )
    picture = draw_motion_curves("t", (), [Panel("e", "mm", curves)], first_frame=1, from_zero=True)
    names = picture[:, -110:].astype(int)
    rows = [
        np.flatnonzero((np.abs(names - color).max(axis=2) < 30).any(axis=1)) for color in colors
    ]
    for lower, higher in pairwise(rows):
        assert higher.max() < lower.min()


def test_pictures_are_the_same_each_time() -> None:
    panels = before_and_after(NAMES, *motions())
    one, other = (draw_motion_curves("t", (), panels, first_frame=1) for _ in range(2))
    np.testing.assert_array_equal(one, other)
