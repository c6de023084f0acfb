"""Bindings survive the way to disk; every way to correct one is understood."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from pxr import Gf, Sdf, Usd

from tests.small_scan import small_scan, write_scan
from usdface.core.errors import InputError
from usdface.core.provenance import Provenance
from usdface.core.replacing import replacing
from usdface.numerics.registration.marker_binding import MarkerBinding
from usdface.numerics.surface.surface_places import nearest_places
from usdface.usdio.rig.mesh import FaceMesh, read_face_mesh
from usdface.usdio.surface.binding import (
    TRANSLATE,
    correct_binding,
    read_binding,
    write_binding,
)
from usdface.usdio.validation import validate

NAMES = ("brow", "lip upper", "lip_upper", "*7", "chin")


@pytest.fixture
def face(tmp_path: Path) -> FaceMesh:
    return read_face_mesh(write_scan(tmp_path / "scan.usdc", small_scan(), z_up=True))


@pytest.fixture
def bound(tmp_path: Path, face: FaceMesh) -> tuple[Path, MarkerBinding]:
    mesh = face.mesh
    wanted = mesh.points[[40, 300, 410, 500, 620]] + [2.0, 1.0, 0.0]
    binding = MarkerBinding(
        NAMES,
        nearest_places(mesh.points, mesh.face_counts, mesh.face_indices, wanted).rounded(),
        np.array([0.9, 0.2, 1.0, 0.5, 0.7]),
        np.array([1.0, 8.0, 0.0, 2.0, 3.0]),
        ("proposed", "proposed", "landmark", "proposed", "proposed"),
    )
    write(tmp_path, binding, face)
    return tmp_path / "b.usda", binding


def write(folder: Path, binding: MarkerBinding, face: FaceMesh) -> None:
    write_binding(folder / "b.usda", binding, face, provenance=Provenance())


def correct(path: Path, prim: str, attribute: str, kind: Sdf.ValueTypeName, value: object) -> None:
    stage = Usd.Stage.Open(str(path.with_name("b.corrected.usda")))
    stage.OverridePrim(f"/Binding/Markers/{prim}").CreateAttribute(attribute, kind).Set(value)
    stage.Save()


def test_a_proposal_is_not_replaced_where_the_layer_to_open_cannot_be(
    bound: tuple[Path, MarkerBinding], face: FaceMesh
) -> None:
    path, binding = bound
    before = {each.name: each.read_bytes() for each in path.parent.iterdir()}
    other = replace(binding, confidence=binding.confidence / 2)
    with pytest.raises(InputError, match="another process is writing it"), replacing(path):
        write(path.parent, other, face)
    assert {each.name: each.read_bytes() for each in path.parent.iterdir()} == before


def test_a_binding_is_read_back_as_it_was(
    bound: tuple[Path, MarkerBinding], face: FaceMesh
) -> None:
    path, binding = bound
    read = read_binding(path, face)
    assert read.left_out == ()
    assert read.binding.names == NAMES
    assert read.binding.sources == binding.sources
    np.testing.assert_allclose(read.binding.confidence, binding.confidence, atol=1e-4)
    # Exactly, so that a step that reads a binding computes what the step that made it did.
    for name in ("faces", "corners", "weights"):
        np.testing.assert_array_equal(
            getattr(read.binding.places, name), getattr(binding.places, name)
        )
    for file in path.parent.glob("b*.usda"):
        assert not [each for each in validate(file) if each.severity == "error"], file


def test_the_balls_lie_on_the_mesh_as_a_viewer_shows_it(
    bound: tuple[Path, MarkerBinding], face: FaceMesh
) -> None:
    from pxr import UsdGeom

    stage = Usd.Stage.Open(str(bound[0]))
    ball = UsdGeom.XformCache().GetLocalToWorldTransform(
        stage.GetPrimAtPath("/Binding/Markers/brow")
    )
    head = UsdGeom.Mesh(stage.GetPrimAtPath("/Binding/Mesh/Asset/head"))
    matrix = np.array(UsdGeom.XformCache().GetLocalToWorldTransform(head.GetPrim()))
    shown = np.array(head.GetPointsAttr().Get()) @ matrix[:3, :3] + matrix[3, :3]
    at = bound[1].places
    wanted = np.einsum("k,kc->c", at.weights[0], shown[at.corners[0]])
    np.testing.assert_allclose(np.array(ball)[3, :3], wanted, atol=1e-4)


def test_the_mesh_is_in_the_hierarchy_of_models(
    bound: tuple[Path, MarkerBinding], face: FaceMesh
) -> None:
    asset = Usd.Stage.Open(str(face.file))
    top = Sdf.Path(face.path).GetPrefixes()[0]
    Usd.ModelAPI(asset.GetPrimAtPath(top)).SetKind("component")
    asset.Save()
    stage = Usd.Stage.Open(str(bound[0]))
    shown = stage.GetPrimAtPath("/Binding/Mesh/Asset")
    assert Usd.ModelAPI(shown).GetKind() == "component"
    assert shown.IsModel(), "a component below what is no group"


def test_a_face_alone_means_its_middle(bound: tuple[Path, MarkerBinding], face: FaceMesh) -> None:
    correct(bound[0], "chin", "face:binding:face", Sdf.ValueTypeNames.Int, 77)
    read = read_binding(bound[0], face).binding
    corners = face.mesh.face_indices[77 * 4 : 77 * 4 + 4]
    at = read.places.positions(face.mesh.points)[NAMES.index("chin")]
    assert np.linalg.norm(at - face.mesh.points[corners].mean(axis=0)) < 0.5
    assert read.sources[NAMES.index("chin")] == "corrected"
    assert read.confidence[NAMES.index("chin")] == 1.0


def test_a_correction_stays_with_its_marker_whichever_comes_first(
    tmp_path: Path, bound: tuple[Path, MarkerBinding], face: FaceMesh
) -> None:
    path, binding = bound
    names = ("眉左", "眉右", *binding.names[2:])
    write(tmp_path, replace(binding, names=names), face)
    correct(path, "眉右", "face:binding:face", Sdf.ValueTypeNames.Int, 5)
    swapped = (names[1], names[0], *names[2:])
    write(tmp_path, replace(binding, names=swapped), face)
    read = read_binding(path, face).binding
    assert sorted(read.names) == sorted(swapped)
    assert [n for n, s in zip(read.names, read.sources, strict=True) if s == "corrected"] == [
        "眉右"
    ]


def test_weights_alone_move_a_marker_on_its_face(
    bound: tuple[Path, MarkerBinding], face: FaceMesh
) -> None:
    correct(bound[0], "brow", "face:binding:weights", Sdf.ValueTypeNames.FloatArray, [0, 0, 1, 0])
    read = read_binding(bound[0], face).binding
    number = int(bound[1].places.faces[0])
    corner = face.mesh.face_indices[number * 4 + 2]
    np.testing.assert_allclose(
        read.places.positions(face.mesh.points)[0], face.mesh.points[corner], atol=1e-6
    )


@pytest.mark.parametrize(
    ("attribute", "kind", "value", "message"),
    [
        ("face:binding:point", "Int", 100000, "point 100000 belongs to no face"),
        ("face:binding:face", "Int", -4, "there is no face -4"),
        ("face:binding:weights", "FloatArray", [1.0], "has 4 corners and 1 weights are given"),
        ("face:binding:weights", "FloatArray", [2, -1, 0, 0], "not 0 or more with sum 1"),
        ("xformOp:translate", "Double3", (np.nan, 0, 0), "its ball is at"),
    ],
)
def test_a_correction_that_is_not_on_the_mesh_names_its_marker(
    bound: tuple[Path, MarkerBinding],
    face: FaceMesh,
    attribute: str,
    kind: str,
    value: object,
    message: str,
) -> None:
    correct(bound[0], "chin", attribute, getattr(Sdf.ValueTypeNames, kind), value)
    with pytest.raises(InputError, match=f"marker chin is not on the mesh: .*{message}"):
        read_binding(bound[0], face)


def test_other_files_are_no_bindings(tmp_path: Path, face: FaceMesh) -> None:
    with pytest.raises(InputError, match="not a binding: its default prim has no FaceBindingAPI"):
        read_binding(tmp_path / "scan.usdc", face)


def test_a_ball_moved_in_the_layer_to_open_is_a_correction_ever_after(
    tmp_path: Path, bound: tuple[Path, MarkerBinding], face: FaceMesh
) -> None:
    path, binding = bound
    correct(path, "chin", "face:binding:point", Sdf.ValueTypeNames.Int, 100)
    stage = Usd.Stage.Open(str(path))  # as in a DCC, which saves the layer that it opened
    ball = stage.GetAttributeAtPath(f"/Binding/Markers/brow.{TRANSLATE}")
    ball.Set(ball.Get() + Gf.Vec3d(0.3, 0, 0))
    stage.GetPrimAtPath("/Binding/Markers/lip_upper").SetActive(False)
    stage.Save()
    with pytest.raises(InputError, match=r"b\.usda: moves brow itself.*b\.corrected\.usda"):
        correct_binding(path, {"brow": face.mesh.points[40]}, Provenance())
    made = read_binding(path, face)
    for _ in range(2):
        write(tmp_path, binding, face)
        again = read_binding(path, face)
        assert (again.binding.sources, again.left_out) == (made.binding.sources, made.left_out)
        at, before = (each.binding.places.positions(face.mesh.points) for each in (again, made))
        np.testing.assert_allclose(at, before, atol=1e-6)
    assert made.binding.sources.count("corrected") == 2
    correct_binding(path, {"brow": face.mesh.points[40]}, Provenance())
