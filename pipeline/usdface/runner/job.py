"""Run the steps of a job that are missing or out of date; look a job over without running it."""

import logging
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Literal

from pydantic import ValidationError

from usdface.core.errors import CheckFailedError, InputError
from usdface.core.progress import Progress, part, silent
from usdface.core.provenance import Provenance
from usdface.core.sidecars import LAYER_SUFFIXES
from usdface.runner.execute import execute
from usdface.runner.origin import make_provenance, provenance_of, spec_of
from usdface.runner.outputs import (
    check_inputs,
    check_may_be_read,
    foreign_sidecar,
    missing_in_job,
    missing_inputs,
    sibling_sharing_layers,
)
from usdface.runner.result import StepResult
from usdface.specs.base import Spec
from usdface.specs.job import JobSpec
from usdface.specs.paths import Reads, Writes, frame_range
from usdface.specs.performance import JoinSpec, MapSpec
from usdface.specs.review import MovieJoinSpec, MovieSpec
from usdface.usdio.referenced_files import frame_range_of, missing_sublayers


def chunk_specs(spec: Spec, made: Provenance, path: Path) -> tuple[Spec, ...]:
    """Return the specs by which a file that joins parts was made, if they come to a given one.

    Parameters
    ----------
    spec : Spec
        What would make the file whole.
    made : Provenance
        What the file says of its making.

    Returns
    -------
    tuple of Spec
        The join, and each part's as it should be: whether all are done is for the caller to find.
        Empty if the file was made otherwise, or of other frames.
    """
    join = _join_of(spec, made)
    if join is None:
        return ()
    folder = path.resolve().parent
    join = join.with_paths(lambda part: folder / part)
    parts, stretches = list[Spec](), list[tuple[int, int]]()
    for path_of_part in join.parts:
        frames = spec_of(provenance_of(path_of_part)).get("frames")
        changed = {"frames": frames, "out": path_of_part}
        changed |= {"chunk": None} if isinstance(spec, MapSpec) else {"sound": False}
        try:
            stretch = frame_range(frames)
        except (AttributeError, ValueError):
            return ()
        if stretch is None:
            return ()
        stretches.append(stretch)
        parts.append(spec.model_copy(update=changed))
    stretches.sort()
    follow = all(one[1] + 1 == other[0] for one, other in pairwise(stretches))
    if not follow or (stretches[0][0], stretches[-1][1]) != _frames_wanted(spec):
        return ()
    return (join, *parts)


def _join_of(spec: Spec, made: Provenance) -> JoinSpec | MovieJoinSpec | None:
    kind: type[JoinSpec] | type[MovieJoinSpec]
    if isinstance(spec, MapSpec):
        kind = JoinSpec
    elif isinstance(spec, MovieSpec):
        kind = MovieJoinSpec
    else:
        return None
    if made.step != kind.step_name():
        return None
    try:
        return kind.model_validate(spec_of(made))
    except ValidationError:
        return None


def _frames_wanted(spec: Spec) -> tuple[int, int] | None:
    if isinstance(spec, MapSpec):
        return frame_range(spec.frames) or frame_range_of(spec.take)
    if isinstance(spec, MovieSpec):
        return frame_range(spec.frames) or frame_range_of(spec.performance)
    return None


log = logging.getLogger(__name__)

_State = Literal["done", "stale", "missing"]


@dataclass(frozen=True)
class StepState:
    """Where one step of a job stands."""

    spec: Spec
    state: _State
    """Whether its outputs are there, and made from the inputs as they are now."""
    reason: str


def run_job(
    job: JobSpec, *, progress: Progress = silent, overwrite: bool = False
) -> list[StepResult]:
    """Run what a job lacks, in order; a step whose outputs are up to date is skipped.

    Parameters
    ----------
    overwrite : bool
        Replace outputs that this package did not write.

    Raises
    ------
    InputError
        If a step fails; what earlier steps wrote stays, and running again goes on from there.
    CheckFailedError
        If a step was done and what it checked is not in order.
    """
    reports = []
    for index, spec in enumerate(job.steps):
        label = f"step {index + 1} of {len(job.steps)}, {spec.step}"
        share = part(progress, index / len(job.steps), (index + 1) / len(job.steps))
        try:
            check_inputs(spec)
        except InputError as error:
            raise InputError(f"{label}: {error}") from error
        provenance = make_provenance(spec)
        state = _state(spec, provenance)
        if state.state == "done":
            log.info("%s: up to date", label)
            reports.append(StepResult(spec.outputs(), f"{spec.step}: up to date", fresh=False))
            share(1.0, f"{spec.step}: up to date")
            continue
        log.info("%s: %s", label, state.reason)
        if not overwrite:
            _refuse_foreign_outputs(spec, label)
        try:
            report = execute(
                spec, overwrite=True, progress=_labelled(share, spec.step), provenance=provenance
            )
        except InputError as error:
            raise InputError(f"{label}: {error}") from error
        try:
            report.require_success()
        except CheckFailedError as error:
            raise CheckFailedError(f"{label}: {error}") from error
        reports.append(report)
    return reports


