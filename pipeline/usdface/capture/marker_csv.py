"""Tables of markers: frame numbers, times or both, then NAME.x, NAME.y, NAME.z."""

import re
from fractions import Fraction
from pathlib import Path
from typing import cast

import numpy as np

from usdface.capture.marker_take import (
    Capture,
    CaptureHeader,
    CaptureOptions,
    MarkerTable,
    build_table_take,
    space_to_mm,
)
from usdface.capture.sample_times import (
    index_kind,
    index_seconds,
    rate_of_times,
    resolve_device_times,
    resolve_frame_numbers,
)
from usdface.capture.text_table import (
    NumberTable,
    head_titles,
    read_header,
    read_lines,
    read_number_table,
    without_repeated_rows,
)
from usdface.core.arrays import FloatArray, IntArray
from usdface.core.errors import InputError
from usdface.core.rates import exact_rate
from usdface.core.text import first_few, pluralize

_X = re.compile(
    r"(?!.*(?:rot(?:ation)?|euler|quat|angles?|velocity|scale).x$)(.+)[._: ]x", re.IGNORECASE
)
"""Title of a marker's x; rotations and velocities of bones have such triples too."""


def is_marker_csv(head: bytes) -> bool:
    """Return whether a file is a table of markers, from its first bytes."""
    titles = head_titles(head)
    least = 3 if titles and index_kind(titles[0]) == "frame" else max(9, len(titles) / 2)
    return 3 * len(_triples(titles)) >= least


def read_marker_csv(path: Path, options: CaptureOptions) -> Capture:
    """Read every NAME.x, NAME.y, NAME.z as a marker; the dot may be ``_``, ``:`` or a space."""
    lines = read_lines(path)
    header, delimiter, titles = read_header(lines)
    triples = _triples(titles)
    at = {kind: place for place, title in enumerate(titles) if (kind := index_kind(title))}
    timed = {"time", "s", "ms"} & at.keys()
    if not (timed or ("frame" in at and options.rate is not None)) or not triples:
        raise InputError(
            f"{header.where}: it must name a column time_s or time_ms, or a column frame with the "
            "frames per second given by --rate, and NAME.x, NAME.y, NAME.z for each marker (found "
            f"{', '.join(titles[:4])[:60]}, …); add what is missing"
        )
    read = {at.get(kind) for kind in ("frame", "time", "s", "ms")}
    read |= {place + axis for place in triples.values() for axis in range(3)}
    others = [place for place in range(len(titles)) if place not in read]
    table = read_number_table(
        lines, titles, path=path, delimiter=delimiter, gaps=True, texts=others
    )
    notes: list[str] = []
    table = without_repeated_rows(table, notes)
    first_frame, frames, rate = _frames(table, at, options, path)
    if "frame" not in at:
        notes.append("no column is called frame: frames are numbered from 1, by their times")
    if others:
        named = first_few([titles[place] for place in others])
        notes.append(f"{pluralize(len(others), 'column')} other than markers left out: {named}")
    up_note = "the table does not state the up axis; Y assumed"
    to_mm = space_to_mm(path, options, notes, units="", field="header", up_note=up_note)
    labels, starts = list(triples), list(triples.values())
    return build_table_take(
        CaptureHeader(path, "marker-csv", rate, first_frame, notes=notes),
        MarkerTable(labels, starts, table.values, frames, to_mm, header.where),
        options,
    )


def _frames(
    table: NumberTable, at: dict[str, int], options: CaptureOptions, path: Path
) -> tuple[int, IntArray, Fraction]:
    """Return the first frame number, the frame of each row from 0, and the frames per second.

    A stated rate makes times unnecessary; without frame numbers, times determine them.
    """
    seconds, where = index_seconds(at, table.values), str(path)
    stated = None if options.rate is None else exact_rate(options.rate, where="--rate")
    if "frame" in at:
        numbers = table.values[:, at["frame"]]
        first, frames = resolve_frame_numbers(numbers, table.lines, where=where)
        if stated is None:
            stated = rate_of_times(cast(FloatArray, seconds), frames, where=where)
        return first, frames, stated
    times = resolve_device_times(
        cast(FloatArray, seconds), table.lines, where=f"{where} times (seconds)"
    )
    if not times.even:
        raise InputError(
            f"{where}: rows come at uneven times, and markers need whole frames; export the take "
            "at one rate, or with a column frame"
        )
    return 1, times.frames.astype(np.int64), stated or times.rate


def _triples(titles: list[str]) -> dict[str, int]:
    """Return each marker's name and the column of its x, where y and z follow."""
    found = {}
    for at, title in enumerate(titles[:-2]):
        match = _X.fullmatch(title)
        if match is None:
            continue
        stem = title[:-1].lower()
        others = [title.lower() for title in titles[at + 1 : at + 4]]
        if others[:2] == [f"{stem}y", f"{stem}z"] and f"{stem}w" not in others:  # a quaternion
            found[match[1]] = at
    return found
