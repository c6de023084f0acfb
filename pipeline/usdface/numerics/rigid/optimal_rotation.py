"""The proper rotation nearest to each of many 3 x 3 matrices.

References
----------
Markley (1993), Attitude determination using vector observations: a fast optimal matrix algorithm,
Journal of the Astronautical Sciences 41(2), 261-280.
"""

import numpy as np
from numpy.typing import NDArray

_NEWTON_LIMIT = 30
_SETTLED = 1e-15
_SAFE_ZETA = 0.05
"""Below it the closed form divides by too little; those few matrices are decomposed."""


def optimal_rotations(
    matrices: NDArray[np.float64], *, rank_tolerance: float
) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Return the rotations R that maximise ``trace(R.T @ B)``, the same as U diag(1, 1, ±1) V^T.

    A batched decomposition takes most of the time of aligning a take. Markley's closed form needs
    the sum of B's singular values (the last with the determinant's sign), the largest root of a
    quartic that Newton's method reaches from above, and one division; it is ten times as fast
    and agrees to rounding. Matrices near rank one, where it would not, take the decomposition.

    Parameters
    ----------
    matrices : (n, 3, 3) float array
        ``sum of x y^T`` when R is to carry y onto x.
    rank_tolerance : float
        A rotation is determined when the second singular value plus the signed third exceeds this
        share of the first.

    Returns
    -------
    rotations : (n, 3, 3) float array
        Identity where not determined.
    determined : (n,) bool array
    """
    # Frames last: every operation then runs along memory, not over matrices of nine numbers.
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
        step = value / np.maximum(slope, _SETTLED)
        root -= step
        if np.abs(step).max(initial=0.0) < _SETTLED:
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


def _product(A: NDArray[np.float64], B: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return A B of (3, 3, n) matrices."""
    return A[:, :1] * B[:1] + A[:, 1:2] * B[1:2] + A[:, 2:] * B[2:]


def _gram(A: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return A.T A of (3, 3, n) matrices."""
    return _product(np.swapaxes(A, 0, 1), A)


def _decompose(
    B: NDArray[np.float64], rank_tolerance: float
) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    U, singular, Vt = np.linalg.svd(np.where(np.isfinite(B), B, 0.0))
    sign = np.sign(np.linalg.det(U) * np.linalg.det(Vt))
    U[:, :, 2] *= sign[:, None]
    margin = singular[:, 1] + sign * singular[:, 2]  # 0: another rotation fits as well
    determined = margin > rank_tolerance * singular[:, 0]
    return np.where(determined[:, None, None], U @ Vt, np.eye(3)), determined
