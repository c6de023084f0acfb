"""Plan of a job on a farm: steps as parallel tasks, with long ones in chunks that are joined."""

from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from usdface.core.errors import InputError
from usdface.core.sidecars import parts_folder
from usdface.runner.origin import existing_take
from usdface.runner.state import frames_made
from usdface.specs.base import Spec
from usdface.specs.capture import TrackSpec
from usdface.specs.commands import SubmitSpec
from usdface.specs.job import JobSpec
from usdface.specs.paths import Reads
from usdface.specs.performance import JoinSpec, MapSpec
from usdface.specs.review import MovieJoinSpec, MovieSpec

FrameRange = tuple[int, int]
"""First and last frame, inclusive."""

CHUNK_LIMIT = 10_000
"""Largest number of chunks of a step; a wrong frame number would make millions."""


def in_chunks(
    step: Spec, spec: SubmitSpec, frames: FrameRange | None, *, take: Path | None = None
) -> list[Spec]:
    """Return the tasks of a step: the step itself, or its chunks by `spec` and their join.

    Boundaries depend on frames and size only, so that retries and repeated submissions make the
    same files.

    `frames`: None if unknown: then the step is not split. `take`: that of a movie's performance,
    whose sound the join encodes; without it, a movie with sound is not split.
    """
    size = None
    if isinstance(step, MapSpec):
        size = spec.chunk
    elif isinstance(step, MovieSpec):
        size = None if step.sound and take is None else spec.movie_chunk
    elif isinstance(step, TrackSpec) and not (step.part or step.parts or step.views):
        size = spec.track_chunk
    chunks = [] if frames is None or size is None else _chunks(frames, size)
    if len(chunks) < 2 or not isinstance(step, MapSpec | MovieSpec | TrackSpec):
        return [step]
    digits, out = max(4, len(str(len(chunks)))), step.out
    names = tuple(
        parts_folder(out) / f"{out.stem}.{number:0{digits}}{out.suffix}"
        for number in range(1, len(chunks) + 1)
    )
    parts = [{"frames": text, "out": name} for text, name in zip(chunks, names, strict=True)]
    if isinstance(step, MapSpec):
        clips = spec.clips if step.chunk is None else "always"
        mapped = [step.model_copy(update={**part, "chunk": None}) for part in parts]
        return [*mapped, JoinSpec(parts=names, out=step.out, clips=clips)]
    if isinstance(step, MovieSpec):
        shown = [step.model_copy(update={**part, "sound": False}) for part in parts]
        return [*shown, MovieJoinSpec(parts=names, take=take if step.sound else None, out=step.out)]
    seen = [step.part_spec(text, name) for text, name in zip(chunks, names, strict=True)]
    return [*seen, step.model_copy(update={"parts": names})]


