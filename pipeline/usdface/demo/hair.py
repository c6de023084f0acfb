"""Short hair combed back from a side parting: a cap over the skull with locks cut into it.

Hair is the one thing on the head that is not symmetric; no shape moves it.
"""

import numpy as np
from scipy.interpolate import PchipInterpolator

from usdface.core.arrays import FloatArray
from usdface.demo.details import Piece, smooth_step
from usdface.demo.half_cage import grid_faces
from usdface.demo.proportions import Style
from usdface.demo.sculpt import Form, trace

# The hairline: azimuth from the front [degrees], height above the eyes [mm].
_LINE_AZIMUTH = (
    0,
    12,
    24,
    34,
    44,
    54,
    63,
    70,
    75,
    79,
    84,
    90,
    97,
    104,
    110,
    116,
    126,
    142,
    160,
    180,
)
_LINE_HEIGHT = (62, 63, 65, 66, 60, 47, 30, 9, -8, -10, -4, 8, 13, 11, 1, -16, -36, -54, -65, -67)
_COLUMNS, _ROWS = 120, 32
_PARTING_X = 20.0
"""x of the parting over the forehead [mm]."""


def hair_cap(style: Style, form: Form) -> Piece:
    """Grow the hair of a style on its sculpted head.

    Parameters
    ----------
    form : callable
        Signed distance to the head [mm].

    Returns
    -------
    Piece
        The whole head of hair.
    """
    azimuth = np.linspace(-180.0, 180.0, _COLUMNS, endpoint=False)
    line = PchipInterpolator(_LINE_AZIMUTH, _LINE_HEIGHT)(np.abs(azimuth))
    # The fringe hangs into the forehead on one side of the parting.
    line -= 8.0 * np.exp(-(((azimuth + 24.0) / 20.0) ** 2)) - 5.0 * np.exp(
        -(((azimuth - 17.0) / 9.0) ** 2)
    )
    line -= 2.2 * np.sin(azimuth * 0.42) * smooth_step(70.0, 40.0, np.abs(azimuth))
    turn = np.radians(azimuth)
    middle = np.array(style.skull.cranium)
    side = np.stack([np.sin(turn), 0.0 * turn, np.cos(turn)], axis=1)
    start = side * 300.0 + np.stack([0 * line, line, 0 * line - 8.0], axis=1)
    edge = trace(form, start, -side)
    low = np.arctan2(edge[:, 1] - middle[1], np.hypot(edge[:, 0], edge[:, 2] - middle[2]))
    along = np.concatenate([[0.0, 0.0, 0.01, 0.025], np.linspace(0.05, 1.0, _ROWS - 4)])
    rise = low + (0.5 * np.pi - 1e-3 - low) * along[:, None]
    outward = np.stack(
        [np.sin(turn) * np.cos(rise), np.sin(rise), np.cos(turn) * np.cos(rise)], axis=-1
    )
    flat = outward.reshape(-1, 3)
    scalp = trace(form, middle + 300.0 * flat, -flat).reshape(outward.shape)
    height, lock = _thickness(along[:, None], azimuth, scalp)
    border = np.concatenate([[-2.5, 0.5, 1.8, 3.0], np.full(_ROWS - 4, 4.0)])[:, None]
    points = scalp + (border / 4.0 * height)[..., None] * outward
    shade = (0.60 + 0.62 * lock)[..., None] * np.array(style.palette.hair)
    return Piece(
        points.reshape(-1, 3), grid_faces(_ROWS, _COLUMNS, closed=True), shade.reshape(-1, 3)
    )


def _thickness(
    along: FloatArray, azimuth: FloatArray, scalp: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """How far the hair stands off the scalp [mm], and the ridge of each lock [0-1]."""
    x, y, z = scalp[..., 0], scalp[..., 1], scalp[..., 2]
    crown = smooth_step(1.0, 0.72, along)
    swept = smooth_step(85.0, 20.0, np.abs(azimuth + 18.0)) * crown
    nape = smooth_step(95.0, 150.0, np.abs(azimuth))
    volume = 6.5 + 10.0 * swept * smooth_step(0.0, 0.25, along) + 3.0 * smooth_step(0.2, 0.6, along)
    volume = volume - 2.5 * nape * smooth_step(0.35, 0.0, along)
    top = smooth_step(45.0, 75.0, y) * crown
    aside = x - _PARTING_X - 0.12 * (z - 60.0)
    volume = volume - 5.0 * np.exp(-((aside / 4.0) ** 2)) * top * smooth_step(-40.0, 10.0, z)
    # Locks run back from the forehead and away from the parting, in planes through the head.
    across = np.abs(aside) * 0.75 - 0.40 * y + 0.08 * z
    across = across + 2.0 * np.sin(0.045 * z + 0.03 * y)
    broad = 0.5 + 0.5 * np.sin(0.34 * across)
    fine = 0.5 + 0.5 * np.sin(0.95 * across + 1.4 * np.sin(0.05 * z))
    lock = 0.68 * broad**0.55 + 0.32 * fine
    relief = 3.6 * (lock - 0.6) * crown * smooth_step(0.0, 0.05, along)
    return volume + relief, lock * crown + 0.55 * (1.0 - crown)
