"""Hand a bundle to Deadline Cloud, with its own command."""

from collections.abc import Sequence
from pathlib import Path

from usdface.farm.commands import find_command, run_command
from usdface.farm.plan import FarmStep
from usdface.specs.paths import Reads, Writes

NOT_TAKEN = (
    "the job was not submitted, and what deadline says above is why; `deadline config` names farm, "
    "queue and known asset paths"
)


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
    deadline = find_command("deadline", "install it with: pip install deadline")
    command = [deadline, "bundle", "submit", str(bundle), "--yes", "--submitter-name", "usdface"]
    for folder in named_folders(steps):
        command += ["--known-asset-path", str(folder)]
    if priority is not None:
        command += ["--priority", str(priority)]
    run_command(command, quiet=quiet, remedy=NOT_TAKEN)


def named_folders(steps: Sequence[FarmStep]) -> list[Path]:
    """Return the folders of the files that tasks name, without those inside others, nor ``/``."""
    tasks = [task for step in steps for task in step.tasks]
    named = {path.parent for task in tasks for path in (*task.paths(Reads), *task.paths(Writes))}
    named = {folder for folder in named if folder.parent != folder}  # everything lies in the root
    return sorted(folder for folder in named if named.isdisjoint(folder.parents))
