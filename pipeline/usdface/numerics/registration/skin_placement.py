"""Put a levelled marker cloud on a face's skin: landmarks, skin and motion pull, a warp binds.

All positions are in the face's frame (`face_skin`). Each marker's place x is drawn by

* its landmark, Gaussian with the spread of such markers, Cauchy beyond 2.5 spreads;
* the skin, hard along its normal and hardly along the skin;
* its motion: what the shapes, solved from all markers where they are now, would do nearby,

and the field of pulls is smoothed by a Gaussian process whose kernel is mostly mirror-symmetric, so
that differing proportions are warped away and single markers cannot run.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial import KDTree
from scipy.spatial.distance import cdist

from usdface.core.arrays import BoolArray, FloatArray, IntArray
from usdface.numerics.registration.face_skin import FaceSkin
from usdface.numerics.solve.bounded_least_squares import (
    descend_in_boxes,
    solve_bounded_least_squares,
)

TYPICAL_SIZE_MM = 55.0
"""Root mean square radius of an adult's moving face: lengths in mm below are on such a face."""

_REACHES_MM = (14.0, 12.0, 10.0, 9.0, 8.0, 7.0, 6.0, 5.5, 5.0, 4.5, 4.0, 4.0)
"""How far from its place a marker looks for skin that moves as it does, round by round."""

_CENTRAL_MM = 4.0
_CENTRAL_SPREAD_MM = 2.0
_MIDDLE_LABEL_SPREAD_MM = 4.0
"""A marker this close to the performer's plane of symmetry lies as close to the character's; one
whose label says that it is in the middle was meant to be there, and is a little off."""

_SETTLE_REACH_MM = 3.5
_SETTLE_LIMIT = 2.5
"""Standard deviation of a marker's place after the warp, and how many of them it may lie off."""

_NORMAL_SPREAD_MM = 1.5
_SLIDE_SPREAD_MM = 30.0
"""Along its normal the skin is known to a marker's height; along itself it says nothing."""

_WARP_LENGTH = 1.0
_WARP_SHARE = 0.13
_ASYMMETRIC_SHARE = 0.35
"""Of the face's size: the length over which proportions differ between faces, and by how much;
and the share of the warp's variance that is not mirror-symmetric."""

_EVIDENCE_FRAMES = 6.0
"""Independent samples that a path counts for: frames repeat each other."""

_NOISE_MM = 0.5
MODEL_ERROR_SHARE = 0.06
"""Of a path's energy, which no correct place explains either."""

_GAIN_LIMITS = (0.5, 2.0)
"""How much less or more far than the shapes a performer's skin may go."""

_RIDGE_MM2 = 25.0
"""(1.5 mm of noise / typical weight 0.3)^2."""

_NEAR_STEPS = 60
"""From the weights of the round before."""

_FEWEST_LANDMARKS = 6
"""With fewer the cloud is placed by motion from the first round on."""

_AXES_HELD = 0.35
"""Pseudo-observations, as a share of the cloud's energy, that hold each axis to the mean scale."""


@dataclass(frozen=True)
class PlaneFit:
    """``aligned = scale * (levelled @ rotation.T) + shift``."""

    rotation: FloatArray
    """(3, 3): pitch alone: about the X axis."""
    scale: FloatArray
    """(3,): character over performer, along the face's axes."""
    shift: FloatArray
    """(3,) [mm]"""

    def apply(self, levelled: FloatArray) -> FloatArray:
        """Return points in the face's frame of the character."""
        return np.asarray(self.scale * (levelled @ self.rotation.T) + self.shift)


@dataclass(frozen=True)
class KnownPlace:
    """Where the middle of some markers belongs, often of a single one."""

    markers: tuple[int, ...]
    place: FloatArray
    """(3,) [mm]"""
    spread_mm: float
    """Standard deviation of the middle about the place."""

    def step(self, positions: FloatArray) -> FloatArray:
        """Return how far the middle of these markers is from its place: (3,) [mm]."""
        return np.asarray(self.place - positions[list(self.markers)].mean(axis=0))


@dataclass(frozen=True)
class SkinPlacement:
    """Where each marker was put."""

    samples: IntArray
    """(markers,): of the skin."""
    warped: FloatArray
    """(markers, 3): before a sample was chosen [mm]."""
    fit: PlaneFit
    """What the warp started from."""


