"""A new rig references the mesh, holds only the new shapes, and leaves the file as it is."""

from pathlib import Path

import numpy as np
import pytest
from pxr import Usd, UsdSkel

from tests.small_scan import small_scan, write_scan
from tests.usdio.small_rig import small_rig
from usdface.core.errors import InputError
from usdface.core.provenance import Provenance
from usdface.usdio.rig.mesh import read_face_mesh, skel_bindings
from usdface.usdio.rig.read import read_rig
from usdface.usdio.rig.write import write_rig
from usdface.usdio.surface.shape_rig import NewShape, shape_names, write_shape_rig
from usdface.usdio.validation import validate


def shape(name: str, moved: np.ndarray) -> NewShape:
    return NewShape(name, moved, take="talk", frame=120)


@pytest.mark.parametrize("z_up", [False, True])
def test_shapes_come_back_as_they_were_given(tmp_path: Path, z_up: bool) -> None:
    face = read_face_mesh(write_scan(tmp_path / "scan.usdc", small_scan(), z_up=z_up))
    source = (tmp_path / "scan.usdc").read_bytes()
    moved = np.zeros_like(face.mesh.points)
    moved[40:90] = np.random.default_rng(0).normal(0, 5, (50, 3))
    written = write_shape_rig(
        tmp_path / "rig.usda", face, [shape("smile", moved)], provenance=Provenance()
    )
    assert written == {"smile": 50}
    rig = read_rig(tmp_path / "rig.usda")
    np.testing.assert_allclose(rig.meshes[0].points, face.mesh.points, atol=1e-3)
    key = rig.meshes[0].shapes[0].keys[-1]
    np.testing.assert_array_equal(key.points, np.arange(40, 90))
    np.testing.assert_allclose(key.offsets, moved[40:90], atol=1e-3)
    assert (tmp_path / "scan.usdc").read_bytes() == source
    assert not [each for each in validate(tmp_path / "rig.usda") if each.severity == "error"]


def test_of_a_rig_only_the_new_shapes_are_left(tmp_path: Path) -> None:
    write_rig(tmp_path / "old.usda", small_rig())
    face = read_face_mesh(tmp_path / "old.usda", prim="/Hero/geo/skin")
    moved = np.random.default_rng(0).normal(0, 5, face.mesh.points.shape)
    write_shape_rig(tmp_path / "new.usda", face, [shape("jawOpen", moved)], provenance=Provenance())
    rig = read_rig(tmp_path / "new.usda")
    assert rig.shapes == ("jawOpen",)
    assert len(rig.meshes) == 2
    skin = next(mesh for mesh in rig.meshes if mesh.path.endswith("skin"))
    np.testing.assert_allclose(skin.shapes[0].keys[-1].offsets, moved, atol=1e-4)
    stage = Usd.Stage.Open(str(tmp_path / "new.usda"))
    roots = [str(prim.GetPath()) for prim in stage.Traverse() if prim.IsA(UsdSkel.Root)]
    assert roots == ["/Face"]


@pytest.mark.parametrize("group", ["/Hero", "/Hero/geo"])
def test_a_mesh_below_a_group_without_a_type_moves_in_the_new_rig(
    tmp_path: Path, group: str
) -> None:
    write_rig(tmp_path / "old.usda", small_rig())
    scan = Usd.Stage.Open(str(tmp_path / "old.usda"))
    scan.GetPrimAtPath(group).SetTypeName("")
    scan.Save()
    face = read_face_mesh(tmp_path / "old.usda", prim="/Hero/geo/skin")
    moved = np.ones_like(face.mesh.points)
    write_shape_rig(tmp_path / "new.usda", face, [shape("open", moved)], provenance=Provenance())
    stage = Usd.Stage.Open(str(tmp_path / "new.usda"))
    moving = skel_bindings(UsdSkel.Cache(), UsdSkel.Root(stage.GetPrimAtPath("/Face")))
    assert "/Face/asset/geo/skin" in moving


def test_names_are_made_valid_short_and_unique() -> None:
    long = "é" * 80
    names = shape_names(["mouth open", "mouth-open", "1st", "", long, long])
    assert names[:4] == ["mouth_open", "mouth_open_2", "_st", "shape"]
    assert len(set(names)) == 6
    assert max(len(name.encode()) for name in names) <= 63


def test_a_shape_that_moves_nothing_is_refused(tmp_path: Path) -> None:
    face = read_face_mesh(write_scan(tmp_path / "scan.usdc", small_scan()))
    still = shape("still", np.full_like(face.mesh.points, 0.005))
    with pytest.raises(InputError, match=r"shape still \(frame 120 of talk\) moves no point"):
        write_shape_rig(tmp_path / "rig.usda", face, [still], provenance=Provenance())
    with pytest.raises(InputError, match="there is no shape to write"):
        write_shape_rig(tmp_path / "rig.usda", face, [], provenance=Provenance())
    assert not (tmp_path / "rig.usda").exists()
