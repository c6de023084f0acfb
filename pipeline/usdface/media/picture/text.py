"""Text on pictures, drawn by Pillow with the DejaVu fonts of matplotlib."""

from bisect import bisect_left
from dataclasses import dataclass, replace
from functools import lru_cache
from importlib.util import find_spec
from pathlib import Path
from typing import Literal

import numpy as np
from PIL import Image, ImageDraw, ImageFont

from usdface.core.arrays import ByteImage, Float32Array, FloatArray
from usdface.core.errors import InputError
from usdface.media.picture.color import Color, mix_color

Weight = Literal["regular", "bold", "mono"]
Anchor = Literal["left", "middle", "right"]

_FONT_FILES: dict[Weight, str] = {
    "regular": "DejaVuSans.ttf",
    "bold": "DejaVuSans-Bold.ttf",
    "mono": "DejaVuSansMono.ttf",
}
_EAST_ASIAN_FONTS = (
    "NotoSansCJK-Regular.ttc",
    "NotoSansCJKjp-Regular.otf",
    "NotoSansJP-Regular.otf",
    "DroidSansFallbackFull.ttf",
    "DroidSansFallback.ttf",
    "YuGothM.ttc",  # Windows
    "msgothic.ttc",
    "ヒラギノ角ゴシック W3.ttc",  # macOS
    "Hiragino Sans GB.ttc",
    "Arial Unicode.ttf",
)
"""Fonts for letters that DejaVu lacks; the first installed one is used."""

_EM_SHARE = 0.88
"""Font size over a style's size: DejaVu's letters are larger than those of most fonts."""


@dataclass(frozen=True)
class TextStyle:
    """Size, colour and weight of a label."""

    size: int = 16
    """Height of the font's body [pixels]."""
    color: Color = (222, 224, 228)
    """sRGB bytes."""
    weight: Weight = "regular"
    """``mono`` for columns of numbers."""

    def scaled(self, scale: float) -> "TextStyle":
        """Return the style with its size multiplied by `scale`."""
        return replace(self, size=round(scale * self.size))


@lru_cache(maxsize=3)
def font_file(weight: Weight) -> Path:
    """Return the file of a font."""
    spec = find_spec("matplotlib")  # importing it would take a second
    folder = Path((spec and spec.origin) or "").parent / "mpl-data" / "fonts" / "ttf"
    file = folder / _FONT_FILES[weight]
    if not file.is_file():
        raise InputError(f"{file}: no such font; install the matplotlib wheel, which brings it")
    return file


@lru_cache(maxsize=1)
def east_asian_font_file() -> Path | None:
    """Return an installed font with Chinese and Japanese letters, or None."""
    for name in _EAST_ASIAN_FONTS:
        try:
            return Path(str(ImageFont.truetype(name, 16).path))
        except OSError:
            continue
    return None


@lru_cache(maxsize=8192)
def text_mask(text: str, *, size: int, weight: Weight = "regular") -> Float32Array:
    """Return the coverage of each pixel by a label of one line, cached: (height, width) [0-1].

    Read-only. The baseline is at row ``round(1.02 * size)``.

    `size`: height of the font's body [pixels].
    """
    runs, starts = _placed_runs(text, size, weight)
    drawn = Image.new("L", (_width(starts), round(size * 1.35)))
    pen = ImageDraw.Draw(drawn)
    for (run, font), start in zip(runs, starts.tolist(), strict=False):
        pen.text((start, round(size * 1.02)), run, 255, font, anchor="ls")
    mask = np.asarray(drawn, dtype=np.float32) / np.float32(255)
    mask.setflags(write=False)
    return mask


def text_width(text: str, style: TextStyle) -> int:
    """Return the width of a label [pixels]."""
    return _measured_width(text, style.size, style.weight)


@lru_cache(maxsize=1 << 14)  # a page measures its rows once for each number of its groups
def _measured_width(text: str, size: int, weight: Weight) -> int:
    return _width(_placed_runs(text, size, weight)[1])


