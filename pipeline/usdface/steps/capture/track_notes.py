"""Checks and notes of a tracked face: missing, rotated, small, cut, covered."""

from fractions import Fraction
from pathlib import Path

import numpy as np

from usdface.capture.face_landmarks import LANDMARKS
from usdface.capture.face_tracking import FaceTrack
from usdface.core.arrays import BoolArray, IntArray, runs
from usdface.core.errors import InputError
from usdface.core.text import first_few, frame_ranges, pluralize
from usdface.steps.capture.track_pictures import LONGEST_BRIDGED

_SMALLEST_EYE_PIXELS = 30.0
"""Distance between the eyes: the model's input of 192 or 256 pixels has about 70."""
_GUESSED_BREADTHS = 0.02
"""Distance between landmarks of a picture and its mirror image, as a share of the face's breadth:
.005 and .006 in recorded clips, .008 on a drawn face, .03 with half a face covered, .08 upside
down."""
_LYING_DEGREES = 60.0
_USUAL_SHARE = 0.5
"""Share of the pictures with a face, below which the video is unusual."""
_BLINK_RATE = 15.0
"""Pictures per second that show a blink, which lasts 0.1 to 0.2 s."""


DOUBTFUL_SHARE = 0.05
"""Share of the landmarks with a confidence below a half: 0.00 to 0.01 in most pictures of an
uncovered face, 0.1 to 0.4 with a hand in front of it."""
_LASTING_SECONDS = 0.25
"""Shortest duration that is noted; interruptions up to twice that are included."""


def check_faces(video: Path, track: FaceTrack) -> None:
    """Refuse a video without a face, or with one lying on its side."""
    if not track.seen.any():
        raise InputError(
            f"{video}: no face in any of {len(track.seen)} pictures; film it from the front, "
            "lit, and larger than a fifth of the picture's height; rotate a video that lies on "
            "its side first (ffmpeg -display_rotation 90 -i IN -c copy OUT)"
        )
    right, left = eye_columns()
    across = track.positions[track.seen][:, left].mean(axis=1)
    across = across - track.positions[track.seen][:, right].mean(axis=1)
    # In an upright face, the performer's left eye is on the right.
    roll = np.degrees(np.arctan2(np.median(across[:, 1]), np.median(across[:, 0])))
    if abs(roll) > _LYING_DEGREES:
        quarter = 90 * round(roll / 90)  # ffmpeg counts counterclockwise, as `roll` does clockwise
        raise InputError(
            f"{video}: the face is rotated by {roll:.0f} degrees in the picture; rotate the video "
            f"first (ffmpeg -display_rotation {quarter} -i IN -c copy OUT)"
        )


def track_notes(track: FaceTrack, *, rate: Fraction, frames: IntArray) -> list[str]:
    """Return notes on low rates, missing, covered and small faces, and cuts.

    `frames` are the take's frames of the pictures.
    """
    notes = []
    if rate < _BLINK_RATE:
        notes.append(
            f"{float(rate):g} pictures per second: blinks may be missed; film with 24 or more"
        )
    seen = track.seen
    if not seen.all():
        missing = (
            f"no face, or not the tracked one, in {pluralize(int((~seen).sum()), 'picture')} of "
            f"{len(seen)}, {_named(runs(~seen), frames)}: these are gaps"
        )
        if seen.mean() < _USUAL_SHARE:
            missing += (
                "; check whether the video is upside down, or shows the face from the side, from "
                "behind or in the dark"
            )
        notes.append(missing)
    pauses = np.flatnonzero(np.diff(frames) > LONGEST_BRIDGED)
    if len(pauses):
        without = [(int(frames[at]) + 1, int(frames[at + 1]) - 1) for at in pauses]
        notes.append(f"no pictures in {frame_ranges(without)}: the video pauses; these are gaps")
    unsure = seen & ~np.isfinite(track.difference[:, 0])
    if unsure.any():
        notes.append(
            f"no face in the mirror image of {pluralize(int(unsure.sum()), 'picture')}: low "
            f"confidence ({first_few(frames[unsure].tolist())})"
        )
    error = track.mirror_difference()
    if error > _GUESSED_BREADTHS:
        notes.append(
            f"landmarks of a picture and of its mirror image differ by {error:.1%} of the face's "
            "breadth (usually 0.5 to 0.8 %): the face is partly covered, turned away, in the dark "
            "or upside down, and many landmarks are inaccurate"
        )
    notes += _doubtful_frames(track, float(rate), frames)
    cuts = frames[np.flatnonzero(track.jumps())]
    if len(cuts):
        notes.append(
            f"the face jumps at frame {first_few(cuts.tolist())}; if these are cuts, track each "
            "shot separately with --frames"
        )
    right, left = eye_columns()
    eyes = track.positions[seen][..., :2]
    apart = np.linalg.norm(eyes[:, left].mean(axis=1) - eyes[:, right].mean(axis=1), axis=1)
    between = float(np.median(apart))
    if between < _SMALLEST_EYE_PIXELS:
        notes.append(
            f"the eyes are {between:.0f} pixels apart; below {_SMALLEST_EYE_PIXELS:g}, lips and "
            "lids are inaccurate: film closer or with more pixels"
        )
    return notes


def _doubtful_frames(track: FaceTrack, rate: float, frames: IntArray) -> list[str]:
    """Return notes on the frames in which the face is covered, or cut off by the picture's edge."""
    notes = []
    both_seen = np.isfinite(track.difference).all(axis=1, keepdims=True)
    covered = _lasting(both_seen & (track.confidence() < 0.5), rate)
    if covered:
        notes.append(
            f"{_named(covered, frames)}: the face is partly covered, as by a hand, or turned away: "
            "landmarks are inaccurate there, with low confidence; choose no references there"
        )
    cut_off = _lasting(track.outside, rate)
    if cut_off:
        notes.append(
            f"{_named(cut_off, frames)}: the picture's edge cuts off up to "
            f"{track.outside.mean(axis=1).max():.0%} of the landmarks: these are gaps; choose no "
            "references there, and film the whole face"
        )
    return notes


def _lasting(doubtful: BoolArray, rate: float) -> list[tuple[int, int]]:
    """Return the rows, (start, stop), in which many landmarks are doubtful for a while.

    `doubtful` is (pictures, markers).
    """
    stretches: list[tuple[int, int]] = []
    for start, stop in runs(doubtful.mean(axis=1) > DOUBTFUL_SHARE):
        if stretches and start - stretches[-1][1] <= 2 * _LASTING_SECONDS * rate:
            start = stretches.pop()[0]
        stretches.append((start, stop))
    return [each for each in stretches if each[1] - each[0] >= _LASTING_SECONDS * rate]


def _named(stretches: list[tuple[int, int]], frames: IntArray) -> str:
    """Return the frames of rows, (start, stop), as text."""
    return frame_ranges((int(frames[start]), int(frames[stop - 1])) for start, stop in stretches)


def eye_columns() -> tuple[IntArray, IntArray]:
    """Return the columns of the corners of the right and the left eye."""
    corners = LANDMARKS.columns("eye_inner", "eye_outer")
    right = np.array(["_R" in LANDMARKS.names[column] for column in corners])
    return corners[right], corners[~right]
