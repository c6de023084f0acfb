"""Output of the command line: results, progress, errors, signals, exit codes."""

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
from typing import Any, Literal, NoReturn

import typer

from usdface.core.errors import CancelledError, InputError, UsdfaceError
from usdface.core.progress import Progress as Listener
from usdface.core.progress import silent
from usdface.runner.result import StepResult

ProgressStyle = Literal["auto", "bar", "openjd", "none"]

INTERRUPTED_MESSAGE = "interrupted; no partly written files remain"

RETRY_SECONDS = 0.05
"""Interval after which a signal during an import is sent again; imports take a second or two."""

UNINTERRUPTIBLE_IMPORTS = frozenset({"pxr", "OpenImageIO"})
"""Packages in whose import an exception is not safe: USD's loader ignores it and continues partly
loaded, OpenImageIO's ends the process."""

LONGEST_FARM_MESSAGE = 1000
"""Characters; farms truncate or refuse longer lines."""

_LEVEL_COLORS = {"good": typer.colors.GREEN, "check": typer.colors.YELLOW, "bad": typer.colors.RED}

LEAST_FARM_PROGRESS = 0.01
LEAST_FARM_SECONDS = 1.0
"""Progress is printed if either has passed since the last line."""

QUIET_SECONDS = 2.0
"""Time before the first line without a terminal, so that short steps print none."""
LINE_SECONDS = 10.0
"""Interval of further lines."""


@contextlib.contextmanager
def progress_listener(style: ProgressStyle) -> Iterator[Listener]:
    """Yield a listener that shows a bar or lines, or prints Open Job Description messages."""
    if style == "openjd":
        try:
            yield _FarmProgress()
        except UsdfaceError as error:
            _print_farm_message("fail", str(error))
            raise
    elif style == "bar" or (style == "auto" and sys.stderr.isatty()):
        with _bar() as listener:
            yield listener
    elif style == "auto":
        yield _LineProgress()
    else:
        yield silent


@contextlib.contextmanager
def _bar() -> Iterator[Listener]:
    # rich doubles the import time, and only a terminal needs it.
    from rich.console import Console
    from rich.markup import escape
    from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

    columns = (TextColumn("{task.description}"), BarColumn(), TimeRemainingColumn())
    console = Console(stderr=True, highlight=False, soft_wrap=True)
    # Output is redirected through the bar, unless it goes to a file.
    on_terminal = sys.stdout.isatty()
    with Progress(*columns, console=console, transient=True, redirect_stdout=on_terminal) as bar:
        task = bar.add_task("", total=1.0)

        def report(fraction: float, message: str) -> None:
            bar.update(task, completed=fraction, description=escape(message))

        yield report


class _FarmProgress:
    """Prints Open Job Description messages, throttled as openjd stores every line."""

    def __init__(self) -> None:
        self._fraction = -math.inf
        self._when = -math.inf

    def __call__(self, fraction: float, message: str) -> None:
        fraction = min(max(fraction, 0.0), 1.0)
        now = time.monotonic()
        small = abs(fraction - self._fraction) < LEAST_FARM_PROGRESS
        if small and now - self._when < LEAST_FARM_SECONDS and fraction < 1.0:
            return
        self._fraction, self._when = fraction, now
        _print_farm_message("progress", f"{100 * fraction:.1f}")
        _print_farm_message("status", message)


class _LineProgress:
    """Prints a line on stderr every few seconds, for logs."""

    def __init__(self) -> None:
        self._next = time.monotonic() + QUIET_SECONDS

    def __call__(self, fraction: float, message: str) -> None:
        if time.monotonic() >= self._next and fraction < 1.0:
            self._next = time.monotonic() + LINE_SECONDS
            typer.echo(f"{fraction:4.0%} {message}", err=True)


def _print_farm_message(kind: str, message: str) -> None:
    """Print one line; a line break in a file name must not start a second message."""
    line = _visible(message).translate({ord(each): " " for each in "\n\t"})
    _print(f"openjd_{kind}: {line[:LONGEST_FARM_MESSAGE]}\n")


def echo(line: str) -> None:
    """Print a line and flush it, on a terminal and in a pipe."""
    _print(f"{line}\n")


def show_result(report: StepResult, *, as_json: bool) -> None:
    """Print a step's result for a person or for a script."""
    if as_json:
        show_json(report.as_data())
        return
    if report.level:  # a verdict is printed last, where it stays visible
        show_details(report)
    echo(styled_summary(report))
    if not report.level:
        show_details(report)


def styled_summary(report: StepResult) -> str:
    """Return the summary, on a terminal in the colour of its verdict."""
    plain = report.level not in _LEVEL_COLORS or not sys.stdout.isatty()
    summary = _visible(report.summary)
    if plain or "NO_COLOR" in os.environ:
        return summary
    return typer.style(summary, fg=_LEVEL_COLORS[report.level], bold=True)


def show_details(report: StepResult) -> None:
    """Print the table, the notes and the new files of a result."""
    for line in report.table:
        echo(f"  {_visible(line)}")
    for note in report.notes:
        echo(f"  note: {_visible(note)}")
    for path in () if report.up_to_date else report.outputs:
        echo(f"  wrote {path}")


