"""Meshes are read where they stand, and what cannot be deformed is refused."""

from pathlib import Path

import numpy as np
import pytest
from pxr import Sdf, Usd, UsdGeom

from tests.small_scan import small_scan, vectors, write_scan
from tests.usdio.small_rig import small_rig
from usdface.core.errors import InputError
from usdface.usdio.rig.mesh import read_face_mesh
from usdface.usdio.rig.read import read_rig
from usdface.usdio.rig.write import write_rig


def head(path: Path) -> tuple[Usd.Stage, UsdGeom.Mesh]:
    stage = Usd.Stage.Open(str(path))
    return stage, UsdGeom.Mesh(stage.GetPrimAtPath("/Scan/head"))


@pytest.fixture
def scan_file(tmp_path: Path) -> Path:
    return write_scan(tmp_path / "scan.usda", small_scan())


def test_units_up_axis_and_transform_are_taken_into_account(tmp_path: Path) -> None:
    scan = small_scan()
    plain = read_face_mesh(write_scan(tmp_path / "plain.usdc", scan))
    np.testing.assert_allclose(plain.mesh.points, scan.points, atol=1e-4)
    turned = read_face_mesh(write_scan(tmp_path / "turned.usdc", scan, z_up=True))
    distances = [
        np.linalg.norm(mesh.mesh.points[::7] - mesh.mesh.points[0], axis=1)
        for mesh in (plain, turned)
    ]
    np.testing.assert_allclose(*distances, atol=1e-3)


@pytest.mark.parametrize("z_up", [False, True])
def test_a_movement_put_back_into_the_mesh_is_that_movement(tmp_path: Path, z_up: bool) -> None:
    path = write_scan(tmp_path / "scan.usdc", small_scan(), z_up=z_up)
    face = read_face_mesh(path)
    moved = np.random.default_rng(0).normal(0, 5, face.mesh.points.shape)
    stage, mesh = head(path)
    mesh.GetPointsAttr().Set(vectors(face.local + face.to_mesh_space(moved)))
    stage.Save()
    again = read_face_mesh(path)
    np.testing.assert_allclose(again.mesh.points - face.mesh.points, moved, atol=1e-3)


def test_a_mesh_of_a_rig_is_read_as_the_rig_reads_it(tmp_path: Path) -> None:
    write_rig(tmp_path / "rig.usda", small_rig())
    rig = read_rig(tmp_path / "rig.usda")
    face = read_face_mesh(tmp_path / "rig.usda", prim="/Hero/geo/skin")
    np.testing.assert_allclose(face.mesh.points, rig.meshes[0].points, atol=1e-5)
    assert face.others == ("/Hero/geo/teeth",)


def test_the_hash_is_of_the_surface_alone(scan_file: Path) -> None:
    before = read_face_mesh(scan_file).hash
    stage, mesh = head(scan_file)
    mesh.CreateDisplayColorPrimvar("constant").Set([(1, 0, 0)])
    stage.Save()
    assert read_face_mesh(scan_file).hash == before
    points = np.array(mesh.GetPointsAttr().Get())
    points[3] += 0.001
    mesh.GetPointsAttr().Set(points)
    stage.Save()
    assert read_face_mesh(scan_file).hash != before


def test_several_meshes_are_named_with_their_sizes(tmp_path: Path) -> None:
    write_rig(tmp_path / "rig.usda", small_rig())
    with pytest.raises(InputError, match=r"holds 2 meshes, </Hero/geo/skin> \(12 points\)"):
        read_face_mesh(tmp_path / "rig.usda")
    with pytest.raises(InputError, match="there is no prim </No>; check --mesh-prim"):
        read_face_mesh(tmp_path / "rig.usda", prim="/No")


def test_a_mesh_without_faces_is_refused(scan_file: Path) -> None:
    stage, mesh = head(scan_file)
    mesh.GetFaceVertexCountsAttr().Set([])
    mesh.GetFaceVertexIndicesAttr().Set([])
    stage.Save()
    with pytest.raises(InputError, match="has 780 points and no faces"):
        read_face_mesh(scan_file)


def test_topology_that_changes_over_time_is_refused(scan_file: Path) -> None:
    stage, mesh = head(scan_file)
    counts = mesh.GetFaceVertexCountsAttr()
    whole = counts.Get()
    counts.Set(whole, 1)
    counts.Set(whole[:-1], 7)
    stage.Save()
    with pytest.raises(InputError, match=r"topology changes over time .*at time code 7"):
        read_face_mesh(scan_file)


def test_a_number_of_points_that_changes_over_time_is_refused(scan_file: Path) -> None:
    stage, mesh = head(scan_file)
    points = mesh.GetPointsAttr()
    whole = points.Get()
    points.Set(whole, 1)
    points.Set(whole[:-1], 2)
    stage.Save()
    with pytest.raises(InputError, match=r"number of points changes over time \(779 to 780\)"):
        read_face_mesh(scan_file)


def test_topology_sampled_over_time_without_change_is_accepted(scan_file: Path) -> None:
    stage, mesh = head(scan_file)
    counts, points = mesh.GetFaceVertexCountsAttr(), mesh.GetPointsAttr()
    for time in (1, 2):
        counts.Set(counts.Get(), time)
        points.Set(points.Get(), time)
    for attribute in (counts, points):
        attribute.ClearDefault()
    stage.Save()
    assert len(read_face_mesh(scan_file).mesh.points) == 780


def test_points_that_are_nan_are_named(scan_file: Path) -> None:
    stage, mesh = head(scan_file)
    points = np.array(mesh.GetPointsAttr().Get())
    points[[17, 40]] = np.nan
    mesh.GetPointsAttr().Set(points)
    stage.Save()
    with pytest.raises(
        InputError, match=r"points hold NaN or infinity \(2, the first is point 17\)"
    ):
        read_face_mesh(scan_file)


def test_faces_that_name_points_beyond_the_last_are_refused(scan_file: Path) -> None:
    stage, mesh = head(scan_file)
    indices = np.array(mesh.GetFaceVertexIndicesAttr().Get())
    indices[3] = 9999
    mesh.GetFaceVertexIndicesAttr().Set(indices)
    stage.Save()
    with pytest.raises(InputError, match="name points that are not there"):
        read_face_mesh(scan_file)


def test_a_mesh_inside_an_instance_is_refused(scan_file: Path, tmp_path: Path) -> None:
    stage = Usd.Stage.CreateNew(str(tmp_path / "instanced.usda"))
    prim = stage.DefinePrim("/Set")
    prim.GetReferences().AddReference("./scan.usda", Sdf.Path("/Scan"))
    prim.SetInstanceable(True)
    stage.Save()
    with pytest.raises(InputError, match="lies inside an instanceable prim"):
        read_face_mesh(tmp_path / "instanced.usda")


@pytest.mark.parametrize("kind", ["vertex", "faceVarying"])
def test_authored_normals_are_known(tmp_path: Path, kind: str) -> None:
    face = read_face_mesh(write_scan(tmp_path / "scan.usda", small_scan(), normals=kind))
    assert face.normals == kind
    assert face.authored_normals is not None
    np.testing.assert_array_equal(face.authored_normals[0], [0, 0, 1])
