"""Which markers of a cloud may sit at which landmarks of a face, where no label says so.

People put markers at features: the nose's tip, the corners of the mouth, along the brows. Whether
one does is a mixture: a landmark's marker lies about it with the spread of such markers; any other
lies anywhere on the face, as densely as the cloud is.
"""

from dataclasses import dataclass

import numpy as np
from scipy.optimize import linear_sum_assignment
from scipy.spatial.distance import cdist

from usdface.core.arrays import FloatArray, IntArray
from usdface.numerics.registration.skin_placement import PlaneFit, fit_in_plane

_MARKED_SHARE = 0.7
"""Of a face's landmarks, those that have a marker of their own: marker sets differ."""

_LEAST_PROBABILITY = 0.1
"""Below it a pair says next to nothing, and is left out."""

_FEWEST_PAIRS = 5
"""From which a fit follows."""

_PROPORTIONS_MM = (14.0, 10.0, 8.0, 6.0, 5.0, 4.0)
"""Standard deviation of a marker about the fit, on an adult's face, as the fit gets better; what
proportions leave, in the end."""


@dataclass(frozen=True)
class FaceLandmarks:
    """Landmarks at which people put markers."""

    names: tuple[str, ...]
    """As `model.placement.rig_landmarks` has them."""
    places: FloatArray
    """(landmarks, 3): in the face's frame [mm]."""
    spreads: FloatArray
    """(landmarks,): standard deviation of markers about them [mm]."""
    area: float
    """Of the part of the skin that moves [mm^2]."""
    unit: float
    """Size of the face, in an adult's."""


@dataclass(frozen=True)
class LandmarkMatch:
    """Pairs of a marker and a landmark, each in one pair at most."""

    markers: IntArray
    landmarks: IntArray
    """`markers`, `landmarks`: (pairs,)"""
    probability: FloatArray
    """(pairs,): that the marker was put there, and is not any other [0-1]."""
    score: float
    """Mean over all landmarks of the log likelihood ratio of a marker that was put there to
    none."""


def match_landmarks(
    points: FloatArray, face: FaceLandmarks, *, proportion_mm: float = _PROPORTIONS_MM[-1]
) -> LandmarkMatch:
    """Pair markers with landmarks so that the pairs together are most likely.

    Parameters
    ----------
    points : (markers, 3) float array
        In the face's frame [mm].
    proportion_mm : float
        Standard deviation by which proportions displace markers, on an adult's face.
    """
    if not len(face.names):
        none = np.zeros(0, np.int64)
        return LandmarkMatch(none, none, np.zeros(0), 0.0)
    variance = face.spreads**2 + (proportion_mm * face.unit) ** 2
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
    levelled: FloatArray, face: FaceLandmarks, fit: PlaneFit, *, centre_x: float
) -> PlaneFit:
    """Fit a cloud to the landmarks that its markers may sit at, pairing and fitting in turns.

    Parameters
    ----------
    levelled : (markers, 3) float array
        At rest, its plane of symmetry at x = 0 [mm].
    fit : PlaneFit
        Where it starts; returned where too few pairs are likely.
    centre_x : float
        Of the character's plane of symmetry [mm].
    """
    centre = np.array([centre_x, 0.0, 0.0])
    for proportion in _PROPORTIONS_MM:
        match = match_landmarks(fit.apply(levelled), face, proportion_mm=proportion)
        if len(match.markers) < _FEWEST_PAIRS:
            break
        spreads = np.hypot(face.spreads[match.landmarks], _PROPORTIONS_MM[-1] * face.unit)
        found = fit_in_plane(
            levelled[match.markers],
            face.places[match.landmarks] - centre,
            spreads / np.sqrt(match.probability),
            rounds=3,
        )
        fit = PlaneFit(found.rotation, found.scale, found.shift + centre)
    return fit
