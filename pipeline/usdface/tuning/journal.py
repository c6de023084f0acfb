"""Write-ahead journal of changes, each on disk before it is acknowledged.

Writing a line takes 4 ms, a USD layer tens of milliseconds. The layer is written when changes
pause; after a crash, the lines are replayed.
"""

import errno
import os
from collections.abc import Iterable
from pathlib import Path
from typing import Annotated

from pydantic import ConfigDict, Field, StrictFloat, TypeAdapter, ValidationError
from pydantic.dataclasses import dataclass

from usdface.core.errors import InputError
from usdface.core.side_files import side_stream


@dataclass(frozen=True, config=ConfigDict(extra="forbid", allow_inf_nan=False))
class Change:
    """New weights of some shapes of one pair, and whether the pair is done."""

    pair: Annotated[int, Field(ge=0)]
    """Index from 0."""
    take: str
    frame: int
    """`take`, `frame`: of the pair, to detect a changed selection."""
    weights: Annotated[dict[str, StrictFloat], Field(max_length=10_000)] = Field(
        default_factory=dict
    )
    """By shape name."""
    done: bool | None = None
    """None: unchanged."""
    author: str = ""
    """Set by the session, so that who recovers a change is not taken for its author."""


_CHANGE = TypeAdapter(Change)


class Journal:
    """An append-only file of changes. `path`: created with the first change, removed by `clear`."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def replay(self) -> list[Change]:
        """Return the changes on disk; an incomplete last line is removed.

        `InputError` if a line before the last is not a change.
        """
        try:
            with side_stream(self.path, "rb") as stream:
                raw = stream.read()
        except FileNotFoundError:
            return []
        whole = raw.rfind(b"\n") + 1
        changes = []
        for number, line in enumerate(raw[:whole].splitlines(), start=1):
            try:
                change = _CHANGE.validate_json(line)
            except ValidationError:
                if number == raw[:whole].count(b"\n"):  # a partly written page
                    whole = raw.rfind(b"\n", 0, whole - 1) + 1
                    break
                raise InputError(
                    f"{self.path}: line {number} is not a change of weights; nothing was changed. "
                    "Move the file away to tune without its changes, and send it to your TD"
                ) from None
            changes.append(change)
        if whole < len(raw):
            with side_stream(self.path, "rb+") as stream:
                stream.truncate(whole)
                os.fsync(stream.fileno())
        return changes

    def append(self, changes: Iterable[Change]) -> None:
        """Write changes and flush them to disk."""
        data = b"".join(_CHANGE.dump_json(change) + b"\n" for change in changes)
        is_new = not self.path.exists()
        try:
            with side_stream(self.path, "ab") as stream:
                start = stream.tell()
                handle = stream.fileno()  # the stream would keep what a full disk does not take
                try:
                    if os.write(handle, data) < len(data):
                        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
                    os.fsync(handle)
                except OSError:
                    os.ftruncate(handle, start)  # an incomplete line would corrupt the next one
                    raise
            if is_new:
                flush_folder(self.path.parent)
        except OSError as error:
            raise InputError(
                f"{self.path}: the change cannot be saved ({error.strerror}); free the disk"
            ) from error

    def clear(self) -> None:
        """Remove all changes, which are in the layer."""
        self.path.unlink(missing_ok=True)


def flush_folder(folder: Path) -> None:
    """Flush a folder's entries to disk, against a loss of power."""
    if os.name == "nt":  # folders cannot be opened; NTFS journals renames
        return
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
