"""Run the step that a spec describes, or one step for every file of a folder."""

import contextlib
import errno
import os
from collections.abc import Callable, Iterator, Sequence
from importlib import import_module
from pathlib import Path

from threadpoolctl import threadpool_limits

from usdface.core.errors import CheckFailedError, InputError
from usdface.core.progress import Progress, part, silent
from usdface.core.provenance import Provenance
from usdface.core.replacing import not_written_since
from usdface.core.text import pluralize
from usdface.runner.origin import make_provenance
from usdface.runner.outputs import check_inputs, check_outputs
from usdface.runner.result import StepResult
from usdface.runner.state import step_state
from usdface.specs.base import MovedRigSpec, Spec
from usdface.specs.job import STEP_SPECS
from usdface.specs.paths import Writes
from usdface.usdio.rig.reference import moved_rig

Step = Callable[..., StepResult]


def find_step(spec: type[Spec]) -> Step:
    """Return a step's function, importing its module only now, for a quick start of others."""
    step: Step = import_module(f"usdface.steps.{spec.module}").run
    return step


@contextlib.contextmanager
def _one_blas_thread() -> Iterator[None]:
    """Limit linear algebra to one thread: rounding of sums depends on the number of threads.

    The same inputs then give the same bytes, whatever limits the host process has set.
    """
    if os.environ.get("OPENBLAS_NUM_THREADS") != "1":
        # SciPy brings its own BLAS, which starts a thread per core unless it is loaded before.
        import_module("scipy.linalg")
    with threadpool_limits(1, user_api="blas"):
        yield


def execute(
    spec: Spec,
    *,
    overwrite: bool = False,
    progress: Progress = silent,
    provenance: Provenance | None = None,
) -> StepResult:
    """Check what a spec reads and writes, then run its step, unless its outputs are up to date.

    Parameters
    ----------
    overwrite : bool
        Replace existing outputs, including newer files and files that usdface did not write.

    Raises
    ------
    InputError
        If an input is missing or cannot be used, an output must not be replaced, or a path lies
        outside the folder of ``USDFACE_ROOT``.
    """
    try:
        check_inputs(spec)
        if not overwrite and _may_be_done(spec):
            provenance = provenance or make_provenance(spec)
            if step_state(spec, provenance).state == "done":
                summary = f"{spec.step}: up to date; --overwrite runs it again"
                return StepResult(spec.outputs(), summary, up_to_date=True)
        with not_written_since(() if overwrite else spec.paths(Writes)):
            check_outputs(spec, overwrite=overwrite)
            step = find_step(type(spec))
            made = provenance or make_provenance(spec)
            moved = (
                moved_rig(spec.rig) if isinstance(spec, MovedRigSpec) else contextlib.nullcontext()
            )
            with _one_blas_thread(), moved:
                progress(0.0, "reading")
                result = step(spec, provenance=made, progress=progress)
                progress(1.0, "done")
                return result
    except OSError as error:
        if error.errno != errno.ENAMETOOLONG:
            raise
        raise InputError(
            f"{error.filename}: the name is too long for this file system, or becomes so with the "
            f"suffixes of files that {spec.step} writes next to it; choose a shorter one"
        ) from error


def _may_be_done(spec: Spec) -> bool:
    """Whether a step is repeatable and its outputs exist; repeated edits would add up."""
    outputs = spec.outputs()
    repeatable = isinstance(spec, STEP_SPECS) and not spec.in_place
    return repeatable and bool(outputs) and all(path.is_file() for path in outputs)


def execute_each(
    specs: Sequence[Spec],
    *,
    folder: Path,
    out: Path,
    done_as: str,
    overwrite: bool = False,
    progress: Progress = silent,
) -> StepResult:
    """Run specs that write into one folder, creating it if needed; failures do not stop the others.

    `done_as` is the step as a participle for the message of failures, such as ``ingested``.
    """
    made = create_folder(out, remedy="choose another --out")
    done: list[StepResult] = []
    failed: list[str] = []
    for index, spec in enumerate(specs):
        share = part(progress, index / len(specs), (index + 1) / len(specs))
        try:
            done.append(execute(spec, overwrite=overwrite, progress=share))
        except InputError as error:
            failed.append(str(error))
    if failed and not done:
        for empty in made:
            with contextlib.suppress(OSError):  # not empty
                empty.rmdir()
    if failed:
        reasons = "\n".join(f"  {message}" for message in failed)
        raise CheckFailedError(
            f"{pluralize(len(done), 'take')} of {folder} {done_as}, "
            f"{len(failed)} failed:\n{reasons}"
        )
    return StepResult(
        tuple(path for result in done for path in result.outputs),
        f"{pluralize(len(done), 'take')} of {folder}",
        tuple(line for result in done for line in (result.summary, *result.notes)),
        {"takes": [result.as_data() for result in done]},
    )


def create_folder(folder: Path, *, remedy: str) -> list[Path]:
    """Create a folder and its parents; return the new ones, the innermost first."""
    new = [path for path in (folder, *folder.parents) if not path.exists()]
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"{folder}: cannot be created: {error.strerror}; {remedy}") from error
    return new
