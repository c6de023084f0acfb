"""Steps over many frames as tasks over few, and the step that joins what they make."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from usdface.core.errors import InputError
from usdface.core.sidecars import parts_folder
from usdface.specs.base import Spec
from usdface.specs.paths import frame_range
from usdface.specs.performance import JoinSpec, MapSpec
from usdface.specs.review import MovieJoinSpec, MovieSpec

FrameRange = tuple[int, int]
"""First and last frame, inclusive."""


CHUNK_LIMIT = 10_000
"""Of one step; a season of takes has fewer, and a frame number that slipped would have millions."""


@dataclass(frozen=True)
class ChunkSizes:
    """How many frames one task works on, and what becomes of its parts."""

    map: int
    movie: int | None = None
    """None leaves a movie in one piece."""
    clips: Literal["auto", "always", "never"] = "auto"
    """Whether the parts of a performance stay where they are, as value clips."""


def frames_made(step: Spec, frames_of: Callable[[Path], FrameRange | None]) -> FrameRange | None:
    """Return the frames that a step will have worked on; None where only the worker will know."""
    if isinstance(step, MapSpec):
        return frame_range(step.frames) or frames_of(step.take)
    if isinstance(step, MovieSpec):
        return frame_range(step.frames) or frames_of(step.performance)
    return None


def in_chunks(step: Spec, sizes: ChunkSizes, frames: FrameRange | None) -> list[Spec]:
    """Return the tasks that do what a step does: the step itself, or its chunks and their join.

    Boundaries depend on the frames and the size alone, so that a task that is retried, or a job
    that is submitted again, makes the same files.

    Parameters
    ----------
    frames : (first, last), optional
        None where they are not known yet: then the step stays whole.
    """
    if frames is None:
        return [step]
    if isinstance(step, MapSpec):
        chunks = _chunks(frames, sizes.map)
        if len(chunks) == 1:
            return [step]
        names = _part_names(step.out, len(chunks))
        parts = [
            step.model_copy(update={"frames": text, "out": name, "chunk": None})
            for text, name in zip(chunks, names, strict=True)
        ]
        clips = sizes.clips if step.chunk is None else "always"
        return [*parts, JoinSpec(parts=names, out=step.out, clips=clips)]
    if isinstance(step, MovieSpec) and sizes.movie is not None:
        chunks = _chunks(frames, sizes.movie)
        if len(chunks) == 1:
            return [step]
        names = _part_names(step.out, len(chunks))
        shown = [
            step.model_copy(update={"frames": text, "out": name, "sound": False})
            for text, name in zip(chunks, names, strict=True)
        ]
        take = step.take if step.sound else None
        return [*shown, MovieJoinSpec(parts=names, take=take, out=step.out)]
    return [step]


def _chunks(frames: FrameRange, size: int) -> list[str]:
    first, last = frames
    count = -(-(last - first + 1) // size)
    if count > CHUNK_LIMIT:
        raise InputError(
            f"frames {first}-{last} are {count} chunks of {size}, more than {CHUNK_LIMIT}: no farm "
            "takes so many tasks; correct the frames, or make the chunks larger"
        )
    return [f"{start}-{min(start + size - 1, last)}" for start in range(first, last + 1, size)]


def _part_names(out: Path, count: int) -> tuple[Path, ...]:
    digits = max(4, len(str(count)))
    folder = parts_folder(out)
    return tuple(
        folder / f"{out.stem}.{number:0{digits}}{out.suffix}" for number in range(1, count + 1)
    )
