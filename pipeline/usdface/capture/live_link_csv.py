"""CSV files of Epic's Live Link Face app: weights, head and eye rotations.

One header line, then a timecode ``HH:MM:SS:FF.fff`` per row. The timecode base is often twice the
rate of the rows, so the rate is taken from the steps between rows. A row without values (a count of
0) is a frame without a face. Generators of speech animation write milliseconds of the second after
the dot, and frames that rounding repeats and skips.
"""

import re
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from usdface.capture.channel_take import build_channel_take, start_notes
from usdface.capture.marker_take import Capture, CaptureOptions
from usdface.capture.sample_times import SampleTimes, resolve_device_times
from usdface.capture.text_table import (
    TableLine,
    head_titles,
    parse_cells,
    read_header,
    read_lines,
    split_cells,
)
from usdface.core.arrays import FloatArray
from usdface.core.errors import InputError
from usdface.core.rates import timecode_of
from usdface.core.text import pluralize

_TIMECODE = re.compile(r"(\d\d):(\d\d):(\d\d):(\d{1,3}(?:\.\d{1,9})?)", re.ASCII)
_TITLES = ("timecode", "blendshapecount")
_BASES = (24, 25, 30, 48, 50, 60, 100, 120)
_DAY_SECONDS = 24 * 60 * 60
_TWO_RATES_SHARE = 0.2
"""Share of rows at half or twice the median step above which the device has changed its rate."""
_FEWEST_FRAMES = 3
"""Range of frames below which decimals can be milliseconds by chance."""
_ROTATIONS = ("Yaw", "Pitch", "Roll")


@dataclass(frozen=True)
class _Rows:
    """Content of the rows."""

    whole: list[int]
    """Timecode: seconds since midnight."""
    parts: list[float]
    """Timecode: frames within the second."""
    values: list[list[float]]
    lines: list[int]
    lost: int
    """Rows without a face, between others."""
    before: int
    after: int
    """`before`, `after`: rows without a face before the first with one, after the last."""


def is_live_link_csv(head: bytes) -> bool:
    """Return whether a file is a Live Link Face recording, from its first bytes."""
    return tuple(title.lower() for title in head_titles(head)[:2]) == _TITLES


def read_live_link_csv(path: Path, options: CaptureOptions) -> Capture:
    """Read weights and rotations as channels, named by the header."""
    lines = read_lines(path)
    header, delimiter, titles = read_header(lines)
    if tuple(title.lower() for title in titles[:2]) != _TITLES or len(titles) < 3:
        raise InputError(
            f"{header.where}: begins {header.text[:24]!r}; it must begin with Timecode and "
            "BlendShapeCount and name the shapes: export the recording again"
        )
    rows = _read_rows(path, lines, titles, delimiter)
    notes = list[str]()
    if rows.lost:
        notes.append(f"{pluralize(rows.lost, 'row')} without a face, interpolated")
    if rows.after:
        notes.append(f"{pluralize(rows.after, 'row')} without a face at the end, left out")
    where = f"{path} Timecode in seconds"
    base = _settle_base(rows, notes, where)
    seconds = _unwrap(_without_milliseconds(rows, base, notes), base)
    times = resolve_device_times(seconds, np.array(rows.lines), where=where)
    _check_one_rate(seconds, rows, where)
    notes += start_notes(rows.before, times.rate)
    if round(float(times.rate)) != base and base % times.rate == 0:
        notes.append(
            f"the timecode counts in {base}ths of a second; rows come at "
            f"{float(times.rate):g} frames per second"
        )
    if any(name.endswith(_ROTATIONS) for name in titles):
        notes.append("head and eye rotations are kept as channels, in radians")
    return build_channel_take(
        path,
        titles[2:],
        np.array(rows.values),
        times,
        notes=notes,
        format_name="live-link-csv",
        timecode_start=_start(seconds[0], times, notes),
    )


