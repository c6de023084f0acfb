"""Letters on pictures, drawn by OpenImageIO with the font it brings along."""

from dataclasses import dataclass
from functools import lru_cache
from typing import Literal

import numpy as np
import OpenImageIO as oiio  # noqa: N813  # the name all its users know it by

from usdface.core.arrays import ByteImage, Float32Array
from usdface.core.errors import InputError
from usdface.media.picture.canvas import Color
from usdface.media.picture.pixel_font import pixel_mask

Weight = Literal["regular", "bold", "mono"]
Anchor = Literal["left", "middle", "right"]

# OpenImageIO embeds these; names with spaces are not found.
_FONTS: dict[Weight, str] = {
    "regular": "DroidSans",
    "bold": "DroidSans-Bold",
    "mono": "DroidSansMono",
}


@dataclass(frozen=True)
class TextStyle:
    """How a label looks.

    Attributes
    ----------
    size : int
        Height of the letters' body [pixels].
    color : tuple of int
        sRGB bytes.
    weight : {'regular', 'bold', 'mono'}
        ``mono`` for numbers that stand below each other.
    """

    size: int = 16
    color: Color = (222, 224, 228)
    weight: Weight = "regular"


@lru_cache(maxsize=1)
def font_works() -> bool:
    """Whether OpenImageIO can draw here; without it labels use a small built-in pixel font."""
    try:
        require_font()
    except InputError:
        return False
    return True


def require_font() -> None:
    """Refuse to go on without a real font.

    Raises
    ------
    InputError
        If OpenImageIO was built without FreeType or finds none of its fonts.
    """
    buffer = oiio.ImageBuf(oiio.ImageSpec(64, 32, 1, "float"))
    drawn = oiio.ImageBufAlgo.render_text(buffer, 4, 24, "A", 20, _FONTS["regular"], (1.0,))
    if not drawn or not np.any(buffer.get_pixels("float")):
        reason = buffer.geterror() or "nothing was drawn"
        raise InputError(
            f"OpenImageIO cannot draw text with {_FONTS['regular']} ({reason}); install the "
            "OpenImageIO wheel from PyPI, which brings the font"
        )


@lru_cache(maxsize=8192)
def text_mask(text: str, *, size: int, weight: Weight = "regular") -> Float32Array:
    """Return how much of each pixel the letters cover; drawn once, as labels repeat.

    Parameters
    ----------
    text : str
        One line.
    size : int
        Height of the letters' body [pixels].
    weight : {'regular', 'bold', 'mono'}

    Returns
    -------
    (height, width) float32 array
        [0-1]; read-only. The base line lies at ``baseline(size)``.
    """
    line = "".join(" " if letter.isspace() else letter for letter in text)
    height = round(size * 1.35)
    if not line.strip():
        mask = np.zeros((height, 0), np.float32)
    elif not font_works():
        mask = pixel_mask(line, size=size)
    else:
        mask = _draw_line(line, size, weight, height)
    mask.setflags(write=False)
    return mask


def baseline(size: int) -> int:
    """Return the row of the base line in a mask of letters of this size."""
    return round(size * 1.02)


def text_width(text: str, style: TextStyle) -> int:
    """Return how wide a label will be [pixels]."""
    return int(text_mask(text, size=style.size, weight=style.weight).shape[1])


