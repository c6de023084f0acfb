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
    size = np.sqrt(np.einsum("nij,nij->n", matrices, matrices))
    B = matrices / np.maximum(size, np.finfo(np.float64).tiny)[:, None, None]
    cofactors = np.stack(
        [np.cross(B[:, 1], B[:, 2]), np.cross(B[:, 2], B[:, 0]), np.cross(B[:, 0], B[:, 1])], axis=1
    )
    determinant = np.einsum("ni,ni->n", B[:, 0], cofactors[:, 0])
    cofactor_norm2 = np.einsum("nij,nij->n", cofactors, cofactors)
    # (λ² - |B|²)² - 8 λ det B - 4 |cof B|² = 0, |B| = 1; convex from the largest root upwards
    root = np.full(len(B), np.sqrt(3.0))
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
    BtB = np.swapaxes(B, 1, 2) @ B
    R = (kappa + 1.0)[:, None, None] * B + root[:, None, None] * cofactors - B @ BtB
    R /= np.where(safe, zeta, 1.0)[:, None, None]
    R = R @ (1.5 * np.eye(3) - 0.5 * (np.swapaxes(R, 1, 2) @ R))  # orthogonal to rounding
    determined = safe.copy()
    rest = np.flatnonzero(~safe)
    R[rest], determined[rest] = _decompose(B[rest], rank_tolerance)
    return R, determined


def _decompose(
    B: NDArray[np.float64], rank_tolerance: float
) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    U, singular, Vt = np.linalg.svd(np.where(np.isfinite(B), B, 0.0))
    sign = np.sign(np.linalg.det(U) * np.linalg.det(Vt))
    U[:, :, 2] *= sign[:, None]
    margin = singular[:, 1] + sign * singular[:, 2]  # 0: another rotation fits as well
    determined = margin > rank_tolerance * singular[:, 0]
    return np.where(determined[:, None, None], U @ Vt, np.eye(3)), determined
