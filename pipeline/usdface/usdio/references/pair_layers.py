"""Headers of layers of pairs, which have pair *i* at time code *i*, for scrubbing in a DCC."""

from fractions import Fraction
from pathlib import Path

from pxr import Sdf, Usd

from usdface.core.errors import InputError
from usdface.usdio.authoring import author_timing
from usdface.usdio.layers import open_stage
from usdface.usdio.units import author_units

PAIRS_PER_SECOND = 24
"""Playback speed of viewers."""


def author_pair_header(layer: Sdf.Layer, root: Sdf.Path, count: int) -> None:
    """Set units, default prim and the range of the pairs: 1 to `count`."""
    author_units(layer)
    author_timing(layer, rate=Fraction(PAIRS_PER_SECOND), first=1, last=max(count, 1))
    layer.defaultPrim = root.name


def open_pair_stage(path: Path, root: Sdf.Path, *, api: str, kind: str, command: str) -> Usd.Stage:
    """Open the stage of an asset of pairs.

    Parameters
    ----------
    root : Sdf.Path
        Prim of the pairs.
    api : str
        Its API schema.
    kind, command : str
        Name of the asset and the command that makes one, for messages.
    """
    stage = open_stage(path)
    prim = stage.GetPrimAtPath(root)
    if not prim or not prim.HasAPI(api):
        whole = path.with_name(f"{Path(path.stem).stem}.usda")
        if prim and whole != path and whole.is_file():
            raise InputError(
                f"{path}: only a layer of a {kind} asset; give the asset itself: {whole}"
            )
        raise InputError(
            f"{path}: not a {kind} asset: no <{root}> with {api}; make one with `{command}`"
        )
    return stage
