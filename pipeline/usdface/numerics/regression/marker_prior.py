"""Prior of the displacements of markers by a rig's shapes, from the rig and example pairs.

Each marker is assigned to the skin that moves as the marker does under the weights of the pairs,
and lies where the marker lies, without landmarks. Motion alone cannot distinguish skin that always
moves together, such as both lids in references with both eyes closed; position alone depends on the
proportions of the face. The prior has a direction of motion also for shapes that the pairs hardly
use, or use only together.
"""

from dataclasses import dataclass

import numpy as np

from usdface.core.arrays import FloatArray, rms_radius

_GAIN_RANGE = (0.4, 2.5)
"""Limits of the amplitude (gain) of a performer's skin over the rig's."""
_LOG_GAIN_DEVIATION = 0.35
"""Standard deviation of the gain's logarithm."""
_MARKER_NOISE_MM = 0.4
"""Standard deviation of a coordinate of a marker."""
_MODEL_ERROR_SHARE = 0.15
"""[of a marker's motion] Standard deviation of the error of the best place on another face."""
_PAIR_SAMPLES = 24.0
"""Effective number of independent samples of the pairs."""
_MOTION_ROUNDS, _PLACE_ROUNDS = 3, 6
"""Alternations of matching with rotation, and of registration, matching by place, and rotation."""
_SIZE_QUANTILE = 0.97
"""Quantile of the points' motion at which the sizes of two faces are compared."""

_PLACE_DEVIATIONS_MM = (30.0, 15.0, 10.0, 8.0)
"""Standard deviation of a marker from its skin after registration, round by round, on the rig:
features of two faces differ so much."""
_REGISTERED_DEVIATION_MM = 4.0
"""The same for markers with known places: the error of registration by labels."""
_UNRELATED_SHARE = 0.5
"""[of the face's radius] Median distance between markers and the skin that moves as they do, from
which positions are ignored. That of random positions is 1."""
_ISOTROPIC_SHARE = 0.1
"""Ridge of the scales of the three axes towards a common one, relative to the markers' variance."""
_SIMILARITY_ROUNDS = 10
_SPREAD_MM = 15.0
"""Standard deviation of a marker's candidates at which its weight in registration is halved."""
_LEAST_SCALE_MM = 3.0
"""Least scale of the Cauchy weights in registration."""


@dataclass(frozen=True)
class _Match:
    """Fit of each marker's motion by each point of the skin: (markers, points) arrays."""

    gain: FloatArray
    log_likelihood: FloatArray


@dataclass(frozen=True)
class _Faces:
    """Motion and neutral of markers and skin, as of `fit_marker_basis`."""

    motion: FloatArray
    """(markers, pairs, 3): displacements of the markers from their mean [mm]."""
    skin_motion: FloatArray
    """(points, pairs, 3): the same of the skin, at the performer's size as `rest` and `places`."""
    energy: FloatArray
    """(markers,): sum of squares of `motion`."""
    rest: FloatArray
    neutral: FloatArray
    places: FloatArray
    prior_gain: float | None
    """Median of the gain's prior; None to estimate it by registration."""


