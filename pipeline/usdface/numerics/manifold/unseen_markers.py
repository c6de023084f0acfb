"""Prediction of unseen markers from the others, and what it adds to the surface's variance.

With the inverse covariance P of the markers (`marker_precisions`), u the unseen ones and s those
seen::

    z_u = -P_uu^-1 P_us z_s,    cov(z_u) = P_uu^-1 = L L'

At given hyper-parameters the surface is linear in all markers, ``h(x)' A P z``, in the terms of
`posterior_prediction`. The added variance is ``|h' A P_.u L|^2``.
"""

from collections.abc import Iterator

import numpy as np

from usdface.core.arrays import BoolArray, Float32Array, FloatArray, IntArray, equal_rows
from usdface.numerics.manifold.hyper_posterior import MarkerSpectrum


def predict_unseen(moved: FloatArray, seen: BoolArray, precision: FloatArray) -> FloatArray:
    """Replace the displacements of unseen markers by those that the others predict.

    Without any marker seen, they are 0.

    Parameters
    ----------
    moved : (frames, N, 3) float array
        [mm]
    seen : (frames, N) bool array
    precision : (N, N) float array
        P [mm^-2], or a multiple.
    """
    out = moved.copy()
    for unseen, rows in _unseen_patterns(seen):
        gain = -np.linalg.solve(precision[np.ix_(unseen, unseen)], precision[unseen])
        gain[:, unseen] = 0.0
        out[np.ix_(rows, unseen)] = gain @ moved[rows]
    return out


def unseen_variances(
    basis: Float32Array,
    spectrum: MarkerSpectrum,
    theta: FloatArray,
    seen: BoolArray,
    precision: FloatArray,
) -> Float32Array:
    """Return the variance that predicted markers add to the surface: (frames, points) [mm^2].

    Parameters
    ----------
    basis : (points, N + 4) float32 array
        See `surface_basis`.
    theta : (4,) float array
        Log hyper-parameters.
    seen : (frames, N) bool array
    precision : (N, N) float array
        P [mm^-2].
    """
    v0, _, a0, a1 = np.exp(theta)
    trend = (spectrum.vectors @ spectrum.trend).T
    dual = np.concatenate([v0 * spectrum.vectors.T, a0 * trend[:1], a1 * trend[1:]])
    out = np.zeros((len(seen), len(basis)), np.float32)
    for unseen, rows in _unseen_patterns(seen):
        root = np.linalg.cholesky(np.linalg.inv(precision[np.ix_(unseen, unseen)]))
        gain = basis @ (dual @ precision[:, unseen] @ root).astype(np.float32)
        out[rows] = (gain**2).sum(axis=1)
    return out


def _unseen_patterns(seen: BoolArray) -> Iterator[tuple[IntArray, IntArray]]:
    """Yield the unseen markers of each pattern that has some, with its frames."""
    for rows in equal_rows(seen):
        unseen = np.flatnonzero(~seen[rows[0]])
        if len(unseen):
            yield unseen, rows
