"""Align a performer's marker cloud with a character's face, without landmarks.

The unknowns are a rotation, a translation and one scale per axis: the performer's proportions.
Iterated closest points, started from every side and trimmed, in both directions: each marker must
find skin and each moving part of the skin must find a marker, or the cloud would shrink into a
cheek. Where motion is known it is a fourth coordinate: what moves much belongs on what moves much.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial import KDTree
from scipy.spatial.transform import Rotation

from usdface.core.arrays import FloatArray, IntArray

_YAWS_DEGREES = range(0, 360, 30)
_PITCHES_DEGREES = (-20, 0, 20)
_TILT_LIMIT = np.cos(np.deg2rad(40))  # Y is roughly up: a face on its side is a wrong answer
_TRUSTED_PAIR_SHARE = 0.95  # of the pairs, nearest first
_PROPORTION_LIMIT = 1.35  # how far one axis may differ from the mean of the three
_PROPORTION_SHARE = 0.6  # exponent on what one axis seems to differ: wrong pairs stretch it too
_COARSE_SKIN, _FINE_SKIN = 500, 3000
_COARSE_STEPS, _FINE_STEPS = 12, 40
_MOTION_MM = 40.0  # what the whole range of motion counts for, on a head 200 mm high
_BACKWARD_WEIGHT = 1.0  # weight of skin looking for markers, against markers looking for skin


@dataclass(frozen=True)
class Alignment:
    """Where the performer's face lies on the character's.

    ``aligned = scale * (cloud @ rotation.T) + translation``
    """

    scale: FloatArray
    """(3,): along the character's axes."""
    rotation: FloatArray
    """(3, 3): proper: left stays left."""
    translation: FloatArray
    """(3,) [mm]"""
    residual_mm: float
    """Trimmed root mean square distance between the cloud and the skin."""

    def apply(self, cloud: ArrayLike) -> FloatArray:
        """Return the cloud in the character's space."""
        return self.scale * (np.asarray(cloud, float) @ self.rotation.T) + self.translation

    def apply_to_motion(self, motion: ArrayLike) -> FloatArray:
        """Return displacements in the character's space and proportions."""
        return self.scale * (np.asarray(motion, float) @ self.rotation.T)

    def undo(self, placed: ArrayLike) -> FloatArray:
        """Return points of the character in the cloud's space."""
        return self.undo_motion(np.asarray(placed, float) - self.translation)

    def undo_motion(self, motion: ArrayLike) -> FloatArray:
        """Return displacements of the character in the cloud's space and proportions."""
        return np.asarray(motion, float) / self.scale @ self.rotation


_UNIT = Alignment(np.ones(3), np.eye(3), np.zeros(3), np.inf)


def align_landmarks(cloud: ArrayLike, targets: ArrayLike) -> Alignment:
    """Align named points with a similarity, and refuse a mirrored cloud.

    Parameters
    ----------
    cloud, targets : (n, 3) arrays
        Pair by pair, at least three.

    Raises
    ------
    ValueError
        If there are too few pairs, they lie on a line, or only a mirrored cloud fits.
    """
    y, x = np.asarray(cloud, float), np.asarray(targets, float)
    if len(y) < 3 or y.shape != x.shape:
        raise ValueError(f"landmarks need at least 3 pairs of points, got {y.shape} and {x.shape}")
    yc, xc = y - y.mean(axis=0), x - x.mean(axis=0)
    spread = np.linalg.svd(yc, compute_uv=False)
    if spread[1] < 0.02 * spread[0]:
        raise ValueError("the landmarks lie on a line; add one off that line")
    u, s, vt = np.linalg.svd(xc.T @ yc)
    handed = float(np.sign(np.linalg.det(u @ vt)))
    proper = s @ np.array([1, 1, handed])
    total = float((xc**2).sum() * (yc**2).sum())
    error, mirrored = 1 - proper**2 / total, 1 - s.sum() ** 2 / total
    if handed < 0 and error > 0.01 and mirrored < 0.25 * error:
        raise ValueError(
            "the landmarks fit only a mirrored face; check that left and right are not exchanged"
        )
    rotation = u @ np.diag([1, 1, handed]) @ vt
    scale = np.full(3, np.sqrt((xc**2).sum() / (yc**2).sum()))
    translation = x.mean(axis=0) - scale * (rotation @ y.mean(axis=0))
    off = scale * (y @ rotation.T) + translation - x
    return Alignment(scale, rotation, translation, float(np.sqrt((off**2).sum(axis=1).mean())))


