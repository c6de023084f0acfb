"""Rigs that kept their names and changed beneath them."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from tests.usdio.small_rig import small_rig
from usdface.core.assets import MeshShape, Rig, RigMesh, ShapeKey, TrainedMapping
from usdface.core.errors import InputError
from usdface.model.mapping.rig_match import changed_shapes, check_same_rig, rig_summary


def mapping_for(rig: Rig, **arrays: np.ndarray) -> TrainedMapping:
    return TrainedMapping(
        method="ridge",
        marker_names=(),
        shape_names=rig.shapes,
        rigid=(),
        neutral=np.zeros((0, 3)),
        ranges=rig.ranges,
        arrays=rig_summary(rig, rig.shapes) | arrays,
    )


def with_shape(rig: Rig, name: str, change: Callable[[ShapeKey], ShapeKey]) -> Rig:
    def sculpted(shape: MeshShape) -> MeshShape:
        return MeshShape(name, tuple(map(change, shape.keys))) if shape.name == name else shape

    meshes = tuple(replace(mesh, shapes=tuple(map(sculpted, mesh.shapes))) for mesh in rig.meshes)
    return replace(rig, meshes=meshes)


def test_the_rig_of_the_training_and_one_read_in_single_precision_are_the_same() -> None:
    rig = small_rig()
    mapping = mapping_for(rig)
    assert check_same_rig(mapping, rig) == ()
    single = replace(
        rig,
        shapes=rig.shapes[::-1],
        ranges=rig.ranges[::-1],
        meshes=tuple(
            replace(mesh, points=mesh.points.astype(np.float32).astype(float))
            for mesh in rig.meshes[::-1]
        ),
    )
    assert check_same_rig(mapping, single) == ()


@pytest.mark.parametrize(
    "change",
    [
        lambda key: replace(key, offsets=1.1 * key.offsets),
        lambda key: replace(key, offsets=key.offsets * [-1, 1, 1]),
        lambda key: replace(key, offsets=key.offsets + np.array([0.3, 0, 0])),
        lambda key: replace(key, points=key.points - 4),
        lambda key: replace(key, weight=key.weight if key.weight == 1 else key.weight - 0.1),
    ],
    ids=["stronger", "mirrored", "moved", "on other points", "another in-between"],
)
def test_a_sculpt_that_changed_is_noted_with_its_name(
    change: Callable[[ShapeKey], ShapeKey],
) -> None:
    rig = small_rig()
    changed = with_shape(rig, "eyeBlink", change)
    assert changed_shapes(mapping_for(rig), changed) == ("eyeBlink",)
    assert changed_shapes(mapping_for(rig), rig) == ()
    notes = check_same_rig(mapping_for(rig), changed)
    assert len(notes) == 1
    assert "1 of the mapping's 3 shapes have been sculpted or moved" in notes[0]
    assert "eyeBlink (moves" in notes[0]
    assert "train again" in notes[0]


def placed(rig: Rig, turn: np.ndarray, move: tuple[float, float, float]) -> Rig:
    def turned(shape: MeshShape) -> MeshShape:
        keys = (replace(key, offsets=key.offsets @ turn.T) for key in shape.keys)
        return replace(shape, keys=tuple(keys))

    meshes = (
        replace(mesh, points=mesh.points @ turn.T + move, shapes=tuple(map(turned, mesh.shapes)))
        for mesh in rig.meshes
    )
    return replace(rig, meshes=tuple(meshes))


def test_a_rig_that_is_placed_elsewhere_is_the_same_unless_it_was_scaled_or_mirrored() -> None:
    rig, quarter = small_rig(), np.array([[0.0, 0, 1], [0, 1, 0], [-1, 0, 0]])
    assert check_same_rig(mapping_for(rig), placed(rig, quarter, (400, 0, -50))) == ()
    for other in (1.1 * np.eye(3), np.diag([-1.0, 1, 1])):
        (note,) = check_same_rig(mapping_for(rig), placed(rig, other, (400, 0, 0)))
        assert "3 of the mapping's 3 shapes" in note


def test_other_points_are_refused_and_meshes_without_shapes_do_not_count() -> None:
    rig = small_rig()
    mapping = mapping_for(rig)
    lashes = RigMesh("/Hero/geo/lashes", np.zeros((7, 3)), np.zeros(0, int), np.zeros(0, int))
    assert check_same_rig(mapping, replace(rig, meshes=(*rig.meshes, lashes))) == ()
    skin = replace(rig.meshes[0], points=np.r_[rig.meshes[0].points, [[0.0, 0.0, 0.0]]])
    with pytest.raises(InputError, match=r"have 17 points, 16 when .* trained.*train again on"):
        check_same_rig(mapping, replace(rig, meshes=(skin, rig.meshes[1])))


def test_other_ranges_are_noted() -> None:
    rig = small_rig()
    (note,) = check_same_rig(
        mapping_for(rig), replace(rig, ranges=np.array([[0, 0.8], [0, 1], [-0.5, 1.5]]))
    )
    assert "1 shapes have other ranges than in training: jawOpen (0 to 0.8, was 0 to 1)" in note


def test_a_mapping_that_kept_no_summary_is_not_compared() -> None:
    rig = small_rig()
    old = replace(mapping_for(rig), arrays={})
    assert (
        check_same_rig(old, with_shape(rig, "smile", lambda k: replace(k, offsets=9.0 * k.offsets)))
        == ()
    )


def test_a_swelling_that_goes_everywhere_and_nowhere_is_known_by_its_size() -> None:
    outwards = np.array([[1.0, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0]])
    rig = small_rig()
    first = next(key for mesh in rig.meshes for shape in mesh.shapes for key in shape.keys)
    ring = replace(first, points=first.points[:1].repeat(4), offsets=outwards)
    even = with_shape(rig, "eyeBlink", lambda key: replace(ring, weight=key.weight))
    more = with_shape(
        rig, "eyeBlink", lambda key: replace(ring, weight=key.weight, offsets=2 * outwards)
    )
    (note,) = check_same_rig(mapping_for(even), more)
    assert "eyeBlink (moves 2.00 mm, was 1.00)" in note
