"""Hessian of a quadratic programme and solution of its free variables: dense, or of low rank.

With more shapes than coordinates of markers, the Hessian is diagonal plus low rank: 946 shapes at
92 markers give 946 rows of rank 276. Systems of its free variables are then solved by Woodbury's
identity: with ``H = FF' + D`` and ``E = F / sqrt(D)``,

    x = (u - E y) / sqrt(D),   (I + E'E) y = E'u,   u = b / sqrt(D)

over the free rows. Few rows change between frames and between exchanges: with ``I + E'E = LL'``
over the previous rows, C the rows that changed and S their signs,

    y = L'^-1 (z - T (S + T'T)^-1 T'z),   z = L^-1 E'u,   T = L^-1 C'

and where many changed, L is factored again. Hessians of many frames are inverted together.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from usdface.core.arrays import BoolArray, FloatArray, IntArray, RealArray

EIGENVALUE_SHIFT = 0.3
"""At unit diagonal: of `Hessian.shifted_inverse`. Few exchanges follow with 52 and 946 shapes."""
_DEPENDENT_EIGENVALUE = 1e-8
"""At unit diagonal: smallest eigenvalue of independent columns."""
_DEPENDENT_RIDGE = 1e-6
"""Added to the unit diagonal of dependent columns, which selects a small solution."""
_LOW_RANK_SHARE = 0.4
"""[of the variables] Largest rank for the low-rank solver."""
_MOST_COORDINATES = 500
"""Largest rank for the low-rank solver, which stores 4 MB per frame of a block."""
_MOST_CHANGES = 48
"""Changed free variables up to which a factor is updated."""
_LEAST_DIAGONAL = 1e-5
"""At unit diagonal: with a smaller D, Woodbury's identity loses digits."""
_SMALL_MATRIX = 8
"""Variables up to which LAPACK inverts fastest."""


Solver = Callable[[IntArray, FloatArray, FloatArray, BoolArray], FloatArray]
"""``solve(rows, b, fixed, free)`` of some frames of a block: which, and their linear terms, fixed
values and free variables (frames, n). Returns frames with their free variables solved."""


class Hessian(Protocol):
    """A symmetric matrix H with a unit diagonal."""

    dtype: np.dtype[Any]
    """Of `shifted_inverse`."""

    def product(self, z: FloatArray) -> FloatArray:
        """Return ``z @ H`` for (frames, n) rows."""

    def shifted_inverse(self) -> Callable[[Any], Any]:
        """Return the product of rows of `dtype` with ``inv(H + EIGENVALUE_SHIFT I)``."""

    def solver(self) -> Solver:
        """Return a solver for a block of frames."""


def hessian_of(factor: FloatArray, diagonal: FloatArray) -> Hessian:
    """Return ``factor.T @ factor`` plus a diagonal.

    Parameters
    ----------
    factor : (rows, n) float array
    diagonal : (n,) float array
        Not negative; `_DEPENDENT_RIDGE` is added if columns are dependent.
    """
    F = factor[factor.any(axis=1)].T
    n, rank = F.shape
    if rank <= min(_LOW_RANK_SHARE * n, _MOST_COORDINATES) and diagonal.min() > _LEAST_DIAGONAL:
        return _LowRank(F, diagonal)
    return _Dense(F @ F.T + np.diag(diagonal))


class _Dense:
    dtype = np.dtype(np.float64)

    def __init__(self, H: FloatArray) -> None:
        if len(H) and np.linalg.eigvalsh(H)[0] < _DEPENDENT_EIGENVALUE:
            H = H + _DEPENDENT_RIDGE * np.eye(len(H))
        self._H = H
        self._inverse = np.linalg.inv(H + EIGENVALUE_SHIFT * np.eye(len(H)))

    def product(self, z: FloatArray) -> FloatArray:
        return z @ self._H

    def shifted_inverse(self) -> Callable[[Any], Any]:
        return lambda z: z @ self._inverse

    def solver(self) -> Solver:
        return self._solve

    def _solve(
        self, rows: IntArray, b: FloatArray, fixed: FloatArray, free: BoolArray
    ) -> FloatArray:
        from scipy.linalg.lapack import dposv  # imported late: mapping a performance needs none

        H, rest = self._H, b - fixed @ self._H
        value = fixed.copy()
        for row, chosen in enumerate(free):
            index = chosen.nonzero()[0]
            if not len(index):
                continue
            system = H.take(index, 0).take(index, 1)
            solved, failed = dposv(system.T, rest[row, index], overwrite_a=True)[1:]
            if failed:  # rounding made a nearly singular system indefinite
                solved = np.linalg.lstsq(H.take(index, 0).take(index, 1), rest[row, index])[0]
            value[row, index] = solved
        return value


