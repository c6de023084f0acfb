"""Whether a step's outputs exist and are up to date with its inputs and options."""

import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path, PurePosixPath
from typing import Any, Literal

from pydantic import ValidationError

from usdface.core.errors import InputError
from usdface.core.provenance import Provenance
from usdface.core.rates import exact_rate
from usdface.core.sidecars import LAYER_SUFFIXES, corrected_path
from usdface.core.text import first_few, pluralize
from usdface.runner.origin import make_provenance, provenance_of, spec_of
from usdface.runner.outputs import check_may_be_read, missing_in_job, missing_inputs, sidecars_of
from usdface.specs.base import Spec
from usdface.specs.capture import TrackSpec
from usdface.specs.job import JobSpec
from usdface.specs.paths import Reads, Writes, frame_range
from usdface.specs.performance import JoinSpec, MapSpec
from usdface.specs.review import MovieJoinSpec, MovieSpec
from usdface.usdio.referenced_files import frame_range_of, missing_sublayers

_LONGEST_VALUE = 60
"""Characters of an option's value in a message."""

_State = Literal["done", "stale", "missing"]


@dataclass(frozen=True)
class StepState:
    """State of one step of a job."""

    spec: Spec
    state: _State
    reason: str


def chunk_specs(spec: Spec, made: Provenance, path: Path) -> tuple[Spec, ...]:
    """Return the specs of a file that was joined from parts and is equivalent to `spec`.

    The join, then the expected spec of each part, not checked for being up to date. Empty if the
    file was not joined, or from other frames.
    """
    join = _join_of(spec, made)
    if join is None:
        return ()
    folder = path.resolve().parent
    join = join.with_paths(lambda part: folder / part)
    parts, ranges = list[Spec](), list[tuple[int, int]]()
    for path_of_part in join.parts or ():
        frames = spec_of(provenance_of(path_of_part)).get("frames")
        try:
            limits = frame_range(frames)
        except (AttributeError, ValueError):
            return ()
        if limits is None:
            return ()
        ranges.append(limits)
        if isinstance(spec, TrackSpec):
            parts.append(spec.part_spec(frames, path_of_part))
            continue
        changed = {"chunk": None} if isinstance(spec, MapSpec) else {"sound": False}
        parts.append(spec.model_copy(update={"frames": frames, "out": path_of_part, **changed}))
    ranges.sort()
    consecutive = all(one[1] + 1 == other[0] for one, other in pairwise(ranges))
    if not consecutive or (ranges[0][0], ranges[-1][1]) != frames_made(spec):
        return ()
    if isinstance(spec, TrackSpec):
        join = spec.model_copy(update={"parts": join.parts})
    return (join, *parts)


_JOIN_SPECS: Mapping[type[Spec], type[JoinSpec | MovieJoinSpec | TrackSpec]] = {
    MapSpec: JoinSpec,
    MovieSpec: MovieJoinSpec,
    TrackSpec: TrackSpec,
}
"""The spec that joins parts of each step."""


def _join_of(spec: Spec, made: Provenance) -> JoinSpec | MovieJoinSpec | TrackSpec | None:
    kind = _JOIN_SPECS.get(type(spec))
    if kind is None or made.step != kind.step_name():
        return None
    if isinstance(spec, TrackSpec) and (spec.parts or not spec_of(made).get("parts")):
        return None
    try:
        return kind.model_validate(spec_of(made))
    except ValidationError:
        return None


def frames_made(
    step: Spec, frames_of: Callable[[Path], tuple[int, int] | None] = frame_range_of
) -> tuple[int, int] | None:
    """Return first and last frame of a step's output; None if they are not known before it runs."""
    if isinstance(step, MapSpec):
        return frame_range(step.frames) or frames_of(step.take)
    if isinstance(step, MovieSpec):
        return frame_range(step.frames) or frames_of(step.performance)
    if isinstance(step, TrackSpec) and step.video.is_file():
        return _video_frames(step)
    return None


def _video_frames(step: TrackSpec) -> tuple[int, int]:
    from usdface.capture.sample_times import picture_frames  # slow to import
    from usdface.media.film.video import open_video

    asked = None if step.video_rate is None else exact_rate(step.video_rate, where="--video-rate")
    with open_video(step.video, asked) as video:
        _, frames = picture_frames(video.times, asked or video.rate)
    first, last = frame_range(step.frames) or (1, 1 + int(frames[-1]))
    return max(first, 1), min(last, 1 + int(frames[-1]))


