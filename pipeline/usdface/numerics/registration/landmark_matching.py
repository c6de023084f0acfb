"""Assignment of unlabelled markers to landmarks of a face.

Markers are commonly put at features: the nose's tip, the corners of the mouth, along the brows. A
mixture model: a landmark's marker is normally distributed about it; any other is uniform over the
face, with the density of the cloud.
"""

from dataclasses import dataclass

import numpy as np
from scipy.spatial.distance import cdist

from usdface.core.arrays import FloatArray, IntArray
from usdface.numerics.registration.cloud_alignment import Alignment
from usdface.numerics.registration.plane_fit import fit_in_plane

_MARKED_SHARE = 0.7
"""Prior probability that a landmark has a marker: marker sets differ."""

_LEAST_PROBABILITY = 0.1
"""Pairs less probable are left out."""

_FEWEST_PAIRS = 5
"""Fewest pairs to fit."""

_PROPORTIONS_MM = (14.0, 10.0, 8.0, 6.0, 5.0, 4.0)
"""Standard deviation of a marker about the fit, on an adult's face, round by round; the last is due
to differing proportions alone."""


@dataclass(frozen=True)
class FaceLandmarks:
    """Landmarks at which markers are commonly put."""

    names: tuple[str, ...]
    """As in `model.placement.rig_landmarks`."""
    places: FloatArray
    """(landmarks, 3): in the face's frame [mm]."""
    spreads: FloatArray
    """(landmarks,): standard deviation of markers about them [mm]."""
    area: float
    """Area of the moving skin [mm^2]."""


@dataclass(frozen=True)
class LandmarkMatch:
    """Pairs of a marker and a landmark, each in one pair at most."""

    markers: IntArray
    landmarks: IntArray
    """`markers`, `landmarks`: (pairs,)"""
    probability: FloatArray
    """(pairs,): posterior probability that the marker belongs to the landmark."""
    score: float
    """Mean over all landmarks of the log likelihood ratio of a marker there to none."""


def match_landmarks(
    points: FloatArray, face: FaceLandmarks, *, proportion_mm: float = _PROPORTIONS_MM[-1]
) -> LandmarkMatch:
    """Return the assignment of markers to landmarks with the largest likelihood.

    Parameters
    ----------
    points : (markers, 3) float array
        In the face's frame [mm].
    proportion_mm : float
        Standard deviation of markers due to proportions, on an adult's face.
    """
    from scipy.optimize import linear_sum_assignment  # slow to import

    if not len(face.names):
        none = np.zeros(0, np.int64)
        return LandmarkMatch(none, none, np.zeros(0), 0.0)
    variance = face.spreads**2 + proportion_mm**2
    away = cdist(points, face.places, "sqeuclidean")
    density = len(points) / face.area
    ratio = _MARKED_SHARE * np.exp(-away / (2 * variance)) / (2 * np.pi * variance) / density
    gain = np.log1p(ratio)
    markers, landmarks = linear_sum_assignment(-gain)
    likely = ratio[markers, landmarks] / (1 + ratio[markers, landmarks])
    clear = likely > _LEAST_PROBABILITY
    return LandmarkMatch(
        markers[clear],
        landmarks[clear],
        likely[clear],
        float(gain[markers, landmarks].sum() / len(face.names)),
    )


def refine_fit(
    levelled: FloatArray, face: FaceLandmarks, fit: Alignment, *, centre_x: float
) -> Alignment:
    """Fit a cloud to landmarks, alternating between assignment and fit.

    Parameters
    ----------
    levelled : (markers, 3) float array
        At rest, its plane of symmetry at x = 0 [mm].
    fit : Alignment
        Initial fit; returned where too few pairs are probable.
    centre_x : float
        X of the character's plane of symmetry [mm].
    """
    for proportion in _PROPORTIONS_MM:
        match = match_landmarks(fit.apply(levelled), face, proportion_mm=proportion)
        if len(match.markers) < _FEWEST_PAIRS:
            break
        spreads = np.hypot(face.spreads[match.landmarks], _PROPORTIONS_MM[-1])
        fit = fit_in_plane(
            levelled[match.markers],
            face.places[match.landmarks],
            spreads / np.sqrt(match.probability),
            centre_x=centre_x,
            rounds=3,
        )
    return fit
