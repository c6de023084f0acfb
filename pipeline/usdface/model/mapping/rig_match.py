"""Comparison of a rig with that of a mapping's training.

Weights are valid for one rig: a shape resculpted under the same name moves differently at the same
weight. A mapping therefore stores moments of each shape's displacements.
"""

import numpy as np

from usdface.core.arrays import FloatArray
from usdface.core.assets import MeshShape, Rig, RigMesh, TrainedMapping
from usdface.core.errors import InputError
from usdface.core.text import first_few
from usdface.numerics.rigid.rigid_alignment import align_rigid

POINTS, SHAPES = "rig_points", "rig_shapes"

CHANGED_MM = 0.05
"""Change of a moment that is reported: above rounding to single precision, below visibility."""

CHANGED_SHARE = 0.01
"""The same relative to the shape's motion, and for the weights of in-betweens."""

_SIZE, _POSITION, _DISPLACEMENT, _KEY_WEIGHT = 0, slice(1, 4), slice(4, 7), 7
"""Columns of ``rig_shapes``."""


def rig_summary(rig: Rig, shape_names: tuple[str, ...]) -> dict[str, FloatArray]:
    """Return moments of a rig's shapes, as arrays of a mapping.

    ``rig_points``, (1,), is the number of points of the meshes that the shapes move.
    ``rig_shapes``, (shapes, 8), are means weighted by the displacement of each point: its length,
    position (x, y, z), displacement (x, y, z) [mm], and the weight of its key.

    `shape_names`: of the mapping; other shapes, and meshes that none of these moves, are ignored.
    """
    named = frozenset(shape_names)
    meshes = [mesh for mesh in rig.meshes if any(shape.name in named for shape in mesh.shapes)]
    points = np.array([float(sum(len(mesh.points) for mesh in meshes))])
    parts: dict[str, list[tuple[RigMesh, MeshShape]]] = {name: [] for name in shape_names}
    for mesh in meshes:
        for shape in mesh.shapes:
            if shape.name in named:
                parts[shape.name].append((mesh, shape))
    rows = [_shape_summary(parts[name]) for name in shape_names]
    return {POINTS: points, SHAPES: np.array(rows).reshape(-1, 8)}


def changed_shapes(mapping: TrainedMapping, rig: Rig) -> tuple[str, ...]:
    """Return the shapes that were resculpted or moved since the mapping was trained."""
    if SHAPES not in mapping.arrays:
        return ()
    now = rig_summary(rig, mapping.shape_names)[SHAPES]
    return tuple(mapping.shape_names[at] for at in _changed(mapping.arrays[SHAPES], now))


def check_same_rig(mapping: TrainedMapping, rig: Rig) -> tuple[str, ...]:
    """Compare a rig with the one a mapping was trained on.

    Returns a note for each kind of change of the shapes, for which the weights are approximate.

    Parameters
    ----------
    mapping : TrainedMapping
        Without a summary, as in earlier versions, it is not compared.
    rig : Rig
        With all shapes of the mapping.

    Raises
    ------
    InputError
        If the number of points differs: errors and limits of the mapping are not valid there.
    """
    if POINTS not in mapping.arrays or SHAPES not in mapping.arrays:
        return ()
    now = rig_summary(rig, mapping.shape_names)
    trained_points, points = int(mapping.arrays[POINTS][0]), int(now[POINTS][0])
    if points != trained_points:
        raise InputError(
            f"{rig.file}: the meshes that the mapping's shapes move have {points} points, "
            f"{trained_points} when the mapping was trained: it is another rig, or its topology "
            "changed. Map onto the rig of the training, or train again on this one "
            "(`usdface train`; tuned pairs are kept)"
        )
    notes = []
    changed = _changed(mapping.arrays[SHAPES], now[SHAPES])
    if len(changed):
        was, size = mapping.arrays[SHAPES][:, _SIZE], now[SHAPES][:, _SIZE]
        moved = first_few(
            f"{mapping.shape_names[shape]} (moves {size[shape]:.2f} mm, was {was[shape]:.2f})"
            for shape in changed
        )
        notes.append(
            f"{rig.file}: {len(changed)} of the mapping's {len(mapping.shape_names)} shapes have "
            f"been sculpted or moved since training: {moved}; weights are predicted for the shapes "
            "before the change, as the pairs were keyed: tune those that show them, and train again"
        )
    ranges = rig.ranges_of(mapping.shape_names)
    other = np.flatnonzero(np.abs(ranges - mapping.ranges).max(axis=1) > 1e-6)
    if len(other):
        differing = first_few(
            f"{mapping.shape_names[shape]} ({_span(ranges[shape])}, was "
            f"{_span(mapping.ranges[shape])})"
            for shape in other
        )
        notes.append(
            f"{rig.file}: {len(other)} shapes have other ranges than in training: "
            f"{differing}; weights are limited to those of the training"
        )
    return tuple(notes)


def _shape_summary(parts: list[tuple[RigMesh, MeshShape]]) -> FloatArray:
    """Return the row of ``rig_shapes`` over all keys and meshes of one shape; see `rig_summary`."""
    total, squares, reached = 0.0, 0.0, 0.0
    position, displacement = np.zeros(3), np.zeros(3)
    for mesh, shape in parts:
        for key in shape.keys:
            length = np.linalg.norm(key.offsets, axis=1)
            total += float(length.sum())
            squares += float(length @ length)
            reached += key.weight * float(length.sum())
            position += length @ mesh.points[key.points]
            displacement += length @ key.offsets
    if total == 0:
        return np.zeros(8)
    return np.concatenate([[squares], position, displacement, [reached]]) / total


def _changed(trained: FloatArray, now: FloatArray) -> np.ndarray:
    """Return the rows that differ; none if the rig as a whole was placed elsewhere or turned."""
    pose = align_rigid(now[None, :, _POSITION], trained[:, _POSITION])
    placed = trained.copy()
    placed[:, _POSITION] = trained[:, _POSITION] @ pose.rotations[0].T + pose.translations[0]
    placed[:, _DISPLACEMENT] = trained[:, _DISPLACEMENT] @ pose.rotations[0].T
    return _differing(trained if len(_differing(placed, now)) else placed, now)


def _differing(trained: FloatArray, now: FloatArray) -> np.ndarray:
    limit = np.maximum(CHANGED_MM, CHANGED_SHARE * trained[:, _SIZE])
    away = np.abs(now - trained)
    changed = away[:, _SIZE] > limit
    changed |= np.linalg.norm(away[:, _POSITION], axis=1) > limit
    changed |= np.linalg.norm(away[:, _DISPLACEMENT], axis=1) > limit
    changed |= away[:, _KEY_WEIGHT] > CHANGED_SHARE
    return np.asarray(np.flatnonzero(changed))


def _span(limits: FloatArray) -> str:
    return f"{limits[0]:g} to {limits[1]:g}"
