"""Write beside, then rename: whoever reads sees the old file or the new one, never half.

Whoever writes holds a lock beside the file, so of two that write the same one wins whole and the
other gets an error. The system releases the lock of a process that was killed, and what such a
process left behind is removed by the next that writes the file.
"""

import contextlib
import errno
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
from usdface.core.side_files import open_side_file
from usdface.core.write_lock import (
    LONGEST_STEM_BYTES,
    name_digest,
    not_writable_error,
    shorten,
    write_lock,
)

_WRITE_PERMISSIONS = 0o222
_HANDLE_FLAGS = getattr(os, "O_PATH", os.O_RDONLY) | getattr(os, "O_NOFOLLOW", 0)
"""How a file is opened that is not to be read, on Linux without the right to."""


@contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """Give a temporary name in the same folder; it takes the place of `path` on success.

    Yields
    ------
    Path
        To write to; it ends as `path` does, so that encoders know the format.

    Raises
    ------
    InputError
        If the folder is missing, `path` is a folder, either cannot be written, `path` is
        write-protected, or another process is writing the same file. The old file, if there is
        one, is as it was.
    """
    with replacing_together([path]) as (temporary,):
        yield temporary


@contextmanager
def creating(path: Path) -> Iterator[Path]:
    """Give a temporary name as `replacing` does; what is at `path` by then is never replaced.

    Raises
    ------
    InputError
        If there is something, a link included; else as `replacing` does.
    """
    with replacing_together([path], new=True) as (temporary,):
        yield temporary


def write_text(path: Path, text: str) -> None:
    """Write a text file in UTF-8, as `replacing` does."""
    with replacing(path) as temporary:
        try:
            temporary.write_text(text, encoding="utf-8", newline="\n")
        except OSError as error:
            raise InputError(f"{path}: cannot be written: {error.strerror}") from error


@dataclass(frozen=True)
class _Replacement:
    """A file that is to take another's place."""

    path: Path
    temporary: Path
    check_lock: Callable[[], None]
    then: Callable[[Path], None] | None


@dataclass(frozen=True)
class _Group:
    """Files of which none is renamed before all are whole."""

    paths: frozenset[Path]
    whole: list[_Replacement] = field(default_factory=list)
    held: contextlib.ExitStack = field(default_factory=contextlib.ExitStack)
    """Their locks and temporaries."""


_GROUP: ContextVar[_Group | None] = ContextVar("_GROUP", default=None)


@contextmanager
def appearing_together(paths: Iterable[Path]) -> Iterator[None]:
    """Let files that a block writes one by one take their places at its end, or none of them.

    They do in the order in which they became whole; other files that it writes do at once.

    Parameters
    ----------
    paths : iterable of Path
        Those of them that are written. None is to be read in the block.
    """
    group = _Group(frozenset(paths))
    with group.held:
        token = _GROUP.set(group)
        try:
            yield
        finally:
            _GROUP.reset(token)
        _put_in_place(group.whole)


@contextmanager
def replacing_together(
    paths: Sequence[Path], *, new: bool = False, then: Callable[[Path], None] | None = None
) -> Iterator[tuple[Path, ...]]:
    """Give temporary names for files that belong together; all are whole before one is renamed.

    A disk that fills leaves every old file. The renames follow each other in the order given, so a
    file that refers to others comes last.

    Parameters
    ----------
    paths : sequence of Path
        The files to make or to replace; no two are the same.
    new : bool
        Make them, and replace none.
    then : callable, optional
        Is called with each once all are in place.

    Yields
    ------
    tuple of Path
        To write to, in the same order.
    """
    if new and (there := [path for path in paths if os.path.lexists(path)]):
        raise _exists_error(there[0])
    group = _GROUP.get()
    with contextlib.ExitStack() as stack:
        made = [_Replacement(path, *stack.enter_context(_temporary(path)), then) for path in paths]
        yield tuple(each.temporary for each in made)
        for each in made:
            with _as_input_error(each.path):
                _settle(each.path, each.temporary)
        if group is not None and group.paths.issuperset(paths):
            group.whole.extend(made)
            group.held.push(stack.pop_all())
        else:
            _put_in_place(made, new=new)


def _put_in_place(made: Sequence[_Replacement], *, new: bool = False) -> None:
    for each in made:
        with _as_input_error(each.path):
            each.check_lock()
    with _old_files_open([each.path for each in made]):
        for each in made:
            with _as_input_error(each.path):
                if new:
                    _put_new(each.temporary, each.path)
                else:
                    each.temporary.replace(each.path)
    for each in made:
        if each.then is not None:
            each.then(each.path)


