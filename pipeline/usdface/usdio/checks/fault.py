"""Results of checks, and the samples that several checks use."""

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
from pxr import Usd, UsdSkel

from usdface.core.arrays import Float32Array, FloatArray
from usdface.core.errors import InputError
from usdface.usdio.authoring import names_in, read_array_samples


@dataclass(frozen=True)
class Fault:
    """A fault of a prim or property; an error stops a publish."""

    severity: Literal["error", "warning"]
    path: str
    """The prim or property."""
    message: str
    """The fault, its time and its remedy."""

    @classmethod
    def error(cls, path: object, message: str) -> "Fault":
        """Return an error at a path."""
        return cls("error", str(path), message)

    @classmethod
    def warning(cls, path: object, message: str) -> "Fault":
        """Return a warning at a path."""
        return cls("warning", str(path), message)


@dataclass(frozen=True)
class Samples:
    """All samples of an animation's weights."""

    path: str
    """Of the attribute."""
    names: tuple[str, ...]
    times: FloatArray
    """(samples,)"""
    values: Float32Array
    """(samples, shapes)"""
    rate: float
    """Time codes per second."""

    def warning(self, message: str) -> Fault:
        """Return a warning at the attribute."""
        return Fault.warning(self.path, message)


def read_samples(prim: Usd.Prim) -> Samples | None:
    """Return an animation's samples; None without any, or if they do not match the names."""
    animation = UsdSkel.Animation(prim)
    names = names_in(animation.GetBlendShapesAttr())
    attribute = animation.GetBlendShapeWeightsAttr()
    times = attribute.GetTimeSamples() if attribute else []
    if not len(times) or not names:
        return None
    stage = prim.GetStage()
    file = Path(stage.GetRootLayer().realPath)
    try:
        values = read_array_samples(file, attribute, times, names, kind=np.float32, remedy="")
    except InputError:  # a fault of `check_weights`
        return None
    rate = float(stage.GetTimeCodesPerSecond())
    return Samples(str(attribute.GetPath()), names, np.array(times), values, rate)


def is_recorded(prim: Usd.Prim) -> bool:
    """Whether an animation is recorded data of a take, sequence or pairs, which drives no rig."""
    parent = prim.GetParent()
    if not parent:
        return False
    of_pairs = parent.HasAPI("FaceReferencesAPI") and prim.GetName() == "Source"
    return of_pairs or any(map(parent.HasAPI, ("FaceTakeAPI", "FaceSequenceAPI")))


def is_solved(prim: Usd.Prim) -> bool:
    """Whether an animation is a solve over time, not references, pairs or a pose."""
    return bool(prim.HasAPI("FaceSolveAPI"))
