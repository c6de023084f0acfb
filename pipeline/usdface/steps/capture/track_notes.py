"""What is wrong or doubtful about a tracked face: none there, on its side, small, cut, covered."""

from fractions import Fraction
from pathlib import Path

import numpy as np

from usdface.capture.face_landmarks import LANDMARKS
from usdface.capture.face_tracking import FaceTrack
from usdface.core.arrays import IntArray, runs
from usdface.core.errors import InputError
from usdface.core.text import first_few, frame_ranges, pluralize

_SMALLEST_EYE_PIXELS = 30.0
"""Between the eyes: the model sees the face at 192 or 256 pixels, where it is some 70."""
_GUESSED_BREADTHS = 0.02
"""How far the mirror image's landmarks lie from the picture's, of a face's breadth: .005 and .006
in recorded clips, .008 on a drawn face, .03 with half a face covered, .08 with one on its head."""
_LYING_DEGREES = 60.0
_USUAL_SHARE = 0.5
"""Of the pictures, in which a filmed face is found."""
_BLINK_RATE = 15.0
"""[1/s] Of pictures: blinks last 0.1 to 0.2 s."""


_COVERED_SHARE = 0.05
"""Of the landmarks, with a confidence below a half: 0.00 to 0.01 in most pictures of a free face,
more in single ones; 0.1 to 0.4 with a hand before it."""
_COVERED_SECONDS = 0.25
"""Such pictures last as long, with others between them of at most twice that."""


def check_faces(video: Path, track: FaceTrack) -> None:
    """Refuse a video without a face, or one that lies on its side."""
    if not track.seen.any():
        raise InputError(
            f"{video}: no face in any of {len(track.seen)} pictures; film it from the front, "
            "lit, and larger than a fifth of the picture's height; a video that lies on its side "
            "has to be turned first (ffmpeg -display_rotation 90 -i IN -c copy OUT)"
        )
    right, left = eye_columns()
    across = track.positions[track.seen][:, left].mean(axis=1)
    across = across - track.positions[track.seen][:, right].mean(axis=1)
    # Of a face upright in the picture, the performer's left eye is on the right.
    roll = np.degrees(np.arctan2(np.median(across[:, 1]), np.median(across[:, 0])))
    if abs(roll) > _LYING_DEGREES:
        raise InputError(
            f"{video}: the face lies by {roll:.0f} degrees in the picture; turn the video "
            "first (ffmpeg -display_rotation 90 -i IN -c copy OUT, or -90)"
        )


def track_notes(track: FaceTrack, *, rate: Fraction, frames: IntArray) -> list[str]:
    """Say what is doubtful about a track: cuts, small faces, pictures without one.

    Parameters
    ----------
    frames : (pictures,) int array
        The take's frame of each picture.
    """
    notes = []
    if rate < _BLINK_RATE:
        notes.append(
            f"{float(rate):g} pictures per second: blinks are lost between two of them; "
            "film with 24 or more"
        )
    seen = track.seen
    if not seen.all():
        missing = (
            f"no face in {pluralize(int((~seen).sum()), 'picture')} of {len(seen)}, or another "
            "than the one that is followed: these are gaps"
        )
        if seen.mean() < _USUAL_SHARE:
            missing += (
                ": look whether the video stands on its head, or shows the face from the side, "
                "from behind or in the dark"
            )
        notes.append(missing)
    unsure = seen & ~np.isfinite(track.difference[:, 0])
    if unsure.any():
        notes.append(
            f"the mirror image shows no face in {pluralize(int(unsure.sum()), 'picture')}: low "
            f"confidence ({first_few(frames[unsure].tolist())})"
        )
    doubt = track.mirror_difference()
    if doubt > _GUESSED_BREADTHS:
        notes.append(
            f"landmarks of a picture and of its mirror image differ by {doubt:.1%} of the face's "
            "breadth, where 0.5 to 0.8 % is usual: the face is partly covered, turned away or in "
            "the dark, or on its head; many landmarks are guesses"
        )
    covered = _covered_stretches(track, float(rate))
    if covered:
        stretches = [(int(frames[start]), int(frames[stop - 1])) for start, stop in covered]
        notes.append(
            f"{frame_ranges(stretches)}: the face is partly covered, as by a hand, or turned away: "
            "landmarks there are guesses of low confidence; choose no references there"
        )
    cuts = frames[np.flatnonzero(track.jumps())]
    if len(cuts):
        notes.append(
            f"the face jumps at frame {first_few(cuts.tolist())}: a cut? Track each shot by itself "
            "with --frames"
        )
    right, left = eye_columns()
    eyes = track.positions[seen][..., :2]
    apart = np.linalg.norm(eyes[:, left].mean(axis=1) - eyes[:, right].mean(axis=1), axis=1)
    between = float(np.median(apart))
    if between < _SMALLEST_EYE_PIXELS:
        notes.append(
            f"the eyes are {between:.0f} pixels apart; lips and lids of faces below "
            f"{_SMALLEST_EYE_PIXELS:g} are coarse: film closer or with more pixels"
        )
    return notes


def _covered_stretches(track: FaceTrack, rate: float) -> list[tuple[int, int]]:
    """Return where many landmarks are doubtful for a while: rows, the stop left out."""
    found = np.isfinite(track.difference).all(axis=1)
    doubtful = (track.confidence() < 0.5).mean(axis=1) > _COVERED_SHARE
    stretches: list[tuple[int, int]] = []
    for start, stop in runs(np.asarray(found & doubtful)):
        if stretches and start - stretches[-1][1] <= 2 * _COVERED_SECONDS * rate:
            start = stretches.pop()[0]
        stretches.append((start, stop))
    return [each for each in stretches if each[1] - each[0] >= _COVERED_SECONDS * rate]


def eye_columns() -> tuple[IntArray, IntArray]:
    """Return the corners of the right and of the left eye, whose mean is the eye's centre."""
    corners = LANDMARKS.columns("eye_inner", "eye_outer")
    right = np.array(["_R" in LANDMARKS.names[column] for column in corners])
    return corners[right], corners[~right]
