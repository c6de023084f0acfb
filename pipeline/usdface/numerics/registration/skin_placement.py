"""Place a levelled marker cloud on the skin of a face, by landmarks, skin and motion.

All positions are in the face's frame (`face_skin`), at the size of an adult's face. The
place of each marker has these priors:

* its landmark, with the standard deviation of such markers and Cauchy tails beyond 2.5 of them;
* the skin: small variance along its normal, large along the skin;
* its motion: likelihood of its path under the shapes, solved from all markers at their places.

Their product is smoothed by a Gaussian process whose kernel is mostly mirror-symmetric. It models
differing proportions, and keeps single markers near the others.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial import KDTree
from scipy.spatial.distance import cdist

from usdface.core.arrays import BoolArray, Float32Array, FloatArray, IntArray, frame_blocks
from usdface.core.processes import map_threads
from usdface.numerics.registration.cloud_alignment import Alignment
from usdface.numerics.registration.face_skin import TYPICAL_SIZE_MM, FaceSkin
from usdface.numerics.solve.bounded_least_squares import (
    minimise_within_bounds,
    solve_bounded_least_squares,
)

_REACHES_MM = (14.0, 12.0, 10.0, 9.0, 8.0, 7.0, 6.0, 5.5, 5.0, 4.5, 4.0, 4.0)
"""Standard deviation of a marker about its place in the search by motion, round by round."""

_CENTRAL_MM = 4.0
"""Markers this close to the performer's plane of symmetry are central."""
_CENTRAL_SPREAD_MM = 2.0
"""Standard deviation of central markers from the character's plane of symmetry."""
_MIDDLE_LABEL_SPREAD_MM = 4.0
"""The same of markers that are central by their label."""

_SETTLE_REACH_MM = 3.5
_SETTLE_LIMIT = 2.5
"""Standard deviation of a marker's sample from its warped place, and its largest multiple."""

_NORMAL_SPREAD_MM = 1.5
"""Standard deviation from the skin along its normal: the height of a marker."""
_SLIDE_SPREAD_MM = 30.0
"""Standard deviation along the skin."""

_WARP_LENGTH = 1.0
"""[of the face's size] Length scale of the warp."""
_WARP_SHARE = 0.13
"""[of the face's size] Standard deviation of the warp."""
_ASYMMETRIC_SHARE = 0.35
"""Share of the warp's variance that is not mirror-symmetric."""

_EVIDENCE_FRAMES = 6.0
"""Effective number of independent samples of a path, whose frames are correlated."""

_NOISE_MM = 0.5
MODEL_ERROR_SHARE = 0.06
"""[of a path's energy] Left unexplained by correct places too."""

_GAIN_LIMITS = (0.5, 2.0)
"""Limits of the amplitude of a performer's skin over that of the shapes."""

_RIDGE_MM2 = 25.0
"""(1.5 mm of noise / typical weight 0.3)^2."""

_BLOCK_FRAMES = 40
"""Frames per thread and task."""

_NEAR_STEPS = 60
"""Iterations from the weights of the previous round."""

_FEWEST_LANDMARKS = 6
"""With fewer, motion counts from the first round on, else from the fourth."""


@dataclass(frozen=True)
class KnownPlace:
    """Prior of the centroid of some markers, often of a single one."""

    markers: tuple[int, ...]
    place: FloatArray
    """(3,) [mm]"""
    spread_mm: float
    """Standard deviation of the centroid about the place."""
    name: str = ""
    """Of the landmark there."""

    def step(self, positions: FloatArray) -> FloatArray:
        """Return the vector from the centroid of these markers to its place: (3,) [mm]."""
        return self.place - positions[list(self.markers)].mean(axis=0)


@dataclass(frozen=True)
class SkinPlacement:
    """Places of markers on the skin."""

    samples: IntArray
    """(markers,): index of the skin sample."""
    warped: FloatArray
    """(markers, 3): after the warp, before a sample is chosen [mm]."""
    fit: Alignment
    """From which the warp starts."""


