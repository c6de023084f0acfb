"""Colours of pictures: sRGB, the palette, and a ramp for errors that colour-blind eyes read too."""

import numpy as np
from numpy.typing import ArrayLike

from usdface.core.arrays import ByteImage, Float32Array, FloatArray

Color = tuple[int, int, int]
"""sRGB bytes."""

PAGE: Color = (22, 23, 26)
"""What pictures lie on."""
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
"""Blue and orange, which most kinds of colour blindness keep apart: of two curves, the one that is
given or was before, and the one that is solved, proposed or came after."""
GREEN: Color = (129, 210, 132)
RED: Color = (240, 104, 96)
VIOLET: Color = (188, 160, 246)
VERDICT_COLORS = {"good": GREEN, "check": ORANGE, "bad": RED}
"""By the level of a verdict."""

SERIES_COLORS = (ORANGE, BLUE, GREEN, (236, 132, 152), VIOLET, (220, 216, 120), DIM)
"""Of more than two curves, in this order; labels name every curve as well."""

KEYS_RANGE_MM = 1.0
UNKEYED_RANGE_MM = 3.0
"""What the last colour of `heat_ramp` stands for in every picture [mm]: an error against keys that
anybody sees, and an uncertainty of three times as much."""

# Lightness, chroma and hue [degrees] in OKLCh. Lightness climbs evenly, so the ramp survives a
# grey print; blue to yellow is the axis that the common kinds of colour blindness keep. It starts
# bright enough to be read as text on a dark page and to show the form it is painted on.
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
    """Encode linear light [0-1] with the sRGB curve; values outside are limited."""
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
    """Encode linear light as sRGB bytes, by table: exact to one code but in the deepest blacks."""
    index = np.clip(linear * 4095 + 0.5, 0, 4095).astype(np.uint16)
    return _ENCODE[index]


def heat_ramp(values: ArrayLike, *, low: float = 0.0, high: float = 1.0) -> FloatArray:
    """Return linear colours that climb from blue to yellow in even steps of lightness.

    Parameters
    ----------
    values : (...) array
    low, high : float
        Values at and beyond these take the first and the last colour.

    Returns
    -------
    (..., 3) float array
        Linear light [0-1]. NaN is grey.
    """
    given = np.asarray(values, np.float64)
    span = max(high - low, 1e-12)
    at = np.clip((np.nan_to_num(given, nan=low) - low) / span, 0.0, 1.0) * (len(_TABLE) - 1)
    below = np.minimum(at.astype(np.int64), len(_TABLE) - 2)
    part = (at - below)[..., None]
    ramp = _TABLE[below] * (1 - part) + _TABLE[below + 1] * part
    return np.asarray(np.where(np.isnan(given)[..., None], 0.18, ramp), np.float64)


def _ramp_table(steps: int = 256) -> FloatArray:
    """Linear colours along the ramp, mixed in OKLab (Ottosson 2020) between its knots."""
    angle = np.radians(_RAMP[:, 2])
    knots = np.stack(
        [_RAMP[:, 0], _RAMP[:, 1] * np.cos(angle), _RAMP[:, 1] * np.sin(angle)], axis=1
    )
    at = np.linspace(0, len(knots) - 1, steps)
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
