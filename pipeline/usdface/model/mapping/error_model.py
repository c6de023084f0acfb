"""How large the error of a frame is likely to be, in each part of the face.

A frame far from what the references showed is a guess: the variance that a Gaussian process has
left there says how far, and noise of the markers leaves an error even where references are near.
How errors grow with both is learned from references that were predicted without themselves: their
errors over the square root of that variance have a distribution, and with it a frame's variance
becomes the probability of an error that nobody sees.
"""

import math
from collections.abc import Sequence
from statistics import NormalDist

import numpy as np

from usdface.core.arrays import FloatArray
from usdface.core.assets import MotionSpace
from usdface.model.mapping.coordinates import noise_variance
from usdface.numerics.regression.cross_validation import Fold

MAX_DIMENSIONS = 24
"""Components used: with more, noise would make every frame look unlike the references."""

SIGNAL_TO_NOISE = 4.0
"""Least variance of a component used, in variances of marker noise."""

_NOISE_VARIANCE = 1e-3
"""Of a reference's output, in units of the process's variance."""

LINEAR_SHARE = 0.5
"""Variance of the linear part of the covariance, in the same units."""

LEAST_SPREAD = 0.35
"""Of the logarithm of errors: few references agree by chance."""

UNKNOWN_SPREAD = 0.7
"""The same where references were too few to compare."""

_VARIANCE_FLOOR = 0.02
"""Added to every frame's variance, in units of the process's: errors are proportional to
``sqrt(variance + 0.02)``, so that marker noise leaves an error even at a reference."""

TAKE_ERROR_RATIO = 1.1
_FOLD_LOSS_PAIRS = 12.0
LEAST_PAIRS = 25
"""Errors on a take over those on pairs left out: ``1.1 / (1 + (12 / max(pairs, 25))^2)``, for a
fold leaves out a fifth, and of few pairs that is much. As the variance floor, measured on
performers like those of `benchmarks confidence`, of other faces and noise: errors of parts of the
face stay below the expected error nine times in ten there, those of the whole face more often."""

ERROR_PROBABILITY = 0.9
"""That the error of a frame stays below the expected error that is written."""

_DEVIATIONS = np.linspace(-8, 8, 8001)
_CUMULATIVE = np.array([0.5 * math.erfc(-each / math.sqrt(2)) for each in _DEVIATIONS.tolist()])
"""The normal distribution: lines between these are within 2e-7 of it, at a fraction of the time."""


def fit_error_model(
    coordinates: FloatArray,
    motion: MotionSpace,
    *,
    folds: Sequence[Fold],
    error_over_tolerance: FloatArray,
) -> dict[str, FloatArray]:
    """Learn how errors depend on the variance that the references leave of a frame.

    Parameters
    ----------
    coordinates : (pairs, dimensions) float array
        Of the references.
    folds : sequence of Fold
        Of the cross-validation that the errors come from.
    error_over_tolerance : (pairs, regions) float array
        Errors of references predicted by other folds, over the error that would be seen.
        A single row where nothing was compared.

    Returns
    -------
    dict of str to float array
        What `confidence_of` and `likely_error` read, as part of a mapping.
    """
    signals = int((motion.variances > SIGNAL_TO_NOISE * noise_variance(motion)).sum())
    kept = max(1, min(MAX_DIMENSIONS, coordinates.shape[1], signals))
    scale = motion.variances[:kept] ** -0.25  # half whitened
    rows = coordinates[:, :kept] * scale
    squared = _squared_distances(rows, rows, rows @ rows.T)[np.triu_indices(len(rows), 1)]
    width = float(np.median(squared)) or 1.0
    size = float(np.einsum("ij,ij->", rows, rows)) / len(rows) or 1.0
    reach = float(np.einsum("ij,ij->i", rows, rows).max()) or 1.0
    settings = np.array([width, size, reach])
    covariance = _kernel(rows, rows, settings)
    inverse = np.linalg.inv(covariance + _NOISE_VARIANCE * np.eye(len(rows)))
    unseen = np.full(len(rows), np.nan)
    for fold in folds:
        unseen[fold.test] = _unseen_variance(covariance, fold)
    if len(error_over_tolerance) == len(rows):
        logs = np.log(np.maximum(error_over_tolerance, 1e-3)) - np.log(_growth(unseen))[:, None]
        middle = logs.mean(axis=0) + np.log(_excess(len(rows)))
        spread = np.maximum(logs.std(axis=0), LEAST_SPREAD)
    else:
        middle = np.log(error_over_tolerance[0]) - np.log(_growth(unseen.mean()))
        spread = np.full(len(middle), UNKNOWN_SPREAD)
    return {
        "familiar_rows": rows,
        "familiar_scale": scale,
        "familiar_inverse": inverse,
        "familiar_settings": settings,
        "familiar_error": np.stack([middle, spread]),
    }