def place_on_skin(
    levelled: FloatArray,
    skin: FaceSkin,
    fit: Alignment,
    *,
    landmarks: Sequence[KnownPlace],
    motion: FloatArray,
    ranges: FloatArray,
    still: BoolArray,
    middle: Sequence[int],
    skin_share: float,
) -> SkinPlacement:
    """Choose a sample of the skin for every marker.

    Parameters
    ----------
    levelled : (markers, 3) float array
        At rest, the plane of symmetry at x = 0 [mm].
    fit : Alignment
        Initial fit.
    landmarks : sequence of KnownPlace
        The markers of one are moved together, and weigh as a single marker.
    motion : (frames, markers, 3) float array
        Displacements in the levelled space, of distinct frames, perhaps none [mm].
    ranges : (shapes, 2) float array
    still : (markers,) bool array
        Markers whose motion is ignored: on the skull, or never visible.
    middle : sequence of int
        Markers in the plane of symmetry according to their labels.
    skin_share : float
        Factor on the precision of the skin: less than 1 for clouds so dense that neighbours have
        the same error.
    """
    aligned = fit.apply(levelled)
    tree = KDTree(skin.positions)
    paths = to_character(motion, fit)
    warped = aligned.copy()
    weights = None
    named = len(landmarks) >= _FEWEST_LANDMARKS
    off_centre = skin.positions[:, 0] - skin.sagittal_x
    near_plane = abs(aligned[:, 0] - skin.sagittal_x) < _CENTRAL_MM
    across = np.where(near_plane, _CENTRAL_SPREAD_MM, np.inf)
    across[list(middle)] = np.minimum(across[list(middle)], _MIDDLE_LABEL_SPREAD_MM)
    central = 1 / across**2
    for number, reach in enumerate(_REACHES_MM):
        away, near = map(np.asarray, tree.query(warped))
        precision, target = (
            skin_share * each for each in _place_by_skin(skin, warped, near, away, reach)
        )
        precision[:, 0] += central
        target[:, 0] += central * skin.sagittal_x
        for known in landmarks:
            rows, step = list(known.markers), known.step(warped)
            deviations = float(np.linalg.norm(step)) / (2.5 * known.spread_mm)
            landmark_precision = 1 / (len(rows) * known.spread_mm**2) / (1 + deviations**2)
            precision[rows] += landmark_precision
            target[rows] += landmark_precision * (warped[rows] + step)
        if len(paths) and (number >= 3 or not named):
            weights = solve_weights_at(skin, near, paths, ranges, start=weights)
            misfit = path_misfit(skin.deltas, weights, paths)
            place, motion_precision = _place_by_motion(skin, warped, misfit, still, reach)
            precision += motion_precision[:, None]
            target += motion_precision[:, None] * place
        warped = _warp(aligned, target / precision, precision, skin)
    samples = np.asarray(tree.query(warped)[1])
    if len(paths):
        prior = cdist(warped, skin.positions, "sqeuclidean") / (2 * _SETTLE_REACH_MM**2)
        prior[prior > _SETTLE_LIMIT**2 / 2] = np.inf
        prior += central[:, None] * off_centre**2 / 2
        for known in landmarks:
            if len(known.markers) == 1:
                away = ((skin.positions - known.place) ** 2).sum(axis=1)
                prior[known.markers[0]] += away / (2 * known.spread_mm**2)
        samples = _settle(skin, prior, samples, paths, ranges, still)
    return SkinPlacement(samples, warped, fit)


def to_character(motion: FloatArray, fit: Alignment) -> FloatArray:
    """Return displacements in the character's frame, all axes scaled alike.

    By the geometric mean of width and height: the depth of a face does not predict the amplitude
    of its motion.
    """
    return np.sqrt(fit.scale[0] * fit.scale[1]) * (motion @ fit.rotation.T)