def fit_marker_basis(
    skin: FloatArray,
    weights: FloatArray,
    markers: FloatArray,
    *,
    rest: FloatArray | None = None,
    neutral: FloatArray | None = None,
    places: FloatArray | None = None,
    motion_scale: float | None = None,
) -> FloatArray:
    """Return the expected displacements of markers by each shape at 1: (s, markers, 3) [mm].

    The posterior mean over all points of the skin as candidates, each with a gain. The rotation
    between the spaces is estimated as well. The rig is scaled to the performer's size first, if
    `motion_scale` states it or if its motion is implausible.

    Parameters
    ----------
    skin : (s, points, 3) float array
        Displacement of points of the rig's surface by each shape at 1 [mm].
    weights : (pairs, s) float array
    markers : (pairs, markers, 3) float array
        [mm]
    rest : (points, 3) float array, optional
        Positions of these points on the rig's neutral [mm]; without them motion alone decides.
    neutral : (markers, 3) float array, optional
        The performer's neutral face [mm]; needed with `rest`.
    places : (markers, 3) float array, optional
        Known places of markers on the rig's neutral, else NaN [mm]; used with `rest` and
        `neutral`. By default they are estimated by registration.
    motion_scale : float, optional
        Motion of the rig over that of the performer, the inverse of the prior gain. By default
        estimated by registration.
    """
    motion = (markers - markers.mean(axis=0)).transpose(1, 0, 2)
    flat = (weights - weights.mean(axis=0)) @ skin.reshape(len(skin), -1)
    skin_motion = np.ascontiguousarray(flat.reshape(len(weights), -1, 3).transpose(1, 0, 2))
    energy = np.einsum("mnc,mnc->m", motion, motion)
    if motion_scale is not None:
        scale = 1 / motion_scale
    else:
        scale = _size_of_performer(energy, np.einsum("pnc,pnc->p", skin_motion, skin_motion))
    skin_motion *= scale
    rotation = np.eye(3)
    for turn in range(_MOTION_ROUNDS):
        match = _match_motion(motion, skin_motion @ rotation.T, energy)
        if turn < _MOTION_ROUNDS - 1:
            rotation = _rotation_of(match, skin_motion, motion)
    if rest is not None and neutral is not None:
        known = np.full_like(neutral, np.nan) if places is None else places
        gain = None if motion_scale is None else 1.0
        faces = _Faces(motion, skin_motion, energy, scale * rest, neutral, scale * known, gain)
        match, rotation = _refine_by_place(match, rotation, faces)
    gains = _shares(match.log_likelihood) * match.gain
    return np.asarray(np.einsum("mp,spc->smc", gains, scale * skin @ rotation.T, optimize=True))


def _match_motion(
    motion: FloatArray, skin_motion: FloatArray, energy: FloatArray, prior_gain: float | None = None
) -> _Match:
    """Compare the motion of every marker with that of every point of the skin.

    The variance of a residual is the sum of `expected` and of the residual of the best gain. So a
    marker whose motion no skin explains is placed by position, with the prior gain.

    The gain is the maximum likelihood estimate or, with `prior_gain`, its posterior mean.
    """
    values = motion[0].size
    size = np.einsum("pnc,pnc->p", skin_motion, skin_motion)
    expected = _MARKER_NOISE_MM**2 + _MODEL_ERROR_SHARE**2 * energy[:, None] / values
    product = motion.reshape(len(motion), -1) @ skin_motion.reshape(len(skin_motion), -1).T
    gain = np.clip(product / np.maximum(size, 1e-9), *_GAIN_RANGE)
    log_median = 0.0 if prior_gain is None else np.log(prior_gain)
    if prior_gain is not None:
        least = (energy[:, None] - 2 * gain * product + gain**2 * size) / values
        evidence = size * _PAIR_SAMPLES / values / (expected + least)
        precision = 1 / _LOG_GAIN_DEVIATION**2
        gain = (gain * evidence + prior_gain * precision) / (evidence + precision)
    squared = energy[:, None] - 2 * gain * product + gain**2 * size
    log_likelihood = -0.5 * _PAIR_SAMPLES * np.log1p(squared / values / expected)
    log_likelihood -= 0.5 * ((np.log(gain) - log_median) / _LOG_GAIN_DEVIATION) ** 2
    return _Match(gain, log_likelihood)


