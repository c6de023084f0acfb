"""Chart of an alignment: correlation over the shift, and delay by window."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from usdface.core.arrays import ByteImage
from usdface.media.charts.axes import (
    add_axes,
    add_label,
    display_color,
    new_figure,
    plot_curve,
    plot_points,
    render,
)
from usdface.media.picture.canvas import fill_box, new_picture
from usdface.media.picture.color import BLUE, BRIGHT, DIM, GREEN, ORANGE, PAGE, SOFT, VIOLET, Color
from usdface.media.picture.text import TextStyle, draw_text, text_width, wrap_text
from usdface.numerics.timing.audio_alignment import LEAST_AGREEMENT, LEAST_PEAK, SoundAlignment
from usdface.numerics.timing.onset_correlation import OnsetCorrelation

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_PAGE_WIDTH = 1280
_PAGE_MARGIN = 34
_AXIS_LEFT = 74
_LINE_HEIGHT = 23
_CLOSE_SECONDS = 0.6
_TITLE_STYLE = TextStyle(size=24, color=BRIGHT, weight="bold")
_FACT_STYLE = TextStyle(size=16, color=SOFT)


@dataclass(frozen=True)
class ShiftMark:
    """A candidate for the shift of the video."""

    label: str
    """Its source."""
    offset: float
    """Of the video [s]."""
    chosen: bool = False
    """Whether this shift is written."""


@dataclass(frozen=True)
class AlignmentPage:
    """Content of the chart."""

    title: str
    verdict: str
    """The result, or the reason for the refusal."""
    accepted: bool
    facts: tuple[str, ...] = ()
    """Lines below the verdict."""
    sound: SoundAlignment | None = None
    """Alignment by sound, if both have some."""
    marks: tuple[ShiftMark, ...] = ()


def draw_alignment(page: AlignmentPage) -> ByteImage:
    """Return the chart: (height, 1280, 3) uint8 array, sRGB."""
    color = GREEN if page.accepted else ORANGE
    verdict = TextStyle(size=17, color=color)
    width = _PAGE_WIDTH - 2 * _PAGE_MARGIN
    sentence = page.verdict[:1].upper() + page.verdict[1:]
    lines = [(line, verdict) for line in wrap_text(sentence, verdict, max_width=width)]
    for fact in page.facts:
        lines += [(line, _FACT_STYLE) for line in wrap_text(fact, _FACT_STYLE, max_width=width)]
    head = 72 + _LINE_HEIGHT * len(lines) + 16
    sound = page.sound
    if sound is None or sound.correlation is None:
        picture = new_picture(_PAGE_WIDTH, head + 40, PAGE)
    else:
        figure = new_figure(_PAGE_WIDTH, head + 600)
        _draw_correlation(figure, page, sound.correlation, sound.drift, head + 36)
        _draw_windows(figure, sound, head + 346)
        picture = render(figure)
    fill_box(picture, 0, 0, 8, picture.shape[0], color)
    draw_text(picture, page.title, x=_PAGE_MARGIN, y=24, style=_TITLE_STYLE, max_width=width)
    for index, (line, style) in enumerate(lines):
        draw_text(picture, line, x=_PAGE_MARGIN, y=68 + _LINE_HEIGHT * index, style=style)
    return picture


def _draw_correlation(
    figure: Figure, page: AlignmentPage, correlation: OnsetCorrelation, drift: float, y: int
) -> None:
    # The correlation's shift is that at the middle of the video; marks are at its start.
    middle = -float(correlation.shifts[0]) / 2
    marks = [
        (mark.label, mark.offset + drift * middle, GREEN if mark.chosen else VIOLET)
        for mark in page.marks
    ]
    finite = correlation.shifts[np.isfinite(correlation.scores)]
    centre = next((at for _, at, color in marks if color == GREEN), correlation.shift)
    gap = 2 * _PAGE_MARGIN + _AXIS_LEFT - 20
    wide = (_PAGE_WIDTH - _AXIS_LEFT - _PAGE_MARGIN - gap) * 2 // 3
    narrow = _PAGE_WIDTH - _AXIS_LEFT - _PAGE_MARGIN - gap - wide
    across = "shift of the video, s"
    whole = add_axes(
        figure,
        (_AXIS_LEFT, y, wide, 220),
        caption="Onsets of sound",
        across=across,
        up="correlation, standard deviations of chance",
    )
    close_box = (_AXIS_LEFT + wide + gap, y, narrow, 220)
    close = add_axes(figure, close_box, caption="The same, close up", across=across)
    whole.set_xlim(float(finite[0]), float(finite[-1]))
    close.set_xlim(centre - _CLOSE_SECONDS, centre + _CLOSE_SECONDS)
    top = max(1.15 * float(np.nanmax(correlation.scores)), 1.5 * LEAST_PEAK)
    bottom = min(1.1 * float(np.nanmin(correlation.scores)), -0.1 * top)
    for axes in (whole, close):
        axes.set_ylim(bottom, top)
        plot_curve(axes, correlation.shifts, correlation.scores, BLUE)
        axes.axhline(LEAST_PEAK, color=display_color(DIM), linewidth=1)
        level = (LEAST_PEAK - bottom) / (top - bottom)
        add_label(axes, "needed", (1, level), shift=(-6, 5), anchor="right")
    for line, (label, at, color) in enumerate(marks):
        _mark(whole, at, color, label, line=line)
        _mark(close, at, color, "")
    if np.isfinite(correlation.rival):
        _mark(whole, correlation.rival, DIM, "second best", line=len(marks))


def _mark(axes: Axes, at: float, color: Color, label: str, *, line: int = 0) -> None:
    """Draw a shift as a vertical line with its label, on text line `line`."""
    low, high = axes.get_xlim()
    share = (at - low) / (high - low)
    if not 0 <= share <= 1:
        return
    # Below the curve, so that a peak stays visible.
    axes.axvline(at, color=display_color(color), linewidth=2, alpha=0.7, zorder=1.5)
    fits = share * axes.bbox.width + 6 + text_width(label, _FACT_STYLE) < axes.bbox.width
    shift = (8.0 if fits else -8.0, -18.0 - 20 * line)
    anchor = "left" if fits else "right"
    add_label(axes, label, (share, 1), shift=shift, color=color, anchor=anchor)


def _draw_windows(figure: Figure, sound: SoundAlignment, y: int) -> None:
    windows = sound.windows
    if windows is None or not len(windows.times):
        return
    centre = float(np.median(windows.delays - sound.drift * windows.times))
    delays_ms = 1000 * (windows.delays - centre)
    agreeing = delays_ms[sound.agreeing]
    # If too few agree, the axis covers the scatter of all windows.
    base = agreeing if sound.agreement >= LEAST_AGREEMENT else delays_ms
    reach = max(1.4 * float(np.ptp(base)) / 2, 0.1)
    middle = (float(base.max()) + float(base.min())) / 2
    axes = add_axes(
        figure,
        (_AXIS_LEFT, y, _PAGE_WIDTH - _AXIS_LEFT - _PAGE_MARGIN, 190),
        caption="Delay by window",
        across="video time, s",
        up=f"ms from {centre:+.4f} s; filled dots agree, hollow ones do not",
    )
    ends = np.array([0.0, float(windows.times[-1]) * 1.02])
    axes.set_xlim(*ends)
    axes.set_ylim(middle - reach, middle + reach)
    line = 1000 * (sound.offset + sound.drift * ends - centre)
    axes.plot(ends, line, color=display_color(DIM), linewidth=1.5)
    outside = ~sound.agreeing
    plot_points(axes, windows.times[sound.agreeing], agreeing, GREEN)
    plot_points(axes, windows.times[outside], delays_ms[outside], ORANGE, hollow=True)
