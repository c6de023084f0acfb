"""Layers that cannot be: refused at once, by name."""

import os
from pathlib import Path

import pytest
from pxr import Sdf, Usd, UsdGeom

from usdface.core.errors import InputError
from usdface.usdio.layers import open_layer, open_stage
from usdface.usdio.rig.mesh import read_face_mesh


@pytest.mark.parametrize("rate", [0.0, -24.0, float("nan"), float("inf")])
def test_a_sublayer_with_a_rate_that_is_none_is_refused_by_name(
    tmp_path: Path, rate: float
) -> None:
    below = Sdf.Layer.CreateNew(str(tmp_path / "samples.usda"))
    below.timeCodesPerSecond = rate
    below.Save()
    above = Sdf.Layer.CreateNew(str(tmp_path / "take.usda"))
    above.timeCodesPerSecond = 24
    above.subLayerPaths = ["./samples.usda"]
    above.Save()
    with pytest.raises(InputError, match=r"samples\.usda: timeCodesPerSecond is"):
        open_stage(tmp_path / "take.usda")


def test_bytes_that_are_no_text_are_refused_though_usd_quotes_them(tmp_path: Path) -> None:
    path = tmp_path / "x.usda"
    path.write_bytes(b'#usda 1.0\ndef Xform "a" {\n double x = "\xff\n}\n')
    with pytest.raises(InputError, match=r"x\.usda: USD failed while opening it: .* no text"):
        open_layer(path)


def test_text_that_is_no_usd_is_refused_with_the_line_and_what_stands_there(tmp_path: Path) -> None:
    path = tmp_path / "x.usda"
    path.write_text('#usda 1.0\ndef Xform "a"\n{\n    double x = "wide"\n}\n', encoding="utf-8")
    with pytest.raises(InputError, match=r'x\.usda:4:\d+: .*"wide".* in </a\.x>$'):
        open_layer(path)


def test_a_place_that_is_told_in_words_is_refused_though_usd_itself_says_so(
    tmp_path: Path,
) -> None:
    stage = Usd.Stage.CreateNew(str(tmp_path / "mesh.usda"))
    mesh = UsdGeom.Mesh.Define(stage, "/mesh")
    mesh.GetPointsAttr().Set([(0, 0, 0), (1, 0, 0), (0, 1, 0)])
    mesh.GetFaceVertexCountsAttr().Set([3])
    mesh.GetFaceVertexIndicesAttr().Set([0, 1, 2])
    prim = mesh.GetPrim()
    prim.CreateAttribute("xformOp:translate", Sdf.ValueTypeNames.String).Set("up there")
    prim.CreateAttribute("xformOpOrder", Sdf.ValueTypeNames.TokenArray).Set(["xformOp:translate"])
    stage.Save()
    with pytest.raises(InputError, match=r"mesh\.usda: a value is not of the type"):
        read_face_mesh(tmp_path / "mesh.usda")


def test_a_name_of_bytes_that_are_no_text_is_refused(tmp_path: Path) -> None:
    path = tmp_path / os.fsdecode(b"x\xff.usda")
    try:
        path.write_text("#usda 1.0\n", encoding="utf-8")
    except OSError:
        pytest.skip("this file system takes names of text alone")
    with pytest.raises(InputError, match=r"x\\udcff\.usda': holds bytes that are no text"):
        open_layer(path)
