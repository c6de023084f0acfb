"""What the tuning page needs of a references asset: each layer by itself, and what a pair shows."""

import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from usdface.core.arrays import FloatArray
from usdface.core.assets import References
from usdface.core.errors import InputError
from usdface.core.text import first_few
from usdface.usdio.layers import open_layer, read_provenance, refusing_wrong_types
from usdface.usdio.references.pair_layers import open_pair_stage
from usdface.usdio.references.read import FRAME_PATH, ROOT, TAKE, WEIGHTS_ATTRIBUTE, WEIGHTS_PATH


@dataclass(frozen=True)
class PairNotes:
    """What names a pair beside its markers and weights; empty where nothing is known."""

    frame: int = 0
    take: str = ""
    """`frame`, `take`: Frame number, and the name of its take."""
    viseme: str = ""
    emotion: str = ""
    """`viseme`, `emotion`: What is seen there."""
    image: Path | None = None
    """The pair's picture, where the asset names one."""


@refusing_wrong_types
def read_proposals(proposed_path: Path, references: References) -> FloatArray:
    """Return the proposed weights alone, in the order of a references asset's shapes.

    Parameters
    ----------
    references : References
        The asset the layer belongs to.

    Returns
    -------
    (pairs, shapes) float array

    Raises
    ------
    InputError
        If the layer does not belong to the asset.
    """
    layer = open_layer(proposed_path)
    prim = layer.GetPrimAtPath(WEIGHTS_PATH)
    names = (
        [str(name) for name in prim.attributes["blendShapes"].default or ()]
        if prim is not None and "blendShapes" in prim.attributes
        else []
    )
    _check_shapes(proposed_path, names, references)
    order = [names.index(name) for name in references.shape_names]
    rows = np.zeros((len(references.frames), len(names)))
    for pair in range(len(rows)):
        weights = layer.QueryTimeSample(WEIGHTS_ATTRIBUTE, pair + 1)
        if weights is None or len(weights) != len(names):
            raise InputError(
                f"{proposed_path} <{WEIGHTS_ATTRIBUTE}> time code {pair + 1}: "
                f"{0 if weights is None else len(weights)} weights for {len(names)} shapes; "
                "select again"
            )
        rows[pair] = weights
    return rows[:, order]


@refusing_wrong_types
def check_tuned_layer(tuned_path: Path, references: References) -> None:
    """Refuse a tuned layer that belongs to another selection or another rig.

    Raises
    ------
    InputError
        Naming the first pair that differs. Nothing is changed.
    """
    if not tuned_path.is_file():
        return
    layer = open_layer(tuned_path)
    prim = layer.GetPrimAtPath(WEIGHTS_PATH)
    if prim is None or "blendShapes" not in prim.attributes:
        return
    names = [str(name) for name in prim.attributes["blendShapes"].default or ()]
    _check_shapes(tuned_path, names, references)
    times = layer.ListTimeSamplesForPath(WEIGHTS_ATTRIBUTE)
    count = len(references.frames)
    if [round(time) for time in times] != list(range(1, count + 1)):
        raise InputError(
            f"{tuned_path}: holds {len(times)} pairs and the references {count}: it belongs to "
            "another selection. Nothing was changed; put back the layer that belongs here, or "
            "move this one away and bring its weights in with `usdface references import`"
        )
    for pair in range(count):
        frame, take = (
            layer.QueryTimeSample(FRAME_PATH, pair + 1),
            layer.QueryTimeSample(TAKE, pair + 1),
        )
        if frame is None and take is None:
            continue  # keyed in a DCC, which knows nothing of our flags
        expected = (int(references.frames[pair]), references.takes[pair])
        if (frame, str(take)) != expected:
            raise InputError(
                f"{tuned_path}: pair {pair + 1} was tuned for frame {frame} of {take}, and the "
                f"references have frame {expected[0]} of {expected[1]} there: it belongs to "
                "another selection. Nothing was changed; put back the layer that belongs here, or "
                "move this one away and bring its weights in with `usdface references import`"
            )


@refusing_wrong_types
def read_pair_notes(path: Path) -> list[PairNotes]:
    """Return what a references asset says of each pair but its markers and weights, in order.

    Raises
    ------
    InputError
        If the file is no references asset.
    """
    stage = open_pair_stage(
        path, ROOT, api="FaceReferencesAPI", kind="references", command="usdface select"
    )
    root = stage.GetPrimAtPath(ROOT)
    frames = root.GetAttribute(FRAME_PATH.name)

    def text(name: str, time: float) -> str:
        attribute = root.GetAttribute(f"face:reference:{name}")
        return str(attribute.Get(time) or "") if attribute else ""

    notes = []
    for time in frames.GetTimeSamples():
        image = root.GetAttribute("face:reference:image")
        resolved = str(getattr(image.Get(time) if image else None, "resolvedPath", "") or "")
        notes.append(
            PairNotes(
                frame=int(frames.Get(time)),
                take=text("take", time),
                viseme=text("viseme", time),
                emotion=text("emotion", time),
                image=Path(resolved) if resolved else None,
            )
        )
    return notes


def take_files(path: Path) -> tuple[Path, ...]:
    """Return the takes that a references asset was selected from, as it remembers them."""
    made = read_provenance(path)
    try:
        spec = json.loads(made.spec) if made is not None and made.spec else {}
    except (ValueError, RecursionError):
        spec = {}
    takes = spec.get("takes", ()) if isinstance(spec, dict) else ()
    return tuple(path.parent / str(take) for take in takes)


def _check_shapes(path: Path, names: list[str], references: References) -> None:
    missing = [name for name in references.shape_names if name not in names]
    if missing or len(names) != len(references.shape_names):
        raise InputError(
            f"{path}: holds {len(names)} shapes and the references {len(references.shape_names)}"
            + (f", without {first_few(missing)}" if missing else "")
            + ": it belongs to another rig. Nothing was changed; put back the layer that belongs "
            "here, or select again"
        )
