"""Meshes whose pictures are known in closed form."""

import numpy as np

from usdface.core.assets import MeshShape, RigMesh, ShapeKey


def sphere(radius: float = 50.0, *, rows: int = 48, columns: int = 96, **fields) -> RigMesh:
    """A globe of quads with triangles at its poles."""
    down = np.linspace(0, np.pi, rows + 1)[1:-1]
    around = np.arange(columns) * 2 * np.pi / columns
    ring = np.stack(
        [
            np.sin(down)[:, None] * np.sin(around),
            np.broadcast_to(np.cos(down)[:, None], (rows - 1, columns)),
            np.sin(down)[:, None] * np.cos(around),
        ],
        axis=-1,
    ).reshape(-1, 3)
    points = radius * np.concatenate([ring, [[0, 1, 0], [0, -1, 0]]])
    faces: list[list[int]] = []
    for row in range(rows - 2):
        for column in range(columns):
            right = (column + 1) % columns
            a, b = row * columns, (row + 1) * columns
            faces.append([a + column, b + column, b + right, a + right])
    top, bottom = len(points) - 2, len(points) - 1
    last = (rows - 2) * columns
    faces += [[top, c, (c + 1) % columns] for c in range(columns)]
    faces += [[bottom, last + (c + 1) % columns, last + c] for c in range(columns)]
    return mesh(points, faces, **fields)


def plate(size: float, z: float, **fields) -> RigMesh:
    """A square that faces the camera."""
    h = size / 2
    corners = np.array([[-h, -h, z], [h, -h, z], [h, h, z], [-h, h, z]])
    return mesh(corners, [[0, 1, 2, 3]], **fields)


def mesh(points: np.ndarray, faces: list[list[int]], **fields) -> RigMesh:
    return RigMesh(
        path=fields.pop("path", "/Form"),
        points=np.asarray(points, float),
        face_counts=np.array([len(face) for face in faces], np.int64),
        face_indices=np.concatenate([np.array(face, np.int64) for face in faces]),
        **fields,
    )


def head() -> RigMesh:
    """A ball with a jaw: its lower front moves down as ``jawOpen``, its upper front as a brow."""
    ball = sphere(100.0)
    lower = np.flatnonzero((ball.points[:, 1] < -20) & (ball.points[:, 2] > 40))
    upper = np.flatnonzero((ball.points[:, 1] > 40) & (ball.points[:, 2] > 40))
    shapes = (
        MeshShape("jawOpen", (ShapeKey(1.0, lower, np.full((len(lower), 3), [0, -30.0, 0])),)),
        MeshShape("browUp", (ShapeKey(1.0, upper, np.full((len(upper), 3), [0, 6.0, 0])),)),
    )
    return sphere(100.0, shapes=shapes)
