"""Changes as lines of a file, each on disk before it is acknowledged.

Writing a USD layer takes tens of milliseconds; a line takes four. The layer follows when the hand
rests. Whatever crashes in between, the lines are still there and are played again.
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
    """`take`, `frame`: What the pair shows: a change never lands on another pair."""
    weights: dict[str, float] = field(default_factory=dict)
    """By shape name."""
    done: bool | None = None
    """None leaves it as it is."""


class Journal:
    """An append-only file of changes.

    Parameters
    ----------
    path : Path
        Made with the first change, removed by `clear`.
    """

    def __init__(self, path: Path) -> None:
        self.path = path

    def replay(self) -> list[Change]:
        """Return the changes on disk, and cut off a last line that was not written to its end.

        Raises
        ------
        InputError
            If a line before the last is no change: the file was edited, or is not a journal.
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
                if number == raw[:whole].count(b"\n"):  # torn within a page that reached the disk
                    whole = raw.rfind(b"\n", 0, whole - 1) + 1
                    break
                raise InputError(
                    f"{self.path}: line {number} is no change of weights; nothing was changed. "
                    "Move the file away to tune without what it holds, and send it to your TD"
                )
            changes.append(change)
        if whole < len(raw):
            with side_stream(self.path, "rb+") as stream:
                stream.truncate(whole)
                os.fsync(stream.fileno())
        return changes

    def append(self, changes: Iterable[Change]) -> None:
        """Write changes; when this returns they are on disk."""
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
                    stream.truncate(start)  # half a line would hide the next whole one
                    raise
            if is_new:
                flush_folder(self.path.parent)
        except OSError as error:
            raise InputError(
                f"{self.path}: the change cannot be saved ({error.strerror}); free the disk"
            ) from error

    def clear(self) -> None:
        """Forget all changes: they are in the layer."""
        self.path.unlink(missing_ok=True)


def flush_folder(folder: Path) -> None:
    """Make sure that names made, replaced or removed in a folder outlive a loss of power."""
    if os.name == "nt":  # folders cannot be opened there; renames are journalled by NTFS
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
