"""Register a performer's marker cloud with a character's face, without landmarks.

The unknowns are a rotation, a translation and one scale per axis (the performer's proportions).
Trimmed iterative closest points, started from all sides and matched in both directions, markers to
skin and moving skin to markers: matched in one, the cloud would shrink into a cheek. The amplitude
of motion, where it is known, is a fourth coordinate.

References
----------
Besl and McKay (1992), A method for registration of 3-D shapes, IEEE PAMI 14(2), 239-256.
Chetverikov, Svirko, Stepanov and Krsek (2002), The trimmed iterative closest point algorithm, ICPR.
"""

from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial import KDTree
from scipy.spatial.transform import Rotation

from usdface.core.arrays import FloatArray, rms_radius
from usdface.numerics.rigid.rigid_alignment import is_mirror_image, optimal_rotations

_YAWS_DEGREES = range(0, 360, 30)
_PITCHES_DEGREES = (-20, 0, 20)
_LEAST_UP_COSINE = np.cos(np.deg2rad(40))  # between the cloud's Y axis and up
_TRUSTED_PAIR_SHARE = 0.95  # of the pairs, nearest first; the others are trimmed
_PROPORTION_LIMIT = 1.35  # largest ratio of an axis' scale to the geometric mean of the three
_PROPORTION_SHARE = 0.6  # exponent that shrinks this ratio: wrong pairs stretch it too
_COARSE_SKIN, _FINE_SKIN = 500, 3000  # samples
_COARSE_STEPS, _FINE_STEPS = 12, 40
_MOTION_MM = 40.0  # fourth coordinate of the largest amplitude, on a head 200 mm high


@dataclass(frozen=True)
class Alignment:
    """Map from the performer's space to the character's.

    ``aligned = scale * (cloud @ rotation.T) + translation``
    """

    scale: FloatArray
    """(3,): along the character's axes."""
    rotation: FloatArray
    """(3, 3): proper, determinant +1."""
    translation: FloatArray
    """(3,) [mm]"""
    residual_mm: float = np.inf
    """Trimmed root mean square distance between the cloud and the skin."""

    def apply(self, cloud: FloatArray) -> FloatArray:
        """Return the cloud in the character's space."""
        return self.scale * (cloud @ self.rotation.T) + self.translation

    def apply_to_motion(self, motion: FloatArray) -> FloatArray:
        """Return displacements in the character's space and proportions."""
        return self.scale * (motion @ self.rotation.T)

    def undo(self, placed: FloatArray) -> FloatArray:
        """Return points of the character in the cloud's space."""
        return self.undo_motion(placed - self.translation)

    def undo_motion(self, motion: FloatArray) -> FloatArray:
        """Return displacements of the character in the cloud's space and proportions."""
        return motion / self.scale @ self.rotation


UNMOVED = Alignment(np.ones(3), np.eye(3), np.zeros(3))


def align_landmarks(cloud: FloatArray, targets: FloatArray) -> Alignment:
    """Align named points with a similarity, and refuse a mirrored cloud.

    Parameters
    ----------
    cloud, targets : (n, 3) float arrays
        Pair by pair, at least three.

    Raises
    ------
    ValueError
        If there are too few pairs, they lie on a line, or only a mirrored cloud fits.
    """
    if len(cloud) < 3 or cloud.shape != targets.shape:
        raise ValueError(
            f"landmarks need at least 3 pairs of points, got {cloud.shape} and {targets.shape}"
        )
    yc, xc = cloud - cloud.mean(axis=0), targets - targets.mean(axis=0)
    for points, where in ((yc, "markers"), (xc, "points on the mesh")):
        spread = np.linalg.svd(points, compute_uv=False)
        if spread[1] <= 0.02 * spread[0]:
            raise ValueError(f"the {where} lie on a line or coincide; give --landmarks off it")
    if is_mirror_image(cloud, targets):
        raise ValueError(
            "the landmarks fit only a mirrored face; check that left and right are not exchanged"
        )
    return fit_similarity(cloud, targets, weight=np.ones(len(cloud)))


def align_cloud(
    cloud: FloatArray,
    skin: FloatArray,
    *,
    activity: FloatArray,
    areas: FloatArray,
    amplitude: FloatArray,
) -> Alignment:
    """Fit the rotation, translation and per-axis scale that map a marker cloud onto a face.

    Parameters
    ----------
    cloud : (markers, 3) float array
        The performer's neutral face, Y roughly up, in any heading.
    skin : (samples, 3) float array
        Points of the character's outer face.
    activity : (samples,) float array
        Displacement of each sample by the shapes.
    areas : (samples,) float array
        Area of skin that each sample represents.
    amplitude : (markers,) float array
        Motion of each marker in the take; ignored if all are 0.

    Raises
    ------
    ValueError
        If there are fewer than four markers, or no start ends upright.
    """
    if len(cloud) < 4:
        raise ValueError(f"registration needs at least 4 markers, got {len(cloud)}")
    moving = np.sqrt(activity / activity.max())
    squared = ((skin - skin.mean(axis=0)) ** 2).sum(axis=1)
    size = float(np.sqrt(np.average(squared, weights=areas)))
    largest = float(np.quantile(amplitude, 0.97))
    skin_motion, cloud_motion = np.zeros(len(skin)), np.zeros(len(cloud))
    if largest > 0:  # 0 in a take of one frame
        skin_motion = _MOTION_MM * size / 80 * moving
        cloud_motion = _MOTION_MM * size / 80 * np.sqrt(np.minimum(amplitude / largest, 1.2))
    skin4, cloud4 = np.column_stack([skin, skin_motion]), np.column_stack([cloud, cloud_motion])
    need = areas * (moving > 0.35)  # parts that a marker set always covers
    coarse = _Skin(skin4, need, _COARSE_SKIN)
    ends = [_refine(cloud4, coarse, start, _COARSE_STEPS) for start in _starts(cloud, skin, need)]
    ends = [end for end in ends if end.rotation[1, 1] > _LEAST_UP_COSINE]
    if not ends:
        raise ValueError(
            "no alignment keeps the face upright; check that Y is up, or name landmarks"
        )
    best = sorted(ends, key=lambda end: end.residual_mm)[:3]
    fine = _Skin(skin4, need, _FINE_SKIN)
    ends = [_refine(cloud4, fine, start, _FINE_STEPS, proportions=True) for start in best]
    return min(ends, key=lambda end: end.residual_mm)


