"""Gaussian radial basis functions with weight decay: Deng et al. (2006), eq. 4-6.

One singular value decomposition of the design matrix H gives the generalised cross-validation
score of every output at every ridge. Weight decay, ``(H'H + rI)^-1 H'W``, differs from kernel
ridge, ``(K + rI)^-1 W``, in the amount of smoothing for the same ridge.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from usdface.core.arrays import FloatArray, first_smallest, frame_blocks
from usdface.numerics.regression.linear_ridge import check_examples

BLOCK_ROWS = 4096
RIDGES_PER_DECADE = 8
FREEDOM_LIMIT = 0.8
"""Largest effective degrees of freedom over the number of pairs. GCV of wide Gaussians has several
minima, and the lowest may be at ridge 0: an interpolation that oscillates between the pairs."""


@dataclass(frozen=True)
class RBFRidge:
    """Fitted: ``F(x) = sum_k coefficients[k] exp(-|x - centres[k]|^2 / 2 widths[k]^2)``."""

    centres: FloatArray
    """(n, d)"""
    widths: FloatArray
    """(n,): in the unit of the centres."""
    coefficients: FloatArray
    """(n, s)"""
    ridge: FloatArray
    freedom: FloatArray
    score: FloatArray
    """`ridge`, `freedom`, `score`: (s,): of each output: ridge, effective degrees of freedom, and
    GCV score."""


@dataclass(frozen=True)
class Rotated:
    """The design matrix and the outputs in the basis of the design's singular vectors."""

    left: FloatArray
    singular: FloatArray
    right: FloatArray
    outputs: FloatArray
    unreached: FloatArray


def shared_widths(centres: FloatArray, *, multiple: float = 8.0) -> FloatArray:
    """Return one width for all centres: a multiple of the median nearest-neighbour distance."""
    _, median = _nearest_distances(centres)
    return np.full(len(centres), multiple * median)


def centre_widths(centres: FloatArray, *, multiple: float = 2.0) -> FloatArray:
    """Return a width for each centre: a multiple of the distance to its nearest neighbour.

    The median width for coinciding centres.
    """
    nearest, median = _nearest_distances(centres)
    return multiple * np.where(nearest > 0, nearest, median)


def _nearest_distances(points: FloatArray) -> tuple[FloatArray, float]:
    """Return the distance of each point to its nearest other point, and the median above 0."""
    if len(points) < 2:
        raise ValueError(f"nearest distances need at least 2 points, got {len(points)}")
    from scipy.spatial.distance import cdist  # imported late: it takes half a second

    distances = cdist(points, points)
    np.fill_diagonal(distances, np.inf)
    nearest = np.asarray(distances.min(axis=1))
    if not nearest.any():
        raise ValueError("all centres coincide; no width fits them")
    return nearest, float(np.median(nearest[nearest > 0]))


def gaussian_design(points: FloatArray, centres: FloatArray, widths: FloatArray) -> FloatArray:
    """Evaluate every basis function at every point: one matrix product, then exp in place.

    Returns (points, centres), in (0, 1].
    """
    scale = -0.5 / widths**2
    design = points @ (-2.0 * centres.T)
    design += np.einsum("ij,ij->i", points, points)[:, None]
    design += np.einsum("ij,ij->i", centres, centres)
    np.maximum(design, 0.0, out=design)  # rounding may make a squared distance negative
    design *= scale
    np.exp(design, out=design)
    return design


def rotate(design: FloatArray, outputs: FloatArray) -> Rotated:
    """Decompose the design, for sums over its singular values."""
    left, singular, right = np.linalg.svd(design, full_matrices=False)
    rotated = left.T @ outputs
    unreached = np.maximum((outputs**2).sum(axis=0) - (rotated**2).sum(axis=0), 0.0)
    return Rotated(left, singular, right, rotated, unreached)


def effective_freedom(singular: FloatArray, ridges: FloatArray) -> FloatArray:
    """Return the trace of the hat matrix at each ridge."""
    squared = singular**2
    return np.asarray((squared / (squared + ridges[..., None])).sum(axis=-1))


def gcv_scores(rotated: Rotated, ridges: FloatArray) -> FloatArray:
    """Score ridges (r,) by generalised cross-validation; lower is better.

    Returns (r, s), ``n |(I - A) y|^2 / tr(I - A)^2`` for every ridge and output.

    References
    ----------
    Golub, Heath and Wahba (1979), Technometrics 21(2), 215-223.
    """
    count = len(rotated.left)
    shrinkage = ridges[:, None] / (rotated.singular**2 + ridges[:, None])  # eigenvalues of I - A
    residual = shrinkage**2 @ rotated.outputs**2 + rotated.unreached
    trace = count - effective_freedom(rotated.singular, ridges)
    return np.asarray(count * residual / np.maximum(trace, 1e-300)[:, None] ** 2)


def smallest_ridge(singular: FloatArray, *, freedom: float) -> float:
    """Return the ridge with given effective degrees of freedom, by bisection."""
    low, high = 1e-18, 1e6
    if effective_freedom(singular, np.array([low * singular[0] ** 2]))[0] <= freedom:
        return low * float(singular[0]) ** 2
    for _ in range(80):
        middle = np.sqrt(low * high)
        used = effective_freedom(singular, np.array([middle * singular[0] ** 2]))[0]
        low, high = (middle, high) if used > freedom else (low, middle)
    return float(high * singular[0] ** 2)