def _refine_by_place(
    match: _Match, rotation: FloatArray, faces: _Faces
) -> tuple[_Match, FloatArray]:
    """Register the markers with the rig, and weigh candidates by distance as well."""
    motion, skin_motion, energy = faces.motion, faces.skin_motion, faces.energy
    rest, neutral, places = faces.rest, faces.neutral, faces.places
    known = np.isfinite(places).all(axis=1)
    radius = rms_radius(rest)
    refined = match
    for turn in range(_PLACE_ROUNDS):
        share = _shares(refined.log_likelihood)
        placed, scale, distance = _register(neutral @ rotation, share, rest, energy)
        if turn == 0 and not known.any() and distance > _UNRELATED_SHARE * radius:
            return match, rotation
        by_registration = float(np.clip(1 / scale, *_GAIN_RANGE))
        gain = by_registration if faces.prior_gain is None else faces.prior_gain
        refined = _match_motion(motion, skin_motion @ rotation.T, energy, gain)
        deviation = scale * _PLACE_DEVIATIONS_MM[min(turn, len(_PLACE_DEVIATIONS_MM) - 1)]
        deviations = np.full(len(placed), deviation)
        placed[known], deviations[known] = places[known], _REGISTERED_DEVIATION_MM
        squared = ((placed[:, None] - rest) ** 2).sum(axis=2)
        refined.log_likelihood[:] -= 0.5 * squared / deviations[:, None] ** 2
        if turn < _PLACE_ROUNDS - 1:
            rotation = _rotation_of(refined, skin_motion, motion)
    return refined, rotation


def _register(
    markers: FloatArray, share: FloatArray, rest: FloatArray, energy: FloatArray
) -> tuple[FloatArray, float, float]:
    """Scale and shift markers to their skin, robustly: places, scale, median distance [mm].

    Axes have separate scales with a ridge towards the common one.
    """
    target = share @ rest
    spread2 = np.maximum(share @ (rest**2).sum(axis=1) - (target**2).sum(axis=1), 0.0)
    moving = energy if energy.any() else np.ones_like(energy)  # one pair alone shows no motion
    trust = moving / (moving + np.median(moving) + 1e-12) / (1 + spread2 / _SPREAD_MM**2)
    weight = trust
    for _ in range(_SIMILARITY_ROUNDS):
        centre = weight @ target / weight.sum()
        centred = markers - weight @ markers / weight.sum()
        covariance = weight @ (centred * (target - centre))
        variance = weight @ centred**2
        common = max(float(covariance.sum() / variance.sum()), 1e-3)
        ridge = _ISOTROPIC_SHARE * variance.sum()
        placed = centred * (covariance + ridge * common) / (variance + ridge) + centre
        distance = np.linalg.norm(placed - target, axis=1)
        known = trust > np.median(trust)
        median_mm = float(np.median(distance[known] if known.any() else distance))
        weight = trust / (1 + (distance / max(median_mm, _LEAST_SCALE_MM)) ** 2)
    return placed, common, median_mm


def _shares(log_likelihood: FloatArray) -> FloatArray:
    share = np.exp(log_likelihood - log_likelihood.max(axis=1, keepdims=True))
    return np.asarray(share / share.sum(axis=1, keepdims=True))


def _rotation_of(match: _Match, skin_motion: FloatArray, motion: FloatArray) -> FloatArray:
    """Return the rotation from each marker's best skin to its motion (Kabsch, uncentred)."""
    best = match.log_likelihood.argmax(axis=1)
    gain = match.gain[np.arange(len(best)), best]
    cross = np.einsum("mni,mnj->ij", skin_motion[best] * gain[:, None, None], motion)
    left, _, right = np.linalg.svd(cross)
    flip = np.diag([1.0, 1.0, np.sign(np.linalg.det(right.T @ left.T))])
    return np.asarray(right.T @ flip @ left.T)


def _size_of_performer(marker_energy: FloatArray, skin_energy: FloatArray) -> float:
    """Return the scale from a rig's motion to the markers'; 1 within the range of gains."""
    markers = float(np.quantile(marker_energy, _SIZE_QUANTILE)) if len(marker_energy) else 0.0
    skin = float(np.quantile(skin_energy, _SIZE_QUANTILE)) if len(skin_energy) else 0.0
    if markers == 0 or skin == 0:
        return 1.0
    scale = float(np.sqrt(markers / skin))
    return 1.0 if _GAIN_RANGE[0] <= scale <= _GAIN_RANGE[1] else scale
