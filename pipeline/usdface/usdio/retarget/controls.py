"""Control vectors in USD: a SkelAnimation's weights and joints, and attributes, by name."""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from fnmatch import fnmatchcase
from pathlib import Path

import numpy as np
from pxr import Gf, Sdf, Usd, UsdSkel, Vt

from usdface.core.arrays import FloatArray
from usdface.core.assets import Rig
from usdface.core.controls import ControlClip, Controls, shape_controls
from usdface.core.errors import InputError, as_input_error
from usdface.core.rates import frames_within
from usdface.core.text import first_few
from usdface.numerics.motion.rotation_space import normalize_quaternions
from usdface.usdio.authoring import (
    author_uniform,
    author_weights,
    define_prim,
    names_in,
    read_array_samples,
    top_path,
)
from usdface.usdio.layers import open_stage, refusing_wrong_types
from usdface.usdio.performance.read import PerformanceReader
from usdface.usdio.performance.weights_layer import ANIMATION
from usdface.usdio.rig.read import skeletons_of

FLOATS = (Sdf.ValueTypeNames.Float, Sdf.ValueTypeNames.Double, Sdf.ValueTypeNames.Half)


def find_control_attributes(rig: Rig, patterns: Sequence[str]) -> tuple[str, ...]:
    """Return the float attributes of a rig that match names or patterns.

    `patterns`: ``PRIM.ATTRIBUTE``, the prim's path relative to the rig's top prim; ``*`` and ``?``
    as in a shell.
    """
    stage = open_stage(rig.file)
    top = stage.GetPrimAtPath(top_path(rig.prim))
    return _match_attributes(top, patterns, rig.file)


def _match_attributes(top: Usd.Prim, patterns: Sequence[str], path: Path) -> tuple[str, ...]:
    """Return the float attributes below a prim that match names or patterns."""
    matches: list[str] = []
    for pattern in patterns:
        if any(letter in pattern for letter in "*?["):
            names = [name for name in _all_floats(top) if fnmatchcase(name, pattern)]
            if not names:
                raise InputError(
                    f"{path} <{top.GetPath()}>: no float attribute below it is like "
                    f"{pattern!r}; {_examples(top)}"
                )
            matches += names
        else:
            control_attribute(top, pattern, path)
            matches.append(pattern)
    return tuple(dict.fromkeys(matches))


def control_attribute(top: Usd.Prim, name: str, path: Path) -> Usd.Attribute:
    """Return the attribute of a control's name, relative to a character's top prim."""
    _, dot, attribute_name = name.rpartition(".")
    target = attribute_path(top.GetPath(), name) if dot else None
    if target is None:
        raise InputError(
            f"{path}: {name!r} names no attribute; write PRIM.ATTRIBUTE, the prim's path taken "
            f"from <{top.GetPath()}>"
        )
    attribute = top.GetStage().GetAttributeAtPath(target)
    if not attribute:
        prim = top.GetStage().GetPrimAtPath(target.GetPrimPath())
        what = (
            f"has no attribute {attribute_name!r}"
            if prim
            else f"is not there, so neither is its attribute {attribute_name!r}"
        )
        raise InputError(f"{path} <{target.GetPrimPath()}>: {what}; {_examples(top)}")
    if attribute.GetTypeName() not in FLOATS:
        raise InputError(
            f"{path} <{target}>: is {attribute.GetTypeName()}, and a control must be one float, "
            "double or half; name its parts if they are attributes of their own"
        )
    return attribute


def attribute_path(top: Sdf.Path, name: str) -> Sdf.Path | None:
    """Return a control's property path below a top prim; None if the name is invalid."""
    place, _, attribute = name.rpartition(".")
    if not Sdf.Path.IsValidNamespacedIdentifier(attribute):
        return None
    if place and (place.startswith("/") or not Sdf.Path.IsValidPathString(place)):
        return None
    prim = top.AppendPath(place) if place else top
    return prim.AppendProperty(attribute)


def _all_floats(top: Usd.Prim) -> list[str]:
    return [name for prim in Usd.PrimRange(top) for name, _ in _floats_of(prim, top)]


def _floats_of(prim: Usd.Prim, top: Usd.Prim) -> Iterator[tuple[str, Usd.Attribute]]:
    """Yield the float attributes of a prim, with their names relative to a top prim."""
    place = str(prim.GetPath().MakeRelativePath(top.GetPath()))
    for attribute in prim.GetAuthoredAttributes():
        if attribute.GetTypeName() in FLOATS:
            yield f"{'' if place == '.' else place}.{attribute.GetName()}", attribute


