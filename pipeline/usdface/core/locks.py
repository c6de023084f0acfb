"""Lock of a references asset during tuning: a file with the user, host and time.

Steps that write pairs hold it as well, so that pairs do not change during tuning.
"""

import contextlib
import getpass
import json
import os
import platform
import secrets
import time
from collections.abc import Iterator
from dataclasses import asdict, dataclass, fields
from datetime import UTC, datetime
from pathlib import Path

from usdface.core.errors import InputError
from usdface.core.side_files import open_side_file, side_stream, write_new_file
from usdface.core.sidecars import journal_path, lock_path
from usdface.core.text import shell_word
from usdface.core.write_lock import is_running

STALE_SECONDS = 60.0
"""Age of the last renewal after which a lock is taken for abandoned."""

_LONGEST_LOCK_BYTES = 4096
"""Bytes of a lock file that are read: ours have some two hundred."""

_LARGEST_PROCESS_ID = 2**31 - 1
"""Process numbers are signed 32-bit integers; 0 and below denote groups."""

_TAKE_OVER = (
    "wait until that page is closed, or take over with --take-over: what was saved there is kept"
)


@dataclass(frozen=True)
class Holder:
    """Holder of a lock."""

    user: str
    host: str
    process: int
    since: str
    """Local time, ISO 8601."""
    key: str
    """Unique each time the lock is taken, by which a server recognises its own."""


class TuningLock:
    """The tuning lock; to be renewed every few seconds."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.taken_from: Holder | None = None
        self._holding: Holder | None = None

    def acquire(self, *, take_over: bool = False, remedy: str = _TAKE_OVER) -> None:
        """Take the lock. `take_over`: from its holder, whose page then refuses changes."""
        holding = Holder(
            user=user_name(),
            host=platform.node(),
            process=os.getpid(),
            since=datetime.now(UTC).astimezone().isoformat(timespec="minutes"),
            key=secrets.token_hex(8),
        )
        text = json.dumps(asdict(holding)) + "\n"
        for _ in range(3):
            try:
                write_new_file(self.path, text.encode("utf-8"))
            except FileExistsError:
                holder = self.holder()
                if holder is not None and not take_over and not self._is_stale(holder):
                    raise InputError(
                        f"{self.path.name.removesuffix('.lock')}: {holder.user} on {holder.host} "
                        f"has been tuning it since {holder.since} (process {holder.process}); "
                        f"{remedy}"
                    ) from None
                self.taken_from = holder
                with contextlib.suppress(FileNotFoundError):
                    self.path.unlink()
            except OSError as error:
                raise InputError(
                    f"{self.path}: cannot be written ({error.strerror}); tuning needs room, and "
                    "the right to write, beside the references"
                ) from error
            else:
                self._holding = holding
                return
        raise InputError(f"{self.path}: someone else takes it at this moment; try again")

    def holder(self) -> Holder | None:
        """Return the holder of the lock; None without one, or if the file is invalid."""
        try:
            with side_stream(self.path, "rb") as stream:
                return _parse_holder(json.loads(stream.read(_LONGEST_LOCK_BYTES)))
        except (OSError, ValueError, RecursionError):
            return None

    def renew(self) -> None:
        """Update the time of the lock, if it is still ours."""
        if self.is_ours():
            with contextlib.suppress(OSError):
                os.utime(self.path, follow_symlinks=False)

    def is_ours(self) -> bool:
        """Whether the lock is still ours, and not taken over."""
        return self._holding is not None and self.holder() == self._holding

    def check(self) -> None:
        """Raise InputError if the lock is no longer ours."""
        if self.is_ours():
            return
        holder = self.holder()
        by = f"{holder.user} on {holder.host} took it over" if holder else "its lock was removed"
        raise InputError(
            f"{self.path.name}: {by}; this page can no longer save. What it saved before is kept; "
            "close it, and start `usdface tune` again when the other is done"
        )

    def release(self) -> None:
        """Remove the lock, if it is still ours."""
        if self.is_ours():
            self.path.unlink(missing_ok=True)
        self._holding = None

    def _is_stale(self, holder: Holder) -> bool:
        is_local = holder.host == platform.node() and os.name == "posix"
        if is_local and not is_running(holder.process):
            return True
        with contextlib.suppress(OSError):
            return self._now() - self.path.lstat().st_mtime > STALE_SECONDS
        return True

    def _now(self) -> float:
        """Return the time of the lock's file system, whose clock may differ from ours."""
        probe = self.path.with_name(f".{self.path.name}.{secrets.token_hex(4)}")
        try:
            os.close(open_side_file(probe, os.O_WRONLY | os.O_CREAT | os.O_EXCL))
            return probe.lstat().st_mtime
        except OSError:
            return time.time()
        finally:
            probe.unlink(missing_ok=True)


def _parse_holder(data: object) -> Holder | None:
    """Return the holder in a lock file; None if the file is invalid."""
    if not isinstance(data, dict) or data.keys() != {field.name for field in fields(Holder)}:
        return None
    process = data["process"]
    texts = [value for name, value in data.items() if name != "process"]
    if type(process) is not int or not 0 < process <= _LARGEST_PROCESS_ID:
        return None
    if not all(isinstance(text, str) for text in texts):
        return None
    return Holder(**data)


def user_name() -> str:
    """Return the login name, or a placeholder if the system has none."""
    try:
        return getpass.getuser()
    except (OSError, KeyError):  # a container without accounts
        return "someone"


_WRITE_REMEDY = (
    "to write pairs now would move them under their hand. Wait until that page is closed, or write "
    "to another --out"
)


@contextlib.contextmanager
def tuning_lock(references: Path) -> Iterator[None]:
    """Hold the tuning lock of a references asset while its pairs are written.

    `InputError` if someone tunes it, or a page that crashed left changes that are not in the tuned
    layer. Nothing is changed.
    """
    lock = TuningLock(lock_path(references))
    lock.acquire(remedy=_WRITE_REMEDY)
    try:
        check_nothing_unsaved(references)
        yield
    finally:
        lock.release()


def check_tuning_lock(references: Path) -> None:
    """Raise the errors of `tuning_lock` before the work begins."""
    with tuning_lock(references):
        pass


def check_nothing_unsaved(references: Path) -> None:
    """Refuse to overwrite changes in the journal of a page that was killed."""
    journal = journal_path(references)
    if journal.is_file() and journal.stat().st_size:
        raise InputError(
            f"{journal}: holds changes of a tuning page that was killed, which are not in the "
            f"tuned layer yet. Start `usdface tune {shell_word(references.name)}` once, which "
            "takes them in, close it with Ctrl+C, and do this again; or write to another --out"
        )
