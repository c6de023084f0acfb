"""Colours of pictures: sRGB, the palette, and a colour-blind-safe ramp for errors."""

import numpy as np
from numpy.typing import ArrayLike

from usdface.core.arrays import ByteImage, Float32Array, FloatArray

Color = tuple[int, int, int]
"""sRGB bytes."""

PAGE: Color = (22, 23, 26)
"""Background of pages."""
PANEL: Color = (31, 33, 37)
LANE: Color = (33, 35, 39)
GRID: Color = (44, 47, 53)
RULE: Color = (58, 61, 67)
FRAME: Color = (64, 67, 74)
DIM: Color = (152, 157, 166)
SOFT: Color = (196, 200, 206)
TEXT: Color = (222, 224, 228)
BRIGHT: Color = (244, 245, 247)

BLUE: Color = (120, 200, 255)
ORANGE: Color = (255, 178, 92)
"""Blue for the curve that is given or before, orange for the one that is solved or after; most
kinds of colour blindness distinguish them."""
GREEN: Color = (129, 210, 132)
RED: Color = (240, 104, 96)
VIOLET: Color = (188, 160, 246)
VERDICT_COLORS = {"good": GREEN, "check": ORANGE, "bad": RED}
"""By the level of a verdict."""

SERIES_COLORS = (ORANGE, BLUE, GREEN, (236, 132, 152), VIOLET, (220, 216, 120), DIM)
"""Colours of more than two curves, in this order."""

KEYS_RANGE_MM = 1.0
UNKEYED_RANGE_MM = 3.0
"""Value of the last colour of `heat_ramp` in all pictures [mm]: an obvious error against keys, and
an uncertainty of three times as much."""

# Lightness, chroma and hue [degrees] in OKLCh. Lightness increases linearly, for grey prints; blue
# to yellow is distinguished with the common kinds of colour blindness. The first colour is legible
# as text on a dark page and shows the shading of the surface below.
_RAMP = np.array(
    [
        [0.44, 0.110, 264.0],
        [0.56, 0.130, 312.0],
        [0.68, 0.155, 12.0],
        [0.80, 0.140, 58.0],
        [0.93, 0.150, 104.0],
    ]
)


def srgb_from_linear(linear: ArrayLike) -> FloatArray:
    """Encode linear light with the sRGB curve, clipped to [0, 1]."""
    light = np.clip(np.asarray(linear, np.float64), 0.0, 1.0)
    return np.asarray(
        np.where(light <= 0.0031308, 12.92 * light, 1.055 * light ** (1 / 2.4) - 0.055)
    )


def linear_from_srgb(encoded: ArrayLike) -> FloatArray:
    """Decode sRGB [0-1] to linear light [0-1]."""
    code = np.clip(np.asarray(encoded, np.float64), 0.0, 1.0)
    return np.asarray(np.where(code <= 0.04045, code / 12.92, ((code + 0.055) / 1.055) ** 2.4))


_ENCODE = np.round(srgb_from_linear(np.arange(4096) / 4095) * 255).astype(np.uint8)


def bytes_from_linear(linear: Float32Array | FloatArray) -> ByteImage:
    """Encode linear light as sRGB bytes, by table: within one code except near black."""
    index = np.clip(linear * 4095 + 0.5, 0, 4095).astype(np.uint16)
    return _ENCODE[index]


def mix_color(window: ByteImage, cover: ArrayLike, color: ArrayLike) -> None:
    """Mix a colour into pixels in place; `cover`: opacity of all or of each [0-1]."""
    share = np.asarray(cover, np.float32)[..., None]
    mixed = window * (1 - share) + np.asarray(color, np.float32) * share
    window[:] = (mixed + 0.5).astype(np.uint8)


def heat_color(value: float, *, high: float) -> Color:
    """Return the colour of one value in `heat_ramp` as bytes."""
    red, green, blue = bytes_from_linear(heat_ramp(value, high=high)).tolist()
    return red, green, blue


def heat_ramp(values: ArrayLike, *, low: float = 0.0, high: float = 1.0) -> FloatArray:
    """Return colours from blue (`low`) to yellow (`high`), linear in lightness; NaN is grey.

    Linear light [0-1], (..., 3) for values of shape (...); those beyond the ends are clipped.
    """
    given = np.asarray(values, np.float64)
    span = max(high - low, 1e-12)
    at = np.clip((np.nan_to_num(given, nan=low) - low) / span, 0.0, 1.0) * (len(_TABLE) - 1)
    below = np.minimum(at.astype(np.int64), len(_TABLE) - 2)
    part = (at - below)[..., None]
    ramp = _TABLE[below] * (1 - part) + _TABLE[below + 1] * part
    return np.asarray(np.where(np.isnan(given)[..., None], 0.18, ramp), np.float64)


def _ramp_table() -> FloatArray:
    """Return 256 linear colours of the ramp, interpolated in OKLab (Ottosson 2020)."""
    angle = np.radians(_RAMP[:, 2])
    knots = np.stack(
        [_RAMP[:, 0], _RAMP[:, 1] * np.cos(angle), _RAMP[:, 1] * np.sin(angle)], axis=1
    )
    at = np.linspace(0, len(knots) - 1, 256)
    lab = np.stack([np.interp(at, np.arange(len(knots)), knots[:, k]) for k in range(3)], axis=1)
    to_cone = np.array(
        [
            [1, 0.3963377774, 0.2158037573],
            [1, -0.1055613458, -0.0638541728],
            [1, -0.0894841775, -1.2914855480],
        ]
    )
    to_linear = np.array(
        [
            [4.0767416621, -3.3077115913, 0.2309699292],
            [-1.2684380046, 2.6097574011, -0.3413193965],
            [-0.0041960863, -0.7034186147, 1.7076147010],
        ]
    )
    return np.asarray(np.clip((lab @ to_cone.T) ** 3 @ to_linear.T, 0.0, 1.0))


_TABLE = _ramp_table()
