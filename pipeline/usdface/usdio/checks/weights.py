"""Checks of the numbers and values of weights, and of edits."""

from pathlib import Path

import numpy as np
from pxr import Sdf, Usd, UsdSkel

from usdface.core.errors import InputError
from usdface.core.text import first_few
from usdface.usdio.authoring import names_in
from usdface.usdio.checks.fault import Fault, is_solved, read_samples
from usdface.usdio.performance.clips import CLIP_SET
from usdface.usdio.performance.edits import PREFIXES, read_edits
from usdface.usdio.performance.weights_layer import WEIGHTS

LARGEST_WEIGHT = 10.0
"""Largest plausible weight."""

_CHANGED_WEIGHT = 0.1
"""Least change of the solve below an edit that is reported."""


def check_weights(prim: Usd.Prim) -> list[Fault]:
    """Check the number and the values of the weights in every sample."""
    animation = UsdSkel.Animation(prim)
    names = names_in(animation.GetBlendShapesAttr())
    attribute = animation.GetBlendShapeWeightsAttr()
    path = str(attribute.GetPath())
    if not (attribute and attribute.HasAuthoredValue()):
        message = (
            f"{len(names)} shapes are named and there is no weight; map again, or take the names "
            "out"
        )
        return [Fault.error(path, message)] if names else []
    if not names:
        message = "weights without blendShapes, so nobody knows whose they are; name the shapes"
        return [Fault.error(path, message)]
    query = Usd.AttributeQuery(attribute)
    for time in attribute.GetTimeSamples():
        fault = _fault(names, np.asarray(query.Get(time)))
        if fault:
            return [Fault.error(path, f"time code {time:g}: {fault}")]
    default = attribute.Get(Usd.TimeCode.Default())
    fault = "" if default is None else _fault(names, np.asarray(default))
    if fault:
        return [Fault.error(path, f"its default: {fault}")]
    changed = changed_part(prim)
    return [Fault.error(path, changed)] if changed else []


def _fault(names: tuple[str, ...], weights: np.ndarray) -> str:
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


def changed_part(prim: Usd.Prim) -> str:
    """Return the fault if a part was mapped again after `join`, else an empty string.

    Found by the frames at the seams, which a separate layer repeats.
    """
    clips = Usd.ClipsAPI(prim)
    assets = [str(each.resolvedPath) for each in clips.GetClipAssetPaths(CLIP_SET) or ()]
    layers = [Sdf.Layer.FindOrOpen(each) if each else None for each in assets]
    if not layers or layers[0] is None:
        return ""
    path = Sdf.Path(clips.GetClipPrimPath(CLIP_SET)).AppendProperty(WEIGHTS)
    for time in layers[0].ListTimeSamplesForPath(path):
        joined = layers[0].QueryTimeSample(path, time)
        values = [(part, part.QueryTimeSample(path, time)) for part in layers[1:] if part]
        values = [(part, value) for part, value in values if value is not None]
        if any(value != joined for _, value in values):
            name = Path(values[0][0].realPath).name
            return (
                f"time code {time:g}: {name} was mapped again since it was joined, and the other "
                "parts were not; join again"
            )
    return ""


def check_edits(prim: Usd.Prim) -> list[Fault]:
    """Check the edits of one animation."""
    path = str(prim.GetPath())
    if not any(name.startswith(PREFIXES) for name in prim.GetAuthoredPropertyNames()):
        return []
    names = names_in(UsdSkel.Animation(prim).GetBlendShapesAttr())
    samples = read_samples(prim)
    frames = np.zeros(1) if samples is None else np.round(samples.times)
    try:
        edits = read_edits(prim, frames.astype(np.int64))
    except InputError as error:
        return [Fault.error(path, str(error))]
    found = []
    unknown = sorted(set(edits) - set(names))
    if unknown:
        message = (
            f"edits of {first_few(unknown)} find no such shape and change nothing; rename them, or "
            "clear them"
        )
        found.append(Fault.warning(path, message))
    if not is_solved(prim):
        message = "edits of an animation that is no solve: only usdface composes them; bake them"
        found.append(Fault.warning(path, message))
    for shape, edit in sorted(edits.items()):
        if samples is None or shape not in names:
            continue
        moved = np.abs(samples.values[:, names.index(shape)] - edit.solve_when_edited)
        moved = np.where(np.isfinite(moved) & edit.curve.active, moved, 0.0)
        row = int(moved.argmax())
        if moved[row] > _CHANGED_WEIGHT:
            found.append(
                Fault.warning(
                    path,
                    f"time code {samples.times[row]:g}: the solve below the edit of {shape} has "
                    f"changed by {moved[row]:.2f} since it was made; look at the edit again",
                )
            )
    return found