def explained_share(
    skin: FaceSkin, samples: IntArray, paths: FloatArray, weights: FloatArray
) -> float:
    """Return the share of the markers' motion that weights explain at their samples.

    The mean over markers of the explained share of each path's energy, weighted by the root of
    the energy; 0 if nothing moves.
    """
    if not paths.any():
        return 0.0
    predicted = np.einsum("fk,kmc->fmc", weights, skin.deltas[:, samples], optimize=True)
    residual = ((paths - predicted) ** 2).sum(axis=(0, 2))
    energy = (paths**2).sum(axis=(0, 2))
    noise = 3 * len(paths) * _NOISE_MM**2
    share = np.clip(1 - (residual + noise) / (energy + noise), -1, 1)
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
    """Solve weights within their ranges from markers' displacements: (frames, shapes).

    Parameters
    ----------
    start : (frames, shapes) float array, optional
        Weights at nearby samples: start of an iteration that ends within some 0.01 mm of motion.
    """
    deltas = skin.deltas[:, samples].reshape(len(skin.deltas), -1)
    flat = paths.reshape(len(paths), -1)
    if start is None:
        return solve_bounded_least_squares(
            deltas.T, flat, lower=ranges[:, 0], upper=ranges[:, 1], ridge=_RIDGE_MM2
        )
    A, ridge = deltas.astype(np.float32), np.float32(_RIDGE_MM2)
    lower, upper = (np.broadcast_to(limit, start.shape).astype(A.dtype) for limit in ranges.T)
    gram = A @ A.T + ridge * np.eye(len(A), dtype=A.dtype)
    few = len(A) < 2 * A.shape[1]  # shapes; the product with their Gram matrix takes less
    diagonal, linear = np.broadcast_to(gram.diagonal(), start.shape), flat.astype(A.dtype) @ A.T

    def solve(rows: slice) -> FloatArray:
        return minimise_within_bounds(
            (lambda z: z @ gram) if few else (lambda z: (z @ A) @ A.T + ridge * z),
            diagonal[rows],
            linear[rows],
            lower=lower[rows],
            upper=upper[rows],
            start=start[rows].astype(A.dtype),
            steps=_NEAR_STEPS,
        ).astype(np.float64)

    return np.concatenate(map_threads(solve, frame_blocks(len(start), frames=_BLOCK_FRAMES)))


def _place_by_skin(
    skin: FaceSkin, warped: FloatArray, near: IntArray, away: FloatArray, reach: float
) -> tuple[FloatArray, FloatArray]:
    """Return the precision per axis, and precision times place, of the nearest skin."""
    normal = skin.normals[near]
    along_normal = 1 / _NORMAL_SPREAD_MM**2 / (1 + (away / reach) ** 2)
    precision = normal**2 * along_normal[:, None] + 1 / _SLIDE_SPREAD_MM**2
    height = ((skin.positions[near] - warped) * normal).sum(axis=1, keepdims=True)
    return precision, precision * (warped + height * normal)


def _place_by_motion(
    skin: FaceSkin, warped: FloatArray, misfit: Float32Array, still: BoolArray, reach: float
) -> tuple[FloatArray, FloatArray]:
    """Return each marker's place by motion alone, and its precision, 0 for `still` ones."""
    before = cdist(warped, skin.positions, "sqeuclidean") / (2 * reach**2)
    after = before + _EVIDENCE_FRAMES / 2 * np.log(misfit + MODEL_ERROR_SHARE)
    place, variance = likelihood_moments(before, after, skin.positions, largest_share=0.95)
    step = place - warped
    length = np.maximum(np.linalg.norm(step, axis=1, keepdims=True), 1e-9)
    place = warped + step * np.minimum(reach / length, 1.0)
    return place, np.where(still, 0.0, 1 / (variance + (0.05 * TYPICAL_SIZE_MM) ** 2))


