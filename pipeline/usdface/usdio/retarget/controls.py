"""Control vectors in USD: a SkelAnimation's weights and joints, and attributes over time."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from pathlib import Path

import numpy as np
from pxr import Sdf, Usd, UsdSkel, Vt

from usdface.core.arrays import FloatArray
from usdface.core.controls import ControlClip, Controls, bare_controls
from usdface.core.errors import InputError
from usdface.numerics.motion.rotation_space import normalize_quaternions
from usdface.usdio.arrays import read_array_samples
from usdface.usdio.authoring import author_uniform
from usdface.usdio.performance.read import PerformanceReader
from usdface.usdio.performance.weights_layer import ANIMATION
from usdface.usdio.retarget.control_attributes import control_attribute
from usdface.usdio.wrong_types import refusing_wrong_types

NAMES = "face:controls:attributes"
"""On an animation: the attributes that are driven beside it, as ``PRIM.ATTRIBUTE``."""


@dataclass(frozen=True)
class ReadControls:
    """Controls as a file holds them."""

    clip: ControlClip
    rate: Fraction
    """Frames per second."""
    timecode_start: str
    """SMPTE timecode of the first frame, empty when unknown."""


@refusing_wrong_types
def read_control_clip(
    path: Path, *, attributes: Sequence[str] | None = None, frames: tuple[int, int] | None = None
) -> ReadControls:
    """Read everything that drives the one face in a USD file.

    Parameters
    ----------
    attributes : sequence of str, optional
        Those to read beside weights and joints; by default what the animation itself names.
    frames : tuple of int, optional
        First and last, inclusive; all that the animation has by default.

    Raises
    ------
    InputError
        If there is no such animation, an attribute is not there or no float, or frames are missing.
    """
    reader = PerformanceReader(path)
    prim, first, last = reader.animation, reader.first_frame, reader.last_frame
    if frames is not None:
        if frames[0] < first or frames[1] > last:
            raise InputError(
                f"{path}: frames {frames[0]}-{frames[1]} are not all there; it has {first}-{last}"
            )
        first, last = frames
    names = attribute_names(prim) if attributes is None else tuple(attributes)
    top = top_of(reader.stage, prim, path) if names else None
    controls = controls_at(prim, top, names, range(first, last + 1), path)
    if reader.edits:
        edited = reader.edited(first, last).astype(np.float64)
        controls = replace(controls, weights=edited)
    return ReadControls(ControlClip(controls, first), reader.rate, reader.timecode_start)


def attribute_names(animation: Usd.Prim) -> tuple[str, ...]:
    """Return the attributes that an animation says are driven beside it."""
    attribute = animation.GetAttribute(NAMES)
    return tuple(map(str, attribute.Get() or ())) if attribute else ()


def top_of(stage: Usd.Stage, animation: Usd.Prim, path: Path) -> Usd.Prim:
    """Return the prim from which attributes are named: where a performance puts its rig."""
    if animation.GetName().startswith(ANIMATION):
        return animation.GetParent()
    top = stage.GetDefaultPrim()
    if not top:
        raise InputError(f"{path}: has no default prim; set one, attributes are named from it")
    return top


def controls_at(
    animation: Usd.Prim,
    top: Usd.Prim | None,
    attributes: Sequence[str],
    times: Sequence[int],
    path: Path,
) -> Controls:
    """Read controls at time codes.

    Raises
    ------
    InputError
        If a value is missing, of another length than its names, or not finite.
    """
    skel = UsdSkel.Animation(animation)
    shapes = tuple(map(str, skel.GetBlendShapesAttr().Get() or ()))
    weights = read_array_samples(
        path, skel.GetBlendShapeWeightsAttr(), times, (len(shapes),), remedy="key it again"
    )
    controls = bare_controls(shapes, weights)
    joints = tuple(map(str, skel.GetJointsAttr().Get() or ()))
    translations = rotations = scales = None
    if joints:
        translations = read_array_samples(
            path, skel.GetTranslationsAttr(), times, (len(joints), 3), remedy="key it again"
        )
        # numpy sees a quaternion as it lies in memory: x, y, z, w
        rotations = read_array_samples(
            path, skel.GetRotationsAttr(), times, (len(joints), 4), remedy="key it again"
        )[..., [3, 0, 1, 2]]
        scales = read_array_samples(
            path, skel.GetScalesAttr(), times, (len(joints), 3), remedy="key it again"
        )
        try:
            rotations = normalize_quaternions(rotations)
        except ValueError as error:
            raise InputError(f"{path} <{animation.GetPath()}.rotations>: {error}") from error
    values = controls.values
    if attributes and top is not None:
        found = [control_attribute(top, name, path) for name in attributes]
        values = np.column_stack([_series(path, each, times) for each in found])
    return Controls(
        shapes=shapes,
        weights=weights,
        joints=joints,
        translations=controls.translations if translations is None else translations,
        rotations=controls.rotations if rotations is None else rotations,
        scales=controls.scales if scales is None else scales,
        attributes=tuple(attributes),
        values=values,
    )


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
    """Write joints over time, an attribute after the other."""
    write = layer.SetTimeSample
    places = [animation.AppendProperty(n) for n in ("translations", "rotations", "scales")]
    translations = np.ascontiguousarray(controls.translations, np.float32)
    in_memory_order = np.ascontiguousarray(controls.rotations[..., [1, 2, 3, 0]], np.float32)
    scales = np.ascontiguousarray(controls.scales, np.float16)
    for time, row in enumerate(translations, start=first):
        write(places[0], time, Vt.Vec3fArray.FromNumpy(row))
    for time, row in enumerate(in_memory_order, start=first):
        write(places[1], time, Vt.QuatfArray.FromNumpy(row))
    for time, row in enumerate(scales, start=first):
        write(places[2], time, Vt.Vec3hArray.FromNumpy(row))


def set_weight_samples(
    layer: Sdf.Layer, animation: Sdf.Path, weights: FloatArray, first: int
) -> None:
    """Write BlendShape weights over time."""
    place = animation.AppendProperty("blendShapeWeights")
    for time, row in enumerate(np.ascontiguousarray(weights, np.float32), start=first):
        layer.SetTimeSample(place, time, Vt.FloatArray.FromNumpy(row))


def _series(path: Path, attribute: Usd.Attribute, times: Sequence[int]) -> FloatArray:
    values = [attribute.Get(time) for time in times]
    for time, value in zip(times, values, strict=True):
        if value is None or not np.isfinite(value):
            raise InputError(
                f"{path} <{attribute.GetPath()}> time code {time}: is "
                f"{'without a value' if value is None else value}; key it"
            )
    return np.array(values, np.float64)
