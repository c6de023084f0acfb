"""Box-constrained quadratic programmes for many frames.

Each frame is a small convex programme: minimise ``0.5 x'Hx - l'x`` with ``lower <= x <= upper``.
`solve_bounded_least_squares` has one matrix for all frames. Alternating directions find nearly the
right active set, block pivoting makes it exact, and an active-set method finishes the few frames on
which pivoting makes no progress. `minimise_within_bounds`, which maps performances, has a matrix
for each frame, and takes accelerated projected gradient steps alone.
"""

import math
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from usdface.core.arrays import FloatArray, RealArray, frame_blocks
from usdface.core.processes import map_threads
from usdface.numerics.solve.hessian import EIGENVALUE_SHIFT, Hessian, hessian_of

_ALTERNATING_STEPS = 30
"""From rest; on face rigs, less than one exchange per frame follows, on average."""
_OVER_RELAXATION = 1.8
_BLOCK_FRAMES = 64
"""Frames per thread and task; rounding depends on it, so it is independent of the cores."""
_PATIENCE_ROUNDS = 3
"""Of pivoting without progress, before the active-set method takes over."""
_ACTIVE_SET_STEPS_PER_VARIABLE = 5
_ACTIVE_SET_TOLERANCE = 1e-10
"""[of the largest linear term] Violation of optimality above which the active-set method runs."""
_POWER_STEPS = 6
_POWER_MARGIN = 1.1
_POWER_START = 1e-6
"""Of the power method for a matrix's largest eigenvalue: steps, factor of the estimate, and offset
of the start vector. Gradient steps that prove the estimate too small are repeated."""

_TINY = float(np.finfo(np.float32).tiny)


def solve_bounded_least_squares(
    matrix: ArrayLike,
    targets: ArrayLike,
    *,
    lower: ArrayLike,
    upper: ArrayLike,
    ridge: ArrayLike = 0.0,
    cost: ArrayLike = 0.0,
) -> FloatArray:
    """Minimise ``|matrix @ x - target|^2 + ridge @ x^2 + 2 cost @ x`` within bounds, per target.

    Returns x, (frames, n), within the bounds exactly.

    Parameters
    ----------
    matrix : (rows, n) array
        If its columns are dependent and there is no ridge, one of the minimisers is returned.
    targets : (frames, rows) array
    lower, upper : (n,) arrays
        May be infinite, or equal, which fixes a variable.
    ridge : float or (n,) array, optional
        Penalties, not negative.
    cost : float or (frames, n) array, optional

    References
    ----------
    Júdice and Pires (1994), Computers & Operations Research 21(5), 587-596: block pivoting.
    Stark and Parker (1995), Computational Statistics 10, 129-141: the active set.
    Boyd et al. (2011), Foundations and Trends in Machine Learning 3(1), 1-122: alternations.
    """
    A, b = np.asarray(matrix, float), np.asarray(targets, float)
    n = A.shape[1]
    penalty = np.broadcast_to(np.asarray(ridge, float), n)
    linear = b @ A - np.asarray(cost, float)
    lo, hi = (np.array(np.broadcast_to(np.asarray(v, float), n)) for v in (lower, upper))
    _check(A, linear, lo, hi)
    diagonal = (A**2).sum(axis=0) + penalty
    floor = float(diagonal.mean()) * 1e-12 if diagonal.any() else 1.0  # all markers may be hidden
    unit = 1 / np.sqrt(np.maximum(diagonal, floor))  # x = unit * z gives z a unit diagonal
    with np.errstate(invalid="ignore"):
        lo_z, hi_z = lo / unit, hi / unit
    z = _solve_scaled(hessian_of(A * unit, penalty * unit**2), linear * unit, lo_z, hi_z)
    return np.where(z <= lo_z, lo, np.where(z >= hi_z, hi, z * unit))  # bounds stay exact