def choose_ridge(rotated: Rotated) -> FloatArray:
    """Choose each output's ridge, (s,), by the lowest GCV score on a grid, then on a finer one."""
    floor = smallest_ridge(rotated.singular, freedom=FREEDOM_LIMIT * len(rotated.left))
    top = max(1e3 * float(rotated.singular[0]) ** 2, 10 * floor)
    decades = np.log10(top / floor)
    grid = floor * 10 ** np.linspace(0, decades, int(decades * RIDGES_PER_DECADE) + 2)
    best = grid[first_smallest(gcv_scores(rotated, grid))]
    fine = 10 ** np.linspace(-1 / RIDGES_PER_DECADE, 1 / RIDGES_PER_DECADE, 17)
    chosen: FloatArray = np.empty_like(best)
    for ridge in np.unique(best):
        outputs = best == ridge
        near = np.maximum(ridge * fine, floor)
        same_ridge = replace(
            rotated, outputs=rotated.outputs[:, outputs], unreached=rotated.unreached[outputs]
        )
        chosen[outputs] = near[first_smallest(gcv_scores(same_ridge, near))]
    return chosen


def reestimate_ridge(
    rotated: Rotated, *, start: float, tolerance: float = 1e-6, max_iterations: int = 500
) -> FloatArray:
    """Return the ridge by the paper's re-estimation, which solves dGCV/dridge = 0: (s,).

    For comparison. If GCV has several minima, the result depends on the start, unlike that of
    `choose_ridge`.

    Parameters
    ----------
    start : float
        First ridge, as a share of the largest squared singular value.
    tolerance : float
        Stop an output when its GCV score changes by less than this share.

    References
    ----------
    Deng et al. (2006), section 6; Orr (1996), *Introduction to Radial Basis Function Networks*,
    section 6.4.
    """
    squared = rotated.singular[:, None] ** 2
    largest = float(squared[0, 0])
    count = len(rotated.left)
    ridge: FloatArray = np.full(rotated.outputs.shape[1], start * largest)
    score = np.full(len(ridge), np.inf)
    for _ in range(max_iterations):
        damped = squared + ridge
        error = ((ridge / damped * rotated.outputs) ** 2).sum(axis=0) + rotated.unreached
        trace = count - (squared / damped).sum(axis=0)
        update = count * error / trace**2
        moving = np.abs(score - update) > tolerance * update
        if not moving.any():
            break
        score = update
        shape = (squared / damped**2).sum(axis=0)
        size = (squared * rotated.outputs**2 / damped**3).sum(axis=0)
        ratio = error * shape / np.maximum(size * trace, 1e-300)
        ridge = np.where(moving, np.clip(ratio, 1e-16 * largest, 1e6 * largest), ridge)
    return ridge


def fit_rbf_ridge(
    centres: FloatArray,
    outputs: FloatArray,
    *,
    widths: FloatArray,
    ridge: FloatArray | float | None = None,
) -> RBFRidge:
    """Fit the network of eq. 4 by minimising eq. 5 through eq. 6, all outputs at once.

    Parameters
    ----------
    centres : (n, d) float array
        Coordinates of the pairs; each is a centre.
    outputs : (n, s) float array
        BlendShape weights of the pairs.
    widths : (n,) float array
        See `shared_widths` and `centre_widths`.
    ridge : float or (s,) float array, optional
        Penalty of squared coefficients; by default by `choose_ridge`.
    """
    check_examples(centres, outputs)
    rotated = rotate(gaussian_design(centres, centres, widths), outputs)
    if ridge is None:
        chosen = choose_ridge(rotated)
    else:
        chosen = np.broadcast_to(np.asarray(ridge, dtype=float), (outputs.shape[1],)).copy()
    gain = rotated.singular[:, None] / (rotated.singular[:, None] ** 2 + chosen)
    unique, index = np.unique(chosen, return_inverse=True)
    scores = gcv_scores(rotated, unique)[index, np.arange(len(chosen))]
    return RBFRidge(
        centres=centres,
        widths=widths,
        coefficients=rotated.right.T @ (gain * rotated.outputs),
        ridge=chosen,
        freedom=effective_freedom(rotated.singular, chosen),
        score=scores,
    )


def predict_rbf_ridge(
    points: FloatArray, centres: FloatArray, widths: FloatArray, coefficients: FloatArray
) -> FloatArray:
    """Evaluate the network (eq. 4) at points (f, d); see `evaluate_network`."""
    return evaluate_network(
        lambda some: gaussian_design(some, centres, widths), coefficients, points
    )


def evaluate_network(
    design: Callable[[FloatArray], FloatArray], coefficients: FloatArray, points: FloatArray
) -> FloatArray:
    """Evaluate a network of any basis functions, (f, s), in blocks.

    Parameters
    ----------
    design : callable
        Maps points (m, d) to values of the basis functions (m, n).
    coefficients : (n, s) float array
    points : (f, d) float array
    """
    out = np.empty((len(points), coefficients.shape[1]))
    for part in frame_blocks(len(points), frames=BLOCK_ROWS):
        np.matmul(design(points[part]), coefficients, out=out[part])
    return out
