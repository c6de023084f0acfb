"""Least squares within bounds, for many frames that share one matrix.

Each frame is a small convex quadratic programme, minimise ``0.5 x'Hx - l'x`` with ``lower <= x <=
upper``. All frames advance together: an accelerated projected gradient finds nearly the right set
of bounds, block pivoting makes it exact, and an active-set walk finishes the few frames on which
pivoting cycles.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from usdface.core.arrays import FloatArray

_GRADIENT_STEPS = 60  # enough that a handful of exchanges then end it on face rigs
_PIVOT_STEPS = 120
_PATIENCE = 3  # rounds without progress before variables change one at a time
_WALK_STEPS_PER_VARIABLE = 5
_TOLERANCE = 1e-10
_SYSTEM_FLOATS = 4_000_000  # size of one batch of linear systems: 32 MB
_DEPENDENT = 1e-8  # smallest eigenvalue, at unit diagonal, of columns that count as independent
_RIDGE = 1e-6  # added to the unit diagonal of dependent ones: of many solutions, a small one


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
    Stark and Parker (1995), Computational Statistics 10, 129-141: bounds one at a time.
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
    floor = float(diagonal.mean()) * 1e-12 if diagonal.any() else 1.0  # a frame may tell nothing
    unit = 1 / np.sqrt(np.maximum(diagonal, floor))  # x = unit * z gives z a unit diagonal
    with np.errstate(invalid="ignore"):
        lo_z, hi_z = lo / unit, hi / unit
    scaled = H * np.outer(unit, unit)
    values = np.linalg.eigvalsh(scaled)
    if n and values[0] < _DEPENDENT:
        scaled += _RIDGE * np.eye(n)
    b_z = b * unit
    step = 1 / max(float(values[-1]) + _RIDGE, np.finfo(float).tiny) if n else 1.0
    z = _approach(scaled, b_z, lo_z, hi_z, step)
    z = _pivot(scaled, b_z, lo_z, hi_z, z)
    z = _walk(scaled, b_z, lo_z, hi_z, z)
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
    H: FloatArray, b: FloatArray, lo: FloatArray, hi: FloatArray, step: float
) -> FloatArray:
    """Take accelerated projected gradient steps."""
    z = np.clip(np.zeros_like(b), lo, hi)
    ahead, momentum = z, np.ones(len(b))
    for _ in range(_GRADIENT_STEPS):
        moved = np.clip(ahead - step * (ahead @ H - b), lo, hi)
        restart = np.einsum("fn,fn->f", ahead - moved, moved - z) > 0
        momentum = np.where(restart, 1.0, momentum)
        following = (1 + np.sqrt(1 + 4 * momentum**2)) / 2
        rate = np.where(restart, 0.0, (momentum - 1) / following)
        ahead, z, momentum = moved + rate[:, None] * (moved - z), moved, following
    return np.asarray(z)


def _pivot(
    H: FloatArray, b: FloatArray, lo: FloatArray, hi: FloatArray, z: FloatArray
) -> FloatArray:
    """Exchange free and bound variables all at once: a few rounds, unless columns are alike."""
    out = z.copy()
    side = np.where(z <= lo, -1, np.where(z >= hi, 1, 0))
    todo = np.arange(len(b))
    fewest, patience = np.full(len(b), H.shape[0] + 1), np.full(len(b), _PATIENCE)
    slack = 1e-11 * (1 + np.abs(b).max(axis=1, initial=0.0))
    for _ in range(_PIVOT_STEPS):
        at = side[todo]
        value = _solve_free(H, b[todo], np.where(at < 0, lo, np.where(at > 0, hi, 0.0)), at == 0)
        gradient = value @ H - b[todo]
        room = slack[todo, None]
        low, high = (at == 0) & (value < lo - room), (at == 0) & (value > hi + room)
        free = ((at < 0) & (gradient < -room)) | ((at > 0) & (gradient > room))
        free &= lo < hi
        wrong = low | high | free
        count = wrong.sum(axis=1)
        better = count < fewest[todo]
        fewest[todo] = np.where(better, count, fewest[todo])
        patience[todo] = np.where(better, _PATIENCE, patience[todo] - 1)
        last = wrong.shape[1] - 1 - wrong[:, ::-1].argmax(axis=1)
        only = np.arange(wrong.shape[1]) == last[:, None]  # Murty: one alone, where all cycle
        change = wrong & (only | (patience[todo] >= 0)[:, None])
        side[todo] = np.where(change, np.where(low, -1, np.where(high, 1, 0)), at)
        done = count == 0
        out[todo[done]] = np.clip(value[done], lo, hi)
        todo = todo[~done]
        if not len(todo):
            break
    return out


def _walk(
    H: FloatArray, b: FloatArray, lo: FloatArray, hi: FloatArray, z: FloatArray
) -> FloatArray:
    """Walk along the bounds, one variable a step, from a feasible start: slow, but never cycles.

    A step goes to the minimum over the free variables, or to the first bound in its way, which
    fixes that variable; at such a minimum the bound variable that pulls hardest is set free.
    """
    out = z.copy()
    todo = np.flatnonzero(_violation(H, b, lo, hi, z) > _TOLERANCE)
    fixed = (z <= lo) | (z >= hi)
    for _ in range(_WALK_STEPS_PER_VARIABLE * len(H)):
        if not len(todo):
            break
        rows = np.arange(len(todo))
        now, right, held = out[todo], b[todo], fixed[todo]
        step = _solve_free(H, right, np.where(held, now, 0.0), ~held) - now
        with np.errstate(divide="ignore", invalid="ignore"):
            room = np.where(step < 0, (lo - now) / step, (hi - now) / step)
        room = np.where(held | (step == 0), np.inf, room)
        blocker = room.argmin(axis=1)
        length = room[rows, blocker]
        blocked = length < 1
        now = np.clip(now + np.minimum(length, 1.0)[:, None] * step, lo, hi)
        first = rows[blocked], blocker[blocked]
        now[first] = np.where(step[first] < 0, lo[first[1]], hi[first[1]])
        held[first] = True
        gradient = now @ H - right
        pull = np.where(now <= lo, -gradient, gradient) * (held & (lo < hi))
        hardest = pull.argmax(axis=1)
        release = ~blocked & (pull[rows, hardest] > _TOLERANCE * np.abs(right).max(axis=1))
        held[rows[release], hardest[release]] = False
        out[todo], fixed[todo] = now, held
        todo = todo[blocked | release]
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
