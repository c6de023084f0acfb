"""Where the eyes look, from the irises; closed eyes look where they looked before.

An iris turns about the eye's centre: its way across the skull is the sine of the angle times the
radius, which follows from the diameter of the iris, as that differs little between people. The way
is measured from the corners of the same eye, which owes nothing to the head's pose: sideways from
both; up and down from the inner one, which a ligament holds to the skull, as the outer one goes
with the lids. Both eyes get the mean of both: how far
they converge, 3.6 degrees at 1 m, is less than the noise of one. Behind a closed lid a landmark
model guesses the iris, and guesses it low: such samples are gaps, so that a blink is never read as
a look down, and of a wink the open eye says where both look.

References
----------
Fry and Hill (1962), The center of rotation of the eye, American Journal of Optometry 39, 581-595:
13.5 mm behind the cornea.
Rüfer, Schröder and Erb (2005), White-to-white corneal diameter, Cornea 24, 259-261: 11.7 mm, with a
standard deviation of 0.4.
Soukupová and Čech (2016), Real-time eye blink detection using facial landmarks, CVWW: aperture over
width.
"""

from dataclasses import dataclass

import numpy as np

from usdface.capture.face_landmarks import LANDMARKS
from usdface.core.arrays import BoolArray, Float32Array, FloatArray, IntArray
from usdface.numerics.rigid.rigid_alignment import RigidAlignment

IRIS_TURN_RATIO = 10.0 / 11.7
"""From the eye's centre of rotation to the plane of the iris, 13.5 mm to the cornea less 3.5 mm of
anterior chamber and cornea, in diameters of the iris."""
FULL_LOOK_DEGREES = 30.0
"""Of a weight of 1: how far eyes turn before the head follows (Stahl 1999, Experimental Brain
Research 126: 20 to 35)."""
LOOK_SHAPES = tuple(
    f"eyeLook{way}{side}" for side in ("Right", "Left") for way in ("In", "Out", "Up", "Down")
)
"""ARKit's names, in the order of `GazeAngles.look_weights`."""

_LEAST_IRIS_MM = 1.0
"""Landmarks of an iris that fall together tell no angle."""
_CLOSED_SHARE = 0.4
"""Of the usual aperture: a look down leaves more than half of it, a lid on its way covers the iris
below."""
_NEUTRAL_REACH = 3
"""Frames on either side of the neutral one whose mean is a look straight ahead."""


def _eye(side: str) -> dict[str, IntArray]:
    names = LANDMARKS.names
    return {
        part: np.array([at for at in LANDMARKS.columns(part) if f"_{side}" in names[at]], np.int64)
        for part in ("iris", "lid_upper", "lid_lower", "eye_inner", "eye_outer")
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


def gaze_angles(
    positions: FloatArray | Float32Array, head: RigidAlignment, closed: BoolArray, neutral: int
) -> GazeAngles:
    """Return where the eyes look.

    Parameters
    ----------
    positions : (frames, markers, 3) float array
        Of `LANDMARKS`, in the camera's space or the head's [mm].
    head : RigidAlignment
        How the head has moved since the neutral frame, where a face is seen.
    closed : (frames, 2) bool array
        From `closed_eyes`; the angles are interpolated there.
    neutral : int
        Row in which the eyes look straight ahead.
    """
    frames = np.arange(len(positions))
    near = np.abs(frames - neutral) <= _NEUTRAL_REACH
    sines = np.zeros((2, len(positions)))
    axes = _head_axes(positions[neutral].astype(np.float64))
    open_eyes = head.determined[:, None] & ~closed
    for eye, usable in zip(_EYES, open_eyes.T, strict=True):
        if not usable.any():
            continue
        iris = positions[:, eye["iris"]].astype(np.float64)
        across = np.linalg.norm(iris[:, :, None] - iris[:, None], axis=3).max(axis=(1, 2))
        radius = IRIS_TURN_RATIO * max(float(np.median(across[usable])), _LEAST_IRIS_MM)
        inner, outer = (positions[:, eye[part]] for part in ("eye_inner", "eye_outer"))
        corners = np.concatenate([inner, outer], axis=1)
        for axis, origin in enumerate((corners.mean(axis=1), inner.mean(axis=1))):
            still = np.einsum("fji,fj->fi", head.rotations, iris.mean(axis=1) - origin) @ axes[axis]
            ahead = still[usable & near] if (usable & near).any() else still[usable]
            sines[axis] += np.where(usable, (still - ahead.mean()) / radius, 0.0)
    known = open_eyes.sum(axis=1)
    if not known.any():
        return GazeAngles(np.zeros(len(frames)), np.zeros(len(frames)))
    at = np.flatnonzero(known)
    turned = np.degrees(np.arcsin(np.clip(sines[:, at] / known[at], -1.0, 1.0)))
    yaw, pitch = (np.interp(frames, at, each) for each in turned)
    return GazeAngles(yaw, pitch)


def _head_axes(rest: FloatArray) -> FloatArray:
    """Return the directions to the performer's left and up of a head: (2, 3)."""
    corner = [np.concatenate([eye["eye_inner"], eye["eye_outer"]]) for eye in _EYES]
    left = rest[corner[1]].mean(axis=0) - rest[corner[0]].mean(axis=0)
    left /= np.linalg.norm(left)
    up = rest[LANDMARKS.column(10)] - rest[LANDMARKS.column(152)]
    up -= (up @ left) * left
    return np.stack([left, up / np.linalg.norm(up)])