def _solve_scaled(H: Hessian, b: FloatArray, lo: FloatArray, hi: FloatArray) -> FloatArray:
    """Return minimisers of ``0.5 z'Hz - b'z`` within bounds."""
    low, high, pull = lo.astype(H.dtype), hi.astype(H.dtype), b.astype(H.dtype)

    def solve(rows: slice) -> FloatArray:
        near = _alternate_directions(H, pull[rows], low, high)
        near = np.where(near <= low, lo, np.where(near >= high, hi, near))
        return _solve_by_active_set(H, b[rows], lo, hi, _exchange_blocks(H, b[rows], lo, hi, near))

    solved = map_threads(solve, frame_blocks(len(b), frames=_BLOCK_FRAMES))
    return np.concatenate([np.zeros_like(b[:0]), *solved])


def minimise_within_bounds(
    product: Callable[[Any], Any],
    diagonal: RealArray,
    linear: RealArray,
    *,
    lower: RealArray,
    upper: RealArray,
    start: RealArray,
    steps: int,
) -> RealArray:
    """Minimise ``0.5 x'Hx - l'x`` within bounds approximately, with a matrix for each row.

    By accelerated projected gradient steps. Returns (frames, n), within the bounds exactly.

    Parameters
    ----------
    product : callable
        Multiplies each row (frames, n) by its H, which is symmetric and positive definite.
    diagonal : (frames, n) float array
        Of each row's H.
    linear : (frames, n) float array
    lower, upper, start : (frames, n) float arrays
    steps : int
        Accelerated gradient steps, at unit diagonal.
    """
    unit = 1 / np.sqrt(np.maximum(diagonal, np.finfo(np.float32).tiny))
    low, high, pull = lower / unit, upper / unit, unit * linear

    def scaled(rows: RealArray) -> RealArray:
        return np.asarray(unit * product(unit * rows))

    # The linear term is mostly along the eigenvectors of large eigenvalues.
    vector: RealArray = pull + np.float32(_POWER_START)
    for _ in range(_POWER_STEPS):
        vector /= np.linalg.norm(vector, axis=1, keepdims=True)
        vector = scaled(vector)
    largest = _POWER_MARGIN * np.linalg.norm(vector, axis=1, keepdims=True)
    now = ahead = np.clip(start / unit, low, high)
    pushed_now = pushed_ahead = scaled(now)
    momentum = 1.0
    for _ in range(steps):
        following = np.minimum(np.maximum(ahead - (pushed_ahead - pull) / largest, low), high)
        pushed = scaled(following)
        moved = following - ahead
        length2 = np.einsum("fn,fn->f", moved, moved)[:, None]
        steepness = np.einsum("fn,fn->f", moved, pushed - pushed_ahead)[:, None]
        steep = steepness > largest * length2
        if steep.any():  # the power method missed an eigenvalue: reject the step
            estimate = _POWER_MARGIN * steepness / np.maximum(length2, _TINY)
            estimate = np.minimum(estimate, moved.shape[1])  # at unit diagonal it is n at most
            largest = np.where(steep, estimate, largest)
            following, pushed = np.where(steep, now, following), np.where(steep, pushed_now, pushed)
        gained = (1 + math.sqrt(1 + 4 * momentum**2)) / 2
        carried = (momentum - 1) / gained
        ahead = following + carried * (following - now)
        pushed_ahead = pushed + carried * (pushed - pushed_now)
        now, pushed_now, momentum = following, pushed, gained
    return np.asarray(np.clip(now * unit, lower, upper))


def _check(A: FloatArray, linear: FloatArray, lo: FloatArray, hi: FloatArray) -> None:
    if not np.isfinite(A).all() or not np.isfinite(linear).all():
        raise ValueError("matrix and targets must be finite; mask or fill missing samples first")
    bad = np.flatnonzero(~(lo <= hi) | (lo == np.inf) | (hi == -np.inf))
    if len(bad):
        raise ValueError(
            f"lower must not exceed upper; variable {bad[0]} has {lo[bad[0]]} and {hi[bad[0]]}"
        )


def _alternate_directions(H: Hessian, b: Any, lower: Any, upper: Any) -> Any:
    """Alternate between minimisers without bounds, near the last values, and their projections."""
    inverse, nearness = H.shifted_inverse(), H.dtype.type(EIGENVALUE_SHIFT)
    now = np.clip(np.zeros_like(b), lower, upper)
    dual = np.zeros_like(b)
    for _ in range(_ALTERNATING_STEPS):
        free = inverse(b + nearness * (now - dual))
        dual += now + H.dtype.type(_OVER_RELAXATION) * (free - now)
        # np.clip is slower if its bounds are arrays
        now = np.minimum(np.maximum(dual, lower), upper)
        dual -= now
    return now


