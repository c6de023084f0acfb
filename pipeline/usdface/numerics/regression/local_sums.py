"""Sums of Gaussians in spaces of their own, for many points: what regional processes come to.

Every output has its own features, so nothing of one kernel serves another; all that can be done is
to lay them side by side, so that a block of points takes few calls and not some per output.
Duals that are small let a kernel be rounded, at half the time.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np

from usdface.core.arrays import FloatArray
from usdface.numerics.array_namespace import CPU, ArrayDevice, namespace_of

SINGLE_NORM = 1.5
"""Norm of duals up to which a kernel may be evaluated in single precision: rounding moved sums by
at most 2.6e-7 times that norm on mappings of 50 and 100 pairs, 4e-7 of a weight."""

BLOCK_VALUES = 1 << 17
"""Kernel values at once: enough that calls are cheap. Larger, arrays come fresh from the system
each time, which costs more than it saves."""


@dataclass(frozen=True)
class _Lot:
    """Kernels of one precision; arrays are on the device.

    Attributes
    ----------
    projection : (k, D + 1, d + 2) float array
        From coordinates and a 1 to features, a 0 and the 1 again: the 0 makes room for the squared
        norm of that row, so that nothing is copied to put it there.
    operand : (k, d + 2, n) float array
        Of features, the squared norm of the row and 1, makes exponents.
    ones : (d + 2, 1) float array
        Sums squares, as a product: quicker than a sum along rows so short.
    dual : (k, n, m) float array
        Of the m outputs of each kernel.
    """

    projection: Any
    operand: Any
    ones: Any
    dual: Any

    def sums(self, points: Any, some: slice) -> Any:
        """Evaluate some of the kernels: (kernels, f, m) float array."""
        xp = namespace_of(points)
        rows = xp.matmul(points, self.projection[some, :, :])
        rows[:, :, -2] = xp.matmul(rows * rows, self.ones)[:, :, 0]
        values = xp.exp(xp.matmul(rows, self.operand[some, :, :]))
        return xp.matmul(values, self.dual[some, :, :])


class LocalSums:
    """``sum_i dual[i, j] exp(exponent[j, i] |x projection[j] - centres[j, i]|^2)`` for each j.

    Parameters
    ----------
    projection : (D, d) or (s, D, d) float array
        From coordinates to the features of all outputs, or of each.
    centres : (n, d) or (s, n, d) float array
    exponent : (1, 1), (s, 1) or (1, n) float array
        Negative; of all kernels, of each output's, or of each centre's.
    dual : (n, s) float array
    single : bool
        Evaluate in single precision where `SINGLE_NORM` allows it.
    device : ArrayDevice
        Where points will be.
    """

    def __init__(
        self,
        projection: FloatArray,
        centres: FloatArray,
        exponent: FloatArray,
        dual: FloatArray,
        *,
        single: bool = False,
        device: ArrayDevice = CPU,
    ) -> None:
        outputs = dual.shape[1]
        if projection.ndim == 2:
            projection, centres, duals = projection[None], centres[None], dual[None]
        else:
            duals = dual.T[:, :, None]
        squares = np.einsum("knd,knd->kn", centres, centres)[:, :, None]
        # a row's squares are those of its features and of the 1 beside them
        operand = np.concatenate([-2.0 * centres, np.ones_like(squares), squares - 1.0], axis=2)
        operand *= exponent[:, :, None]
        _, inputs, features = projection.shape
        widened = np.zeros((len(projection), inputs + 1, features + 2))
        widened[:, :-1, :-2] = projection
        widened[:, -1, -1] = 1.0
        norms = np.linalg.norm(duals, axis=1).max(axis=1)
        rounded = (norms <= SINGLE_NORM) & single
        self._device = device
        self._lots: list[_Lot] = []
        columns = np.arange(outputs).reshape(len(duals), -1)
        told: list[int] = []
        for kind, chosen in (("float32", rounded), ("float64", ~rounded)):
            own = np.flatnonzero(chosen & (norms > 0))
            if len(own):
                parts = (
                    widened[own],
                    operand[own].transpose(0, 2, 1),
                    np.ones((features + 2, 1)),
                    duals[own],
                )
                told += columns[own].ravel().tolist()
                self._lots.append(
                    _Lot(*(device.put(np.ascontiguousarray(each), dtype=kind) for each in parts))
                )
        # Where each output stands among those of the lots; those of no kernel share a zero.
        place = np.full(outputs, len(told))
        place[told] = np.arange(len(told))
        self._place = device.put(place)

    def __call__(self, points: Any) -> Any:
        """Evaluate the sums.

        Parameters
        ----------
        points : (f, D) float array
            On the device, in double precision.

        Returns
        -------
        (f, s) float array
        """
        xp = namespace_of(points)
        count, kind = points.shape[0], points.dtype
        device = self._device.device
        one = xp.ones((count, 1), dtype=kind, device=device)
        points = xp.concat([points, one], axis=1)
        found = []
        for lot in self._lots:
            own = xp.astype(points, lot.dual.dtype)[None, :, :]
            kernels, pairs, outputs = lot.dual.shape
            together = max(BLOCK_VALUES // max(count * pairs, 1), 1)
            sums = xp.concat(
                [
                    lot.sums(own, slice(start, min(start + together, kernels)))
                    for start in range(0, kernels, together)
                ]
            )
            flat = xp.permute_dims(sums, (1, 0, 2))
            found.append(xp.astype(xp.reshape(flat, (count, kernels * outputs)), kind))
        found.append(xp.zeros((count, 1), dtype=kind, device=device))
        return xp.take(xp.concat(found, axis=1), self._place, axis=1)
