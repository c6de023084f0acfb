"""Public Python API: run steps and jobs, check layers, read assets. See docs/python.md."""

import contextlib
import csv
import hashlib
import io
import re
from collections.abc import Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from usdface.core.assets import Performance, References, Rig, Take, TrainedMapping
from usdface.core.errors import InputError, UsdfaceError
from usdface.core.progress import Progress, silent
from usdface.core.replacing import write_text
from usdface.runner import job as jobs
from usdface.runner.execute import execute
from usdface.runner.outputs import confine
from usdface.runner.result import StepResult
from usdface.runner.state import StepState, job_states
from usdface.specs.job import SPEC_BY_STEP
from usdface.specs.reading import read_job, validation_messages
from usdface.specs.references import ReferencesImportSpec
from usdface.steps.edits.validate import check_layer
from usdface.usdio import mapping as mapping_files
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
    """Run one step, like the command of that name.

    Parameters
    ----------
    step : str
        Name as in a job: ``"map"``, ``"references-import"``, ...
    overwrite : bool
        Replace existing outputs, including newer files and files of other programs.
    progress : callable
        Called with the fraction done and a message.
    **values
        The step's options, with underscores: ``take=..., mapping=..., rig=..., out=...``. The
        `weights` of ``references-import`` may be a table instead of a file: ``{frame: {shape:
        weight}}``, columns by name, one of them ``frame``, or a DataFrame of such columns. It is
        written next to the references, as the provenance of the result names it.

    Returns
    -------
    StepResult
        Its `up_to_date` is true if the outputs existed, made from the same inputs and options.

    Raises
    ------
    InputError
        If there is no such step, an option is wrong, or an input cannot be used.
    """
    spec = SPEC_BY_STEP.get(step)
    if spec is None:
        raise InputError(f"no step {step!r}; there are {', '.join(SPEC_BY_STEP)}")
    with _options_as_arguments():
        table, references = values.get("weights"), values.get("references")
        if spec is ReferencesImportSpec and not isinstance(table, str | Path | None):
            if not isinstance(references, str | Path):
                raise InputError(f"references: {references!r}, expected the file of references")
            values["weights"] = _write_table(table, Path(references))
        try:
            made = spec.model_validate(values)
        except ValidationError as error:
            raise InputError(validation_messages(error, spec)) from error
        result = execute(made, overwrite=overwrite, progress=progress)
    notes = tuple(map(_in_python, result.notes))
    return replace(result, summary=_in_python(result.summary), notes=notes)


@contextlib.contextmanager
def _options_as_arguments() -> Iterator[None]:
    """Name options in errors as Python arguments: ``overwrite=True`` for ``--overwrite``."""
    try:
        yield
    except UsdfaceError as error:
        raise type(error)(_in_python(str(error))) from error


_OPTION = re.compile(r"--(no-)?([a-z][a-z-]*[a-z])\b")
_SWITCHES = {
    f"{'no-' if value is False else ''}{name.replace('_', '-')}"
    for spec in SPEC_BY_STEP.values()
    for name, field in spec.model_fields.items()
    if field.annotation is bool
    for value in (True, False)
} | {"overwrite"}


def _in_python(message: str) -> str:
    """Return a message with command-line options replaced by Python arguments."""
    message = message.replace("--overwrite it", "--overwrite")

    def argument(found: re.Match[str]) -> str:
        name = found[2].replace("-", "_")
        if f"{found[1] or ''}{found[2]}" in _SWITCHES:
            return f"{name}={not found[1]}"
        return f"{name}="

    return _OPTION.sub(argument, message)


def _write_table(table: Any, references: Path) -> Path:
    """Write a table of weights next to the references, with a hash of its content in the name."""
    if hasattr(table, "to_dict"):  # a DataFrame
        table = table.to_dict("list")
    if not isinstance(table, Mapping) or not table:
        raise InputError(
            f"weights: {type(table).__name__}, expected a file, {{frame: {{shape: weight}}}}, or "
            "columns by name, one of them `frame`"
        )
    if "frame" in table:
        names = ["frame", *(str(name) for name in table if name != "frame")]
        columns = [list(table[name]) for name in ("frame", *(n for n in table if n != "frame"))]
        if len({len(column) for column in columns}) != 1:
            raise InputError("weights: columns of different lengths; give one value per frame")
        rows = [list(row) for row in zip(*columns, strict=True)]
    else:
        if not all(isinstance(row, Mapping) for row in table.values()):
            raise InputError("weights: no column `frame`; add it, or give {frame: {shape: weight}}")
        shapes = list(dict.fromkeys(shape for row in table.values() for shape in row))
        if any(len(row) != len(shapes) for row in table.values()):
            raise InputError("weights: frames name different shapes; give each the same shapes")
        names = ["frame", *map(str, shapes)]
        rows = [[frame, *(row[shape] for shape in shapes)] for frame, row in table.items()]
    text = io.StringIO()
    csv.writer(text, lineterminator="\n").writerows([names, *rows])
    digest = hashlib.sha256(text.getvalue().encode()).hexdigest()[:8]
    path = references.with_name(f"{references.stem}.weights-{digest}.csv")
    confine("references-import", writes=[path])
    if not path.exists():
        write_text(path, text.getvalue())
    return path


def run_job(
    job: Path | str, *, overwrite: bool = False, progress: Progress = silent
) -> list[StepResult]:
    """Run the steps of a job file that are missing or out of date.

    Raises
    ------
    InputError
        If the job cannot be read, or a step fails.
    CheckFailedError
        If a check of a step failed.
    """
    with _options_as_arguments():
        return jobs.run_job(read_job(Path(job)), overwrite=overwrite, progress=progress)


def check_job(job: Path | str) -> list[StepState]:
    """Return the state of each step of a job file, done, stale or missing, without running any."""
    return job_states(read_job(Path(job)))


def validate(layer: Path | str) -> list[Finding]:
    """Return the findings of the validators of USD and usdface, and the verdict, on a USD file."""
    return check_layer(Path(layer))


def read_take(file: Path | str, *, first: int | None = None, last: int | None = None) -> Take:
    """Read a take, or its frames `first` to `last`, inclusive."""
    return take_files.read_take(Path(file), first=first, last=last)


def read_rig(file: Path | str, *, prim: str | None = None) -> Rig:
    """Read a rig; `prim` names the face if the file holds several."""
    return rig_files.read_rig(Path(file), prim=prim)


def read_references(file: Path | str) -> References:
    """Read a references asset: tuned weights where there are any, else proposals."""
    return references_files.read_references(Path(file))


def read_mapping(file: Path | str) -> TrainedMapping:
    """Read a trained mapping."""
    return mapping_files.read_mapping(Path(file))


def read_performance(file: Path | str) -> Performance:
    """Read a performance: the weights of its solve with the edits."""
    return performance_files.read_performance(Path(file))