def _exchange_blocks(
    H: Hessian, b: FloatArray, lo: FloatArray, hi: FloatArray, z: FloatArray
) -> FloatArray:
    """Exchange free and bound variables by block principal pivoting."""
    out = z.copy()
    side = np.where(z <= lo, -1, np.where(z >= hi, 1, 0))
    todo = np.arange(len(b))
    fewest, patience = np.full(len(b), b.shape[1] + 1), np.full(len(b), _PATIENCE_ROUNDS)
    solve = H.solver()
    slack = 1e-11 * (1 + np.abs(b).max(axis=1, initial=0.0))
    while len(todo):
        at = side[todo]
        bound = np.where(at < 0, lo, np.where(at > 0, hi, 0.0))
        value = solve(todo, b[todo], bound, at == 0)
        gradient = H.product(value) - b[todo]
        room = slack[todo, None]
        low, high = (at == 0) & (value < lo - room), (at == 0) & (value > hi + room)
        free = ((at < 0) & (gradient < -room)) | ((at > 0) & (gradient > room))
        wrong = low | high | (free & (lo < hi))
        count = wrong.sum(axis=1)
        better = count < fewest[todo]
        fewest[todo] = np.where(better, count, fewest[todo])
        patience[todo] = np.where(better, _PATIENCE_ROUNDS, patience[todo] - 1)
        side[todo] = np.where(wrong, np.where(low, -1, np.where(high, 1, 0)), at)
        done = count == 0
        out[todo[done]] = np.clip(value[done], lo, hi)
        todo = todo[~done & (patience[todo] > 0)]
    return out


def _solve_by_active_set(
    H: Hessian, b: FloatArray, lo: FloatArray, hi: FloatArray, z: FloatArray
) -> FloatArray:
    """Solve by a primal active-set method from a feasible start: slow, but without cycles.

    A step goes to the minimum over the free variables, or to the first bound on the way, which
    fixes that variable; at such a minimum the variable with the largest multiplier is freed.
    """
    out = z.copy()
    moved = np.clip(z - (H.product(z) - b), lo, hi) - z  # a projected gradient step
    scale = np.maximum(np.abs(b).max(axis=1, initial=0.0), np.finfo(float).tiny)
    todo = np.flatnonzero(np.abs(moved).max(axis=1, initial=0.0) / scale > _ACTIVE_SET_TOLERANCE)
    fixed = (z <= lo) | (z >= hi)
    solve = H.solver()
    for _ in range(_ACTIVE_SET_STEPS_PER_VARIABLE * b.shape[1]):
        if not len(todo):
            break
        rows = np.arange(len(todo))
        now, right, bound = out[todo], b[todo], fixed[todo]
        step = solve(todo, right, np.where(bound, now, 0.0), ~bound) - now
        with np.errstate(divide="ignore", invalid="ignore"):
            room = np.where(step < 0, (lo - now) / step, (hi - now) / step)
        room = np.where(bound | (step == 0), np.inf, room)
        blocker = room.argmin(axis=1)
        length = room[rows, blocker]
        blocked = length < 1
        now = np.clip(now + np.minimum(length, 1.0)[:, None] * step, lo, hi)
        first = rows[blocked], blocker[blocked]
        now[first] = np.where(step[first] < 0, lo[first[1]], hi[first[1]])
        bound[first] = True
        gradient = H.product(now) - right
        pull = np.where(now <= lo, -gradient, gradient) * (bound & (lo < hi))
        hardest = pull.argmax(axis=1)
        release = ~blocked & (
            pull[rows, hardest] > _ACTIVE_SET_TOLERANCE * np.abs(right).max(axis=1)
        )
        bound[rows[release], hardest[release]] = False
        out[todo], fixed[todo] = now, bound
        todo = todo[blocked | release]
    return out
