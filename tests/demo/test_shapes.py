"""The shapes: what each has to do for an animator to trust it."""

import numpy as np
import pytest

from tests.demo.posed_head import posed
from usdface.core.arrays import FloatArray
from usdface.demo.half_cage import Mark
from usdface.demo.head import DemoHead, HeadPart, lid_edge, lip_rim
from usdface.demo.rig import mesh_points, rig_from_head

ARKIT = (
    "browDownLeft browDownRight browInnerUp browOuterUpLeft browOuterUpRight cheekPuff "
    "cheekSquintLeft cheekSquintRight eyeBlinkLeft eyeBlinkRight eyeLookDownLeft eyeLookDownRight "
    "eyeLookInLeft eyeLookInRight eyeLookOutLeft eyeLookOutRight eyeLookUpLeft eyeLookUpRight "
    "eyeSquintLeft eyeSquintRight eyeWideLeft eyeWideRight jawForward jawLeft jawOpen jawRight "
    "mouthClose mouthDimpleLeft mouthDimpleRight mouthFrownLeft mouthFrownRight mouthFunnel "
    "mouthLeft mouthLowerDownLeft mouthLowerDownRight mouthPressLeft mouthPressRight mouthPucker "
    "mouthRight mouthRollLower mouthRollUpper mouthShrugLower mouthShrugUpper mouthSmileLeft "
    "mouthSmileRight mouthStretchLeft mouthStretchRight mouthUpperUpLeft mouthUpperUpRight "
    "noseSneerLeft noseSneerRight tongueOut"
).split()


def lip_offset(head: DemoHead, points: FloatArray) -> FloatArray:
    """From the lower to the upper lip, between points that faced each other at rest [mm]."""
    upper = lip_rim(head.points, head.marks, upper=True)
    lower = lip_rim(head.points, head.marks, upper=False)
    x = head.points[upper, 0]
    facing = np.stack([np.interp(x, head.points[lower, 0], points[lower, k]) for k in range(3)], 1)
    return points[upper] - facing


def lip_gap(head: DemoHead, points: FloatArray) -> FloatArray:
    return np.linalg.norm(lip_offset(head, points), axis=1)


def lid_gap(head: DemoHead, points: FloatArray) -> FloatArray:
    """Height of the eye's opening, at points of the upper lid's edge [mm]."""
    upper = lid_edge(head.points, head.marks, upper=True)
    lower = lid_edge(head.points, head.marks, upper=False)
    below = np.interp(points[upper, 0], points[lower, 0], points[lower, 1])
    return points[upper, 1] - below


def test_all_arkit_shapes_are_there_and_do_something(head: DemoHead) -> None:
    assert list(head.shapes) == sorted(ARKIT)
    for name, keys in head.shapes.items():
        assert keys[-1][0] == 1.0
        reach = np.linalg.norm(keys[-1][1], axis=1).max()
        assert 1.5 < reach < 45.0, name


def test_left_and_right_shapes_mirror_exactly(head: DemoHead) -> None:
    for name, keys in head.shapes.items():
        if name.endswith("Left"):
            other = head.shapes[name.removesuffix("Left") + "Right"]
            for (weight, left), (weight_other, right) in zip(keys, other, strict=True):
                assert weight == weight_other
                np.testing.assert_array_equal(left[head.mirror] * (-1.0, 1.0, 1.0), right)


def test_middle_shapes_are_symmetric(head: DemoHead) -> None:
    for name, keys in head.shapes.items():
        if not name.endswith(("Left", "Right")):
            field = keys[-1][1]
            np.testing.assert_array_equal(field[head.mirror] * (-1.0, 1.0, 1.0), field)


def test_a_blink_closes_the_gap(head: DemoHead) -> None:
    opened = lid_gap(head, head.points)
    closed = lid_gap(head, posed(head, {"eyeBlinkLeft": 1.0}))
    assert opened.max() > 8.0
    assert np.abs(closed).max() < 0.8


@pytest.mark.parametrize("weight", [0.1, 0.25, 0.375, 0.5, 0.625, 0.75, 0.9, 1.0])
def test_no_part_of_a_blink_enters_the_eyeball(head: DemoHead, weight: float) -> None:
    points = posed(head, {"eyeBlinkLeft": weight})
    skin = (head.parts == HeadPart.SKIN) & (head.points[:, 0] > 0.0)
    distance = np.linalg.norm(points[skin] - head.style.eye.center, axis=1)
    assert distance.min() > head.style.eye.radius


def test_half_a_blink_half_closes(head: DemoHead) -> None:
    opened, half = (lid_gap(head, posed(head, {"eyeBlinkLeft": w})).max() for w in (0.0, 0.5))
    assert 0.35 * opened < half < 0.65 * opened


