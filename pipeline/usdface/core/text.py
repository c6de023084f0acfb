"""Numbers and lists in messages; text and JSON files."""

import json
import shlex
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from usdface.core.confinement import check_may_open
from usdface.core.errors import InputError


def shell_word(path: object) -> str:
    """Return a path as it is typed in a shell, quoted if it has spaces."""
    return shlex.quote(str(path))


def pluralize(count: int, noun: str) -> str:
    """Return a number with its noun, ``1 shape`` or ``3 shapes``.

    `noun`: in the singular; one whose plural ends in s.
    """
    return f"{count} {noun}" if count == 1 else f"{count} {noun}s"


def repeated(names: Iterable[str]) -> list[str]:
    """Return the names that occur more than once, each once."""
    return [name for name, count in Counter(names).items() if count > 1]


def first_few(names: Iterable[object], *, most: int = 5, between: str = ", ") -> str:
    """Return names as a list that stays short: ``a, b, c and 4 more``."""
    written = list(map(str, names))
    rest = len(written) - most
    return between.join(written[:most]) + (f" and {rest} more" if rest > 0 else "")


def frame_ranges(stretches: Iterable[tuple[int, int]]) -> str:
    """Return stretches of frames, first and last, as ``frames 7, 12-20``."""
    written = [f"{first}" if first == last else f"{first}-{last}" for first, last in stretches]
    noun = "frame" if len(written) == 1 and "-" not in written[0] else "frames"
    return f"{noun} {first_few(written)}"


def counted(names: Sequence[object], noun: str, *, most: int = 5) -> str:
    """Return the number of names and the first ones, ``7 shapes, a, b, c, d, e and 2 more``."""
    return f"{pluralize(len(names), noun)}, {first_few(names, most=most)}"


def read_text(path: Path, largest_bytes: int) -> str:
    """Read a text file, in UTF-8 or UTF-16."""
    check_may_open(path)
    try:
        if path.stat().st_size > largest_bytes:
            raise InputError(f"{path}: {path.stat().st_size} bytes are too many for a text")
        data = path.read_bytes()
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror}; check the path") from error
    try:
        return data.decode(text_encoding(data))
    except UnicodeDecodeError as error:
        raise InputError(f"{path}: is not UTF-8 at byte {error.start}; save it as UTF-8") from error


def text_encoding(head: bytes) -> str:
    """Return the encoding of a text by its first bytes: UTF-16 with a byte order mark, or UTF-8."""
    return "utf-16" if head[:2] in (b"\xff\xfe", b"\xfe\xff") else "utf-8-sig"


def read_json(path: Path, largest_bytes: int) -> Any:
    """Read a JSON file."""
    try:
        return json.loads(read_text(path, largest_bytes))
    except (ValueError, RecursionError) as error:
        raise InputError(f"{path}: is no valid JSON: {error}") from error


def json_text(data: Mapping[str, Any]) -> str:
    """Return data as indented JSON."""
    return json.dumps(data, indent=2, ensure_ascii=False, allow_nan=False) + "\n"


def json_object(text: str) -> dict[str, Any]:
    """Return the JSON object in a text; empty if there is none."""
    try:
        data = json.loads(text)
    except (ValueError, RecursionError):
        return {}
    return data if isinstance(data, dict) else {}


def aligned_rows(rows: Sequence[Sequence[str]]) -> list[str]:
    """Return rows of equally many cells as lines with aligned columns."""
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    return [
        "  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip()
        for row in rows
    ]
