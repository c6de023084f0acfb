"""Solve the blendshape equation: which weights move the virtual markers as the performer's moved.

Deng et al. 2006, section 7, equation 7: ``B = B0 + sum_i w_i B_i`` at the virtual markers, with the
performer's motion scaled by the proportions of the two faces. Plain least squares is the baseline
of the paper's comparison; solved within the rig's ranges it is a starting pose for an animator.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from usdface.core.arrays import BoolArray, FloatArray, IntArray
from usdface.numerics.solve.bounded_least_squares import minimise_bounded_quadratic

_Method = Literal["lstsq", "bounded"]

_MOST_RELINEARISATIONS = 8
_SMALL_STEP = 1e-6
"""Of a weight, for forward differences: exact, as in-betweens are linear in pieces."""
_DEPENDENT_RIDGE = 0.01
"""[of a shape's mean energy] Chooses a small one of many solutions where shapes are dependent."""


@dataclass(frozen=True)
class EquationSolution:
    """Weights that explain a marker motion.

    Attributes
    ----------
    weights : (frames, shapes) float array
    residual_mm : (frames, markers) float array
        Distance between each marker and where the weights put it; NaN where it was not seen.
    rank : int
        Of the equation, all trusted markers seen. Below the number of shapes, several weights
        explain the same motion: least squares returns the smallest; the bounded solve keeps at
        least a small ridge.
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
    ridge: float = 0.0,
    keys: MarkerKeys | None = None,
) -> EquationSolution:
    """Solve the blendshape equation for every frame.

    Minimises ``sum_m trust_m |motion_m - sum_i w_i delta_im|^2 + ridge |w|^2``, in mm^2.

    Parameters
    ----------
    deltas : (shapes, markers, 3) array
        What each shape at 1 does to the virtual markers [mm].
    motion : (frames, markers, 3) array
        Displacements from the neutral face, in the character's space and proportions [mm].
    method : {'lstsq', 'bounded'}, optional
        Plain least squares as in the paper; within `ranges`.
    ranges : (shapes, 2) array, optional
        Lowest and highest weights for ``'bounded'``; 0 to 1 unless given.
    visible : (frames, markers) bool array, optional
        False where a marker was not seen: it is left out of that frame's equation.
    marker_trust : (markers,) array, optional
        Weight of each marker in the sum, not negative; 1 unless given.
    ridge : float, optional
        Penalty [mm^2], not negative.
    keys : MarkerKeys, optional
        In-betweens, for ``'bounded'``: the equation is linearised again about each solution.

    Raises
    ------
    ValueError
        If arrays do not fit together, or an option does not go with the method.
    """
    problem = _checked(deltas, motion, visible, marker_trust)
    limits = _limits(method, ranges, problem.shape_count)
    if limits is None and keys is not None:
        raise ValueError("keys need method 'bounded'")
    if not ridge >= 0:
        raise ValueError(f"ridge must not be negative, got {ridge}")
    rank = problem.rank()
    if limits is not None and rank < problem.shape_count:
        energy = float(np.einsum("smc,m,smc->", problem.deltas, problem.share, problem.deltas))
        ridge = max(ridge, _DEPENDENT_RIDGE * energy / problem.shape_count)
    weights = np.zeros((problem.frame_count, problem.shape_count))
    for rows in _equal_rows(problem.trust):
        weights[rows] = _solve_rows(
            problem, rows, problem.deltas, problem.motion[rows], ridge, limits
        )
    if limits is not None and keys is not None:
        weights = _relinearise(problem, keys, weights, ridge, limits)
    residual = np.linalg.norm(problem.motion - _predict(problem.deltas, keys, weights), axis=2)
    residual[~problem.visible] = np.nan
    return EquationSolution(weights, residual, rank)


def _solve_rows(
    problem: "_Problem",
    rows: IntArray,
    deltas: FloatArray,
    target: FloatArray,
    ridge: float,
    limits: "_Limits | None",
) -> FloatArray:
    """Solve frames that share one matrix; without limits by plain least squares."""
    root = np.sqrt(problem.trust[rows[0]])[:, None]
    A = (deltas * root).reshape(len(deltas), -1)
    b = (target * root).reshape(len(rows), -1)
    if limits is None and ridge == 0:
        return np.asarray(np.linalg.lstsq(A.T, b.T)[0]).T
    hessian, linear = A @ A.T + ridge * np.eye(len(deltas)), b @ A.T
    if limits is None:
        return np.asarray(np.linalg.solve(hessian, linear.T)).T
    return minimise_bounded_quadratic(hessian, linear, lower=limits[0], upper=limits[1]).x


def _relinearise(
    problem: "_Problem", keys: MarkerKeys, weights: FloatArray, ridge: float, limits: "_Limits"
) -> FloatArray:
    """Solve again with each shape's slope at the last solution, keeping what fits better."""
    channels = np.asarray(keys.channels, np.int64)
    member = np.zeros((len(channels), problem.shape_count))
    member[np.arange(len(channels)), channels] = 1
    best = weights.copy()
    error = _error(problem, keys, weights)
    for _ in range(_MOST_RELINEARISATIONS):
        here = keys.key_weights(weights)
        # each key belongs to one shape, so one step of all shapes gives every slope
        slopes = (keys.key_weights(weights + _SMALL_STEP) - here) / _SMALL_STEP
        offset = here - slopes * weights[:, channels]
        following = np.empty_like(weights)
        for rows in _equal_rows(np.column_stack([problem.trust, slopes.round(4)])):
            D = np.einsum("ks,k,kmc->smc", member, slopes[rows[0]], keys.deltas)
            fixed = np.einsum("fk,kmc->fmc", offset[rows], keys.deltas)
            target = problem.motion[rows] - fixed
            following[rows] = _solve_rows(problem, rows, D, target, ridge, limits)
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


def _equal_rows(rows: FloatArray) -> list[IntArray]:
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
    visible: BoolArray
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

    def rank(self) -> int:
        """Return the rank of the equation, all trusted markers seen."""
        trusted = self.deltas[:, self.share > 0].reshape(self.shape_count, -1)
        return int(np.linalg.matrix_rank(trusted)) if trusted.size else 0


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


_Limits = tuple[FloatArray, FloatArray]
"""Lowest and highest weights, (shapes,) each."""


def _limits(method: _Method, ranges: ArrayLike | None, shapes: int) -> _Limits | None:
    if method == "lstsq":
        return None
    if method != "bounded":
        raise ValueError(f"method must be 'lstsq' or 'bounded', got {method!r}")
    limits = np.asarray([[0.0, 1.0]] * shapes if ranges is None else ranges, float)
    if limits.shape != (shapes, 2):
        raise ValueError(f"ranges must be ({shapes}, 2), got {limits.shape}")
    return limits[:, 0], limits[:, 1]
