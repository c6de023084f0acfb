"""Learn from tuned pairs what each shape means on this performer, then solve with that.

Virtual markers say what a shape does to the character. A performer's skin goes less far, in other
directions, and their neutral face is nobody's zero. A few frames whose weights an animator tuned
correct all of it: the registered deltas are the prior, the pairs the evidence, marker by marker.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from usdface.numerics.solve.bounded_least_squares import minimise_bounded_quadratic

FloatArray = NDArray[np.float64]

_NOISE_MM = 0.3  # of a marker coordinate, cleaned
_NEUTRAL_MM = 3.0  # how far a performer's neutral may be from the character's
_STRETCHES = ((0.3, 0.3), (1.0, 0.3), (1.0, 1.0), (2.0, 1.0))
_FOLDS = 5
_FOLDED_PAIRS = 150  # more pairs choose no better, and each marker inverts its own matrix
_LEAST_NOISE_MM = 0.05
_TOGETHER = 0.7  # of the pairs' covariance that is believed; the rest is each shape alone
_LEAST_VARIANCE = 0.01  # of a weight: a shape no pair shows may still move a little


@dataclass(frozen=True)
class CalibratedBasis:
    """What shapes do to one performer's markers, and which weights are usual.

    Attributes
    ----------
    deltas : (shapes, markers, 3) float array
        [mm]
    offset : (markers, 3) float array
        Motion of the markers where all weights are 0 [mm].
    noise_mm : (markers,) float array
        Root mean square error of each marker coordinate on pairs left out; infinite for markers
        without trust.
    weight_mean : (shapes,) float array
    weight_precision : (shapes, shapes) float array
        Inverse covariance of the pairs' weights, shrunk.
    stretch, spread : float
        How far deltas were allowed to change: in proportion to themselves, and to what the other
        shapes do to the same marker.
    weight_rmse : float
        Of pairs left out, with that choice; NaN when it was given or there are too few pairs.
    """

    deltas: FloatArray
    offset: FloatArray
    noise_mm: FloatArray
    weight_mean: FloatArray
    weight_precision: FloatArray
    stretch: float
    spread: float
    weight_rmse: float


def calibrate_deltas(
    deltas: ArrayLike,
    motion: ArrayLike,
    weights: ArrayLike,
    *,
    stretch: tuple[float, float] | None = None,
    marker_trust: ArrayLike | None = None,
    ranges: ArrayLike | None = None,
    gram: ArrayLike | None = None,
) -> CalibratedBasis:
    """Estimate each shape's marker deltas from tuned pairs, pulled towards the registered ones.

    For marker m, ``motion = offset_m + sum_i w_i delta_im + noise`` with the Gaussian prior
    ``delta_im ~ N(registered_im, stretch^2 (|registered_im|^2 + spread^2 mean_j
    |registered_jm|^2))``.

    Parameters
    ----------
    deltas : (shapes, markers, 3) array
        At the virtual markers, as registered [mm].
    motion : (pairs, markers, 3) array
        Displacements of the tuned frames, in the character's space and proportions [mm].
    weights : (pairs, shapes) array
        What the animator wants there.
    stretch : (stretch, spread), optional
        Chosen by leaving pairs out unless given: the choice that solves their weights best.
    marker_trust : (markers,) array, optional
        0 leaves a marker out, such as the rigid ones; else its inverse relative variance.
    ranges : (shapes, 2) array, optional
        Limits of the weights, 0 to 1 unless given.
    gram : (shapes, shapes) array, optional
        What a weight error does to the surface (`BlendShapes.gram`): the choice then minimises
        millimetres rather than weights.

    Raises
    ------
    ValueError
        If the arrays do not fit together or hold fewer than 2 pairs.
    """
    D, m, w = np.asarray(deltas, float), np.asarray(motion, float), np.asarray(weights, float)
    trust = np.ones(D.shape[1]) if marker_trust is None else np.asarray(marker_trust, float)
    if m.shape[1:] != D.shape[1:] or w.shape != (len(m), len(D)) or trust.shape != D.shape[1:2]:
        raise ValueError(
            f"deltas {D.shape}, motion {m.shape}, weights {w.shape} and marker_trust "
            f"{trust.shape} do not fit together"
        )
    if len(m) < 2:
        raise ValueError(f"calibration needs at least 2 tuned pairs, got {len(m)}")
    if not np.isfinite(m).all() or not np.isfinite(w).all():
        raise ValueError("tuned pairs must be finite; fill missing markers first")
    error = float("nan")
    if stretch is None:
        measure = np.eye(len(D)) if gram is None else np.asarray(gram, float)
        scored = [
            (_left_out(D, m, w, trust, choice, ranges, measure), choice) for choice in _STRETCHES
        ]
        best = min(range(len(scored)), key=lambda i: scored[i][0][0])
        (_, error), stretch = scored[best]
    return _fit(D, m, w, trust, stretch, error)


def solve_calibrated(
    basis: CalibratedBasis,
    motion: ArrayLike,
    *,
    ranges: ArrayLike | None = None,
    prior: ArrayLike | None = None,
    prior_precision: ArrayLike | None = None,
) -> FloatArray:
    """Return the most probable weights of each frame, within the ranges.

    Parameters
    ----------
    basis : CalibratedBasis
    motion : (frames, markers, 3) array
        Displacements, scaled as the pairs' were [mm].
    ranges : (shapes, 2) array, optional
        0 to 1 unless given.
    prior : (frames, shapes) or (shapes,) array, optional
        Weights expected beforehand, such as a regression's prediction; the pairs' mean unless
        given.
    prior_precision : (shapes, shapes) array, optional
        Inverse covariance of that expectation's error; of the pairs' weights unless given.

    Returns
    -------
    (frames, shapes) float array

    Raises
    ------
    ValueError
        If arrays do not fit together.
    """
    m, D = np.asarray(motion, float), basis.deltas
    if m.ndim != 3 or m.shape[1:] != D.shape[1:]:
        raise ValueError(f"motion must be (frames, {D.shape[1]}, 3), got {m.shape}")
    limits = np.tile([0.0, 1.0], (len(D), 1)) if ranges is None else np.asarray(ranges, float)
    mean = basis.weight_mean if prior is None else np.asarray(prior, float)
    precision = (
        basis.weight_precision if prior_precision is None else np.asarray(prior_precision, float)
    )
    A = (D / basis.noise_mm[:, None]).reshape(len(D), -1)
    b = ((m - basis.offset) / basis.noise_mm[:, None]).reshape(len(m), -1)
    return minimise_bounded_quadratic(
        A @ A.T + precision,
        b @ A.T + mean @ precision,
        lower=limits[:, 0],
        upper=limits[:, 1],
    ).x


def _fit(
    D: FloatArray,
    m: FloatArray,
    w: FloatArray,
    trust: FloatArray,
    stretch: tuple[float, float],
    error: float,
) -> CalibratedBasis:
    """Solve each marker's regression in its dual: a matrix of the size of the pairs."""
    own = (D**2).sum(axis=2)
    allowed = stretch[0] ** 2 * (own + stretch[1] ** 2 * own.mean(axis=0) + _LEAST_NOISE_MM**2)
    residual = m - np.einsum("ns,smc->nmc", w, D)
    dual, left_out = np.empty_like(m), np.empty_like(m)
    for marker, variance in enumerate(allowed.T):
        kernel = (w * variance) @ w.T + _NEUTRAL_MM**2 + _NOISE_MM**2 * np.eye(len(w))
        inverse = np.linalg.inv(kernel)
        dual[:, marker] = inverse @ residual[:, marker]
        left_out[:, marker] = dual[:, marker] / np.diag(inverse)[:, None]  # closed form
    noise = np.sqrt((left_out**2).mean(axis=(0, 2)) + _LEAST_NOISE_MM**2)
    with np.errstate(divide="ignore"):
        noise = np.where(trust > 0, noise / np.sqrt(trust), np.inf)
    spread = np.atleast_2d(np.cov(w.T))
    spread = _TOGETHER * spread + (1 - _TOGETHER) * np.diag(np.diag(spread) + _LEAST_VARIANCE)
    return CalibratedBasis(
        deltas=D + np.einsum("sm,ns,nmc->smc", allowed, w, dual, optimize=True),
        offset=_NEUTRAL_MM**2 * dual.sum(axis=0),
        noise_mm=noise,
        weight_mean=w.mean(axis=0),
        weight_precision=np.asarray(np.linalg.inv(spread), float),
        stretch=stretch[0],
        spread=stretch[1],
        weight_rmse=error,
    )


def _left_out(
    D: FloatArray,
    m: FloatArray,
    w: FloatArray,
    trust: FloatArray,
    stretch: tuple[float, float],
    ranges: ArrayLike | None,
    measure: FloatArray,
) -> tuple[float, float]:
    """Return the measured error and the weight error of pairs solved without themselves."""
    m, w = m[:_FOLDED_PAIRS], w[:_FOLDED_PAIRS]
    fold = np.arange(len(w)) % min(_FOLDS, len(w))
    off = np.empty_like(w)
    for part in range(int(fold.max()) + 1):
        out = fold == part
        if (~out).sum() < 2:
            return float("inf"), float("nan")
        basis = _fit(D, m[~out], w[~out], trust, stretch, float("nan"))
        off[out] = solve_calibrated(basis, m[out], ranges=ranges) - w[out]
    seen = np.einsum("ns,st,nt->n", off, measure, off)
    return float(seen.mean()), float(np.sqrt((off**2).mean()))
