"""The built-in performance: speech with coarticulation, moods, blinks, gaze, brows and head motion.

All curves are sums of smooth bumps and ramps with natural durations: 60 to 120 ms for lips, 75 ms
for closing and 130 for opening lids, a third of a second for moods.
"""

from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from itertools import chain, pairwise

import numpy as np

from usdface.core.arrays import FloatArray, smoothstep
from usdface.core.assets import WeightsClip
from usdface.demo.fields import LID_TURNS, lid_closing
from usdface.demo.script import (
    DURATION_SECONDS,
    EMOTIONS,
    GLIDES,
    LINES,
    NEUTRAL_TIME,
    VISEME_OF_PHONE,
    VISEME_SHAPES,
    timed_phones,
)

FIRST_FRAME = 1
"""Frame number of the first sample, as in captures."""

_BLINKS = (1.42, 3.72, 5.28, 7.12, 7.78, 9.42, 11.05, 11.5, 12.86, 14.2)
_GAZES = (  # time of a saccade [s] and its target [degrees to the person's left, up]
    (0.0, 0.0, 0.0),
    (0.62, 3.0, 1.0),
    (1.44, -9.0, -3.0),
    (2.05, 1.0, 0.0),
    (2.95, 12.0, 5.0),
    (3.45, 0.0, -1.0),
    (4.40, -4.0, 6.0),
    (5.30, 2.0, 0.0),
    (6.35, 8.0, -4.0),
    (6.75, -1.0, 1.0),
    (7.78, 0.0, 0.0),
    (9.44, -13.0, -2.0),
    (9.85, 0.0, 1.0),
    (11.10, 6.0, -14.0),
    (12.88, -3.0, -6.0),
    (13.55, 5.0, -15.0),
    (14.22, 0.0, 0.0),
)
_FULL_GAZE = 28.0  # degrees at which a look shape is at 1
_BEATS = (  # motion between the sentences: shape, start, stop [s], weight
    ("browOuterUpLeft", 2.85, 3.55, 0.75),
    ("mouthSmileLeft", 2.9, 3.6, 0.30),
    ("mouthRight", 2.95, 3.65, 0.32),
    ("jawOpen", 6.9, 7.45, 0.20),
    ("mouthSmileLeft", 6.75, 7.6, 0.22),
    ("mouthSmileRight", 6.75, 7.6, 0.20),
    ("mouthUpperUpLeft", 6.8, 7.5, 0.28),
    ("mouthUpperUpRight", 6.8, 7.5, 0.28),
    ("cheekPuff", 7.72, 8.2, 0.55),
    ("noseSneerLeft", 10.55, 11.15, 0.42),
    ("noseSneerRight", 10.6, 11.15, 0.30),
    ("mouthUpperUpLeft", 10.55, 11.15, 0.35),
    ("jawLeft", 10.6, 11.2, 0.30),
    ("eyeWideLeft", 4.35, 5.05, 0.62),
    ("eyeWideRight", 4.35, 5.05, 0.62),
    ("browInnerUp", 4.35, 5.2, 0.45),
    ("browOuterUpLeft", 4.35, 5.15, 0.45),
    ("browOuterUpRight", 4.35, 5.15, 0.48),
    ("eyeWideLeft", 8.3, 8.8, 0.35),
    ("eyeWideRight", 8.3, 8.8, 0.35),
    ("mouthShrugUpper", 14.0, 14.6, 0.25),
    ("mouthPucker", 13.95, 14.5, 0.22),
)
_ASYMMETRY = {
    "mouthSmileRight": 0.91,
    "browDownLeft": 0.93,
    "mouthFrownRight": 1.06,
    "cheekSquintRight": 0.94,
}


_PARTING_LIPS = tuple(
    name + side for name in ("mouthUpperUp", "mouthLowerDown") for side in ("Left", "Right")
)


@dataclass(frozen=True)
class ActedPerformance:
    """Weights and head motion of the actor."""

    weights: WeightsClip
    """ARKit names, [0-1]."""
    neutral_frame: int
    """Frame number of the face at rest."""
    rotation: FloatArray
    """(frames, 3): head pitch, yaw, roll [degrees]."""
    translation: FloatArray
    """(frames, 3): of the top of the neck [mm]."""


_FRAME_RATE = 120
"""Frames per second."""


