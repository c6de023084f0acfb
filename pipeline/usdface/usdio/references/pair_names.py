"""What the pairs of a references asset are called: their frames, takes, visemes and emotions."""

from dataclasses import dataclass
from pathlib import Path

from pxr import Usd

from usdface.core.errors import InputError
from usdface.usdio.layers import open_stage
from usdface.usdio.wrong_types import refusing_wrong_types


@dataclass(frozen=True)
class PairName:
    """One pair: which frame of which take, and what is seen there; empty where nobody said."""

    frame: int
    take: str
    viseme: str
    emotion: str


@refusing_wrong_types
def read_pair_names(path: Path) -> tuple[PairName, ...]:
    """Read the names of a references asset's pairs, in order.

    Raises
    ------
    InputError
        If the file is no references asset.
    """
    stage = open_stage(path)
    root = stage.GetDefaultPrim()
    if not root or not root.HasAPI("FaceReferencesAPI"):
        raise InputError(
            f"{path}: not a references asset: its default prim has no FaceReferencesAPI; make one "
            "with `usdface select`"
        )
    times = root.GetAttribute("face:reference:frame").GetTimeSamples()
    return tuple(
        PairName(
            frame=int(root.GetAttribute("face:reference:frame").Get(time)),
            take=_text(root, "take", time),
            viseme=_text(root, "viseme", time),
            emotion=_text(root, "emotion", time),
        )
        for time in times
    )


def _text(root: Usd.Prim, name: str, time: float) -> str:
    attribute = root.GetAttribute(f"face:reference:{name}")
    return str(attribute.Get(time) or "") if attribute else ""
