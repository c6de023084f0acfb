"""Whether a rig is still the one that a mapping was trained on.

A mapping's weights mean something on one rig only: a shape sculpted again under the same name does
something else at the same weight. So a mapping keeps a few lengths of each shape of its rig.
"""

import numpy as np

from usdface.core.arrays import FloatArray
from usdface.core.assets import MeshShape, Rig, RigMesh, TrainedMapping
from usdface.core.errors import InputError
from usdface.core.text import first_few

POINTS, SHAPES = "rig_points", "rig_shapes"

CHANGED_MM = 0.05
"""What no rounding to single precision makes, and nobody sees."""

CHANGED_SHARE = 0.01
"""Of a shape's motion, and of the weight an in-between is reached at."""

_SIZE, _PLACE, _WAY, _REACHED = 0, slice(1, 4), slice(4, 7), 7


def rig_summary(rig: Rig, shape_names: tuple[str, ...]) -> dict[str, FloatArray]:
    """Return what tells a rig from another with the same names, as arrays of a mapping.

    Parameters
    ----------
    shape_names : tuple of str
        The mapping's; a rig's other shapes, and meshes that none of these moves, do not count.

    Returns
    -------
    dict of str to float array
        ``rig_points``: (1,), points of the meshes that shapes move. ``rig_shapes``:
        (shapes, 8): mean size of a shape's motion, where it is (x, y, z) and where it goes
        (x, y, z) [mm], each point weighed by how far it moves; and the weight at which its keys
        are reached, on average.
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
    """Return the shapes that have been sculpted or moved since the mapping was trained."""
    if SHAPES not in mapping.arrays:
        return ()
    now = rig_summary(rig, mapping.shape_names)[SHAPES]
    return tuple(mapping.shape_names[at] for at in _changed(mapping.arrays[SHAPES], now))


def check_same_rig(mapping: TrainedMapping, rig: Rig) -> tuple[str, ...]:
    """Compare a rig with the one a mapping was trained on.

    A sculpt that moved is worth a note: weights still mean something close. Other points are
    another head, and what a mapping learned of errors and limits is not true there.

    Parameters
    ----------
    mapping : TrainedMapping
        One of an earlier version, without a summary, is not compared.
    rig : Rig
        With all shapes of the mapping.

    Returns
    -------
    tuple of str
        A note for each kind of change; none where nothing changed.
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
            f"been sculpted or moved since training: {moved}; weights are those "
            "for the shapes as they were, train again to follow them"
        )
    ranges = rig.ranges[[rig.shapes.index(name) for name in mapping.shape_names]]
    other = np.flatnonzero(np.abs(ranges - mapping.ranges).max(axis=1) > 1e-6)
    if len(other):
        differing = first_few(
            f"{mapping.shape_names[shape]} ({_span(ranges[shape])}, was "
            f"{_span(mapping.ranges[shape])})"
            for shape in other
        )
        notes.append(
            f"{rig.file}: {len(other)} shapes have other ranges than in training: "
            f"{differing}; weights keep to those of the training"
        )
    return tuple(notes)


def _shape_summary(parts: list[tuple[RigMesh, MeshShape]]) -> FloatArray:
    """Sum over every key of every mesh that one channel moves."""
    total, squares, reached = 0.0, 0.0, 0.0
    place, way = np.zeros(3), np.zeros(3)
    for mesh, shape in parts:
        for key in shape.keys:
            length = np.linalg.norm(key.offsets, axis=1)
            total += float(length.sum())
            squares += float(length @ length)
            reached += key.weight * float(length.sum())
            place += length @ mesh.points[key.points]
            way += length @ key.offsets
    if total == 0:
        return np.zeros(8)
    return np.concatenate([[squares], place, way, [reached]]) / total


def _changed(trained: FloatArray, now: FloatArray) -> np.ndarray:
    limit = np.maximum(CHANGED_MM, CHANGED_SHARE * trained[:, _SIZE])
    away = np.abs(now - trained)
    changed = away[:, _SIZE] > limit
    changed |= np.linalg.norm(away[:, _PLACE], axis=1) > limit
    changed |= np.linalg.norm(away[:, _WAY], axis=1) > limit
    changed |= away[:, _REACHED] > CHANGED_SHARE
    found: np.ndarray = np.flatnonzero(changed)
    return found


def _span(limits: FloatArray) -> str:
    return f"{limits[0]:g} to {limits[1]:g}"
