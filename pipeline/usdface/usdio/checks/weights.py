"""One finite weight per shape in every sample."""

import numpy as np
from pxr import Usd, UsdSkel

from usdface.usdio.checks.fault import Fault
from usdface.usdio.checks.parts import changed_part

LARGEST_WEIGHT = 10.0
"""Weights may pass 1, but none that an animator means is this far beyond."""


def check_weights(prim: Usd.Prim) -> list[Fault]:
    """Look at the count and the values of every sample."""
    animation = UsdSkel.Animation(prim)
    names = list(map(str, animation.GetBlendShapesAttr().Get() or []))
    attribute = animation.GetBlendShapeWeightsAttr()
    path = str(attribute.GetPath())
    authored = bool(attribute) and attribute.HasAuthoredValue()
    if names and not authored:
        return [
            Fault(
                "error",
                path,
                f"{len(names)} shapes are named and there is no weight; map again, or take the "
                "names out",
            )
        ]
    if authored and not names:
        message = "weights without blendShapes, so nobody knows whose they are; name the shapes"
        return [Fault("error", path, message)]
    if not authored:
        return []
    query = Usd.AttributeQuery(attribute)
    for time in attribute.GetTimeSamples():
        fault = _fault(names, np.asarray(query.Get(time)))
        if fault:
            return [Fault("error", path, f"time code {time:g}: {fault}")]
    held = attribute.Get(Usd.TimeCode.Default())
    fault = "" if held is None else _fault(names, np.asarray(held))
    if fault:
        return [Fault("error", path, f"its default: {fault}")]
    changed = changed_part(prim)
    return [Fault("error", path, changed)] if changed else []


def _fault(names: list[str], weights: np.ndarray) -> str:
    if not weights.ndim or len(weights) != len(names):
        count = len(weights) if weights.ndim else 0
        return f"{count} weights for {len(names)} shapes; write one per shape"
    if not np.isfinite(weights).all():
        return f"{names[int(np.argmin(np.isfinite(weights)))]} is not finite; map again"
    if len(weights) and np.abs(weights).max() > LARGEST_WEIGHT:
        worst = int(np.abs(weights).argmax())
        return (
            f"{names[worst]} is {weights[worst]:g}; weights are about 0 to 1: were they written "
            "as percent?"
        )
    return ""
