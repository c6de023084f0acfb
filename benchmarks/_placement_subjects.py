"""Simulated performers with known marker positions and weights, and their equations."""

from collections import Counter
from dataclasses import dataclass

import numpy as np

from tests.conftest import SHARED_DATA
from usdface.capture.sniff import read_capture
from usdface.core.arrays import FloatArray, IntArray
from usdface.core.assets import Rig
from usdface.core.deformer import Deformer
from usdface.model.placement.rig_landmarks import find_landmarks
from usdface.model.retarget.shape_names import motion_and_side
from usdface.model.selection.baseline import BlendshapeEquation, PerformerMarkers, set_up_equation
from usdface.numerics.registration.face_skin import FaceSkin

MARKER_COUNT = 72
RIGID_COUNT = 6
_EVERY_FRAME = 6
"""Every n-th frame of the recorded performance, about 700."""

_PROPORTIONS = np.array([1.1, 0.9, 1.2])
"""Size of the character over that of the performer, along x, y and z."""

_WARP_MM, _WARP_LENGTH_MM = 4.0, 40.0
_GAIN_SPREAD = 0.15
"""Standard deviation of the logarithm of the amplitude of each shape on the performer."""

_NOISE_MM = 0.15
_PART_MM = 22.0
"""Distance from a landmark up to which a marker is named after its part of the face."""

_PARTS = {"eye": "lid", "lip": "mouth"}


@dataclass(frozen=True)
class Head:
    """A rig with its deformer and skin."""

    rig: Rig
    deformer: Deformer
    skin: FaceSkin


def head_of(rig: Rig) -> Head:
    deformer = Deformer(rig)
    return Head(rig, deformer, deformer.face_skin())


def find_equation(
    head: Head,
    positions: FloatArray,
    neutral: FloatArray,
    rigid: tuple[int, ...],
    labels: tuple[str, ...],
) -> BlendshapeEquation:
    return set_up_equation(
        head.rig,
        head.deformer,
        PerformerMarkers(
            neutral=neutral,
            positions=positions,
            visible=np.ones(positions.shape[:2], np.bool_),
            rigid=rigid,
            labels=labels,
        ),
    )


@dataclass(frozen=True)
class SimulatedTake:
    """Stabilised markers of a performer, with labels without meaning.

    Attributes
    ----------
    neutral : (markers, 3) float array
        [mm]
    positions : (frames, markers, 3) float array
        [mm]
    rigid : tuple of int
        The markers that the shapes move least.
    weights : (frames, shapes) float array
        True weights.
    samples : (markers,) int array
        Indices of the skin samples at the markers.
    """

    neutral: FloatArray
    positions: FloatArray
    rigid: tuple[int, ...]
    weights: FloatArray
    samples: IntArray

    @property
    def labels(self) -> tuple[str, ...]:
        """Return names without meaning."""
        return tuple(f"m{i}" for i in range(len(self.neutral)))

    def numbered(self, skin: FaceSkin, shapes: tuple[str, ...]) -> tuple[str, ...]:
        """Return names of each marker's part and side, with a number."""
        found = find_landmarks(skin, shapes)
        places, counts, labels = np.array(list(found.values())), Counter[str](), []
        for at in skin.positions[self.samples]:
            away = np.linalg.norm(places - at, axis=1)
            near = list(found)[away.argmin()] if away.min() < _PART_MM else "cheek"
            part = _PARTS.get(near.split("_")[0], near.split("_")[0])
            name = f"{part}_{'L' if at[0] > skin.sagittal_x else 'R'}"
            counts[name] += 1
            labels.append(f"{name}{counts[name]}")
        return tuple(labels)


def simulate_take(skin: FaceSkin, shapes: tuple[str, ...], *, seed: int) -> SimulatedTake:
    """Simulate a performer with other proportions by a recorded performance."""
    rng = np.random.default_rng(seed)
    samples = _spread_markers(skin, rng)
    at = skin.positions[samples]
    turn = np.array([[0.8, 0.0, 0.6], [0.0, 1.0, 0.0], [-0.6, 0.0, 0.8]])
    warped = at + _WARP_MM * np.sin(at / _WARP_LENGTH_MM)[:, [1, 2, 0]]
    neutral = (warped / _PROPORTIONS) @ turn.T + [100.0, 1500.0, -40.0]
    gains = np.exp(_GAIN_SPREAD * rng.standard_normal((len(shapes), 1, 1)))
    weights = _recorded_weights(shapes)
    moved = np.einsum("fs,smc->fmc", weights, skin.deltas[:, samples] * gains, optimize=True)
    moved = moved / _PROPORTIONS[:2].prod() ** 0.5 @ turn.T
    moved += _NOISE_MM * rng.standard_normal(moved.shape)
    rigid = np.argsort(skin.activity()[samples])[:RIGID_COUNT]
    return SimulatedTake(
        neutral, neutral + moved, tuple(map(int, np.sort(rigid))), weights, samples
    )


def _spread_markers(skin: FaceSkin, rng: np.random.Generator) -> IntArray:
    """Choose distant samples, more densely where the face moves."""
    share = 0.4 + skin.activity() / skin.activity().max()
    pool = np.flatnonzero(skin.activity() > 0.02 * skin.activity().max())
    chosen, distance = [int(rng.choice(pool))], np.full(len(pool), np.inf)
    while len(chosen) < MARKER_COUNT:
        step = np.linalg.norm(skin.positions[pool] - skin.positions[chosen[-1]], axis=1)
        distance = np.minimum(distance, step)
        chosen.append(int(pool[np.argmax(distance * share[pool])]))
    return np.array(chosen)


def _recorded_weights(shapes: tuple[str, ...]) -> FloatArray:
    source = read_capture(SHARED_DATA / "livelink_alex" / "alex_rom_3.csv").take.source
    if source is None:
        raise SystemExit("livelink_alex has no weights")
    column_of = {motion_and_side(name): i for i, name in enumerate(source.names)}
    values = np.clip(source.values[::_EVERY_FRAME].astype(float), 0, 1)
    weights = np.zeros((len(values), len(shapes)))
    for i, name in enumerate(shapes):
        motion, side = motion_and_side(name)
        column = column_of.get((motion, side), column_of.get((motion, "")))
        if column is not None:
            weights[:, i] = values[:, column]
    return weights
