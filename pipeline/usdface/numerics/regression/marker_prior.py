"""Prior of the displacements of markers by a rig's shapes, from the rig and example pairs.

Each marker is assigned to the skin that moves as the marker does under the weights of the pairs,
and lies where the marker lies, without landmarks. Motion alone cannot distinguish skin that always
moves together, such as both lids in references with both eyes closed; position alone depends on the
proportions of the face. The prior has a direction of motion also for shapes that the pairs hardly
use, or use only together.
"""

from dataclasses import dataclass

import numpy as np

from usdface.core.arrays import FloatArray

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

    seen: FloatArray
    """(markers, pairs, 3): displacements of the markers from their mean [mm]."""
    moved: FloatArray
    """(points, pairs, 3): the same of the skin, at the performer's size as `rest` and `places`."""
    energy: FloatArray
    """(markers,): sum of squares of `seen`."""
    rest: FloatArray
    neutral: FloatArray
    places: FloatArray
    usual_gain: float | None
    """None if the registered positions are to tell it."""


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
        Motion of the rig over that of the performer, the inverse of the usual gain. By default that
        of the registered positions.
    """
    if skin.ndim != 3 or skin.shape[2] != 3 or skin.shape[0] != weights.shape[1]:
        raise ValueError(f"skin {skin.shape} and weights {weights.shape} do not fit together")
    if markers.shape[0] != len(weights):
        raise ValueError(f"{markers.shape[0]} marker clouds but {len(weights)} weights")
    seen = (markers - markers.mean(axis=0)).transpose(1, 0, 2)
    flat = (weights - weights.mean(axis=0)) @ skin.reshape(len(skin), -1)
    moved = np.ascontiguousarray(flat.reshape(len(weights), -1, 3).transpose(1, 0, 2))
    energy = np.einsum("mnc,mnc->m", seen, seen)
    if motion_scale is not None:
        scale = 1 / motion_scale
    else:
        scale = _size_of_performer(energy, np.einsum("pnc,pnc->p", moved, moved))
    moved *= scale
    rotation = np.eye(3)
    for turn in range(_MOTION_ROUNDS):
        match = _match_motion(seen, moved @ rotation.T, energy)
        if turn < _MOTION_ROUNDS - 1:
            rotation = _rotation_of(match, moved, seen)
    if rest is not None and neutral is not None:
        known = np.full_like(neutral, np.nan) if places is None else places
        usual = None if motion_scale is None else 1.0
        faces = _Faces(seen, moved, energy, scale * rest, neutral, scale * known, usual)
        match, rotation = _refine_by_place(match, rotation, faces)
    gain = _shares(match.log_likelihood) * match.gain
    return np.asarray(np.einsum("mp,spc->smc", gain, scale * skin @ rotation.T, optimize=True))


def _match_motion(
    seen: FloatArray, moved: FloatArray, energy: FloatArray, usual_gain: float | None = None
) -> _Match:
    """Compare the motion of every marker with that of every point of the skin.

    The variance of a residual is the sum of `expected` and of the residual of the best gain. So a
    marker whose motion no skin explains is placed by position, with the usual gain.

    The gain is the maximum likelihood estimate or, with a usual gain, its posterior mean.
    """
    values = seen[0].size
    size = np.einsum("pnc,pnc->p", moved, moved)
    expected = _MARKER_NOISE_MM**2 + _MODEL_ERROR_SHARE**2 * energy[:, None] / values
    product = seen.reshape(len(seen), -1) @ moved.reshape(len(moved), -1).T
    gain = np.clip(product / np.maximum(size, 1e-9), *_GAIN_RANGE)
    middle = 0.0 if usual_gain is None else np.log(usual_gain)
    if usual_gain is not None:
        least = (energy[:, None] - 2 * gain * product + gain**2 * size) / values
        evidence = size * _PAIR_SAMPLES / values / (expected + least)
        precision = 1 / _LOG_GAIN_DEVIATION**2
        gain = (gain * evidence + usual_gain * precision) / (evidence + precision)
    left = energy[:, None] - 2 * gain * product + gain**2 * size
    log_likelihood = -0.5 * _PAIR_SAMPLES * np.log1p(left / values / expected)
    log_likelihood -= 0.5 * ((np.log(gain) - middle) / _LOG_GAIN_DEVIATION) ** 2
    return _Match(gain, log_likelihood)


def _refine_by_place(
    match: _Match, rotation: FloatArray, faces: _Faces
) -> tuple[_Match, FloatArray]:
    """Register the markers with the rig, and weigh candidates by distance as well."""
    seen, moved, energy = faces.seen, faces.moved, faces.energy
    rest, neutral, places = faces.rest, faces.neutral, faces.places
    known = np.isfinite(places).all(axis=1)
    radius = float(np.sqrt(((rest - rest.mean(axis=0)) ** 2).sum(axis=1).mean()))
    refined, gain = match, faces.usual_gain
    for turn in range(_PLACE_ROUNDS):
        share = _shares(refined.log_likelihood)
        laid, scale, distance = _register(neutral @ rotation, share, rest, energy)
        if turn == 0 and not known.any() and distance > _UNRELATED_SHARE * radius:
            return match, rotation
        usual = float(np.clip(1 / scale, *_GAIN_RANGE)) if gain is None else gain
        refined = _match_motion(seen, moved @ rotation.T, energy, usual)
        deviation = scale * _PLACE_DEVIATIONS_MM[min(turn, len(_PLACE_DEVIATIONS_MM) - 1)]
        deviations = np.full(len(laid), deviation)
        laid[known], deviations[known] = places[known], _REGISTERED_DEVIATION_MM
        squared = ((laid[:, None] - rest) ** 2).sum(axis=2)
        refined.log_likelihood[:] -= 0.5 * squared / deviations[:, None] ** 2
        if turn < _PLACE_ROUNDS - 1:
            rotation = _rotation_of(refined, moved, seen)
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
        middle = weight @ markers / weight.sum(), weight @ target / weight.sum()
        centred = markers - middle[0]
        along = weight @ (centred * (target - middle[1]))
        across = weight @ centred**2
        common = max(float(along.sum() / across.sum()), 1e-3)
        held = _ISOTROPIC_SHARE * across.sum()
        laid = centred * (along + held * common) / (across + held) + middle[1]
        distance = np.linalg.norm(laid - target, axis=1)
        known = trust > np.median(trust)
        usual = float(np.median(distance[known] if known.any() else distance))
        weight = trust / (1 + (distance / max(usual, _LEAST_SCALE_MM)) ** 2)
    return laid, common, usual


def _shares(log_likelihood: FloatArray) -> FloatArray:
    share = np.exp(log_likelihood - log_likelihood.max(axis=1, keepdims=True))
    return np.asarray(share / share.sum(axis=1, keepdims=True))


def _rotation_of(match: _Match, moved: FloatArray, seen: FloatArray) -> FloatArray:
    """Return the rotation from each marker's best skin to its motion (Kabsch, uncentred)."""
    best = match.log_likelihood.argmax(axis=1)
    gain = match.gain[np.arange(len(best)), best]
    cross = np.einsum("mni,mnj->ij", moved[best] * gain[:, None, None], seen)
    left, _, right = np.linalg.svd(cross)
    flip = np.diag([1.0, 1.0, np.sign(np.linalg.det(right.T @ left.T))])
    return np.asarray(right.T @ flip @ left.T)


def _size_of_performer(seen: FloatArray, moved: FloatArray) -> float:
    """Return the scale from a rig's motion to the markers'; 1 within the range of gains."""
    rig_motion = float(np.quantile(moved, _SIZE_QUANTILE)) if len(moved) else 0.0
    marker_motion = float(np.quantile(seen, _SIZE_QUANTILE)) if len(seen) else 0.0
    if rig_motion == 0 or marker_motion == 0:
        return 1.0
    scale = float(np.sqrt(marker_motion / rig_motion))
    return 1.0 if _GAIN_RANGE[0] <= scale <= _GAIN_RANGE[1] else scale
