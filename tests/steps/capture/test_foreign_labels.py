"""Labels of markers from other makers' USD files are settled as those of every other format."""

from pathlib import Path

import numpy as np
import pytest
from pxr import Sdf, Usd, UsdGeom, Vt

from usdface.runner.execute import execute
from usdface.specs.capture import IngestSpec
from usdface.usdio.take.read import read_take

POSITIONS = np.random.default_rng(0).normal(0, 50, (6, 4, 3)).astype(np.float32)


def ingest(folder: Path, names: list[str]) -> tuple[Path, tuple[str, ...]]:
    stage = Usd.Stage.CreateNew(str(folder / "mocap.usda"))
    UsdGeom.SetStageMetersPerUnit(stage, 0.001)
    UsdGeom.SetStageUpAxis(stage, "Y")
    points = UsdGeom.Points.Define(stage, "/mocap/face")
    primvars = UsdGeom.PrimvarsAPI(points)
    primvars.CreatePrimvar("names", Sdf.ValueTypeNames.StringArray, "vertex").Set(names)
    for frame, row in enumerate(POSITIONS):
        points.GetPointsAttr().Set(Vt.Vec3fArray.FromNumpy(row), 1 + frame)
    stage.Save()
    out = folder / "a.take.usda"
    return out, execute(IngestSpec(sources=(folder / "mocap.usda",), out=out)).notes


def test_prefixes_are_taken_off_and_unlabelled_points_left_out(tmp_path: Path) -> None:
    out, notes = ingest(tmp_path, ["Kim:brow", "*3", "Kim:lip", "Kim:chin"])
    markers = read_take(out).markers
    assert markers is not None
    assert markers.names == ("brow", "lip", "chin")
    np.testing.assert_allclose(markers.positions, POSITIONS[:, [0, 2, 3]], rtol=1e-6)
    assert "1 unlabelled markers were left out: *3" in notes
    assert "subject prefixes taken off: Kim" in notes


@pytest.mark.parametrize(
    ("names", "named", "note"),
    [
        (["a", "a", "a_1", "c"], ("a_2", "a_3", "a_1", "c"), "2 markers share their labels"),
        (["a", "", "b", ""], ("a", "marker_2", "b", "marker_4"), "2 markers with an empty label"),
    ],
)
def test_doubled_and_empty_labels_are_numbered_in_the_files_order(
    tmp_path: Path, names: list[str], named: tuple[str, ...], note: str
) -> None:
    out, notes = ingest(tmp_path, names)
    markers = read_take(out).markers
    assert markers is not None
    assert markers.names == named
    np.testing.assert_allclose(markers.positions, POSITIONS, rtol=1e-6)
    assert sum(note in each for each in notes) == 1
