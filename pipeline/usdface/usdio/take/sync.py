"""Say in a take how its video lies in time; everything else in the layer stays as it is."""

from dataclasses import dataclass
from pathlib import Path

from pxr import Sdf

from usdface.core.errors import InputError
from usdface.usdio.layers import new_layer, open_layer


@dataclass(frozen=True)
class VideoSync:
    """How a video lies in its take: ``take_time = offset + (1 + drift * 1e-6) * video_time``.

    Attributes
    ----------
    offset : float
        [s]
    drift : float
        [ppm]
    confidence : float
        [0-1]
    """

    offset: float
    drift: float
    confidence: float


def write_video_sync(path: Path, sync: VideoSync) -> None:
    """Write the video's place in time into the root layer of a take.

    The layer is copied, changed and put in the place of the old one at once: whoever reads sees
    the one or the other. Its other opinions, its sublayers and what it says of its making stay.

    Parameters
    ----------
    path : Path
    sync : VideoSync

    Raises
    ------
    InputError
        If the layer cannot be read or written, or names no default prim.
    """
    layer = open_layer(path)
    if not layer.defaultPrim:
        raise InputError(f"{path}: names no default prim, so it is no take; ingest the capture")
    root = Sdf.Path.absoluteRootPath.AppendPath(layer.defaultPrim)
    with new_layer(path) as changed:
        changed.TransferContent(layer)
        # A take made over another may say nothing of its root yet: then this is an over.
        prim = Sdf.CreatePrimInLayer(changed, root)
        for name, value in (
            ("face:video:offset", sync.offset),
            ("face:video:drift", sync.drift),
            ("face:sync:confidence", sync.confidence),
        ):
            attribute = prim.attributes.get(name)
            if attribute is None:
                kind = Sdf.ValueTypeNames.Double
                attribute = Sdf.AttributeSpec(prim, name, kind, Sdf.VariabilityUniform)
            attribute.default = float(value)
