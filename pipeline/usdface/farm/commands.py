"""Other programs, called with lists of arguments: no shell ever reads a name."""

import contextlib
import os
import shutil
import subprocess
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path

from usdface.core.errors import CheckFailedError, InputError

_LAST_WORDS_SECONDS = 60.0
"""What a farm's command gets to stop its tasks when it is told to."""


def find_command(name: str, remedy: str) -> str:
    """Return the path of a program: of this environment if it is there, else of the user's.

    Raises
    ------
    InputError
        If it is in neither.
    """
    found = shutil.which(name, path=_search_path())
    if found is None:
        raise InputError(f"{name}: no such command on this machine; {remedy}")
    return found


GOES_ON = "what was done stays done, and submitting again goes on from there"


def run_command(command: Sequence[str], *, quiet: bool = False, remedy: str = GOES_ON) -> None:
    """Run a program to its end.

    Parameters
    ----------
    command : sequence of str
        The program and its arguments.
    quiet : bool
        Send what it says to standard error.
    remedy : str
        What to tell where it fails.

    Raises
    ------
    CheckFailedError
        If it ends with another code than 0.
    """
    with running(command, quiet=quiet) as process:
        finish(process, Path(command[0]).name, remedy=remedy)


@contextlib.contextmanager
def running(
    command: Sequence[str], *, quiet: bool = False, told: bool = False
) -> Iterator[subprocess.Popen[str]]:
    """Yield a program that runs; where the block fails, it is told to stop, and so are its tasks.

    Parameters
    ----------
    command : sequence of str
        The program and its arguments.
    quiet : bool
        Send what it says to standard error.
    told : bool
        Whether the block writes to its standard input, which is empty otherwise.
    """
    # The tasks call `usdface`: the one that submits, not another that comes first on the path.
    environment = os.environ | {"PATH": _search_path()}
    sys.stdout.flush()
    with subprocess.Popen(
        list(command),
        env=environment,
        stdin=subprocess.PIPE if told else subprocess.DEVNULL,
        stdout=2 if quiet else None,
        text=True,
        encoding="utf-8",
    ) as process:
        try:
            yield process
        except BaseException:
            process.terminate()
            try:
                process.wait(_LAST_WORDS_SECONDS)
            except subprocess.TimeoutExpired:
                process.kill()
            raise


def finish(process: subprocess.Popen[str], name: str, *, remedy: str = GOES_ON) -> None:
    """Wait for a program.

    Raises
    ------
    CheckFailedError
        If it ends with another code than 0.
    """
    code = process.wait()
    if code:
        raise CheckFailedError(f"{name} ended with {code}; {remedy}")


def _search_path() -> str:
    here = str(Path(sys.executable).parent)
    return os.pathsep.join((here, os.environ.get("PATH", os.defpath)))