def show_json(data: Any) -> None:
    """Print one JSON document for a script, in ASCII, which any locale can print."""
    _print(json.dumps(data, indent=2, default=str) + "\n")


def _visible(text: str) -> str:
    """Return text with spaces for the control characters of names in files."""
    return "".join(each if each.isprintable() or each in "\n\t" else " " for each in text)


def _print(text: str) -> None:
    """Write to standard output and flush; raise InputError if it cannot be written."""
    encoding = sys.stdout.encoding or "utf-8"  # may lack characters of names, as of ASCII
    try:
        sys.stdout.write(text.encode(encoding, "backslashreplace").decode(encoding))
        sys.stdout.flush()
    except BrokenPipeError:  # typer ends quietly
        raise
    except OSError as error:
        raise unwritable_output(error) from error


def unwritable_output(error: OSError) -> InputError:
    """Return the error for an unwritable standard output, and close that."""
    # Otherwise Python flushes it at exit and prints a second error.
    with contextlib.suppress(OSError), open(os.devnull, "w") as nowhere:  # noqa: PTH123
        os.dup2(nowhere.fileno(), sys.stdout.fileno())
    return InputError(
        f"standard output cannot be written ({error.strerror}), so the result is not printed; "
        "output files are complete. Redirect the output elsewhere"
    )


def show_error(message: str) -> None:
    """Print an error for a person; on a farm its first line becomes the task's status."""
    text = f"usdface: {_visible(message)}"
    if "NO_COLOR" not in os.environ:  # typer styles only on terminals
        text = typer.style(text, fg=typer.colors.RED, bold=True)
    typer.echo(text, err=True)


def set_up_logging(*, verbose: bool) -> None:
    """Send log records to stderr; only warnings unless verbose."""
    logging.basicConfig(
        level=logging.INFO if verbose else logging.WARNING,
        format="%(levelname)s %(name)s: %(message)s",
        stream=sys.stderr,
    )


_stopped = threading.Event()


def was_stopped() -> bool:
    """Return whether a signal was received, even if a library turned it into another error."""
    return _stopped.is_set()


def raise_on_signals() -> None:
    """Turn SIGTERM, which farms send once, into an exception, so that temporary files are removed.

    Both SIGTERM and Ctrl+C are delayed during imports of `UNINTERRUPTIBLE_IMPORTS`. If the
    exception is lost in a callback of a library, the signal is sent again.
    """

    def send_again(signum: int) -> None:
        again = threading.Timer(RETRY_SECONDS, os.kill, (os.getpid(), signum))
        again.daemon = True
        again.start()

    def stop(signum: int, frame: FrameType | None) -> None:
        imported = [*_imported_by(frame)]
        if any(name.partition(".")[0] in UNINTERRUPTIBLE_IMPORTS for name in imported):
            send_again(signum)
            return
        _stopped.set()
        # Modules that import others if they can may catch any other exception.
        raise (
            KeyboardInterrupt
            if signum == signal.SIGINT or imported
            else CancelledError(INTERRUPTED_MESSAGE)
        )

    def lost(unraisable: "sys.UnraisableHookArgs") -> None:
        kind = unraisable.exc_type
        if kind in (KeyboardInterrupt, CancelledError):
            send_again(signal.SIGINT if kind is KeyboardInterrupt else signal.SIGTERM)
        else:
            sys.__unraisablehook__(unraisable)

    _stopped.clear()
    sys.unraisablehook = lost
    with contextlib.suppress(ValueError):  # only the main thread may set handlers
        signal.signal(signal.SIGTERM, stop)
        if signal.getsignal(signal.SIGINT) is signal.default_int_handler:  # else ignored, by nohup
            signal.signal(signal.SIGINT, stop)


def exit_at_once(code: int) -> NoReturn:
    """End the process without waiting for its threads, and without clean-up by libraries.

    An exception while a thread pool starts, such as MediaPipe's, leaves a worker running, for which
    the interpreter would wait forever; OpenImageIO prints what an exception leaves of its objects.
    """
    for stream in (sys.stdout, sys.stderr):
        with contextlib.suppress(OSError):
            stream.flush()
    if "multiprocessing.util" in sys.modules:  # else its tracker warns of semaphores
        sys.modules["multiprocessing.util"]._run_finalizers(0)
    os._exit(code)


def _imported_by(frame: FrameType | None) -> Iterator[str]:
    """Yield the names of the modules whose import a frame is part of."""
    while frame is not None:
        caller = frame.f_back
        if caller is not None and caller.f_code.co_filename.startswith("<frozen importlib"):
            yield frame.f_globals.get("__name__", "")
        frame = caller


def exit_code_of(error: BaseException) -> int:
    """Return the exit code: 1 a check failed, 2 bad input, 3 interrupted."""
    if isinstance(error, UsdfaceError):
        return error.exit_code
    return CancelledError.exit_code if isinstance(error, KeyboardInterrupt) else 2
