"""Consistency check of binary layers (crates) before USD opens them.

USD allocates memory for the numbers of specs, paths and tokens in the file before it reads them, so
that one damaged byte of a count takes gigabytes. Checked are the places and the counts of the
sections, some 300 bytes; values are not.
"""

import itertools
import struct
from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO
from zipfile import BadZipFile, ZipFile

from usdface.core.errors import InputError

MAGIC, HEADER_SIZE, ENTRY_SIZE = b"PXR-USDC", 88, 32
"""First bytes of a crate, and sizes of its header and of a section's entry [bytes]."""
PARTS = ("TOKENS", "STRINGS", "FIELDS", "FIELDSETS", "PATHS", "SPECS")
"""Sections of all versions of the format; later ones may have more."""
PART_LIMIT = 64

OLDEST_VERSION = (0, 4)
"""The oldest version that USD reads; it refuses older ones itself."""
NUMBERS_PER_BYTE = 4 * 255
"""Most numbers per packed byte: a number has at least two bits, and LZ4 compresses up to 255:1."""
BYTES_PER_STRING = 4


def check_crate(path: Path) -> None:
    """Refuse a binary layer with sections outside it, or with impossible counts.

    `path`: any file; only binary layers, and those in packages (``.usdz``), are checked.
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
        return  # reported when USD opens the file


def _files_in(stream: BinaryIO) -> Iterator[tuple[int, int, str]]:
    """Yield start, size and name of the files in a package; none if it is not one."""
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
    """Raise ValueError with the fault, if there is one."""
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
    parts = list[tuple[str, int, int]]()  # name, size and count
    spans = [(0, HEADER_SIZE, "the header"), (table, end, "the table of contents")]
    for padded, at, length in struct.iter_unpack("<16sqq", entries):
        name = padded.rstrip(b"\0").decode("ascii", "backslashreplace")
        if not 0 <= at <= size or not 8 <= length <= size - at:
            raise ValueError(f"part {name} is said to be {length} at {at} of {size} bytes")
        spans.append((at, at + length, name))
        (items,) = struct.unpack("<Q", _read(stream, start + at, 8))
        parts.append((name, length, items))
    for (_, end, before), (begin, _, after) in itertools.pairwise(sorted(spans)):
        if begin < end:
            raise ValueError(f"{before} and {after} overlap at {begin}")
    _check_counts(parts)


def _check_counts(parts: list[tuple[str, int, int]]) -> None:
    by_name = {name: (size, count) for name, size, count in parts}
    if not by_name.keys() >= set(PARTS) or len(by_name) != len(parts):
        raise ValueError(f"its parts are {', '.join(each[0] for each in parts)}, not those of USD")
    for name in PARTS:
        size, count = by_name[name]
        most = size * NUMBERS_PER_BYTE if name != "STRINGS" else size // BYTES_PER_STRING
        if count > most:
            raise ValueError(f"part {name} of {size} bytes is said to hold {count}, {most} at most")
    specs, paths = by_name["SPECS"][1], by_name["PATHS"][1]
    if specs > paths:
        raise ValueError(f"it is said to hold {specs} specs at {paths} paths")


def _read(stream: BinaryIO, at: int, size: int) -> bytes:
    stream.seek(at)
    data = stream.read(size)
    if len(data) < size:
        raise ValueError(f"it ends at {at + len(data)}, before {at + size}")
    return data
