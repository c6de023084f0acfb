"""Head pose from markers of the face, whose expression is unknown: where rigid ones are missing.

The markers of a frame are a rigid transform of ``x ~ N(mean, S)``, with the low-rank model's
``S = C' V C + N``. The pose maximises the likelihood, with the expression marginalised:

    minimise r' inv(S) r + q' inv(P) q,   r = R x + t - mean,

by Gauss-Newton steps from the alignment with the mean. q is the rotation and shift relative to the
pose interpolated between measured ones, P its covariance, as `interpolation_precision` estimates it
from the take: small in short gaps of a still head, large in long ones. With J the derivatives of
r, a step is ``-inv(J' inv(S) J + inv(P)) (J' inv(S) r + inv(P) q)``; the inverse matrix is the
covariance of the pose. Woodbury's identity gives
``inv(S) = inv(N) - inv(N) C' inv(inv(V) + C inv(N) C') C inv(N)``.

The noise of a marker grows with its residual, so that swapped labels and outliers do not count
(Cauchy weights). The likelihood's covariance is scaled by how far the frame exceeds the model: the
median of the residuals over the noise, or the mean square of the scores over their variances, if
more than usual.

References
----------
Rasmussen and Williams (2006), Gaussian Processes for Machine Learning, section A.3: Woodbury.
Holland and Welsch (1977), Communications in Statistics A6(9), 813-827: Cauchy weights.
"""

import numpy as np
from scipy.spatial.transform import Rotation

from usdface.core.arrays import BoolArray, FloatArray, RealArray, frame_blocks
from usdface.core.processes import map_threads
from usdface.numerics.repair.low_rank import LowRankModel
from usdface.numerics.rigid.rigid_alignment import (
    align_rigid,
    alignment_of,
    pose_matrices,
    remove_motion,
)

_BLOCK_FRAMES = 256
"""The derivatives of a hundred markers take 4 MB."""
_MOST_STEPS = 8
_SETTLED_MM = 0.01
"""Largest shift of a step at which the pose has converged."""
_INLIER_DEVIATIONS = 3.0
"""Residual at which a marker weighs half [standard deviations of the noise]."""
_MEDIAN_CHI_SQUARE = 2.366
"""Of three degrees of freedom."""
_VAGUE_PRECISION = np.repeat([0.1, 1e-9], 3)
"""Of a pose known to 3 rad and 30 m: the matrix is invertible even if all markers are one point."""
_LEAST_VARIANCE = np.repeat([1e-8, 1e-4], 3)
"""Of interpolated poses: 0.1 mrad and 0.01 mm, squared."""


def pose_by_face(
    model: LowRankModel,
    positions: RealArray,
    seen: BoolArray,
    *,
    precision: FloatArray,
    centre: FloatArray,
) -> tuple[FloatArray, FloatArray]:
    """Return the poses of frames of unknown expression, and their variance.

    Parameters
    ----------
    positions : (frames, markers, 3) float array
        [mm] In the poses that the prior expects; anything finite where not seen.
    seen : (frames, markers) bool array
        Three or more in each frame.
    precision : (frames, 6) float array
        Of the prior: rotation about the centre [1/rad^2] and shift [1/mm^2]; 0 for none.
    centre : (3,) float array
        In or near the head [mm].

    Returns
    -------
    poses : (frames, 4, 4) float array
        For column vectors: ``positions = pose @ x``, with x in the model's space.
    variance : (frames,) float array
        Mean square displacement of a marker by the error of the pose [mm^2].
    """
    poses, variance = np.empty((len(positions), 4, 4)), np.empty(len(positions))

    def solve(rows: slice) -> None:
        given = positions[rows], seen[rows], precision[rows]
        poses[rows], variance[rows] = _solve(model, *given, centre)

    map_threads(solve, frame_blocks(len(positions), frames=_BLOCK_FRAMES))
    return poses, variance