def draw_text(
    picture: ByteImage,
    text: str,
    *,
    x: int,
    y: int,
    style: TextStyle = TextStyle(),  # frozen
    anchor: Anchor = "left",
    max_width: int | None = None,
) -> int:
    """Draw a label into a picture; what lies outside is cut off.

    Parameters
    ----------
    picture : (height, width, 3) uint8 array
        Changed in place.
    text : str
    x, y : int
        Where `anchor` of the label's top edge goes [pixels].
    style : TextStyle
    anchor : {'left', 'middle', 'right'}
    max_width : int, optional
        Longer labels end in an ellipsis [pixels].

    Returns
    -------
    int
        The label's width [pixels].
    """
    if max_width is not None:
        text = shortened(text, style, max_width=max_width)
    mask = text_mask(text, size=style.size, weight=style.weight)
    height, width = mask.shape
    x -= {"left": 0, "middle": width // 2, "right": width}[anchor]
    top, left = max(y, 0), max(x, 0)
    bottom, right = min(y + height, picture.shape[0]), min(x + width, picture.shape[1])
    if bottom > top and right > left:
        cover = mask[top - y : bottom - y, left - x : right - x, None]
        under = picture[top:bottom, left:right].astype(np.float32)
        mixed = under * (1 - cover) + cover * np.asarray(style.color, np.float32)
        picture[top:bottom, left:right] = (mixed + 0.5).astype(np.uint8)
    return int(width)


def shortened(text: str, style: TextStyle, *, max_width: int) -> str:
    """Return the text, cut in the middle if it is too wide: names differ at both ends."""
    if text_width(text, style) <= max_width:
        return text
    fits, too_long = 0, len(text)
    while too_long - fits > 1:
        middle = (fits + too_long) // 2
        if text_width(_cut(text, middle), style) <= max_width:
            fits = middle
        else:
            too_long = middle
    return _cut(text, fits) if fits else ""


def _cut(text: str, kept: int) -> str:
    head = (kept + 1) // 2
    return text[:head].rstrip() + "…" + text[len(text) - (kept - head) :].lstrip()


def _draw_line(line: str, size: int, weight: Weight, height: int) -> Float32Array:
    runs = _runs(line, weight)
    drawn = [
        _draw_run(run, size, font, height, last=number == len(runs))
        for number, (run, font) in enumerate(runs, start=1)
    ]
    if any(run is None for run in drawn):
        return pixel_mask(line, size=size)
    return np.concatenate([run for run in drawn if run is not None], axis=1)


def _runs(line: str, weight: Weight) -> list[tuple[str, str]]:
    """Cut a line where the font changes: two of the three know no letters beyond Western Europe's.

    They draw nothing for others, the ellipsis among them; the third has Greek and Cyrillic, and a
    box for what it lacks.
    """
    runs: list[tuple[str, str]] = []
    for letter in line:
        font = _FONTS["mono" if _is_blank(letter, _FONTS[weight]) else weight]
        if runs and font == runs[-1][1]:
            runs[-1] = runs[-1][0] + letter, font
        else:
            runs.append((letter, font))
    return runs


@lru_cache(maxsize=4096)
def _is_blank(letter: str, font: str) -> bool:
    """Whether a font draws nothing for a letter that should be seen."""
    if letter.isspace() or letter.isascii():
        return False
    buffer = oiio.ImageBuf(oiio.ImageSpec(64, 64, 1, "float"))
    oiio.ImageBufAlgo.zero(buffer)
    drawn = oiio.ImageBufAlgo.render_text(buffer, 12, 44, letter, 30, font, (1.0,))
    return drawn and float(np.asarray(buffer.get_pixels("float"), np.float32).sum()) < 1.0


def _draw_run(line: str, size: int, font: str, height: int, *, last: bool) -> Float32Array | None:
    box = oiio.ImageBufAlgo.text_size(line, size, font)
    # The advance of a last space is not in the box, and a first letter may start left of zero.
    width = max(box.xend, box.width) + 2
    if not last:
        behind = oiio.ImageBufAlgo.text_size(line + "x", size, font).xend
        width = behind - oiio.ImageBufAlgo.text_size("x", size, font).xend
    buffer = oiio.ImageBuf(oiio.ImageSpec(max(width, 1), height, 1, "float"))
    oiio.ImageBufAlgo.zero(buffer)
    start = max(-box.xbegin, 0)
    if not oiio.ImageBufAlgo.render_text(buffer, start, baseline(size), line, size, font, (1.0,)):
        return None
    drawn = np.asarray(buffer.get_pixels("float"), np.float32).reshape(height, max(width, 1))
    return np.clip(drawn, 0, 1)