def align_cloud(
    cloud: ArrayLike,
    skin: ArrayLike,
    *,
    activity: ArrayLike,
    areas: ArrayLike,
    amplitude: ArrayLike | None = None,
) -> Alignment:
    """Find the rotation, translation and per-axis scale that lay a marker cloud onto a face.

    Parameters
    ----------
    cloud : (markers, 3) array
        The performer's neutral face, Y roughly up, looking anywhere.
    skin : (samples, 3) array
        Points of the character's outer face.
    activity : (samples,) array
        How far the shapes move each sample.
    areas : (samples,) array
        What each sample stands for.
    amplitude : (markers,) array, optional
        How far each marker moves in the take; where none does, as if it were not known.

    Raises
    ------
    ValueError
        If there are fewer than four markers, or no start ends upright.
    """
    y, x = np.asarray(cloud, float), np.asarray(skin, float)
    if len(y) < 4:
        raise ValueError(f"registration needs at least 4 markers, got {len(y)}")
    moving = np.sqrt(np.asarray(activity, float) / np.asarray(activity, float).max())
    area = np.asarray(areas, float)
    size = float(np.sqrt(np.average(((x - x.mean(axis=0)) ** 2).sum(axis=1), weights=area)))
    a = np.zeros(len(y)) if amplitude is None else np.asarray(amplitude, float)
    usual = float(np.quantile(a, 0.97))
    skin_motion, cloud_motion = np.zeros(len(x)), np.zeros(len(y))
    if usual > 0:  # a take of one frame does not show where a face moves
        skin_motion = _MOTION_MM * size / 80 * moving
        cloud_motion = _MOTION_MM * size / 80 * np.sqrt(np.minimum(a / usual, 1.2))
    skin4, cloud4 = np.column_stack([x, skin_motion]), np.column_stack([y, cloud_motion])
    need = area * (moving > 0.35)  # parts that a marker set always covers
    coarse = _Skin(skin4, need, _COARSE_SKIN)
    ends = [_climb(cloud4, coarse, begin, _COARSE_STEPS) for begin in _starts(y, x, need)]
    ends = [end for end in ends if end.rotation[1, 1] > _TILT_LIMIT]
    if not ends:
        raise ValueError(
            "no alignment keeps the face upright; check that Y is up, or name landmarks"
        )
    best = sorted(ends, key=lambda end: end.residual_mm)[:3]
    fine = _Skin(skin4, need, _FINE_SKIN)
    ends = [_climb(cloud4, fine, begin, _FINE_STEPS, proportions=True) for begin in best]
    return min(ends, key=lambda end: end.residual_mm)


def align_pairs(cloud: ArrayLike, targets: ArrayLike, *, weight: ArrayLike) -> Alignment:
    """Fit rotation, translation and one scale per axis to points whose partners are known.

    Parameters
    ----------
    cloud, targets : (n, 3) arrays
    weight : (n,) array
        How far each pair is trusted.
    """
    y, x, w = (np.asarray(value, float) for value in (cloud, targets, weight))
    now = _fit(y, x, w, _UNIT, proportions=False)
    for _ in range(5):
        now = _fit(y, x, w, now, proportions=True)
    off = ((now.apply(y) - x) ** 2).sum(axis=1)
    return replace(now, residual_mm=float(np.sqrt(np.average(off, weights=w))))