def fit_in_plane(
    levelled: FloatArray, targets: FloatArray, spreads: FloatArray, *, rounds: int = 15
) -> PlaneFit:
    """Fit pitch, scales and the two shifts in the sagittal plane to targets, robustly.

    Minimises ``sum |R s y + t - x|^2 / spread^2`` with Cauchy weights; the axes' scales are shrunk
    towards one, since a face's markers are nearly a plane.

    Parameters
    ----------
    levelled : (n, 3) float array
        The plane of symmetry at x = 0 [mm].
    targets : (n, 3) float array
        In the character's frame, its plane of symmetry at x = 0 [mm].
    spreads : (n,) float array
        Standard deviations of the targets [mm].
    """
    base = 1 / spreads**2
    weight = base
    rotation, scale, shift = np.eye(3), np.ones(3), np.zeros(3)
    in_plane = np.array([0.0, 1.0, 1.0])
    for _ in range(rounds):
        share = weight / weight.sum()
        centre, goal = share @ levelled * in_plane, share @ targets * in_plane
        y, x = levelled - centre, targets - goal
        sine = share @ (x[:, 2] * y[:, 1] - x[:, 1] * y[:, 2])
        cosine = share @ (x[:, 1] * y[:, 1] + x[:, 2] * y[:, 2])
        rotation = pitch_rotation(float(np.arctan2(sine, cosine)))
        turned = y @ rotation.T
        energy = share @ turned**2
        common = (share @ (turned * x).sum(axis=1)) / energy.sum()
        held = _AXES_HELD * energy.mean()
        scale = (share @ (turned * x) + held * common) / (energy + held)
        shift = goal - scale * (rotation @ centre) * in_plane
        fit = PlaneFit(rotation, scale, shift)
        away = np.linalg.norm(fit.apply(levelled) - targets, axis=1) / spreads
        weight = base / (1 + (away / 2.0) ** 2)
    return PlaneFit(rotation, scale, shift)


def pitch_rotation(angle: float) -> FloatArray:
    """Return the rotation about X by an angle [radians]."""
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[1.0, 0.0, 0.0], [0.0, c, -s], [0.0, s, c]])


def place_on_skin(
    levelled: FloatArray,
    skin: FaceSkin,
    fit: PlaneFit,
    *,
    landmarks: Sequence[KnownPlace],
    motion: FloatArray | None,
    ranges: FloatArray,
    still: BoolArray,
    middle: Sequence[int] = (),
) -> SkinPlacement:
    """Choose a sample of the skin for every marker.

    Parameters
    ----------
    levelled : (markers, 3) float array
        At rest, the plane of symmetry at x = 0 [mm].
    fit : PlaneFit
        Where the cloud lies to begin with.
    landmarks : sequence of KnownPlace
        The markers of one keep their places to each other, and count as a single one.
    motion : (frames, markers, 3) float array, optional
        Displacements in the levelled space, of frames that differ [mm].
    ranges : (shapes, 2) float array
    still : (markers,) bool array
        Markers whose motion says nothing: of the skull, or never seen.
    middle : sequence of int
        Markers whose label says that they lie in the plane of symmetry.
    """
    unit = skin.size_mm / TYPICAL_SIZE_MM
    aligned = fit.apply(levelled)
    tree = KDTree(skin.positions)
    paths = None if motion is None else in_character(motion, fit)
    warped = aligned.copy()
    weights = None
    named = len(landmarks) >= _FEWEST_LANDMARKS
    off_centre = skin.positions[:, 0] - skin.sagittal_x
    near_plane = abs(aligned[:, 0] - skin.sagittal_x) < _CENTRAL_MM * unit
    across = np.where(near_plane, _CENTRAL_SPREAD_MM, np.inf)
    across[list(middle)] = np.minimum(across[list(middle)], _MIDDLE_LABEL_SPREAD_MM)
    central = 1 / (across * unit) ** 2
    for number, reach in enumerate(_REACHES_MM):
        away, near = map(np.asarray, tree.query(warped))
        precision, target = _skin_pull(skin, warped, near, away, reach * unit, unit)
        precision[:, 0] += central
        target[:, 0] += central * skin.sagittal_x
        for known in landmarks:
            rows, step = list(known.markers), known.step(warped)
            off = float(np.linalg.norm(step)) / (2.5 * known.spread_mm)
            pull = 1 / (len(rows) * known.spread_mm**2) / (1 + off**2)
            precision[rows] += pull
            target[rows] += pull * (warped[rows] + step)
        if paths is not None and (number >= 3 or not named):
            weights = solve_weights_at(skin, near, paths, ranges, start=weights)
            misfit = _path_misfit(skin, weights, paths)
            by_motion, firm = _motion_pull(skin, warped, misfit, still, reach * unit)
            precision += firm[:, None]
            target += firm[:, None] * by_motion
        warped = _warp(aligned, target / precision, precision, skin)
    samples = np.asarray(tree.query(warped)[1])
    if paths is not None:
        prior = cdist(warped, skin.positions, "sqeuclidean") / (2 * (_SETTLE_REACH_MM * unit) ** 2)
        prior[prior > _SETTLE_LIMIT**2 / 2] = np.inf
        prior += central[:, None] * off_centre**2 / 2
        for known in landmarks:
            if len(known.markers) == 1:
                away = ((skin.positions - known.place) ** 2).sum(axis=1)
                prior[known.markers[0]] += away / (2 * known.spread_mm**2)
        samples = _settle(skin, prior, samples, paths, ranges, still)
    return SkinPlacement(samples, warped, fit)


