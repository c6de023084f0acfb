"""Markers bound to places on a mesh, and the affine map from a performer's face onto it.

Wang et al. 2006, section "Motion data pre-processing": an affine transformation between markers
and mesh aligns the proportions of the motion with the model's. Head motion is removed first, so
that one map serves all frames of a take.
"""

from dataclasses import dataclass

import numpy as np

from usdface.core.arrays import BoolArray, FloatArray, IntArray, rms_radius
from usdface.numerics.registration.cloud_alignment import align_landmarks
from usdface.numerics.surface.surface_places import SurfacePoints

FEWEST_MARKERS = 4
"""An affine map has four unknown points."""

_SIMILARITY_WEIGHT = 0.15  # [of the markers' variance] ridge towards the similarity
_HALF_WEIGHT_SIZE = 0.10  # [of the face's size] residual of a marker that weighs half (Cauchy)
_ROBUST_ROUNDS = 8
_NOISE_MM = 0.3  # standard deviation of a marker's displacement, per coordinate
_CORRELATION_LENGTH_MM = 60.0  # of the motion of neighbouring markers
_EVIDENCE_SAMPLES = 6.0  # effective number of independent samples of a path
_MODEL_ERROR = 0.04  # [of a path's energy] that its neighbours do not tell


@dataclass(frozen=True)
class MarkerBinding:
    """Places of a performer's markers on a mesh."""

    names: tuple[str, ...]
    """Of the markers."""
    places: SurfacePoints
    """Marker by marker."""
    confidence: FloatArray
    """(markers,) [0-1]; 1 where a person set the place."""
    distance_mm: FloatArray
    """(markers,): between the marker mapped by `Proportions` and its place [mm]."""
    sources: tuple[str, ...]
    """``'proposed'``, ``'landmark'`` or ``'corrected'``."""


@dataclass(frozen=True)
class Proportions:
    """Affine map from a performer's face to a character's."""

    linear: FloatArray
    """(3, 3): maps displacements."""
    away_mm: FloatArray
    """(markers,): residual distance between each mapped marker and its place [mm]."""

    @property
    def scale(self) -> float:
        """Size of the character over that of the performer, root mean square over directions."""
        return float(np.sqrt((self.linear**2).sum() / 3.0))


def fit_proportions(cloud: FloatArray, places: FloatArray, *, weight: FloatArray) -> Proportions:
    """Fit the affine map from a performer's neutral markers to their places on a mesh.

    Ridge regression towards the best similarity: the markers of a face are nearly coplanar, so
    that noise would determine the depth without it. Reweighted with Cauchy weights.

    Parameters
    ----------
    cloud : (markers, 3) float array
        [mm]
    places : (markers, 3) float array
        [mm]
    weight : (markers,) float array
        Of each pair [0-1].

    Raises
    ------
    ValueError
        If there are fewer than four markers, they lie on a line, or only a mirrored face fits.
    """
    if len(cloud) < FEWEST_MARKERS:
        raise ValueError(f"{len(cloud)} markers; an affine map needs at least {FEWEST_MARKERS}")
    size = rms_radius(places)
    robust = np.maximum(weight, 1e-3)
    for _ in range(_ROBUST_ROUNDS):
        w = robust / robust.sum()
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
        robust = np.maximum(weight, 1e-3) / (1 + (away / (_HALF_WEIGHT_SIZE * size)) ** 2)
    return Proportions(linear, away)


def motion_agreement(displacements: FloatArray, distances: FloatArray) -> FloatArray:
    """Return standardised leave-one-out residuals of each marker's motion, over their median.

    Of a Gaussian process over the mesh: large for a lip marker bound to the wrong lip, or for two
    markers exchanged. Returns (markers,), about 1 for most markers, 3 and more for misplaced ones.

    Parameters
    ----------
    displacements : (frames, markers, 3) float array
        [mm]
    distances : (markers, markers) float array
        Along the surface where that is known [mm].

    References
    ----------
    Rasmussen and Williams (2006), Gaussian Processes for Machine Learning, equations 5.10 to 5.12.
    """
    frames, markers = displacements.shape[:2]
    moved = displacements.transpose(1, 0, 2).reshape(markers, -1)
    energy = float((moved**2).sum() / markers) or 1.0
    noise = 3 * frames * _NOISE_MM**2 / energy
    kernel = np.exp(-np.asarray(distances, float) / _CORRELATION_LENGTH_MM)
    # With distances along a surface the kernel may be indefinite: project it to the PSD cone.
    variances, directions = np.linalg.eigh((kernel + kernel.T) / 2)
    inverse = (directions / (np.maximum(variances, 0.0) + noise)) @ directions.T
    residual = (inverse @ moved) / np.diag(inverse)[:, None]
    standardised = np.sqrt((residual**2).sum(axis=1) * np.diag(inverse))
    return standardised / max(float(np.median(standardised)), 1e-9)


def choose_by_motion(
    displacements: FloatArray, distances: FloatArray, others: IntArray, excess: FloatArray
) -> BoolArray:
    """Choose between two places of each of some markers, such as on either lip, by their motion.

    A marker moves as the markers that are near along the surface do. Markers with one place are
    known; of the others, the one whose two places differ most is chosen first, and is known then.

    Parameters
    ----------
    displacements : (frames, markers, 3) float array
        [mm]
    distances : (places, places) float array
        Along the surface [mm]. The first place of every marker, then the second ones.
    others : (second places,) int array
        Marker of each second place; each marker once.
    excess : (second places,) float array
        Half the squared distance of the second place from where the marker is expected, in
        standard deviations, minus that of the first.

    Returns
    -------
    second : (second places,) bool array
        Whether the marker is at its second place.
    """
    frames, markers = displacements.shape[:2]
    moved = displacements.transpose(1, 0, 2).reshape(markers, -1)
    noise_energy = 3 * frames * _NOISE_MM**2
    kernel = np.exp(-np.asarray(distances, float) / _CORRELATION_LENGTH_MM)
    noise = noise_energy / (float((moved**2).sum() / markers) or 1.0)
    known = np.setdiff1d(np.arange(markers), others).tolist()
    owners = np.concatenate([np.arange(markers), others])
    energy = (moved[others] ** 2).sum(axis=1) + noise_energy
    second, open_ = np.zeros(len(others), bool), np.arange(len(others))
    while len(open_) and known:
        inside = kernel[np.ix_(known, known)] + noise * np.eye(len(known))
        dual = np.linalg.lstsq(inside, moved[owners[known]], rcond=None)[0]
        evidence = [
            np.log(
                ((moved[others[open_]] - kernel[np.ix_(rows, known)] @ dual) ** 2).sum(axis=1)
                / energy[open_]
                + _MODEL_ERROR
            )
            for rows in (others[open_], markers + open_)
        ]
        cost = excess[open_] + _EVIDENCE_SAMPLES / 2 * (evidence[1] - evidence[0])
        surest = int(np.abs(cost).argmax())
        chosen = open_[surest]
        second[chosen] = cost[surest] < 0
        known.append(int(markers + chosen if second[chosen] else others[chosen]))
        open_ = np.delete(open_, surest)
    return second
