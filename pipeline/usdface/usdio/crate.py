"""Does a binary layer hold together? Looked at before USD opens it.

USD sets aside memory for as many specs, paths and tokens as a binary layer (a crate) says it has,
before it reads one: a damaged byte of a count makes gigabytes of a file of a few kilobytes. What
is looked at here is where the parts lie and how many things each says it holds, some 300 bytes in
all. Values are not looked at: that would be reading the file.
"""

import itertools
import struct
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO
from zipfile import BadZipFile, ZipFile

from usdface.core.errors import InputError

MAGIC, HEADER_SIZE, ENTRY_SIZE = b"PXR-USDC", 88, 32
"""What a crate begins with, and sizes [bytes]."""
PARTS = ("TOKENS", "STRINGS", "FIELDS", "FIELDSETS", "PATHS", "SPECS")
"""Every version of the format has them all; a later one may have more."""
PART_LIMIT = 64

OLDEST_VERSION = (0, 4)
"""The oldest version of the format that USD still reads; of an older one it says so itself."""
NUMBERS_PER_BYTE = 4 * 255
"""Numbers in a packed byte: each takes two bits at least, and LZ4 makes a byte of 255 at most."""
BYTES_PER_STRING = 4


@dataclass(frozen=True)
class _Part:
    name: str
    start: int
    size: int
    count: int


def check_crate(path: Path) -> None:
    """Refuse a binary layer whose parts lie outside it, or claim more than they can hold.

    Parameters
    ----------
    path : Path
        Any file. What is no binary layer passes; of a package, the binary layers in it are
        looked at. What a file is called counts for nothing but packages.
    """
    try:
        with path.open("rb") as stream:
            if path.suffix.lower() == ".usdz":
                spans = list(_files_in(stream))
            else:
                spans = [(0, stream.seek(0, 2), "")]
            for start, size, inner in spans:
                _check_span(stream, start, size, f"{path}{inner}")
    except OSError:
        return  # what the disk or the rights refuse is told where USD opens the file


def _files_in(stream: BinaryIO) -> Iterator[tuple[int, int, str]]:
    """Yield where files of a package lie, and their names; of what is no package USD says so."""
    try:
        with ZipFile(stream) as package:
            entries = package.infolist()
    except (BadZipFile, NotImplementedError, ValueError, struct.error):
        return
    for entry in entries:
        stream.seek(max(0, entry.header_offset) + 26)
        lengths = stream.read(4)
        if len(lengths) == 4:
            start = entry.header_offset + 30 + sum(struct.unpack("<HH", lengths))
            yield start, entry.file_size, f"[{entry.filename}]"


def _check_span(stream: BinaryIO, start: int, size: int, named: str) -> None:
    stream.seek(start)
    if stream.read(len(MAGIC)) != MAGIC:
        return
    try:
        _check_layer(stream, start, size)
    except ValueError as error:
        raise InputError(
            f"{named}: a damaged binary layer: {error}; copy it again from where it came from, or "
            "write it again"
        ) from error


def _check_layer(stream: BinaryIO, start: int, size: int) -> None:
    """Raise ValueError, saying what is wrong."""
    if size < HEADER_SIZE:
        raise ValueError(f"its {size} bytes end within its header")
    head = _read(stream, start, HEADER_SIZE)
    if (head[8], head[9]) < OLDEST_VERSION:
        return
    (table,) = struct.unpack_from("<q", head, 16)
    if not HEADER_SIZE <= table <= size - 8:
        raise ValueError(f"its table of contents is said to lie at {table} of {size} bytes")
    (count,) = struct.unpack("<Q", _read(stream, start + table, 8))
    end = table + 8 + count * ENTRY_SIZE
    if count > PART_LIMIT or end > size:
        raise ValueError(f"its table of contents, {count} parts at {table}, ends beyond {size}")
    entries = _read(stream, start + table + 8, count * ENTRY_SIZE)
    parts = []
    taken = [(0, HEADER_SIZE, "the header"), (table, end, "the table of contents")]
    for name, at, length in struct.iter_unpack("<16sqq", entries):
        called = name.rstrip(b"\0").decode("ascii", "backslashreplace")
        if not 0 <= at <= size or not 8 <= length <= size - at:
            raise ValueError(f"part {called} is said to be {length} at {at} of {size} bytes")
        taken.append((at, at + length, called))
        (holds,) = struct.unpack("<Q", _read(stream, start + at, 8))
        parts.append(_Part(called, at, length, holds))
    _check_overlaps(taken)
    _check_counts(parts)


def _check_overlaps(taken: list[tuple[int, int, str]]) -> None:
    taken.sort()
    for (_, end, before), (start, _, after) in itertools.pairwise(taken):
        if start < end:
            raise ValueError(f"{before} and {after} overlap at {start}")


def _check_counts(parts: list[_Part]) -> None:
    found = {part.name: part for part in parts}
    missing = [name for name in PARTS if name not in found]
    if missing or len(found) != len(parts):
        raise ValueError(
            f"its parts are {', '.join(part.name for part in parts)}, not those of USD"
        )
    for name in PARTS:
        part = found[name]
        most = part.size * NUMBERS_PER_BYTE if name != "STRINGS" else part.size // BYTES_PER_STRING
        if part.count > most:
            raise ValueError(
                f"part {name} of {part.size} bytes is said to hold {part.count}, {most} at most"
            )
    specs, paths = found["SPECS"].count, found["PATHS"].count
    if specs > paths:
        raise ValueError(f"it is said to hold {specs} specs at {paths} paths")


def _read(stream: BinaryIO, at: int, size: int) -> bytes:
    stream.seek(at)
    found = stream.read(size)
    if len(found) < size:
        raise ValueError(f"it ends at {at + len(found)}, before {at + size}")
    return found
