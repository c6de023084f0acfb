"""Rows of a sheet that compares deformations of a mesh by the same markers, with uncertainty.

As Figures 3, 4 and 6 of Wang et al. (2006): Euclidean, geodesic and blended distance, and
interpolation, which keeps the markers' noise, beside regression, which smooths it.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from usdface.core.arrays import FloatArray
from usdface.core.assets import RigMesh
from usdface.media.face.camera import frame_face
from usdface.media.face.render import FaceRenderer, Quality
from usdface.media.picture.color import UNKEYED_RANGE_MM
from usdface.media.picture.sheet import SheetRow, Tile


@dataclass(frozen=True)
class ComparedFrame:
    """One row of the comparison."""

    frame: int
    timecode: str
    surfaces: tuple[FloatArray, ...]
    """tuple of (points, 3) float arrays: the mesh deformed by each method [mm]."""
    uncertainty_mm: FloatArray | None = None
    """(points,): standard deviation of the last surface's points [mm]."""
    note: str = ""


_TILE_SIZE = 320
"""Width and height of a picture [pixels]."""


def draw_compared(
    mesh: RigMesh,
    frames: Sequence[ComparedFrame],
    *,
    still: Sequence[RigMesh] = (),
    near: FloatArray,
    yaw_degrees: float,
    quality: Quality = "final",
) -> Iterator[SheetRow]:
    """Yield rows with a face for each method, and the last one's uncertainty as a heat map.

    `still`: meshes that are not deformed, as eyes, teeth and hair. `near`: positions on the mesh to
    frame, (markers, 3) [mm]. `yaw_degrees`: of the camera around the head.
    """
    renderer = FaceRenderer([mesh, *still])
    others = np.concatenate([np.zeros((0, 3)), *(each.points for each in still)])
    room = 0.10 * float(np.ptp(near, axis=0).max())
    low, high = near.min(axis=0) - room, near.max(axis=0) + room
    shown = ((mesh.points >= low) & (mesh.points <= high)).all(axis=1).astype(np.float64)
    camera = frame_face(
        np.concatenate([mesh.points, others]),
        weights=np.concatenate([shown, np.zeros(len(others))]),
        yaw_degrees=yaw_degrees,
        hair=True,
    )
    draw = partial(
        renderer.render, camera=camera, width=_TILE_SIZE, height=_TILE_SIZE, quality=quality
    )
    for each in frames:
        tiles = [Tile(draw(np.concatenate([points, others]))) for points in each.surfaces]
        if each.uncertainty_mm is not None:
            heat = draw(
                np.concatenate([each.surfaces[-1], others]),
                values=np.concatenate([each.uncertainty_mm, np.zeros(len(others))]),
                value_range=(0.0, UNKEYED_RANGE_MM),
            )
            inside = each.uncertainty_mm[shown > 0]
            tiles.append(Tile(heat, value=float(np.sqrt((inside**2).mean()))))
        yield SheetRow(frame=each.frame, timecode=each.timecode, tiles=tuple(tiles), note=each.note)
