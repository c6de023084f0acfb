"""Hand a bundle to OpenCue: an outline with a layer per farm step, a frame per task."""

import importlib
import re
import shlex
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from usdface.core.errors import CheckFailedError, InputError
from usdface.farm.plan import FarmStep
from usdface.farm.template import TASKS, task_command
from usdface.specs.base import Spec
from usdface.specs.job import SPEC_BY_STEP

_FRAME = "#IFRAME#"
"""What OpenCue replaces by a frame's number when it runs a command."""


def build_outline(
    name: str, steps: Sequence[FarmStep], bundle: Path, *, priority: int | None = None
) -> Any:
    """Return the launcher of a bundle's outline; nothing is sent yet.

    Commands reach a worker's shell as text, so the bundle's path is quoted; nothing else in them
    comes from data. OpenCue knows no path mapping: workers must see the files where this machine
    does.

    Parameters
    ----------
    name : str
        The job's; what OpenCue does not allow in a name becomes ``_``.
    bundle : Path
        Where workers find it.

    Raises
    ------
    InputError
        If pyoutline is not installed, or the bundle's path would confuse OpenCue.
    """
    outline, shell, cuerun = _pyoutline()
    if _FRAME[:2] in str(bundle):
        raise InputError(f"{bundle}: {_FRAME[:2]!r} in a path means a frame to OpenCue; rename it")
    longest = max(len(step.tasks) for step in steps)
    # A layer whose frames lie outside the outline's is dropped without a word.
    job = outline.Outline(name=_allowed(name), frame_range=f"1-{longest}")
    for step in steps:
        needs = SPEC_BY_STEP.get(step.kind, Spec)
        spec = bundle.absolute() / TASKS / step.name / f"{_FRAME}.yaml"
        layer = shell.Shell(
            _allowed(step.name),
            command=[shlex.quote(word) for word in task_command(str(spec))],
            range=f"1-{len(step.tasks)}",
            chunk=1,
            cores=float(needs.cores),
            memory=f"{needs.memory_mib}m",
        )
        job.add_layer(layer)
        for needed in step.needs:
            layer.depend_all(job.get_layer(_allowed(needed)))
    flags = {} if priority is None else {"priority": priority}
    return cuerun.OutlineLauncher(job, **flags)


def outline_text(launcher: Any) -> str:
    """Return the job as the XML that OpenCue is sent."""
    return str(launcher.serialize(use_pycuerun=False))


def submit_outline(launcher: Any) -> None:
    """Send an outline to OpenCue; workers run our command alone, they need no pyoutline.

    Raises
    ------
    CheckFailedError
        If OpenCue cannot be reached or refuses the job.
    """
    try:
        launcher.launch(use_pycuerun=False)
    except Exception as error:  # pyoutline hands on whatever its transport raises
        raise CheckFailedError(f"OpenCue: {type(error).__name__}: {error}") from error


def _pyoutline() -> tuple[Any, Any, Any]:
    try:
        return tuple(  # type: ignore[return-value]
            importlib.import_module(name)
            for name in ("outline", "outline.modules.shell", "outline.cuerun")
        )
    except ImportError as error:
        raise InputError(
            f"pyoutline cannot be imported ({error}); install it with: pip install "
            "opencue-pyoutline opencue-pycue"
        ) from error


def _allowed(name: str) -> str:
    return re.sub(r"[^A-Za-z0-9_-]", "_", name)