def predictive_variance(arrays: dict[str, FloatArray], coordinates: FloatArray) -> FloatArray:
    """Return the variance that the references leave of each frame.

    Further out than any reference errors grow with the square of the distance: there no line need
    go on, and limits cut weights off.

    Parameters
    ----------
    arrays : dict
        From `fit_error_model`.
    coordinates : (frames, dimensions) float array

    Returns
    -------
    (frames,) float array
        In units of the process's variance.
    """
    scale, settings = arrays["familiar_scale"], arrays["familiar_settings"]
    rows = coordinates[:, : len(scale)] * scale
    known = _kernel(rows, arrays["familiar_rows"], settings)
    distance = np.einsum("ij,ij->i", rows, rows)
    prior = 1.0 + LINEAR_SHARE * distance / settings[1]
    left: FloatArray = prior - np.einsum("ij,ij->i", known @ arrays["familiar_inverse"], known)
    left = np.maximum(left, _NOISE_VARIANCE)
    left *= np.maximum(distance / settings[2], 1.0) ** 2
    return left


def confidence_of(arrays: dict[str, FloatArray], left: FloatArray) -> FloatArray:
    """Return the probability that errors stay below the tolerance.

    Parameters
    ----------
    arrays : dict
        From `fit_error_model`.
    left : (frames,) float array
        From `predictive_variance`.

    Returns
    -------
    (frames, regions) float array
        [0-1]
    """
    middle, spread = arrays["familiar_error"]
    deviations = -(middle + np.log(_growth(left))[:, None]) / spread
    below: FloatArray = np.interp(deviations, _DEVIATIONS, _CUMULATIVE)
    return below


def likely_error(
    arrays: dict[str, FloatArray], left: FloatArray, *, probability: float = ERROR_PROBABILITY
) -> FloatArray:
    """Return the error, in tolerances, that is not exceeded with this probability.

    Returns
    -------
    (frames, regions) float array
    """
    middle, spread = arrays["familiar_error"]
    error: FloatArray = (
        np.exp(middle + spread * NormalDist().inv_cdf(probability)) * _growth(left)[:, None]
    )
    return error


def _excess(pairs: int) -> float:
    return TAKE_ERROR_RATIO / (1.0 + (_FOLD_LOSS_PAIRS / max(pairs, LEAST_PAIRS)) ** 2)


def _growth(left: FloatArray) -> FloatArray:
    """Return what errors are proportional to."""
    grown: FloatArray = np.sqrt(left + _VARIANCE_FLOOR)
    return grown


def _unseen_variance(covariance: FloatArray, fold: Fold) -> FloatArray:
    """Variance of a fold's tested references, given those it trains on."""
    known = covariance[np.ix_(fold.train, fold.train)] + _NOISE_VARIANCE * np.eye(len(fold.train))
    shared = covariance[np.ix_(fold.train, fold.test)]
    explained = np.einsum("ij,ij->j", shared, np.linalg.solve(known, shared))
    left: FloatArray = np.maximum(np.diag(covariance)[fold.test] - explained, _NOISE_VARIANCE)
    return left


def _kernel(left: FloatArray, right: FloatArray, settings: FloatArray) -> FloatArray:
    width, size, _ = settings
    along = left @ right.T
    out = _squared_distances(left, right, along)
    out *= -0.5 / width
    np.exp(out, out=out)
    along *= LINEAR_SHARE / size
    out += along
    return out


def _squared_distances(left: FloatArray, right: FloatArray, along: FloatArray) -> FloatArray:
    """From the products `along` of all rows: they are of a like size, so that digits suffice."""
    out: FloatArray = -2.0 * along
    out += np.einsum("ij,ij->i", left, left)[:, None]
    out += np.einsum("ij,ij->i", right, right)
    np.maximum(out, 0.0, out=out)
    return out
