"""CSV files of OpenFace's FeatureExtraction: 3-D landmarks and action units from video.

Landmarks ``X_0``, ``Y_0``, ``Z_0``, … are in millimetres from the camera, Y down, Z away from it;
intensities of action units ``AU01_r``, … are 0 to 5. Rows with success 0 hold no face.
"""

import re
from collections import Counter
from dataclasses import replace
from fractions import Fraction
from pathlib import Path
from typing import cast

import numpy as np

from usdface.capture.channel_take import fill_frames, gap_ranges
from usdface.capture.marker_take import (
    Capture,
    CaptureHeader,
    CaptureOptions,
    MarkerTable,
    build_table_take,
    resolve_units,
)
from usdface.capture.sample_times import rate_of_times, resolve_frame_numbers
from usdface.capture.text_table import (
    NumberTable,
    TableLine,
    head_titles,
    read_header,
    read_lines,
    read_number_table,
)
from usdface.core.arrays import BoolArray, FloatArray, IntArray, index_of
from usdface.core.assets import Markers, Take, WeightsClip
from usdface.core.errors import InputError
from usdface.core.rates import exact_rate

_LANDMARK = re.compile(r"X_(\d+)", re.ASCII)
_INTENSITY = re.compile(r"(AU\d+)_r", re.ASCII)
_FASTEST_CAMERA = 1000
"""Rate from which timestamps count the rows in milliseconds [Hz]."""
_HIGHEST_INTENSITY = 5.0
_NEEDED = ("frame", "timestamp", "confidence", "success")
_TO_Y_UP = np.diag([1.0, -1.0, -1.0])


def is_openface_csv(head: bytes) -> bool:
    """Return whether a file is an OpenFace table, from its first bytes."""
    return set(head_titles(head)).issuperset(_NEEDED)


def read_openface_csv(path: Path, options: CaptureOptions) -> Capture:
    """Read landmarks as markers, and intensities divided by 5 as channels."""
    lines = read_lines(path)
    header, delimiter, titles = read_header(lines)
    at, landmarks, units = _find_columns(titles, header)
    table = read_number_table(lines, titles, path=path, delimiter=delimiter, gaps=True)
    notes = []
    others = len(titles) - len(_NEEDED) - 3 * len(landmarks) - len(units) - ("face_id" in at)
    if others:
        notes.append(f"{others} other columns left out: 2-D and eye landmarks, gaze, head pose")
    table = _one_face(table, at.get("face_id"), notes)
    first_frame, frames = resolve_frame_numbers(
        table.values[:, at["frame"]], table.lines, where=str(path)
    )
    if options.rate is not None:
        rate = exact_rate(options.rate, where="--rate")
    else:
        rate = rate_of_times(table.values[:, at["timestamp"]], frames, where=str(path))
        if rate >= _FASTEST_CAMERA:
            notes.append(
                f"{float(rate):g} frames per second by the timestamps, as OpenFace counts pictures "
                "whose rate it does not know; state it with --rate"
            )
    seen = _rows_with_face(table.values[:, at["success"]], path, notes)
    source = None
    if units:
        source = _read_units(table, units, seen, frames, first_frame, rate, path=path)
        notes.append("action units are kept as channels, intensity / 5")
    if not landmarks:
        take = Take(path.stem, rate, first_frame, source=source)
        return Capture(take, "openface-csv", tuple(notes))

    axes = [[at[f"{axis}_{number}"] for number in landmarks] for axis in "XYZ"]
    points = table.values[:, np.array(axes).T]
    points[~seen] = np.nan
    to_mm = resolve_units("mm", options, notes, where=str(path), field="OpenFace") * _TO_Y_UP
    capture = build_table_take(
        CaptureHeader(path, "openface-csv", rate, first_frame, notes=notes),
        MarkerTable(
            [f"landmark_{number}" for number in landmarks],
            range(0, 3 * len(landmarks), 3),
            points.reshape(len(points), -1),
            frames,
            to_mm,
            header.where,
        ),
        options,
    )
    confidence = np.zeros(int(frames[-1]) + 1)
    stated = table.values[:, at["confidence"]]
    confidence[frames] = np.nan_to_num(stated, posinf=0, neginf=0)
    return _add(capture, source, confidence)


def _find_columns(
    titles: list[str], header: TableLine
) -> tuple[dict[str, int], list[str], dict[str, int]]:
    """Return columns by title, numbers of landmarks, and columns of action units by name."""
    at = index_of(titles)
    landmarks = [
        match[1]
        for match in map(_LANDMARK.fullmatch, titles)
        if match and f"Y_{match[1]}" in at and f"Z_{match[1]}" in at
    ]
    units = {match[1]: at[match[0]] for match in map(_INTENSITY.fullmatch, titles) if match}
    missing = [title for title in _NEEDED if title not in at]
    if missing or not (landmarks or units):
        wanted = ", ".join(missing) or "3-D landmarks (X_0 …) nor intensities (AU01_r …)"
        raise InputError(
            f"{header.where}: no {wanted}; run FeatureExtraction on the video with -3Dfp and -aus"
        )
    return at, landmarks, units


def _rows_with_face(success: FloatArray, path: Path, notes: list[str]) -> BoolArray:
    seen: BoolArray = success == 1
    if not seen.any():
        raise InputError(
            f"{path}: no face found in any of {len(seen)} frames (success is 0); film the face "
            "larger and lit, then run OpenFace again"
        )
    if not seen.all():
        notes.append(
            f"no face found in {np.sum(~seen)} of {len(seen)} rows: gaps of the landmarks, "
            "interpolated in the action units"
        )
    return seen


def _one_face(table: NumberTable, face_column: int | None, notes: list[str]) -> NumberTable:
    """Return the rows of the face with the most rows."""
    if face_column is None:
        return table
    faces = table.values[:, face_column]
    counts = Counter(faces.tolist())
    if len(counts) == 1:
        return table
    face, rows = counts.most_common(1)[0]
    notes.append(f"{len(counts)} faces; face {face:g}, in {rows} of {len(faces)} rows, used")
    kept = faces == face
    return NumberTable(table.values[kept], table.lines[kept])


def _read_units(
    table: NumberTable,
    units: dict[str, int],
    seen: BoolArray,
    frames: IntArray,
    first_frame: int,
    rate: Fraction,
    *,
    path: Path,
) -> WeightsClip:
    """Return intensities as weights for all frames, interpolated where there is no face."""
    values = table.values[:, list(units.values())][seen] / _HIGHEST_INTENSITY
    finite = np.isfinite(values)
    if not finite.all():
        row, unit = np.argwhere(~finite)[0]
        name = list(units)[unit]
        raise InputError(
            f"{path} line {table.lines[seen][row]}, column {units[name] + 1} ({name}_r): not a "
            "number in a row with a face; run OpenFace again"
        )
    filled = fill_frames(values, frames[seen].astype(np.float64))
    before, after = int(frames[seen][0]), int(frames[-1] - frames[seen][-1])
    held = np.pad(filled, ((before, after), (0, 0)), mode="edge")
    missing = np.ones(len(held), bool)
    missing[frames[seen]] = False
    return WeightsClip(tuple(units), held, first_frame, rate, gap_ranges(missing, first_frame))


def _add(capture: Capture, source: WeightsClip | None, confidence: FloatArray) -> Capture:
    """Add weights and the tracker's confidence to a take of markers."""
    markers = cast(Markers, capture.take.markers)
    seen = markers.confidence * np.clip(confidence, 0, 1)[:, None]
    markers = replace(markers, confidence=seen.astype(np.float32))
    return replace(capture, take=replace(capture.take, markers=markers, source=source))