def in_character(motion: FloatArray, fit: PlaneFit) -> FloatArray:
    """Return displacements in the character's frame, all axes scaled alike.

    Depth is left out of the scale: it is told by the shape of a face alone, and no guide to how far
    its skin moves.
    """
    return np.asarray(np.sqrt(fit.scale[0] * fit.scale[1]) * (motion @ fit.rotation.T))


def explained_share(
    skin: FaceSkin, samples: IntArray, paths: FloatArray, weights: FloatArray
) -> float:
    """Return how much of the markers' motion weights explain at their samples.

    The mean over markers of the share of each path's energy, weighted by its root; 0 where nothing
    moves.
    """
    if not paths.any():
        return 0.0
    predicted = np.einsum("fk,kmc->fmc", weights, skin.deltas[:, samples], optimize=True)
    left = ((paths - predicted) ** 2).sum(axis=(0, 2))
    energy = (paths**2).sum(axis=(0, 2))
    noise = 3 * len(paths) * _NOISE_MM**2
    share = np.clip(1 - (left + noise) / (energy + noise), -1, 1)
    weight = np.sqrt(energy)
    return float(weight @ share / weight.sum())


def solve_weights_at(
    skin: FaceSkin,
    samples: IntArray,
    paths: FloatArray,
    ranges: FloatArray,
    *,
    start: FloatArray | None = None,
) -> FloatArray:
    """Return weights within their ranges from markers' displacements: (frames, shapes).

    Parameters
    ----------
    start : (frames, shapes) float array, optional
        Weights at samples nearby: these are followed to the solution, to some 0.01 mm of motion.
    """
    deltas = skin.deltas[:, samples].reshape(len(skin.deltas), -1)
    flat = paths.reshape(len(paths), -1)
    if start is None:
        return solve_bounded_least_squares(
            deltas.T, flat, lower=ranges[:, 0], upper=ranges[:, 1], ridge=_RIDGE_MM2
        ).x
    A, ridge = deltas.astype(np.float32), np.float32(_RIDGE_MM2)
    lower, upper = (np.broadcast_to(limit, start.shape).astype(A.dtype) for limit in ranges.T)
    return descend_in_boxes(
        lambda z: (z @ A) @ A.T + ridge * z,
        np.broadcast_to((A**2).sum(axis=1) + ridge, start.shape),
        flat.astype(A.dtype) @ A.T,
        lower=lower,
        upper=upper,
        start=start.astype(A.dtype),
        steps=_NEAR_STEPS,
    ).astype(np.float64)


def _skin_pull(
    skin: FaceSkin, warped: FloatArray, near: IntArray, away: FloatArray, reach: float, unit: float
) -> tuple[FloatArray, FloatArray]:
    """Return the precision per axis, and precision times place, of the nearest skin."""
    normal = skin.normals[near]
    firm = 1 / (_NORMAL_SPREAD_MM * unit) ** 2 / (1 + (away / reach) ** 2)
    precision = normal**2 * firm[:, None] + 1 / (_SLIDE_SPREAD_MM * unit) ** 2
    height = ((skin.positions[near] - warped) * normal).sum(axis=1, keepdims=True)
    return precision, precision * (warped + height * normal)


