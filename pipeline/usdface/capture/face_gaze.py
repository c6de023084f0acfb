"""Where the eyes look, by the model's own scores; closed eyes look where they looked before.

The model scores how far each eye looks in, out, up and down (`LOOK_SHAPES`), from the landmarks of
lids and irises of many people. Where the iris lies against the corners of the eye says less: lids
cover it in looks down, so that of those less than half is seen. Both eyes get the mean of both:
how far they converge, 3.6 degrees at 1 m, is less than the noise of one. Behind a closed lid the
model guesses the iris, and guesses it low: such samples are gaps, so that a blink is never read as
a look down, and of a wink the open eye says where both look.

References
----------
Soukupová and Čech (2016), Real-time eye blink detection using facial landmarks, CVWW: aperture over
width.
"""

from dataclasses import dataclass

import numpy as np

from usdface.capture.face_landmarks import LANDMARKS
from usdface.core.arrays import BoolArray, Float32Array, FloatArray, IntArray

FULL_LOOK_DEGREES = 30.0
"""Of a weight of 1: how far eyes turn before the head follows (Stahl 1999, Experimental Brain
Research 126: 20 to 35)."""
LOOK_SHAPES = tuple(
    f"eyeLook{way}{side}" for side in ("Right", "Left") for way in ("In", "Out", "Up", "Down")
)
"""ARKit's names, in the order of `GazeAngles.look_weights`."""

_CLOSED_SHARE = 0.4
"""Of the usual aperture: a look down leaves more than half of it, a lid on its way covers the iris
below."""
_NEUTRAL_REACH = 3
"""Frames on either side of the neutral one whose mean is a look straight ahead."""


def _eye(side: str) -> dict[str, IntArray]:
    names = LANDMARKS.names
    return {
        part: np.array([at for at in LANDMARKS.columns(part) if f"_{side}" in names[at]], np.int64)
        for part in ("lid_upper", "lid_lower", "eye_inner", "eye_outer")
    }


_EYES = (_eye("R"), _eye("L"))


@dataclass(frozen=True)
class GazeAngles:
    """The direction of both eyes, against the neutral frame."""

    yaw: FloatArray
    """(frames,): to the performer's left [degrees]"""
    pitch: FloatArray
    """(frames,): upwards [degrees]"""

    def look_weights(self) -> Float32Array:
        """Return weights of `LOOK_SHAPES`: (frames, 8), 1 at `FULL_LOOK_DEGREES`."""
        left, up = self.yaw, self.pitch
        # the right eye's nose is to its left
        ways = np.stack([left, -left, up, -up, -left, left, up, -up], axis=1) / FULL_LOOK_DEGREES
        return np.clip(ways, 0.0, 1.0).astype(np.float32)


def closed_eyes(positions: FloatArray | Float32Array, seen: BoolArray) -> BoolArray:
    """Return where the right and the left eye are closed, or nearly: (frames, 2).

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
        # a picture beside a closed one is blurred
        closed[:, side] = low | np.append(low[1:], False) | np.insert(low[:-1], 0, False)
    return closed


def gaze_angles(looks: FloatArray | Float32Array, usable: BoolArray, neutral: int) -> GazeAngles:
    """Return where the eyes look.

    Parameters
    ----------
    looks : (frames, 8) float array
        The model's weights of `LOOK_SHAPES`.
    usable : (frames, 2) bool array
        Where the right and the left eye are seen open; the angles are interpolated elsewhere.
    neutral : int
        Row in which the eyes look straight ahead.
    """
    frames = np.arange(len(looks))
    known = usable.sum(axis=1)
    at = np.flatnonzero(known)
    if not len(at):
        return GazeAngles(np.zeros(len(frames)), np.zeros(len(frames)))
    ways = looks.reshape(-1, 2, 4).astype(np.float64) * FULL_LOOK_DEGREES
    inwards, upwards = ways[..., 0] - ways[..., 1], ways[..., 2] - ways[..., 3]
    near = np.abs(frames - neutral) <= _NEUTRAL_REACH
    angles = np.zeros((2, len(frames)))
    for left, up, seen in zip((inwards * (1, -1)).T, upwards.T, usable.T, strict=True):
        rest = seen & near if (seen & near).any() else seen
        for axis, angle in enumerate((left, up) if seen.any() else ()):
            angles[axis] += np.where(seen, angle - angle[rest].mean(), 0.0)
    yaw, pitch = (np.interp(frames, at, each[at] / known[at]) for each in angles)
    return GazeAngles(yaw, pitch)
