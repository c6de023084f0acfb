"""Conversion between a stage's units and axes and ours: millimetres, Y up."""

from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike
from pxr import Gf, Sdf, Usd, UsdGeom

from usdface.core.arrays import FloatArray
from usdface.core.errors import InputError
from usdface.usdio.authoring import top_path
from usdface.usdio.layers import open_layer

Z_UP_TO_Y_UP = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])
_METRES_PER_STAGE_UNIT = 0.01
MM_PER_STAGE_UNIT = 10.0
"""Layers that this package writes are in centimetres, as most film rigs."""

_SMALLEST_UNIT_M, _LARGEST_UNIT_M = 1e-9, 1e6
"""[m] Plausible units of scenes."""


def stage_to_ours(stage: Usd.Stage) -> FloatArray:
    """Return the (3, 3) matrix from a stage's column vectors to millimetres, Y up."""
    is_z_up = UsdGeom.GetStageUpAxis(stage) == UsdGeom.Tokens.z
    rotation = Z_UP_TO_Y_UP if is_z_up else np.eye(3)
    return millimetres_per_unit(stage) * rotation


def column_matrix(matrix: Gf.Matrix4d) -> FloatArray:
    """Return a USD matrix (row vectors) as one for column vectors."""
    return np.array(matrix, dtype=np.float64).T


def row_matrix(matrix: FloatArray) -> Gf.Matrix4d:
    """Return a map of column vectors, (3, 3) or (4, 4), as a USD matrix."""
    whole = np.eye(4)
    whole[: len(matrix), : len(matrix)] = matrix
    return Gf.Matrix4d(whole.T.tolist())


def rest_transforms(prim: Usd.Prim) -> UsdGeom.XformCache:
    """Return the transforms at rest of all prims under the top prim of one.

    At the first samples if one has no default value, where USD takes the identity: exporters sample
    transforms that never change.
    """
    top = prim.GetStage().GetPrimAtPath(top_path(prim.GetPath()))
    xforms = map(UsdGeom.Xformable, Usd.PrimRange(top, Usd.TraverseInstanceProxies()))
    operations = (op.GetAttr() for xform in xforms if xform for op in xform.GetOrderedXformOps())
    sampled = any(each.GetNumTimeSamples() and each.Get() is None for each in operations)
    return UsdGeom.XformCache(Usd.TimeCode.EarliestTime() if sampled else Usd.TimeCode.Default())


def transform_points(matrix: FloatArray, points: ArrayLike) -> FloatArray:
    """Apply a (4, 4) column-vector transform to (n, 3) points."""
    points = np.asarray(points, dtype=np.float64).reshape(-1, 3)
    return np.asarray(points @ matrix[:3, :3].T + matrix[:3, 3], dtype=np.float64)


def millimetres_per_unit(stage: Usd.Stage) -> float:
    """Return the length of a stage's unit [mm]."""
    metres = float(UsdGeom.GetStageMetersPerUnit(stage))
    if not _SMALLEST_UNIT_M <= metres <= _LARGEST_UNIT_M:  # also catches NaN
        raise InputError(
            f"{stage.GetRootLayer().realPath}: metersPerUnit is {metres:g}, no length that a face "
            "is measured in; correct it: 0.01 is centimetres"
        )
    return metres * 1000.0


def author_units(layer: Sdf.Layer, *, like: Path | None = None) -> None:
    """Set centimetres and Y up on a layer, or the unit and axis of a file that it references.

    `like`: the referenced file; USD does not convert units of references.
    """
    metres, up = _METRES_PER_STAGE_UNIT, "Y"
    if like is not None:
        other = open_layer(like)  # keep a reference: prims do not outlive their layer
        root = other.pseudoRoot
        metres = root.GetInfo("metersPerUnit") if root.HasInfo("metersPerUnit") else metres
        up = root.GetInfo("upAxis") if root.HasInfo("upAxis") else UsdGeom.GetFallbackUpAxis()
    layer.pseudoRoot.SetInfo("metersPerUnit", metres)
    layer.pseudoRoot.SetInfo("upAxis", up)
