"""A character's controls as its rig has them when nobody poses it."""

from collections.abc import Sequence

import numpy as np
from pxr import Gf, Sdf, UsdSkel

from usdface.core.assets import Rig
from usdface.core.controls import Controls
from usdface.usdio.layers import open_stage
from usdface.usdio.retarget.control_attributes import control_attribute, find_control_attributes
from usdface.usdio.rig.read import skeletons_of


def rest_controls(rig: Rig, *, attributes: Sequence[str] = (), joints: bool = True) -> Controls:
    """Return one row of controls: weights 0, joints at rest, attributes as the rig has them.

    Parameters
    ----------
    rig : Rig
    attributes : sequence of str
        Names or patterns; see `find_control_attributes`.
    joints : bool
        Whether joints are controls; a skeleton of one joint only carries the head, and is none.

    Raises
    ------
    InputError
        If an attribute is not there or no float.
    """
    stage = open_stage(rig.file)
    names: tuple[str, ...] = ()
    rest: list[Gf.Matrix4d] = []
    skeletons = skeletons_of(stage.GetPrimAtPath(rig.prim))
    if joints and skeletons:
        skeleton = UsdSkel.Skeleton(skeletons[0])
        names = tuple(map(str, skeleton.GetJointsAttr().Get() or ()))
        rest = list(skeleton.GetRestTransformsAttr().Get() or ())
    if len(names) < 2 or len(rest) != len(names):
        names, rest = (), []
    top = stage.GetPrimAtPath(Sdf.Path(rig.prim).GetPrefixes()[0])
    found = find_control_attributes(rig, attributes)
    values = [control_attribute(top, name, rig.file).Get() or 0.0 for name in found]
    parts = [_decompose(matrix) for matrix in rest]
    return Controls(
        shapes=rig.shapes,
        weights=np.zeros((1, len(rig.shapes))),
        joints=names,
        translations=np.array([part[0] for part in parts], float).reshape(1, -1, 3),
        rotations=np.array([part[1] for part in parts], float).reshape(1, -1, 4),
        scales=np.array([part[2] for part in parts], float).reshape(1, -1, 3),
        attributes=found,
        values=np.array(values, float).reshape(1, -1),
    )


def _decompose(matrix: Gf.Matrix4d) -> tuple[list[float], list[float], list[float]]:
    """Return translation, rotation (w first) and scale, as UsdSkel takes a transform apart."""
    translation, rotation, scale = UsdSkel.DecomposeTransform(matrix)
    turn = [rotation.GetReal(), *rotation.GetImaginary()]
    return list(translation), turn, [float(each) for each in scale]
