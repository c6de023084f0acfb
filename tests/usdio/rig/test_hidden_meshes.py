"""Meshes that are hidden, or not meant to be rendered, are known as such wherever that is said."""

from pathlib import Path

import pytest
from pxr import Usd, UsdGeom

from tests.usdio.small_rig import small_rig
from usdface.usdio.rig.read import read_rig
from usdface.usdio.rig.write import write_rig


@pytest.mark.parametrize(
    ("where", "say", "shown"),
    [
        ("/Hero/geo/teeth", "guide", False),
        ("/Hero/geo/teeth", "proxy", False),
        ("/Hero/geo/teeth", "render", True),
        ("/Hero/geo/teeth", "default", True),
        ("/Hero/geo/teeth", "invisible", False),
        ("/Hero/geo", "guide", False),
        ("/Hero/geo", "invisible", False),
    ],
)
def test_purpose_and_visibility_are_inherited(
    tmp_path: Path, where: str, say: str, shown: bool
) -> None:
    write_rig(tmp_path / "rig.usda", small_rig())
    stage = Usd.Stage.Open(str(tmp_path / "rig.usda"))
    prim = UsdGeom.Imageable(stage.GetPrimAtPath(where))
    if say == "invisible":
        prim.MakeInvisible()
    else:
        prim.CreatePurposeAttr(say)
    stage.Save()
    meshes = {mesh.path: mesh for mesh in read_rig(tmp_path / "rig.usda").meshes}
    assert meshes["/Hero/geo/teeth"].visible == shown
    assert meshes["/Hero/geo/skin"].visible == (shown or where != "/Hero/geo")
    assert len(meshes) == 2, "a hidden mesh still has shapes and points"
