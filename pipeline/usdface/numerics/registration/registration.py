"""Virtual markers: where a performer's markers sit on a character's face.

Deng et al. picked them by hand, vertex by vertex. Here they are found from the neutral cloud, the
character's surface and, where a take is at hand, from what moves like what.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy import sparse

from usdface.core.arrays import FloatArray, IntArray
from usdface.numerics.registration.cloud_alignment import Alignment, align_cloud, align_landmarks
from usdface.numerics.registration.motion_correspondence import place_by_motion
from usdface.numerics.registration.outer_surface import (
    SurfaceSamples,
    facing_direction,
    sample_outer_surface,
)

Offsets = ArrayLike | sparse.sparray

_MOST_FRAMES = 150
"""That placement looks at: those that differ most from each other."""
_POOL_FRAMES = 3000
"""Spread over the take, among which they are chosen."""


@dataclass(frozen=True)
class VirtualMarkers:
    """Markers of a performer glued to a character's surface.

    ``aligned = scale * (neutral @ rotation.T) + translation`` brings the performer's face onto
    the character's; displacements follow the same rotation and scale.

    Attributes
    ----------
    points : (markers, 3) int array
        The three points of the surface that carry each marker.
    weights : (markers, 3) float array
        Their shares, sum 1.
    scale : (3,) float array
        Character over performer, along the character's axes.
    rotation : (3, 3) float array
        From the performer's space to the character's; proper, so left stays left.
    translation : (3,) float array
        [mm]
    distance_mm : (markers,) float array
        Between the aligned marker and the place found for it: differing proportions, or a
        marker that is not on the face.
    agreement : (markers,) float array
        Share of the marker's motion that the shapes explain at that place [0-1]; NaN when no
        motion was given. Near 0 for markers that hardly move.
    """

    points: IntArray
    weights: FloatArray
    scale: FloatArray
    rotation: FloatArray
    translation: FloatArray
    distance_mm: FloatArray
    agreement: FloatArray


def register_markers(
    neutral: ArrayLike,
    points: ArrayLike,
    triangles: ArrayLike,
    *,
    offsets: Offsets,
    motion: ArrayLike | None = None,
    visible: ArrayLike | None = None,
    rigid: Sequence[int] = (),
    ranges: ArrayLike | None = None,
    landmarks: Mapping[int, int] | None = None,
) -> VirtualMarkers:
    """Find where on a character's face each marker of a performer sits.

    Parameters
    ----------
    neutral : (markers, 3) array
        The performer's neutral face [mm], Y roughly up, looking anywhere.
    points : (points, 3) array
        The character's neutral surface [mm], Y up: a mask or a whole head.
    triangles : (triangles, 3) int array
    offsets : (shapes, points, 3) array or (shapes, 3 * points) sparse array
        What each shape at 1 does to the surface [mm].
    motion : (frames, markers, 3) array, optional
        Stabilised *positions* of a take, in the space of `neutral`. Without motion, upper and
        lower lips or lids may be mistaken for each other.
    visible : (frames, markers) bool array, optional
        False where the capture did not see the marker; such frames are avoided.
    rigid : sequence of int, optional
        Markers that move with the skull alone.
    ranges : (shapes, 2) array, optional
        Limits of the shapes' weights, 0 to 1 unless given.
    landmarks : mapping of int to int, optional
        Markers whose point on the surface is known. Three or more, not on a line, also replace
        the search for an alignment.

    Raises
    ------
    ValueError
        If the arrays do not fit together, the face cannot be found, or the landmarks fit only a
        mirrored face.
    """
    y, P, T = _checked(neutral, points, triangles)
    pins = dict(landmarks or {})
    _check_landmarks(pins, len(y), len(P))
    D = _Offsets(offsets, len(P))
    activity = D.activity()
    paths = None if motion is None else _pick_frames(motion, y, visible, rigid)
    skin = sample_outer_surface(P, T, facing=facing_direction(P, T, activity), activity=activity)
    start = None
    if len(pins) >= 3:
        start = align_landmarks(y[list(pins)], P[list(pins.values())])
    alignment = align_cloud(
        y,
        skin.positions,
        activity=(activity[skin.corners] * skin.weights).sum(axis=1),
        areas=skin.areas,
        amplitude=None if paths is None else np.sqrt((paths**2).sum(axis=2)).mean(axis=0),
        start=start,
    )
    placement = place_by_motion(
        y,
        skin.positions,
        alignment,
        skin_deltas=D.at(skin.corners, skin.weights),
        motion=paths,
        ranges=None if ranges is None else np.asarray(ranges, float),
        pinned={marker: P[point] for marker, point in pins.items()},
    )
    return _glue(y, P, skin, placement.chosen, placement.alignment, placement.agreement, pins)


def marker_deltas(virtual: VirtualMarkers, offsets: Offsets) -> FloatArray:
    """Return what each shape, or key of a shape, does to the virtual markers.

    Parameters
    ----------
    offsets : (shapes, points, 3) array or (shapes, 3 * points) sparse array
        Of the surface that the markers were registered on.

    Returns
    -------
    (shapes, markers, 3) float array
    """
    return _Offsets(offsets, None).at(virtual.points, virtual.weights)


def character_motion(
    virtual: VirtualMarkers, positions: ArrayLike, neutral: ArrayLike
) -> FloatArray:
    """Return a performer's displacements in the character's space and proportions.

    Parameters
    ----------
    positions : (frames, markers, 3) array
        Stabilised [mm].
    neutral : (markers, 3) array
        In the same space.

    Returns
    -------
    (frames, markers, 3) float array
        What the blendshape equation has on its left side [mm].
    """
    moved = np.asarray(positions, float) - np.asarray(neutral, float)
    return np.asarray(virtual.scale * (moved @ virtual.rotation.T), float)


class _Offsets:
    """Shapes over a surface, dense or sparse, sampled without being spread out."""

    def __init__(self, offsets: Offsets, point_count: int | None) -> None:
        if isinstance(offsets, sparse.sparray):
            flat: FloatArray | sparse.sparray = offsets
        else:
            dense = np.asarray(offsets, float)
            if dense.ndim != 3 or dense.shape[2] != 3:
                raise ValueError(
                    f"offsets must be (shapes, points, 3) or sparse (shapes, 3 * points), "
                    f"got {dense.shape}"
                )
            flat = dense.reshape(len(dense), -1)
        self.matrix: sparse.csc_array = sparse.csc_array(flat)
        if point_count is not None and self.matrix.shape[1] != 3 * point_count:
            raise ValueError(
                f"offsets are for {self.matrix.shape[1] // 3} points, the surface has {point_count}"
            )

    def activity(self) -> FloatArray:
        """Return the root of the summed squared offsets of each point."""
        squares = np.asarray(self.matrix.power(2).sum(axis=0), float).reshape(-1, 3)
        return np.asarray(np.sqrt(squares.sum(axis=1)), float)

    def at(self, corners: IntArray, weights: FloatArray) -> FloatArray:
        """Return the shapes at points inside triangles: (shapes, samples, 3)."""
        samples = len(corners)
        rows = (3 * corners[:, :, None] + np.arange(3)).ravel()
        columns = np.repeat(3 * np.arange(samples), 9) + np.tile([0, 1, 2], 3 * samples)
        pick = sparse.csc_array(
            (np.repeat(weights.ravel(), 3), (rows, columns)),
            shape=(self.matrix.shape[1], 3 * samples),
        )
        sampled = np.asarray((self.matrix @ pick).toarray(), float)
        return sampled.reshape(-1, samples, 3)


def _glue(
    y: FloatArray,
    P: FloatArray,
    skin: SurfaceSamples,
    chosen: IntArray,
    alignment: Alignment,
    agreement: FloatArray,
    pins: dict[int, int],
) -> VirtualMarkers:
    corners, weights = skin.corners[chosen], skin.weights[chosen]
    for marker, point in pins.items():
        corners[marker], weights[marker] = point, (1.0, 0.0, 0.0)
    place = np.einsum("mk,mkc->mc", weights, P[corners])
    return VirtualMarkers(
        corners,
        weights,
        alignment.scale,
        alignment.rotation,
        alignment.translation,
        np.linalg.norm(alignment.apply(y) - place, axis=1),
        agreement,
    )


def _pick_frames(
    motion: ArrayLike, neutral: FloatArray, visible: ArrayLike | None, rigid: Sequence[int]
) -> FloatArray:
    """Return the displacements of frames that differ most from each other."""
    positions = np.asarray(motion, float)
    if positions.ndim != 3 or positions.shape[1:] != neutral.shape or not len(positions):
        raise ValueError(
            f"motion must be (frames, {len(neutral)}, 3) like the neutral, got {positions.shape}"
        )
    if not np.isfinite(positions).all():
        raise ValueError("motion must be finite; fill gaps first")
    usable = np.arange(len(positions))
    if visible is not None:
        seen = np.asarray(visible, bool).mean(axis=1)
        usable = np.flatnonzero(seen >= min(0.999, float(np.quantile(seen, 0.5))))
    usable = usable[:: max(1, len(usable) // _POOL_FRAMES)]
    moved = positions[usable] - neutral
    moved[:, list(rigid)] = 0
    flat = moved.reshape(len(moved), -1)
    picked, far = [int((flat**2).sum(axis=1).argmax())], np.full(len(flat), np.inf)
    while len(picked) < min(_MOST_FRAMES, len(flat)):
        far = np.minimum(far, ((flat - flat[picked[-1]]) ** 2).sum(axis=1))
        picked.append(int(far.argmax()))
    return moved[picked]


def _checked(
    neutral: ArrayLike, points: ArrayLike, triangles: ArrayLike
) -> tuple[FloatArray, FloatArray, IntArray]:
    y, P = np.asarray(neutral, float), np.asarray(points, float)
    T = np.asarray(triangles, np.int64)
    for name, array in (("neutral", y), ("points", P), ("triangles", T)):
        if array.ndim != 2 or array.shape[1] != 3:
            raise ValueError(f"{name} must be (n, 3), got {array.shape}")
        if not np.isfinite(array).all():
            raise ValueError(f"{name} must be finite; leave unseen markers out")
    if T.size and (T.min() < 0 or T.max() >= len(P)):
        raise ValueError(f"triangles name point {T.max()} of a surface with {len(P)} points")
    return y, P, T


def _check_landmarks(pins: dict[int, int], markers: int, points: int) -> None:
    for marker, point in pins.items():
        if not 0 <= marker < markers or not 0 <= point < points:
            raise ValueError(
                f"landmark {marker} -> {point}: there are {markers} markers and {points} points"
            )