def _examples(top: Usd.Prim) -> str:
    names = _all_floats(top)
    if not names:
        return "it has no float attributes at all"
    return f"it has {first_few(names)}"


def rest_controls(rig: Rig, *, attributes: Sequence[str] = (), joints: bool = True) -> Controls:
    """Return one row of controls: weights 0, joints at rest, attributes of the rig.

    Parameters
    ----------
    attributes : sequence of str
        Names or patterns; see `find_control_attributes`.
    joints : bool
        Whether joints are controls; the joint of a skeleton with only one is not.
    """
    stage = open_stage(rig.file)
    names: tuple[str, ...] = ()
    rest: list[Gf.Matrix4d] = []
    skeletons = skeletons_of(stage.GetPrimAtPath(rig.prim))
    if joints and skeletons:
        skeleton = UsdSkel.Skeleton(skeletons[0])
        names = names_in(skeleton.GetJointsAttr())
        rest = list(skeleton.GetRestTransformsAttr().Get() or ())
    if len(names) < 2 or len(rest) != len(names):
        names, rest = (), []
    top = stage.GetPrimAtPath(top_path(rig.prim))
    attribute_names = _match_attributes(top, attributes, rig.file)
    values = [control_attribute(top, name, rig.file).Get() or 0.0 for name in attribute_names]
    parts = [decompose_joint(matrix) for matrix in rest]
    return Controls(
        shapes=rig.shapes,
        weights=np.zeros((1, len(rig.shapes))),
        joints=names,
        translations=np.array([part[0] for part in parts], float).reshape(1, -1, 3),
        rotations=np.array([part[1] for part in parts], float).reshape(1, -1, 4),
        scales=np.array([part[2] for part in parts], float).reshape(1, -1, 3),
        attributes=attribute_names,
        values=np.array(values, float).reshape(1, -1),
    )


def decompose_joint(matrix: Gf.Matrix4d) -> tuple[list[float], list[float], list[float]]:
    """Return translation, rotation (w first) and scale of a transform, as in UsdSkel."""
    translation, rotation, scale = UsdSkel.DecomposeTransform(matrix)
    quaternion = [rotation.GetReal(), *rotation.GetImaginary()]
    return list(translation), quaternion, [float(factor) for factor in scale]


NAMES = "face:controls:attributes"
"""Of an animation: the attributes that are driven with it, as ``PRIM.ATTRIBUTE``."""


@refusing_wrong_types
def read_control_clip(
    path: Path, *, attributes: Sequence[str] | None = None, frames: tuple[int, int] | None = None
) -> ControlClip:
    """Read the control vectors of the face in a USD file.

    Parameters
    ----------
    attributes : sequence of str, optional
        Names or patterns of attributes; by default those that the animation names, and all that
        are animated.
    frames : tuple of int, optional
        First and last, inclusive; by default all.
    """
    reader = PerformanceReader(path)
    prim = reader.animation
    # Names of attributes are relative to the rig of a performance.
    rig = prim.GetParent() if prim.GetName().startswith(ANIMATION) else None
    top = rig or reader.stage.GetDefaultPrim() or None
    first, last = frames_within(path, frames, reader.first_frame, reader.last_frame)
    if attributes is None:
        moving = () if top is None else moving_attributes(top)
        names = tuple(dict.fromkeys((*attribute_names(prim), *moving)))
    elif top is None and attributes:
        raise InputError(f"{path}: has no default prim; set one, attributes are named from it")
    else:
        names = () if top is None else _match_attributes(top, attributes, path)
    controls = controls_at(prim, top, names, range(first, last + 1), path)
    if reader.edits:
        edited = reader.edited(first, last).astype(np.float64)
        controls = replace(controls, weights=edited)
    return ControlClip(controls, first, reader.rate, reader.timecode_start)


def attribute_names(animation: Usd.Prim) -> tuple[str, ...]:
    """Return the attributes that an animation names."""
    return names_in(animation.GetAttribute(NAMES))


def moving_attributes(top: Usd.Prim) -> tuple[str, ...]:
    """Return the animated float attributes below a prim, such as those of deformers.

    Without those of animations: edits of weights, and figures of solves.
    """
    return tuple(
        name
        for prim in Usd.PrimRange(top)
        if not prim.IsA(UsdSkel.Animation)
        for name, attribute in _floats_of(prim, top)
        if attribute.ValueMightBeTimeVarying()
    )


