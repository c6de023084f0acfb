"""Write beside, then rename: whoever reads sees the old file or the new one, never half.

Whoever writes holds a lock beside the file, so of two that write the same one wins whole and the
other gets an error. The system releases the lock of a process that was killed, and what such a
process left behind is removed by the next that writes the file.
"""

import contextlib
import errno
import os
import re
import socket
import uuid
import zlib
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from pathlib import Path
from types import MappingProxyType

from usdface.core.errors import InputError

try:
    import fcntl
except ImportError:  # Windows: files in use cannot be replaced there, which protects them as well
    fcntl = None  # type: ignore[assignment]

_LONGEST_STEM_BYTES = 80
"""Bytes of a file's name that its temporary name repeats: names have an upper limit."""
_LONGEST_LOCK_NAME_BYTES = 2 * _LONGEST_STEM_BYTES
"""Bytes of it that its lock's name repeats."""

_WRITE_PERMISSIONS = 0o222


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
def replacing_together(paths: Sequence[Path]) -> Iterator[tuple[Path, ...]]:
    """Give temporary names for files that belong together; all are whole before one is renamed.

    A disk that fills leaves every old file. The renames follow each other in the order given, so a
    file that refers to others comes last.

    Parameters
    ----------
    paths : sequence of Path
        The files to make or to replace; no two are the same.

    Yields
    ------
    tuple of Path
        To write to, in the same order.

    Raises
    ------
    InputError
        As `replacing` does.
    """
    with contextlib.ExitStack() as stack:
        temporaries = tuple(stack.enter_context(_temporary(path)) for path in paths)
        yield temporaries
        for path, temporary in zip(paths, temporaries, strict=True):
            with _as_input_error(path), temporary.open("rb+") as written:
                os.fsync(written.fileno())
        for path, temporary in zip(paths, temporaries, strict=True):
            with _as_input_error(path):
                _copy_permissions(path, temporary)
                temporary.replace(path)


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
    """Refuse a file that somebody else wrote since; for who has locked it, and is about to write.

    Raises
    ------
    InputError
        If it is another than `not_written_since` saw.
    """
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
    """Refuse a file that nobody may write to: a rename would ask for the folder's rights alone.

    Raises
    ------
    InputError
        If it is there and write-protected.
    """
    with contextlib.suppress(OSError):
        if not path.stat().st_mode & _WRITE_PERMISSIONS:
            raise InputError(
                f"{path}: is write-protected; make it writable if it may be replaced, or write "
                "elsewhere"
            )


def _copy_permissions(path: Path, temporary: Path) -> None:
    """Let a file that is replaced stay open to those who could read and write it."""
    with contextlib.suppress(OSError):  # there was none; or a file system knows no permissions
        temporary.chmod(path.stat().st_mode & 0o777)


@contextmanager
def _temporary(path: Path) -> Iterator[Path]:
    """Give a temporary name for a file that nobody else may write; it is gone afterwards."""
    if path.is_dir():
        raise InputError(f"{path}: is a folder; give the name of a file to write")
    if not path.parent.is_dir():
        raise InputError(f"{path}: the folder {path.parent} does not exist; make it first")
    check_unprotected(path)
    with _locked(path) as is_locked:
        if is_locked:
            _clear_leftovers(path)
        stem = _shorten(path.stem, _LONGEST_STEM_BYTES)
        unique = f"{_name_digest(path)}{uuid.uuid4().hex[:8]}"
        temporary = path.with_name(f".{stem}.{unique}{path.suffix}")
        try:
            _touch(temporary, target=path)
            yield temporary
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
        temporary.touch()
    except OSError as error:
        raise _not_writable_error(target, error) from error


@contextmanager
def _locked(path: Path) -> Iterator[bool]:
    """Hold the lock of a file that is written until the block, or the process, ends.

    Yields whether it is locked: some file systems have no locks.
    """
    name = path.name
    short = _shorten(name, _LONGEST_LOCK_NAME_BYTES)
    if short != name:  # names that begin alike are still of different files
        name = f"{short}.{_name_digest(path)}"
    lock = path.with_name(f".{name}.lock")
    try:
        handle, locked = _lock(lock)
    except BlockingIOError as error:
        raise InputError(
            f"{path}: another process is writing it{_owner(lock)}; let that one finish, or write "
            "elsewhere"
        ) from error
    except OSError as error:
        raise _not_writable_error(path, error) from error
    try:
        yield locked
    finally:
        # Removed while still held: whoever waits for this very file then sees that it is gone.
        with contextlib.suppress(OSError):
            lock.unlink(missing_ok=True)
        os.close(handle)


def _lock(lock: Path) -> tuple[int, bool]:
    """Return an open lock file, and whether the system keeps others from it."""
    while True:
        try:
            handle = os.open(lock, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o666)
        except PermissionError:
            if not lock.exists():  # it is the folder that may not be written to
                raise
            _remove_foreign(lock)
            continue
        try:
            if fcntl is not None:
                fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
            if os.fstat(handle).st_nlink:  # not removed by its last owner in between
                os.ftruncate(handle, 0)
                os.write(handle, f"process {os.getpid()} on {socket.gethostname()}".encode())
                return handle, fcntl is not None
        except OSError as error:
            if error.errno in (errno.ENOLCK, errno.ENOTSUP):
                # A file system without locks: work on, as before there were any.
                return handle, False
            os.close(handle)
            raise
        os.close(handle)


def _remove_foreign(lock: Path) -> None:
    """Remove the lock that a killed process of another user left; one that is held is an error.

    Raises
    ------
    BlockingIOError
        If that process lives.
    OSError
        If it may not be removed.
    """
    handle = os.open(lock, os.O_RDONLY | os.O_CLOEXEC)  # which is enough to ask for it
    try:
        if fcntl is not None:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        if os.fstat(handle).st_nlink:  # its name is no other file's by now
            lock.unlink()
    finally:
        os.close(handle)


def _owner(lock: Path) -> str:
    try:
        return f" ({lock.read_text(encoding='utf-8')[:200]})"
    except (OSError, UnicodeDecodeError):
        return ""


def _shorten(name: str, size: int) -> str:
    """Return as much of a name as fits into so many bytes, whole characters alone."""
    if len(name.encode(errors="surrogatepass")) <= size:
        return name
    return name.encode(errors="ignore")[:size].decode(errors="ignore")


def _name_digest(path: Path) -> str:
    """Tell a file's temporary names from those of files that differ only in how they end."""
    return f"{zlib.crc32(path.name.encode(errors='surrogatepass')) & 0xFFFF:04x}"


def _clear_leftovers(path: Path) -> None:
    """Remove what a killed process left; nobody else can be writing, as the lock is ours."""
    if _shorten(path.stem, _LONGEST_STEM_BYTES) != path.stem:
        return  # another file's temporaries could have the same name
    # While USD saves, its own temporary file lies beside ours, with other letters at its end.
    ours = re.compile(rf"\.{re.escape(path.stem)}\.{_name_digest(path)}[0-9a-f]{{8}}(\.\w+)*")
    with contextlib.suppress(OSError):  # they are only in the way; what is wrong shows on writing
        for each in path.parent.iterdir():
            if ours.fullmatch(each.name):
                each.unlink(missing_ok=True)


def _not_writable_error(path: Path, error: OSError) -> InputError:
    return InputError(
        f"{path}: the folder {path.parent} cannot be written to ({error.strerror}); "
        "write elsewhere or ask for the right to"
    )
