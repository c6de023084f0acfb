"""Which frames of a take become shapes, and what the shapes are called."""

import csv
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from usdface.core.arrays import BoolArray, FloatArray
from usdface.core.errors import InputError
from usdface.core.text import first_few
from usdface.numerics.regression.reference_design import most_different_rows
from usdface.specs.surface import MakeShapesSpec
from usdface.usdio.references.tuning import read_pair_notes
from usdface.usdio.take.read import TakeReader

_LARGEST_CSV_BYTES = 1 << 20

_USABLE_SHARE = 0.9
"""Share of visible markers [0-1] below which a frame is not chosen."""

CANDIDATE_FRAMES = 4000
"""Frames spread over a take among which the most different are found."""


@dataclass(frozen=True)
class ShapeFrame:
    """A frame, and the name of its shape."""

    frame: int
    name: str


def given_frames(spec: MakeShapesSpec, take: TakeReader) -> tuple[ShapeFrame, ...]:
    """Return the frames that the spec names, in its order; none where it leaves the choice.

    Raises
    ------
    InputError
        If a frame is outside the take or named twice, or a file cannot be used.
    """
    if spec.names is not None:
        chosen = _from_csv(spec.names)
    elif spec.references is not None:
        chosen = _from_references(spec.references, take)
    else:
        chosen = tuple(_from_text(text) for text in spec.shape_frames)
    outside = [
        each.frame for each in chosen if not take.first_frame <= each.frame <= take.last_frame
    ]
    if outside:
        raise InputError(
            f"{take.path}: has no frame {first_few(outside)}; it holds "
            f"{take.first_frame}-{take.last_frame}"
        )
    seen: set[int] = set()
    for each in chosen:
        if each.frame in seen:
            raise InputError(f"frame {each.frame} is to become two shapes; give it once")
        seen.add(each.frame)
    return chosen


def choose_shape_frames(
    frames: list[int], displacements: FloatArray, usable: BoolArray, *, count: int
) -> tuple[ShapeFrame, ...]:
    """Choose the frames of a take that differ most from each other and from the neutral face.

    Parameters
    ----------
    displacements : (frames, markers, 3) float array
        From the neutral face [mm].
    usable : (frames, markers) bool array

    Raises
    ------
    InputError
        If the take shows fewer different faces than that.
    """
    allowed = np.flatnonzero(usable.mean(axis=1) >= _USABLE_SHARE)
    rows = allowed[most_different_rows(displacements[allowed].reshape(len(allowed), -1), count)]
    if len(rows) < count:
        raise InputError(
            f"the take shows only {len(rows)} faces that differ from the neutral one and from each "
            f"other, {count} are asked for; lower --count"
        )
    chosen = sorted(frames[row] for row in rows.tolist())
    return tuple(ShapeFrame(frame, f"frame_{frame}") for frame in chosen)


def _from_text(text: str) -> ShapeFrame:
    number, _, name = text.partition("=")
    return ShapeFrame(int(number), name.strip() or f"frame_{number}")


def _from_csv(path: Path) -> tuple[ShapeFrame, ...]:
    try:
        if path.stat().st_size > _LARGEST_CSV_BYTES:
            raise InputError(f"{path}: is too large for a list of frames and names")
        rows = list(csv.DictReader(path.read_text(encoding="utf-8-sig").splitlines()))
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise InputError(f"{path}: cannot be read as CSV: {error}; save it as UTF-8") from error
    if not rows or not {"frame", "name"} <= set(rows[0]):
        raise InputError(f"{path}: needs the columns frame and name, and a row for each shape")
    found = []
    for number, row in enumerate(rows, start=2):
        try:
            frame = int(str(row["frame"]).strip())
        except ValueError as error:
            raise InputError(
                f"{path} line {number}: frame {row['frame']!r} is no whole number"
            ) from error
        found.append(ShapeFrame(frame, str(row["name"] or "").strip() or f"frame_{frame}"))
    return tuple(found)


def _from_references(path: Path, take: TakeReader) -> tuple[ShapeFrame, ...]:
    pairs = [pair for pair in read_pair_notes(path) if pair.take == take.name]
    if not pairs:
        raise InputError(
            f"{path}: has no pair of the take {take.name!r}; select references from it first"
        )
    found = {}
    for pair in pairs:
        name = "_".join(part for part in (pair.emotion, pair.viseme) if part)
        found[pair.frame] = ShapeFrame(pair.frame, name or f"frame_{pair.frame}")
    return tuple(found[frame] for frame in sorted(found))
