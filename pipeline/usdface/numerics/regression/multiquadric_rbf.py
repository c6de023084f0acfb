"""Hardy's multiquadric through example pairs: Song et al. (2011), section 4.1, eq. 3-4.

The softness of each centre is its distance to the nearest other centre.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from usdface.core.arrays import FloatArray, nearest_distances
from usdface.numerics.regression.linear_ridge import check_examples
from usdface.numerics.regression.rbf_ridge import choose_ridge, evaluate_network, rotate

_LEAST_CONDITION = 1e-13
"""Least reciprocal condition number for interpolation."""


@dataclass(frozen=True)
class Multiquadric:
    """``F(x) = sum_j coefficients[j] sqrt(|x - centres[j]|^2 + softness[j]^2)``."""

    centres: FloatArray
    """(n, d)"""
    softness: FloatArray
    """(n,): the paper's s_j, in the unit of the centres."""
    coefficients: FloatArray
    """(n, s): the paper's M_RBF."""
    ridge: FloatArray
    """(s,): penalty of squared coefficients; 0 for interpolation."""


def nearest_softness(centres: FloatArray) -> FloatArray:
    """Return each centre's distance to the nearest other centre that does not coincide with it."""
    from scipy.spatial.distance import cdist  # imported late: it takes half a second

    nearest = nearest_distances(cdist(centres, centres))
    if not np.isfinite(nearest).all():
        raise ValueError(f"all {len(centres)} centres coincide; no distance between them")
    return nearest


def multiquadric_design(
    points: FloatArray, centres: FloatArray, softness: FloatArray
) -> FloatArray:
    """Evaluate every basis function at every point: (points, centres) float array."""
    from scipy.spatial.distance import cdist  # imported late: it takes half a second

    design: FloatArray = cdist(points, centres, "sqeuclidean")
    design += softness**2
    np.sqrt(design, out=design)
    return design


def fit_multiquadric(
    centres: ArrayLike, outputs: ArrayLike, *, smooth: bool = False
) -> Multiquadric:
    """Fit the network to pairs; each pair is a centre, of the published `nearest_softness`.

    Parameters
    ----------
    centres : (n, d) array
        Inputs of the pairs.
    outputs : (n, s) array
    smooth : bool
        Penalise squared coefficients, with penalties by generalised cross-validation, instead of
        interpolation: for pairs with noise.
    """
    C, Y = np.asarray(centres, np.float64), np.asarray(outputs, np.float64)
    check_examples(C, Y)
    s = nearest_softness(C)
    design = multiquadric_design(C, C, s)
    if not smooth:
        from scipy.spatial.distance import cdist  # imported late: it takes half a second

        equal = np.argwhere(np.triu(cdist(C, C) == 0.0, 1))
        if len(equal):
            first, second = equal[0]
            raise ValueError(
                f"centres {first} and {second} coincide, so their pairs cannot both be met; "
                "leave one out, or fit with smooth=True"
            )
        coefficients, _, rank, singular = np.linalg.lstsq(design, Y, rcond=_LEAST_CONDITION)
        if rank < len(design):
            raise ValueError(
                f"the pairs cannot be met exactly: rank {rank} of {len(design)}, smallest share of "
                f"a singular value {singular[-1] / singular[0]:.1e}; fit with smooth=True"
            )
        return Multiquadric(C, s, np.asarray(coefficients, np.float64), np.zeros(Y.shape[1]))
    rotated = rotate(design, Y)
    ridge = choose_ridge(rotated)
    gain = rotated.singular[:, None] / (rotated.singular[:, None] ** 2 + ridge)
    return Multiquadric(C, s, rotated.right.T @ (gain * rotated.outputs), ridge)


def predict_multiquadric(
    points: FloatArray, centres: FloatArray, softness: FloatArray, coefficients: FloatArray
) -> FloatArray:
    """Evaluate the network (eq. 4) at points (f, d); see `evaluate_network`."""
    return evaluate_network(
        lambda some: multiquadric_design(some, centres, softness), coefficients, points
    )
