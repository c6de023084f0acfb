"""A command in a forked process that has imported everything, and leads a group of processes."""

import os
from pathlib import Path

from usdface.specs.job import STEP_SPECS


def preloaded() -> list[str]:
    """Return the modules that the process forked from imports once."""
    steps = [f"usdface.steps.{spec.module}" for spec in STEP_SPECS]
    return ["usdface.cli", "tests.faults.forked_command", *steps]


def run_forked(folder: str, arguments: list[str]) -> None:
    """Run a command in a folder, its messages in the file ``.stderr`` there."""
    os.setsid()
    os.chdir(folder)
    output = os.open(os.devnull, os.O_WRONLY)
    errors = os.open(Path(folder) / ".stderr", os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
    os.dup2(output, 1)
    os.dup2(errors, 2)
    from usdface.cli import main

    main(arguments)
