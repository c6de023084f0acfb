"""Confinement of all files to a folder."""

import errno
import os
from collections.abc import Sequence
from pathlib import Path

from usdface.core.errors import InputError

ROOT_VARIABLE = "USDFACE_ROOT"
"""Environment variable with the folder to which all commands and steps are confined, for farms and
services."""


def confinement_root() -> Path | None:
    """Return the folder to which the environment confines all files, or None."""
    folder = os.environ.get(ROOT_VARIABLE, "")
    return Path(folder) if folder else None


def check_confined(paths: Sequence[tuple[str, Path]], root: Path | None = None) -> None:
    """Refuse paths that lead out of a folder, by default that of the environment, if it has one.

    After links are resolved. `paths`: each with the name of its reader or writer.
    """
    root = confinement_root() if root is None else root
    if root is None:
        return
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
    """Refuse a path through a cycle of links."""
    try:
        path.stat()
    except OSError as error:
        if error.errno == errno.ELOOP:
            raise InputError(
                f"{path}: is a link, or lies behind one, that leads back to itself; remove the link"
            ) from error


def check_may_open(path: Path, *, what: str = "open") -> None:
    """Refuse a file outside the folder to which the environment confines all files.

    Called by all readers and writers before they open a file, whatever named it.

    `what`: the operation, for the message.
    """
    check_confined([(what, path)])
