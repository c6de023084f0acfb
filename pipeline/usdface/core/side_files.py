"""Files and folders beside a file: locks, journals, temporaries, pictures. None is ever a link.

Their names follow from the name of an output, so anybody who may write to its folder can put a
link there first, to a file or a folder of whoever runs usdface. All of them are opened here.
"""

import contextlib
import errno
import os
import re
import stat
from collections.abc import Iterator
from pathlib import Path
from typing import IO, Any

from usdface.core.confinement import check_may_open, confinement_root
from usdface.core.errors import InputError

_NO_LINK = getattr(os, "O_NOFOLLOW", 0) | getattr(os, "O_CLOEXEC", 0)
_NO_WAIT = getattr(os, "O_NONBLOCK", 0)
"""Not to wait for whoever would write to a pipe."""
_LISTED = getattr(os, "O_DIRECTORY", 0) | _NO_LINK
# A folder that may be entered and not listed is enough to open names in.
_FOLDER = getattr(os, "O_PATH", os.O_RDONLY) | _LISTED
_BY_FOLDER = os.open in os.supports_dir_fd
"""Whether the system opens a name in an open folder; Windows does not."""


def open_side_file(path: Path, flags: int) -> int:
    """Open a file beside another, and nothing that a link leads to.

    Parameters
    ----------
    flags : int
        As `os.open` takes them.

    Returns
    -------
    int
        Descriptor of a regular file; close it.

    Raises
    ------
    InputError
        If there is a link, a pipe, a device or a folder in its place, or its folder lies outside
        the one that all work is confined to.
    OSError
        If it cannot be opened.
    """
    with _opened_folder(path.parent) as folder:
        try:
            name = path if folder is None else path.name
            handle = os.open(name, flags | _NO_LINK | _NO_WAIT, 0o666, dir_fd=folder)
        except OSError as error:
            if error.errno in (errno.ELOOP, errno.EMLINK, errno.ENXIO):
                raise _not_plain_error(path) from error
            raise
    if not stat.S_ISREG(os.fstat(handle).st_mode) or (folder is None and path.is_symlink()):
        os.close(handle)
        raise _not_plain_error(path)
    return handle


def side_stream(path: Path, mode: str) -> IO[Any]:
    """Open a file beside another as a stream of bytes; see `open_side_file`."""
    return open(path, mode, opener=lambda _, flags: open_side_file(path, flags))


def make_side_folder(folder: Path) -> None:
    """Make a folder beside a file, if it is not there."""
    try:
        with _opened_folder(folder.parent) as parent, contextlib.suppress(FileExistsError):
            os.mkdir(folder if parent is None else folder.name, dir_fd=parent)
    except OSError as error:
        raise InputError(f"{folder}: cannot be written to ({error.strerror})") from error
    check_side_folder(folder)


def check_side_folder(folder: Path) -> None:
    """Refuse a link, or a file, in the place of a folder; that it is missing is no fault."""
    with contextlib.suppress(FileNotFoundError):
        if not stat.S_ISDIR(folder.lstat().st_mode):
            raise _not_plain_error(folder, kind="folder")


def clear_side_folder(folder: Path, pattern: str, *, keep: frozenset[str] = frozenset()) -> None:
    """Remove the files of a folder whose names match; what others put there stays."""
    check_side_folder(folder)
    try:
        with _opened_folder(folder.parent) as parent:
            _clear(folder, parent, re.compile(pattern), keep)
    except FileNotFoundError:
        return
    except OSError as error:
        raise InputError(f"{folder}: cannot be written to ({error.strerror})") from error


@contextlib.contextmanager
def emptied_side_folder(folder: Path) -> Iterator[Path]:
    """Make a folder, empty it of what a killed process left, and remove it with all in it."""
    make_side_folder(folder)
    clear_side_folder(folder, ".*")
    try:
        yield folder
    finally:
        with contextlib.suppress(InputError, OSError):
            clear_side_folder(folder, ".*")
            folder.rmdir()


def _clear(
    folder: Path, parent: int | None, pattern: re.Pattern[str], keep: frozenset[str]
) -> None:
    if parent is None:
        for path in folder.iterdir():
            if pattern.fullmatch(path.name) and path.name not in keep:
                path.unlink()
        return
    handle = os.open(folder.name, os.O_RDONLY | _LISTED, dir_fd=parent)
    try:
        for name in os.listdir(handle):  # noqa: PTH208  # the open folder, whatever its name
            if pattern.fullmatch(name) and name not in keep:
                os.unlink(name, dir_fd=handle)
    finally:
        os.close(handle)


@contextlib.contextmanager
def _opened_folder(folder: Path) -> Iterator[int | None]:
    """Open a folder, so that what is opened in it lies there whatever is renamed meanwhile.

    Confined, the way from the root is walked folder by folder, and none may be a link by then.
    """
    check_may_open(folder, what="write to")
    if not _BY_FOLDER:
        yield None
        return
    root = confinement_root()
    top = folder.resolve() if root is None else root.resolve()
    parts = folder.resolve().relative_to(top).parts
    handle = os.open(top, _FOLDER)
    try:
        for part in parts:
            inner = os.open(part, _FOLDER, dir_fd=handle)
            os.close(handle)
            handle = inner
        yield handle
    finally:
        os.close(handle)


def _not_plain_error(path: Path, *, kind: str = "file") -> InputError:
    found = "a link" if path.is_symlink() else "something else"
    return InputError(
        f"{path}: is {found} where usdface keeps a {kind}, and is not followed; remove it, or "
        "write elsewhere"
    )
