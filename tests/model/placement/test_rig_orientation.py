"""A rig that lies is refused by what its shapes do; its size and proportions are its own."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from pxr import Usd, UsdGeom
from scipy.spatial.transform import Rotation

from usdface.core.arrays import FloatArray
from usdface.core.assets import Rig
from usdface.core.errors import InputError
from usdface.demo.dog import dog_rig
from usdface.demo.rig import demo_rig
from usdface.model.placement.rig_orientation import (
    check_rig_upright,
    covered_face_notes,
    facing_degrees,
)
from usdface.steps.retarget.pairs_propose import match_rigs
from usdface.usdio.rig.read import read_rig

HEADS = ("facecap_head.usdc", "ict_head.usdc", "ict_face.usdc")


def transformed(rig: Rig, matrix: FloatArray) -> Rig:
    meshes = [
        replace(
            mesh,
            points=mesh.points @ matrix.T,
            shapes=tuple(
                replace(
                    shape,
                    keys=tuple(replace(key, offsets=key.offsets @ matrix.T) for key in shape.keys),
                )
                for shape in mesh.shapes
            ),
        )
        for mesh in rig.meshes
    ]
    return replace(rig, meshes=tuple(meshes))


@pytest.fixture(scope="module", params=[demo_rig, dog_rig], ids=["character", "dog"])
def rig(request: pytest.FixtureRequest) -> Rig:
    made: Rig = request.param()
    return made


def test_heads_that_stand_pass_however_large_squashed_or_turned(rig: Rig) -> None:
    yaw = Rotation.from_euler("y", 130, degrees=True).as_matrix()
    nod = Rotation.from_euler("x", 35, degrees=True).as_matrix()
    for matrix in (np.eye(3), 50 * np.eye(3), np.diag([2.0, 0.6, 1.5]), yaw, yaw @ nod):
        assert check_rig_upright(transformed(rig, matrix)) == ()


def test_where_a_face_looks_is_known_by_its_sides(rig: Rig) -> None:
    for degrees in (0, 15, 45, 135, -90):
        matrix = Rotation.from_euler("y", degrees, degrees=True).as_matrix()
        found = facing_degrees(transformed(rig, matrix))
        if abs(degrees) <= 15:
            assert found == 0.0, "pictures of heads a little askew stay as they were"
        else:
            assert found == pytest.approx(degrees, abs=3)


@pytest.mark.parametrize(
    ("axis", "degrees", "up"),
    [("x", 90, "Z"), ("x", -90, "-Z"), ("x", 180, "-Y"), ("z", 90, "-X"), ("z", -90, "X")],
)
def test_a_lying_head_is_refused_with_the_axis_that_is_up(
    rig: Rig, axis: str, degrees: float, up: str
) -> None:
    lying = transformed(rig, Rotation.from_euler(axis, degrees, degrees=True).as_matrix())
    with pytest.raises(InputError, match=rf"the head lies: .*near {up} .*correct upAxis"):
        check_rig_upright(lying)


def test_exchanged_sides_are_a_doubt(rig: Rig) -> None:
    (note,) = check_rig_upright(transformed(rig, np.diag([-1.0, 1, 1])))
    assert "shapes named left move the right side" in note


def test_names_match_rigs_whose_sides_differ_with_a_note(rig: Rig) -> None:
    viewers = replace(transformed(rig, np.diag([-1.0, 1, 1])), file=Path("viewers.usda"))
    for source, target, count in ((rig, viewers, 1), (viewers, rig, 1), (viewers, viewers, 0)):
        notes = match_rigs(source, target, by="name")[1]
        noted = [each for each in notes if each.startswith("viewers.usda: shapes named left")]
        assert len(noted) == count


def test_a_mesh_without_shapes_before_the_face_is_a_doubt(rig: Rig) -> None:
    skin = max(rig.meshes, key=lambda mesh: len(mesh.shapes))
    copy = replace(skin, path="/render", points=skin.points + 1.0, shapes=())
    (note,) = covered_face_notes(replace(rig, meshes=(*rig.meshes, copy)))
    assert note.startswith("/render has no shapes")
    beside = replace(copy, points=copy.points + 400.0)
    for other in (beside, replace(copy, visible=False)):
        assert covered_face_notes(replace(rig, meshes=(*rig.meshes, other))) == ()
    assert covered_face_notes(rig) == ()


def test_foreign_names_are_not_judged(rig: Rig) -> None:
    meshes = [
        replace(mesh, shapes=tuple(replace(s, name=f"p{i}") for i, s in enumerate(mesh.shapes)))
        for mesh in rig.meshes
    ]
    lying = transformed(replace(rig, meshes=tuple(meshes)), np.diag([1.0, -1, -1]))
    assert check_rig_upright(lying) == ()


def test_rigs_of_others_pass_and_a_wrong_axis_in_the_file_is_refused(
    shared_data: Path, tmp_path: Path
) -> None:
    for name in HEADS:
        assert check_rig_upright(read_rig(shared_data / "rigs" / name)) == ()
    stage = Usd.Stage.Open(str(shared_data / "rigs" / HEADS[0]))
    UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.z)
    stage.Export(str(tmp_path / "lies.usdc"))
    with pytest.raises(InputError, match="the head lies"):
        check_rig_upright(read_rig(tmp_path / "lies.usdc"))