def make_folders(job: JobSpec) -> None:
    """Make the folders that a job writes to: a farm's worker may have none of them.

    Raises
    ------
    InputError
        If one cannot be made.
    """
    for folder in {path.parent for step in job.steps for path in step.paths(Writes)}:
        try:
            folder.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise InputError(f"{folder}: cannot be made: {error.strerror}") from error


def job_states(job: JobSpec) -> list[StepState]:
    """Say of each step whether it is done, stale or missing.

    Raises
    ------
    InputError
        If a step reads a file that neither exists nor is made by an earlier step, or writes where
        it cannot; every fault is named.
    """
    faults = missing_in_job(job)
    states: list[StepState] = []
    to_come: set[Path] = set()
    for number, spec in enumerate(job.steps, start=1):
        check_may_be_read(spec)
        faults += [
            f"step {number}, {spec.step}: {path}: folder {path.parent} does not exist"
            for path in spec.paths(Writes)
            if not path.parent.is_dir()
        ]
        waits_for = [path for path in spec.paths(Reads) if path in to_come or not path.exists()]
        if waits_for and all(path.exists() for path in spec.outputs()):
            state = StepState(spec, "stale", f"an earlier step makes {waits_for[0].name} anew")
        elif waits_for:
            state = StepState(spec, "missing", "waits for an earlier step")
        else:
            state = _state(spec, make_provenance(spec))
        if state.state != "done":
            to_come.update(spec.changes())
        states.append(state)
    if faults:
        raise InputError("\n".join(faults))
    return states


def _state(spec: Spec, provenance: Provenance) -> StepState:
    if not spec.outputs():
        return StepState(spec, "missing", "writes nothing that could tell it was done")
    for path in spec.outputs():
        if not path.exists():
            return StepState(spec, "missing", f"{path.name} is not there")
        made = provenance_of(path)
        if made is not None and (parts := chunk_specs(spec, made, path)):
            states = [_state_of_part(each) for each in parts]
            return next(
                (StepState(spec, s.state, s.reason) for s in states if s.state != "done"),
                StepState(spec, "done", "up to date, made in parts"),
            )
        if made is None or made.step != provenance.step:
            return StepState(spec, "stale", f"{path.name} was made by something else")
        if made.spec != provenance.spec:
            return StepState(spec, "stale", f"{path.name} was made with other settings")
        changed = [
            name for name, value in provenance.inputs.items() if made.inputs.get(name) != value
        ]
        if changed:
            return StepState(spec, "stale", f"{changed[0]} has changed since")
        if path.suffix in LAYER_SUFFIXES and (lost := missing_sublayers(path)):
            return StepState(spec, "missing", f"{lost[0]} is not there")
    return StepState(spec, "done", "up to date")


def _state_of_part(spec: Spec) -> StepState:
    check_may_be_read(spec)
    if missing := missing_inputs(spec):
        return StepState(spec, "missing", f"{missing[0].name} is not there")
    return _state(spec, make_provenance(spec))


def _refuse_foreign_outputs(spec: Spec, label: str) -> None:
    for path in spec.paths(Writes):
        foreign = path if path.exists() and provenance_of(path) is None else None
        if foreign := foreign or foreign_sidecar(spec, path):
            raise InputError(
                f"{label}: {foreign}: exists and was not written by usdface; move it away, or run "
                "with --overwrite"
            )
        if sibling := sibling_sharing_layers(spec, path):
            raise InputError(
                f"{label}: {sibling}: has the same layers beneath as {path.name} would have; name "
                "another output, or run with --overwrite"
            )


def _labelled(progress: Progress, step: str) -> Progress:
    def report(fraction: float, message: str) -> None:
        progress(fraction, f"{step}: {message}")

    return report
