"""Run the step that a spec describes, or one step for every file of a folder."""

import contextlib
import errno
import os
from collections.abc import Callable, Iterator, Sequence
from contextlib import nullcontext, suppress
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
    """Return a step's function; its module is imported only now, so that others start quickly."""
    step: Step = import_module(f"usdface.steps.{spec.module}").run
    return step


@contextlib.contextmanager
def _one_blas_thread() -> Iterator[None]:
    """Keep linear algebra to one thread: a sum over more of them is rounded otherwise.

    The same inputs then give the same bytes in any host, whatever it set for itself.
    """
    if os.environ.get("OPENBLAS_NUM_THREADS") != "1":
        # SciPy has a library of its own, which would begin with a thread for each core.
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
        Replace outputs whoever wrote them and however new they are.

    Raises
    ------
    InputError
        If an input is missing or cannot be used, an output must not be replaced, or a path lies
        outside the folder that ``USDFACE_ROOT`` confines all work to.
    """
    try:
        check_inputs(spec)
        if not overwrite and _may_be_done(spec):
            provenance = provenance or make_provenance(spec)
            if step_state(spec, provenance).state == "done":
                summary = f"{spec.step}: up to date; --overwrite makes it anew"
                return StepResult(spec.outputs(), summary, fresh=False)
        with not_written_since(() if overwrite else spec.paths(Writes)):
            check_outputs(spec, overwrite=overwrite)
            step = find_step(type(spec))
            made = provenance or make_provenance(spec)
            moved = moved_rig(spec.rig) if isinstance(spec, MovedRigSpec) else nullcontext()
            with _one_blas_thread(), moved:
                return step(spec, provenance=made, progress=progress)
    except OSError as error:
        if error.errno != errno.ENAMETOOLONG:
            raise
        raise InputError(
            f"{error.filename}: a name that is too long for this file system, or that becomes so "
            f"with what {spec.step} writes beside it; choose a shorter one"
        ) from error


def _may_be_done(spec: Spec) -> bool:
    """Whether a step is one that a job may repeat, and its outputs are there; edits add up."""
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
) -> list[StepResult]:
    """Run specs that write into one folder, which is made if it is not there.

    What fails does not stop the others.

    Parameters
    ----------
    folder : Path
        What the specs read from, for messages.
    done_as : str
        The step as a participle: ``ingested``.

    Raises
    ------
    InputError
        If `out` cannot be made.
    CheckFailedError
        If some failed; each is named with its reason.
    """
    made = _make_folder(out)
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
            with suppress(OSError):  # whatever lies in it stays
                empty.rmdir()
    if failed:
        reasons = "\n".join(f"  {message}" for message in failed)
        raise CheckFailedError(
            f"{pluralize(len(done), 'take')} of {folder} {done_as}, "
            f"{len(failed)} could not be:\n{reasons}"
        )
    return done


def _make_folder(folder: Path) -> list[Path]:
    """Make a folder with those above it, and return the new ones, the innermost first."""
    new = [path for path in (folder, *folder.parents) if not path.exists()]
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(
            f"{folder}: cannot be made: {error.strerror}; choose another --out"
        ) from error
    return new
