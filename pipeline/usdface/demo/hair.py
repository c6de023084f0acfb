"""Short hair combed back from the forehead: a cap over the skull with locks cut into it."""

import numpy as np
from scipy.interpolate import PchipInterpolator

from usdface.assets import FloatArray
from usdface.demo.details import HalfMesh, smooth_step
from usdface.demo.halves import grid_faces
from usdface.demo.proportions import Style
from usdface.demo.sculpt import Form, trace

# The hairline: azimuth from the front [degrees], height above the eyes [mm].
_LINE_AZIMUTH = (0, 12, 24, 36, 48, 58, 66, 72, 78, 82, 87, 92, 100, 110, 120, 132, 148, 165, 180)
_LINE_HEIGHT = (64, 65, 66, 64, 55, 42, 24, 2, -18, -20, -4, 12, 19, 18, 6, -24, -52, -64, -66)
_COLUMNS, _ROWS = 61, 30


def hair_cap(style: Style, form: Form) -> HalfMesh:
    """Grow the hair of a style on its sculpted head."""
    azimuth = np.linspace(0.0, 180.0, _COLUMNS)
    line = PchipInterpolator(_LINE_AZIMUTH, _LINE_HEIGHT)(azimuth)
    turn = np.radians(azimuth)
    middle = np.array(style.skull.cranium)
    side = np.stack([np.sin(turn), 0.0 * turn, np.cos(turn)], axis=1)
    start = side * 300.0 + np.stack([0 * line, line, 0 * line - 8.0], axis=1)
    edge = trace(form, start, -side)
    low = np.arctan2(edge[:, 1] - middle[1], np.hypot(edge[:, 0], edge[:, 2] - middle[2]))
    along = np.concatenate([[0.0, 0.0, 0.008, 0.02], np.linspace(0.045, 1.0, _ROWS - 4)])
    rise = low + (0.5 * np.pi - 1e-3 - low) * along[:, None]
    outward = np.stack(
        [np.sin(turn) * np.cos(rise), np.sin(rise), np.cos(turn) * np.cos(rise)], axis=-1
    )
    flat = outward.reshape(-1, 3)
    scalp = trace(form, middle + 300.0 * flat, -flat).reshape(outward.shape)
    height, lock = _thickness(along[:, None], azimuth, scalp)
    border = np.concatenate([[-2.5, 0.6, 2.0, 3.2], np.full(_ROWS - 4, 4.0)])[:, None]
    points = scalp + (border / 4.0 * height)[..., None] * outward
    points[:, [0, -1], 0] = 0.0
    shade = (0.72 + 0.5 * lock)[..., None] * np.array(style.palette.hair)
    return HalfMesh(points.reshape(-1, 3), grid_faces(_ROWS, _COLUMNS), shade.reshape(-1, 3))


def _thickness(
    along: FloatArray, azimuth: FloatArray, scalp: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """How far the hair stands off the scalp [mm], and the ridge of each lock [0-1]."""
    front = smooth_step(75.0, 20.0, azimuth)
    nape = smooth_step(100.0, 150.0, azimuth)
    volume = 6.0 + 9.0 * front * smooth_step(0.0, 0.22, along) + 4.0 * smooth_step(0.2, 0.6, along)
    volume = volume - 2.0 * nape * smooth_step(0.3, 0.0, along)
    # Locks run back from the forehead: their ridges follow x over the top and y down the sides.
    across = np.abs(scalp[..., 0]) * 0.75 - 0.40 * scalp[..., 1] + 0.06 * scalp[..., 2]
    lock = 0.5 + 0.5 * np.sin(across * 0.52 + 1.2 * np.sin(scalp[..., 2] * 0.035))
    lock = 0.65 * lock**0.6 + 0.35 * (0.5 + 0.5 * np.sin(across * 1.27 + 0.8))
    calm = smooth_step(0.97, 0.7, along)
    return volume + 2.6 * (lock - 0.5) * calm * smooth_step(0.0, 0.06, along), lock * calm + 0.5 * (
        1 - calm
    )
