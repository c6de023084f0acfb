"""Safe opening of side files: locks, journals, temporary files, pictures. None may be a link.

Their names are predictable from the name of an output, so that others who may write to its folder
could put links there, to files or folders of the user.
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

STRETCH_FILES = r"\.?[0-9a-f]{16}\..*"
"""Names of files that an interrupted run resumes from, including temporary ones."""

_NO_LINK = getattr(os, "O_NOFOLLOW", 0) | getattr(os, "O_CLOEXEC", 0)
_NO_WAIT = getattr(os, "O_NONBLOCK", 0)
"""Not to wait for the writer of a pipe."""
_LISTED = getattr(os, "O_DIRECTORY", 0) | _NO_LINK
# Opening names in a folder needs no permission to list it.
_FOLDER = getattr(os, "O_PATH", os.O_RDONLY) | _LISTED
_BY_FOLDER = os.open in os.supports_dir_fd
"""Whether the system can open a name relative to an open folder; Windows cannot."""


def open_side_file(path: Path, flags: int) -> int:
    """Open a regular file without following links, and return its descriptor.

    Parameters
    ----------
    flags : int
        As in `os.open`.

    Raises
    ------
    InputError
        If it is a link, a pipe, a device or a folder, or outside the folder of the confinement.
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
    """Open a side file as a stream of bytes; see `open_side_file`."""
    return open(path, mode, opener=lambda _, flags: open_side_file(path, flags))


def write_new_file(path: Path, data: bytes) -> None:
    """Write a side file, `FileExistsError` if it exists; remove it if the disk is full."""
    handle = open_side_file(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL)
    try:
        with open(handle, "wb") as stream:  # noqa: PTH123  # no path
            stream.write(data)
    except OSError:
        path.unlink(missing_ok=True)
        raise


def make_side_folder(folder: Path) -> None:
    """Make a side folder, if it does not exist."""
    try:
        with _opened_folder(folder.parent) as parent, contextlib.suppress(FileExistsError):
            os.mkdir(folder if parent is None else folder.name, dir_fd=parent)
    except OSError as error:
        raise InputError(f"{folder}: cannot be written to ({error.strerror})") from error
    check_side_folder(folder)


def check_side_folder(folder: Path) -> None:
    """Refuse a link or a file in the place of a folder; it may be missing."""
    with contextlib.suppress(FileNotFoundError):
        if not stat.S_ISDIR(folder.lstat().st_mode):
            raise _not_plain_error(folder, kind="folder")


def clear_side_folder(folder: Path, pattern: str, *, keep: frozenset[str] = frozenset()) -> None:
    """Remove the files of a folder whose names match."""
    check_side_folder(folder)
    try:
        with _opened_folder(folder.parent) as parent:
            _clear(folder, parent, re.compile(pattern), keep)
    except FileNotFoundError:
        return
    except OSError as error:
        raise InputError(f"{folder}: cannot be written to ({error.strerror})") from error


def remove_side_folder(folder: Path, pattern: str) -> None:
    """Remove the files of a folder whose names match, and the folder, unless it holds others."""
    with contextlib.suppress(OSError):  # does not exist, or holds other files
        clear_side_folder(folder, pattern)
        folder.rmdir()


@contextlib.contextmanager
def emptied_side_folder(folder: Path) -> Iterator[Path]:
    """Make a folder, or empty it after a killed process, and remove it after the block."""
    make_side_folder(folder)
    clear_side_folder(folder, ".*")
    try:
        yield folder
    finally:
        with contextlib.suppress(InputError):
            remove_side_folder(folder, ".*")


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
    """Open a folder, so that names are opened in it even if it is renamed.

    Under confinement, folder by folder from the root, of which none may have become a link.
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
    actual = "a link" if path.is_symlink() else "something else"
    return InputError(
        f"{path}: is {actual} where usdface keeps a {kind}, and is not followed; remove it, or "
        "write elsewhere"
    )
