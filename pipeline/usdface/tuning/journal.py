"""Write-ahead journal of changes, each on disk before it is acknowledged.

Writing a line takes 4 ms, a USD layer tens of milliseconds. The layer is written when changes
pause; after a crash, the lines are replayed.
"""

import json
import os
from collections.abc import Iterable
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from usdface.core.errors import InputError
from usdface.core.side_files import side_stream


@dataclass(frozen=True)
class Change:
    """New weights of some shapes of one pair, and whether the pair is done."""

    pair: int
    """Index from 0."""
    take: str
    frame: int
    """`take`, `frame`: of the pair, to detect a changed selection."""
    weights: dict[str, float] = field(default_factory=dict)
    """By shape name."""
    done: bool | None = None
    """None: unchanged."""


class Journal:
    """An append-only file of changes.

    Parameters
    ----------
    path : Path
        Created with the first change, removed by `clear`.
    """

    def __init__(self, path: Path) -> None:
        self.path = path

    def replay(self) -> list[Change]:
        """Return the changes on disk; an incomplete last line is removed.

        Raises
        ------
        InputError
            If a line before the last is not a change.
        """
        try:
            with side_stream(self.path, "rb") as stream:
                raw = stream.read()
        except FileNotFoundError:
            return []
        whole = raw.rfind(b"\n") + 1
        changes = []
        for number, line in enumerate(raw[:whole].splitlines(), start=1):
            change = _parse(line)
            if change is None:
                if number == raw[:whole].count(b"\n"):  # a partly written page
                    whole = raw.rfind(b"\n", 0, whole - 1) + 1
                    break
                raise InputError(
                    f"{self.path}: line {number} is not a change of weights; nothing was changed. "
                    "Move the file away to tune without its changes, and send it to your TD"
                )
            changes.append(change)
        if whole < len(raw):
            with side_stream(self.path, "rb+") as stream:
                stream.truncate(whole)
                os.fsync(stream.fileno())
        return changes

    def append(self, changes: Iterable[Change]) -> None:
        """Write changes and flush them to disk."""
        lines = [json.dumps(asdict(change), ensure_ascii=False) + "\n" for change in changes]
        is_new = not self.path.exists()
        try:
            with side_stream(self.path, "ab") as stream:
                start = stream.tell()
                try:
                    stream.write("".join(lines).encode("utf-8"))
                    stream.flush()
                    os.fsync(stream.fileno())
                except OSError:
                    stream.truncate(start)  # an incomplete line would corrupt the next one
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


def _parse(line: bytes) -> Change | None:
    try:
        data: Any = json.loads(line)
        weights = {str(name): float(value) for name, value in data["weights"].items()}
        done = data["done"]
        if done is not None and not isinstance(done, bool):
            return None
        return Change(int(data["pair"]), str(data["take"]), int(data["frame"]), weights, done)
    except (ValueError, TypeError, KeyError, AttributeError, RecursionError):
        return None
