"""Least squares within bounds, for many frames that share one matrix.

Each frame is a small convex quadratic programme, minimise ``0.5 x'Hx - l'x`` with ``lower <= x <=
upper``. All frames advance together: an accelerated projected gradient finds nearly the right set
of bounds, and block principal pivoting then makes it exact.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

FloatArray = NDArray[np.float64]

_GRADIENT_STEPS = 60  # enough that pivoting then needs a handful of exchanges on face rigs
_PIVOT_STEPS = 500
_PATIENCE = 3  # full exchanges without progress before single ones [Júdice and Pires 1994]
_SYSTEM_FLOATS = 4_000_000  # size of one batch of linear systems: 32 MB
_RIDGE = 1e-10  # of the mean diagonal: makes dependent columns solvable, invisible otherwise


@dataclass(frozen=True)
class BoundedSolution:
    """Minimisers, and how near each is to optimal.

    Attributes
    ----------
    x : (frames, n) float array
        Within the bounds exactly.
    violation : (frames,) float array
        Largest breach of the optimality (Karush-Kuhn-Tucker) conditions, after scaling every
        variable to a unit diagonal and relative to the largest linear term.
    """

    x: FloatArray
    violation: FloatArray


def solve_bounded_least_squares(
    matrix: ArrayLike,
    targets: ArrayLike,
    *,
    lower: ArrayLike,
    upper: ArrayLike,
    ridge: float = 0.0,
    l1: float = 0.0,
) -> BoundedSolution:
    """Minimise ``|matrix @ x - target|^2 + ridge |x|^2 + 2 l1 |x|_1`` within bounds, per target.

    Parameters
    ----------
    matrix : (rows, n) array
    targets : (frames, rows) array
    lower, upper : (n,) arrays
        May be infinite.
    ridge, l1 : float, optional
        Penalties, not negative.

    Raises
    ------
    ValueError
        If shapes, bounds or penalties cannot be used.
    """
    A, b = np.asarray(matrix, float), np.asarray(targets, float)
    if A.ndim != 2 or b.ndim != 2 or A.shape[0] != b.shape[1]:
        raise ValueError(
            f"matrix (rows, n) and targets (frames, rows) must share rows; got {A.shape}, {b.shape}"
        )
    if not ridge >= 0 or not l1 >= 0:
        raise ValueError(f"ridge and l1 must not be negative, got {ridge} and {l1}")
    hessian = A.T @ A + ridge * np.eye(A.shape[1])
    return minimise_bounded_quadratic(hessian, b @ A, lower=lower, upper=upper, l1=l1)


def minimise_bounded_quadratic(
    hessian: ArrayLike,
    linear: ArrayLike,
    *,
    lower: ArrayLike,
    upper: ArrayLike,
    l1: float = 0.0,
) -> BoundedSolution:
    """Minimise ``0.5 x'Hx - l'x + l1 |x|_1`` with ``lower <= x <= upper`` for every row ``l``.

    Parameters
    ----------
    hessian : (n, n) array
        Symmetric and positive semidefinite; shared by all frames. Where columns are dependent,
        one of the minimisers is returned.
    linear : (frames, n) array
    lower, upper : (n,) arrays
        May be infinite; ``lower < upper`` or equal, which fixes a variable.
    l1 : float, optional
        Weight of the absolute values, not negative.

    Raises
    ------
    ValueError
        If shapes or bounds cannot be used, or a value is not finite.

    References
    ----------
    Júdice and Pires (1994), Computers & Operations Research 21(5), 587-596: block pivoting.
    O'Donoghue and Candès (2015), Found. Comput. Math. 15, 715-732: adaptive restart.
    """
    H, b = np.asarray(hessian, float), np.asarray(linear, float)
    n = len(H)
    lo, hi = (np.array(np.broadcast_to(np.asarray(v, float), n)) for v in (lower, upper))
    _check(H, b, lo, hi)
    if l1 < 0:
        raise ValueError(f"l1 must not be negative, got {l1}")
    both = np.flatnonzero((lo < 0) & (hi > 0)) if l1 > 0 else np.empty(0, int)
    if len(both):  # |x| has a kink inside the bounds: x = positive part - negative part
        columns = np.r_[np.arange(n), both]
        sign = np.r_[np.ones(n), -np.ones(len(both))]
        wide_lo, wide_hi = np.r_[lo, np.zeros(len(both))], np.r_[hi, -lo[both]]
        wide_lo[both] = 0
        wide = H[np.ix_(columns, columns)] * np.outer(sign, sign)
        slope = np.where(wide_hi > 0, 1.0, -1.0)  # of |.| on the side where the part may lie
        part = _minimise(wide, b[:, columns] * sign - l1 * slope, wide_lo, wide_hi)
        x = part.x[:, :n].copy()
        x[:, both] -= part.x[:, n:]
        return BoundedSolution(x, part.violation)
    return _minimise(H, b - l1 * np.where(hi > 0, 1.0, -1.0), lo, hi)


def _minimise(H: FloatArray, b: FloatArray, lo: FloatArray, hi: FloatArray) -> BoundedSolution:
    n = len(H)
    diagonal = np.diagonal(H)
    floor = max(float(diagonal.mean()), np.finfo(float).tiny) * 1e-12
    unit = 1 / np.sqrt(np.maximum(diagonal, floor))  # x = unit * z gives z a unit diagonal
    with np.errstate(invalid="ignore"):
        lo_z, hi_z = lo / unit, hi / unit
    scaled = H * np.outer(unit, unit) + _RIDGE * np.eye(n)
    b_z = b * unit
    z, state = _approach(scaled, b_z, lo_z, hi_z)
    z = _pivot(scaled, b_z, lo_z, hi_z, z, state)
    violation = _violation(scaled, b_z, lo_z, hi_z, z)
    x = np.where(z <= lo_z, lo, np.where(z >= hi_z, hi, z * unit))  # bounds stay exact
    return BoundedSolution(x, violation)


def _check(H: FloatArray, b: FloatArray, lo: FloatArray, hi: FloatArray) -> None:
    n = len(H)
    if H.shape != (n, n) or b.ndim != 2 or b.shape[1] != n:
        raise ValueError(f"expected H (n, n) and linear (frames, n), got {H.shape} and {b.shape}")
    if not np.isfinite(H).all() or not np.isfinite(b).all():
        raise ValueError("matrix and targets must be finite; mask or fill missing samples first")
    bad = np.flatnonzero(~(lo <= hi) | (lo == np.inf) | (hi == -np.inf))
    if len(bad):
        raise ValueError(
            f"lower must not exceed upper; variable {bad[0]} has {lo[bad[0]]} and {hi[bad[0]]}"
        )


def _approach(
    H: FloatArray, b: FloatArray, lo: FloatArray, hi: FloatArray
) -> tuple[FloatArray, NDArray[np.int8]]:
    """Take accelerated projected gradient steps; return where they end and the bounds they touch.

    The state is -1 at the lower bound, 1 at the upper, 0 free.
    """
    step = 1 / max(float(np.linalg.eigvalsh(H)[-1]), np.finfo(float).tiny)
    z = np.clip(np.zeros_like(b), lo, hi)
    ahead, momentum = z, np.ones(len(b))
    for _ in range(_GRADIENT_STEPS):
        moved = np.clip(ahead - step * (ahead @ H - b), lo, hi)
        restart = np.einsum("fn,fn->f", ahead - moved, moved - z) > 0
        momentum = np.where(restart, 1.0, momentum)
        following = (1 + np.sqrt(1 + 4 * momentum**2)) / 2
        rate = np.where(restart, 0.0, (momentum - 1) / following)
        ahead, z, momentum = moved + rate[:, None] * (moved - z), moved, following
    state = np.zeros(b.shape, np.int8)
    state[z <= lo] = -1
    state[z >= hi] = 1
    return z, state


def _pivot(
    H: FloatArray,
    b: FloatArray,
    lo: FloatArray,
    hi: FloatArray,
    z: FloatArray,
    state: NDArray[np.int8],
) -> FloatArray:
    """Exchange bound and free variables until every frame is optimal."""
    out = z.copy()
    todo = np.arange(len(b))
    fewest = np.full(len(b), H.shape[0] + 1)
    patience = np.full(len(b), _PATIENCE)
    slack = 1e-11 * (1 + np.abs(b).max(axis=1, initial=0.0))
    for _ in range(_PIVOT_STEPS):
        if not len(todo):
            break
        s = state[todo]
        value = _solve_free(H, b[todo], np.where(s < 0, lo, np.where(s > 0, hi, 0.0)), s == 0)
        gradient = value @ H - b[todo]
        room = slack[todo, None]
        to_lower = (s == 0) & (value < lo - room)
        to_upper = (s == 0) & (value > hi + room)
        to_free = ((s < 0) & (gradient < -room)) | ((s > 0) & (gradient > room))
        to_free &= lo < hi
        wrong = to_lower | to_upper | to_free
        count = wrong.sum(axis=1)
        out[todo] = np.clip(value, lo, hi)
        better = count < fewest[todo]
        fewest[todo] = np.where(better, count, fewest[todo])
        patience[todo] = np.where(better, _PATIENCE, patience[todo] - 1)
        single = patience[todo] < 0  # Murty's rule: the last one alone; finite, though slow
        last = wrong.shape[1] - 1 - wrong[:, ::-1].argmax(axis=1)
        only = np.zeros_like(wrong)
        only[np.arange(len(todo)), last] = True
        change = wrong & (only | ~single[:, None])
        s = np.where(change & to_lower, -1, np.where(change & to_upper, 1, s))
        state[todo] = np.where(change & to_free, 0, s).astype(np.int8)
        todo = todo[count > 0]
    return out


def _solve_free(
    H: FloatArray, b: FloatArray, fixed: FloatArray, free: NDArray[np.bool_]
) -> FloatArray:
    """Solve each frame's free variables, the others staying at their bounds."""
    rest = b - fixed @ H
    value = fixed.copy()
    counts = free.sum(axis=1)
    first = np.argsort(~free, axis=1, kind="stable")  # the free variables of each frame come first
    by_count = np.argsort(counts, kind="stable")[::-1]
    start = 0
    while start < len(by_count) and counts[by_count[start]] > 0:
        k = int(counts[by_count[start]])
        rows = by_count[start : start + max(1, _SYSTEM_FLOATS // (k * k))]
        index = first[rows, :k]
        inside = np.arange(k) < counts[rows, None]
        system = H[index[:, :, None], index[:, None, :]]
        system *= inside[:, :, None] & inside[:, None, :]
        system[:, np.arange(k), np.arange(k)] += ~inside
        right = np.take_along_axis(rest[rows], index, axis=1) * inside
        solved = np.linalg.solve(system, right[..., None])[..., 0]
        frame, slot = np.nonzero(inside)
        value[rows[frame], index[frame, slot]] = solved[frame, slot]
        start += len(rows)
    return value


def _violation(
    H: FloatArray, b: FloatArray, lo: FloatArray, hi: FloatArray, z: FloatArray
) -> FloatArray:
    """Distance that one projected gradient step would move, relative to the linear term."""
    if not b.size:
        return np.zeros(len(b))
    moved = np.clip(z - (z @ H - b), lo, hi) - z
    scale = np.maximum(np.abs(b).max(axis=1), np.finfo(float).tiny)
    violation: FloatArray = np.abs(moved).max(axis=1) / scale
    return violation
