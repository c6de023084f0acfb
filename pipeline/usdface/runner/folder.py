"""One step for every file of a folder; what fails does not stop the others."""

from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path

from usdface.core.errors import CheckFailedError, InputError
from usdface.core.progress import Progress, part, silent
from usdface.core.text import pluralize
from usdface.runner.execute import execute
from usdface.runner.result import StepResult
from usdface.specs.base import Spec


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
