"""Moved meshes side by side, with what stays still about them."""

import numpy as np

from usdface.core.assets import RigMesh
from usdface.media.picture.surface_comparison import ComparedFrame, draw_compared


def square(size: float, z: float) -> RigMesh:
    corners = size * np.array([[-1.0, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]])
    blue = np.tile([0.0, 0.0, 1.0], (4, 1)) if z else None
    return RigMesh(
        "/face", corners + np.array([0.0, 0.0, z]), np.array([4]), np.arange(4), colors=blue
    )


def test_parts_that_stay_are_drawn_in_every_column() -> None:
    face, eye = square(50.0, 0.0), square(15.0, 10.0)
    moved = ComparedFrame(
        7, "", (face.points, face.points + np.array([0.0, 1.0, 0.0])), np.full(4, 0.5)
    )

    def middles(still: list[RigMesh]) -> list[np.ndarray]:
        (row,) = draw_compared(
            face, [moved], still=still, near=face.points, yaw_degrees=0.0, quality="draft"
        )
        return [tile.pixels[160, 160].astype(int) for tile in row.tiles]

    with_eye, without = middles([eye]), middles([])
    assert len(with_eye) == 3
    far = [np.abs(a - b).max() for a, b in zip(with_eye, without, strict=True)]
    assert far[2] > 20  # heat: what stays has no uncertainty
    assert min(far[:2]) > 20
