"""Hardy's multiquadric under any distance: W06, "Geodesic manifold distances".

``F(x) = sum_i w_i sqrt(d(x, i)^2 + s_i^2)``: one centre at each marker, which it meets exactly.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from usdface.core.arrays import Float32Array, FloatArray
from usdface.numerics.regression.rbf_ridge import choose_ridge, rotate

SOFTNESS = 0.1
"""Stiffness over the distance to the nearest marker. Song's and Hardy's 1 leaves the matrix of a
geodesic distance nearly singular (errors of centimetres); without any the surface has creases."""

_SINGULAR = 1e-12
_COLUMNS = 1 << 15


@dataclass(frozen=True)
class DistanceMultiquadric:
    """A fitted network as an operator: displacements of markers in, weights of centres out.

    Attributes
    ----------
    stiffness : (markers,) float array
        The paper's sigma_i [mm].
    inverse : (markers, markers) float array
        Weights are ``inverse @ displacements``.
    """

    stiffness: FloatArray
    inverse: FloatArray


def nearest_stiffness(between: FloatArray) -> FloatArray:
    """Return each marker's distance to the nearest other one that is not at its place [mm]."""
    others = np.where(between > 0, between, np.inf)
    nearest: FloatArray = others.min(axis=1)
    if not np.isfinite(nearest).all():
        raise ValueError("all markers sit at one place; no distance between them")
    return nearest


def multiquadric_values(distances: NDArray[np.floating], stiffness: FloatArray) -> FloatArray:
    """Evaluate every centre at every point: (points, markers) float array."""
    squared = np.asarray(distances, np.float64).T ** 2
    squared += stiffness**2
    return np.asarray(np.sqrt(squared), np.float64)


def fit_distance_multiquadric(
    between: FloatArray,
    displacements: FloatArray | None = None,
    *,
    stiffness: FloatArray | float | None = None,
) -> DistanceMultiquadric:
    """Fit the network that meets every marker, or, given noisy examples, nearly.

    Parameters
    ----------
    between : (markers, markers) float array
        [mm]
    displacements : (markers, examples) float array, optional
        Smooth instead of meeting every marker: one ridge penalty for all, the median of those that
        generalised cross-validation chooses for the examples.
    stiffness : float or (markers,) array, optional
        [mm]; by default `SOFTNESS` of the distance to the nearest other marker.

    Raises
    ------
    ValueError
        If two markers sit at one place, or a stiffness is negative.
    """
    soft = (
        SOFTNESS * nearest_stiffness(between)
        if stiffness is None
        else np.asarray(stiffness, np.float64)
    )
    soft = np.broadcast_to(soft, (len(between),)).copy()
    if not (soft >= 0).all():
        raise ValueError("stiffness must be 0 mm or more")
    design = multiquadric_values(between, soft)
    left, singular, right = np.linalg.svd(design)
    if singular[-1] < _SINGULAR * singular[0]:
        apart = np.where(np.eye(len(between), dtype=np.bool_), np.inf, between)
        i, j = np.unravel_index(int(apart.argmin()), apart.shape)
        raise ValueError(
            f"markers {i} and {j} are {apart[i, j]:.3g} mm apart and cannot both be met; "
            "leave one out"
        )
    ridge = 0.0
    if displacements is not None:
        ridge = float(np.median(choose_ridge(rotate(design, displacements))))
    gain = singular / (singular**2 + ridge)
    return DistanceMultiquadric(soft, (right.T * gain) @ left.T)


def multiquadric_fields(
    model: DistanceMultiquadric, distances: NDArray[np.floating]
) -> Float32Array:
    """How each point follows each marker.

    Parameters
    ----------
    model : DistanceMultiquadric
    distances : (markers, points) float array
        [mm]

    Returns
    -------
    (points, markers) float32 array
        Displacements of points are ``fields @ displacements``.
    """
    out = np.empty((distances.shape[1], len(distances)), np.float32)
    for start in range(0, len(out), _COLUMNS):
        part = slice(start, start + _COLUMNS)
        out[part] = multiquadric_values(distances[:, part], model.stiffness) @ model.inverse
    return out
