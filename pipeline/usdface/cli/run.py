"""Run a job on the command line and print the results of its steps, also of earlier runs."""

import contextlib
import hashlib
import json
import os
import sys
from dataclasses import replace
from pathlib import Path

import typer

from usdface.cli.console import (
    INTERRUPTED_MESSAGE,
    ProgressStyle,
    echo,
    progress_listener,
    show_details,
    show_error,
    show_json,
    styled_summary,
)
from usdface.core.errors import CancelledError, InputError, UsdfaceError
from usdface.core.side_files import side_stream
from usdface.runner.job import JobEvents, JobStep, run_job
from usdface.runner.result import StepResult
from usdface.specs.job import JobSpec

_LARGEST_NOTES_BYTES = 16 << 20
"""A file of notes above this size is truncated."""


def run_and_show(
    job: JobSpec, file: Path, *, style: ProgressStyle, overwrite: bool, as_json: bool, again: bool
) -> None:
    """Run a job and print each step's result when it ends, also of steps before a failure.

    Parameters
    ----------
    file : Path
        The job's file; results are stored next to it.
    again : bool
        Print the stored results of steps that are up to date.
    """
    shown: list[StepResult] = []
    events = showing_events(file, shown, style=style, as_json=as_json, again=again)
    try:
        with progress_listener(style) as listener:
            run_job(job, progress=listener, overwrite=overwrite, events=events)
    except (UsdfaceError, KeyboardInterrupt) as error:
        kind = CancelledError if isinstance(error, KeyboardInterrupt) else type(error)
        message, steps = str(error) or INTERRUPTED_MESSAGE, len(job.steps)
        if steps > 1:
            message += f"\n{len(shown)} of {steps} steps are done; run again to continue"
        if not as_json:
            raise kind(message) from error
        show_json(_as_data(job, shown) | {"error": message, "exit_code": kind.exit_code})
        show_error(message)
        raise typer.Exit(kind.exit_code) from error
    if as_json:
        show_json(_as_data(job, shown))


def _as_data(job: JobSpec, shown: list[StepResult]) -> dict[str, object]:
    return {"job": job.job, "steps": [report.as_data() for report in shown]}


def showing_events(
    file: Path, shown: list[StepResult], *, style: ProgressStyle, as_json: bool, again: bool = False
) -> JobEvents:
    """Return callbacks that print and store the results of steps, and append them to `shown`."""
    stored = _StoredResults(file)

    def ended(step: JobStep, report: StepResult) -> None:
        if not report.up_to_date and style != "openjd":  # a farm's bundle must not change
            stored.add(step, report)
        if report.up_to_date and again:
            report = stored.of(step, report)
        shown.append(report)
        if not as_json:
            echo(f"{step.label}: {'up to date' if report.up_to_date else styled_summary(report)}")
            show_details(report)

    def started(step: JobStep) -> None:
        shows_bar = sys.stderr.isatty()
        if style == "auto" and not shows_bar and step.count > 1:
            typer.echo(f"{step.label} ...", err=True)

    return JobEvents(started, ended)


class _StoredResults:
    """Results of a job's steps, one line of JSON each, in a hidden file next to the job's.

    Nothing is stored if the file cannot be written or read, or lies outside ``USDFACE_ROOT``.
    """

    def __init__(self, job: Path) -> None:
        self._folder = job.resolve().parent
        self._file = job.with_name(f".{job.name}.notes")
        self._entries: dict[str, tuple[tuple[str, ...], tuple[str, ...]]] = {}
        stored = b""
        with (
            contextlib.suppress(OSError, ValueError, InputError),
            side_stream(self._file, "rb") as stream,
        ):
            stored = stream.read(_LARGEST_NOTES_BYTES + 1)
        for line in stored.splitlines() if len(stored) <= _LARGEST_NOTES_BYTES else ():
            with contextlib.suppress(ValueError, KeyError, TypeError):  # an incomplete line
                entry = json.loads(line)
                table, notes = (tuple(map(str, entry[name])) for name in ("table", "notes"))
                self._entries[entry["made"]] = table, notes

    def add(self, step: JobStep, report: StepResult) -> None:
        """Store the result of a step."""
        entry = {
            "made": self._key(step),
            "table": [report.summary, *report.table],
            "notes": report.notes,
        }
        text = json.dumps(entry, ensure_ascii=False, default=str)
        with (
            contextlib.suppress(OSError, ValueError, InputError),
            side_stream(self._file, "ab") as stream,
        ):
            if stream.tell() > _LARGEST_NOTES_BYTES:
                stream.truncate(0)
            stream.write(f"{text}\n".encode())

    def of(self, step: JobStep, report: StepResult) -> StepResult:
        """Return the result of a step that is up to date with its stored table and notes."""
        table, notes = self._entries.get(self._key(step), (("no stored notes",), ()))
        return replace(report, table=table, notes=notes)

    def _key(self, step: JobStep) -> str:
        made, paths = step.provenance, step.spec.outputs()
        files = [os.path.relpath(path.resolve(), self._folder) for path in paths]
        return hashlib.sha256(
            json.dumps([made.step, made.spec, dict(made.inputs), files]).encode()
        ).hexdigest()
