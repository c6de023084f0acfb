"""Keys of a hybrid's alpha: a time-sampled float ``face:mapping:alpha`` on any prim of a layer."""

from pathlib import Path

from usdface.core.errors import InputError
from usdface.usdio.layers import open_stage
from usdface.usdio.wrong_types import refusing_wrong_types

ATTRIBUTE = "face:mapping:alpha"


@refusing_wrong_types
def read_alpha_keys(path: Path) -> list[tuple[float, float]]:
    """Return (time code, alpha) for every key; one key for a value that does not change.

    Raises
    ------
    InputError
        If no prim has the attribute with a value, or several have.
    """
    stage = open_stage(path)
    found = [
        attribute
        for prim in stage.TraverseAll()
        if (attribute := prim.GetAttribute(ATTRIBUTE)) and attribute.HasAuthoredValue()
    ]
    if len(found) != 1:
        raise InputError(f"{path}: {len(found)} prims have a value of {ATTRIBUTE}; key it on one")
    times = found[0].GetTimeSamples()
    if not times:
        return [(0.0, float(found[0].Get()))]
    return [(float(time), float(found[0].Get(time))) for time in times]
