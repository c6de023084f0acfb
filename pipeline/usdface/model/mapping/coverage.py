"""How far references show what a frame does: its coverage, by region of the face.

The markers that belong to a region are a point x, displacements from the neutral [mm]. What weights
they stand for is taken as unknown, with the covariance of `design_kernel` between two points: the
linear part says that faces answer mostly in proportion, the radial one that combinations are known
only near those seen. References leave of a frame's variance the share v; its coverage is

    1 - sqrt(v)

1 where references show what the frame does, 0 where they say nothing of it. Displacements count by
what the rig's shapes do to the region at full weight, not by how far the references' takes went:
brows that hardly move in any reference are then a region that no reference shows.

A mapping measures where its forward model puts the markers of its references; references that are
not trained on yet, where their markers are, beside what the rig's shapes do at these places.
"""

from dataclasses import dataclass

import numpy as np

from usdface.core.arrays import FloatArray, IntArray
from usdface.numerics.regression.design_kernel import KEY_VARIANCE, DesignKernel, left_over

UNCOVERED_SHARE = 0.25
"""Share of a face's motion left to guess at which a frame counts as not covered."""

_LEAST_SHAPE_SHARE = 0.02
"""Of the largest squared motion in a region: what shapes of other regions do there does not set
its scale."""


@dataclass(frozen=True)
class _RegionCoverage:
    """What the references show of one region."""

    markers: IntArray
    """(m,): those of the region."""
    pairs: FloatArray
    """(pairs, 3 m): displacements of the references [mm]."""
    kernel: DesignKernel


class CoverageModel:
    """What references show of each region; ready for many frames.

    Parameters
    ----------
    basis : (shapes, markers, 3) float array
        What each shape at 1 does to the markers [mm].
    pairs : (pairs, markers, 3) float array
        Displacements of the references' markers from their neutral [mm].
    membership : (regions, markers) float array
        1 where a marker belongs to a region; the whole face first.
    """

    def __init__(self, basis: FloatArray, pairs: FloatArray, membership: FloatArray) -> None:
        self._regions = [
            self._region(basis, pairs, np.flatnonzero(members)) for members in membership
        ]

    @staticmethod
    def _region(basis: FloatArray, pairs: FloatArray, markers: IntArray) -> _RegionCoverage | None:
        """Return what is shown of some markers; None where there are none that shapes move."""
        size2 = (basis[:, markers] ** 2).sum(axis=(1, 2))
        if not size2.max(initial=0.0) > 0:
            return None
        full2 = float(size2[size2 > _LEAST_SHAPE_SHARE * size2.max()].mean())
        rows = pairs[:, markers].reshape(len(pairs), 3 * len(markers))
        return _RegionCoverage(markers, rows, DesignKernel.for_size(full2))

    def measure(self, displacements: FloatArray) -> FloatArray:
        """Return the coverage of frames.

        Parameters
        ----------
        displacements : (frames, markers, 3) float array
            From the neutral, all markers [mm].

        Returns
        -------
        (frames, regions) float array
            [0-1]; 1 in regions without markers, of which there is nothing to cover.
        """
        covered = np.ones((len(displacements), len(self._regions)))
        for column, region in enumerate(self._regions):
            if region is not None:
                rows = displacements[:, region.markers].reshape(len(displacements), -1)
                left = left_over(region.kernel, region.pairs, rows, noise=KEY_VARIANCE)
                covered[:, column] = 1 - np.sqrt(left)
        return covered

    def growth(self, further: FloatArray, displacements: FloatArray) -> FloatArray:
        """Return the mean coverage of the whole face as references are known one by one.

        Parameters
        ----------
        further : (n, markers, 3) float array
            Displacements of frames that would join the references, in this order [mm].
        displacements : (frames, markers, 3) float array
            Of the frames over which the mean is taken [mm].

        Returns
        -------
        (pairs + n + 1,) float array
            With none, one, two ... of them [0-1]: one factorisation for all.
        """
        face = self._regions[0]
        if face is None:
            raise ValueError("no shape moves a marker")
        added = further[:, face.markers].reshape(len(further), face.pairs.shape[1])
        rows = displacements[:, face.markers].reshape(len(displacements), -1)
        known = np.concatenate([face.pairs, added])
        if not len(known):
            return np.zeros(1)
        factor = np.linalg.cholesky(face.kernel(known, known) + KEY_VARIANCE * np.eye(len(known)))
        explained = np.cumsum(np.linalg.solve(factor, face.kernel(known, rows)) ** 2, axis=0)
        left = np.maximum(1 - explained / face.kernel.diagonal(rows), 0.0)
        return np.concatenate([[0.0], 1 - np.sqrt(left).mean(axis=1)])
