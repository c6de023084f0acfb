"""Hand a bundle to Deadline Cloud, with its own command."""

from pathlib import Path

from usdface.farm.commands import find_command, run_command


def submit_bundle(bundle: Path, *, priority: int | None = None, quiet: bool = False) -> None:
    """Submit a bundle to the farm and queue that `deadline config` names.

    Raises
    ------
    InputError
        If `deadline` is not installed.
    CheckFailedError
        If it refuses the bundle.
    """
    deadline = find_command("deadline", "install it with: pip install deadline")
    command = [deadline, "bundle", "submit", str(bundle), "--yes", "--submitter-name", "usdface"]
    if priority is not None:
        command += ["--priority", str(priority)]
    run_command(command, quiet=quiet)