def job_states(job: JobSpec) -> list[StepState]:
    """Return the state of each step of a job; refuse missing inputs and output folders together."""
    faults = missing_in_job(job)
    folders = {path.parent: None for spec in job.steps for path in spec.paths(Writes)}
    missing = [folder for folder in folders if not folder.is_dir()]
    if missing:
        faults.append(
            f"{pluralize(len(missing), 'output folder')} missing: {first_few(missing)}; create "
            "them, or use `usdface run --make-folders`"
        )
    states: list[StepState] = []
    to_come: set[Path] = set()
    for spec in job.steps:
        check_may_be_read(spec)
        waits_for = [path for path in spec.paths(Reads) if path in to_come or not path.exists()]
        if waits_for and all(path.exists() for path in spec.outputs()):
            state = StepState(spec, "stale", f"an earlier step rewrites {waits_for[0].name}")
        elif waits_for:
            state = StepState(spec, "missing", "waits for an earlier step")
        else:
            state = step_state(spec, make_provenance(spec))
        if state.state != "done":
            to_come.update(spec.changes())
        states.append(state)
    if faults:
        raise InputError("\n".join(faults))
    return states


def step_state(spec: Spec, provenance: Provenance) -> StepState:
    """Compare the provenance stored in a step's outputs with `provenance`, the current one."""
    if not spec.outputs():
        return StepState(spec, "missing", "writes no file that stores its provenance")
    for path in spec.outputs():
        if not path.exists():
            return StepState(spec, "missing", f"{path.name} does not exist")
        made = provenance_of(path)
        if made is not None and (parts := chunk_specs(spec, made, path)):
            states = [_state_of_part(each) for each in parts]
            return next(
                (StepState(spec, s.state, s.reason) for s in states if s.state != "done"),
                StepState(spec, "done", "up to date, made in parts"),
            )
        if made is None or made.step != provenance.step:
            return StepState(spec, "stale", f"{path.name} was not made by {provenance.step}")
        if made.spec != provenance.spec:
            changes = _changed_settings(spec_of(made), spec_of(provenance))
            return StepState(spec, "stale", f"{path.name} was made with other options: {changes}")
        changed = [
            name for name, value in provenance.inputs.items() if made.inputs.get(name) != value
        ]
        if (binding := spec.written_binding()) is not None:
            layer = corrected_path(binding).name  # without a correction it is no input
            changed += [
                name
                for name in made.inputs
                if name not in provenance.inputs and PurePosixPath(name).name == layer
            ]
        if changed:
            return StepState(spec, "stale", f"{changed[0]} has changed since")
        if path.suffix in LAYER_SUFFIXES and (lost := missing_sublayers(path)):
            return StepState(spec, "missing", f"{lost[0]} does not exist")
        if other := _layer_of_another_run(spec, path, made):
            return StepState(spec, "stale", f"{other.name} is of another, interrupted run")
    return StepState(spec, "done", "up to date")


def _layer_of_another_run(spec: Spec, path: Path, made: Provenance) -> Path | None:
    """Return a sublayer of an output that the same step made with other options or inputs."""
    for layer in sidecars_of(spec, path):
        layer_made = provenance_of(layer) if layer.is_file() else None
        if layer_made is not None and layer_made.step == made.step:
            if (layer_made.spec, dict(layer_made.inputs)) != (made.spec, dict(made.inputs)):
                return layer
    return None


def _changed_settings(was: Mapping[str, Any], now: Mapping[str, Any]) -> str:
    """Return the options that differ, each with both values; options not stored are the default."""

    def text(data: Mapping[str, Any], name: str) -> str:
        return (
            json.dumps(data[name], ensure_ascii=False)[:_LONGEST_VALUE]
            if name in data
            else "default"
        )

    names = [name for name in {**was, **now} if was.get(name) != now.get(name)]
    return first_few(
        [f"{name} was {text(was, name)}, is {text(now, name)}" for name in names], most=3
    )


def _state_of_part(spec: Spec) -> StepState:
    check_may_be_read(spec)
    if missing := missing_inputs(spec):
        return StepState(spec, "missing", f"{missing[0].name} does not exist")
    return step_state(spec, make_provenance(spec))
