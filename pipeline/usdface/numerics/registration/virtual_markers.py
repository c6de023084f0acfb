"""Virtual markers: points of a character's surface that correspond to a performer's markers.

Deng et al. (2006) chose vertices by hand; `model.placement` places them automatically.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike
from scipy import sparse

from usdface.core.arrays import FloatArray, IntArray
from usdface.numerics.rigid.pose_error import ExpressionMotion, PoseErrors, expression_motion

LARGEST_NOISE_SCALE = 10.0
"""Noise scale from which a placement is wrong, or the rig lacks shapes of a part: of unlabelled
set-ups of `poe bench random_captures`, right ones have 1.5 to 9 (one 12), wrong ones 8.6 to 21."""


@dataclass(frozen=True)
class VirtualMarkers:
    """A performer's markers on a character's surface.

    ``motion_scale * (displacements @ rotation.T)`` maps the performer's displacements to the
    character.
    """

    points: IntArray
    """(markers, 3): three points of the surface for each marker."""
    weights: FloatArray
    """(markers, 3): barycentric, sum 1."""
    motion_scale: float
    """Amplitude of the character's motion over the performer's. One number for all axes: the depth
    of a face does not predict the amplitude of its motion."""
    rotation: FloatArray
    """(3, 3): from the performer's space to the character's; proper, determinant +1."""

    def places(self, surface: FloatArray) -> FloatArray:
        """Return the positions of the markers for given points of the surface: (markers, 3)."""
        return np.einsum("mk,mkc->mc", self.weights, surface[self.points])


def marker_deltas(virtual: VirtualMarkers, offsets: sparse.sparray) -> FloatArray:
    """Return displacements of the markers by each shape, or key of a shape: (shapes, markers, 3).

    Parameters
    ----------
    offsets : (shapes, 3 * points) sparse array
        Of the surface on which the markers were placed.
    """
    found = deltas_at(sparse.csc_array(offsets), virtual.points, virtual.weights).toarray()
    by_axis = np.asarray(found, float).reshape(len(found), 3, -1)
    return np.ascontiguousarray(np.moveaxis(by_axis, 1, 2))


def character_motion(
    virtual: VirtualMarkers, positions: ArrayLike, neutral: ArrayLike
) -> FloatArray:
    """Return a performer's displacements in the character's space and size.

    Returns (frames, markers, 3), the left side of the blendshape equation [mm].

    Parameters
    ----------
    positions : (frames, markers, 3) array
        Stabilised [mm].
    neutral : (markers, 3) array
        In the same space.
    """
    moved = np.asarray(positions, float) - np.asarray(neutral, float)
    return np.asarray(virtual.motion_scale * (moved @ virtual.rotation.T), float)


def motion_by_rig(
    virtual: VirtualMarkers, deltas: FloatArray, neutral: FloatArray, *, rigid: Sequence[int]
) -> ExpressionMotion:
    """Return the distribution of the displacements of markers at `virtual` on a character.

    Parameters
    ----------
    deltas : (shapes, markers, 3) float array
        Displacements of the virtual markers by each shape in full [mm].
    neutral : (markers, 3) float array
        [mm]
    rigid : sequence of int
        Markers at which the stabilisation leaves no error.
    """
    basis = deltas @ virtual.rotation / virtual.motion_scale
    unknown = np.zeros((0, len(basis)))
    return expression_motion(basis, unknown, neutral, rigid=np.array(rigid, np.int64))


def certain_errors(errors: PoseErrors) -> PoseErrors:
    """Return errors of poses; none where the residuals tell that the markers are elsewhere."""
    return replace(errors, size_mm=errors.size_mm * (errors.noise_scale < LARGEST_NOISE_SCALE))


def deltas_at(
    matrix: sparse.csc_array,
    corners: IntArray,
    weights: FloatArray,
    *,
    axes: FloatArray | None = None,
) -> sparse.csr_array:
    """Return the shapes' offsets at points inside triangles, axis by axis: (shapes, 3 * n).

    Parameters
    ----------
    matrix : (shapes, 3 * points) sparse array
    corners : (n, 3) int array
    weights : (n, 3) float array
        Barycentric.
    axes : (3, 3) float array, optional
        Axes of the returned coordinates, in rows; those of the points unless given.
    """
    samples, turn = len(corners), np.eye(3) if axes is None else axes
    rows = 3 * corners[:, :, None, None] + np.arange(3)  # by sample, corner, axis there and here
    columns = np.arange(samples)[:, None, None, None] + samples * np.arange(3)[:, None]
    values = weights[:, :, None, None] * turn
    used = np.broadcast_to(turn != 0, values.shape)
    rows, columns = (np.broadcast_to(each, values.shape)[used] for each in (rows, columns))
    pick = sparse.csc_array((values[used], (rows, columns)), (matrix.shape[1], 3 * samples))
    return sparse.csr_array(matrix @ pick)
