"""The folder that all work is confined to, and whether a path leads out of it."""

import errno
import os
from collections.abc import Sequence
from pathlib import Path

from usdface.core.errors import InputError

ROOT_VARIABLE = "USDFACE_ROOT"
"""Environment variable: folder that confines every command and step, for a farm or a service that
runs jobs of others."""


def confinement_root() -> Path | None:
    """Return the folder that the environment confines all work to; None if not set."""
    folder = os.environ.get(ROOT_VARIABLE, "")
    return Path(folder) if folder else None


def check_confined(paths: Sequence[tuple[str, Path]], root: Path) -> None:
    """Refuse paths outside a folder: absolute, by ``..`` or by a link.

    Links are followed, those of folders on the way included: what counts is where the file is.

    Parameters
    ----------
    paths : sequence of (str, Path)
        Each with the name of what reads or writes it.
    """
    if not root.is_dir():
        raise InputError(f"{root}: no such folder, so nothing can be confined to it")
    top = root.resolve()
    faults = []
    for what, path in paths:
        check_no_loop(path)
        real = path.resolve()
        if not real.is_relative_to(top):
            plainly = Path(os.path.normpath(path.absolute()))  # a folder up is no link
            by = " (by a link)" if plainly.is_relative_to(top) else ""
            faults.append(f"{what}: {path}: lies outside {root}{by}, at {real}")
    if faults:
        raise InputError("\n".join(faults) + "\nmove the files below it, or ask for another root")


def check_no_loop(path: Path) -> None:
    """Refuse a path by a link that leads back to itself: where the file is cannot be said."""
    try:
        path.stat()
    except OSError as error:
        if error.errno == errno.ELOOP:
            raise InputError(
                f"{path}: is a link, or lies behind one, that leads back to itself; remove the link"
            ) from error


def check_may_open(path: Path, *, what: str = "open") -> None:
    """Refuse a file outside the folder that the environment confines all work to.

    Whatever named it: readers ask here as they open a file, and writers before they make one, so
    that no way of coming by a path leads out. Without such a folder every file may be opened.

    Parameters
    ----------
    what : str
        What is about to be done, for the message.
    """
    root = confinement_root()
    if root is not None:
        check_confined([(what, path)], root)
