"""Exclusive lock of a file that is being written.

A separate file, locked by the system, which releases it when the process ends. On a file system
without locks, the process that created the file holds the lock. Files that are not ours are never
written to.
"""

import contextlib
import errno
import logging
import os
import re
import socket
import uuid
import zlib
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import cache
from pathlib import Path

from usdface.core.errors import InputError
from usdface.core.side_files import open_side_file

try:
    import fcntl
except ImportError:  # Windows: files in use cannot be replaced there, which protects them as well
    fcntl = None  # type: ignore[assignment]

LONGEST_STEM_BYTES = 80
"""Bytes of a file's name in its temporary name, as names have a limit."""
_LONGEST_LOCK_NAME_BYTES = 2 * LONGEST_STEM_BYTES
"""Bytes of a file's name in its lock's name."""
_LONGEST_OWNER_BYTES = 400
_MOST_TRIES = 100
"""Attempts at a lock that others take and release."""
_OWNER = re.compile(r"process (\d{1,10}) on (\S+?)(?: ([0-9a-f]{32}))?(, alone)?")
"""Contents of a lock file: process, host, a unique key, and ", alone" on a file system without
locks."""

# Errors of file systems without locks: Lustre without -o flock, some network and FUSE mounts.
_NO_LOCKS = (errno.ENOLCK, errno.ENOTSUP, errno.ENOSYS, errno.EINVAL, errno.EOPNOTSUPP)

log = logging.getLogger(__name__)


@contextmanager
def write_lock(path: Path) -> Iterator[Callable[[], None]]:
    """Hold the lock of a file until the block, or the process, ends.

    Yields
    ------
    callable
        Raises InputError if the lock is no longer ours; to be called before the file is renamed.
    """
    name = path.name
    short = shorten(name, _LONGEST_LOCK_NAME_BYTES)
    if short != name:
        name = f"{short}.{name_digest(path)}"
    lock = path.with_name(f".{name}.lock")
    try:
        handle = _lock(lock)
    except BlockingIOError as error:
        raise InputError(
            f"{path}: another process is writing it{error.strerror}; let that one finish, or write "
            "elsewhere"
        ) from error
    except OSError as error:
        raise not_writable_error(path, error) from error

    def check() -> None:
        if fcntl is not None and not _is_at(handle, lock):
            raise InputError(
                f"{path}: its lock {lock.name} was removed while it was written, so another may be "
                "writing it too; what is there is kept: give the command again"
            )

    try:
        yield check
    finally:
        # Removed while still locked, so that others that have opened it see that it is gone.
        with contextlib.suppress(OSError):
            if fcntl is None or _is_at(handle, lock):
                lock.unlink(missing_ok=True)
        os.close(handle)


def _lock(lock: Path) -> int:
    """Take the lock, and return its open file.

    `BlockingIOError` if another process holds it, with its name as text.
    """
    owner = f"process {os.getpid()} on {socket.gethostname()} {uuid.uuid4().hex}"
    for _ in range(_MOST_TRIES):
        with contextlib.suppress(FileNotFoundError):  # removed by its owner in between
            handle, is_new = _open(lock)
            try:
                by_system = _locked_by_system(handle, lock, is_new=is_new)
                if not _is_at(handle, lock):
                    os.close(handle)
                    continue
                if is_new:
                    os.write(handle, (owner if by_system else f"{owner}, alone").encode())
                    return handle
                _remove_stale(lock, handle, by_system=by_system)
            except BaseException:
                if is_new and _is_at(handle, lock):
                    lock.unlink(missing_ok=True)
                os.close(handle)
                raise
            os.close(handle)
    raise BlockingIOError(errno.EWOULDBLOCK, "")


def _open(lock: Path) -> tuple[int, bool]:
    """Open a lock file; return it, and whether it is new."""
    try:
        return open_side_file(lock, os.O_RDWR | os.O_CREAT | os.O_EXCL), True
    except FileExistsError:
        pass
    try:
        return open_side_file(lock, os.O_RDWR), False  # locks over NFS need write access
    except PermissionError:  # of another user
        return open_side_file(lock, os.O_RDONLY), False


def _locked_by_system(handle: int, lock: Path, *, is_new: bool) -> bool:
    """Lock an open file; return whether the file system can."""
    try:
        if fcntl is not None:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError as error:
        # New, and locked by a process that was faster, or takes it for a stale one.
        raise BlockingIOError(error.errno, "" if is_new else _owner(handle)) from error
    except OSError as error:
        if error.errno not in _NO_LOCKS:
            raise
        _warn_of_no_locks(str(lock.parent))
        return False
    return True


@cache
def _warn_of_no_locks(folder: str) -> None:
    log.warning(
        "%s: this file system has no file locks; lock files made by one process alone are used "
        "instead. If a machine fails while it writes, remove the .lock file that it left",
        folder,
    )


def _remove_stale(lock: Path, handle: int, *, by_system: bool) -> None:
    """Remove the lock of a process that has ended.

    Raises
    ------
    BlockingIOError
        If it may be running.
    InputError
        If the file is no lock of ours.
    """
    text = _text(handle)
    owner = _OWNER.fullmatch(text)
    if text and owner is None:
        raise InputError(f"{lock}: is no lock of usdface, and is not written over; move it away")
    if by_system and not (owner and owner[4]):
        lock.unlink()  # we hold the system's lock
        return
    if owner is None or owner[2] != socket.gethostname() or is_running(int(owner[1])):
        remedy = f", or a machine failed there; if it did, remove {lock.name}"
        raise BlockingIOError(errno.EWOULDBLOCK, _owner(handle) + remedy)
    aside = lock.with_name(f"{lock.name}.{uuid.uuid4().hex}")
    lock.rename(aside)
    if not _is_at(handle, aside):  # another process has replaced it since it was read
        with contextlib.suppress(OSError):
            os.link(aside, lock)
    aside.unlink()


def _text(handle: int) -> str:
    os.lseek(handle, 0, os.SEEK_SET)
    return os.read(handle, _LONGEST_OWNER_BYTES).decode(errors="replace")


def _owner(handle: int) -> str:
    owner = _OWNER.fullmatch(_text(handle))
    return f" (process {owner[1]} on {owner[2]})" if owner else ""


def _is_at(handle: int, lock: Path) -> bool:
    """Whether an open file is the one at a path."""
    try:
        return os.path.samestat(os.fstat(handle), lock.lstat())
    except OSError:
        return False


def is_running(process: int) -> bool:
    """Whether a process of this machine exists; True if that is unknown."""
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    except (OSError, OverflowError):
        return True
    return True


def shorten(name: str, size: int) -> str:
    """Return a name truncated to a number of bytes, at a whole character."""
    if len(name.encode(errors="surrogatepass")) <= size:
        return name
    return name.encode(errors="ignore")[:size].decode(errors="ignore")


def name_digest(path: Path) -> str:
    """Return four hex digits that distinguish temporary names of files with the same beginning."""
    return f"{zlib.crc32(path.name.encode(errors='surrogatepass')) & 0xFFFF:04x}"


def not_writable_error(path: Path, error: OSError) -> InputError:
    """Return the error for a file whose folder cannot be written to."""
    return InputError(
        f"{path}: the folder {path.parent} cannot be written to ({error.strerror}); "
        "write elsewhere or ask for the right to"
    )
