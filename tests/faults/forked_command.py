"""A command in a forked process that has imported everything, and leads a group of processes."""

import os
import signal
import sys
from itertools import count
from multiprocessing import get_context
from multiprocessing.context import ForkServerContext
from pathlib import Path

from usdface.specs.job import STEP_SPECS


def forking() -> ForkServerContext:
    """Return a context whose processes are forked from one that has imported all commands."""
    context = get_context("forkserver")
    steps = [f"usdface.steps.{spec.module}" for spec in STEP_SPECS]
    commands = ["usdface.cli.app", "usdface.tuning.serve", *steps]
    context.set_forkserver_preload(["tests.remembered", "tests.faults.forked_command", *commands])
    return context


def run_forked(folder: str, arguments: list[str], killed_at: int | None = None) -> None:
    """Run a command in a folder, its messages in the file ``.stderr`` there.

    Parameters
    ----------
    killed_at : int, optional
        The rename, counted from 0, before which the process kills itself.
    """
    os.setsid()
    os.chdir(folder)
    output = os.open(os.devnull, os.O_WRONLY)
    errors = os.open(Path(folder) / ".stderr", os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
    os.dup2(output, 1)
    os.dup2(errors, 2)
    if killed_at is not None:
        _kill_before_rename(killed_at)
    from usdface.cli import main

    sys.argv = ["usdface", *arguments]
    main()


def _kill_before_rename(number: int) -> None:
    numbers, rename = count(), Path.replace

    def replace(path: Path, target: Path) -> Path:
        if next(numbers) == number:
            os.kill(os.getpid(), signal.SIGKILL)
        return rename(path, target)

    Path.replace = replace  # type: ignore[method-assign, assignment]
