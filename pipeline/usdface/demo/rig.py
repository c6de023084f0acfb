"""The built-in head as a rig: meshes an outliner shows by name, with sparse BlendShapes."""

from pathlib import Path

import numpy as np

from usdface.core.arrays import FloatArray, IntArray
from usdface.core.assets import MeshShape, Rig, RigMesh, ShapeKey
from usdface.demo.head import DemoHead, HeadPart
from usdface.demo.proportions import CHARACTER, Style
from usdface.demo.shapes import make_head

MESHES = {
    "skin": (HeadPart.SKIN, HeadPart.EARS),
    "eyes": (HeadPart.EYES,),
    "teeth": (HeadPart.UPPER_TEETH, HeadPart.LOWER_TEETH),
    "tongue": (HeadPart.TONGUE,),
    "brows": (HeadPart.BROWS,),
    "lashes": (HeadPart.LASHES,),
    "hair": (HeadPart.HAIR,),
}
"""Mesh names and the parts of the head in each, in drawing order."""

SMALLEST_OFFSET = 1e-4
"""Points that a shape moves less than this are left out of it [mm]."""


def demo_rig(style: Style = CHARACTER) -> Rig:
    """Build a style's head as a rig.

    Returns
    -------
    Rig
        `Rig.file` is empty until the rig is written.
    """
    return rig_from_head(make_head(style))


def rig_from_head(head: DemoHead) -> Rig:
    """Split a head into meshes with sparse shapes."""
    prim = f"/{head.style.name}"
    names = tuple(head.shapes)
    return Rig(
        file=Path(),
        prim=prim,
        shapes=names,
        meshes=tuple(
            _mesh(head, f"{prim}/geometry/{name}", points)
            for name, points in mesh_points(head).items()
        ),
        ranges=np.tile([0.0, 1.0], (len(names), 1)),
    )


def mesh_points(head: DemoHead) -> dict[str, IntArray]:
    """Which of the head's points each mesh of its rig holds, in the mesh's order."""
    return {
        name: np.flatnonzero(np.isin(head.parts, [int(part) for part in parts]))
        for name, parts in MESHES.items()
    }


def _mesh(head: DemoHead, path: str, points: IntArray) -> RigMesh:
    place = np.full(len(head.points), -1)
    place[points] = np.arange(len(points))
    faces = place[head.faces[np.all(place[head.faces] >= 0, axis=1)]]
    shapes = []
    for name, keys in head.shapes.items():
        sparse = tuple(_key(weight, offsets[points]) for weight, offsets in keys)
        if any(len(key.points) for key in sparse):
            shapes.append(MeshShape(name, sparse))
    return RigMesh(
        path=path,
        points=head.points[points],
        face_counts=np.full(len(faces), 4, np.int64),
        face_indices=faces.ravel(),
        shapes=tuple(shapes),
        colors=head.colors[points],
        subdivision="none",
    )


def _key(weight: float, offsets: FloatArray) -> ShapeKey:
    moved = np.flatnonzero(np.linalg.norm(offsets, axis=1) > SMALLEST_OFFSET)
    return ShapeKey(weight, moved, offsets[moved])
