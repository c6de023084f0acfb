"""Float attributes of a character that are part of its control vector, found by name."""

from collections.abc import Sequence
from fnmatch import fnmatchcase
from pathlib import Path

import numpy as np
from pxr import Gf, Sdf, Usd, UsdSkel

from usdface.core.assets import Rig
from usdface.core.controls import Controls
from usdface.core.errors import InputError
from usdface.core.text import first_few
from usdface.usdio.layers import open_stage
from usdface.usdio.rig.read import skeletons_of

FLOATS = (Sdf.ValueTypeNames.Float, Sdf.ValueTypeNames.Double, Sdf.ValueTypeNames.Half)


def find_control_attributes(rig: Rig, patterns: Sequence[str]) -> tuple[str, ...]:
    """Return the float attributes of a rig that names or patterns mean, each once.

    Parameters
    ----------
    patterns : sequence of str
        ``PRIM.ATTRIBUTE``, the prim's path taken from the rig's top prim; ``*`` and ``?`` as in a
        shell.

    Raises
    ------
    InputError
        If a name means no attribute, or one that is not a single float.
    """
    stage = open_stage(rig.file)
    top = stage.GetPrimAtPath(Sdf.Path(rig.prim).GetPrefixes()[0])
    found: list[str] = []
    for pattern in patterns:
        if any(letter in pattern for letter in "*?["):
            names = [name for name in _all_floats(top) if fnmatchcase(name, pattern)]
            if not names:
                raise InputError(
                    f"{rig.file} <{top.GetPath()}>: no float attribute below it is like "
                    f"{pattern!r}; {_examples(top)}"
                )
            found += names
        else:
            control_attribute(top, pattern, rig.file)
            found.append(pattern)
    return tuple(dict.fromkeys(found))


def control_attribute(top: Usd.Prim, name: str, path: Path) -> Usd.Attribute:
    """Return the attribute that a control's name means below a character's top prim.

    Raises
    ------
    InputError
        If there is none, or it is not a single float.
    """
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
    """Return a control's property path below a top prim; None if the name cannot be one."""
    place, _, attribute = name.rpartition(".")
    if not Sdf.Path.IsValidNamespacedIdentifier(attribute):
        return None
    if place and (place.startswith("/") or not Sdf.Path.IsValidPathString(place)):
        return None
    prim = top.AppendPath(place) if place else top
    return prim.AppendProperty(attribute)


def _all_floats(top: Usd.Prim) -> list[str]:
    names = []
    for prim in Usd.PrimRange(top):
        place = str(prim.GetPath().MakeRelativePath(top.GetPath()))
        place = "" if place == "." else place
        names += [
            f"{place}.{attribute.GetName()}"
            for attribute in prim.GetAuthoredAttributes()
            if attribute.GetTypeName() in FLOATS
        ]
    return names


def _examples(top: Usd.Prim) -> str:
    names = _all_floats(top)
    if not names:
        return "it has no float attributes at all"
    return f"it has {first_few(names)}"


def rest_controls(rig: Rig, *, attributes: Sequence[str] = (), joints: bool = True) -> Controls:
    """Return one row of controls: weights 0, joints at rest, attributes as the rig has them.

    Parameters
    ----------
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
