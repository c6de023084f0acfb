"""Solve the blendshape equation: which weights move the virtual markers as the performer's moved.

Deng et al. 2006, section 7, equation 7: ``B = B0 + sum_i w_i B_i`` at the virtual markers, with the
performer's motion scaled by the proportions of the two faces. Plain least squares is the baseline
of the paper's comparison; solved within the rig's ranges it is a starting pose for an animator.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from usdface.core.arrays import FloatArray, IntArray
from usdface.numerics.solve.bounded_least_squares import minimise_bounded_quadratic
from usdface.numerics.solve.bounded_smoothing import minimise_bounded_smooth

_Method = Literal["lstsq", "nnls", "bounded"]

_RELINEARISATIONS = 8
_SMALL_STEP = 1e-6
_FILLS = 5
_DEPENDENT_RIDGE = 0.01  # of a shape's mean energy: settles which of many solutions is meant


@dataclass(frozen=True)
class _Solve:
    """Weights that explain a marker motion.

    Attributes
    ----------
    weights : (frames, shapes) float array
    residual_mm : (frames, markers) float array
        Distance between each marker and where the weights put it; NaN where it was not seen.
    rank : int
        Of the equation, all trusted markers seen. Below the number of shapes, several weights
        explain the same motion: least squares returns the smallest; the bounded methods then keep
        at least a small ridge.
    """

    weights: FloatArray
    residual_mm: FloatArray
    rank: int


@dataclass(frozen=True)
class MarkerKeys:
    """Shapes that bend: in-betweens at the virtual markers.

    Attributes
    ----------
    deltas : (keys, markers, 3) float array
        What each key, full targets included, does to the markers [mm].
    channels : (keys,) int array
        The shape each key belongs to.
    key_weights : callable
        (frames, shapes) weights of shapes to (frames, keys) weights of keys, linear in pieces.
    """

    deltas: FloatArray
    channels: IntArray
    key_weights: Callable[[FloatArray], FloatArray]


def solve_weights(
    deltas: ArrayLike,
    motion: ArrayLike,
    *,
    method: _Method = "lstsq",
    ranges: ArrayLike | None = None,
    visible: ArrayLike | None = None,
    marker_trust: ArrayLike | None = None,
    prior: ArrayLike | None = None,
    ridge: float = 0.0,
    l1: float = 0.0,
    smoothness: float = 0.0,
    keys: MarkerKeys | None = None,
) -> _Solve:
    """Solve the blendshape equation for every frame.

    Minimises ``sum_m trust_m |motion_m - sum_i w_i delta_im|^2 + ridge |w - prior|^2 + 2 l1 |w|_1
    + smoothness |second difference of w over time|^2``, all in mm^2.

    Parameters
    ----------
    deltas : (shapes, markers, 3) array
        What each shape at 1 does to the virtual markers [mm].
    motion : (frames, markers, 3) array
        Displacements from the neutral face, in the character's space and proportions [mm].
    method : {'lstsq', 'nnls', 'bounded'}, optional
        Plain least squares as in the paper; not negative; within `ranges`.
    ranges : (shapes, 2) array, optional
        Lowest and highest weights for ``'bounded'``; 0 to 1 unless given.
    visible : (frames, markers) bool array, optional
        False where a marker was not seen: it is left out of that frame's equation.
    marker_trust : (markers,) array, optional
        Weight of each marker in the sum, not negative; 1 unless given.
    prior : (frames, shapes) or (shapes,) array, optional
        What `ridge` pulls towards; 0 unless given.
    ridge, l1 : float, optional
        Penalties [mm^2].
    smoothness : float, optional
        Penalty over time [mm^2]; not for ``'lstsq'``.
    keys : MarkerKeys, optional
        In-betweens: the equation is linearised again about each solution.

    Raises
    ------
    ValueError
        If arrays do not fit together, or an option does not go with the method.
    """
    problem = _checked(deltas, motion, visible, marker_trust)
    lower, upper = _bounds(method, ranges, problem.shape_count)
    if method == "lstsq" and (l1 or smoothness or keys is not None):
        raise ValueError("l1, smoothness and keys need method 'bounded' or 'nnls'")
    if not min(ridge, l1, smoothness) >= 0:
        raise ValueError("ridge, l1 and smoothness must not be negative")
    heard = problem.deltas[:, problem.share > 0].reshape(problem.shape_count, -1)
    rank = int(np.linalg.matrix_rank(heard)) if heard.size else 0
    if method != "lstsq" and rank < problem.shape_count:
        energy = float(np.einsum("smc,m,smc->", problem.deltas, problem.share, problem.deltas))
        ridge = max(ridge, _DEPENDENT_RIDGE * energy / problem.shape_count)
    pull = np.zeros((problem.frame_count, problem.shape_count))
    if prior is not None:
        pull = pull + np.asarray(prior, float)

    def solve(rows: IntArray, D: FloatArray, target: FloatArray) -> FloatArray:
        """Solve frames that share one matrix."""
        root = np.sqrt(problem.trust[rows[0]])[:, None]
        A = (D * root).reshape(len(D), -1)
        b = (target * root).reshape(len(rows), -1)
        if method == "lstsq" and ridge == 0:
            return np.asarray(np.linalg.lstsq(A.T, b.T)[0]).T
        hessian = A @ A.T + ridge * np.eye(len(D))
        linear = b @ A.T + ridge * pull[rows]
        if method == "lstsq":
            return np.asarray(np.linalg.solve(hessian, linear.T)).T
        return minimise_bounded_quadratic(hessian, linear, lower=lower, upper=upper, l1=l1).x

    weights = np.zeros_like(pull)
    for rows in _alike(problem.trust):
        weights[rows] = solve(rows, problem.deltas, problem.motion[rows])
    if keys is not None:
        weights = _relinearise(problem, keys, weights, solve)
    if smoothness > 0:
        hessian = _gram(problem.deltas, problem.share) + ridge * np.eye(problem.shape_count)
        for _ in range(_FILLS if keys is not None or (problem.trust != problem.share).any() else 1):
            # unseen markers, and what in-betweens add, are taken from the solution so far
            moved = _predict(problem.deltas, keys, weights)
            seen = problem.trust / np.maximum(problem.share, 1e-300)
            target = np.einsum("fs,smc->fmc", weights, problem.deltas)
            target += seen[:, :, None] * (problem.motion - moved)
            linear = np.einsum("fmc,m,smc->fs", target, problem.share, problem.deltas)
            weights = minimise_bounded_smooth(
                hessian,
                linear + ridge * pull,
                lower=lower,
                upper=upper,
                l1=l1,
                smoothness=smoothness,
                start=weights,
            )
    residual = np.linalg.norm(problem.motion - _predict(problem.deltas, keys, weights), axis=2)
    residual[~problem.visible] = np.nan
    return _Solve(weights, residual, rank)


def _relinearise(
    problem: "_Problem",
    keys: MarkerKeys,
    weights: FloatArray,
    solve: Callable[[IntArray, FloatArray, FloatArray], FloatArray],
) -> FloatArray:
    """Solve again with each shape's slope at the last solution, keeping what fits better."""
    channels = np.asarray(keys.channels, np.int64)
    member = np.zeros((len(channels), problem.shape_count))
    member[np.arange(len(channels)), channels] = 1
    best = weights.copy()
    error = _error(problem, keys, weights)
    for _ in range(_RELINEARISATIONS):
        here = keys.key_weights(weights)
        # a forward difference is exact: keys are linear in pieces and belong to one shape each
        slopes = (keys.key_weights(weights + _SMALL_STEP) - here) / _SMALL_STEP
        offset = here - slopes * weights[:, channels]
        following = np.empty_like(weights)
        for rows in _alike(np.column_stack([problem.trust, slopes.round(4)])):
            D = np.einsum("ks,k,kmc->smc", member, slopes[rows[0]], keys.deltas)
            fixed = np.einsum("fk,kmc->fmc", offset[rows], keys.deltas)
            following[rows] = solve(rows, D, problem.motion[rows] - fixed)
        weights = following
        after = _error(problem, keys, weights)
        better = after < error
        best[better], error = weights[better], np.minimum(error, after)
        if not better.any():
            break
    return best


