"""The parameter section of a C3D file: groups of named values that describe the data.

Every offset and count is checked against the section before it is used. Real files have damaged
parameters after valid ones, so the first damaged record ends the reading with a note: required
parameters are either read by then, or reported as missing by name.
"""

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from itertools import chain, count, takewhile

import numpy as np

from usdface.core.arrays import Float32Array, FloatArray

_TYPE_TEXT = -1
_TYPE_BYTE = 1
_TYPE_INTEGER = 2
_TYPE_REAL = 4
_SECTION_HEADER_SIZE = 4
Value = FloatArray | tuple[str, ...]


@dataclass(frozen=True)
class Processor:
    """Byte order of a C3D file."""

    name: str
    order: str
    """Of integers, and of floats except for DEC."""

    @property
    def integer(self) -> np.dtype[np.int16]:
        """16-bit signed."""
        return np.dtype(f"{self.order}i2")

    @property
    def unsigned(self) -> np.dtype[np.uint16]:
        """16-bit unsigned."""
        return np.dtype(f"{self.order}u2")

    def floats(self, raw: bytes | bytearray | memoryview) -> Float32Array:
        """Decode 32-bit floats.

        DEC machines stored VAX F floats: the 16-bit words are swapped and the exponent is larger by
        two, so the words in order, read as IEEE, are four times the value.
        """
        if self.name != "DEC":
            return np.frombuffer(raw, f"{self.order}f4").astype(np.float32, copy=False)
        words = np.frombuffer(raw, "<u2")[: len(raw) // 4 * 2].reshape(-1, 2)
        swapped = np.ascontiguousarray(words[:, ::-1]).view("<f4")[:, 0]
        with np.errstate(invalid="ignore"):  # a VAX reserved operand reads as a signalling NaN
            return (swapped * np.float32(0.25)).astype(np.float32, copy=False)


PROCESSORS = {
    84: Processor("Intel", "<"),
    85: Processor("DEC", "<"),
    86: Processor("MIPS", ">"),
}
"""By the fourth byte of the parameter section."""


@dataclass(frozen=True)
class Parameters:
    """Values by ``'GROUP:NAME'`` in capitals: numbers as float64, text as a tuple of str."""

    values: Mapping[str, Value]
    """Integers keep their sign as stored; see `unsigned` for counts."""
    notes: tuple[str, ...] = ()
    """Parameters that could not be read."""

    def numbers(self, name: str) -> FloatArray:
        """Return the numbers of a parameter and its continuations, flat; empty if it has none."""
        found = [part.ravel() for part in self._parts(name) if isinstance(part, np.ndarray)]
        return np.concatenate(found) if found else np.empty(0)

    def number(self, name: str) -> float | None:
        """Return the first number of a parameter, or None."""
        numbers = self.numbers(name)
        return float(numbers[0]) if numbers.size else None

    def unsigned(self, name: str) -> int | None:
        """Return the first number as a count: 16-bit integers above 32,767 are stored negative."""
        number = self.number(name)
        if number is None or not math.isfinite(number):
            return None
        return int(number) + 0x10000 if -0x8000 <= number < 0 else int(number)

    def long(self, name: str) -> int | None:
        """Return a 32-bit count stored as two 16-bit words, the low one first."""
        words = self.numbers(name)
        if words.size < 2 or not np.isfinite(words).all():
            return None
        low, high = (int(word) % 0x10000 for word in words[:2])
        return low + (high << 16)

    def texts(self, name: str) -> tuple[str, ...]:
        """Return the texts of a parameter and of its continuations."""
        parts = (part for part in self._parts(name) if isinstance(part, tuple))
        return tuple(text for part in parts for text in part)

    def _parts(self, name: str) -> Iterator[Value]:
        """Yield a parameter and its continuations ``NAME2``, ``NAME3`` and so on.

        One parameter holds at most 255 entries, so long label lists are continued.
        """
        names = chain([name], (f"{name}{number}" for number in count(2)))
        return (self.values[each] for each in takewhile(self.values.__contains__, names))

    def text(self, name: str) -> str:
        """Return the first text of a parameter; empty when absent."""
        value = self.values.get(name)
        return value[0] if isinstance(value, tuple) and value else ""


def parse_parameters(section: bytes, *, processor: Processor) -> Parameters:
    """Parse a parameter section, its four header bytes included.

    Parameters
    ----------
    section : bytes
        Up to the start of the data, or longer.
    processor : Processor
        Byte order of integers and floats.
    """
    groups: dict[int, str] = {}
    found: dict[tuple[int, str], Value] = {}
    notes: list[str] = []
    position = _SECTION_HEADER_SIZE
    while position + 2 <= len(section):
        name_length = abs(int.from_bytes(section[position : position + 1], signed=True))
        group = int.from_bytes(section[position + 1 : position + 2], signed=True)
        if name_length == 0 or group == 0:
            break
        try:
            name, following, value = _parse_record(section, position, name_length, group, processor)
        except ValueError as error:
            notes.append(
                f"parameter section damaged at byte {position}: {error}; the rest of it is ignored"
            )
            break
        if value is None:
            groups[-group] = name
        else:
            found.setdefault((group, name), value)
        if following > len(section):
            notes.append(f"parameter {name} at byte {position} links past the section's end")
        if following <= position:
            break
        position = following
    values = {f"{groups.get(group, group)}:{name}": value for (group, name), value in found.items()}
    return Parameters(values, tuple(notes))


def _parse_record(
    section: bytes, position: int, name_length: int, group: int, processor: Processor
) -> tuple[str, int, Value | None]:
    """Return the name of a group or parameter, where the next begins, and a parameter's value."""
    link = position + 2 + name_length
    if link + 2 > len(section):
        raise ValueError("a name runs past its end")
    name = section[position + 2 : link].decode("latin-1").strip().upper()
    offset = int(np.frombuffer(section, processor.unsigned, 1, link)[0])
    following = link + offset if offset else 0
    value = None if group < 0 else _parse_value(section, link + 2, name, processor)
    return name, following, value


def _parse_value(section: bytes, position: int, name: str, processor: Processor) -> Value:
    if position + 2 > len(section):
        raise ValueError(f"{name} has no room for its type")
    kind = int.from_bytes(section[position : position + 1], signed=True)
    rank = section[position + 1]
    dimensions = tuple(section[position + 2 : position + 2 + rank])
    start = position + 2 + rank
    if kind not in (_TYPE_TEXT, _TYPE_BYTE, _TYPE_INTEGER, _TYPE_REAL) or len(dimensions) < rank:
        raise ValueError(f"{name} has type {kind} and {rank} dimensions")
    count = math.prod(dimensions)
    stop = start + count * abs(kind)
    if stop > len(section):
        raise ValueError(f"{name} claims {count} values, {stop - len(section)} bytes past its end")
    raw = section[start:stop]
    if kind == _TYPE_TEXT:
        length = dimensions[0] if dimensions else 1
        if length == 0:
            return ("",) * min(math.prod(dimensions[1:]), 0xFF)
        pieces = (raw[start : start + length] for start in range(0, len(raw), length))
        return tuple(piece.decode("latin-1").strip(" \t\r\n\x00") for piece in pieces)
    if kind == _TYPE_BYTE:
        return np.frombuffer(raw, np.int8).astype(np.float64)
    if kind == _TYPE_INTEGER:
        return np.frombuffer(raw, processor.integer).astype(np.float64)
    return processor.floats(raw).astype(np.float64)
