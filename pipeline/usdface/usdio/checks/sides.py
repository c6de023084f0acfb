"""Left is left: shapes that name a side move that side of the face."""

import numpy as np
from pxr import Usd, UsdGeom, UsdSkel

from usdface.core.arrays import FloatArray
from usdface.usdio.checks.curves import pair_sides
from usdface.usdio.checks.fault import Fault, some

CLEAR_SHARE = 0.2
"""How one-sided a shape must be, of its whole movement, to count as that side's."""


def check_sides(stage: Usd.Stage) -> list[Fault]:
    """Find pairs of shapes that move the sides the other way round than most pairs do.

    Which way a character faces is not asked: the majority says where its left is.
    """
    found = []
    for mesh in stage.Traverse():
        binding = UsdSkel.BindingAPI(mesh) if mesh.IsA(UsdGeom.Mesh) else None
        names = tuple(map(str, (binding.GetBlendShapesAttr().Get() or []) if binding else []))
        pairs = pair_sides(names)
        if len(pairs) < 3:
            continue
        leaning = _leaning(mesh)
        clear = [
            (names[left], leaning[left] - leaning[right])
            for left, right in pairs
            if min(abs(leaning[left]), abs(leaning[right])) > CLEAR_SHARE
            and leaning[left] * leaning[right] < 0
        ]
        side = np.sign(sum(np.sign(lean) for _, lean in clear))
        flipped = [name for name, lean in clear if side and np.sign(lean) != side]
        if flipped:
            found.append(
                Fault(
                    "error",
                    str(mesh.GetPath()),
                    f"{some(flipped)}: left and right are exchanged, compared with the other "
                    f"{len(clear) - len(flipped)} pairs of this mesh; rename the shapes on the rig",
                )
            )
    return found


def _leaning(mesh: Usd.Prim) -> list[float]:
    """Return for each shape how far its movement lies on one side: -1 all at -x, 1 all at +x."""
    points = np.asarray(UsdGeom.Mesh(mesh).GetPointsAttr().Get() or [], dtype=np.float64)
    binding = UsdSkel.BindingAPI(mesh)
    out = []
    for target in binding.GetBlendShapeTargetsRel().GetTargets():
        shape = UsdSkel.BlendShape(mesh.GetStage().GetPrimAtPath(target))
        told = shape.GetOffsetsAttr().Get() if shape else None
        offsets: FloatArray = np.asarray(told or np.zeros((0, 3)), dtype=np.float64)
        indices = shape.GetPointIndicesAttr().Get() if shape else None
        rows = np.arange(len(offsets)) if indices is None else np.asarray(indices)
        if not len(offsets) or len(rows) != len(offsets) or rows.max(initial=0) >= len(points):
            out.append(0.0)
            continue
        size = np.linalg.norm(offsets, axis=1)
        middle = 0.5 * (points[:, 0].min() + points[:, 0].max())
        side = np.sign(points[rows, 0] - middle)
        out.append(float((size * side).sum() / max(size.sum(), 1e-12)))
    return out
