"""A face lies where it lies, whatever else is in a rig and however its shapes are stated."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tests.remembered import coarse_face_skin
from usdface.core.arrays import FloatArray
from usdface.core.assets import MeshShape, Rig, RigMesh, ShapeKey
from usdface.core.deformer import Deformer
from usdface.demo.dog import dog_rig
from usdface.demo.rig import demo_rig
from usdface.model.placement.rig_landmarks import find_landmarks
from usdface.model.placement.rig_orientation import check_rig_upright, facing_degrees

_SAMPLING_MM = 10.0
"""Other triangles lead to other, here coarse, samples of the skin: landmarks are the nearest."""


@pytest.fixture(autouse=True)
def coarse_skin(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("usdface.core.deformer.sample_face_skin", coarse_face_skin)


def landmarks(rig: Rig) -> dict[str, FloatArray]:
    skin = Deformer(rig).face_skin()
    return {name: skin.from_frame(at) for name, at in find_landmarks(skin, rig.shapes).items()}


@pytest.fixture(scope="module")
def rig() -> Rig:
    return demo_rig()


@pytest.fixture(scope="module")
def usual(rig: Rig) -> dict[str, FloatArray]:
    """Return the landmarks of the rig as it is."""
    return landmarks(rig)


def with_shape(rig: Rig, mesh: RigMesh, name: str, offsets: FloatArray) -> Rig:
    """Return a rig with one more shape, of a mesh that it has or not."""
    key = ShapeKey(1.0, np.arange(len(mesh.points)), offsets)
    moved = replace(mesh, shapes=(*mesh.shapes, MeshShape(name, (key,))))
    others = tuple(each for each in rig.meshes if each is not mesh)
    ranges = np.vstack([rig.ranges, [0.0, 1.0]])
    return replace(rig, meshes=(moved, *others), shapes=(*rig.shapes, name), ranges=ranges)


def mapped(rig: Rig, change: Callable[[ShapeKey], ShapeKey], limits: FloatArray) -> Rig:
    meshes = tuple(
        replace(
            mesh, shapes=tuple(replace(s, keys=tuple(map(change, s.keys))) for s in mesh.shapes)
        )
        for mesh in rig.meshes
    )
    return replace(rig, meshes=meshes, ranges=np.tile(limits, (len(rig.shapes), 1)))


@pytest.mark.parametrize("beside", [0.0, 400.0])
def test_a_hidden_copy_is_no_second_face(
    rig: Rig, usual: dict[str, FloatArray], beside: float
) -> None:
    copies = tuple(
        replace(m, path=f"{m.path}_copy", points=m.points + np.eye(3)[0] * beside, visible=False)
        for m in rig.meshes
    )
    found = landmarks(replace(rig, meshes=(*rig.meshes, *copies)))
    for name, place in usual.items():
        np.testing.assert_allclose(found[name], place, atol=1e-6)
    all_hidden = tuple(replace(m, visible=False) for m in rig.meshes)
    assert landmarks(replace(rig, meshes=all_hidden)).keys() == found.keys()


@pytest.mark.parametrize("axis", ["x", "y", "z"])
@pytest.mark.parametrize("degrees", [10.0, 60.0])
def test_a_shape_that_turns_the_head_is_no_expression(
    rig: Rig, usual: dict[str, FloatArray], axis: str, degrees: float
) -> None:
    skin = max(rig.meshes, key=lambda mesh: len(mesh.points))
    height = skin.points[:, 1]
    low, high = np.quantile(height, [0.02, 0.3])
    share = np.clip((height - low) / (high - low), 0.0, 1.0)[:, None]
    about = skin.points - skin.points.mean(axis=0)
    turned = Rotation.from_euler(axis, degrees, degrees=True).apply(about)
    found = landmarks(with_shape(rig, skin, "headTurn", share * (turned - about)))
    for name, place in usual.items():
        np.testing.assert_allclose(found[name], place, atol=1e-6)


def test_a_shape_that_hides_a_part_far_away_is_no_expression(
    rig: Rig, usual: dict[str, FloatArray]
) -> None:
    points = rig.meshes[0].points.mean(axis=0) + 10 * np.eye(3)
    prop = RigMesh("/prop", points, np.array([3]), np.arange(3))
    hiding = with_shape(rig, prop, "hide", np.tile([0.0, -10_000.0, 0.0], (3, 1)))
    found = landmarks(hiding)
    for name, place in usual.items():
        np.testing.assert_allclose(found[name], place, atol=_SAMPLING_MM)
    count = len(Deformer(rig).shapes.face_points)
    assert len(Deformer(hiding).shapes.face_points) == pytest.approx(count, rel=0.01)


@pytest.mark.parametrize("end", [100.0, 0.1, -1.0])
def test_ranges_of_any_unit_and_sign_show_one_face(
    rig: Rig, usual: dict[str, FloatArray], end: float
) -> None:
    limits = np.sort([0.0, end])
    other = mapped(rig, lambda key: replace(key, offsets=key.offsets / end), limits)
    found = landmarks(other)
    for name, place in usual.items():
        np.testing.assert_allclose(found[name], place, atol=1e-3)
    assert check_rig_upright(other) == check_rig_upright(rig)
    assert facing_degrees(other) == facing_degrees(rig)


def test_a_mask_looks_ahead_whichever_way_its_faces_wind(rig: Rig) -> None:
    skin = max(rig.meshes, key=lambda mesh: len(mesh.points))
    corners = skin.face_indices.reshape(-1, skin.face_counts[0])
    front = skin.points[corners, 2].min(axis=1) > np.quantile(skin.points[:, 2], 0.5)
    counts, corners = skin.face_counts[front], corners[front]
    mask = replace(skin, face_counts=counts, face_indices=corners.ravel())
    turned = replace(mask, face_indices=corners[:, ::-1].ravel(), inside_out=True)
    for mesh in (mask, turned):
        assert Deformer(replace(rig, meshes=(mesh,))).face_skin().frame[2, 2] > 0.99


def test_lips_parted_at_rest_are_a_mouth(rig: Rig, usual: dict[str, FloatArray]) -> None:
    share = 0.25
    parted = tuple(
        replace(mesh, points=mesh.points + share * mesh_offsets(mesh, "jawOpen"))
        for mesh in rig.meshes
    )
    found = landmarks(replace(rig, meshes=parted))
    assert "chin" in found
    for corner in ("mouth_L", "mouth_R"):
        assert np.linalg.norm(found[corner] - usual[corner]) < _SAMPLING_MM


def mesh_offsets(mesh: RigMesh, name: str) -> FloatArray:
    offsets = np.zeros_like(mesh.points)
    for shape in mesh.shapes:
        if shape.name == name:
            offsets[shape.keys[-1].points] = shape.keys[-1].offsets
    return offsets


def test_the_brow_is_not_on_the_muzzle() -> None:
    found = landmarks(dog_rig())
    assert found["nose_tip"][2] - found["brow_inner_L"][2] > 50
    assert abs(found.get("brow_centre", found["brow_inner_L"]) - found["brow_inner_L"])[2] < 20