def likelihood_moments(
    prior_cost: FloatArray, cost: FloatArray, positions: FloatArray, *, largest_share: float
) -> tuple[FloatArray, FloatArray]:
    """Return mean and variance per axis of Gaussian likelihoods, as posterior over prior.

    For markers that hardly move the variance is large.

    Parameters
    ----------
    prior_cost, cost : (markers, samples) float arrays
        Negative logarithms of prior and posterior.
    largest_share : float
        Limit of the posterior's variance over that of the prior, below 1.
    """
    prior_mean, wide = _moments(prior_cost, positions)
    mean, narrow = _moments(cost, positions)
    narrow = np.minimum(narrow, largest_share * wide)
    gain = wide / (wide - narrow)
    return prior_mean + (mean - prior_mean) * gain[:, None], narrow * gain


def _moments(cost: FloatArray, positions: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return mean and variance per axis of distributions ``exp(-cost)`` over samples."""
    density = np.exp((cost.min(axis=1, keepdims=True) - cost).astype(np.float32))
    total = density.sum(axis=1, dtype=np.float64)
    mean = density @ positions / total[:, None]
    variance = density @ (positions**2).sum(axis=1) / total - (mean**2).sum(axis=1)
    return mean, np.maximum(variance, 1e-9) / 3


def path_misfit(deltas: Float32Array, weights: FloatArray, paths: FloatArray) -> Float32Array:
    """Return the share of each marker's path that each sample leaves unexplained.

    The amplitude (gain) of each path is fitted within limits. Returns (markers, samples).

    Parameters
    ----------
    deltas : (shapes, samples, 3) float array
        [mm]
    weights : (frames, shapes) float array
    paths : (frames, markers, 3) float array
        [mm]
    """
    # W = QR: products need R alone, which has no more rows than there are shapes.
    basis, root = np.linalg.qr(weights)
    along = np.einsum("fmc,fr->cmr", paths, basis, optimize=True).astype(np.float32)
    root, energy = root.astype(np.float32), (paths**2).sum(axis=(0, 2)).astype(np.float32)

    def along_axis(axis: int) -> tuple[Float32Array, Float32Array]:
        moves = root @ deltas[:, :, axis]
        return along[axis] @ moves, np.einsum("rs,rs->s", moves, moves)

    product, sample_energy = map(sum, zip(*map_threads(along_axis, range(3)), strict=True))
    gain = np.clip(product / np.maximum(sample_energy, 1e-9), *_GAIN_LIMITS)
    residual = np.maximum(energy[:, None] + gain * (gain * sample_energy - 2 * product), 0)
    noise = 3 * len(paths) * _NOISE_MM**2
    return (residual + noise) / (energy + noise)[:, None]


def _settle(
    skin: FaceSkin,
    prior: FloatArray,
    samples: IntArray,
    paths: FloatArray,
    ranges: FloatArray,
    still: BoolArray,
) -> IntArray:
    """Choose the sample near the warped place with the largest posterior of place and motion."""
    misfit = path_misfit(skin.deltas, solve_weights_at(skin, samples, paths, ranges), paths)
    misfit[still] = 1.0
    cost = prior + _EVIDENCE_FRAMES / 2 * np.log(misfit + MODEL_ERROR_SHARE)
    return np.where(np.isfinite(cost.min(axis=1)), cost.argmin(axis=1), samples)


def _warp(
    start: FloatArray, target: FloatArray, precision: FloatArray, skin: FaceSkin
) -> FloatArray:
    """Move points towards targets by the posterior mean of a Gaussian process over the cloud.

    Its kernel is mostly mirror-symmetric: ``x`` displacements have opposite signs on the two
    sides, the others are equal.
    """
    length, variance = _WARP_LENGTH * TYPICAL_SIZE_MM, (_WARP_SHARE * TYPICAL_SIZE_MM) ** 2
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
