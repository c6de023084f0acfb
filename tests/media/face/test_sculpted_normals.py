"""Normals that were sculpted are there at rest and at every key; between, they follow the face."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from pxr import Usd, UsdGeom, UsdSkel, Vt

from tests.media.forms import mesh
from tests.usdio.small_rig import small_rig
from usdface.core.assets import MeshShape, Rig, RigMesh, ShapeKey
from usdface.core.deformer import Deformer
from usdface.media.face.camera import Camera
from usdface.media.face.render import FaceRenderer
from usdface.media.face.sculpted_normals import SculptedNormals
from usdface.numerics.surface.triangulation import normal_operator, triangulate, vertex_normals
from usdface.usdio.rig.read import read_rig
from usdface.usdio.rig.write import write_rig

FAR = Camera(eye=(0.0, 0.0, 3000.0), target=(0.0, 0.0, 0.0), fov_degrees=3.0)


def sheet_of(*keys: ShapeKey, **fields) -> Rig:
    x, y = np.meshgrid(np.linspace(-60, 60, 7), np.linspace(-60, 60, 7))
    points = np.stack([x.ravel(), y.ravel(), np.zeros(49)], axis=1)
    corner = np.arange(42).reshape(6, 7)[:, :-1].ravel()
    faces = np.stack([corner, corner + 1, corner + 8, corner + 7], axis=1)
    form = mesh(points, faces.tolist(), shapes=(MeshShape("lift", keys),), **fields)
    return Rig(Path("sheet.usda"), "/Form", ("lift",), (form,), np.array([[0.0, 1.0]]))


def unit(vectors: np.ndarray) -> np.ndarray:
    return vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)


def lit_by(rig: Rig, weight: float) -> np.ndarray:
    """The unit normals that a picture is lit by."""
    deformer = Deformer(rig)
    posed = deformer.points(np.array([[weight]]))[0]
    own = rig.meshes[0]
    triangles, _ = triangulate(own.face_counts, own.face_indices)
    surface = vertex_normals(posed, triangles, normal_operator(triangles, point_count=len(posed)))
    added = SculptedNormals(rig, deformer).at(np.array([weight]))
    return unit(surface if added is None else surface + added)


def bump(weight: float = 1.0, *, sculpted: bool = True) -> ShapeKey:
    rng = np.random.default_rng(0)
    moved = np.arange(10, 40)
    normals = rng.normal(0, 0.3, (len(moved), 3)) if sculpted else None
    return ShapeKey(weight, moved, rng.normal(0, 6, (len(moved), 3)) * weight, normals)


def authored() -> np.ndarray:
    return unit(np.random.default_rng(1).normal([0, 0, 2], 0.4, (49, 3)))


def test_at_rest_and_at_each_key_normals_are_those_that_were_sculpted() -> None:
    half, full = bump(0.5), bump()
    rig = sheet_of(half, full, normals=authored())
    np.testing.assert_allclose(lit_by(rig, 0.0), authored(), atol=1e-9)
    for key in (half, full):
        expected = authored()
        expected[key.points] += key.normal_offsets
        np.testing.assert_allclose(lit_by(rig, key.weight), unit(expected), atol=1e-6)


def test_a_shape_without_normal_offsets_takes_authored_normals_along() -> None:
    rng = np.random.default_rng(2)
    tilt = np.array([[1, 0, 0], [0, np.cos(0.6), -np.sin(0.6)], [0, np.sin(0.6), np.cos(0.6)]])
    flat = sheet_of(bump(sculpted=False))
    points = flat.meshes[0].points
    turn = ShapeKey(1.0, np.arange(49), points @ tilt.T - points)
    near = unit(np.array([0, 0, 1.0]) + rng.normal(0, 0.02, (49, 3)))
    rig = sheet_of(turn, normals=near)
    angles = np.degrees(np.arccos(np.clip(np.sum(lit_by(rig, 1.0) * (near @ tilt.T), -1), -1, 1)))
    assert angles.max() < 3  # left behind they would be 34 degrees away


def test_a_rig_that_says_nothing_of_normals_costs_nothing() -> None:
    for rig in (
        sheet_of(bump(sculpted=False)),
        sheet_of(bump(), normals=authored(), subdivision="catmullClark"),
    ):
        sculpted = SculptedNormals(rig, Deformer(rig))
        assert not sculpted.any
        assert sculpted.at(np.array([0.7])) is None


def test_a_mesh_wound_the_other_way_is_lit_alike() -> None:
    rig = sheet_of(bump(), normals=authored())
    own = rig.meshes[0]
    flipped = replace(own, face_indices=own.face_indices.reshape(-1, 4)[:, ::-1].ravel())
    np.testing.assert_allclose(lit_by(replace(rig, meshes=(flipped,)), 1.0), -lit_by(rig, 1.0))


def test_a_shape_that_turns_normals_alone_is_seen() -> None:
    moved = np.arange(49)
    key = ShapeKey(1.0, moved, np.zeros((49, 3)), np.tile([0.0, -0.8, 0.0], (49, 1)))
    rig = sheet_of(key, colors=np.full((49, 3), 0.5))
    deformer, renderer = Deformer(rig), FaceRenderer(rig.meshes)
    sculpted = SculptedNormals(rig, deformer)
    pictures = [
        renderer.render(
            deformer.points(np.array([[w]]))[0],
            camera=FAR,
            width=60,
            height=60,
            sculpted=sculpted.at(np.array([w])),
        ).astype(float)
        for w in (0.0, 1.0)
    ]
    # The key light comes from above: what looks down is darker.
    assert pictures[1][25:35, 25:35].mean() < pictures[0][25:35, 25:35].mean() - 15


def test_normals_of_a_turned_and_squeezed_mesh_stay_upright(tmp_path: Path) -> None:
    write_rig(tmp_path / "rig.usda", small_rig())
    stage = Usd.Stage.Open(str(tmp_path / "rig.usda"))
    UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.z)
    skin = UsdGeom.Mesh(stage.GetPrimAtPath("/Hero/geo/skin"))
    skin.CreateNormalsAttr(Vt.Vec3fArray([(0, 0, 2)] * 12))
    skin.SetNormalsInterpolation(UsdGeom.Tokens.vertex)
    shape = UsdSkel.BlendShape(
        stage.GetPrimAtPath(
            UsdSkel.BindingAPI(skin.GetPrim()).GetBlendShapeTargetsRel().GetTargets()[0]
        )
    )
    shape.CreateNormalOffsetsAttr(Vt.Vec3fArray([(0, 0, 0.5)] * 3))
    stage.GetRootLayer().Save()
    rig: RigMesh = read_rig(tmp_path / "rig.usda").meshes[0]
    np.testing.assert_allclose(rig.normals, np.tile([0.0, 1.0, 0.0], (12, 1)), atol=1e-6)
    np.testing.assert_allclose(
        rig.shapes[0].keys[-1].normal_offsets, np.tile([0, 0.5, 0], (3, 1)), atol=1e-6
    )


@pytest.mark.parametrize("scale", [(2.0, 2.0, 2.0), (1.0, 3.0, 0.5)])
def test_normals_are_turned_as_the_surface_is(scale: tuple[float, float, float]) -> None:
    from usdface.usdio.rig.mesh import PlacedMesh

    rng = np.random.default_rng(3)
    linear = np.linalg.qr(rng.normal(size=(3, 3)))[0] @ np.diag(scale)
    a, b = rng.normal(size=(2, 3))
    normal = unit(np.cross(a, b))
    turned = PlacedMesh(np.zeros((1, 3)), linear).normals(normal[None])[0]
    assert abs(turned @ (linear @ a)) < 1e-12
    assert abs(turned @ (linear @ b)) < 1e-12
    if len(set(scale)) == 1:
        assert np.linalg.norm(turned) == pytest.approx(1)
