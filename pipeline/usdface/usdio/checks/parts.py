"""Parts that are played as value clips: all as they were when they were joined."""

from pathlib import Path

from pxr import Sdf, Usd

from usdface.usdio.performance.clips import CLIP_SET
from usdface.usdio.performance.weights_layer import WEIGHTS


def changed_part(prim: Usd.Prim) -> str:
    """Return what is wrong where a part was mapped again since; empty where none was.

    The frames at the seams lie in a layer of their own as well, so they tell.
    """
    clips = Usd.ClipsAPI(prim)
    assets = [str(each.resolvedPath) for each in clips.GetClipAssetPaths(CLIP_SET) or ()]
    layers = [Sdf.Layer.FindOrOpen(each) if each else None for each in assets]
    if not layers or layers[0] is None:
        return ""
    path = Sdf.Path(clips.GetClipPrimPath(CLIP_SET)).AppendProperty(WEIGHTS)
    for time in layers[0].ListTimeSamplesForPath(path):
        wanted = layers[0].QueryTimeSample(path, time)
        held = [(each, each.QueryTimeSample(path, time)) for each in layers[1:] if each]
        there = [(each, value) for each, value in held if value is not None]
        if any(value != wanted for _, value in there):
            name = Path(there[0][0].realPath).name
            return (
                f"time code {time:g}: {name} was mapped again since it was joined, and the other "
                "parts were not; join again"
            )
    return ""