def controls_at(
    animation: Usd.Prim,
    top: Usd.Prim | None,
    attributes: Sequence[str],
    times: Sequence[int],
    path: Path,
) -> Controls:
    """Read controls at time codes."""
    skel = UsdSkel.Animation(animation)

    def read(attribute: Usd.Attribute, names: tuple[str, ...], *size: int) -> FloatArray:
        return read_array_samples(path, attribute, times, names, size, remedy="key it again")

    shapes = names_in(skel.GetBlendShapesAttr())
    controls = shape_controls(shapes, read(skel.GetBlendShapeWeightsAttr(), shapes))
    joints = names_in(skel.GetJointsAttr())
    if joints:
        # Quaternions are x, y, z, w in memory.
        quaternions = read(skel.GetRotationsAttr(), joints, 4)[..., [3, 0, 1, 2]]
        with as_input_error(f"{path} <{animation.GetPath()}.rotations>"):
            rotations = normalize_quaternions(quaternions)
        controls = replace(
            controls,
            joints=joints,
            translations=read(skel.GetTranslationsAttr(), joints, 3),
            rotations=rotations,
            scales=read(skel.GetScalesAttr(), joints, 3),
        )
    if attributes and top is not None:
        driven = [control_attribute(top, name, path) for name in attributes]
        values = np.column_stack([_series(path, attribute, times) for attribute in driven])
        controls = replace(controls, attributes=tuple(attributes), values=values)
    return controls


def author_joints(prim: Sdf.PrimSpec, joints: tuple[str, ...]) -> None:
    """Declare an animation's joints; samples follow with `set_joint_samples`."""
    kinds = Sdf.ValueTypeNames
    author_uniform(prim, "joints", kinds.TokenArray, list(joints))
    Sdf.AttributeSpec(prim, "translations", kinds.Float3Array)
    Sdf.AttributeSpec(prim, "rotations", kinds.QuatfArray)
    Sdf.AttributeSpec(prim, "scales", kinds.Half3Array)


def set_joint_samples(
    layer: Sdf.Layer, animation: Sdf.Path, controls: Controls, first: int
) -> None:
    """Write the samples of joints, one attribute after the other."""
    in_memory_order = controls.rotations[..., [1, 2, 3, 0]]
    for name, kind, values in (
        ("translations", Vt.Vec3fArray, controls.translations.astype(np.float32)),
        ("rotations", Vt.QuatfArray, in_memory_order.astype(np.float32)),
        ("scales", Vt.Vec3hArray, controls.scales.astype(np.float16)),
    ):
        path = animation.AppendProperty(name)
        for time, row in enumerate(np.ascontiguousarray(values), start=first):
            layer.SetTimeSample(path, time, kind.FromNumpy(row))


def author_animation(layer: Sdf.Layer, place: Sdf.Path, controls: Controls) -> None:
    """Define an animation of weights and joints from time code 1 on."""
    prim = define_prim(layer, place, "SkelAnimation")
    author_weights(prim, controls.shapes, controls.weights)
    if controls.joints:
        author_joints(prim, controls.joints)
        set_joint_samples(layer, place, controls, 1)


def author_attribute_specs(
    layer: Sdf.Layer, top: Sdf.Path, rig: Rig, names: Sequence[str]
) -> list[Sdf.Path]:
    """Define attributes of a rig below a top prim; return their paths."""
    stage = open_stage(rig.file)
    of_rig = stage.GetPrimAtPath(top_path(rig.prim))
    places = []
    for attribute in [control_attribute(of_rig, name, rig.file) for name in names]:
        place = attribute.GetPath().ReplacePrefix(of_rig.GetPath(), top)
        over = Sdf.CreatePrimInLayer(layer, place.GetPrimPath())
        places.append(Sdf.AttributeSpec(over, place.name, attribute.GetTypeName()).path)
    return places


def set_attribute_samples(
    layer: Sdf.Layer, places: Sequence[Sdf.Path], controls: Controls, first: int
) -> None:
    """Write the samples of attributes, one after the other."""
    for place, values in zip(places, controls.values.T.tolist(), strict=True):
        for time, value in enumerate(values, start=first):
            layer.SetTimeSample(place, time, value)


def _series(path: Path, attribute: Usd.Attribute, times: Sequence[int]) -> FloatArray:
    values = [attribute.Get(time) for time in times]
    for time, value in zip(times, values, strict=True):
        if value is None or not np.isfinite(value):
            raise InputError(
                f"{path} <{attribute.GetPath()}> time code {time}: is "
                f"{'without a value' if value is None else value}; key it"
            )
    return np.array(values, np.float64)