class _LowRank:
    dtype = np.dtype(np.float32)  # only the start of the exact solution

    def __init__(self, F: FloatArray, diagonal: FloatArray) -> None:
        self.F, self.diagonal, self.root = F, diagonal, np.sqrt(diagonal)
        self.E = F / self.root[:, None]
        shifted = F / (diagonal + EIGENVALUE_SHIFT)[:, None]
        inner = np.linalg.inv(np.eye(F.shape[1]) + F.T @ shifted)  # Woodbury's identity
        factor = shifted @ np.linalg.cholesky(inner)
        self._shifted = (
            factor.astype(self.dtype),
            (1 / (diagonal + EIGENVALUE_SHIFT)).astype(self.dtype),
        )

    def product(self, z: FloatArray) -> FloatArray:
        return np.asarray((z @ self.F) @ self.F.T + z * self.diagonal)

    def shifted_inverse(self) -> Callable[[Any], Any]:
        factor, diagonal = self._shifted
        return lambda z: z * diagonal - (z @ factor) @ factor.T

    def solver(self) -> Solver:
        return _LowRankSolver(self)


@dataclass(frozen=True)
class _Factored:
    """``I + E'E`` over the free rows, and its Cholesky factor."""

    free: BoolArray
    products: FloatArray
    lower: FloatArray


class _LowRankSolver:
    def __init__(self, H: _LowRank) -> None:
        self._H = H
        unit = np.eye(H.E.shape[1])
        self._empty = self._last = _Factored(np.zeros(len(H.E), np.bool_), unit, unit)
        self._by_row: dict[int, _Factored] = {}

    def __call__(
        self, rows: IntArray, b: FloatArray, fixed: FloatArray, free: BoolArray
    ) -> FloatArray:
        H = self._H
        u = np.where(free, b - H.product(fixed), 0.0) / H.root
        y = u @ H.E
        if not y.shape[1]:  # no marker is visible: H is diagonal
            return np.asarray(np.where(free, u / H.root, fixed))
        for index, (row, chosen) in enumerate(zip(rows.tolist(), free, strict=True)):
            # From the previous exchange of this frame, or from the previous frame.
            starts = (self._by_row.get(row, self._last), self._last)
            near = min(starts, key=lambda start: np.count_nonzero(start.free != chosen))
            if np.count_nonzero(near.free != chosen) > _MOST_CHANGES:
                near = self._factored(near, chosen)
            self._last = self._by_row[row] = near
            y[index] = self._solved(near, chosen, y[index])
        return np.asarray(np.where(free, (u - y @ H.E.T) / H.root, fixed))

    def _factored(self, near: _Factored, free: BoolArray) -> _Factored:
        from scipy.linalg.lapack import dpotrf

        if np.count_nonzero(near.free != free) > np.count_nonzero(free):
            near = self._empty
        added, removed = self._H.E[free & ~near.free], self._H.E[near.free & ~free]
        products = near.products + added.T @ added - removed.T @ removed
        return _Factored(free, products, dpotrf(products, lower=True)[0])

    def _solved(self, factored: _Factored, free: BoolArray, right: FloatArray) -> FloatArray:
        """Return ``(I + E'E)^-1 right`` over the free rows, by updating another factor."""
        from scipy.linalg.blas import dtrsm, dtrsv

        y = dtrsv(factored.lower, right, lower=True)
        changed = np.flatnonzero(factored.free != free)
        if len(changed):
            T = dtrsm(1.0, factored.lower, self._H.E[changed].T, lower=True)
            S = np.diag(np.where(free[changed], 1.0, -1.0))
            y -= T @ np.linalg.solve(S + T.T @ T, T.T @ y)
        return np.asarray(dtrsv(factored.lower, y, lower=True, trans=True))


def invert_by_halves(matrices: RealArray) -> RealArray:
    """Return the inverses of symmetric positive definite matrices, (frames, n, n).

    By Schur complements of halves: products are faster than LAPACK's solves of small matrices,
    three times at 51 variables.
    """
    n = matrices.shape[1]
    if n <= _SMALL_MATRIX:
        return np.asarray(np.linalg.inv(matrices))
    half = n // 2
    first, beside = matrices[:, :half, :half], matrices[:, :half, half:]
    first = invert_by_halves(first)
    carried = first @ beside
    below = carried.transpose(0, 2, 1)
    last = invert_by_halves(matrices[:, half:, half:] - beside.transpose(0, 2, 1) @ carried)
    out = np.empty_like(matrices)
    out[:, half:, half:] = last
    out[:, half:, :half] = -last @ below
    out[:, :half, half:] = out[:, half:, :half].transpose(0, 2, 1)
    out[:, :half, :half] = first - carried @ out[:, half:, :half]
    return out
