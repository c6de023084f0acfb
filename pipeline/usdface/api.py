"""What scripts may rely on: run steps and jobs, check layers, read assets. See docs/python.md."""

from pathlib import Path
from typing import Any

from pydantic import ValidationError

from usdface.core.assets import Performance, References, Rig, Take, TrainedMapping
from usdface.core.errors import InputError
from usdface.core.progress import Progress, silent
from usdface.runner import job as jobs
from usdface.runner.execute import execute
from usdface.runner.job import StepState
from usdface.runner.result import StepResult
from usdface.specs.base import Spec
from usdface.specs.job import SPEC_BY_STEP
from usdface.specs.reading import read_job, validation_messages
from usdface.usdio import mapping as mapping_files
from usdface.usdio import validation
from usdface.usdio.performance import read as performance_files
from usdface.usdio.references import read as references_files
from usdface.usdio.rig import read as rig_files
from usdface.usdio.take import read as take_files
from usdface.usdio.validation import Finding

__all__ = [
    "check_job",
    "read_mapping",
    "read_performance",
    "read_references",
    "read_rig",
    "read_take",
    "run_job",
    "run_step",
    "validate",
]


def run_step(
    step: str, /, *, overwrite: bool = False, progress: Progress = silent, **values: Any
) -> StepResult:
    """Run one step, as the command of that name does.

    Parameters
    ----------
    step : str
        As in a job: ``"map"``, ``"references-import"``, ...
    overwrite : bool
        Replace outputs, whoever wrote them and however new they are.
    progress : callable
        Called with the fraction done and what is being done.
    **values
        The step's options, with underscores: ``take=..., mapping=..., rig=..., out=...``.

    Raises
    ------
    InputError
        If there is no such step, an option is wrong, or an input cannot be used.
    """
    spec = SPEC_BY_STEP.get(step)
    if spec is None:
        raise InputError(f"no step {step!r}; there are {', '.join(SPEC_BY_STEP)}")
    return execute(_filled(spec, values), overwrite=overwrite, progress=progress)


def _filled(spec: type[Spec], values: dict[str, Any]) -> Spec:
    try:
        return spec.model_validate(values)
    except ValidationError as error:
        raise InputError(validation_messages(error, spec)) from error


def run_job(
    job: Path | str, *, overwrite: bool = False, progress: Progress = silent
) -> list[StepResult]:
    """Run the steps of a job file that are missing or out of date.

    Raises
    ------
    InputError
        If the job cannot be read, or a step fails.
    CheckFailedError
        If a step was done and what it checked is not in order.
    """
    return jobs.run_job(read_job(Path(job)), overwrite=overwrite, progress=progress)


def check_job(job: Path | str) -> list[StepState]:
    """Say of each step of a job file whether it is done, stale or missing; nothing is run.

    Raises
    ------
    InputError
        If the job cannot be read, or cannot run; every fault is named.
    """
    return jobs.job_states(read_job(Path(job)))


def validate(layer: Path | str) -> list[Finding]:
    """Check a USD file with USD's validators and ours; an empty list means nothing was found.

    Raises
    ------
    InputError
        If the file cannot be opened at all.
    """
    return validation.validate(Path(layer))


def read_take(file: Path | str, *, first: int | None = None, last: int | None = None) -> Take:
    """Read a take, or its frames `first` to `last`, inclusive.

    Raises
    ------
    InputError
        If the file is no take, or lacks the frames.
    """
    return take_files.read_take(Path(file), first=first, last=last)


def read_rig(file: Path | str, *, prim: str | None = None) -> Rig:
    """Read a rig as it is found; `prim` names the face where the file holds several.

    Raises
    ------
    InputError
        If the file holds no rig.
    """
    return rig_files.read_rig(Path(file), prim=prim)


def read_references(file: Path | str) -> References:
    """Read a references asset: tuned weights where there are any, else proposals.

    Raises
    ------
    InputError
        If the file is no references asset.
    """
    return references_files.read_references(Path(file))


def read_mapping(file: Path | str) -> TrainedMapping:
    """Read a trained mapping.

    Raises
    ------
    InputError
        If the file is no mapping.
    """
    return mapping_files.read_mapping(Path(file))


def read_performance(file: Path | str) -> Performance:
    """Read a performance as it is to be seen: its solve with the edits.

    Raises
    ------
    InputError
        If the file is no performance, or its rig is gone.
    """
    return performance_files.read_performance(Path(file))
