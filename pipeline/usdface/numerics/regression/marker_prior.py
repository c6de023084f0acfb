"""What a rig's shapes should do to each marker, before any pair corrects it.

A pair shows how every marker lies when the rig's weights are known. A marker belongs to the part of
the skin that, under those weights, would move as it does, and that lies where the marker lies: no
registration, no landmarks. Motion alone cannot tell skin that always moves together, as both lids
do wherever references close both eyes; place alone cannot tell how another face is proportioned.
Shapes that the pairs hardly use, or use only together, still have a direction of motion: the rig's.
"""

from dataclasses import dataclass

import numpy as np

from usdface.core.arrays import FloatArray

_GAIN_RANGE = (0.4, 2.5)
"""How much further or less far than the rig a performer's skin may go."""
_LOG_GAIN_DEVIATION = 0.35
"""Standard deviation of the gain's logarithm."""
_MARKER_NOISE_MM = 0.4
"""What a marker moves for no reason."""
_MODEL_ERROR_SHARE = 0.15
"""Of a marker's motion, which no place on another face explains."""
_PAIR_SAMPLES = 24.0
"""Independent samples that the pairs count for: faces repeat each other."""
_MOTION_ROUNDS, _PLACE_ROUNDS = 3, 6
_SIZE_QUANTILE = 0.97
"""Quantile of points, by motion, at which two faces are compared in size."""

_PLACE_DEVIATIONS_MM = (30.0, 15.0, 10.0, 8.0)
"""How far from its skin a marker may lie once the faces are laid on each other, round by round, on
the rig: features of two faces are that far apart."""
_REGISTERED_DEVIATION_MM = 4.0
"""The same where the places of markers are known: as far as registration by labels errs."""
_UNRELATED_SHARE = 0.5
"""Of the face's radius: median distance between markers and the skin that moves as they do, from
which on their places say nothing. Markers laid at random are a whole radius off."""
_ISOTROPIC_SHARE = 0.1
"""How strongly the scales of the three axes are held to one, in markers' own evidence."""
_SIMILARITY_ROUNDS = 10
_SPREAD_MM = 15.0
"""Spread of a marker's candidates at which it counts half in laying the faces on each other."""
_LEAST_SCALE_MM = 3.0
"""Distance below which no marker is an outlier there."""


@dataclass(frozen=True)
class MarkerPrior:
    """Expected motion of markers."""

    basis: FloatArray
    """(s, markers, 3): what each shape at 1 does to each marker, in the markers' space [mm]."""
    rotation: FloatArray
    """(3, 3): from the rig's space to the markers'."""
    explained: float
    """Share of the markers' motion energy in the pairs that the best places explain."""


@dataclass(frozen=True)
class _Match:
    """How well each point of the skin explains each marker: (markers, points) arrays."""

    gain: FloatArray
    left: FloatArray
    log_likelihood: FloatArray


def expect_marker_motion(
    skin: FloatArray,
    weights: FloatArray,
    markers: FloatArray,
    *,
    rest: FloatArray | None = None,
    neutral: FloatArray | None = None,
    places: FloatArray | None = None,
) -> MarkerPrior:
    """Find for every marker the skin that moves as it does, and lies where it lies.

    Every point of the skin is a candidate, each with a gain; candidates are averaged by
    how well they explain the marker. The rotation between the spaces is found on the way. A rig
    of another size than any performer is brought to the performer's first.

    Parameters
    ----------
    skin : (s, points, 3) float array
        Displacement of points of the rig's surface by each shape at 1 [mm].
    weights : (pairs, s) float array
    markers : (pairs, markers, 3) float array
        [mm]
    rest : (points, 3) float array, optional
        Where those points are on the rig's neutral [mm]. Without it motion alone decides.
    neutral : (markers, 3) float array, optional
        The performer's neutral face [mm]; needed with `rest`.
    places : (markers, 3) float array, optional
        Where markers are known to sit on the rig's neutral, NaN where not [mm]; used with `rest`
        and `neutral`. By default the faces are laid on each other.
    """
    if skin.ndim != 3 or skin.shape[2] != 3 or skin.shape[0] != weights.shape[1]:
        raise ValueError(f"skin {skin.shape} and weights {weights.shape} do not fit together")
    if markers.shape[0] != len(weights):
        raise ValueError(f"{markers.shape[0]} marker clouds but {len(weights)} weights")
    seen = (markers - markers.mean(axis=0)).transpose(1, 0, 2)
    flat = (weights - weights.mean(axis=0)) @ skin.reshape(len(skin), -1)
    moved = np.ascontiguousarray(flat.reshape(len(weights), -1, 3).transpose(1, 0, 2))
    energy = np.einsum("mnc,mnc->m", seen, seen)
    scale = _size_of_performer(energy, np.einsum("pnc,pnc->p", moved, moved))
    moved *= scale
    rotation = np.eye(3)
    for turn in range(_MOTION_ROUNDS):
        match = _match_motion(seen, moved @ rotation.T, energy)
        if turn < _MOTION_ROUNDS - 1:
            rotation = _rotation_of(match, moved, seen)
    if rest is not None and neutral is not None:
        motion = seen, moved, energy
        match, rotation = _refine_by_place(match, rotation, motion, rest, neutral, places)
    best = match.log_likelihood.argmax(axis=1)
    share = _shares(match.log_likelihood)
    basis = np.einsum("mp,spc->smc", share * match.gain, scale * skin @ rotation.T, optimize=True)
    left = match.left[np.arange(len(best)), best].sum()
    return MarkerPrior(basis, rotation, float(1 - left / max(float(energy.sum()), 1e-300)))


