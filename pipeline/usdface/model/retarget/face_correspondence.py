"""Correspondence of the faces of two rigs, and of the displacements by their shapes.

The faces are aligned (rotation, translation, one scale per axis), so that meshes may differ in
topology, size and proportions: by the landmarks of eyes and mouth, or, on a rig without them, by
their outer surfaces. Every shape is then a field of displacements over the same samples.

*Position matching*, the method of comparison of S11 (section 6.3), finds the non-negative weights
of the target whose displacements are nearest to the source's.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass

import numpy as np
from scipy.spatial import KDTree

from usdface.core.arrays import FloatArray, IntArray
from usdface.core.assets import Rig, range_ends
from usdface.core.deformer import Deformer
from usdface.core.errors import InputError
from usdface.model.placement.rig_landmarks import find_landmarks
from usdface.numerics.registration.cloud_alignment import (
    UNMOVED,
    Alignment,
    align_cloud,
    align_pairs,
)
from usdface.numerics.registration.face_skin import TYPICAL_SIZE_MM, FaceSkin
from usdface.numerics.solve.bounded_least_squares import solve_bounded_least_squares

CLOUD_POINTS = 400
"""Points of the source for the alignment, which are searched from every start."""

_SAMPLE_COUNT = 1500
"""Samples on which both faces are compared."""

_ALIGNING_LANDMARKS = ("lid_upper_L", "lid_upper_R", "mouth_middle")
"""Landmarks without which two faces are aligned by their surfaces."""

_LEAST_DEPTH = 1e-3
"""Least extent of a face along its shortest axis, relative to its longest."""

_SAME_SHARE = 1e-3
"""[of the face's size] Largest distance between the points of the same head."""

RIDGE_SHARE = 1e-3
"""Ridge of position matching, as a share of the mean square of the displacements."""


@dataclass(frozen=True)
class Correspondence:
    """Displacements by the shapes of two rigs at corresponding points."""

    source: FloatArray
    target: FloatArray
    """`source`, `target`: (shapes, samples, 3): displacements at the ends of the shapes' ranges in
    the frame of the target's face, the source's in its proportions [mm]."""
    source_ends: FloatArray
    target_ends: FloatArray
    """`source_ends`, `target_ends`: (shapes,): weights of these (`range_ends`)."""
    mirror: IntArray
    """(samples,): the sample nearest to the mirror image of each."""

    def similarity(self) -> FloatArray:
        """Return the cosine between every source and every target shape: (ns, nt)."""
        return np.asarray(unit_fields(self.source) @ unit_fields(self.target).T)


def correspond(source: Rig, target: Rig) -> Correspondence:
    """Align two faces.

    The same head, with other shapes, is not moved. Else each is aligned to the other, and the
    alignment with the smaller residual is used, so that the result does not depend on which one is
    the source.

    Raises
    ------
    InputError
        If one of them has no recognisable face, or no alignment is upright.
    """
    one, other = _find_face(source), _find_face(target)
    with _surface_errors(f"{source.file} on {target.file}"):
        forward, forward_error = _align(one, other)
        backward, backward_error = _align(other, one)
    by_inverse = backward_error < forward_error
    place = backward.undo if by_inverse else forward.apply
    move = backward.undo_motion if by_inverse else forward.apply_to_motion
    (skin, _), (other_skin, _) = one, other
    chosen = np.arange(0, len(skin.positions), max(len(skin.positions) // _SAMPLE_COUNT, 1))
    _, nearest = KDTree(other_skin.positions).query(place(skin.positions[chosen]))
    at = other_skin.positions[np.asarray(nearest, np.int64)]
    _, opposite = KDTree(at).query(at * [-1, 1, 1] + [2 * at[:, 0].mean(), 0, 0])
    return Correspondence(
        source=move(skin.deltas[:, chosen].astype(np.float64)),
        target=other_skin.deltas[:, np.asarray(nearest, np.int64)].astype(np.float64),
        source_ends=range_ends(source.ranges),
        target_ends=range_ends(target.ranges),
        mirror=np.asarray(opposite, np.int64),
    )


_Face = tuple[FaceSkin, dict[str, FloatArray]]
"""Skin and landmarks."""


def _align(one: _Face, other: _Face) -> tuple[Alignment, float]:
    """Return the alignment of a face to another, and its residual over the other's size."""
    (skin, landmarks), (other_skin, other_landmarks) = one, other
    rest, other_rest = skin.positions, other_skin.positions
    if rest.shape == other_rest.shape:
        if np.abs(rest - other_rest).max() < _SAME_SHARE * TYPICAL_SIZE_MM:
            return UNMOVED, 0.0
    common = sorted(landmarks.keys() & other_landmarks.keys())
    if set(_ALIGNING_LANDMARKS) <= set(common):
        places, targets = (np.array([each[1][name] for name in common]) for each in (one, other))
        found = align_pairs(places, targets, weight=np.ones(len(common)))
    else:
        stride = max(len(rest) // CLOUD_POINTS, 1)
        found = align_cloud(
            rest[::stride],
            other_rest,
            activity=other_skin.activity(),
            areas=other_skin.areas,
            amplitude=skin.activity()[::stride],
        )
    return found, found.residual_mm / TYPICAL_SIZE_MM


def match_positions(both: Correspondence, weights: FloatArray) -> FloatArray:
    """Return target weights whose displacements are nearest to the source's.

    None has the opposite sign of its shape's end. Returns (frames, target shapes), from weights
    (frames, source shapes).
    """
    matrix = both.target.reshape(len(both.target), -1).T
    displacements = (weights / both.source_ends) @ both.source.reshape(len(both.source), -1)
    return both.target_ends * solve_bounded_least_squares(
        matrix,
        displacements,
        lower=np.zeros(len(both.target)),
        upper=np.full(len(both.target), np.inf),
        ridge=RIDGE_SHARE * float((matrix**2).sum(axis=0).mean()),
    )


def _find_face(rig: Rig) -> _Face:
    deformer = Deformer(rig)
    with _surface_errors(str(rig.file)):
        skin = deformer.face_skin()
    extents = np.linalg.svd(skin.positions - skin.positions.mean(axis=0), compute_uv=False)
    if extents[-1] < _LEAST_DEPTH * extents[0]:
        raise InputError(f"{rig.file}: the surface is too flat for a face")
    return skin, find_landmarks(skin, rig.shapes)


@contextmanager
def _surface_errors(where: str) -> Iterator[None]:
    """Report a surface without extent, or without moving parts, as bad input."""
    try:
        with np.errstate(divide="raise", invalid="raise"):
            yield
    except FloatingPointError as error:
        raise InputError(f"{where}: the surface is too small or too flat for a face") from error
    except ValueError as error:
        raise InputError(f"{where}: {error}") from error


def unit_fields(fields: FloatArray) -> FloatArray:
    """Return fields (n, samples, 3) as unit vectors (n, 3 * samples); 0 where nothing moves."""
    flat = fields.reshape(len(fields), -1)
    return np.asarray(flat / np.maximum(np.linalg.norm(flat, axis=1, keepdims=True), 1e-12))
