"""Hardy's multiquadric under any distance: W06, "Geodesic manifold distances".

``F(x) = sum_i w_i sqrt(d(x, i)^2 + s_i^2)``: one centre at each marker, where F is exact.
"""

from dataclasses import dataclass

import numpy as np

from usdface.core.arrays import Float32Array, FloatArray, RealArray

STIFFNESS_SHARE = 0.1
"""Stiffness s_i over the distance to the nearest marker. Song's and Hardy's 1 leaves the matrix of
a geodesic distance nearly singular (errors of centimetres); 0 leaves creases at the markers."""

_LEAST_CONDITION = 1e-12
"""Smallest over largest singular value below which two markers count as one."""

_BLOCK_POINTS = 1 << 15
"""Points evaluated in double precision at once."""


@dataclass(frozen=True)
class DistanceMultiquadric:
    """A fitted network as an operator: displacements of markers in, weights of centres out."""

    stiffness: FloatArray
    """(markers,): s_i [mm]; the paper's sigma_i."""
    inverse: FloatArray
    """(markers, markers): weights are ``inverse @ displacements``."""


def nearest_stiffness(between: FloatArray) -> FloatArray:
    """Return `STIFFNESS_SHARE` of each marker's distance to the nearest other place [mm]."""
    nearest: FloatArray = np.where(between > 0, between, np.inf).min(axis=1)
    if not np.isfinite(nearest).all():
        raise ValueError("all markers sit at one place; no distance between them")
    return STIFFNESS_SHARE * nearest


def fit_distance_multiquadric(between: FloatArray, stiffness: FloatArray) -> DistanceMultiquadric:
    """Fit the network that meets every marker.

    Parameters
    ----------
    between : (markers, markers) float array
        [mm]
    stiffness : (markers,) float array
        s_i [mm], by default of `nearest_stiffness`.

    Raises
    ------
    ValueError
        If two markers sit at one place.
    """
    left, singular, right = np.linalg.svd(_values(between, stiffness))
    if singular[-1] < _LEAST_CONDITION * singular[0]:
        others = np.where(np.eye(len(between), dtype=np.bool_), np.inf, between)
        i, j = np.unravel_index(int(others.argmin()), others.shape)
        raise ValueError(
            f"markers {i} and {j} are {others[i, j]:.3g} mm apart and cannot both be met; "
            "leave one out"
        )
    gain = 1.0 / singular
    return DistanceMultiquadric(stiffness, (right.T * gain) @ left.T)


def multiquadric_fields(model: DistanceMultiquadric, distances: RealArray) -> Float32Array:
    """Return how each point follows each marker.

    Parameters
    ----------
    distances : (markers, points) float array
        [mm]

    Returns
    -------
    (points, markers) float32 array
        Displacements of points are ``fields @ displacements``.
    """
    out = np.empty((distances.shape[1], len(distances)), np.float32)
    for start in range(0, len(out), _BLOCK_POINTS):
        part = slice(start, start + _BLOCK_POINTS)
        out[part] = _values(distances[:, part], model.stiffness) @ model.inverse
    return out


def _values(distances: RealArray, stiffness: FloatArray) -> FloatArray:
    """Evaluate every centre at every point: (points, markers) float array."""
    squared = np.asarray(distances, np.float64).T ** 2
    squared += stiffness**2
    return np.asarray(np.sqrt(squared), np.float64)
