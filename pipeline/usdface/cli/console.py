"""How the command line speaks: results, progress, errors, signals, exit codes."""

import contextlib
import json
import logging
import math
import os
import signal
import sys
import threading
import time
from collections.abc import Iterator
from types import FrameType
from typing import Any, Literal

import typer

from usdface.core.errors import CancelledError, UsdfaceError
from usdface.core.progress import Progress as Listener
from usdface.core.progress import silent
from usdface.runner.result import StepResult

ProgressStyle = Literal["auto", "bar", "openjd", "none"]

STOPPED = "stopped on request; nothing half done was left"

RETRY_SECONDS = 0.05
"""An import is over in a second or two; a farm waits longer before it kills."""

LONGEST_FARM_MESSAGE = 1000
"""Farms cut or refuse longer lines."""

LEAST_FARM_PROGRESS = 0.01
LEAST_FARM_SECONDS = 1.0
"""What is nearer than both to what was said last is left out."""


@contextlib.contextmanager
def progress_listener(style: ProgressStyle) -> Iterator[Listener]:
    """Yield a listener that draws a bar on a terminal or speaks a farm's language."""
    if style == "openjd":
        try:
            yield _FarmProgress()
        except UsdfaceError as error:
            _say_to_farm("fail", str(error))
            raise
    elif style == "bar" or (style == "auto" and sys.stderr.isatty()):
        with _bar() as listener:
            yield listener
    else:
        yield silent


@contextlib.contextmanager
def _bar() -> Iterator[Listener]:
    # Takes as long to import as all else a command starts with, and only a terminal sees it.
    from rich.console import Console
    from rich.markup import escape
    from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

    columns = (TextColumn("{task.description}"), BarColumn(), TimeRemainingColumn())
    console = Console(stderr=True, highlight=False, soft_wrap=True)
    with Progress(*columns, console=console, transient=True) as bar:
        task = bar.add_task("", total=1.0)

        def report(fraction: float, message: str) -> None:
            bar.update(task, completed=fraction, description=escape(message))

        yield report


class _FarmProgress:
    """Speaks Open Job Description, which reads and keeps every line: so, not of every block."""

    def __init__(self) -> None:
        self._fraction = -math.inf
        self._when = -math.inf

    def __call__(self, fraction: float, message: str) -> None:
        fraction = min(max(fraction, 0.0), 1.0)
        now = time.monotonic()
        little = abs(fraction - self._fraction) < LEAST_FARM_PROGRESS
        if little and now - self._when < LEAST_FARM_SECONDS and fraction < 1.0:
            return
        self._fraction, self._when = fraction, now
        _say_to_farm("progress", f"{100 * fraction:.1f}")
        _say_to_farm("status", message)


def _say_to_farm(what: str, message: str) -> None:
    """Write one line: a line's end inside a file's name must not begin a second message."""
    line = "".join(each if each.isprintable() else " " for each in message)
    sys.stdout.write(f"openjd_{what}: {line[:LONGEST_FARM_MESSAGE]}\n")
    sys.stdout.flush()


def echo(line: str) -> None:
    """Print a line at once, whoever reads it: a person, or a pipe."""
    typer.echo(line)


def show_result(report: StepResult, *, as_json: bool) -> None:
    """Print a step's result for a person or for a script."""
    if as_json:
        show_json(report.as_data())
        return
    echo(report.summary)
    for line in report.table:
        echo(f"  {line}")
    for note in report.notes:
        echo(f"  note: {note}")
    for path in report.outputs if report.fresh else ():
        echo(f"  wrote {path}")


def show_json(data: Any) -> None:
    """Print data for a script: one JSON document, nothing beside it."""
    sys.stdout.write(json.dumps(data, indent=2, ensure_ascii=False, default=str) + "\n")


def show_error(message: str) -> None:
    """Print an error for a person; on a farm its first line becomes the task's status."""
    text = f"usdface: {message}"
    if "NO_COLOR" not in os.environ:  # as people ask of any command; only a terminal gets any
        text = typer.style(text, fg=typer.colors.RED, bold=True)
    typer.echo(text, err=True)


def set_up_logging(*, verbose: bool) -> None:
    """Send log records to stderr; only warnings unless verbose."""
    logging.basicConfig(
        level=logging.INFO if verbose else logging.WARNING,
        format="%(levelname)s %(name)s: %(message)s",
        stream=sys.stderr,
    )


def raise_on_signals() -> None:
    """Turn the one SIGTERM a farm sends into an exception, so that half files are removed.

    Inside an import it waits, and so does Ctrl+C: USD's loader would swallow the exception and go
    on with half of itself.
    """

    def stop(signum: int, frame: FrameType | None) -> None:
        if _is_importing(frame):
            again = threading.Timer(RETRY_SECONDS, os.kill, (os.getpid(), signum))
            again.daemon = True
            again.start()
            return
        raise KeyboardInterrupt if signum == signal.SIGINT else CancelledError(STOPPED)

    with contextlib.suppress(ValueError):  # only the main thread may set handlers
        signal.signal(signal.SIGTERM, stop)
        if signal.getsignal(signal.SIGINT) is signal.default_int_handler:  # else it is ignored
            signal.signal(signal.SIGINT, stop)


def _is_importing(frame: FrameType | None) -> bool:
    while frame is not None:
        if frame.f_code.co_filename.startswith("<frozen importlib"):
            return True
        frame = frame.f_back
    return False


def exit_code_of(error: BaseException) -> int:
    """Return what the process should exit with: 1 a check failed, 2 bad input, 3 interrupted."""
    if isinstance(error, UsdfaceError):
        return error.exit_code
    return CancelledError.exit_code if isinstance(error, KeyboardInterrupt) else 2
