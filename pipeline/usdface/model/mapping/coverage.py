"""Coverage of frames by the references, per region of the face.

The weights of a region are modelled as a Gaussian process of the displacements x of its markers
[mm], with the covariance of `design_kernel`: a linear term, as weights are nearly proportional to
displacements, and a radial one, by which combinations are known only near those in the references.
With v the posterior over the prior variance at a frame, given the references, its coverage is ::

    1 - sqrt(v)

1 where the references determine the weights, 0 where they carry no information. The kernel is
scaled by the displacements of the rig's shapes at full weight in the region, not by those of the
takes: a region that hardly moves in the references is thus not covered by them.

A mapping evaluates the displacements of its references by the forward model; references without a
mapping use the captured ones, and the rig's displacements at the markers.
"""

from dataclasses import dataclass

import numpy as np

from usdface.core.arrays import FloatArray, IntArray
from usdface.numerics.regression.reference_design import (
    DesignKernel,
    cholesky_factor,
    posterior_shares,
)

LEAST_COVERAGE = 0.75
"""Coverage from which a frame counts as covered: ``sqrt(v)`` of 1/4 or less."""

_MIN_SHAPE_SHARE = 0.02
"""Squared motion in a region, relative to the largest, from which a shape contributes to its scale:
shapes of other regions do not."""


@dataclass(frozen=True)
class _RegionCoverage:
    """References and kernel of one region."""

    markers: IntArray
    """(m,): indices of the region's markers."""
    pairs: FloatArray
    """(pairs, 3 m): displacements of the references [mm]."""
    kernel: DesignKernel
    whitening: FloatArray
    """Inverse of the Cholesky factor of the references' covariance."""


class CoverageModel:
    """Coverage by references, prepared for many frames.

    Parameters
    ----------
    basis : (shapes, markers, 3) float array
        Displacements of the markers by each shape at 1 [mm].
    pairs : (pairs, markers, 3) float array
        Displacements of the references' markers from their neutral [mm].
    membership : (regions, markers) float array
        1 where a marker belongs to a region, else 0; the whole face first.
    """

    def __init__(self, basis: FloatArray, pairs: FloatArray, membership: FloatArray) -> None:
        self._regions = [
            self._region(basis, pairs, np.flatnonzero(members)) for members in membership
        ]

    @staticmethod
    def _region(basis: FloatArray, pairs: FloatArray, markers: IntArray) -> _RegionCoverage | None:
        """Return the coverage model of some markers; None if no shape moves them."""
        size2 = (basis[:, markers] ** 2).sum(axis=(1, 2))
        if not size2.max(initial=0.0) > 0:
            return None
        full2 = float(size2[size2 > _MIN_SHAPE_SHARE * size2.max()].mean())
        rows = pairs[:, markers].reshape(len(pairs), 3 * len(markers))
        kernel = DesignKernel.for_size(full2)
        whitening = np.asarray(np.linalg.inv(cholesky_factor(kernel, rows)))
        return _RegionCoverage(markers, rows, kernel, whitening)

    def measure(self, displacements: FloatArray) -> FloatArray:
        """Return the coverage of frames.

        Returns (frames, regions) [0-1], of displacements from the neutral, (frames, markers, 3)
        [mm]; 1 in regions without markers.
        """
        coverage = np.ones((len(displacements), len(self._regions)))
        for column, region in enumerate(self._regions):
            if region is not None:
                rows = displacements[:, region.markers].reshape(len(displacements), -1)
                white = region.whitening @ region.kernel(region.pairs, rows)
                explained = np.einsum("nf,nf->f", white, white) / region.kernel.diagonal(rows)
                coverage[:, column] = 1 - np.sqrt(np.maximum(1 - explained, 0.0))
        return coverage

    def growth(self, further: FloatArray, displacements: FloatArray) -> FloatArray:
        """Return the mean coverage of the whole face as a function of the number of references.

        Returns (pairs + n + 1,), for the first 0, 1, 2 ... references [0-1].

        Parameters
        ----------
        further : (n, markers, 3) float array
            Displacements of frames appended to the references [mm].
        displacements : (frames, markers, 3) float array
            Frames over which the mean is taken [mm].
        """
        face = self._regions[0]
        if face is None:
            raise ValueError("no shape moves a marker")
        added = further[:, face.markers].reshape(len(further), face.pairs.shape[1])
        rows = displacements[:, face.markers].reshape(len(displacements), -1)
        shares = posterior_shares(face.kernel, np.concatenate([face.pairs, added]), rows)
        return np.asarray(1 - np.sqrt(shares).mean(axis=1))
