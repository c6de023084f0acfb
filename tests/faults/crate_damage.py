"""Ways to damage a binary layer and a package: where they say how much there is, and where it lies.

Each takes a generator of random numbers and a sound file, and returns one that is damaged: the same
seed gives the same damage.
"""

import struct
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from tests.faults.crate_file import (
    ENTRY_SIZE,
    HEADER_SIZE,
    TABLE_AT,
    field_values,
    sections,
    table_start,
    with_values,
)


@dataclass(frozen=True)
class Sound:
    """A sound file, and another of its kind, to be spliced with it."""

    content: bytes
    other: bytes


Damage = Callable[[np.random.Generator, Sound], bytes]

NUMBERS = (0, 1, -1, 2, 2**15, 2**31 - 1, -(2**31), 2**32, 2**40, 2**47, 2**62, 2**63 - 1, -(2**63))
"""As counts, sizes and places: none, few, the most and more than there can be."""


def _word(rng: np.random.Generator, sound: Sound) -> bytes:
    """Return 64 bits that no size may be, or that are off by little."""
    if rng.random() < 0.3:
        return struct.pack("<q", len(sound.content) + int(rng.integers(-64, 65)))
    return struct.pack("<q", NUMBERS[rng.integers(len(NUMBERS))])


def _put(content: bytes, at: int, found: bytes) -> bytes:
    return content[:at] + found + content[at + len(found) :]


def flip(rng: np.random.Generator, sound: Sound) -> bytes:
    """Change single bytes anywhere."""
    changed = bytearray(sound.content)
    for at in rng.integers(len(changed), size=rng.integers(1, 9)):
        changed[at] ^= int(rng.integers(1, 256))
    return bytes(changed)


def overwrite(rng: np.random.Generator, sound: Sound) -> bytes:
    """Overwrite a run of bytes."""
    at, length = int(rng.integers(len(sound.content))), int(rng.integers(1, 257))
    run = (b"\0" * length, b"\xff" * length, rng.bytes(length))[rng.integers(3)]
    return _put(sound.content, at, run)[: len(sound.content)]


def move(rng: np.random.Generator, sound: Sound) -> bytes:
    """Put a stretch in again elsewhere: all that follows lies where nobody looks for it."""
    low, high, at = sorted(map(int, rng.integers(len(sound.content), size=3)))
    return sound.content[:low] + sound.content[high:at] + sound.content[low:]


def cut(rng: np.random.Generator, sound: Sound) -> bytes:
    """Cut where a part of the file begins or ends, or next to it."""
    content = sound.content
    table = table_start(content)
    places = [0, 8, TABLE_AT, TABLE_AT + 8, HEADER_SIZE, table, table + 8, len(content)]
    for section in sections(content):
        places += [section.start, section.start + section.size, section.entry + ENTRY_SIZE]
    at = places[rng.integers(len(places))] + int(rng.integers(-9, 10))
    return content[: max(0, min(at, len(content) - 1))]


def header(rng: np.random.Generator, sound: Sound) -> bytes:
    """Damage the first bytes: version and the place of the table."""
    if rng.random() < 0.3:
        return _put(sound.content, 8, bytes([*rng.integers(0, 16, size=3)]))
    return _put(sound.content, int(rng.integers(0, HEADER_SIZE - 8)), _word(rng, sound))


def table(rng: np.random.Generator, sound: Sound) -> bytes:
    """Change, exchange, empty or rename entries of the table of contents."""
    content = sound.content
    entries = sections(content)
    one, two = (entries[index] for index in rng.choice(len(entries), 2, replace=False))
    kind = rng.integers(6)
    if kind == 0:
        return _put(content, table_start(content), _word(rng, sound))
    if kind == 1:
        return _put(content, one.entry, bytes(ENTRY_SIZE))
    if kind == 2:
        places = content[one.entry + 16 : one.entry + 32], content[two.entry + 16 : two.entry + 32]
        return _put(_put(content, one.entry + 16, places[1]), two.entry + 16, places[0])
    if kind == 3:
        return _put(content, one.entry, content[two.entry : two.entry + 16])
    return _put(content, one.entry + 16 + 8 * int(rng.integers(2)), _word(rng, sound))


