"""Learn how weights move a face from pairs, then ask which weights explain a motion.

The equation-solving way of Deng et al. (2006), section 7, without the character's geometry: its
basis is a straight line from the pairs' weights to their markers. It knows that shapes add up,
which regression from markers to weights has to learn; where the pairs do not tell two shapes
apart, only what is usual decides.
"""

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from usdface.core.arrays import FloatArray
from usdface.numerics.regression.linear_ridge import fit_linear_ridge
from usdface.numerics.solve.bounded_least_squares import minimise_bounded_quadratic

Solve = Literal["lstsq", "nnls", "bounded"]

_LEAST_NOISE = 0.05  # in the unit of the motion, mm: what optical systems resolve
_TOGETHER = 0.9  # of the pairs' covariance that is believed; the rest is each shape alone
_LEAST_VARIANCE = 0.01  # of a weight: a shape no pair shows may still move a little
_NEARLY_NOTHING = 1e-6  # share of the basis' size that keeps an undetermined weight at 0


@dataclass(frozen=True)
class ForwardModel:
    """``motion = weights @ basis + offset``, up to noise; and which weights are usual.

    Attributes
    ----------
    basis : (shapes, dimensions) float array
    offset : (dimensions,) float array
    noise : (dimensions,) float array
        Root mean square error of each dimension on pairs left out.
    weight_mean : (shapes,) float array
    weight_precision : (shapes, shapes) float array
        Inverse covariance of the pairs' weights, shrunk.
    """

    basis: FloatArray
    offset: FloatArray
    noise: FloatArray
    weight_mean: FloatArray
    weight_precision: FloatArray


def fit_forward_model(weights: ArrayLike, motion: ArrayLike) -> ForwardModel:
    """Fit the line, its ridge chosen for each dimension by leave-one-out.

    Parameters
    ----------
    weights : (pairs, shapes) array
    motion : (pairs, dimensions) array

    Raises
    ------
    ValueError
        If there are fewer than two pairs, or arrays do not pair up or are not finite.
    """
    w, m = np.asarray(weights, np.float64), np.asarray(motion, np.float64)
    if len(w) >= 2 and w.ndim == 2 and not np.ptp(w, axis=0).any():
        basis, offset = np.zeros((w.shape[1], m.shape[1])), m.mean(axis=0)
        left_out = m - offset  # the weights explain nothing
    else:
        line = fit_linear_ridge(w, m)
        basis, offset = line.coefficients, line.intercept - line.mean @ line.coefficients
        left_out = line.loo_residuals
    covariance = np.atleast_2d(np.cov(w.T))
    alone = np.diag(np.diag(covariance) + _LEAST_VARIANCE)
    return ForwardModel(
        basis=basis,
        offset=offset,
        noise=np.sqrt((left_out**2).mean(axis=0) + _LEAST_NOISE**2),
        weight_mean=w.mean(axis=0),
        weight_precision=np.asarray(
            np.linalg.inv(_TOGETHER * covariance + (1 - _TOGETHER) * alone), np.float64
        ),
    )


def solve_forward_model(
    model: ForwardModel, motion: ArrayLike, *, solve: Solve, ranges: ArrayLike, l1: float = 0.0
) -> FloatArray:
    """Return the weights that explain motions best.

    Parameters
    ----------
    model : ForwardModel
    motion : (frames, dimensions) array
    solve : {'lstsq', 'nnls', 'bounded'}
        Plain least squares, the smallest weights where several explain the same; not negative;
        within `ranges` and as usual as the noise allows: the most probable weights.
    ranges : (shapes, 2) array
        Lowest and highest weight of each shape.
    l1 : float, optional
        Of the bounded solve: how much the sum of absolute weights costs; leaves few shapes on.

    Returns
    -------
    (frames, shapes) float array

    Raises
    ------
    ValueError
        If arrays do not fit together, or the way to solve is unknown.
    """
    m, limits = np.asarray(motion, np.float64), np.asarray(ranges, np.float64)
    shapes, dimensions = model.basis.shape
    if m.ndim != 2 or m.shape[1] != dimensions or limits.shape != (shapes, 2):
        raise ValueError(
            f"motion {m.shape} and ranges {limits.shape} do not fit a basis of {shapes} shapes in "
            f"{dimensions} dimensions"
        )
    basis = model.basis / model.noise
    target = (m - model.offset) / model.noise
    if solve == "lstsq":
        return np.asarray(np.linalg.lstsq(basis.T, target.T)[0].T, np.float64)
    hessian, linear = basis @ basis.T, target @ basis.T
    if solve == "nnls":
        little = _NEARLY_NOTHING * max(float(np.trace(hessian)) / shapes, 1.0)
        return minimise_bounded_quadratic(
            hessian + little * np.eye(shapes),
            linear,
            lower=np.zeros(shapes),
            upper=np.full(shapes, np.inf),
        ).x
    if solve != "bounded":
        raise ValueError(f"solve must be 'lstsq', 'nnls' or 'bounded', got {solve!r}")
    return minimise_bounded_quadratic(
        hessian + model.weight_precision,
        linear + model.weight_mean @ model.weight_precision,
        lower=limits[:, 0],
        upper=limits[:, 1],
        l1=l1,
    ).x
