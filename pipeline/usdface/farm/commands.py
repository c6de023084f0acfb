"""Farms' own commands, called with lists of arguments: no shell ever reads a name."""

import os
import shutil
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

from usdface.core.errors import CheckFailedError, InputError
from usdface.farm.bundle import TEMPLATE
from usdface.farm.plan import FarmStep
from usdface.specs.paths import Reads, Writes

_STOP_SECONDS = 60.0
"""What a farm's command gets to stop its tasks when it is terminated."""

_RUN_AGAIN = "what was done stays done, and submitting again goes on from there"
_NOT_TAKEN = (
    "the job was not submitted, and what deadline says above is why; `deadline config` names farm, "
    "queue and known asset paths"
)


def run_bundle(bundle: Path, *, quiet: bool = False) -> None:
    """Run every step of a bundle on this machine, one task after the other, with `openjd`.

    Parameters
    ----------
    bundle : Path
        The folder.
    quiet : bool
        Send what the command says to standard error, so that ours stays readable for scripts.

    Raises
    ------
    InputError
        If `openjd` is not installed.
    CheckFailedError
        If a task fails; what was done stays done, and running again goes on from there.
    """
    openjd = _find_command(
        "openjd", "install usdface with its farm extra: pip install usdface[farm]"
    )
    _run_command([openjd, "run", str(bundle / TEMPLATE)], quiet=quiet, remedy=_RUN_AGAIN)


def submit_bundle(
    bundle: Path, *, steps: Sequence[FarmStep], priority: int | None = None, quiet: bool = False
) -> None:
    """Submit a bundle to the farm and queue that `deadline config` names.

    Of job attachments, `deadline` takes only those without a question that lie in folders declared
    known: those that the job itself names are. What a layer refers to elsewhere is for the user to
    allow, in `deadline config`: the layer may be somebody else's.

    Raises
    ------
    InputError
        If `deadline` is not installed.
    CheckFailedError
        If it refuses the bundle.
    """
    deadline = _find_command("deadline", "install it with: pip install deadline")
    command = [deadline, "bundle", "submit", str(bundle), "--yes", "--submitter-name", "usdface"]
    for folder in named_folders(steps):
        command += ["--known-asset-path", str(folder)]
    if priority is not None:
        command += ["--priority", str(priority)]
    _run_command(command, quiet=quiet, remedy=_NOT_TAKEN)


def named_folders(steps: Sequence[FarmStep]) -> list[Path]:
    """Return the folders of the files that tasks name, without those inside others, nor ``/``."""
    tasks = [task for step in steps for task in step.tasks]
    named = {path.parent for task in tasks for path in (*task.paths(Reads), *task.paths(Writes))}
    named = {folder for folder in named if folder.parent != folder}  # everything lies in the root
    return sorted(folder for folder in named if named.isdisjoint(folder.parents))


def _find_command(name: str, remedy: str) -> str:
    """Return the path of a program: of this environment if it is there, else of the user's."""
    found = shutil.which(name, path=_search_path())
    if found is None:
        raise InputError(f"{name}: no such command on this machine; {remedy}")
    return found


def _run_command(command: Sequence[str], *, quiet: bool, remedy: str) -> None:
    """Run a program to its end; where this process is interrupted, terminate it and its tasks."""
    # The tasks call `usdface`: the one that submits, not another that comes first on the path.
    environment = os.environ | {"PATH": _search_path()}
    sys.stdout.flush()
    with subprocess.Popen(
        list(command),
        env=environment,
        stdin=subprocess.DEVNULL,
        stdout=2 if quiet else None,
    ) as process:
        try:
            code = process.wait()
        except BaseException:
            process.terminate()
            try:
                process.wait(_STOP_SECONDS)
            except subprocess.TimeoutExpired:
                process.kill()
            raise
    if code:
        raise CheckFailedError(f"{Path(command[0]).name} ended with {code}; {remedy}")


def _search_path() -> str:
    here = str(Path(sys.executable).parent)
    return os.pathsep.join((here, os.environ.get("PATH", os.defpath)))
