"""The layout of a binary USD layer (a crate), as far as damaging one on purpose needs it.

88 bytes of header: ``PXR-USDC``, the version, where the table of contents begins. The table: a
count, then per section a name of 16 bytes, a start and a size. Sections of numbers are packed with
LZ4.
"""

import struct
from dataclasses import dataclass

HEADER_SIZE, TABLE_AT, ENTRY_SIZE = 88, 16, 32
"""[bytes]"""


@dataclass(frozen=True)
class Section:
    """One section: its name, where it lies, and where the table says so [bytes]."""

    name: str
    start: int
    size: int
    entry: int


def table_start(content: bytes) -> int:
    """Return where the table of contents begins [bytes]."""
    return int(struct.unpack_from("<q", content, TABLE_AT)[0])


def sections(content: bytes) -> list[Section]:
    """Return the sections of a sound crate in the order of its table."""
    table = table_start(content)
    (count,) = struct.unpack_from("<Q", content, table)
    found = []
    for entry in range(table + 8, table + 8 + count * ENTRY_SIZE, ENTRY_SIZE):
        name, start, size = struct.unpack_from("<16sqq", content, entry)
        found.append(Section(name.rstrip(b"\0").decode(), start, size, entry))
    return found


def unpack(block: bytes, size: int) -> bytes:
    """Return what one LZ4 block holds, as the format defines it."""
    out = bytearray()
    at = 0
    while at < len(block):
        token = block[at]
        length, at = _length(block, token >> 4, at + 1)
        out += block[at : at + length]
        at += length
        if at >= len(block):
            break
        back = struct.unpack_from("<H", block, at)[0]
        length, at = _length(block, token & 15, at + 2)
        for _ in range(length + 4):  # may repeat what it has just written
            out.append(out[-back])
    if len(out) != size:
        raise ValueError(f"{len(out)} bytes were packed, {size} expected")
    return bytes(out)


def _length(block: bytes, length: int, at: int) -> tuple[int, int]:
    if length == 15:
        while block[at] == 255:
            length, at = length + 255, at + 1
        length, at = length + block[at], at + 1
    return length, at


def pack(content: bytes) -> bytes:
    """Return one LZ4 block that holds what is given as it is."""
    if len(content) < 15:
        return bytes([len(content) << 4]) + content
    more, rest = divmod(len(content) - 15, 255)
    return b"\xf0" + b"\xff" * more + bytes([rest]) + content


def with_values(content: bytes, changed: dict[int, int]) -> bytes:
    """Return a crate in whose fields some values are others, packed as they should be.

    The section of fields is written anew behind everything else, and the table says so.

    Parameters
    ----------
    content : bytes
        A sound crate.
    changed : dict
        By the number of a field, the 64 bits that say of what type its value is and where it lies.
    """
    section = next(each for each in sections(content) if each.name == "FIELDS")
    values = bytearray(field_values(content))
    for index, value in changed.items():
        struct.pack_into("<Q", values, index * 8, value)
    at = section.start + 8
    head = content[section.start : at + 8 + struct.unpack_from("<Q", content, at)[0]]
    packed = b"\0" + pack(bytes(values))  # one chunk
    written = head + struct.pack("<Q", len(packed)) + packed
    out = bytearray(content)
    struct.pack_into("<qq", out, section.entry + 16, len(content), len(written))
    return bytes(out) + written


def field_values(content: bytes) -> bytes:
    """Return 64 bits for each field of a sound crate: type, flags and place of its value."""
    section = next(each for each in sections(content) if each.name == "FIELDS")
    count, size = struct.unpack_from("<QQ", content, section.start)
    at = section.start + 16 + size
    (size,) = struct.unpack_from("<Q", content, at)
    if content[at + 8] != 0:
        raise ValueError("more than one chunk of fields: a smaller layer, please")
    return unpack(content[at + 9 : at + 8 + size], count * 8)
