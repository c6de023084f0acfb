"""The lock of a file that is being written: who holds it writes, and nobody else.

It is a file beside the other, locked by the system, which lets go when a process is killed. Where a
file system has no locks, to make that file is to hold it: of several only one can. It is never
written into anything that was there before.
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
"""Bytes of a file's name that its temporary name repeats: names have an upper limit."""
_LONGEST_LOCK_NAME_BYTES = 2 * LONGEST_STEM_BYTES
"""Bytes of it that its lock's name repeats."""
_LONGEST_OWNER_BYTES = 400
_MOST_TRIES = 100
"""To have a lock that others take and give back meanwhile."""
_OWNER = re.compile(r"process (\d{1,10}) on (\S+?)(?: ([0-9a-f]{32}))?(, alone)?")
"""What a lock holds: process, host, a key that no other lock has, and whether the file alone is the
lock, because its owner's file system has none."""

# Said of file systems without locks: Lustre without -o flock, some network and FUSE mounts.
_NO_LOCKS = (errno.ENOLCK, errno.ENOTSUP, errno.ENOSYS, errno.EINVAL, errno.EOPNOTSUPP)

log = logging.getLogger(__name__)


@contextmanager
def write_lock(path: Path) -> Iterator[Callable[[], None]]:
    """Hold the lock of a file that is written until the block, or the process, ends.

    Yields
    ------
    callable
        Raises InputError if the lock is no longer ours: for who is about to put the file there.
    """
    name = path.name
    short = shorten(name, _LONGEST_LOCK_NAME_BYTES)
    if short != name:  # names that begin alike are still of different files
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
        # Removed while still held: whoever waits for this very file then sees that it is gone.
        with contextlib.suppress(OSError):
            if fcntl is None or _is_at(handle, lock):
                lock.unlink(missing_ok=True)
        os.close(handle)


def _lock(lock: Path) -> int:
    """Return the open lock file, which is ours.

    Raises
    ------
    BlockingIOError
        If another holds it; its text says who.
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
    """Open a lock file; return it, and whether it was made now."""
    try:
        return open_side_file(lock, os.O_RDWR | os.O_CREAT | os.O_EXCL), True
    except FileExistsError:
        pass
    try:
        return open_side_file(lock, os.O_RDWR), False  # as locks over NFS want it
    except PermissionError:  # another user's, and enough to ask for it
        return open_side_file(lock, os.O_RDONLY), False


def _locked_by_system(handle: int, lock: Path, *, is_new: bool) -> bool:
    """Lock an open file; return whether the file system can."""
    try:
        if fcntl is not None:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError as error:
        # Made now, and held: by one who takes it for a stale one, or is quicker.
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
    """Remove what a process left that is gone.

    Raises
    ------
    BlockingIOError
        If it may be alive.
    InputError
        If that is no lock of ours.
    """
    text = _text(handle)
    said = _OWNER.fullmatch(text)
    if text and said is None:
        raise InputError(f"{lock}: is no lock of usdface, and is not written over; move it away")
    if by_system and not (said and said[4]):
        lock.unlink()  # nobody else can have it: we hold it
        return
    if said is None or said[2] != socket.gethostname() or _is_running(int(said[1])):
        remedy = f", or a machine failed there; if it did, remove {lock.name}"
        raise BlockingIOError(errno.EWOULDBLOCK, _owner(handle) + remedy)
    aside = lock.with_name(f"{lock.name}.{uuid.uuid4().hex}")
    lock.rename(aside)
    if not _is_at(handle, aside):  # another removed it, and made its own, since it was read
        with contextlib.suppress(OSError):
            os.link(aside, lock)
    aside.unlink()


def _text(handle: int) -> str:
    os.lseek(handle, 0, os.SEEK_SET)
    return os.read(handle, _LONGEST_OWNER_BYTES).decode(errors="replace")


def _owner(handle: int) -> str:
    said = _OWNER.fullmatch(_text(handle))
    return f" (process {said[1]} on {said[2]})" if said else ""


def _is_at(handle: int, lock: Path) -> bool:
    """Whether an open file is the one of that name."""
    try:
        return os.path.samestat(os.fstat(handle), lock.lstat())
    except OSError:
        return False


def _is_running(process: int) -> bool:
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    except (OSError, OverflowError):
        return True
    return True


def shorten(name: str, size: int) -> str:
    """Return as much of a name as fits into so many bytes, whole characters alone."""
    if len(name.encode(errors="surrogatepass")) <= size:
        return name
    return name.encode(errors="ignore")[:size].decode(errors="ignore")


def name_digest(path: Path) -> str:
    """Tell a file's temporary names from those of files that differ only in how they end."""
    return f"{zlib.crc32(path.name.encode(errors='surrogatepass')) & 0xFFFF:04x}"


def not_writable_error(path: Path, error: OSError) -> InputError:
    """Return the error for a file whose folder refuses it."""
    return InputError(
        f"{path}: the folder {path.parent} cannot be written to ({error.strerror}); "
        "write elsewhere or ask for the right to"
    )
