"""Layers of a performance with joints, Xforms and attributes, and joining those of parts.

NAME.head.usdc and NAME.controls.usdc are sublayers of NAME.usda, stronger than its weights. The
head layer moves head and eyes: joints on the same animation prim, Xforms as overs with one
transform before those of the rig. A joint with a parent is only rotated, as the neck determines its
position; a root joint and an Xform are translated as well.
"""

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import numpy as np
from pxr import Gf, Sdf, Usd, UsdGeom

from usdface.core.arrays import FloatArray
from usdface.core.assets import Rig
from usdface.core.controls import Controls, shape_controls
from usdface.core.errors import InputError
from usdface.core.provenance import Provenance
from usdface.core.sidecars import controls_path, head_path
from usdface.core.text import first_few
from usdface.numerics.motion.rotation_space import multiply_quaternions
from usdface.usdio.authoring import (
    author_series,
    author_uniform,
    paths_in,
    sampled_properties,
    top_path,
)
from usdface.usdio.layers import new_layer, open_stage
from usdface.usdio.performance.read import PerformanceReader
from usdface.usdio.performance.weights_layer import WeightsHeader, author_layer_metadata
from usdface.usdio.retarget.controls import (
    author_joints,
    controls_at,
    decompose_joint,
    set_joint_samples,
)
from usdface.usdio.rig.drive_targets import DriveTarget, joint_rest, skeleton_with
from usdface.usdio.rig.reference import rig_path_of
from usdface.usdio.units import column_matrix, rest_transforms, row_matrix, stage_to_ours

TRANSFORM = "xformOp:transform:head"


def write_head_layer(
    path: Path,
    header: WeightsHeader,
    rig: Rig,
    transforms: Mapping[DriveTarget, FloatArray],
    *,
    controls: Sdf.Layer | None = None,
    provenance: Provenance | None = None,
) -> None:
    """Write the head layer of a performance.

    Parameters
    ----------
    path : Path
        The performance.
    transforms : mapping of DriveTarget to (frames, 4, 4) float array
        From rest, in the rig's world, for column vectors [mm]. If empty, no layer is written.
    controls : Sdf.Layer, optional
        With the joints of a retargeting, to which the rotations are added.
    """
    if not transforms:
        return
    stage = open_stage(rig.file)
    ours = np.eye(4)
    ours[:3, :3] = stage_to_ours(stage)
    back = np.linalg.inv(ours)
    world = {target: back @ values @ ours for target, values in transforms.items()}
    joints = {target: values for target, values in world.items() if target.is_joint}
    with new_layer(head_path(path), provenance) as layer:
        author_layer_metadata(layer, header, rig)
        if joints:
            driven = _turn_joints(_joints_of(controls, header, path), stage, rig, joints)
            prim = Sdf.CreatePrimInLayer(layer, header.animation)
            author_joints(prim, driven.joints)
            set_joint_samples(layer, header.animation, driven, header.first_frame)
        source = top_path(rig.prim)
        for target in [each for each in world if not each.is_joint]:
            prim = stage.GetPrimAtPath(target.path)
            over = Sdf.CreatePrimInLayer(
                layer, prim.GetPath().ReplacePrefix(source, header.rig_path)
            )
            _author_xform(over, prim, world[target], header.first_frame)


def _joints_of(controls: Sdf.Layer | None, header: WeightsHeader, path: Path) -> Controls:
    """Return the joints of a retargeting, or none."""
    if controls is not None:
        stage = Usd.Stage.Open(controls)
        frames = range(header.first_frame, header.last_frame + 1)
        return controls_at(stage.GetPrimAtPath(header.animation), None, (), frames, path)
    return shape_controls((), np.zeros((header.frame_count, 0)))


def _turn_joints(
    below: Controls, stage: Usd.Stage, rig: Rig, transforms: Mapping[DriveTarget, FloatArray]
) -> Controls:
    """Return the joints of a retargeting, or at rest, with the driven ones rotated in addition."""
    from scipy.spatial.transform import Rotation  # imported late: joining needs none

    names = list(below.joints)
    places, turns, scales = (
        list(np.moveaxis(each, 1, 0))
        for each in (below.translations, below.rotations, below.scales)
    )
    for target, world in transforms.items():
        rest, parent, is_root = joint_rest(skeleton_with(stage, rig, target.path), target.path)
        local = np.linalg.inv(parent) @ world @ parent
        if target.path not in names:
            names.append(target.path)
            for series, part in zip(
                (places, turns, scales), decompose_joint(row_matrix(rest)), strict=True
            ):
                series.append(np.tile(part, (len(world), 1)))
        at = names.index(target.path)
        turned = Rotation.from_matrix(local[:, :3, :3]).as_quat(scalar_first=True)
        turns[at] = multiply_quaternions(turned, turns[at])
        if is_root:
            places[at] = np.einsum("fij,fj->fi", local[:, :3, :3], places[at]) + local[:, :3, 3]
    return Controls(
        joints=tuple(names),
        weights=np.zeros((len(places[0]), 0)),
        translations=np.stack(places, axis=1),
        rotations=np.stack(turns, axis=1),
        scales=np.stack(scales, axis=1),
    )


