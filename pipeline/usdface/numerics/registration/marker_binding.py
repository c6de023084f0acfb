"""Markers bound to places on a mesh, and the affine map from a performer's face onto it.

Wang et al. 2006, section "Motion data pre-processing": an affine transformation between markers
and mesh aligns the proportions of the motion with the model's. Head motion is taken out before, so
one map serves every frame of a take.
"""

from dataclasses import dataclass

import numpy as np

from usdface.core.arrays import FloatArray
from usdface.numerics.registration.cloud_alignment import align_landmarks
from usdface.numerics.registration.surface_places import SurfacePlaces

FEWEST_MARKERS = 4
"""An affine map has four unknown points."""

_SIMILARITY_WEIGHT = 0.15  # of the similarity, over the spread of the markers themselves
_HALF_TRUST_SIZE = 0.10  # [of the face's size] a marker this far off counts half
_ROBUST_ROUNDS = 8
_NOISE_MM = 0.3  # of a marker's displacement, per coordinate
_CORRELATION_LENGTH_MM = 60.0  # over which neighbouring markers move alike


@dataclass(frozen=True)
class MarkerBinding:
    """Where a performer's markers sit on a mesh."""

    names: tuple[str, ...]
    """Of the markers."""
    places: SurfacePlaces
    """Marker by marker."""
    confidence: FloatArray
    """(markers,) [0-1]; 1 where a person set the place."""
    distance_mm: FloatArray
    """(markers,): between where the performer's proportions put the marker and its place [mm]."""
    sources: tuple[str, ...]
    """``'proposed'``, ``'landmark'`` or ``'corrected'``."""


@dataclass(frozen=True)
class Proportions:
    """``aligned = cloud @ linear.T + shift``: a performer's face on a character's."""

    linear: FloatArray
    """(3, 3): displacements follow it alone."""
    shift: FloatArray
    """(3,) [mm]"""
    away_mm: FloatArray
    """(markers,): what the map leaves between each marker and its place [mm]."""


def fit_proportions(cloud: FloatArray, places: FloatArray, *, weight: FloatArray) -> Proportions:
    """Fit the affine map from a performer's neutral markers to their places on a mesh.

    Ridge regression towards the best similarity: a face's markers are nearly a plane, so that
    without it noise would decide on the depth. A marker far from where the others put it counts
    less.

    Parameters
    ----------
    cloud : (markers, 3) float array
        [mm]
    places : (markers, 3) float array
        [mm]
    weight : (markers,) float array
        How far each pair is trusted [0-1].

    Raises
    ------
    ValueError
        If there are fewer than four markers, they lie on a line, or only a mirrored face fits.
    """
    if len(cloud) < FEWEST_MARKERS:
        raise ValueError(f"{len(cloud)} markers; an affine map needs at least {FEWEST_MARKERS}")
    size = float(np.sqrt(((places - places.mean(axis=0)) ** 2).sum(axis=1).mean()))
    trust = np.maximum(weight, 1e-3)
    for _ in range(_ROBUST_ROUNDS):
        w = trust / trust.sum()
        root = np.sqrt(w * len(w))[:, None]
        middle, goal = w @ cloud, w @ places
        start = align_landmarks((cloud - middle) * root, (places - goal) * root)
        similar = start.scale[0] * start.rotation
        y, x = cloud - middle, places - goal
        spread = (y * w[:, None]).T @ y
        ridge = _SIMILARITY_WEIGHT * np.trace(spread) / 3 * np.eye(3)
        linear = ((x * w[:, None]).T @ y + similar @ ridge) @ np.linalg.inv(spread + ridge)
        shift = goal - linear @ middle
        away = np.linalg.norm(cloud @ linear.T + shift - places, axis=1)
        trust = np.maximum(weight, 1e-3) / (1 + (away / (_HALF_TRUST_SIZE * size)) ** 2)
    return Proportions(linear, shift, away)


def motion_agreement(displacements: FloatArray, distances: FloatArray) -> FloatArray:
    """Return how badly each marker's motion fits that of its neighbours on the mesh.

    Leave-one-out residuals of a Gaussian process over the markers, each against what it expects,
    against the median marker: a lip marker on the wrong lip, or two that were exchanged, stand out.

    Parameters
    ----------
    displacements : (frames, markers, 3) float array
        [mm]
    distances : (markers, markers) float array
        Along the surface where that is known [mm].

    Returns
    -------
    (markers,) float array
        Residual over expected residual: about 1 for most, 3 and more for one that does not fit.
    """
    frames, markers = displacements.shape[:2]
    moved = displacements.transpose(1, 0, 2).reshape(markers, -1)
    energy = float((moved**2).sum() / markers) or 1.0
    noise = 3 * frames * _NOISE_MM**2 / energy
    kernel = np.exp(-np.asarray(distances, float) / _CORRELATION_LENGTH_MM)
    # Distances along a surface need not give a covariance: what of it is negative is left out.
    variances, directions = np.linalg.eigh((kernel + kernel.T) / 2)
    inverse = (directions / (np.maximum(variances, 0.0) + noise)) @ directions.T
    left = (inverse @ moved) / np.diag(inverse)[:, None]
    surprise = np.sqrt((left**2).sum(axis=1) * np.diag(inverse))
    return np.asarray(surprise / max(float(np.median(surprise)), 1e-9))
