"""Gaze direction from the scores of the face landmark model.

The model scores for each eye looks in, out, up and down (`LOOK_SHAPES`). These are more accurate
than the iris relative to the corners of the eye, which misses more than half of looks down, where
lids cover the iris. Both eyes get the mean of both: convergence, 3.6 degrees at 1 m, is below the
noise of one eye. Behind a closed lid the model estimates the iris too low: such samples are gaps,
so that blinks are not looks down, and in a wink the open eye determines the direction.

References
----------
Soukupová and Čech (2016), Real-time eye blink detection using facial landmarks, CVWW: aperture over
width.
"""

import numpy as np

from usdface.capture.face_landmarks import LANDMARKS
from usdface.core.arrays import BoolArray, Float32Array, FloatArray, IntArray

FULL_LOOK_DEGREES = 30.0
"""Rotation of the eye at weight 1: the range before the head follows (Stahl 1999, Experimental
Brain Research 126: 20 to 35)."""
LOOK_SHAPES = tuple(
    f"eyeLook{way}{side}" for side in ("Right", "Left") for way in ("In", "Out", "Up", "Down")
)
"""ARKit's names, in the order of `look_weights`."""

_CLOSED_SHARE = 0.4
"""Share of the median aperture below which the lid covers the iris; looks down leave over half."""
_NEUTRAL_REACH = 3
"""Frames on either side of the neutral frame, averaged as the look straight ahead."""


def _eye(side: str) -> dict[str, IntArray]:
    names = LANDMARKS.names
    return {
        part: np.array([at for at in LANDMARKS.columns(part) if f"_{side}" in names[at]], np.int64)
        for part in ("lid_upper", "lid_lower", "eye_inner", "eye_outer")
    }


_EYES = (_eye("R"), _eye("L"))


def look_weights(left: FloatArray, up: FloatArray) -> Float32Array:
    """Return weights of `LOOK_SHAPES` by `gaze_angles`: (frames, 8), 1 at `FULL_LOOK_DEGREES`."""
    # the right eye's nose is to its left
    ways = np.stack([left, -left, up, -up, -left, left, up, -up], axis=1) / FULL_LOOK_DEGREES
    return np.clip(ways, 0.0, 1.0).astype(np.float32)


def closed_eyes(positions: FloatArray | Float32Array, seen: BoolArray) -> BoolArray:
    """Return whether the right and the left eye are closed or nearly so: (frames, 2).

    Parameters
    ----------
    positions : (frames, markers, 3) float array
        Of `LANDMARKS` [mm].
    seen : (frames,) bool array
    """
    closed = np.zeros((len(positions), 2), bool)
    for side, eye in enumerate(_EYES):
        lids = positions[:, eye["lid_upper"]] - positions[:, eye["lid_lower"]]
        width = (positions[:, eye["eye_outer"]] - positions[:, eye["eye_inner"]]).mean(axis=1)
        aperture = np.linalg.norm(lids.mean(axis=1), axis=1) / np.linalg.norm(width, axis=1)
        low = aperture < _CLOSED_SHARE * np.median(aperture[seen])
        # frames next to a closed one are motion-blurred
        closed[:, side] = low | np.append(low[1:], False) | np.insert(low[:-1], 0, False)
    return closed


def gaze_angles(
    looks: FloatArray | Float32Array, usable: BoolArray, neutral: int
) -> tuple[FloatArray, FloatArray]:
    """Return the gaze of both eyes to the performer's left and upwards: (frames,) each [degrees].

    Relative to the neutral frame.

    Parameters
    ----------
    looks : (frames, 8) float array
        The model's scores of `LOOK_SHAPES`.
    usable : (frames, 2) bool array
        Whether the right and the left eye are seen open; angles are interpolated elsewhere.
    neutral : int
        Row of the look straight ahead.
    """
    frames = np.arange(len(looks))
    known = usable.sum(axis=1)
    at = np.flatnonzero(known)
    if not len(at):
        return np.zeros(len(frames)), np.zeros(len(frames))
    ways = looks.reshape(-1, 2, 4).astype(np.float64) * FULL_LOOK_DEGREES
    inwards, upwards = ways[..., 0] - ways[..., 1], ways[..., 2] - ways[..., 3]
    near = np.abs(frames - neutral) <= _NEUTRAL_REACH
    angles = np.zeros((2, len(frames)))
    for left, up, seen in zip((inwards * (1, -1)).T, upwards.T, usable.T, strict=True):
        rest = seen & near if (seen & near).any() else seen
        for axis, angle in enumerate((left, up) if seen.any() else ()):
            angles[axis] += np.where(seen, angle - angle[rest].mean(), 0.0)
    yaw, pitch = (np.interp(frames, at, angle[at] / known[at]) for angle in angles)
    return yaw, pitch
