"""Submission of a job to a farm.

The farms' commands are called with lists of arguments, without a shell. OpenCue gets an outline
with a layer per farm step and a frame per task.
"""

import importlib
import os
import re
import shlex
import shutil
import subprocess
import sys
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from usdface.core.confinement import check_confined
from usdface.core.errors import CheckFailedError, InputError
from usdface.core.replacing import write_text
from usdface.core.text import pluralize
from usdface.farm.bundle import (
    TASKS_FOLDER,
    TEMPLATE_FILE,
    bundle_hash,
    compose_bundle,
    task_command,
    write_bundle,
)
from usdface.farm.plan import FarmStep, Plan, plan_job
from usdface.runner.origin import input_files
from usdface.runner.outputs import missing_in_job
from usdface.specs.commands import SubmitSpec
from usdface.specs.job import JobSpec
from usdface.specs.paths import Reads, Writes
from usdface.specs.reading import read_job
from usdface.usdio.layers import is_layer_name
from usdface.usdio.referenced_files import frame_range_of
from usdface.usdio.take.read import TakeReader, is_take

_FRAME = "#IFRAME#"
"""Placeholder of the frame number in commands of OpenCue."""


def build_outline(
    name: str, steps: Sequence[FarmStep], bundle: Path, *, priority: int | None = None
) -> Any:
    """Return the launcher of a bundle's outline, without sending it.

    Workers run commands in a shell, so the bundle's path, their only variable part, is quoted.
    OpenCue has no path mapping: paths must be the same on workers.

    Parameters
    ----------
    name : str
        Of the job; characters that OpenCue does not allow become ``_``.

    Raises
    ------
    InputError
        If pyoutline is not installed, or the bundle's path would confuse OpenCue.
    """
    outline, shell, cuerun = _pyoutline()
    if _FRAME[:2] in str(bundle):
        raise InputError(f"{bundle}: {_FRAME[:2]!r} in a path means a frame to OpenCue; rename it")
    longest = max(len(step.tasks) for step in steps)
    # Layers with frames outside the outline's range would be dropped silently.
    job = outline.Outline(name=_allowed(name), frame_range=f"1-{longest}")
    for step in steps:
        spec = bundle.absolute() / TASKS_FOLDER / step.name / f"{_FRAME}.yaml"
        layer = shell.Shell(
            _allowed(step.name),
            command=[shlex.quote(word) for word in task_command(str(spec))],
            range=f"1-{len(step.tasks)}",
            chunk=1,
            cores=float(step.kind.cores),
            memory=f"{step.kind.memory_mib}m",
        )
        job.add_layer(layer)
        for needed in step.needs:
            layer.depend_all(job.get_layer(_allowed(needed)))
    flags = {} if priority is None else {"priority": priority}
    return cuerun.OutlineLauncher(job, **flags)


def submit_outline(launcher: Any) -> None:
    """Send an outline to OpenCue; workers need usdface but not pyoutline.

    `CheckFailedError` if OpenCue cannot be reached or refuses the job.
    """
    try:
        launcher.launch(use_pycuerun=False)
    except Exception as error:  # pyoutline passes on errors of its transport
        raise CheckFailedError(f"OpenCue: {type(error).__name__}: {error}") from error


def _pyoutline() -> tuple[Any, Any, Any]:
    try:
        return tuple(  # type: ignore[return-value]
            importlib.import_module(name)
            for name in ("outline", "outline.modules.shell", "outline.cuerun")
        )
    except ImportError as error:
        raise InputError(
            f"pyoutline cannot be imported ({error}); install it with: pip install "
            "opencue-pyoutline opencue-pycue"
        ) from error


def _allowed(name: str) -> str:
    return re.sub(r"[^A-Za-z0-9_-]", "_", name)


_STOP_SECONDS = 60.0
"""Time for a farm's command to stop its tasks after termination."""

_RUN_AGAIN = "finished tasks are kept, and submitting again continues"
_NOT_TAKEN = (
    "the job was not submitted for the reason above; `deadline config` sets farm, queue and known "
    "asset paths"
)


def run_bundle(bundle: Path, *, quiet: bool = False) -> None:
    """Run all tasks of a bundle on this machine, one after the other, with `openjd`.

    Parameters
    ----------
    quiet : bool
        Redirect the command's output to standard error, for scripts that parse ours.
    """
    openjd = _find_command(
        "openjd", "install usdface with its farm extra: pip install usdface[farm]"
    )
    _run_command([openjd, "run", str(bundle / TEMPLATE_FILE)], quiet=quiet, remedy=_RUN_AGAIN)


def submit_bundle(
    bundle: Path, *, steps: Sequence[FarmStep], priority: int | None = None, quiet: bool = False
) -> None:
    """Submit a bundle to the farm and queue of `deadline config`.

    `deadline` uploads job attachments without a question from known folders only. The folders of
    files that the job names are declared known; others, which layers refer to, must be allowed by
    the user in `deadline config`.
    """
    deadline = _find_command("deadline", "install it with: pip install deadline")
    command = [deadline, "bundle", "submit", str(bundle), "--yes", "--submitter-name", "usdface"]
    for folder in named_folders(steps):
        command += ["--known-asset-path", str(folder)]
    if priority is not None:
        command += ["--priority", str(priority)]
    _run_command(command, quiet=quiet, remedy=_NOT_TAKEN)


