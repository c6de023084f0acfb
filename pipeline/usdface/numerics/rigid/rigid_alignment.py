"""Least-squares rigid alignment of a reference with each frame (Wahba's problem), in batches.

References
----------
Deng, Chiang, Fox and Neumann (2006), Animating Blendshape Faces by Cross-Mapping Motion Capture
Data, I3D, section 3, equations 1 and 2.
Umeyama (1991), Least-squares estimation of transformation parameters between two point patterns,
IEEE PAMI 13(4): the determinant.
Markley (1993), Attitude determination using vector observations: a fast optimal matrix algorithm,
Journal of the Astronautical Sciences 41(2), 261-280: `optimal_rotations`.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from usdface.core.arrays import BoolArray, FloatArray, RealArray, frame_blocks
from usdface.core.processes import map_threads

FEWEST_RIGID = 3
"""Points that determine a rotation."""

_CHUNK_FRAMES = 1024
"""The working arrays of 100 points fit in the cache."""
_RANK_TOLERANCE = 1e-3
"""Second over first singular value of the covariance: that of markers 3 % as broad as long, whose
rotation about their line is determined by noise."""
_IRLS_ROUNDS = 12
_IRLS_SETTLED = 1e-3
_INLIER_MEDIANS = 2.6
"""Residuals of Gaussian noise in three dimensions stay below 2.6 medians in 999 of 1000 samples."""
_LEAST_SCALE = 1e-6
"""[mm] Scale of the residuals of exact data, which are rounding."""
_NEWTON_LIMIT = 30
_NEWTON_SETTLED = 1e-15
_SAFE_ZETA = 0.05
"""Below it the closed form is inaccurate, and the SVD is used."""


@dataclass(frozen=True)
class RigidAlignment:
    """One rigid transform per frame: ``captured = rotation @ reference + translation``."""

    rotations: FloatArray
    """(frames, 3, 3): proper rotations; identity where not `determined`."""
    translations: FloatArray
    """(frames, 3)"""
    determined: BoolArray
    """(frames,): False where fewer than three points are visible, or all are collinear."""
    weights: FloatArray
    """(frames, points): final weights; 0 where not visible."""

    def matrices(self) -> FloatArray:
        """Return (frames, 4, 4) transforms for column vectors."""
        return pose_matrices(self.rotations, self.translations)


def pose_matrices(rotations: FloatArray, translations: FloatArray) -> FloatArray:
    """Return (..., 4, 4) transforms for column vectors: a rotation, then a translation."""
    matrices = np.tile(np.eye(4), (*rotations.shape[:-2], 1, 1))
    matrices[..., :3, :3] = rotations
    matrices[..., :3, 3] = translations
    return matrices


def align_rigid(
    positions: ArrayLike, reference: ArrayLike, *, weights: ArrayLike | None = None
) -> RigidAlignment:
    """Align a reference, or a target per frame, to every frame by weighted least squares.

    The centroids of a frame and of the reference are of the same points with the same weights.

    Parameters
    ----------
    positions : (frames, points, 3) array_like
        Arbitrary, also not finite, where the weight is 0.
    reference : (points, 3) or (frames, points, 3) array_like
    weights : (frames, points) array_like, optional
        Not negative, or bool. All 1 by default.
    """
    points = np.asarray(positions)
    goals = np.broadcast_to(reference, points.shape)
    w = np.broadcast_to(1.0, points.shape[:2]) if weights is None else np.array(weights, np.float64)
    count = len(points)
    rotations, translations = np.empty((count, 3, 3)), np.empty((count, 3))
    determined = np.empty(count, bool)
    for rows in frame_blocks(count, frames=_CHUNK_FRAMES):
        unused = w[rows] <= 0
        share = w[rows] / np.maximum(w[rows].sum(axis=1), np.finfo(np.float64).tiny)[:, None]
        x, y = points[rows].astype(np.float64), np.ones((*share.shape, 4))
        if unused.any():
            x[unused] = 0.0  # arbitrary, perhaps NaN
        x *= share[..., None]
        y[..., :3] = goals[rows]
        moments, y_center = np.swapaxes(x, 1, 2) @ y, (share[:, None] @ y)[:, 0, :3]
        x_center = moments[:, :, 3]
        covariance = moments[:, :, :3] - x_center[:, :, None] * y_center[:, None]
        # D06 equations 1 and 2: y^T x = U D V^T, R = V U^T, with determinant +1
        R, known = optimal_rotations(covariance, rank_tolerance=_RANK_TOLERANCE)
        known &= points.shape[1] - unused.sum(axis=1) >= FEWEST_RIGID
        R[~known] = np.eye(3)
        rotations[rows], determined[rows] = R, known
        translations[rows] = x_center - np.einsum("fij,fj->fi", R, y_center)
    return RigidAlignment(rotations, translations, determined, w)


def align_rigid_robust(
    positions: ArrayLike, reference: ArrayLike, *, visible: ArrayLike
) -> RigidAlignment:
    """Align a reference (points, 3) to every frame, robust to swapped points and outliers.

    Iteratively reweighted least squares with Geman-McClure weights. Their scale is the median
    residual of the frame, at least that of the take, so that a swap, which distorts the first
    solution, remains an outlier.
    """
    points, y = np.asarray(positions), np.asarray(reference, np.float64)
    seen = np.asarray(visible, bool)
    first = align_rigid(points, y, weights=seen)
    rotations, translations = first.rotations.copy(), first.translations.copy()
    determined, weights = first.determined.copy(), first.weights
    residuals = alignment_residuals(points, y, first)
    chosen = residuals[seen]
    take_scale = max(float(np.median(chosen)) if chosen.size else 0.0, _LEAST_SCALE)

    def reweigh(block: slice) -> None:
        active = np.flatnonzero(determined[block]) + block.start
        for _ in range(_IRLS_ROUNDS):
            if not active.size:
                break
            # The lower median of each frame's visible values, of which there must be one.
            mask = seen[active]
            ordered = np.sort(np.where(mask, residuals[active], np.inf), axis=1)
            middle = (mask.sum(axis=1) - 1) // 2
            frame_scale = ordered[np.arange(len(ordered)), middle]
            scale = _INLIER_MEDIANS * np.maximum(frame_scale, take_scale)[:, None]
            fresh = seen[active] / (1.0 + (residuals[active] / scale) ** 2) ** 2
            moved = np.abs(fresh - weights[active]).max(axis=1) > _IRLS_SETTLED
            weights[active] = fresh
            active = active[moved]
            again = align_rigid(points[active], y, weights=weights[active])
            rotations[active], translations[active] = again.rotations, again.translations
            determined[active] = again.determined
            residuals[active] = alignment_residuals(points[active], y, again)
            active = active[again.determined]

    map_threads(reweigh, frame_blocks(len(points)))
    return RigidAlignment(rotations, translations, determined, weights)


def alignment_of(matrices: ArrayLike) -> RigidAlignment:
    """Return (frames, 4, 4) transforms for column vectors as an alignment, fully determined."""
    motion = np.asarray(matrices, np.float64)
    known = np.ones(len(motion), bool)
    return RigidAlignment(motion[:, :3, :3], motion[:, :3, 3], known, np.ones((len(motion), 0)))


def rigid_displacements(points: FloatArray) -> FloatArray:
    """Return displacements by 1 rad about and by 1 mm along each axis: (6, points, 3) [mm].

    Linearised, about the centre of `points`, (points, 3) [mm].
    """
    turns = np.cross(np.eye(3)[:, None], points - points.mean(axis=0))
    return np.concatenate([turns, np.broadcast_to(np.eye(3)[:, None], turns.shape)])


def remove_motion(
    positions: ArrayLike, alignment: RigidAlignment, *, out: RealArray | None = None
) -> RealArray:
    """Transform captured positions to the space of the reference.

    Returns (frames, any, 3), in single precision if `positions` are.

    Parameters
    ----------
    positions : (frames, any, 3) array_like
    out : (frames, any, 3) float array, optional
        Where to store the result, which may be `positions`. On long takes, allocation takes longer
        than the arithmetic.
    """
    points = np.asarray(positions)
    kind = np.result_type(points.dtype, np.float32)
    still = np.empty(points.shape, kind) if out is None else out
    rotations = alignment.rotations.astype(kind)
    for rows in frame_blocks(len(points), frames=_CHUNK_FRAMES):
        # Subtract in double precision: metres from the origin, single precision loses microns.
        centred = (points[rows] - alignment.translations[rows, None]).astype(kind, copy=False)
        # Row vectors times R are R.T times column vectors; one dtype is six times as fast as two.
        np.matmul(centred, rotations[rows], out=still[rows])
    return still


def alignment_residuals(
    positions: ArrayLike, reference: ArrayLike, alignment: RigidAlignment
) -> FloatArray:
    """Return the distance of each point from the aligned reference, (frames, points)."""
    with np.errstate(invalid="ignore", over="ignore"):
        offsets = remove_motion(positions, alignment) - np.asarray(reference, np.float64)
        return np.nan_to_num(np.linalg.norm(offsets, axis=2), nan=np.inf)


def optimal_rotations(
    matrices: FloatArray, *, rank_tolerance: float
) -> tuple[FloatArray, BoolArray]:
    """Return the rotations R that maximise ``trace(R.T @ B)``, which are U diag(1, 1, ±1) V^T.

    By Markley's closed form, in a quarter of the time of an SVD and equal to rounding. It needs the
    sum of the singular values of B (the last with the determinant's sign): the largest root of a
    quartic, by Newton's method from above. Matrices near rank one are decomposed by SVD.

    Parameters
    ----------
    matrices : (n, 3, 3) float array
        ``sum of x y^T`` when R is to carry y onto x.
    rank_tolerance : float
        A rotation is determined if the second singular value plus the signed third exceeds this
        share of the first.

    Returns
    -------
    rotations : (n, 3, 3) float array
        Identity where not determined.
    determined : (n,) bool array
    """
    # Frames last, so that operations run over contiguous memory.
    B = np.ascontiguousarray(np.moveaxis(matrices, 0, -1))
    size = np.sqrt((B * B).sum(axis=(0, 1)))
    B /= np.maximum(size, np.finfo(np.float64).tiny)
    above, below = B[[1, 2, 0]], B[[2, 0, 1]]
    cofactors = (
        above[:, [1, 2, 0]] * below[:, [2, 0, 1]] - above[:, [2, 0, 1]] * below[:, [1, 2, 0]]
    )
    determinant = (B[0] * cofactors[0]).sum(axis=0)
    cofactor_norm2 = (cofactors * cofactors).sum(axis=(0, 1))
    # (λ² - |B|²)² - 8 λ det B - 4 |cof B|² = 0, |B| = 1; convex from the largest root upwards
    root = np.full(len(matrices), np.sqrt(3.0))
    for _ in range(_NEWTON_LIMIT):
        excess = root * root - 1.0
        value = excess * excess - 8.0 * root * determinant - 4.0 * cofactor_norm2
        slope = 4.0 * root * excess - 8.0 * determinant
        step = value / np.maximum(slope, _NEWTON_SETTLED)
        root -= step
        if np.abs(step).max(initial=0.0) < _NEWTON_SETTLED:
            break
    kappa = 0.5 * (root * root - 1.0)
    zeta = kappa * root - determinant
    safe = (zeta > _SAFE_ZETA) & (size > 0)
    turned = (kappa + 1.0) * B + root * cofactors - _product(B, _gram(B))
    turned /= np.where(safe, zeta, 1.0)
    turned = 1.5 * turned - 0.5 * _product(turned, _gram(turned))  # orthogonal to rounding
    R = np.ascontiguousarray(np.moveaxis(turned, -1, 0))
    determined = safe.copy()
    rest = np.flatnonzero(~safe)
    R[rest], determined[rest] = _decompose(np.moveaxis(B[:, :, rest], -1, 0), rank_tolerance)
    return R, determined


def _product(A: FloatArray, B: FloatArray) -> FloatArray:
    """Return A B of (3, 3, n) matrices."""
    return A[:, :1] * B[:1] + A[:, 1:2] * B[1:2] + A[:, 2:] * B[2:]


def _gram(A: FloatArray) -> FloatArray:
    """Return A.T A of (3, 3, n) matrices."""
    return _product(np.swapaxes(A, 0, 1), A)


def _decompose(B: FloatArray, rank_tolerance: float) -> tuple[FloatArray, BoolArray]:
    U, singular, Vt = np.linalg.svd(np.where(np.isfinite(B), B, 0.0))
    sign = np.sign(np.linalg.det(U) * np.linalg.det(Vt))
    U[:, :, 2] *= sign[:, None]
    margin = singular[:, 1] + sign * singular[:, 2]  # 0: the rotation is not unique
    determined = margin > rank_tolerance * singular[:, 0]
    return np.where(determined[:, None, None], U @ Vt, np.eye(3)), determined


def is_mirror_image(cloud: FloatArray, targets: FloatArray) -> bool:
    """Whether points (n, 3) fit their targets only if they are reflected.

    By similarities, whose squared error is less than a quarter of that without the reflection.
    """
    yc, xc = cloud - cloud.mean(axis=0), targets - targets.mean(axis=0)
    cross = xc.T @ yc
    s, sign = np.linalg.svd(cross, compute_uv=False), float(np.sign(np.linalg.det(cross)))
    proper = s @ np.array([1, 1, sign])
    total = float((xc**2).sum() * (yc**2).sum())
    if not total:
        return False
    error, mirrored = 1 - proper**2 / total, 1 - s.sum() ** 2 / total
    return bool(sign < 0 and error > 0.01 and mirrored < 0.25 * error)
