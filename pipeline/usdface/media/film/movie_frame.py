"""Pictures of a review movie: panels side by side above a bar with title, frame and timecode."""

from collections.abc import Sequence
from dataclasses import dataclass

from usdface.core.arrays import ByteImage
from usdface.media.picture.canvas import empty_tile, fill_box, fit_picture, new_picture
from usdface.media.picture.color import BRIGHT, SOFT, VERDICT_COLORS, Color, heat_color
from usdface.media.picture.text import TextStyle, draw_text, text_width, wrap_text

BAR_SHARE = 0.075
"""Height of the bar over that of the panels: text is legible at a third of the movie's size."""
LEAST_BAR = 26

_BAR_COLOR: Color = (14, 15, 17)
_PANEL_GAP = 2


@dataclass(frozen=True)
class MoviePanel:
    """One of the pictures side by side."""

    width: int
    """[pixels]"""
    pixels: ByteImage | None
    """(h, w, 3): of any size; None if there is none, with the reason in `missing`."""
    label: str
    missing: str = ""


def movie_size(widths: Sequence[int], height: int) -> tuple[int, int]:
    """Return (width, height) of the whole picture, both even for encoders."""
    width = sum(widths) + _PANEL_GAP * (len(widths) - 1)
    total = height + _bar_height(height)
    return width + width % 2, total + total % 2


def compose_movie_frame(
    panels: Sequence[MoviePanel],
    *,
    height: int,
    title: str,
    clock: str,
    uncertainty: tuple[float, float] | None = None,
    verdict: tuple[str, ...] = (),
) -> ByteImage:
    """Compose one picture of size `movie_size`: (height + bar, width, 3) uint8 array, sRGB.

    Parameters
    ----------
    height : int
        Of the panels [pixels].
    title : str
        Shot and character, at the left of the bar.
    clock : str
        Frame number and timecode, at the right.
    uncertainty : tuple of float, optional
        Value, shown as number and colour in the bar, and end of the colour scale [mm].
    verdict : tuple of str
        ``'good'``, ``'check'`` or ``'bad'``, shown as the colour of the bar's upper edge, and
        optional sentences, written over the panels.
    """
    width, total = movie_size([panel.width for panel in panels], height)
    picture = new_picture(width, total, _BAR_COLOR)
    bar = _bar_height(height)
    small = TextStyle(size=max(round(0.4 * bar), 11), color=SOFT)
    x = 0
    for panel in panels:
        if panel.pixels is None:
            tile = empty_tile(panel.width, height, panel.missing)
        else:
            tile = fit_picture(panel.pixels, width=panel.width, height=height)
        picture[:height, x : x + panel.width] = tile
        # With a background: the picture may be as light as the letters.
        label = TextStyle(size=small.size, color=BRIGHT)
        ground = text_width(panel.label, label) + 12
        fill_box(picture, x, 0, min(ground, panel.width), small.size + 9, _BAR_COLOR)
        draw_text(picture, panel.label, x=x + 6, y=2, style=label, max_width=panel.width - 12)
        x += panel.width + _PANEL_GAP
    _draw_bar(picture, height, bar, title=title, clock=clock, uncertainty=uncertainty, small=small)
    if verdict:
        fill_box(picture, 0, height, width, max(bar // 10, 2), VERDICT_COLORS[verdict[0]])
        _draw_sentence(picture, height, verdict, TextStyle(size=small.size + 3, color=BRIGHT))
    return picture


def _draw_sentence(
    picture: ByteImage, bottom: int, verdict: tuple[str, ...], style: TextStyle
) -> None:
    """Write a verdict's sentences with a background, above the bar."""
    width = picture.shape[1] - 32
    lines = [line for text in verdict[1:] for line in wrap_text(text, style, max_width=width)]
    step = round(1.4 * style.size)
    top = bottom - step * len(lines) - 16
    if lines and top > 0:
        fill_box(picture, 0, top, picture.shape[1], bottom - top, _BAR_COLOR)
        fill_box(picture, 0, top, 8, bottom - top, VERDICT_COLORS[verdict[0]])
    for number, line in enumerate(lines):
        draw_text(picture, line, x=20, y=top + 8 + step * number, style=style)


def _draw_bar(
    picture: ByteImage,
    top: int,
    bar: int,
    *,
    title: str,
    clock: str,
    uncertainty: tuple[float, float] | None,
    small: TextStyle,
) -> None:
    width = picture.shape[1]
    style = TextStyle(size=round(0.56 * bar), color=BRIGHT, weight="mono")
    y = top + (bar - style.size) // 2 - 1
    used = draw_text(
        picture, clock, x=width - 10, y=y, style=style, anchor="right", max_width=width - 20
    )
    right = width - used - 34
    if uncertainty is not None:
        value, high = uncertainty
        side = round(0.44 * bar)
        room = max(right - side - 10, 0)
        labels = (f"uncertainty {value:.2f} mm", f"{value:.2f} mm", "")
        label = next(each for each in labels if text_width(each, small) <= room)
        text = draw_text(
            picture,
            label,
            x=right,
            y=top + (bar - small.size) // 2 - 1,
            style=small,
            anchor="right",
        )
        right -= text + side + 8
        fill_box(picture, right, top + (bar - side) // 2, side, side, heat_color(value, high=high))
        right -= 14
    heading = TextStyle(size=round(0.5 * bar), color=SOFT)
    y = top + (bar - heading.size) // 2 - 1
    draw_text(picture, title, x=10, y=y, style=heading, max_width=max(right - 10, 0))


def _bar_height(height: int) -> int:
    return max(round(BAR_SHARE * height), LEAST_BAR)
