"""Rigs by exporters that sample what never changes, mirror, or state in-betweens beyond use."""

from pathlib import Path

import numpy as np
import pytest
from pxr import Gf, Usd, UsdGeom, UsdSkel

from tests.usdio.small_rig import small_rig
from usdface.core.deformer import Deformer
from usdface.core.errors import InputError
from usdface.usdio.rig.read import read_rig
from usdface.usdio.rig.write import write_rig


@pytest.fixture
def stage(tmp_path: Path) -> Usd.Stage:
    write_rig(tmp_path / "rig.usda", small_rig())
    return Usd.Stage.Open(str(tmp_path / "rig.usda"))


def read(stage: Usd.Stage):
    stage.Save()
    return read_rig(Path(stage.GetRootLayer().realPath))


def test_sampled_points_and_transforms_are_those_of_the_first_sample(stage: Usd.Stage) -> None:
    before = read(stage)
    for path in ("/Hero/geo/skin", "/Hero/geo/teeth"):
        points = UsdGeom.Mesh(stage.GetPrimAtPath(path)).GetPointsAttr()
        values = points.Get()
        points.Clear()
        points.Set(values, 1.0)
    turn = UsdGeom.Xformable(stage.GetPrimAtPath("/Hero")).AddRotateXOp()
    for time in (1.0, 2.0):
        turn.Set(90.0, time)
    after = read(stage)
    for one, other in zip(before.meshes, after.meshes, strict=True):
        np.testing.assert_allclose(other.points, one.points[:, [0, 2, 1]] * [1, -1, 1], atol=1e-5)


@pytest.mark.parametrize(
    ("orientation", "mirrored", "inside_out"),
    [
        ("rightHanded", False, False),
        ("leftHanded", False, True),
        ("rightHanded", True, True),
        ("leftHanded", True, False),
    ],
)
def test_winding_is_known(
    stage: Usd.Stage, orientation: str, mirrored: bool, inside_out: bool
) -> None:
    mesh = UsdGeom.Mesh(stage.GetPrimAtPath("/Hero/geo/skin"))
    mesh.CreateOrientationAttr(orientation)
    if mirrored:
        UsdGeom.Xformable(stage.GetPrimAtPath("/Hero")).AddScaleOp().Set(Gf.Vec3f(-1, 1, 1))
    rig = read(stage)
    assert {m.path: m.inside_out for m in rig.meshes}["/Hero/geo/skin"] == inside_out
    skin = Deformer(rig).triangles[0]
    a, b, c = Deformer(rig).neutral[skin]
    outward = -1.0 if orientation == "leftHanded" else 1.0
    assert np.sign(np.cross(b - a, c - a)[2]) == outward


def test_in_betweens_at_the_ends_are_ignored_as_by_usdskel(stage: Usd.Stage) -> None:
    shape = UsdSkel.BlendShape(stage.GetPrimAtPath("/Hero/geo/skin/jawOpen"))
    offsets = shape.GetOffsetsAttr().Get()
    before = read(stage).meshes[0].shapes[0]
    for name, weight in (("almost", 0.99999994), ("nothing", 1e-7)):
        between = shape.CreateInbetween(name)
        between.SetWeight(weight)
        between.SetOffsets([-each for each in offsets])
    assert len(read(stage).meshes[0].shapes[0].keys) == len(before.keys)
    for name in ("one", "two"):
        between = shape.CreateInbetween(name)
        between.SetWeight(0.5)
        between.SetOffsets(offsets)
    with pytest.raises(InputError, match=r"two in-betweens at weight 0[.]5"):
        read(stage)
