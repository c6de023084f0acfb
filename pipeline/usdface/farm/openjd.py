"""Run a bundle on this machine, with Open Job Description's own command."""

from pathlib import Path

from usdface.farm.bundle import TEMPLATE
from usdface.farm.commands import find_command, run_command


def run_bundle(bundle: Path, *, quiet: bool = False) -> None:
    """Run every step of a bundle here, one task after the other.

    Parameters
    ----------
    bundle : Path
    quiet : bool
        Send what the command says to standard error, so that ours stays readable for scripts.

    Raises
    ------
    InputError
        If `openjd` is not installed.
    CheckFailedError
        If a task failed; what was done stays done, and running again goes on from there.
    """
    openjd = find_command(
        "openjd", "install usdface with its farm extra: pip install usdface[farm]"
    )
    run_command([openjd, "run", str(bundle / TEMPLATE)], quiet=quiet)
