"""Joints and Xforms of a rig that a performer's head and eyes may drive."""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from pxr import Usd, UsdGeom, UsdSkel

from usdface.core.arrays import FloatArray
from usdface.core.assets import Rig
from usdface.core.errors import InputError
from usdface.core.text import first_few
from usdface.usdio.authoring import check_not_instanced, names_in, prims_below, top_path
from usdface.usdio.layers import open_stage
from usdface.usdio.rig.mesh import at_rest
from usdface.usdio.rig.read import skeletons_of
from usdface.usdio.units import column_matrix, rest_transforms, stage_to_ours, transform_points

_LISTED_NAMES = 12


@dataclass(frozen=True)
class DriveTarget:
    """The joint or Xform that a part of a performer drives."""

    part: str
    """``head``, ``left_eye`` or ``right_eye``."""
    path: str
    """Of a joint in its skeleton, or of a prim in the rig's file."""
    is_joint: bool
    pivot: tuple[float, float, float]
    """Centre of rotation, in the rig's world [mm]."""


@dataclass(frozen=True)
class HeadDrive:
    """Motion of a performer's head and eyes on one rig."""

    transforms: Mapping[DriveTarget, FloatArray] = field(default_factory=dict)
    """(frames, 4, 4) by target, from rest, in the rig's world [mm]."""
    zeroed_shapes: tuple[str, ...] = ()
    """Shapes that turn the same eyeballs, and are written at 0."""
    notes: tuple[str, ...] = ()


def find_drive_target(rig: Rig, part: str, name: str) -> DriveTarget:
    """Return the only joint or Xform with a path, or with the end of one."""
    stage = open_stage(rig.file)
    skeletons = map(UsdSkel.Skeleton, skeletons_of(stage.GetPrimAtPath(rig.prim)))
    joints = dict.fromkeys(name for each in skeletons for name in names_in(each.GetJointsAttr()))
    prims = prims_below(stage.GetPrimAtPath(top_path(rig.prim)), UsdGeom.Xformable)
    xforms = [str(prim.GetPath()) for prim in prims if not prim.IsA(UsdSkel.Skeleton)]
    for paths, is_joint in ((joints, True), (xforms, False)):
        exact = [path for path in paths if path == name]
        matches = exact or [path for path in paths if f"/{path}".endswith(f"/{name.lstrip('/')}")]
        if len(matches) > 1:
            raise InputError(
                f"{rig.file}: {len(matches)} {'joints' if is_joint else 'Xforms'} are called "
                f"{name!r}: {first_few(matches)}; give --drive {part}= the whole path of one"
            )
        if matches:
            pivot_of = _joint_pivot if is_joint else _xform_pivot
            return DriveTarget(part, matches[0], is_joint, pivot_of(stage, rig, matches[0]))
    raise InputError(
        f"{rig.file}: no joint and no Xform is called {name!r}, which --drive names for the "
        f"{part}; it has the joints {first_few(joints, most=_LISTED_NAMES) or 'none'} and the "
        f"Xforms {first_few(xforms, most=_LISTED_NAMES) or 'none'}"
    )


def skeleton_with(stage: Usd.Stage, rig: Rig, joint: str) -> UsdSkel.Skeleton:
    """Return the first skeleton of a rig that has a joint."""
    skeletons = map(UsdSkel.Skeleton, skeletons_of(stage.GetPrimAtPath(rig.prim)))
    return next(each for each in skeletons if joint in names_in(each.GetJointsAttr()))


def joint_rest(skeleton: UsdSkel.Skeleton, joint: str) -> tuple[FloatArray, FloatArray, bool]:
    """Return a joint's rest, its parent's rest in the stage's world, and whether it has none."""
    names = names_in(skeleton.GetJointsAttr())
    rest = [column_matrix(each) for each in skeleton.GetRestTransformsAttr().Get()]
    prim = skeleton.GetPrim()
    world = column_matrix(rest_transforms(prim).GetLocalToWorldTransform(prim))
    above = [name for name in names if joint.startswith(f"{name}/")]
    for name in sorted(above, key=len):
        world = world @ rest[names.index(name)]
    return rest[names.index(joint)], world, not above


def _joint_pivot(stage: Usd.Stage, rig: Rig, joint: str) -> tuple[float, float, float]:
    skeleton = skeleton_with(stage, rig, joint)
    count, rest = len(skeleton.GetJointsAttr().Get()), skeleton.GetRestTransformsAttr().Get() or ()
    if len(rest) != count:
        raise InputError(
            f"{rig.file} <{skeleton.GetPath()}>: has {len(rest)} restTransforms for {count} "
            "joints; author one for each to drive them"
        )
    own, parent, _ = joint_rest(skeleton, joint)
    return _in_millimetres(stage, (parent @ own)[:3, 3])


def _xform_pivot(stage: Usd.Stage, rig: Rig, path: str) -> tuple[float, float, float]:
    """Return the origin of a prim that was placed; of one that was not, the middle of its meshes.

    Groups whose transforms were frozen into their points have the origin of the world, which may be
    at a character's feet.
    """
    prim = stage.GetPrimAtPath(path)
    cache = rest_transforms(prim)
    check_not_instanced(rig.file, prim)
    origin = column_matrix(cache.GetLocalToWorldTransform(prim))[:3, 3]
    if UsdGeom.Xformable(prim).GetXformOpOrderAttr().Get():
        return _in_millimetres(stage, origin)
    clouds = [
        transform_points(column_matrix(cache.GetLocalToWorldTransform(each)), points)
        for each in prims_below(prim, UsdGeom.Mesh)
        if (points := at_rest(UsdGeom.Mesh(each).GetPointsAttr()))
    ]
    if not clouds:
        return _in_millimetres(stage, origin)
    cloud = np.concatenate(clouds)
    return _in_millimetres(stage, (cloud.min(axis=0) + cloud.max(axis=0)) / 2)


def _in_millimetres(stage: Usd.Stage, place: FloatArray) -> tuple[float, float, float]:
    x, y, z = (stage_to_ours(stage) @ place).tolist()
    return x, y, z
