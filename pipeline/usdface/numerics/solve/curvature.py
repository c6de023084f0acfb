"""The matrix of a quadratic programme, as its solver needs it: dense, or of low rank.

Rigs have more shapes than a marker set has coordinates: 946 shapes at 92 markers make a matrix of
946 rows that is a product of 276, plus a diagonal. Systems of its free variables are then solved in
the coordinates: with ``H = FF' + D`` and ``E = F / sqrt(D)``, by Woodbury's identity,

    x = (u - E y) / sqrt(D),   (I + E'E) y = E'u,   u = b / sqrt(D)

over the rows that are free. From one frame to the next, and from one exchange to the next, few
rows come and go; the products ``E'E`` change by theirs.
"""

from typing import Any, Protocol

import numpy as np

from usdface.core.arrays import BoolArray, FloatArray, IntArray

_DEPENDENT_EIGENVALUE = 1e-8
"""At unit diagonal: columns with a smaller one count as dependent."""
_DEPENDENT_RIDGE = 1e-6
"""Added to the unit diagonal of dependent columns: of many solutions, a small one."""
_LOW_RANK_SHARE = 0.4
"""[of the variables] Coordinates up to which systems are solved in them."""
_MOST_COORDINATES = 500
"""A block of frames keeps the products of each: 2 MB a frame."""
_LEAST_DIAGONAL = 1e-5
"""At unit diagonal: with less the detour by the coordinates loses digits."""


class Systems(Protocol):
    """Solves a block of frames again and again, while their free variables change."""

    def solve(
        self, rows: IntArray, b: FloatArray, fixed: FloatArray, free: BoolArray
    ) -> FloatArray:
        """Return frames with their free variables solved, the others as `fixed` has them.

        Parameters
        ----------
        rows : (frames,) int array
            Which of the block's frames.
        b, fixed, free : (frames, n) arrays
        """


class Curvature(Protocol):
    """A symmetric matrix H with a unit diagonal."""

    largest: float
    """Its largest eigenvalue, or more."""
    dtype: np.dtype[Any]
    """Of `near`."""

    def times(self, z: FloatArray) -> FloatArray:
        """Return ``z @ H`` for (frames, n) rows."""

    def near(self, z: Any) -> Any:
        """Return ``z @ H`` for rows of `dtype`, as exactly as that holds it."""

    def systems(self) -> Systems:
        """Return what solves a block of frames."""


def curvature(factor: FloatArray, diagonal: FloatArray) -> Curvature:
    """Return ``factor.T @ factor`` plus a diagonal.

    Parameters
    ----------
    factor : (rows, n) float array
    diagonal : (n,) float array
        Not negative; where columns are dependent without it, a little is added.
    """
    F = factor[factor.any(axis=1)].T
    n, rank = F.shape
    if rank <= min(_LOW_RANK_SHARE * n, _MOST_COORDINATES) and diagonal.min() > _LEAST_DIAGONAL:
        return _LowRank(F, diagonal)
    return _Dense(F @ F.T + np.diag(diagonal))


class _Dense:
    dtype = np.dtype(np.float64)

    def __init__(self, H: FloatArray) -> None:
        values = np.linalg.eigvalsh(H)
        if len(H) and values[0] < _DEPENDENT_EIGENVALUE:
            H = H + _DEPENDENT_RIDGE * np.eye(len(H))
        self.largest = float(values[-1]) + _DEPENDENT_RIDGE if len(H) else 1.0
        self._H = H

    def times(self, z: FloatArray) -> FloatArray:
        return z @ self._H

    def near(self, z: Any) -> Any:
        return z @ self._H

    def systems(self) -> Systems:
        return self

    def solve(
        self, rows: IntArray, b: FloatArray, fixed: FloatArray, free: BoolArray
    ) -> FloatArray:
        from scipy.linalg.lapack import dposv  # frames of a performance are solved without

        H, rest = self._H, b - fixed @ self._H
        value = fixed.copy()
        for row, chosen in enumerate(free):
            index = np.flatnonzero(chosen)
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
        self._narrow = F.astype(self.dtype), diagonal.astype(self.dtype)
        values = np.linalg.eigvalsh(F.T @ F) if F.size else np.zeros(1)
        self.largest = float(values[-1] + diagonal.max())

    def times(self, z: FloatArray) -> FloatArray:
        return np.asarray((z @ self.F) @ self.F.T + z * self.diagonal)

    def near(self, z: Any) -> Any:
        F, diagonal = self._narrow
        return (z @ F) @ F.T + z * diagonal

    def systems(self) -> Systems:
        return _LowRankSystems(self)


class _LowRankSystems:
    def __init__(self, H: _LowRank) -> None:
        self._H = H
        self._known: dict[int, tuple[BoolArray, FloatArray]] = {}

    def solve(
        self, rows: IntArray, b: FloatArray, fixed: FloatArray, free: BoolArray
    ) -> FloatArray:
        from scipy.linalg.lapack import dposv

        H = self._H
        u = np.where(free, b - H.times(fixed), 0.0) / H.root
        y = u @ H.E
        last = nothing = np.zeros(len(H.E), np.bool_), np.eye(H.E.shape[1])
        for index, (row, chosen) in enumerate(zip(rows.tolist(), free, strict=True)):
            # This frame's products of the last exchange, those of the frame before, or none.
            starts = (self._known.get(row, last), nothing)
            start = min(starts, key=lambda start: np.count_nonzero(start[0] != chosen))
            last = self._known[row] = chosen, self._products(start, chosen)
            y[index] = dposv(last[1], y[index])[1]
        return np.asarray(np.where(free, (u - y @ H.E.T) / H.root, fixed))

    def _products(self, start: tuple[BoolArray, FloatArray], free: BoolArray) -> FloatArray:
        """Return ``I + E'E`` over the free rows, from that over others."""
        before, products = start
        changed = np.flatnonzero(before != free)
        moved = self._H.E[changed]
        sign = np.where(free[changed], 1.0, -1.0)[:, None]
        return np.asarray(products + moved.T @ (moved * sign))