class _Skin:
    """The skin at one level of detail, with what finds neighbours on it."""

    def __init__(self, points: FloatArray, need: FloatArray, count: int) -> None:
        self.points = points[:: max(1, len(points) // count)]
        self.tree = KDTree(self.points)
        wanted = np.cumsum(need)
        at = (np.arange(count // 2) + 0.5) / (count // 2) * wanted[-1]
        self.wanted = points[np.searchsorted(wanted, at)]  # evenly over the parts that move


def _nearest(tree: KDTree, points: FloatArray) -> tuple[FloatArray, IntArray]:
    distance, index = tree.query(points)
    return np.asarray(distance, float), np.asarray(index, np.int64)


def _starts(y: FloatArray, x: FloatArray, need: FloatArray) -> list[Alignment]:
    """Return similarities from every side, sized by the spread of what moves."""
    centre = np.average(x, axis=0, weights=need)
    spread = np.sqrt(np.average(((x - centre) ** 2).sum(axis=1), weights=need))
    middle = y.mean(axis=0)
    scale = np.full(3, spread / np.sqrt(((y - middle) ** 2).sum(axis=1).mean()))
    turns = [
        Rotation.from_euler("yx", [yaw, pitch], degrees=True).as_matrix()
        for yaw in _YAWS_DEGREES
        for pitch in _PITCHES_DEGREES
    ]
    return [Alignment(scale, turn, centre - scale * (turn @ middle), np.inf) for turn in turns]


def _climb(
    cloud4: FloatArray, skin: _Skin, begin: Alignment, steps: int, *, proportions: bool = False
) -> Alignment:
    """Iterate closest points from one start; the scale per axis comes free half-way."""
    now = begin
    for step in range(steps + 1):
        moved = np.column_stack([now.apply(cloud4[:, :3]), cloud4[:, 3]])
        forward, nearest = _nearest(skin.tree, moved)
        backward, seeker = _nearest(KDTree(moved), skin.wanted)
        keep = forward <= np.quantile(forward, _TRUSTED_PAIR_SHARE)
        found = backward <= np.quantile(backward, _TRUSTED_PAIR_SHARE)
        residual = np.sqrt(
            (forward[keep] ** 2).mean() + _BACKWARD_WEIGHT * (backward[found] ** 2).mean()
        )
        now = replace(now, residual_mm=float(residual))
        if step == steps:
            break
        source = np.concatenate([cloud4[keep, :3], cloud4[seeker[found], :3]])
        target = np.concatenate([skin.points[nearest[keep], :3], skin.wanted[found, :3]])
        weight = np.concatenate(
            [
                np.full(int(keep.sum()), 1 / keep.sum()),
                np.full(int(found.sum()), _BACKWARD_WEIGHT / found.sum()),
            ]
        )
        now = _fit(source, target, weight, now, proportions=proportions and step > steps // 2)
    return now


def _fit(
    y: FloatArray, x: FloatArray, weight: FloatArray, now: Alignment, *, proportions: bool
) -> Alignment:
    """Fit rotation, scale and translation to weighted pairs."""
    w = weight / weight.sum()
    y_mean, x_mean = w @ y, w @ x
    yc, xc = y - y_mean, x - x_mean
    shape = now.scale / np.prod(now.scale) ** (1 / 3) if proportions else np.ones(3)
    u, _, vt = np.linalg.svd((xc / shape * w[:, None]).T @ yc)
    rotation = u @ np.diag([1, 1, np.sign(np.linalg.det(u @ vt))]) @ vt
    turned = yc @ rotation.T
    mean_square = w @ turned**2
    if proportions:
        scale = (w @ (turned * xc)) / mean_square
        middle = np.prod(np.maximum(scale, 1e-9)) ** (1 / 3)
        scale = middle * np.clip(scale / middle, 1e-3, None) ** _PROPORTION_SHARE
        scale = np.clip(scale, middle / _PROPORTION_LIMIT, middle * _PROPORTION_LIMIT)
    else:
        scale = np.full(3, np.sqrt((w @ xc**2).sum() / mean_square.sum()))
    return Alignment(scale, rotation, x_mean - scale * (rotation @ y_mean), np.inf)
