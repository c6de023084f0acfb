"""The evidence of an alignment on one picture: what fits where, and which windows agree."""

from dataclasses import dataclass

import numpy as np

from usdface.core.arrays import ByteImage
from usdface.media.charts.plot import Plot
from usdface.media.picture.canvas import Color, draw_line, fill_box, new_picture
from usdface.media.picture.palette import PAGE
from usdface.media.picture.text import TextStyle, draw_text, text_width
from usdface.numerics.timing.audio_alignment import LEAST_AGREEMENT, LEAST_PEAK, SoundAlignment

_WIDTH = 1280
_MARGIN, _AXIS = 34, 74
_CURVE: Color = (126, 184, 236)
_GOOD: Color = (129, 199, 132)
_BAD: Color = (240, 160, 80)
_OTHER: Color = (190, 150, 220)
_FAINT: Color = (152, 157, 166)
_TITLE = TextStyle(size=24, weight="bold")
_FACT = TextStyle(size=15, color=(182, 186, 193))
_LINE = 23
_CLOSE_SECONDS = 0.6


@dataclass(frozen=True)
class ShiftMark:
    """A shift that someone or something claims.

    Attributes
    ----------
    label : str
    offset : float
        Of the video [s].
    chosen : bool
        Whether this is the one that is written.
    """

    label: str
    offset: float
    chosen: bool = False


@dataclass(frozen=True)
class AlignmentPage:
    """What the picture shows.

    Attributes
    ----------
    title : str
    verdict : str
        The result, or why there is none.
    accepted : bool
    facts : tuple of str
        Lines below the verdict.
    sound : SoundAlignment or None
        Evidence of the sound, if there was any to hear.
    marks : tuple of ShiftMark
    """

    title: str
    verdict: str
    accepted: bool
    facts: tuple[str, ...] = ()
    sound: SoundAlignment | None = None
    marks: tuple[ShiftMark, ...] = ()


def draw_alignment(page: AlignmentPage) -> ByteImage:
    """Return the picture.

    Parameters
    ----------
    page : AlignmentPage

    Returns
    -------
    (height, 1280, 3) uint8 array
        sRGB.
    """
    color = _GOOD if page.accepted else _BAD
    verdict = TextStyle(size=17, color=color)
    lines = [
        (line, verdict) for line in _wrapped(page.verdict[:1].upper() + page.verdict[1:], verdict)
    ]
    lines += [(line, _FACT) for fact in page.facts for line in _wrapped(fact, _FACT)]
    head = 72 + _LINE * len(lines) + 16
    heard = page.sound is not None and page.sound.correlation is not None
    picture = new_picture(_WIDTH, head + (600 if heard else 40), PAGE)
    fill_box(picture, 0, 0, 8, picture.shape[0], color)
    draw_text(picture, page.title, x=_MARGIN, y=24, style=_TITLE, max_width=_WIDTH - 2 * _MARGIN)
    for index, (line, style) in enumerate(lines):
        draw_text(picture, line, x=_MARGIN, y=68 + _LINE * index, style=style)
    if heard and page.sound is not None:
        _draw_correlation(picture, page, page.sound, head + 36)
        _draw_windows(picture, page.sound, head + 346)
    return picture


def _draw_correlation(
    picture: ByteImage, page: AlignmentPage, sound: SoundAlignment, y: int
) -> None:
    correlation = sound.correlation
    if correlation is None:
        return
    # A correlation holds at the middle of the video; marks are given at its start.
    middle = -float(correlation.shifts[0]) / 2
    shown = [
        (mark.label, mark.offset + sound.drift * middle, _GOOD if mark.chosen else _OTHER)
        for mark in page.marks
    ]
    scores = correlation.scores
    top = max(1.15 * float(np.nanmax(scores)), 1.5 * LEAST_PEAK)
    bottom = min(1.1 * float(np.nanmin(scores)), -0.1 * top)
    gap = 2 * _MARGIN + _AXIS - 20
    wide = (_WIDTH - _AXIS - _MARGIN - gap) * 2 // 3
    narrow = _WIDTH - _AXIS - _MARGIN - gap - wide
    heard = correlation.shifts[np.isfinite(scores)]
    ends = float(heard[0]), float(heard[-1])
    whole = Plot(picture, _AXIS, y, wide, 220, *ends, bottom, top)
    whole.draw_axes(
        "Onsets of sound", across="shift of the video, s", up="deviations of chance, by shift"
    )
    centre = next((at for _, at, color in shown if color == _GOOD), correlation.shift)
    ends = centre - _CLOSE_SECONDS, centre + _CLOSE_SECONDS
    close = Plot(picture, _AXIS + wide + gap, y, narrow, 220, *ends, bottom, top)
    close.draw_axes("The same, close up", across="shift of the video, s", up="")
    for line, (label, at, color) in enumerate(shown):
        whole.draw_mark(at, color, label, line=line)
        close.draw_mark(at, color, "", line=line)
    if np.isfinite(correlation.rival):
        whole.draw_mark(correlation.rival, _FAINT, "second best", line=len(shown))
    for plot in (whole, close):  # over the marks: a peak must stay in sight
        plot.draw_level(LEAST_PEAK, _FAINT, "needed")
        plot.draw_curve(correlation.shifts, scores, _CURVE)


def _draw_windows(picture: ByteImage, sound: SoundAlignment, y: int) -> None:
    windows = sound.windows
    if windows is None or not len(windows.times):
        return
    centre = float(np.median(windows.delays - sound.drift * windows.times))
    apart = 1000 * (windows.delays - centre)
    agreeing = apart[sound.agreeing]
    # Where hardly any agree, the scatter of all is what there is to see.
    base = agreeing if sound.agreement >= LEAST_AGREEMENT else apart
    reach = max(1.4 * float(np.ptp(base)) / 2, 0.1)
    middle = (float(base.max()) + float(base.min())) / 2
    ends = 0.0, float(windows.times[-1]) * 1.02
    panel = Plot(
        picture,
        _AXIS,
        y,
        _WIDTH - _AXIS - _MARGIN,
        190,
        *ends,
        middle - reach,
        middle + reach,
    )
    panel.draw_axes(
        "Delay by window",
        across="video time, s",
        up=f"ms from {centre:+.4f} s; filled dots agree, hollow ones do not",
    )
    line = [
        (panel.column(at), panel.row(1000 * (sound.offset + sound.drift * at - centre)))
        for at in ends
    ]
    draw_line(picture, line[0], line[1], _FAINT)
    panel.draw_points(windows.times[sound.agreeing], agreeing, _GOOD)
    panel.draw_points(windows.times[~sound.agreeing], apart[~sound.agreeing], _BAD, hollow=True)


def _wrapped(text: str, style: TextStyle) -> list[str]:
    lines, line = list[str](), ""
    for word in text.split():
        longer = f"{line} {word}" if line else word
        if line and text_width(longer, style) > _WIDTH - 2 * _MARGIN:
            lines.append(line)
            longer = word
        line = longer
    return [*lines, line]
