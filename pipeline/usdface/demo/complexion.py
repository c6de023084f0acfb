"""The colour of the skin: blush, lips, lids, the dark of the mouth and of the nostrils."""

import numpy as np

from usdface.core.arrays import FloatArray
from usdface.demo.details import smooth_step
from usdface.demo.half_cage import Mark
from usdface.demo.proportions import Style


def skin_colors(style: Style, points: FloatArray, marks: FloatArray) -> FloatArray:
    """Paint the skin.

    Parameters
    ----------
    points : (points, 3) float array
        [mm]
    marks : (points, len(Mark)) float array

    Returns
    -------
    (points, 3) float array
        Linear.
    """
    x, y, z = np.abs(points[:, 0]), points[:, 1], points[:, 2]
    eye, nose, mouth = style.eye, style.nose, style.mouth
    front = smooth_step(20.0, 60.0, z)

    def spot(cx: float, cy: float, rx: float, ry: float) -> FloatArray:
        return front * np.exp(-(((x - cx) / rx) ** 2) - ((y - cy) / ry) ** 2)

    blush = 0.85 * spot(eye.center[0] + 8.0, eye.center[1] - 33.0, 19.0, 13.0)
    blush += 0.55 * spot(0.0, nose.tip[0], 13.0, 10.0) + 0.30 * spot(
        0.0, style.skull.chin[1], 14.0, 9.0
    )
    shadow = 0.30 * spot(
        eye.center[0], eye.center[1] + 3.0, eye.half_width * 1.25, eye.open_up + 8.0
    )
    color = np.array(style.palette.skin) * (1.0 - np.outer(blush, (0.02, 0.24, 0.24)))
    color *= 1.0 - np.outer(shadow, (0.35, 0.6, 0.55))

    ring, side = marks[:, Mark.MOUTH_RING], marks[:, Mark.MOUTH_SIDE]
    lip = np.array(style.palette.lip) * np.where(side > 0.0, 0.86, 1.04)[:, None]
    color = _mix(color, lip, smooth_step(2.30, 1.80, ring))
    color = _mix(color, 0.55 * np.array(style.palette.lip), smooth_step(0.45, -0.1, ring))
    color = _mix(color, np.array([0.30, 0.075, 0.065]), smooth_step(-0.4, -1.6, ring))
    color = _mix(color, np.array([0.045, 0.010, 0.009]), smooth_step(-1.6, -3.2, ring))
    corner = spot(mouth.half_width + 1.0, mouth.height + mouth.curve, 3.0, 1.6)
    color *= 1.0 - 0.45 * corner[:, None] * (ring > -0.5)[:, None]

    ring, side = marks[:, Mark.EYE_RING], marks[:, Mark.EYE_SIDE]
    color = _mix(color, 0.80 * np.array(style.palette.lip), 0.65 * smooth_step(0.15, -0.4, ring))
    lash_line = (
        smooth_step(0.0, 0.35, side) * smooth_step(0.42, 0.15, ring) * smooth_step(-1.5, -0.9, ring)
    )
    color = _mix(color, 0.25 * np.array(style.palette.brow), lash_line)
    color = _mix(
        color,
        np.array([0.10, 0.04, 0.03]),
        0.45 * smooth_step(0.0, -0.4, side) * smooth_step(0.35, 0.1, np.abs(ring)),
    )
    crease = np.exp(-(((ring - 2.1) / 0.35) ** 2)) * smooth_step(0.1, 0.6, side)
    color *= 1.0 - np.outer(crease, (0.18, 0.28, 0.28))
    return _mix(
        color, np.array([0.03, 0.008, 0.006]), smooth_step(0.02, 0.45, marks[:, Mark.NOSTRIL])
    )


def _mix(color: FloatArray, other: FloatArray, amount: FloatArray) -> FloatArray:
    return color + amount[:, None] * (other - color)