def _read_rows(path: Path, lines: Iterator[TableLine], titles: list[str], delimiter: str) -> _Rows:
    rows = _Rows([], [], [], [], 0, 0, 0)
    before = lost = latest = 0  # rows without a face: at the start, in between, since the last
    for line in lines:
        cells = split_cells(line, delimiter)
        if not any(cells):
            continue
        whole, part = _read_timecode(cells[0], line)
        if len(cells) > 1 and cells[1] == "0" and not any(cells[2:]):
            latest += 1
            continue
        values = parse_cells(
            cells[1:], titles[1:], line, delimiter=delimiter, gaps=False, first_column=1
        )
        before, lost = (before, lost + latest) if rows.values else (latest, 0)
        latest = 0
        rows.whole.append(whole)
        rows.parts.append(part)
        rows.values.append(values[1:])
        rows.lines.append(line.number)
    if not rows.values:
        raise InputError(
            f"{path}: no row with a face after the header ({latest} without); export the recording "
            "again"
        )
    return replace(rows, lost=lost, before=before, after=latest)


def _read_timecode(cell: str, line: TableLine) -> tuple[int, float]:
    """Return whole seconds since midnight, and the frames within the second."""
    match = _TIMECODE.fullmatch(cell)
    hours, minutes, seconds = (int(match[group]) for group in (1, 2, 3)) if match else (99, 0, 0)
    if match is None or hours > 23 or minutes > 59 or seconds > 59:
        raise InputError(
            f"{line.where}, column 1 (Timecode): {cell[:24]!r}; it must be HH:MM:SS:FF or "
            "HH:MM:SS:FF.fff: export the recording again, or correct the cell"
        )
    return (hours * 60 + minutes) * 60 + seconds, float(match[4])


def _settle_base(rows: _Rows, notes: list[str], where: str) -> int:
    """Return the frames per second of the timecode, from where it wraps to 0."""
    whole, parts = np.array(rows.whole), np.array(rows.parts)
    turns = np.diff(whole) == 1
    within = np.diff(parts)[np.diff(whole) == 0]
    possible = [base for base in _BASES if base > parts.max()]
    if not possible:
        raise InputError(
            f"{where} line {rows.lines[int(parts.argmax())]}: counts to frame {parts.max():g} "
            f"within a second, more than {_BASES[-1]}; export the recording again"
        )
    if not turns.any() or not len(within):
        notes.append(
            f"the recording never reaches a full second; its timecode is taken to count in "
            f"{possible[0]}ths"
        )
        return possible[0]
    estimate = float(np.median(within) - np.median(np.diff(parts)[turns]))
    return min(possible, key=lambda base: abs(base - estimate))


def _without_milliseconds(rows: _Rows, base: int, notes: list[str]) -> _Rows:
    """Return the rows with the time after the dot in frames, if it is milliseconds of the second.

    That of the app is a share of a frame, which hardly changes from row to row.
    """
    frames, share = np.divmod(np.array(rows.parts), 1.0)
    within = share * base
    if np.ptp(frames) < _FEWEST_FRAMES or (np.abs(within - frames) > 1 + 1e-3 * base).any():
        return rows
    notes.append("the timecode's decimals are milliseconds of the second; rows are timed by them")
    return replace(rows, parts=within.tolist())


def _unwrap(rows: _Rows, base: int) -> FloatArray:
    """Return seconds since the first midnight, continuous across later ones."""
    seconds: FloatArray = np.array(rows.whole) + np.array(rows.parts) / base
    midnights = np.diff(seconds) < -_DAY_SECONDS / 2
    seconds[1:] += _DAY_SECONDS * np.cumsum(midnights)
    return seconds


def _check_one_rate(seconds: FloatArray, rows: _Rows, where: str) -> None:
    """Refuse a recording whose rows come at one rate for a while, then at twice or half of it."""
    steps = np.diff(seconds)
    usual = float(np.median(steps))
    for factor in (0.5, 2.0):
        other = np.abs(steps / usual - factor) < 0.1
        if other.mean() > _TWO_RATES_SHARE:
            at = int(np.argmax(other)) + 1
            raise InputError(
                f"{where} line {rows.lines[at]}: two frame rates: most rows come at about "
                f"{1 / usual:.3g} per second, here at {1 / (factor * usual):.3g}; split the "
                "recording there, or record it again"
            )


def _start(seconds: float, times: SampleTimes, notes: list[str]) -> str:
    """Return the SMPTE label of the first row, at the rate of the rows."""
    # Timecodes have three decimals: rounding may put a frame just below.
    frames = int(seconds * float(times.rate) + 1e-3)
    try:
        return timecode_of(frames, times.rate)
    except InputError as error:
        notes.append(f"the timecode is not kept: {error}")
        return ""