def _predict(deltas: FloatArray, keys: MarkerKeys | None, weights: FloatArray) -> FloatArray:
    if keys is None:
        return np.asarray(np.einsum("fs,smc->fmc", weights, deltas, optimize=True))
    return np.asarray(
        np.einsum("fk,kmc->fmc", keys.key_weights(weights), keys.deltas, optimize=True)
    )


def _error(problem: "_Problem", keys: MarkerKeys, weights: FloatArray) -> FloatArray:
    off = ((problem.motion - _predict(problem.deltas, keys, weights)) ** 2).sum(axis=2)
    return np.asarray((off * problem.trust).sum(axis=1))


def _gram(deltas: FloatArray, trust: FloatArray) -> FloatArray:
    A = (deltas * np.sqrt(trust)[:, None]).reshape(len(deltas), -1)
    return np.asarray(A @ A.T)


def _alike(rows: FloatArray) -> list[IntArray]:
    """Group equal rows: frames that share one matrix."""
    if not len(rows):
        return []
    if (rows == rows[0]).all():
        return [np.arange(len(rows))]
    _, group = np.unique(rows, axis=0, return_inverse=True)
    order = np.argsort(group.ravel(), kind="stable")
    return np.split(order, np.flatnonzero(np.diff(group.ravel()[order])) + 1)


