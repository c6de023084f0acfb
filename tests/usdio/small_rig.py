"""A rig small enough to read in a test: two meshes, an in-between, a channel they share."""

from pathlib import Path

import numpy as np

from usdface.core.assets import MeshShape, Rig, RigMesh, ShapeKey


def small_rig(prim: str = "/Hero") -> Rig:
    rng = np.random.default_rng(0)
    grid = np.stack(np.meshgrid(np.arange(4.0), np.arange(3.0)), -1).reshape(-1, 2) * 10
    points = np.c_[grid, np.zeros(12)]
    faces = [
        [r * 4 + c, r * 4 + c + 1, r * 4 + c + 5, r * 4 + c + 4] for r in (0, 1) for c in range(3)
    ]

    def key(weight: float, moved: list[int]) -> ShapeKey:
        return ShapeKey(weight, np.array(moved), rng.normal(0, 3, (len(moved), 3)))

    skin = RigMesh(
        path=f"{prim}/geo/skin",
        points=points,
        face_counts=np.full(6, 4),
        face_indices=np.ravel(faces),
        shapes=(
            MeshShape("jawOpen", (key(1.0, [0, 1, 2]),)),
            MeshShape("eyeBlink", (key(0.3, [5, 6]), key(0.6, [5, 6, 7]), key(1.0, [5, 6, 7]))),
            MeshShape("smile", (key(1.0, [8, 9, 10, 11]),)),
        ),
        colors=rng.random((12, 3)),
    )
    teeth = RigMesh(
        path=f"{prim}/geo/teeth",
        points=points[:4] + np.array([0, -5, -5]),
        face_counts=np.array([4]),
        face_indices=np.array([0, 1, 2, 3]),
        shapes=(MeshShape("jawOpen", (key(0.5, [0, 1, 2, 3]), key(1.0, [0, 1, 2, 3]))),),
    )
    return Rig(
        file=Path("small.usda"),
        prim=prim,
        shapes=("jawOpen", "eyeBlink", "smile"),
        meshes=(skin, teeth),
        ranges=np.array([[0.0, 1.0], [0.0, 1.0], [-0.5, 1.5]]),
    )