def test_a_blink_stays_on_its_side(head: DemoHead) -> None:
    moved = np.linalg.norm(head.shapes["eyeBlinkLeft"][-1][1], axis=1) > 1e-4
    assert head.points[moved, 0].min() > -6.0


def test_the_jaw_opens_the_mouth_wide_and_round(head: DemoHead) -> None:
    gap = lip_gap(head, posed(head, {"jawOpen": 1.0}))
    assert gap.max() >= 15.0
    x = head.points[lip_rim(head.points, head.marks, upper=True), 0]
    assert np.all(gap[np.abs(x) < 0.5 * head.style.mouth.half_width] > 0.7 * gap.max())
    assert gap[[0, -1]].max() < 0.6 * gap.max()


@pytest.mark.parametrize("weight", [0.3, 0.7, 1.0])
def test_mouth_close_brings_the_lips_of_an_open_jaw_together(head: DemoHead, weight: float) -> None:
    opened = lip_gap(head, posed(head, {"jawOpen": weight}))
    shut = lip_gap(head, posed(head, {"jawOpen": weight, "mouthClose": weight}))
    assert shut.max() < 1.0
    assert shut.max() < 0.12 * opened.max()


def test_the_skull_does_not_move(head: DemoHead) -> None:
    still = (
        (head.parts == HeadPart.HAIR)
        | (head.parts == HeadPart.EARS)
        | (head.parts == HeadPart.UPPER_TEETH)
    )
    for keys in head.shapes.values():
        assert np.abs(keys[-1][1][still]).max() == 0.0


def test_eyes_turn_without_changing_form(head: DemoHead) -> None:
    eye = (head.parts == HeadPart.EYES) & (head.points[:, 0] > 0.0)
    for name in ("eyeLookInLeft", "eyeLookOutLeft", "eyeLookUpLeft", "eyeLookDownLeft"):
        offset = posed(head, {name: 1.0})[eye] - head.style.eye.center
        np.testing.assert_allclose(np.linalg.norm(offset, axis=1), head.style.eye.radius, rtol=1e-9)


def test_lashes_stay_on_the_edge_of_the_lid(head: DemoHead) -> None:
    lash = np.flatnonzero(head.parts == HeadPart.LASHES)
    root = head.anchors[lash]
    before = np.linalg.norm(head.points[lash] - head.points[root], axis=1)
    opened = posed(head, {"eyeBlinkLeft": 1.0, "eyeBlinkRight": 1.0})
    after = np.linalg.norm(opened[lash] - opened[root], axis=1)
    assert np.abs(after - before).max() < 1.5


def test_the_rig_carries_every_shape_and_only_what_moves(character: DemoHead) -> None:
    rig = rig_from_head(character)
    assert set(rig.shapes) == set(ARKIT)
    assert {name for mesh in rig.meshes for name in (s.name for s in mesh.shapes)} == set(ARKIT)
    assert sum(len(mesh.points) for mesh in rig.meshes) == len(character.points)
    for mesh, points in zip(rig.meshes, mesh_points(character).values(), strict=True):
        assert mesh.colors is not None
        assert mesh.colors.shape == mesh.points.shape
        assert mesh.face_indices.max() < len(mesh.points)
        for shape in mesh.shapes:
            for key, (weight, offsets) in zip(
                shape.keys, character.shapes[shape.name], strict=True
            ):
                assert key.weight == weight
                dense = np.zeros_like(mesh.points)
                dense[key.points] = key.offsets
                np.testing.assert_allclose(dense, offsets[points], atol=1e-4)
                assert np.all(np.linalg.norm(key.offsets, axis=1) > 1e-4)


def test_blinks_have_an_in_between_at_a_half(character: DemoHead) -> None:
    skin = rig_from_head(character).meshes[0]
    blink = next(s for s in skin.shapes if s.name == "eyeBlinkLeft")
    assert 0.5 in [key.weight for key in blink.keys]
    assert blink.keys[-1].weight == 1.0


def test_the_mouth_does_not_tear_at_its_corners(head: DemoHead) -> None:
    """No edge of the skin round the mouth grows more than fourfold when the jaw drops."""
    near = (head.parts == HeadPart.SKIN) & (np.abs(head.marks[:, Mark.MOUTH_RING]) < 4.0)
    faces = head.faces[np.all(near[head.faces], axis=1)]
    edges = np.unique(
        np.sort(np.stack([faces, np.roll(faces, -1, 1)], -1).reshape(-1, 2), 1), axis=0
    )
    opened = posed(head, {"jawOpen": 1.0})
    before, after = (
        np.linalg.norm(p[edges[:, 0]] - p[edges[:, 1]], axis=1) for p in (head.points, opened)
    )
    assert np.max(after / np.maximum(before, 1.0)) < 5.0