@dataclass(frozen=True)
class _Problem:
    deltas: FloatArray
    motion: FloatArray
    visible: NDArray[np.bool_]
    share: FloatArray
    """Trust of each marker when seen."""
    trust: FloatArray
    """(frames, markers): 0 where a marker is not seen."""

    @property
    def frame_count(self) -> int:
        return len(self.motion)

    @property
    def shape_count(self) -> int:
        return len(self.deltas)


def _checked(
    deltas: ArrayLike, motion: ArrayLike, visible: ArrayLike | None, trust: ArrayLike | None
) -> _Problem:
    D, m = np.asarray(deltas, float), np.asarray(motion, float)
    if D.ndim != 3 or m.ndim != 3 or D.shape[1:] != m.shape[1:] or D.shape[2] != 3:
        raise ValueError(
            f"deltas (shapes, markers, 3) and motion (frames, markers, 3) must share markers; "
            f"got {D.shape} and {m.shape}"
        )
    seen = np.ones(m.shape[:2], bool) if visible is None else np.asarray(visible, bool)
    share = np.ones(m.shape[1]) if trust is None else np.asarray(trust, float)
    if seen.shape != m.shape[:2] or share.shape != m.shape[1:2] or not (share >= 0).all():
        raise ValueError(
            f"visible must be {m.shape[:2]}, got {seen.shape}; marker_trust must be "
            f"{m.shape[1:2]} and not negative, got {share.shape}"
        )
    m = np.where(seen[:, :, None], m, 0.0)
    if not np.isfinite(m).all():
        frame = int(np.flatnonzero(~np.isfinite(m).all(axis=(1, 2)))[0])
        raise ValueError(f"motion is not finite at index {frame}; mark unseen markers in visible")
    return _Problem(D, m, seen, share, seen * share)


def _bounds(
    method: _Method, ranges: ArrayLike | None, shapes: int
) -> tuple[FloatArray, FloatArray]:
    if method == "bounded":
        limits = np.asarray([[0.0, 1.0]] * shapes if ranges is None else ranges, float)
        if limits.shape != (shapes, 2):
            raise ValueError(f"ranges must be ({shapes}, 2), got {limits.shape}")
        return limits[:, 0], limits[:, 1]
    if method not in ("lstsq", "nnls"):
        raise ValueError(f"method must be 'lstsq', 'nnls' or 'bounded', got {method!r}")
    return np.full(shapes, 0.0 if method == "nnls" else -np.inf), np.full(shapes, np.inf)