def fit_similarity(cloud: FloatArray, targets: FloatArray, *, weight: FloatArray) -> Alignment:
    """Fit rotation, translation and scale to corresponding points (n, 3), weighted.

    The scale is the symmetric one of Horn (1987, J. Opt. Soc. Am. A 4, 629-642).
    """
    fit = _fit(cloud, targets, weight, UNMOVED, proportions=False)
    return _with_residual(fit, cloud, targets, weight)


def align_pairs(cloud: FloatArray, targets: FloatArray, *, weight: FloatArray) -> Alignment:
    """Fit rotation, translation and one scale per axis to corresponding points (n, 3), weighted."""
    now = _fit(cloud, targets, weight, UNMOVED, proportions=False)
    for _ in range(5):
        now = _fit(cloud, targets, weight, now, proportions=True)
    return _with_residual(now, cloud, targets, weight)


def _with_residual(
    fit: Alignment, cloud: FloatArray, targets: FloatArray, weight: FloatArray
) -> Alignment:
    squared = ((fit.apply(cloud) - targets) ** 2).sum(axis=1)
    return replace(fit, residual_mm=float(np.sqrt(np.average(squared, weights=weight))))


class _Skin:
    """The skin at one level of detail."""

    def __init__(self, points: FloatArray, need: FloatArray, count: int) -> None:
        self.points = points[:: max(1, len(points) // count)]
        self.tree = KDTree(self.points)
        total = np.cumsum(need)
        at = (np.arange(count // 2) + 0.5) / (count // 2) * total[-1]
        self.moving = points[np.searchsorted(total, at)]  # evenly over the parts that move


def _starts(y: FloatArray, x: FloatArray, need: FloatArray) -> list[Alignment]:
    """Return similarities from all sides, scaled by the spread of the moving skin."""
    centre, middle = np.average(x, axis=0, weights=need), y.mean(axis=0)
    scale = np.full(3, rms_radius(x, need) / rms_radius(y))
    turns = [
        Rotation.from_euler("yx", [yaw, pitch], degrees=True).as_matrix()
        for yaw in _YAWS_DEGREES
        for pitch in _PITCHES_DEGREES
    ]
    return [Alignment(scale, turn, centre - scale * (turn @ middle)) for turn in turns]


def _refine(
    cloud4: FloatArray, skin: _Skin, start: Alignment, steps: int, *, proportions: bool = False
) -> Alignment:
    """Iterate closest points from one start; axes scale separately in the second half."""
    now = start
    for step in range(steps + 1):
        moved = np.column_stack([now.apply(cloud4[:, :3]), cloud4[:, 3]])
        to_skin, nearest_skin = map(np.asarray, skin.tree.query(moved))
        to_marker, nearest_marker = map(np.asarray, KDTree(moved).query(skin.moving))
        markers = to_skin <= np.quantile(to_skin, _TRUSTED_PAIR_SHARE)
        samples = to_marker <= np.quantile(to_marker, _TRUSTED_PAIR_SHARE)
        residual = np.sqrt((to_skin[markers] ** 2).mean() + (to_marker[samples] ** 2).mean())
        now = replace(now, residual_mm=float(residual))
        if step == steps:
            break
        source = np.concatenate([cloud4[markers, :3], cloud4[nearest_marker[samples], :3]])
        target = np.concatenate([skin.points[nearest_skin[markers], :3], skin.moving[samples, :3]])
        counts = markers.sum(), samples.sum()
        weight = np.repeat(1 / np.array(counts), counts)
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
    cross = (xc / shape * w[:, None]).T @ yc
    rotation = optimal_rotations(cross[None], rank_tolerance=0.0)[0][0]
    turned = yc @ rotation.T
    mean_square = w @ turned**2
    if proportions:
        scale = (w @ (turned * xc)) / mean_square
        middle = np.prod(np.maximum(scale, 1e-9)) ** (1 / 3)
        scale = middle * np.clip(scale / middle, 1e-3, None) ** _PROPORTION_SHARE
        scale = np.clip(scale, middle / _PROPORTION_LIMIT, middle * _PROPORTION_LIMIT)
    else:
        scale = np.full(3, np.sqrt((w @ xc**2).sum() / mean_square.sum()))
    return Alignment(scale, rotation, x_mean - scale * (rotation @ y_mean))
