"""From a job's file to a farm."""

from dataclasses import dataclass
from pathlib import Path

from usdface.core.errors import InputError
from usdface.core.replacing import replacing
from usdface.core.sidecars import LAYER_SUFFIXES
from usdface.farm.bundle import bundle_hash, compose_bundle, write_bundle
from usdface.farm.chunks import ChunkSizes, FrameRange
from usdface.farm.commands import run_bundle, submit_bundle
from usdface.farm.opencue import build_outline, outline_text, submit_outline
from usdface.farm.plan import Plan, plan_job
from usdface.farm.template import check_job_name
from usdface.runner.outputs import missing_in_job
from usdface.specs.job import JobSpec
from usdface.specs.paths import Reads, check_confined, confinement_root
from usdface.specs.reading import read_job
from usdface.specs.submit import SubmitSpec
from usdface.usdio.referenced_files import frame_range_of, referenced_files


@dataclass(frozen=True)
class Submission:
    """What was handed to a farm."""

    job: str
    """Its name."""
    bundle: Path
    """The folder that describes it."""
    plan: Plan


def submit(spec: SubmitSpec, *, overwrite: bool = False, quiet: bool = False) -> Submission:
    """Write a job's bundle, and hand it to the farm unless only the bundle is wanted.

    Parameters
    ----------
    overwrite : bool
        Replace another job's bundle in the same folder.
    quiet : bool
        Send what the farm's own command says to standard error.

    Raises
    ------
    InputError
        If the job cannot be run as it is, the bundle cannot be written, or the farm's client is
        not installed.
    CheckFailedError
        If the farm refuses the job, or a task of a local run fails.
    """
    submission = _write(spec, overwrite=overwrite)
    bundle, steps = submission.bundle, submission.plan.steps
    if spec.farm == "opencue":
        launcher = build_outline(submission.job, steps, bundle, priority=spec.priority)
        if spec.write_only:
            with replacing(outline_path(bundle)) as file:
                file.write_text(outline_text(launcher), encoding="utf-8", newline="\n")
        else:
            submit_outline(launcher)
    elif spec.farm == "deadline" and not spec.write_only:
        submit_bundle(bundle, steps=steps, priority=spec.priority, quiet=quiet)
    elif not spec.write_only:
        run_bundle(bundle, quiet=quiet)
    return submission


def outline_path(bundle: Path) -> Path:
    """Return where the XML of an OpenCue job is written when it is not sent: beside its bundle."""
    return bundle.with_name(f"{bundle.name}.outline.xml")


def describe(submission: Submission) -> tuple[str, ...]:
    """Return a line for each farm step: its tasks and what it waits for."""
    return tuple(
        f"{step.name}: {len(step.tasks)} task{'s' * (len(step.tasks) > 1)}"
        + (f", after {', '.join(step.needs)}" if step.needs else "")
        for step in submission.plan.steps
    )


def _write(spec: SubmitSpec, *, overwrite: bool) -> Submission:
    """Plan a job and write its bundle."""
    root = confinement_root()
    if root is not None:
        check_confined([("submit", spec.job), ("submit", spec.out or spec.job)], root)
    job = _with_absolute_paths(read_job(spec.job))
    check_job_name(job.job)
    if root is not None:
        check_confined(job.named_paths(), root)
    _check_inputs(job)
    sizes = ChunkSizes(map=spec.chunk, movie=spec.movie_chunk, clips=spec.clips)
    plan = plan_job(job, sizes=sizes, frames_of=_frames_of)
    carried = _carried(job)
    if root is not None:  # farms without shared storage upload these
        check_confined([("submit, what a layer refers to", path) for path in carried], root)
    files = compose_bundle(job.job, plan.steps, carried=carried)
    bundle = spec.out or spec.job.with_name(f"{spec.job.stem}-{bundle_hash(files)}.bundle")
    if root is not None:  # its name may be that of a link
        check_confined([("submit", bundle)], root)
    write_bundle(bundle, files, overwrite=overwrite)
    return Submission(job.job, bundle, plan)


def _with_absolute_paths(job: JobSpec) -> JobSpec:
    def absolute(path: Path) -> Path:
        # `..` after a link does not lead back to where the link is.
        return path.resolve() if ".." in path.parts else path.absolute()

    return job.model_copy(update={"steps": tuple(step.with_paths(absolute) for step in job.steps)})


def _check_inputs(job: JobSpec) -> None:
    """Find here, in a second, what a worker would find after an hour in the queue."""
    if faults := missing_in_job(job):
        raise InputError("\n".join(faults))


def _frames_of(path: Path) -> FrameRange | None:
    return frame_range_of(path) if path.exists() else None


def _carried(job: JobSpec) -> list[Path]:
    """Return what layers that the job starts from need beside them."""
    made = {path for step in job.steps for path in step.changes()}
    read = {path for step in job.steps for path in step.paths(Reads)} - made
    layers = [path for path in read if path.suffix in LAYER_SUFFIXES and path.is_file()]
    return [found for layer in sorted(layers) for found in referenced_files(layer)]