def section(rng: np.random.Generator, sound: Sound) -> bytes:
    """Change the counts that sections begin with, and bytes of what they hold."""
    found = sections(sound.content)
    one = found[rng.integers(len(found))]
    if rng.random() < 0.5:
        at = one.start + 8 * int(rng.integers(min(4, max(1, one.size // 8))))
        return _put(sound.content, at, _word(rng, sound))
    changed = bytearray(sound.content)
    for at in rng.integers(one.start, one.start + one.size, size=rng.integers(1, 5)):
        changed[at] ^= int(rng.integers(1, 256))
    return bytes(changed)


def counts(rng: np.random.Generator, sound: Sound) -> bytes:
    """Blow up 64 bits that read as a count or a place, among the values."""
    content = sound.content
    end = min(each.start for each in sections(content))
    words = np.frombuffer(content[HEADER_SIZE : end - (end - HEADER_SIZE) % 8], "<u8")
    likely = np.flatnonzero((words > 0) & (words <= len(content)))
    if len(likely) == 0:
        return flip(rng, sound)
    at = HEADER_SIZE + 8 * int(rng.choice(likely))
    return _put(content, at, _word(rng, sound))


def values(rng: np.random.Generator, sound: Sound) -> bytes:
    """Let fields be of other types, or lie elsewhere; everything else is as it should be."""
    found = np.frombuffer(field_values(sound.content), "<u8")
    changed = {}
    for index in rng.integers(len(found), size=rng.integers(1, 4)):
        value = int(found[index])
        kind = rng.integers(4)
        if kind == 0:  # the type
            value = value & ~(0xFF << 48) | int(rng.integers(0, 64)) << 48
        elif kind == 1:  # array, inlined, compressed
            value ^= 1 << int(rng.integers(61, 64))
        elif kind == 2:  # the place, or the value itself
            value = value & ~(2**48 - 1) | int(rng.integers(0, len(sound.content) + 64))
        else:
            value = value & ~(2**48 - 1) | NUMBERS[rng.integers(len(NUMBERS))] & (2**48 - 1)
        changed[int(index)] = value
    return with_values(sound.content, changed)


def splice(rng: np.random.Generator, sound: Sound) -> bytes:
    """Go on as another file from somewhere on."""
    at = int(rng.integers(len(sound.content)))
    if rng.random() < 0.5:
        return sound.content[:at] + sound.other[at:]
    begin = min(each.start for each in sections(sound.content))
    return sound.content[:begin] + sound.other[min(e.start for e in sections(sound.other)) :]


CRATE_DAMAGES: tuple[Damage, ...] = (
    flip, overwrite, move, cut, header, table, section, counts, values, splice,
)  # fmt: skip

DIRECTORY, ENTRY, LOCAL = b"PK\x05\x06", b"PK\x01\x02", b"PK\x03\x04"


def zip_records(rng: np.random.Generator, sound: Sound) -> bytes:
    """Change sizes, places and names in the records of a package."""
    content = sound.content
    mark, length = ((DIRECTORY, 22), (ENTRY, 46), (LOCAL, 30))[rng.integers(3)]
    places = []
    at = content.find(mark)
    while at >= 0:
        places.append(at)
        at = content.find(mark, at + 4)
    start = places[rng.integers(len(places))] + int(rng.integers(0, length - 3))
    number = NUMBERS[rng.integers(len(NUMBERS))] & 0xFFFFFFFF
    return _put(content, start, struct.pack("<I", number)[: int(rng.choice((1, 2, 4)))])


def zip_cut(rng: np.random.Generator, sound: Sound) -> bytes:
    """Cut a package, mostly within its directory."""
    directory = sound.content.find(ENTRY)
    low = directory if rng.random() < 0.7 else 0
    return sound.content[: int(rng.integers(low, len(sound.content)))]


def zip_splice(rng: np.random.Generator, sound: Sound) -> bytes:
    """Leave out what lies between the first file and the directory, or say the directory twice."""
    content = sound.content
    directory = content.find(ENTRY)
    if rng.random() < 0.5:
        return content[: int(rng.integers(directory))] + content[directory:]
    return content + content[directory:]


PACKAGE_DAMAGES: tuple[Damage, ...] = (flip, overwrite, zip_records, zip_cut, zip_splice)
