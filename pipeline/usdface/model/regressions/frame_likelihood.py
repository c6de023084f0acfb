"""Linearised likelihood of a frame's markers given its weights, for `frame_solve`."""

from collections.abc import Callable

import numpy as np

from usdface.core.arrays import FloatArray, RealArray, frame_blocks, single_precision

_CACHED_FRAMES = 16
"""Frames whose Jacobians stay in the cache between their products."""


class MarkerWeight:
    """``W``, the inverse covariance of the markers' errors of each frame.

    By Woodbury's identity ``(I + U'U)^-1 = I - U' C U, C = (I + U U')^-1``.
    """

    def __init__(self, precision: FloatArray, common: FloatArray) -> None:
        """Take ``1 / r``, 0 where a marker is not visible: (frames, markers) [mm^-2], and U."""
        self.root = np.repeat(np.sqrt(precision), 3, axis=1).astype(np.float32)
        self._common = single_precision(common)
        seen = precision > 0
        patterns, frames = seen[:1], np.zeros(len(seen), np.int64)
        if (seen != patterns).any():
            patterns, frames = np.unique(seen, axis=0, return_inverse=True)
        visible = common * np.repeat(patterns, 3, axis=1)[:, None]
        core = single_precision(np.linalg.inv(visible @ common.T + np.eye(len(common))))
        self.core = core[frames.ravel()] if len(core) > 1 else core

    def shared(self, rows: RealArray) -> RealArray:
        """Return ``x U'`` for each x of (frames, n, 3 markers)."""
        product = rows.reshape(-1, rows.shape[2]) @ self._common.T
        return np.asarray(product.reshape(*rows.shape[:2], -1))

    def __call__(self, rows: RealArray) -> RealArray:
        """Return ``W x`` for each x of (frames, ..., 3 markers)."""
        x = rows.reshape(len(self.root), -1, self.root.shape[1]) * self.root[:, None]
        x -= (self.shared(x) @ self.core) @ self._common
        x *= self.root[:, None]
        return np.asarray(x.reshape(rows.shape))


class FrameJacobians:
    """Linearised likelihood ``e' W e, e = residual - J'd``, with a Jacobian J for each frame.

    With the columns of J divided by ``sqrt r``, ``J W J' = J J' - (J U') C (J U')'``.
    """

    def __init__(self, slope: RealArray, weight: MarkerWeight) -> None:
        self._slope, self._weight = slope, weight
        self._normal = np.empty((*slope.shape[:2], slope.shape[1]), dtype=np.float32)
        core = np.broadcast_to(weight.core, (len(slope), *weight.core.shape[1:]))
        for block in frame_blocks(len(slope), frames=_CACHED_FRAMES):
            rows = slope[block] * weight.root[block, None]
            shared = weight.shared(rows)
            normal = np.matmul(rows, rows.transpose(0, 2, 1), out=self._normal[block])
            normal -= shared @ core[block] @ shared.transpose(0, 2, 1)
        self.diagonal = np.einsum("fss->fs", self._normal)

    def gradient(self, residual: RealArray) -> RealArray:
        """Return ``J W residual``, half the negative gradient at d = 0: (frames, shapes)."""
        weighted = self._weight(residual)
        return np.asarray((self._slope @ weighted[:, :, None])[:, :, 0])

    def displacements(self, step: RealArray) -> RealArray:
        """Return the displacement of the markers for a step of the weights."""
        return np.asarray((step[:, None] @ self._slope)[:, 0])

    def hessian(self, precision: RealArray) -> RealArray:
        """Return ``J W J' + diag(precision)`` of each frame."""
        system = self._normal.copy()
        diagonal = np.arange(system.shape[1])
        system[:, diagonal, diagonal] += precision
        return system

    def product(self, precision: RealArray) -> Callable[[RealArray], RealArray]:
        """Return the product of rows (frames, shapes) with `hessian`."""
        system = self.hessian(precision)
        return lambda rows: (system @ rows[:, :, None])[:, :, 0]


class SharedJacobian:
    """The same with one Jacobian for all frames, and no explicit Hessian."""

    def __init__(self, slope: RealArray, weight: MarkerWeight) -> None:
        self._slope, self._weight = slope, weight
        self.diagonal = weight.root**2 @ (slope**2).T  # an upper bound, which scales the steps

    def gradient(self, residual: RealArray) -> RealArray:
        """As of `FrameJacobians`."""
        return np.asarray(self._weight(residual) @ self._slope.T)

    def displacements(self, step: RealArray) -> RealArray:
        """As of `FrameJacobians`."""
        return np.asarray(step @ self._slope)

    def hessian(self, _precision: RealArray) -> None:
        """Return None: it would be large."""
        return None

    def product(self, precision: RealArray) -> Callable[[RealArray], RealArray]:
        """As of `FrameJacobians`."""
        return lambda rows: self.gradient(rows @ self._slope) + precision * rows