@contextmanager
def _old_files_open(paths: Sequence[Path]) -> Iterator[None]:
    """Keep files open that are about to be replaced.

    The system frees the blocks of a replaced file within the rename: milliseconds each, in which a
    process that is killed leaves new files beside old ones. While they are open, renames take
    microseconds.
    """
    with contextlib.ExitStack() as stack:
        for path in paths:
            with contextlib.suppress(OSError):  # there is none, or it cannot be read: then slower
                handle = os.open(path, _HANDLE_FLAGS)
                stack.callback(os.close, handle)
        yield


_Stamp = tuple[int, int] | None
_STAMPS_BEFORE: ContextVar[Mapping[Path, _Stamp]] = ContextVar(
    "_STAMPS_BEFORE", default=MappingProxyType({})
)


@contextmanager
def not_written_since(paths: Iterable[Path]) -> Iterator[None]:
    """Keep in mind, while a block runs, which files there were when it began."""
    token = _STAMPS_BEFORE.set({path.absolute(): _stamp(path) for path in paths})
    try:
        yield
    finally:
        _STAMPS_BEFORE.reset(token)


def check_not_written_since(path: Path) -> None:
    """Refuse a file that somebody else wrote since; for who has locked it and is about to write."""
    seen = _STAMPS_BEFORE.get()
    if path.absolute() in seen and _stamp(path) != seen[path.absolute()]:
        raise InputError(
            f"{path}: another process wrote it meanwhile, and what it wrote is kept; give the "
            "command again with --overwrite to replace that"
        )


def _stamp(path: Path) -> _Stamp:
    try:
        there = path.stat()
    except OSError:
        return None
    return there.st_mtime_ns, there.st_ino


def check_unprotected(path: Path) -> None:
    """Refuse a file that nobody may write to: a rename would ask for the folder's rights alone."""
    with contextlib.suppress(OSError):
        if not path.stat().st_mode & _WRITE_PERMISSIONS:
            raise InputError(
                f"{path}: is write-protected; make it writable if it may be replaced, or write "
                "elsewhere"
            )


def _settle(path: Path, temporary: Path) -> None:
    """Bring a file to the disk, open to those who could read and write the one it replaces."""
    handle = open_side_file(temporary, os.O_RDWR)
    try:
        # There may be none yet; or a file system knows no permissions, as Windows' do not.
        with contextlib.suppress(OSError, AttributeError):
            os.fchmod(handle, path.stat().st_mode & 0o777)
        os.fsync(handle)
    finally:
        os.close(handle)


_NO_HARD_LINKS = (errno.EPERM, errno.ENOTSUP, errno.ENOSYS, errno.EOPNOTSUPP)


def _put_new(temporary: Path, path: Path) -> None:
    """Give a file its name, if nothing has it."""
    try:
        try:
            os.link(temporary, path, follow_symlinks=False)
        except OSError as error:
            if error.errno not in _NO_HARD_LINKS:
                raise
            os.close(open_side_file(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL))
            temporary.replace(path)
    except FileExistsError as error:
        raise _exists_error(path) from error


def _exists_error(path: Path) -> InputError:
    return InputError(f"{path}: exists, and is not written over; give another name, or remove it")


@contextmanager
def _temporary(path: Path) -> Iterator[tuple[Path, Callable[[], None]]]:
    """Give a temporary name for a file that nobody else may write; it is gone afterwards.

    Yields what checks that the lock still holds, too.
    """
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
            _touch(temporary, target=path)
            yield temporary, check_lock
        finally:
            with contextlib.suppress(OSError):  # the folder may have gone meanwhile
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


def _touch(temporary: Path, *, target: Path) -> None:
    """Fail here, by name, rather than deep inside an encoder."""
    try:
        os.close(open_side_file(temporary, os.O_WRONLY | os.O_CREAT | os.O_EXCL))
    except OSError as error:
        raise not_writable_error(target, error) from error


def _clear_leftovers(path: Path) -> None:
    """Remove what a killed process left; nobody else can be writing, as the lock is ours."""
    if shorten(path.stem, LONGEST_STEM_BYTES) != path.stem:
        return  # another file's temporaries could have the same name
    # While USD saves, its own temporary file lies beside ours, with other letters at its end.
    temporary = rf"\.{re.escape(path.stem)}\.{name_digest(path)}[0-9a-f]{{8}}(\.\w+)*"
    lock = rf"\.{re.escape(path.name)}\.lock\.[0-9a-f]{{32}}"
    ours = re.compile(f"{temporary}|{lock}")
    with contextlib.suppress(OSError):  # they are only in the way; what is wrong shows on writing
        for each in path.parent.iterdir():
            if ours.fullmatch(each.name):
                each.unlink(missing_ok=True)
