"""Front view of a marker cloud: near dots bright and large, occluded ones hollow."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from usdface.core.arrays import ByteImage, FloatArray, distances
from usdface.media.face.raycast import background
from usdface.media.picture.canvas import draw_dot, draw_line
from usdface.media.picture.color import Color, bytes_from_linear

_FAR, _NEAR = np.array([74, 92, 112]), np.array([150, 208, 255])
_UNSEEN = (214, 122, 84)
_LARGEST_DOT = 4.2
_DOT_SHARE = 0.28
"""Largest radius of a dot relative to the distance of neighbours, so that lines between landmarks
are visible."""
_LINE = (104, 140, 176)


@dataclass(frozen=True)
class MarkersFrame:
    """Framing of a marker cloud; one for a whole sheet, so that tiles have the same scale."""

    center: FloatArray
    """(3,) [mm]"""
    height: float
    """From the tile's lower to its upper edge [mm]."""
    depth: float
    """From the furthest to the nearest marker [mm]."""
    spacing: float = np.inf
    """Median distance of neighbouring markers in the front view [mm]."""


_CLOUD_ROOM = 1.16
"""Height of the tile over that of the cloud."""


def frame_markers(positions: ArrayLike) -> MarkersFrame:
    """Return the framing of a cloud over all of its frames, except outliers.

    `positions`: (..., markers, 3) [mm], without head motion.
    """
    cloud = np.asarray(positions, np.float64)
    # Percentiles, because a single outlier would shrink the face.
    low, high = np.percentile(cloud.reshape(-1, 3), [0.2, 99.8], axis=0)
    span = np.maximum(high - low, 1e-6)
    return MarkersFrame(
        center=(low + high) / 2,
        height=float(_CLOUD_ROOM * max(span[:2])),
        depth=float(span[2]),
        spacing=_spacing(cloud),
    )


def _spacing(positions: FloatArray) -> float:
    """Return the median distance to the nearest marker, in the first frame."""
    at = positions.reshape(-1, *positions.shape[-2:])[0, :, :2]
    if len(at) < 2:
        return np.inf
    away = distances(at[:, None], at)
    np.fill_diagonal(away, np.inf)
    return float(np.median(away.min(axis=1)))


def draw_markers(
    positions: ArrayLike,
    *,
    width: int,
    height: int,
    frame: MarkersFrame | None = None,
    visible: ArrayLike | None = None,
    lines: ArrayLike = (),
) -> ByteImage:
    """Draw one frame of a marker cloud: (height, width, 3) uint8 array.

    Parameters
    ----------
    positions : (markers, 3) array
        [mm], without head motion, Y up, the face looking along +Z.
    width, height : int
        [pixels]
    frame : MarkersFrame, optional
        Default: fits this cloud.
    visible : (markers,) bool array, optional
        Occluded markers are drawn hollow.
    lines : (lines, 2) int array, optional
        Markers to join by lines, such as along a lip.
    """
    cloud = np.asarray(positions, np.float64)
    seen = np.ones(len(cloud), bool) if visible is None else np.asarray(visible, bool)
    view = frame or frame_markers(cloud)
    scale = height / view.height
    picture = bytes_from_linear(background(height, width))
    local = (cloud - view.center) * scale
    at = np.stack([width / 2 + local[:, 0], height / 2 - local[:, 1]], axis=1)
    near = np.clip((cloud[:, 2] - view.center[2]) / max(view.depth, 1e-6) + 0.5, 0, 1)
    size = min(width, height) / 320
    dot = min(size, _DOT_SHARE * view.spacing * scale / _LARGEST_DOT)
    draw_marker_lines(picture, at, lines, size=size)
    for marker in np.argsort(near, kind="stable"):
        x, y = at[marker]
        radius = dot * (2.6 + 1.6 * near[marker])
        shade = _FAR + (_NEAR - _FAR) * near[marker]
        color = (int(shade[0]), int(shade[1]), int(shade[2]))
        if seen[marker]:
            draw_dot(picture, x, y, radius, color)
        else:
            draw_dot(picture, x, y, radius + 0.8 * size, _UNSEEN, hollow=True)
    return picture


def draw_marker_lines(
    picture: ByteImage, at: FloatArray, lines: ArrayLike, *, size: float, color: Color = _LINE
) -> None:
    """Draw lines, (lines, 2), between markers.

    `at`: (markers, 2), positions in the picture [pixels]; NaN if unknown. `size`: scale of the
    picture, height / 320.
    """
    for one, other in np.asarray(lines, np.int64).reshape(-1, 2).tolist():
        if np.isfinite(at[[one, other]]).all():
            draw_line(picture, at[one], at[other], color, thickness=1.2 * size)