def _placed_runs(
    text: str, size: int, weight: Weight
) -> tuple[list[tuple[str, ImageFont.FreeTypeFont]], FloatArray]:
    """Return the runs of a line by font, and their starts and the last end [pixels]."""
    line = "".join(" " if letter.isspace() else letter for letter in text)
    runs = _runs(line, size, weight) if line.strip() else []
    return runs, np.cumsum([0.0, *(font.getlength(run) for run, font in runs)])


def _width(starts: FloatArray) -> int:
    return int(np.ceil(starts[-1])) + (2 if len(starts) > 1 else 0)


def wrap_text(text: str, style: TextStyle, *, max_width: int) -> list[str]:
    """Return the lines of a wrapped text; at least one."""
    lines, line = list[str](), ""
    for word in text.split():
        longer = f"{line} {word}" if line else word
        if line and text_width(longer, style) > max_width:
            lines.append(line)
            longer = word
        line = longer
    return [*lines, line]


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
    """Draw a label, clipped to the picture; return its width [pixels].

    Parameters
    ----------
    picture : (height, width, 3) uint8 array
        Changed in place.
    text : str
        One line.
    x, y : int
        Position of `anchor` on the label's top edge [pixels].
    anchor : {'left', 'middle', 'right'}
    max_width : int, optional
        Longer labels are shortened in the middle, with an ellipsis [pixels].
    """
    if max_width is not None:
        text = shortened(text, style, max_width=max_width)
    mask = text_mask(text, size=style.size, weight=style.weight)
    height, width = mask.shape
    x -= {"left": 0, "middle": width // 2, "right": width}[anchor]
    top, left = max(y, 0), max(x, 0)
    bottom, right = min(y + height, picture.shape[0]), min(x + width, picture.shape[1])
    if bottom > top and right > left:
        cover = mask[top - y : bottom - y, left - x : right - x]
        mix_color(picture[top:bottom, left:right], cover, style.color)
    return int(width)


def shortened(text: str, style: TextStyle, *, max_width: int) -> str:
    """Return the text, shortened in the middle if it is too wide."""
    if text_width(text, style) <= max_width:
        return text

    def is_too_wide(length: int) -> bool:
        return text_width(_cut(text, length), style) > max_width

    fits = bisect_left(range(1, len(text)), True, key=is_too_wide)
    return _cut(text, fits) if fits else ""


def _cut(text: str, length: int) -> str:
    head = (length + 1) // 2
    return text[:head].rstrip() + "…" + text[len(text) - (length - head) :].lstrip()


@lru_cache(maxsize=256)
def _font(file: Path, size: int) -> ImageFont.FreeTypeFont:
    # Basic layout for equal results on all machines: Raqm may shift letters by a pixel.
    return ImageFont.truetype(str(file), size, layout_engine=ImageFont.Layout.BASIC)


def _runs(line: str, size: int, weight: Weight) -> list[tuple[str, ImageFont.FreeTypeFont]]:
    """Split a line into runs of one font."""
    main, other = font_file(weight), east_asian_font_file()
    pixels = max(round(size * _EM_SHARE), 1)
    if other is None or line.isascii():
        return [(line, _font(main, pixels))]
    runs: list[tuple[str, Path]] = []
    for letter in line:
        file = other if _is_missing(letter, main) else main
        if runs and file == runs[-1][1]:
            runs[-1] = runs[-1][0] + letter, file
        else:
            runs.append((letter, file))
    return [(run, _font(file, pixels)) for run, file in runs]


@lru_cache(maxsize=4096)
def _is_missing(letter: str, file: Path) -> bool:
    """Return whether a font lacks a letter and draws its box instead."""
    if letter.isascii():
        return False
    font = _font(file, 24)
    return bytes(font.getmask(letter)) == bytes(font.getmask("\U0010ffff"))
