"""Edits that change something, and still what they were made for."""

import numpy as np
from pxr import Usd, UsdSkel

from usdface.core.errors import InputError
from usdface.usdio.checks.fault import Fault, is_solved, read_samples, some
from usdface.usdio.performance.edits import PREFIXES, read_edits

_CHANGED = 0.1
"""Change of the solve beneath an edit that an animator should look at."""


def check_edits(prim: Usd.Prim) -> list[Fault]:
    """Look at the edits of one animation; without edits there is nothing to find."""
    path = str(prim.GetPath())
    if not any(name.startswith(PREFIXES) for name in prim.GetAuthoredPropertyNames()):
        return []
    names = list(map(str, UsdSkel.Animation(prim).GetBlendShapesAttr().Get() or []))
    samples = read_samples(prim)
    frames = np.zeros(1) if samples is None else np.round(samples.times)
    try:
        edits = read_edits(prim, frames.astype(np.int64))
    except InputError as error:
        return [Fault("error", path, str(error))]
    found = []
    unknown = sorted(set(edits) - set(names))
    if unknown:
        message = (
            f"edits of {some(unknown)} find no such shape and change nothing; rename them, or "
            "clear them"
        )
        found.append(Fault("warning", path, message))
    if not is_solved(prim):
        message = "edits of an animation that is no solve: only usdface composes them; bake them"
        found.append(Fault("warning", path, message))
    for shape, edit in sorted(edits.items()):
        if samples is None or shape not in names:
            continue
        moved = np.abs(samples.values[:, names.index(shape)] - edit.beneath)
        moved = np.where(np.isfinite(moved) & edit.curve.active, moved, 0.0)
        row = int(moved.argmax())
        if moved[row] > _CHANGED:
            found.append(
                Fault(
                    "warning",
                    path,
                    f"time code {samples.times[row]:g}: the solve beneath the edit of {shape} has "
                    f"changed by {moved[row]:.2f} since it was made; look at the edit again",
                )
            )
    return found
