"""CSV as OpenFace's FeatureExtraction writes it: 3-D landmarks and action units from video.

Landmarks ``X_0``, ``Y_0``, ``Z_0``, … are in millimetres from the camera, Y down and Z away from
it; action unit intensities ``AU01_r``, … run from 0 to 5. Rows without success hold no face.
"""

import re
from collections import Counter
from dataclasses import replace
from fractions import Fraction
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from usdface.assets import Take, WeightsClip
from usdface.capture.channel_take import fill_frames
from usdface.capture.marker_table import build_table_take
from usdface.capture.marker_take import Capture, CaptureOptions
from usdface.capture.sample_times import rate_of_times, settle_frame_numbers
from usdface.capture.text_table import (
    NumberTable,
    check_columns,
    head_lines,
    read_lines,
    read_number_table,
    sniff_delimiter,
    split_cells,
    without_empty_tail,
)
from usdface.errors import InputError

_LANDMARK = re.compile(r"X_(\d+)", re.ASCII)
_INTENSITY = re.compile(r"(AU\d+)_r", re.ASCII)
_HIGHEST_INTENSITY = 5.0
_NEEDED = ("frame", "timestamp", "confidence", "success")
_TO_Y_UP = np.diag([1.0, -1.0, -1.0])


def is_openface_csv(head: bytes) -> bool:
    """Tell an OpenFace table by its first bytes."""
    lines = head_lines(head, 1)
    titles = {title.strip('" ') for title in re.split(r"[,;\t]", lines[0])} if lines else set()
    return titles.issuperset(_NEEDED)


def read_openface_csv(path: Path, options: CaptureOptions) -> Capture:
    """Read landmarks as markers, and intensities divided by 5 as channels.

    Raises
    ------
    InputError
        If the header or a row is damaged, times tell no rate, neither landmarks nor intensities
        are there, or no face was found in any frame.
    """
    lines = read_lines(path)
    header = next(lines)
    delimiter = sniff_delimiter(header.text) or ","
    titles = without_empty_tail(split_cells(header, delimiter))
    check_columns(titles, header)
    column = {title: index for index, title in enumerate(titles)}
    missing = [title for title in _NEEDED if title not in column]
    landmarks = [
        match[1]
        for match in map(_LANDMARK.fullmatch, titles)
        if match and f"Y_{match[1]}" in column and f"Z_{match[1]}" in column
    ]
    units = [match[1] for match in map(_INTENSITY.fullmatch, titles) if match]
    if missing or not (landmarks or units):
        lacking = ", ".join(missing) or "3-D landmarks (X_0 …) nor intensities (AU01_r …)"
        raise InputError(
            f"{header.where}: no {lacking}; run FeatureExtraction on the video with -3Dfp and -aus"
        )
    table = read_number_table(lines, titles, path=path, delimiter=delimiter, gaps=True)
    notes = []
    others = len(titles) - len(_NEEDED) - 3 * len(landmarks) - len(units) - ("face_id" in column)
    if others:
        notes.append(f"{others} other columns left out: 2-D and eye landmarks, gaze, head pose")
    table = _one_face(table, column.get("face_id"), notes)
    first_frame, frames = settle_frame_numbers(
        table.values[:, column["frame"]], table.lines, where=str(path)
    )
    rate = rate_of_times(table.values[:, column["timestamp"]], frames, where=str(path))
    succeeded = table.values[:, column["success"]] == 1
    if not succeeded.any():
        raise InputError(
            f"{path}: no face found in any of {len(succeeded)} frames (success is 0); "
            "film the face larger and lit, then run OpenFace again"
        )
    if not succeeded.all():
        notes.append(
            f"no face found in {np.sum(~succeeded)} of {len(succeeded)} rows: gaps of the "
            "landmarks, interpolated in the action units"
        )

    source = None
    if units:
        source = _read_units(
            table,
            [column[f"{unit}_r"] for unit in units],
            units,
            path=path,
            used=succeeded,
            frames=frames,
            first_frame=first_frame,
            rate=rate,
        )
        notes.append("action units are kept as channels, intensity / 5")
    if not landmarks:
        take = Take(path.stem, rate, first_frame, source=source)
        return Capture(take, "openface-csv", tuple(notes))
    points = np.stack(
        [table.values[:, [column[f"{axis}_{number}"] for number in landmarks]] for axis in "XYZ"],
        axis=2,
    )
    points[~succeeded] = np.nan
    capture = build_table_take(
        path,
        [f"landmark_{number}" for number in landmarks],
        points.reshape(len(points), -1),
        range(0, 3 * len(landmarks), 3),
        frames=frames,
        first_frame=first_frame,
        rate=rate,
        to_mm=_TO_Y_UP,
        options=options,
        notes=notes,
        format_name="openface-csv",
        where=header.where,
    )
    confidence = np.zeros(int(frames[-1]) + 1)
    confidence[frames] = np.nan_to_num(table.values[:, column["confidence"]], posinf=0, neginf=0)
    return _add(capture, source, confidence)


def _one_face(table: NumberTable, face_column: int | None, notes: list[str]) -> NumberTable:
    """Keep the face that is seen in most rows."""
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
    columns: list[int],
    names: list[str],
    *,
    path: Path,
    used: NDArray[np.bool_],
    frames: NDArray[np.int64],
    first_frame: int,
    rate: Fraction,
) -> WeightsClip:
    """Return intensities as weights; frames without a face are interpolated."""
    values = table.values[:, columns][used] / _HIGHEST_INTENSITY
    finite = np.isfinite(values)
    if not finite.all():
        row, unit = np.argwhere(~finite)[0]
        raise InputError(
            f"{path} line {table.lines[used][row]}, column {columns[unit] + 1} ({names[unit]}_r): "
            "not a number in a row with a face; run OpenFace again"
        )
    filled = fill_frames(values, frames[used].astype(np.float64))
    before, after = int(frames[used][0]), int(frames[-1] - frames[used][-1])
    held = np.pad(filled, ((before, after), (0, 0)), mode="edge")  # as long as the markers
    return WeightsClip(tuple(names), held, first_frame, rate)


def _add(capture: Capture, source: WeightsClip | None, confidence: NDArray[np.float64]) -> Capture:
    """Put weights and the tracker's confidence into a take of markers."""
    take = capture.take
    if take.markers is not None:
        seen = take.markers.confidence * np.clip(confidence, 0, 1)[:, None]
        markers = replace(take.markers, confidence=seen.astype(np.float32))
        take = replace(take, markers=markers, source=source)
    return replace(capture, take=take)
