"""Run the steps of a job that are missing or out of date."""

import logging
from collections.abc import Callable
from dataclasses import dataclass

from usdface.core.errors import CancelledError, UsdfaceError
from usdface.core.progress import Progress, part, silent
from usdface.core.provenance import Provenance
from usdface.runner.execute import create_folder, execute
from usdface.runner.origin import make_provenance
from usdface.runner.outputs import check_inputs, check_may_be_replaced
from usdface.runner.result import StepResult
from usdface.runner.state import step_state
from usdface.specs.base import Spec
from usdface.specs.job import JobSpec
from usdface.specs.paths import Writes

log = logging.getLogger(__name__)


@dataclass(frozen=True)
class JobStep:
    """The current step of a running job."""

    number: int
    """Counted from 1."""
    count: int
    """Number of steps of the job."""
    spec: Spec
    provenance: Provenance

    @property
    def label(self) -> str:
        """Number, step and output: ``step 3 of 22, map k_001.hero.usda``."""
        files = (*self.spec.outputs(), *self.spec.paths(Writes))
        name = f" {files[0].name}" if files else ""
        place = f"step {self.number} of {self.count}, " if self.count > 1 else ""
        return f"{place}{self.spec.step}{name}"


def _ignore(*_: object) -> None:
    """Do nothing."""


@dataclass(frozen=True)
class JobEvents:
    """Callbacks of a running job."""

    started: Callable[[JobStep], None] = _ignore
    """Before a step runs; not for steps that are up to date."""
    ended: Callable[[JobStep, StepResult], None] = _ignore
    """After a step, also if it is up to date."""


def run_job(
    job: JobSpec,
    *,
    progress: Progress = silent,
    overwrite: bool = False,
    events: JobEvents | None = None,
) -> list[StepResult]:
    """Run the steps of a job in order, skipping those whose outputs are up to date.

    Parameters
    ----------
    overwrite : bool
        Replace outputs that this package did not write, or that are of another kind.

    Raises
    ------
    InputError
        If a step fails; outputs of earlier steps stay, and running again continues from there.
    CheckFailedError
        If a check of a step failed.
    """
    events = events or JobEvents()
    reports = []
    count = len(job.steps)
    for index, spec in enumerate(job.steps):
        where = f"step {index + 1} of {count}, {spec.step}"
        share = part(progress, index / count, (index + 1) / count)
        try:
            check_inputs(spec)
            step = JobStep(index + 1, count, spec, make_provenance(spec))
            state = step_state(spec, step.provenance)
            if state.state == "done":
                report = StepResult(spec.outputs(), f"{spec.step}: up to date", up_to_date=True)
                share(1.0, f"{step.label}: up to date")
            else:
                log.info("%s: %s", step.label, state.reason)
                events.started(step)
                if not overwrite:
                    check_may_be_replaced(spec)
                report = execute(
                    spec,
                    overwrite=True,
                    progress=_labelled(share, step.label),
                    provenance=step.provenance,
                )
            events.ended(step, report)
        except CancelledError:
            raise
        except UsdfaceError as error:
            raise type(error)(f"{where}: {error}") from error
        reports.append(report)
    return reports


def make_folders(job: JobSpec) -> None:
    """Create the folders that a job writes to: a farm's worker may lack them."""
    for folder in {path.parent for step in job.steps for path in step.paths(Writes)}:
        create_folder(folder, remedy="change the job's outputs")


def _labelled(progress: Progress, label: str) -> Progress:
    def report(fraction: float, message: str) -> None:
        progress(fraction, f"{label}: {message}")

    return report
