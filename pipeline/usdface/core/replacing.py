"""Atomic replacement of files: write to a temporary name, then rename.

Readers see the old or the new file. Of two processes that write the same file, one is refused by a
lock, which the system releases when a process is killed. Temporary files of a killed process are
removed by the next one that writes the file.
"""

import contextlib
import os
import re
import uuid
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass, field
from pathlib import Path
from types import MappingProxyType

from usdface.core.errors import InputError
from usdface.core.side_files import open_side_file, write_new_file
from usdface.core.write_lock import (
    LONGEST_STEM_BYTES,
    name_digest,
    not_writable_error,
    shorten,
    write_lock,
)

_WRITE_PERMISSIONS = 0o222
_HANDLE_FLAGS = getattr(os, "O_PATH", os.O_RDONLY) | getattr(os, "O_NOFOLLOW", 0)
"""To open a file without reading it; Linux needs no permission for that."""


@contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """Yield a temporary path in the same folder, which replaces `path` on success.

    Yields
    ------
    Path
        To write to, with the suffix of `path`.

    Raises
    ------
    InputError
        If the folder is missing, `path` is a folder, either cannot be written, `path` is
        write-protected, or another process is writing the same file. The old file is unchanged.
    """
    with replacing_together([path]) as (temporary,):
        yield temporary


def write_new_text(path: Path, text: str) -> None:
    """Write a text file in UTF-8; `InputError` if a file or a link is at `path`."""
    try:
        write_new_file(path, text.encode("utf-8"))
    except FileExistsError as error:
        raise InputError(
            f"{path}: exists, and is not written over; give another name, or remove it"
        ) from error
    except OSError as error:
        raise not_writable_error(path, error) from error


def write_text(path: Path, text: str) -> None:
    """Write a text file in UTF-8, as `replacing` does."""
    write_bytes(path, text.encode("utf-8"))


def write_bytes(path: Path, data: bytes) -> None:
    """Write a file, as `replacing` does."""
    with replacing(path) as temporary:
        try:
            temporary.write_bytes(data)
        except OSError as error:
            raise InputError(
                f"{path}: cannot be written ({error.strerror}); free the disk, or write elsewhere"
            ) from error


@dataclass(frozen=True)
class _Replacement:
    """A file that is to replace another."""

    path: Path
    temporary: Path
    check_lock: Callable[[], None]
    then: Callable[[Path], None] | None


@dataclass(frozen=True)
class _Group:
    """Files of which none is renamed before all are complete."""

    paths: frozenset[Path]
    whole: list[_Replacement] = field(default_factory=list)
    held: contextlib.ExitStack = field(default_factory=contextlib.ExitStack)
    """Their locks and temporary files."""


_GROUP: ContextVar[_Group | None] = ContextVar("_GROUP", default=None)


@contextmanager
def replacing_group(paths: Iterable[Path]) -> Iterator[None]:
    """Rename files that a block writes one by one at its end, all or none.

    In the order in which they were completed; other files are renamed at once.

    `paths`: not to be read in the block.
    """
    group = _Group(frozenset(paths))
    with group.held:
        token = _GROUP.set(group)
        try:
            yield
        finally:
            _GROUP.reset(token)
        _rename(group.whole)


@contextmanager
def replacing_together(
    paths: Sequence[Path], *, then: Callable[[Path], None] | None = None
) -> Iterator[tuple[Path, ...]]:
    """Yield temporary paths of several files, which are renamed when all are complete.

    A full disk leaves all old files. Files are renamed in the order given, so that a file that
    refers to others should be last.

    Parameters
    ----------
    paths : sequence of Path
        The files to make or to replace, all different.
    then : callable, optional
        Called with each file after all are renamed.

    Yields
    ------
    tuple of Path
        To write to, in the same order.
    """
    group = _GROUP.get()
    with contextlib.ExitStack() as stack:
        made = [_Replacement(path, *stack.enter_context(_temporary(path)), then) for path in paths]
        yield tuple(file.temporary for file in made)
        for file in made:
            with _as_input_error(file.path):
                _sync(file.path, file.temporary)
        if group is not None and group.paths.issuperset(paths):
            group.whole.extend(made)
            group.held.push(stack.pop_all())
        else:
            _rename(made)


def _rename(made: Sequence[_Replacement]) -> None:
    for file in made:
        with _as_input_error(file.path):
            file.check_lock()
    with _old_files_open([file.path for file in made]):
        for file in made:
            with _as_input_error(file.path):
                file.temporary.replace(file.path)
    for file in made:
        if file.then is not None:
            file.then(file.path)