def performance() -> ActedPerformance:
    """Return the performance of the script: 15 s, deterministic."""
    time = np.arange(round(DURATION_SECONDS * _FRAME_RATE) + 1) / _FRAME_RATE
    curves: defaultdict[str, FloatArray] = defaultdict(lambda: np.zeros_like(time))
    speech, closure, activity = _speech(time)
    every = (speech, _moods(time, activity), _beats(time), _gaze(time), _blinks(time))
    for name, curve in chain.from_iterable(each.items() for each in every):
        curves[name] += curve
    # Lids do not cross: blinks are smaller where other shapes close the eye.
    for side in ("Left", "Right"):
        shut = sum(
            lid_closing(name) * np.clip(curves[name + side], 0.0, 1.0)
            for name in LID_TURNS
            if name != "eyeBlink" and name + side in curves
        )
        room = np.clip(1.0 - np.asarray(shut), 0.0, 1.0)
        curves["eyeBlink" + side] *= room
    for name in _PARTING_LIPS:  # closed lips take precedence over moods
        curves[name] *= 1.0 - 0.85 * closure
    # A sneer lifts the upper lip by about 4 mm, a seventh of the opening by jawOpen.
    sneer = 0.5 * (curves["noseSneerLeft"] + curves["noseSneerRight"])
    curves["mouthClose"] = closure * (curves["jawOpen"] + 0.13 * sneer)
    names = tuple(sorted(name for name, curve in curves.items() if np.max(curve) > 0.02))
    values = np.stack([np.clip(curves[name], 0.0, 1.0) for name in names], axis=1)
    rotation, translation = _head_motion(time)

    return ActedPerformance(
        weights=WeightsClip(names, values.astype(np.float32), FIRST_FRAME, Fraction(_FRAME_RATE)),
        neutral_frame=FIRST_FRAME + round(NEUTRAL_TIME * _FRAME_RATE),
        rotation=rotation,
        translation=translation,
    )


def _speech(time: FloatArray) -> tuple[dict[str, FloatArray], FloatArray, FloatArray]:
    """Return curves of the mouth, closure of the lips, and speech activity [0-1].

    Visemes are averaged with dominance functions around the middle of each sound, after Cohen and
    Massaro (1993), "Modeling coarticulation in synthetic visual speech"; closed lips dominate.
    """
    claims: list[tuple[float, float, float, Mapping[str, float]]] = []
    for sound in timed_phones():
        length = sound.stop - sound.start
        viseme = VISEME_OF_PHONE[sound.phone]
        strength = {"PP": 3.5, "FF": 2.6, "CH": 1.6, "UU": 1.6, "SS": 1.3}.get(viseme, 1.0)
        loud = {"anger": 1.2, "sadness": 0.78, "happiness": 1.05}.get(sound.emotion, 0.95)
        look: Mapping[str, float] = {
            name: min(1.0, value * (loud if name == "jawOpen" else 1.0))
            for name, value in VISEME_SHAPES[viseme].items()
        }
        glide = GLIDES.get(sound.phone)
        if glide is None:
            claims.append((0.5 * (sound.start + sound.stop), length, strength, look))
        else:
            claims.append((sound.start + 0.3 * length, 0.7 * length, strength, look))
            claims.append((sound.stop - 0.15 * length, 0.5 * length, 0.8, VISEME_SHAPES[glide]))
    total = np.full_like(time, 1e-3)
    curves = {name: np.zeros_like(time) for look in VISEME_SHAPES.values() for name in look}
    closure = np.zeros_like(time)
    for middle, length, strength, look in claims:
        width = 0.030 + 0.48 * length
        claim = strength * np.exp(-(np.abs((time - middle) / width) ** 1.8))
        total += claim
        for name, value in look.items():
            curves[name] += claim * value
        if "mouthPressLeft" in look:
            closure = np.maximum(
                closure, np.exp(-(((time - middle) / (0.018 + 0.42 * length)) ** 4))
            )
    # Silence has a constant dominance, so that the mouth rests between sentences.
    activity = total / (total + 0.12)
    return {name: curve / (total + 0.12) for name, curve in curves.items()}, closure, activity


def _moods(time: FloatArray, activity: FloatArray) -> dict[str, FloatArray]:
    """Return curves of the moods with drift, reduced around the mouth during speech."""
    rng = np.random.default_rng(11)
    curves: defaultdict[str, FloatArray] = defaultdict(lambda: np.zeros_like(time))
    for line in LINES:
        envelope = smoothstep(time, line.start - 0.12, line.start + 0.36)
        envelope = envelope * smoothstep(time, line.stop + 0.22, line.stop - 0.22)
        for name, value in EMOTIONS[line.emotion].items():
            sway = 1.0 + 0.10 * _drift(rng, time, 0.9)
            room = 1.0 - 0.42 * activity * name.startswith(("mouth", "jaw"))
            curves[name] += value * _ASYMMETRY.get(name, 1.0) * envelope * sway * room
        for stress in line.stresses:
            accent = 0.30 * _bump(time, stress - 0.16, stress + 0.42)
            for name in ("browInnerUp", "browOuterUpLeft", "browOuterUpRight"):
                curves[name] += accent * (line.emotion != "anger")
            for name in ("noseSneerLeft", "noseSneerRight", "browDownLeft", "browDownRight"):
                curves[name] += 0.5 * accent * (line.emotion == "anger")
    return curves