def _solve(
    model: LowRankModel,
    positions: RealArray,
    seen: BoolArray,
    prior: FloatArray,
    centre: FloatArray,
) -> tuple[FloatArray, FloatArray]:
    mean, prior = model.mean.reshape(-1, 3), np.maximum(prior, _VAGUE_PRECISION)
    weights, excess = seen / model.noise**2, np.ones(len(seen))
    start = align_rigid(positions, mean, weights=seen)
    poses, aligned = start.matrices(), remove_motion(positions.astype(np.float64), start)
    for _ in range(_MOST_STEPS):
        vectors = np.zeros((*aligned.shape, 7))  # derivatives of r by rotation and shift, and r
        vectors[..., :3] = np.cross(np.eye(3), (aligned - centre)[..., None, :]).swapaxes(2, 3)
        vectors[..., 3:6], vectors[..., 6] = np.eye(3), aligned - mean
        remainder, scores, normal = _marginalise(model, vectors, weights)
        normal /= excess[:, None, None]
        covariance = np.linalg.inv(normal[:, :6, :6] + prior[:, None] * np.eye(6))
        gradient = normal[:, :6, 6] + prior * _coordinates(poses, centre)
        step = -(covariance @ gradient[..., None])[..., 0]
        correction = _inverse_motion(step, centre)
        poses, aligned = poses @ correction, remove_motion(aligned, alignment_of(correction))
        combination = np.append(step, np.ones((len(step), 1)), axis=1)[..., None]
        chi = np.linalg.norm((remainder @ combination[:, None])[..., 0], axis=2) / model.noise
        weights = seen / (model.noise**2 * (1 + (chi / _INLIER_DEVIATIONS) ** 2))
        unexplained = np.nanmedian(np.where(seen, chi**2, np.nan), axis=1) / _MEDIAN_CHI_SQUARE
        unusual = np.mean((scores @ combination)[..., 0] ** 2 / model.variances, axis=1)
        excess = np.maximum(1.0, np.maximum(unexplained, unusual))
        if abs(vectors[..., :6] @ step[:, None, :, None]).max() < _SETTLED_MM:
            break
    slope = vectors[..., :6]
    moved = np.einsum("fmci,fij,fmcj->f", slope, covariance, slope, optimize=True)
    return poses, moved / seen.shape[1]


def _marginalise(
    model: LowRankModel, vectors: FloatArray, weights: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the remainder of vectors, their scores, and ``vectors' inv(S) vectors``."""
    components = model.components.reshape(len(model.variances), -1, 3)
    grams = np.einsum("kmc,lmc->mkl", components, components)
    inner = np.einsum("fm,mkl->fkl", weights, grams, optimize=True) + np.diag(1 / model.variances)
    weighed = weights[..., None, None] * vectors
    scores = np.linalg.solve(inner, np.einsum("kmc,fmci->fki", components, weighed, optimize=True))
    remainder = vectors - np.einsum("kmc,fki->fmci", components, scores, optimize=True)
    return remainder, scores, np.einsum("fmci,fmcj->fij", weighed, remainder, optimize=True)


def _coordinates(poses: FloatArray, centre: FloatArray) -> FloatArray:
    """Return the rotation vector and the shift of the inverse of poses about a centre."""
    back = poses[:, :3, :3].swapaxes(1, 2)
    shift = (back @ (centre - poses[:, :3, 3])[..., None])[..., 0] - centre
    return np.hstack([Rotation.from_matrix(back).as_rotvec(), shift])


def _inverse_motion(coordinates: FloatArray, centre: FloatArray) -> FloatArray:
    """Return the poses, (frames, 4, 4), whose `_coordinates` are given."""
    turns = Rotation.from_rotvec(-coordinates[:, :3]).as_matrix()
    target = (centre + coordinates[:, 3:])[..., None]
    return pose_matrices(turns, centre - (turns @ target)[..., 0])


def interpolation_precision(
    poses: FloatArray, measured: BoolArray, centre: FloatArray
) -> FloatArray:
    """Return the precision of interpolated poses, from how well measured ones are interpolated.

    A pose a and b frames from the measured ones on both sides is as uncertain as measured poses are
    when interpolated from those m frames before and after, m the next power of two of sqrt(a b): at
    constant acceleration the error is proportional to a b. At the ends of the take, it is as
    uncertain as poses held for as long.

    Parameters
    ----------
    poses : (frames, 4, 4) float array
    measured : (frames,) bool array
    centre : (3,) float array
        In or near the head, in its space [mm].

    Returns
    -------
    (frames, 6) float array
        Of rotation [1/rad^2] and shift [1/mm^2]; 0 where measured, and where no measured poses are
        that far apart.
    """
    known, frames = np.flatnonzero(measured), np.flatnonzero(~measured)
    at = np.searchsorted(known, frames)
    is_inside = (at > 0) & (at < len(known))
    before = abs(frames - known[np.maximum(at - 1, 0)])
    after = abs(known[np.minimum(at, len(known) - 1)] - frames)
    away = np.where(is_inside, np.sqrt(before * after), np.minimum(before, after))
    precision = np.zeros((len(measured), 6))
    for power in range(int(away.max(initial=0)).bit_length() + 1):
        reach = 2**power
        middle = known[(known >= reach) & (known < len(measured) - reach)]
        middle = middle[measured[middle - reach] & measured[middle + reach]]
        if not len(middle):
            break
        back = np.linalg.inv(poses[middle])
        ends = [_coordinates(back @ poses[middle + ahead], centre) for ahead in (-reach, reach)]
        of_reach = (away > reach / 2) & (away <= reach)
        for rows, errors in ((is_inside, np.mean(ends, axis=0)), (~is_inside, ends[0])):
            variance = np.maximum(np.mean(errors**2, axis=0), _LEAST_VARIANCE)
            precision[frames[of_reach & rows]] = 1 / variance
    return precision