@contextmanager
def _old_files_open(paths: Sequence[Path]) -> Iterator[None]:
    """Keep files open that are about to be replaced.

    Otherwise the system frees the blocks of a replaced file during the rename, which takes
    milliseconds instead of microseconds, and a process that is killed meanwhile leaves new files
    with old ones.
    """
    with contextlib.ExitStack() as stack:
        for path in paths:
            with contextlib.suppress(OSError):  # missing or not readable
                handle = os.open(path, _HANDLE_FLAGS)
                stack.callback(os.close, handle)
        yield


_Stamp = tuple[int, int] | None
_STAMPS_BEFORE: ContextVar[Mapping[Path, _Stamp]] = ContextVar(
    "_STAMPS_BEFORE", default=MappingProxyType({})
)


@contextmanager
def not_written_since(paths: Iterable[Path]) -> Iterator[None]:
    """Record the times of files during a block, for `check_not_written_since`."""
    token = _STAMPS_BEFORE.set({path.absolute(): _stamp(path) for path in paths})
    try:
        yield
    finally:
        _STAMPS_BEFORE.reset(token)


def check_not_written_since(path: Path) -> None:
    """Refuse to replace a file, which we have locked, if another process wrote it since."""
    before = _STAMPS_BEFORE.get()
    if path.absolute() in before and _stamp(path) != before[path.absolute()]:
        raise InputError(
            f"{path}: another process wrote it meanwhile, and what it wrote is kept; give the "
            "command again with --overwrite to replace that"
        )


def _stamp(path: Path) -> _Stamp:
    try:
        status = path.stat()
    except OSError:
        return None
    return status.st_mtime_ns, status.st_ino


def check_unprotected(path: Path) -> None:
    """Refuse a write-protected file; a rename needs only the folder's permissions."""
    with contextlib.suppress(OSError):
        if not path.stat().st_mode & _WRITE_PERMISSIONS:
            raise InputError(
                f"{path}: is write-protected; make it writable if it may be replaced, or write "
                "elsewhere"
            )


def _sync(path: Path, temporary: Path) -> None:
    """Flush a file to the disk, with the permissions of the one it replaces."""
    handle = open_side_file(temporary, os.O_RDWR)
    try:
        # Unless there is none, or without permissions, as on Windows.
        with contextlib.suppress(OSError, AttributeError):
            os.fchmod(handle, path.stat().st_mode & 0o777)
        os.fsync(handle)
    finally:
        os.close(handle)


@contextmanager
def _temporary(path: Path) -> Iterator[tuple[Path, Callable[[], None]]]:
    """Yield a temporary path of a locked file, and the check of its lock; remove it afterwards."""
    if path.is_dir():
        raise InputError(f"{path}: is a folder; give the name of a file to write")
    if not path.parent.is_dir():
        raise InputError(f"{path}: the folder {path.parent} does not exist; make it first")
    check_unprotected(path)
    with write_lock(path) as check_lock:
        _clear_leftovers(path)
        stem = shorten(path.stem, LONGEST_STEM_BYTES)
        unique = f"{name_digest(path)}{uuid.uuid4().hex[:8]}"
        temporary = path.with_name(f".{stem}.{unique}{path.suffix}")
        try:
            # Made here, so that errors have its name, rather than an encoder's message.
            try:
                os.close(open_side_file(temporary, os.O_WRONLY | os.O_CREAT | os.O_EXCL))
            except OSError as error:
                raise not_writable_error(path, error) from error
            yield temporary, check_lock
        finally:
            with contextlib.suppress(OSError):  # the folder may have been removed
                temporary.unlink(missing_ok=True)


@contextmanager
def _as_input_error(path: Path) -> Iterator[None]:
    try:
        yield
    except OSError as error:
        raise InputError(
            f"{path}: cannot be replaced ({error.strerror}); free the disk or the file, "
            "and see that the folder is still there"
        ) from error


def _clear_leftovers(path: Path) -> None:
    """Remove temporary files of a killed process, while we hold the lock."""
    if shorten(path.stem, LONGEST_STEM_BYTES) != path.stem:
        return  # another file's temporary files could have the same name
    # While USD saves, it has a temporary file of its own, with a suffix to our name.
    temporary = rf"\.{re.escape(path.stem)}\.{name_digest(path)}[0-9a-f]{{8}}(\.\w+)*"
    lock = rf"\.{re.escape(path.name)}\.lock\.[0-9a-f]{{32}}"
    ours = re.compile(f"{temporary}|{lock}")
    with contextlib.suppress(OSError):  # harmless; errors of the folder are raised on writing
        for file in path.parent.iterdir():
            if ours.fullmatch(file.name):
                file.unlink(missing_ok=True)