def _author_xform(over: Sdf.PrimSpec, prim: Usd.Prim, world: FloatArray, first: int) -> None:
    """Write the world transforms of an Xform as an operation before its others."""
    xform = UsdGeom.Xformable(prim)
    operations = [str(op) for op in xform.GetXformOpOrderAttr().Get() or ()]
    start = int(xform.GetResetXformStack())
    parent = np.eye(4)
    if not start:
        parent = column_matrix(rest_transforms(prim).GetParentToWorldTransform(prim))
    order = [*operations[:start], TRANSFORM, *operations[start:]]
    author_uniform(over, "xformOpOrder", Sdf.ValueTypeNames.TokenArray, order)
    local = (np.linalg.inv(parent) @ world @ parent).transpose(0, 2, 1)
    matrices = map(Gf.Matrix4d, local.tolist())
    author_series(over, TRANSFORM, Sdf.ValueTypeNames.Matrix4d, matrices, first=first)


DRIVING_PATHS = (head_path, controls_path)
"""Of layers of joints, Xforms and attributes, the stronger first: both may have the same joints."""

_OF_JOINTS = ("translations", "rotations", "scales")


def opened_driving_layer(
    performance: PerformanceReader, beside: Callable[[Path], Path]
) -> tuple[Sdf.PrimSpec, Sdf.LayerOffset] | None:
    """Return the rig's prim in the strongest layer of a kind, and how the layer's times are moved.

    `beside`: from a performance to the layer, such as `head_path`; a layer above the performance,
    such as a shot, has another name, and may reference it at another path.
    """
    ending = beside(Path("x.usda")).name.removeprefix("x")
    rig = performance.stage.GetPrimAtPath(rig_path_of(performance.stage, performance.animation))
    stack = rig.GetPrimStackWithLayerOffsets() if rig else ()
    return next((each for each in stack if each[0].layer.realPath.endswith(ending)), None)


def copy_driving_layer(layer: Sdf.Layer, source: Sdf.PrimSpec, rig_path: str) -> None:
    """Copy a driving layer into a new one, with the rig's prim at another path."""
    layer.TransferContent(source.layer)
    layer.rootPrims.clear()
    Sdf.CreatePrimInLayer(layer, rig_path)
    Sdf.CopySpec(source.layer, source.path, layer, rig_path)
    layer.defaultPrim = top_path(rig_path).name


def head_layer_xforms(performance: PerformanceReader) -> tuple[str, ...]:
    """Return the paths of the Xforms in a performance's head layer."""
    properties = map(Sdf.Path, _driven(performance, head_path))
    return tuple(str(each.GetPrimPath()) for each in properties if each.name == TRANSFORM)


def driving_layers(
    parts: Sequence[PerformanceReader], beside: Callable[[Path], Path]
) -> list[Sdf.PrimSpec]:
    """Return the rig's prim in the driving layers of the parts of a performance.

    They must drive the same, since samples of joints are arrays in the order of the header's names.

    `beside`: from a performance to the layer, such as `head_path`.
    """
    opened = [opened_driving_layer(each, beside) for each in parts]
    driven = [_driven(each, beside) for each in parts]
    for part, names in zip(parts, driven, strict=True):
        if names != driven[0]:
            raise InputError(
                f"{part.path}: drives {first_few(names) or 'nothing'} where {parts[0].path} drives "
                f"{first_few(driven[0]) or 'nothing'}; make it again with the same options"
            )
    return [each[0] for each in opened if each is not None and driven[0]]


def join_driving_layers(
    path: Path,
    sources: Sequence[Sdf.PrimSpec],
    header: WeightsHeader,
    *,
    provenance: Provenance | None = None,
) -> None:
    """Join driving layers of parts of a performance, in the order of their frames."""
    if not sources:
        return
    with new_layer(path, provenance) as layer:
        copy_driving_layer(layer, sources[0], header.rig_path)
        layer.endTimeCode = header.last_frame
        for source in sources[1:]:
            other = source.layer
            for place in sampled_properties(other):
                joined = place.ReplacePrefix(source.path, header.rig_path)
                for time in other.ListTimeSamplesForPath(place):
                    layer.SetTimeSample(joined, time, other.QueryTimeSample(place, time))


def _driven(performance: PerformanceReader, beside: Callable[[Path], Path]) -> list[str]:
    """Return the names of joints and the paths of attributes that a layer of a kind drives."""
    found, driven = opened_driving_layer(performance, beside), list[str]()
    if found is None:
        return driven
    layer, rig_path = found[0].layer, rig_path_of(performance.stage, performance.animation)
    for path in paths_in(layer):
        if path.IsPropertyPath() and path.name == "joints":
            driven += map(str, layer.GetAttributeAtPath(path).default or ())
        elif path.IsPropertyPath() and path.name not in _OF_JOINTS:
            if layer.GetNumTimeSamplesForPath(path):
                driven.append(str(path.ReplacePrefix(found[0].path, rig_path)))
    return driven
