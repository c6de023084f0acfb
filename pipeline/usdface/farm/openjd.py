"""Run a bundle on this machine, with Open Job Description's own command."""

import contextlib
import importlib.util
import json
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

from usdface.farm.bundle import TEMPLATE
from usdface.farm.commands import find_command, finish, run_command, running

_NAME = "openjd"


@contextlib.contextmanager
def local_farm(*, quiet: bool = False) -> Iterator[Callable[[Path], None]]:
    """Yield what runs every step of a bundle here, one task after the other.

    The command takes as long to start as USD does, with which a job is planned: it starts at once,
    and waits to be told of the bundle.

    Parameters
    ----------
    quiet : bool
        Send what the command says to standard error, so that ours stays readable for scripts.

    Raises
    ------
    InputError
        If `openjd` is not installed.
    CheckFailedError
        When a bundle is run, if a task fails; what was done stays done, and running again goes on
        from there.
    """
    if not _is_ours():
        command = find_command(
            _NAME, "install usdface with its farm extra: pip install usdface[farm]"
        )
        yield lambda bundle: run_command([command, "run", str(bundle / TEMPLATE)], quiet=quiet)
        return
    waiting = [sys.executable, "-m", "usdface.farm.openjd_process"]
    with running(waiting, quiet=quiet, told=True) as process:

        def run(bundle: Path) -> None:
            process.communicate(json.dumps(str(bundle / TEMPLATE)))
            finish(process, _NAME)

        yield run


def _is_ours() -> bool:
    """Whether `openjd` is installed beside us, and not elsewhere on the path."""
    try:
        return importlib.util.find_spec("openjd.cli") is not None
    except ModuleNotFoundError:
        return False