def named_folders(steps: Sequence[FarmStep]) -> list[Path]:
    """Return the folders of the files that tasks name, without nested ones and ``/``."""
    tasks = [task for step in steps for task in step.tasks]
    named = {path.parent for task in tasks for path in (*task.paths(Reads), *task.paths(Writes))}
    named = {folder for folder in named if folder.parent != folder}
    return sorted(folder for folder in named if named.isdisjoint(folder.parents))


def _find_command(name: str, remedy: str) -> str:
    """Return the path of a program, of this environment if it has it."""
    found = shutil.which(name, path=_search_path())
    if found is None:
        raise InputError(f"{name}: no such command on this machine; {remedy}")
    return found


def _run_command(command: Sequence[str], *, quiet: bool, remedy: str) -> None:
    """Run a program to its end; if this process is interrupted, terminate the program."""
    # The tasks must call this environment's `usdface`.
    environment = os.environ | {"PATH": _search_path()}
    sys.stdout.flush()
    with subprocess.Popen(
        list(command), env=environment, stdin=subprocess.DEVNULL, stdout=2 if quiet else None
    ) as process:
        try:
            code = process.wait()
        except BaseException:
            process.terminate()
            try:
                process.wait(_STOP_SECONDS)
            except subprocess.TimeoutExpired:
                process.kill()
            raise
    if code:
        raise CheckFailedError(f"{Path(command[0]).name} ended with {code}; {remedy}")


def _search_path() -> str:
    here = str(Path(sys.executable).parent)
    return os.pathsep.join((here, os.environ.get("PATH", os.defpath)))


@dataclass(frozen=True)
class Submission:
    """A submitted job."""

    job: str
    """Name of the job."""
    bundle: Path
    """Folder of the bundle."""
    plan: Plan


def submit(spec: SubmitSpec, *, overwrite: bool = False, quiet: bool = False) -> Submission:
    """Write a job's bundle, and submit it unless `spec.write_only`.

    Parameters
    ----------
    overwrite : bool
        Replace another job's bundle in the same folder.
    quiet : bool
        Redirect the output of the farm's command to standard error.
    """
    submission = _write(spec, overwrite=overwrite)
    bundle, steps = submission.bundle, submission.plan.steps
    if spec.farm == "opencue":
        launcher = build_outline(submission.job, steps, bundle, priority=spec.priority)
        if spec.write_only:
            text = str(launcher.serialize(use_pycuerun=False))
            write_text(bundle.with_name(f"{bundle.name}.outline.xml"), text)
        else:
            submit_outline(launcher)
    elif spec.farm == "deadline" and not spec.write_only:
        submit_bundle(bundle, steps=steps, priority=spec.priority, quiet=quiet)
    elif not spec.write_only:
        run_bundle(bundle, quiet=quiet)
    return submission


def describe(submission: Submission) -> tuple[str, ...]:
    """Return a line per farm step with its tasks and dependencies."""
    return tuple(
        f"{step.name}: {pluralize(len(step.tasks), 'task')}"
        + (f", after {', '.join(step.needs)}" if step.needs else "")
        for step in submission.plan.steps
    )


def _write(spec: SubmitSpec, *, overwrite: bool) -> Submission:
    """Plan a job and write its bundle."""
    check_confined([("submit", spec.job), ("submit", spec.out or spec.job)])
    job = _with_absolute_paths(read_job(spec.job))
    check_confined(job.named_paths())
    # Before the job waits in a queue.
    if faults := missing_in_job(job):
        raise InputError("\n".join(faults))
    plan = plan_job(
        job, spec, frames_of=lambda path: frame_range_of(path) if path.exists() else None
    )
    carried = _carried(job)
    # Uploaded to farms without shared storage.
    check_confined([("submit, what a layer refers to", path) for path in carried])
    files = compose_bundle(job.job, plan.steps, carried=carried)
    bundle = spec.out or spec.job.with_name(f"{spec.job.stem}-{bundle_hash(files)}.bundle")
    check_confined([("submit", bundle)])  # it may be a link
    write_bundle(bundle, files, overwrite=overwrite)
    return Submission(job.job, bundle, plan)


def _with_absolute_paths(job: JobSpec) -> JobSpec:
    def absolute(path: Path) -> Path:
        # `..` after a link is relative to its target.
        return path.resolve() if ".." in path.parts else path.absolute()

    return job.model_copy(update={"steps": tuple(step.with_paths(absolute) for step in job.steps)})


def _carried(job: JobSpec) -> list[Path]:
    """Return the files that the job's input layers refer to, and the pictures of sequences."""
    made = {path for step in job.steps for path in step.changes()}
    steps_read = {path: how for step in job.steps for path, how in step.reads().items()}
    read = {path: how for path, how in steps_read.items() if path not in made}
    for take in [path for path in read if is_layer_name(path) and is_take(path)]:
        video = TakeReader(take).read_video()
        if video is not None and video.file.is_file():
            read[video.file] = Reads(sequence=True)
    return [
        file
        for path, how in read.items()
        for file in input_files(path, replace(how, alone=False, assets=True))
    ]
