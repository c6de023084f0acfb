"""Work kept below one folder: nothing outside it is read or written, whichever way it is named."""

import os
from collections.abc import Sequence
from pathlib import Path

from usdface.errors import InputError
from usdface.specs.base import Reads, Spec, Writes

VARIABLE = "USDFACE_ROOT"
"""Environment variable that confines every command and step: for a farm, or a service that runs
what others send."""


def confinement_root() -> Path | None:
    """Return the folder that the environment confines all work to; None where it does not."""
    told = os.environ.get(VARIABLE, "")
    return Path(told) if told else None


def check_confined(specs: tuple[Spec, ...], root: Path) -> None:
    """Refuse specs with a path outside a folder, by ``..``, by a link, or plainly.

    Links are followed, those of folders on the way included: what counts is where the file is.

    Raises
    ------
    InputError
        If the folder does not exist, or naming every path that lies outside.
    """
    check_paths_confined(
        [
            (spec.step, path)
            for spec in specs
            for path in dict.fromkeys((*spec.paths(Reads), *spec.paths(Writes), *spec.changes()))
        ],
        root,
    )


def check_paths_confined(paths: Sequence[tuple[str, Path]], root: Path) -> None:
    """Refuse paths outside a folder, as `check_confined` does.

    Parameters
    ----------
    paths : sequence of (str, Path)
        Each with the name of what reads or writes it.
    root : Path

    Raises
    ------
    InputError
        If the folder does not exist, or naming every path that lies outside.
    """
    if not root.is_dir():
        raise InputError(f"{root}: no such folder, so nothing can be confined to it")
    top = root.resolve()
    faults = []
    for what, path in paths:
        real = path.resolve()
        if not real.is_relative_to(top):
            plainly = Path(os.path.normpath(path.absolute()))  # a folder up is no link
            by = " (by a link)" if plainly.is_relative_to(top) else ""
            faults.append(f"{what}: {path}: lies outside {root}{by}, at {real}")
    if faults:
        raise InputError("\n".join(faults) + "\nmove the files below it, or ask for another root")
