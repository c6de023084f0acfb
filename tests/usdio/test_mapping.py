"""Mappings are USD assets, to the last bit."""

import math
from pathlib import Path

import numpy as np
import pytest
from pxr import Sdf, Usd

from usdface.core.assets import CandidateScore, TrainedMapping
from usdface.core.errors import InputError
from usdface.core.provenance import Provenance
from usdface.usdio.mapping import read_mapping, write_mapping
from usdface.usdio.validation import validate


def small_mapping() -> TrainedMapping:
    rng = np.random.default_rng(0)
    return TrainedMapping(
        method="d06",
        marker_names=("a", "b"),
        shape_names=("jawOpen", "smile"),
        rigid=("a",),
        neutral=rng.normal(size=(2, 3)),
        ranges=np.array([[0.0, 1.0], [-1.0, 1.5]]),
        arrays={"centres": rng.normal(size=(7, 3)), "widths": rng.random(7), "one": np.ones(1)},
        settings={"dimensions": 4, "ridge": 0.1, "shared": True, "note": "ü"},
        scores=(CandidateScore("d06", "dimensions=4", 0.1, math.nan),),
        references="hero.references.usda",
    )


@pytest.mark.parametrize("name", ["m.mapping.usda", "m.mapping.usdc"])
def test_mapping_reads_back_to_the_last_bit(tmp_path: Path, name: str) -> None:
    mapping = small_mapping()
    write_mapping(tmp_path / name, mapping, provenance=Provenance())
    back = read_mapping(tmp_path / name)
    for field in ("method", "marker_names", "shape_names", "rigid", "settings", "references"):
        assert getattr(back, field) == getattr(mapping, field)
    np.testing.assert_array_equal(back.neutral, mapping.neutral)
    np.testing.assert_array_equal(back.ranges, mapping.ranges)
    assert back.arrays.keys() == mapping.arrays.keys()
    for key, array in mapping.arrays.items():
        np.testing.assert_array_equal(back.arrays[key], array)
    assert math.isnan(back.scores[0].vertex_rms_mm)
    assert validate(tmp_path / name) == []


def test_usd_sees_a_typed_prim(tmp_path: Path) -> None:
    write_mapping(tmp_path / "m.usda", small_mapping(), provenance=Provenance())
    stage = Usd.Stage.Open(str(tmp_path / "m.usda"))
    assert stage.GetDefaultPrim().GetTypeName() == "Scope"
    prim = stage.GetPrimAtPath("/Mapping/FaceMapping")
    assert prim.GetTypeName() == "FaceMapping"
    assert prim.GetPrimDefinition().GetPropertyDocumentation("face:mapping:method")


@pytest.mark.parametrize(
    ("name", "value", "message"),
    [
        ("face:array:centres:shape", [7, 4], r"21 numbers, which make no array of shape \(7, 4\)"),
        ("face:mapping:settings", "{", "settings or scores are no valid JSON"),
        ("face:mapping:neutral", [math.nan] * 6, "neutral holds NaN"),
        ("face:mapping:neutral", [0.0] * 3, "neutral has 3 numbers, which make no array of"),
        ("face:mapping:ranges", [], "ranges has 0 numbers, which make no array of"),
        ("face:mapping:rigid", ["nose"], "rigid names nose, which are none of its markers"),
    ],
    ids=["shape", "json", "nan", "neutral", "ranges", "rigid"],
)
def test_a_damaged_mapping_is_refused(tmp_path: Path, name, value, message) -> None:
    write_mapping(tmp_path / "m.usda", small_mapping(), provenance=Provenance())
    layer = Sdf.Layer.FindOrOpen(str(tmp_path / "m.usda"))
    layer.GetAttributeAtPath(f"/Mapping/FaceMapping.{name}").default = value
    layer.Save()
    with pytest.raises(InputError, match=message):
        read_mapping(tmp_path / "m.usda")


def test_a_mapping_of_an_earlier_version_is_read(tmp_path: Path) -> None:
    write_mapping(tmp_path / "m.usda", small_mapping(), provenance=Provenance())
    new, old = (
        Sdf.Layer.FindOrOpen(str(tmp_path / "m.usda")),
        Sdf.Layer.CreateNew(str(tmp_path / "old.usda")),
    )
    Sdf.CopySpec(new, "/Mapping/FaceMapping", old, "/Mapping")
    old.defaultPrim = "Mapping"
    old.Save()
    assert read_mapping(tmp_path / "old.usda").marker_names == small_mapping().marker_names