def _match_motion(
    seen: FloatArray, moved: FloatArray, energy: FloatArray, usual_gain: float | None = None
) -> _Match:
    """Compare the motion of every marker with that of every point of the skin.

    The variance of a residual is unknown: `expected`, and what the best gain leaves over. Markers
    whose motion no skin explains are then placed by where they lie, and keep the usual gain.

    The gain is the likeliest one or, with a usual gain, its posterior mean.
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
    return _Match(gain, left, log_likelihood)


def _refine_by_place(
    match: _Match,
    rotation: FloatArray,
    motion: tuple[FloatArray, FloatArray, FloatArray],
    rest: FloatArray,
    neutral: FloatArray,
    places: FloatArray | None,
) -> tuple[_Match, FloatArray]:
    """Lay the markers on the rig, and let the distance decide between skin that moves alike."""
    if places is None:
        places = np.full_like(neutral, np.nan)
    known = np.isfinite(places).all(axis=1)
    seen, moved, energy = motion
    radius = float(np.sqrt(((rest - rest.mean(axis=0)) ** 2).sum(axis=1).mean()))
    refined = match
    for turn in range(_PLACE_ROUNDS):
        share = _shares(refined.log_likelihood)
        laid, scale, distance = _lay_on_rig(neutral @ rotation, share, rest, energy)
        if turn == 0 and not known.any() and distance > _UNRELATED_SHARE * radius:
            return match, rotation
        usual = float(np.clip(1 / scale, *_GAIN_RANGE))
        refined = _match_motion(seen, moved @ rotation.T, energy, usual)
        deviation = scale * _PLACE_DEVIATIONS_MM[min(turn, len(_PLACE_DEVIATIONS_MM) - 1)]
        deviations = np.full(len(laid), deviation)
        laid[known], deviations[known] = places[known], _REGISTERED_DEVIATION_MM
        squared = ((laid[:, None] - rest) ** 2).sum(axis=2)
        refined.log_likelihood[:] -= 0.5 * squared / deviations[:, None] ** 2
        if turn < _PLACE_ROUNDS - 1:
            rotation = _rotation_of(refined, moved, seen)
    return refined, rotation


def _lay_on_rig(
    markers: FloatArray, share: FloatArray, rest: FloatArray, energy: FloatArray
) -> tuple[FloatArray, float, float]:
    """Scale and shift markers onto their skin, robustly: places, scale, median distance [mm].

    Axes are scaled apart a little: faces differ in width and depth.
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
    """Return the rotation under which each marker's best skin moves as the marker does."""
    best = match.log_likelihood.argmax(axis=1)
    gain = match.gain[np.arange(len(best)), best]
    return _best_rotation(moved[best] * gain[:, None, None], seen)


def _size_of_performer(seen: FloatArray, moved: FloatArray) -> float:
    """Scale that brings a rig's motion to the markers'; 1 where the points' gains reach it."""
    rig_motion = float(np.quantile(moved, _SIZE_QUANTILE)) if len(moved) else 0.0
    marker_motion = float(np.quantile(seen, _SIZE_QUANTILE)) if len(seen) else 0.0
    if rig_motion == 0 or marker_motion == 0:
        return 1.0
    scale = float(np.sqrt(marker_motion / rig_motion))
    return 1.0 if _GAIN_RANGE[0] <= scale <= _GAIN_RANGE[1] else scale


def _best_rotation(rows: FloatArray, targets: FloatArray) -> FloatArray:
    """Proper rotation that turns displacements onto others best (Kabsch, without centring)."""
    cross = np.einsum("mni,mnj->ij", rows, targets)
    left, _, right = np.linalg.svd(cross)
    flip = np.diag([1.0, 1.0, np.sign(np.linalg.det(right.T @ left.T))])
    rotation: FloatArray = right.T @ flip @ left.T
    return rotation