def _motion_pull(
    skin: FaceSkin,
    warped: FloatArray,
    misfit: FloatArray,
    still: BoolArray,
    reach: float,
) -> tuple[FloatArray, FloatArray]:
    """Return where motion alone puts each marker, and with what precision.

    The belief after seeing the motion divided by the belief before it: a marker that hardly moves
    says nothing, rather than "the middle of what is near".
    """
    before = cdist(warped, skin.positions, "sqeuclidean") / (2 * reach**2)
    cost = before + _EVIDENCE_FRAMES / 2 * np.log(misfit + MODEL_ERROR_SHARE)
    mean_before, wide = belief_moments(before, skin.positions)
    mean_after, narrow = belief_moments(cost, skin.positions)
    narrow = np.minimum(narrow, 0.95 * wide)
    place = mean_before + (mean_after - mean_before) * (wide / (wide - narrow))[:, None]
    step = place - warped
    length = np.maximum(np.linalg.norm(step, axis=1, keepdims=True), 1e-9)
    place = warped + step * np.minimum(reach / length, 1.0)
    variance = narrow * wide / (wide - narrow) + (0.05 * skin.size_mm) ** 2
    return place, np.where(still, 0.0, 1 / variance)


def belief_moments(cost: FloatArray, positions: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return mean and variance per axis of beliefs ``exp(-cost)`` over samples."""
    belief = np.exp(cost.min(axis=1, keepdims=True) - cost)
    belief /= belief.sum(axis=1, keepdims=True)
    mean = belief @ positions
    spread = belief @ (positions**2).sum(axis=1) - (mean**2).sum(axis=1)
    return mean, np.maximum(spread, 1e-9) / 3


def _path_misfit(skin: FaceSkin, weights: FloatArray, paths: FloatArray) -> FloatArray:
    """Return the share of each marker's path that each sample leaves unexplained.

    A path may be longer or shorter than the shapes': its own gain is fitted within limits.
    """
    # Orthonormal times root: no longer than weights, with no more rows than shapes.
    basis, root = np.linalg.qr(weights)
    energy = (paths**2).sum(axis=(0, 2))
    count = len(skin.positions)
    common, own = np.zeros((paths.shape[1], count)), np.zeros(count)
    for axis in range(3):
        moves = root @ skin.deltas[:, :, axis]
        common += (paths[:, :, axis].T @ basis) @ moves
        own += np.einsum("rs,rs->s", moves, moves)
    gain = np.clip(common / np.maximum(own, 1e-9), *_GAIN_LIMITS)
    left = np.maximum(energy[:, None] - 2 * gain * common + gain**2 * own, 0)
    noise = 3 * len(paths) * _NOISE_MM**2
    return np.asarray((left + noise) / (energy + noise)[:, None])


def _settle(
    skin: FaceSkin,
    prior: FloatArray,
    samples: IntArray,
    paths: FloatArray,
    ranges: FloatArray,
    still: BoolArray,
) -> IntArray:
    """Choose last between samples near the warped place: where it is and how it moves together."""
    misfit = _path_misfit(skin, solve_weights_at(skin, samples, paths, ranges), paths)
    misfit[still] = 1.0
    cost = prior + _EVIDENCE_FRAMES / 2 * np.log(misfit + MODEL_ERROR_SHARE)
    return np.where(np.isfinite(cost.min(axis=1)), cost.argmin(axis=1), samples)


def _warp(
    start: FloatArray, target: FloatArray, precision: FloatArray, skin: FaceSkin
) -> FloatArray:
    """Move points towards targets by a Gaussian process over the cloud, mostly mirror-symmetric.

    A symmetric field has ``x`` displacements of opposite sign on the two sides, and equal ones
    along the other axes.
    """
    length, variance = _WARP_LENGTH * skin.size_mm, (_WARP_SHARE * skin.size_mm) ** 2
    same = np.exp(-0.5 * cdist(start, start, "sqeuclidean") / length**2)
    across = np.exp(-0.5 * cdist(start, skin.mirrored(start), "sqeuclidean") / length**2)
    symmetric = (1 - _ASYMMETRIC_SHARE) / 2
    warped = start.copy()
    for axis, sign in enumerate((-1.0, 1.0, 1.0)):
        kernel = variance * ((symmetric + _ASYMMETRIC_SHARE) * same + sign * symmetric * across)
        noise = np.diag(1 / precision[:, axis])
        pull = np.linalg.solve(kernel + noise, target[:, axis] - start[:, axis])
        warped[:, axis] += kernel @ pull
    return warped