def _beats(time: FloatArray) -> dict[str, FloatArray]:
    curves: defaultdict[str, FloatArray] = defaultdict(lambda: np.zeros_like(time))
    for name, start, stop, amount in _BEATS:
        curves[name] += amount * _bump(time, start, stop)
    return curves


def _blinks(time: FloatArray) -> dict[str, FloatArray]:
    """Return blinks: lids close in 75 ms, rest for 25 and open in 130, the right one 4 ms later."""
    curves = {}
    for side, late in (("Left", 0.0), ("Right", 0.004)):
        lids = np.zeros_like(time)
        for start in _BLINKS:
            t = time - start - late
            lids = np.maximum(lids, smoothstep(t, 0.0, 0.075) * smoothstep(t, 0.23, 0.10))
        curves["eyeBlink" + side] = 0.98 * lids
        curves["cheekSquint" + side] = 0.10 * lids
    return curves


def _gaze(time: FloatArray) -> dict[str, FloatArray]:
    """Return gaze: saccades of about 45 ms between fixations with small drift."""
    rng = np.random.default_rng(5)
    yaw, pitch = np.zeros_like(time), np.zeros_like(time)
    for (_, x0, y0), (start, x1, y1) in pairwise(_GAZES):
        step = smoothstep(time, start, start + 0.03 + 0.0015 * np.hypot(x1 - x0, y1 - y0))
        yaw += (x1 - x0) * step
        pitch += (y1 - y0) * step
    awake = smoothstep(time, 0.4, 0.8)
    yaw = (yaw + 0.35 * awake * _drift(rng, time, 2.0)) / _FULL_GAZE
    pitch = (pitch + 0.25 * awake * _drift(rng, time, 2.0)) / _FULL_GAZE
    left, right, up, down = (np.maximum(v, 0.0) for v in (yaw, -yaw, pitch, -pitch))
    return {
        "eyeLookOutLeft": left,
        "eyeLookInRight": left,
        "eyeLookInLeft": right,
        "eyeLookOutRight": right,
        **{"eyeLookUp" + side: up for side in ("Left", "Right")},
        **{"eyeLookDown" + side: down for side in ("Left", "Right")},
    }


def _head_motion(time: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return pitch, yaw, roll [degrees] and translation [mm]: poses, nods on stresses, sway."""
    rng = np.random.default_rng(3)
    poses = np.array(  # time, pitch, yaw, roll, x, y, z
        [
            (0.0, 0, 0, 0, 0, 0, 0),
            (0.6, 0, 0, 0, 0, 0, 0),
            (1.6, -3, -6, 2, -8, 2, 4),
            (2.9, 2, 9, -5, 12, -3, 0),
            (3.8, 0, 2, 0, 4, 0, 2),
            (4.7, -8, -3, 3, -4, 8, -12),
            (5.8, -3, 8, 6, 14, 4, 6),
            (6.9, -6, -9, -5, -16, 6, 2),
            (7.9, 4, 0, 0, 0, -4, 10),
            (9.0, 8, -5, -3, -6, -6, 34),
            (10.1, 6, 12, 3, 10, -5, 40),
            (11.1, 3, -4, 0, -4, 0, 12),
            (12.2, 13, 7, 6, 8, -14, -6),
            (13.6, 15, -7, -7, -10, -20, -14),
            (14.6, 3, 0, 0, 0, -2, 0),
            (15.1, 1, 0, 0, 0, 0, 0),
        ],
        float,
    )
    motion = np.zeros((len(time), 6))
    for before, after in pairwise(poses):
        step = smoothstep(time, before[0], after[0])
        motion += np.outer(step, after[1:] - before[1:])
    awake = smoothstep(time, 0.45, 0.9)
    for axis, amount in enumerate((0.9, 1.1, 0.7, 2.0, 1.2, 1.8)):
        motion[:, axis] += amount * awake * _drift(rng, time, 0.7)
    for line in LINES:
        for stress in line.stresses:
            motion[:, 0] += 3.2 * _bump(time, stress - 0.12, stress + 0.34)
    return motion[:, :3], motion[:, 3:]


def _bump(time: FloatArray, start: float, stop: float) -> FloatArray:
    """Return a smooth pulse between two times."""
    ramp = min(0.16, 0.45 * (stop - start))
    return smoothstep(time, start, start + ramp) * smoothstep(time, stop, stop - 1.3 * ramp)


def _drift(rng: np.random.Generator, time: FloatArray, frequency: float) -> FloatArray:
    """Return slow drift around zero of about unit size: three sines of unrelated periods."""
    waves: Sequence[FloatArray] = [
        np.sin(2.0 * np.pi * (frequency * factor * time + rng.random()))
        for factor in (0.41, 1.0, 1.73)
    ]
    return (waves[0] + 0.7 * waves[1] + 0.4 * waves[2]) / 1.3
