"""Between a stage's space and ours: millimetres, Y up."""

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pxr import Gf, Usd

from usdface.usdio.layers import is_z_up, millimetres

Z_UP_TO_Y_UP = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])


def stage_to_ours(stage: Usd.Stage) -> NDArray[np.float64]:
    """Return the 3x3 that turns a stage's column vectors into millimetres, Y up."""
    turn = Z_UP_TO_Y_UP if is_z_up(stage) else np.eye(3)
    return millimetres(stage) * turn


def column_matrix(matrix: Gf.Matrix4d) -> NDArray[np.float64]:
    """Return a USD matrix (row vectors) as one for column vectors."""
    return np.array(matrix, dtype=np.float64).T


def transform_points(matrix: NDArray[np.float64], points: ArrayLike) -> NDArray[np.float64]:
    """Apply a (4, 4) column-vector transform to (n, 3) points."""
    points = np.asarray(points, dtype=np.float64).reshape(-1, 3)
    return np.asarray(points @ matrix[:3, :3].T + matrix[:3, 3], dtype=np.float64)
