"""Source weights from a take or a performance, brought to the shapes that somebody asks for."""

from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path

import numpy as np

from usdface.core.arrays import FloatArray, columns_by_name, index_of
from usdface.core.errors import InputError
from usdface.core.text import first_few, pluralize
from usdface.model.retarget.shape_names import match_names
from usdface.usdio.performance.read import PerformanceReader
from usdface.usdio.take.read import TakeReader, is_take

MOVING_WEIGHT = 0.02
"""Weight beyond which a shape counts as used by a performance."""


@dataclass(frozen=True)
class SourceMotion:
    """Source weights over consecutive frames."""

    names: tuple[str, ...]
    weights: FloatArray
    """(frames, shapes)"""
    first_frame: int
    rate: Fraction
    timecode_start: str = ""
    """SMPTE timecode of the first frame, empty when unknown."""
    emotion: str = ""
    """Of the take, empty when unknown."""

    @property
    def last_frame(self) -> int:
        """Frame number of the last row."""
        return self.first_frame + len(self.weights) - 1


def read_source_motion(path: Path, frames: tuple[int, int] | None = None) -> SourceMotion:
    """Read the weights that a take carries, or those of a performance, edits included.

    Raises
    ------
    InputError
        If there are none, or the frames are not all there.
    """
    if is_take(path):
        return _from_take(TakeReader(path), frames)
    reader = PerformanceReader(path)
    first, last = _limits(path, frames, reader.first_frame, reader.last_frame)
    return SourceMotion(
        names=reader.names,
        weights=reader.edited(first, last).astype(np.float64),
        first_frame=first,
        rate=reader.rate,
        timecode_start=reader.timecode_at(first),
    )


def source_columns(
    path: Path, motion: SourceMotion, wanted: tuple[str, ...]
) -> tuple[FloatArray, tuple[str, ...]]:
    """Return a motion's weights in the order of other names, and what to tell of that.

    Names that are the same go first; the rest is matched by what they mean, so that Live Link's
    ``EyeBlinkLeft`` drives a rig's ``eyeBlink_L``.

    Raises
    ------
    InputError
        If no name matches.
    """
    place, column = index_of(wanted), index_of(motion.names)
    out = columns_by_name(motion.weights, motion.names, wanted)
    same = [name for name in motion.names if name in place]
    meant = match_names(
        [name for name in motion.names if name not in place],
        [name for name in wanted if name not in column],
    )
    for match in meant:
        for name, share in match.target:
            out[:, place[name]] += share * motion.weights[:, column[match.source[0][0]]]
    if not same and not meant:
        raise InputError(
            f"{path}: none of its {len(motion.names)} shapes ({first_few(motion.names, most=3)}) "
            f"is one of {first_few(wanted, most=3)}; are they of another character?"
        )
    matched = {*same, *(match.source[0][0] for match in meant)}
    moving = [
        name
        for name in motion.names
        if name not in matched and np.abs(motion.weights[:, column[name]]).max() > MOVING_WEIGHT
    ]
    notes = []
    if meant:
        example = meant[0]
        notes.append(
            f"matched by the meaning of their names: {pluralize(len(meant), 'shape')}, such as "
            f"{example.name} "
            f"to {example.target[0][0]}"
        )
    if moving:
        notes.append(
            f"{path.name}: no counterpart for {pluralize(len(moving), 'moving shape')}: "
            f"{first_few(moving)}"
        )
    return out, tuple(notes)


def _from_take(reader: TakeReader, frames: tuple[int, int] | None) -> SourceMotion:
    first, last = _limits(reader.path, frames, reader.first_frame, reader.last_frame)
    take = reader.read(first, last)
    if take.source is None:
        raise InputError(
            f"{reader.path}: the take carries no blendshape weights; retarget the performance that "
            "`usdface map` made of it"
        )
    return SourceMotion(
        names=take.source.names,
        weights=take.source.values.astype(np.float64),
        first_frame=first,
        rate=take.rate,
        timecode_start=take.timecode_start,
        emotion=take.emotion,
    )


def _limits(path: Path, frames: tuple[int, int] | None, first: int, last: int) -> tuple[int, int]:
    if frames is None:
        return first, last
    if frames[0] < first or frames[1] > last:
        raise InputError(
            f"{path}: frames {frames[0]}-{frames[1]} are not all there; it has {first}-{last}"
        )
    return frames