def _chunks(frames: FrameRange, size: int) -> list[str]:
    first, last = frames
    count = -(-(last - first + 1) // size)
    if count > CHUNK_LIMIT:
        raise InputError(
            f"frames {first}-{last} are {count} chunks of {size}, more than {CHUNK_LIMIT}, too "
            "many for a farm; correct the frames, or make the chunks larger"
        )
    return [f"{start}-{min(start + size - 1, last)}" for start in range(first, last + 1, size)]


@dataclass(frozen=True)
class FarmStep:
    """Independent tasks of one kind."""

    name: str
    """Unique in the plan; letters, digits and hyphens only."""
    tasks: tuple[Spec, ...]
    """With absolute paths; each may run on another worker."""
    needs: tuple[str, ...]
    """Names of the farm steps it depends on."""

    @property
    def kind(self) -> type[Spec]:
        """Kind of all tasks, which states the cores and the memory of each."""
        return type(self.tasks[0])


@dataclass(frozen=True)
class Plan:
    """The farm steps of a job."""

    steps: tuple[FarmStep, ...]
    """In topological order."""
    whole: tuple[Path, ...] = ()
    """Performances that are not split, because the frames of their takes are unknown."""


def plan_job(
    job: JobSpec, spec: SubmitSpec, *, frames_of: Callable[[Path], FrameRange | None]
) -> Plan:
    """Return the farm steps of a job, split by `spec`.

    Tasks are grouped by step and by depth in the graph of dependencies, so that the same step of
    all takes is one farm step, whose tasks are independent.

    Parameters
    ----------
    job : JobSpec
        With absolute paths, one spelling for each file.
    frames_of : callable
        First and last frame of an existing take or performance; None if unknown.
    """
    tasks, whole = _tasks(job, spec, frames_of)
    before = _tasks_before(tasks)
    depth: list[int] = []
    for earlier in before:
        depth.append(1 + max((depth[index] for index in earlier), default=-1))
    names = _names(tasks, depth)
    members: dict[str, list[int]] = {}
    for index, name in enumerate(names):
        members.setdefault(name, []).append(index)
    ordered = sorted(members, key=lambda name: (depth[members[name][0]], members[name][0]))
    steps = []
    for name in ordered:
        needed = {names[earlier] for index in members[name] for earlier in before[index]}
        steps.append(
            FarmStep(
                name,
                tuple(tasks[index] for index in members[name]),
                tuple(each for each in ordered if each in needed),
            )
        )
    return Plan(tuple(steps), tuple(whole))


def _tasks(
    job: JobSpec, spec: SubmitSpec, frames_of: Callable[[Path], FrameRange | None]
) -> tuple[list[Spec], list[Path]]:
    made = {path for step in job.steps for path in step.changes()}
    ranges: dict[Path, FrameRange] = {}
    takes: dict[Path, Path] = {}

    def known_frames(path: Path) -> FrameRange | None:
        # Files that this job makes may get other frames than the existing ones.
        return ranges.get(path) if path in made else frames_of(path)

    def known_take(movie: MovieSpec) -> Path | None:
        if movie.take is not None:
            return movie.take
        if movie.performance in made or not movie.performance.is_file():
            return takes.get(movie.performance)
        return existing_take(movie.performance)

    tasks: list[Spec] = []
    whole: list[Path] = []
    for step in job.steps:
        frames = frames_made(step, known_frames)
        if frames is not None:
            ranges |= dict.fromkeys(step.outputs(), frames)
        elif isinstance(step, MapSpec):
            whole += step.outputs()
        if isinstance(step, MapSpec):
            takes |= dict.fromkeys(step.outputs(), step.take)
        take = known_take(step) if isinstance(step, MovieSpec) else None
        tasks += in_chunks(step, spec, frames, take=take)
    return tasks, whole


def _tasks_before(tasks: list[Spec]) -> list[set[int]]:
    """Return the earlier tasks that each depends on: those that write or read its files."""
    writer: dict[Path, int] = {}
    readers: dict[Path, set[int]] = {}
    before: list[set[int]] = []
    for index, task in enumerate(tasks):
        reads, changes = set(task.paths(Reads)), set(task.changes())
        waits = {writer[path] for path in reads | changes if path in writer}
        for path in changes:
            waits |= readers.pop(path, set())
        for path in reads:
            readers.setdefault(path, set()).add(index)
        writer |= dict.fromkeys(changes, index)
        before.append(waits - {index})
    return before


def _names(tasks: list[Spec], depth: list[int]) -> list[str]:
    """Return the name of each task's farm step: its kind, numbered from the second depth on."""
    kinds = [task.step for task in tasks]
    names: dict[tuple[str, int], str] = {}
    numbers = Counter[str]()
    for kind, level in sorted(set(zip(kinds, depth, strict=True))):
        numbers[kind] += 1
        names[kind, level] = kind if numbers[kind] == 1 else f"{kind}-{numbers[kind]}"
    return [names[each] for each in zip(kinds, depth, strict=True)]
