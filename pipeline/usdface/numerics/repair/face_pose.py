"""Head pose from markers of the face, whose expression is unknown: where rigid ones are missing.

The markers of a frame are a rigid transform of ``x ~ N(mean, S)``, with the low-rank model's
``S = C' V C + N``. The pose maximises the likelihood, with the expression marginalised:

    minimise r' inv(S) r,   r = R x + t - mean,

by Gauss-Newton steps from the alignment with the mean. With J the derivatives of r, a step is
``-inv(J' inv(S) J) J' inv(S) r``, and the inverse matrix is the covariance of the pose. Woodbury's
identity gives ``inv(S) = inv(N) - inv(N) C' inv(inv(V) + C inv(N) C') C inv(N)``. The noise of a
marker grows with its residual, so that swapped labels and outliers do not count (Cauchy weights).
The covariance is scaled by how far the frame exceeds the model: the median of the residuals over
the noise, or the mean square of the scores over their variances, if either is more than usual.

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
    align_frames,
    alignment_of,
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


def pose_by_face(
    model: LowRankModel, positions: RealArray, seen: BoolArray
) -> tuple[FloatArray, FloatArray]:
    """Return the poses of frames of unknown expression, and their variance.

    Parameters
    ----------
    positions : (frames, markers, 3) float array
        [mm] In any pose; anything finite where not seen.
    seen : (frames, markers) bool array
        Three or more in each frame.

    Returns
    -------
    poses : (frames, 4, 4) float array
        For column vectors: ``positions = pose @ x``, with x in the model's space.
    variance : (frames,) float array
        Mean square displacement of a marker by the error of the pose [mm^2].
    """
    poses, variance = np.empty((len(positions), 4, 4)), np.empty(len(positions))

    def solve(block: slice) -> None:
        poses[block], variance[block] = _solve(model, positions[block], seen[block])

    map_threads(solve, frame_blocks(len(positions), frames=_BLOCK_FRAMES))
    return poses, variance


def _solve(
    model: LowRankModel, positions: RealArray, seen: BoolArray
) -> tuple[FloatArray, FloatArray]:
    mean = model.mean.reshape(-1, 3)
    centre, precision = mean.mean(axis=0), seen / model.noise**2
    start = align_frames(positions, np.broadcast_to(mean, positions.shape), weights=seen)
    poses, still = start.matrices(), remove_motion(positions.astype(np.float64), start)
    for _ in range(_MOST_STEPS):
        derivatives = np.zeros((*still.shape, 6))
        derivatives[..., :3] = np.cross(np.eye(3), (still - centre)[..., None, :]).swapaxes(2, 3)
        derivatives[..., 3:] = np.eye(3)
        step, covariance, residual, scores = _step(model, derivatives, still - mean, precision)
        back = Rotation.from_rotvec(-step[:, :3]).as_matrix()
        turn = np.tile(np.eye(4), (len(step), 1, 1))
        turn[:, :3, :3], turn[:, :3, 3] = (
            back,
            centre - (back @ (centre + step[:, 3:])[..., None])[..., 0],
        )
        poses, still = poses @ turn, remove_motion(still, alignment_of(turn))
        chi = residual / model.noise
        precision = seen / (model.noise**2 * (1 + (chi / _INLIER_DEVIATIONS) ** 2))
        if abs(derivatives @ step[:, None, :, None]).max() < _SETTLED_MM:
            break
    moved = np.einsum("fmci,fij,fmcj->f", derivatives, covariance, derivatives, optimize=True)
    unexplained = np.nanmedian(np.where(seen, chi**2, np.nan), axis=1) / _MEDIAN_CHI_SQUARE
    unusual = np.mean(scores**2 / model.variances, axis=1)
    return poses, moved / seen.shape[1] * np.maximum(1.0, np.maximum(unexplained, unusual))


def _step(
    model: LowRankModel, derivatives: FloatArray, offset: FloatArray, precision: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Return the step in rotation and shift, its covariance, residuals [mm] and scores."""
    components = model.components.reshape(len(model.variances), -1, 3)
    grams = np.einsum("kmc,lmc->mkl", components, components)
    inner = np.einsum("fm,mkl->fkl", precision, grams, optimize=True)
    inner += np.diag(1 / model.variances)
    known = np.concatenate([derivatives, offset[..., None]], axis=3)
    weighed = precision[..., None, None] * known
    scores = np.linalg.solve(inner, np.einsum("kmc,fmci->fki", components, weighed, optimize=True))
    left = known - np.einsum("kmc,fki->fmci", components, scores, optimize=True)
    normal = np.einsum("fmci,fmcj->fij", weighed, left, optimize=True)
    covariance = np.linalg.inv(normal[:, :6, :6])
    step = -(covariance @ normal[:, :6, 6:])[..., 0]
    along = np.append(step, np.ones((len(step), 1)), axis=1)[..., None]
    residual = np.linalg.norm((left @ along[:, None])[..., 0], axis=2)
    return step, covariance, residual, (scores @ along)[..., 0]
