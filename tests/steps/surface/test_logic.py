"""A rig's logic, from all it can be read from, written over the rig."""

import csv
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from pxr import Usd

from tests.usdio.small_rig import small_rig
from usdface.core.assets import MeshShape, Rig, ShapeKey
from usdface.core.errors import InputError
from usdface.core.rig_logic import Combination, RigLogic
from usdface.runner.execute import execute
from usdface.runner.result import StepResult
from usdface.specs.surface import LogicSpec
from usdface.steps.surface.logic import combinations_of_names
from usdface.usdio.rig.read import read_rig
from usdface.usdio.rig.write import write_rig

NAMES = ("jaw", "smile_L", "smile_R", "jaw_smile_L", "jaw__smile_R", "smile_jaw_L", "jaw50", "lid")


@pytest.fixture
def rig(tmp_path: Path) -> Path:
    """Write a rig of shapes with these names, that knows of no logic."""
    bare = small_rig()
    key = ShapeKey(1.0, np.arange(3), np.ones((3, 3)))
    mesh = bare.meshes[1]
    shapes = tuple(MeshShape(name, (key,)) for name in NAMES)
    made = Rig(
        tmp_path / "rig.usda",
        bare.prim,
        NAMES,
        (replace(mesh, shapes=shapes),),
        np.tile([0.0, 1.0], (len(NAMES), 1)),
    )
    write_rig(made.file, made)
    return made.file


def logic(rig: Path, **given: object) -> StepResult:
    out = rig.with_name("logic.usda")
    return execute(LogicSpec.model_validate({"rig": rig, "out": out} | given), overwrite=True)


def stated(rig: Path, **given: object) -> dict[str, str]:
    logic(rig, **given)
    read = read_rig(rig.with_name("logic.usda"))
    assert set(read.shapes) == set(NAMES) - read.logic.driven
    return {each.shape: str(each) for each in read.combinations}


def test_names_say_it_where_all_parts_are_shapes(rig: Path) -> None:
    assert stated(rig, naming=True) == {
        "jaw_smile_L": "jaw_smile_L = jaw * smile_L",
        "jaw__smile_R": "jaw__smile_R = jaw * smile_R",
        "smile_jaw_L": "smile_jaw_L = smile_L * jaw",
        "jaw50": "jaw50 = jaw@0.5",
    }
    assert Usd.Stage.Open(str(rig.with_name("logic.usda"))).GetDefaultPrim()


def test_a_constant_prefix_is_no_part_and_two_readings_are_refused() -> None:
    found = combinations_of_names(("hero_bs_a", "hero_bs_b", "hero_bs_a_b"))
    assert found == (Combination("hero_bs_a_b", ("hero_bs_a", "hero_bs_b")),)
    with pytest.raises(InputError, match=r"a_b_c is ambiguous: .*; state it in a table"):
        combinations_of_names(("a", "b_c", "a_b", "c", "a_b_c"))


def test_a_name_of_a_shape_that_is_not_there_is_refused() -> None:
    with pytest.raises(InputError, match="bs_jaw__blow: blow is no shape of the rig"):
        combinations_of_names(("bs_jaw", "bs_smile_L", "bs_jaw__blow"))
    for other in ("bs_smile__L", "bs_grp__x", "bs_jaw_blow", "bs_jaw__smile_L"):
        names = ("bs_jaw", "bs_smile", "bs_smile_L", other)
        assert len(combinations_of_names(names)) == (other == "bs_jaw__smile_L"), other


def test_tables_and_simplex_say_the_same(rig: Path) -> None:
    table = rig.with_name("logic.csv")
    table.write_text("shape,parts,mode,weights\njaw_smile_L,jaw smile_L,minimum,\njaw50,jaw,,0.5\n")
    rows = [
        {"shape": "jaw_smile_L", "parts": ["jaw", "smile_L"], "mode": "minimum"},
        {"shape": "jaw50", "parts": ["jaw"], "weights": [0.5]},
    ]
    listed = rig.with_name("logic.json")
    listed.write_text(json.dumps({"combinations": rows}))
    assert stated(rig, definition=table) == stated(rig, definition=listed)
    table.write_text(table.read_text().replace(",", ";"))
    assert stated(rig, definition=table) == stated(rig, definition=listed)
    simplex = {
        "encodingVersion": 3,
        "shapes": [{"name": name} for name in ("Rest", "jaw", "smile_L", "jaw_smile_L")],
        "progressions": [
            {"name": "jaw", "pairs": [[0, 0.0], [1, 1.0]], "interp": "spline"},
            {"name": "smile", "pairs": [[2, -1.0], [0, 0.0]], "interp": "linear"},
            {"name": "both", "pairs": [[0, 0.0], [3, 1.0]], "interp": "spline"},
        ],
        "sliders": [{"name": "jaw", "prog": 0}, {"name": "smile", "prog": 1}],
        "combos": [
            {"name": "both", "prog": 2, "pairs": [[0, 1.0], [1, -1.0]], "solveType": "None"}
        ],
    }
    text = [row | {"parts": " ".join(row["parts"])} for row in rows]  # as CSV has them
    capitals = rig.with_name("text.JSON")
    capitals.write_text(json.dumps(text))
    assert stated(rig, definition=capitals) == stated(rig, definition=listed)
    listed.write_text(json.dumps(simplex))
    assert stated(rig, definition=listed) == {
        "jaw_smile_L": "jaw_smile_L = jaw * smile_L (minimum)"
    }
    simplex["combos"][0]["enabled"] = False  # type: ignore[index]
    listed.write_text(json.dumps(simplex))
    with pytest.raises(InputError, match="none of its 8 shapes is a combination"):
        logic(rig, definition=listed)
    del simplex["combos"][0]["enabled"]  # type: ignore[attr-defined]
    simplex["combos"][0]["pairs"][0][1] = 0.5  # type: ignore[index]
    listed.write_text(json.dumps(simplex))
    with pytest.raises(InputError, match=r"combo both has a slider at 0\.5"):
        logic(rig, definition=listed)
    simplex["combos"][0]["pairs"][0][1] = 1.0  # type: ignore[index]
    for progression in (0, 2):  # of a slider, and of the combo itself
        whole = json.loads(json.dumps(simplex))
        whole["shapes"].append({"name": "jaw50"})
        whole["progressions"][progression]["pairs"].append([4, 0.5])
        listed.write_text(json.dumps(whole))
        with pytest.raises(InputError, match=r"jaw50 is at 0\.5 of its progression"):
            logic(rig, definition=listed)


def test_weights_show_it(rig: Path) -> None:
    weights = np.random.default_rng(0).uniform(0, 1, (60, 3)) ** 2
    truth = RigLogic(
        NAMES[:3],
        (
            Combination("jaw_smile_L", ("jaw", "smile_L")),
            Combination("jaw50", ("jaw",), weights=(0.5,)),
            Combination("jaw__smile_R", ("jaw50", "smile_R"), "minimum"),
        ),
    )
    file = rig.with_name("weights.csv")
    with file.open("w", newline="") as stream:
        writer = csv.writer(stream)
        writer.writerow(["frame", *NAMES[:3], "jaw_smile_L", "jaw50", "jaw__smile_R"])
        writer.writerows([n, *row] for n, row in enumerate(truth.evaluate(weights).tolist()))
    driven = ("jaw_*", "jaw50", "lid")
    result = logic(rig, weights=file, driven=driven)
    assert result.notes[0].startswith("inferred 3 of 4 from 60 rows; lid stay animated")
    read = read_rig(rig.with_name("logic.usda"))
    found = read.logic.complete(weights, NAMES[:3])
    names = [*NAMES[:3], *(each.shape for each in read.combinations)]
    for name, column in zip(("jaw_smile_L", "jaw50", "jaw__smile_R"), (3, 4, 5), strict=True):
        expected = truth.evaluate(weights)[:, column]
        np.testing.assert_allclose(found[:, names.index(name)], expected, atol=1e-9)


@pytest.mark.parametrize(
    ("table", "message"),
    [
        pytest.param("jaw_smile_L,jaw tongue", "tongue is no shape of the rig", id="missing"),
        pytest.param("jaw,smile_L\nsmile_L,jaw", "a cycle: jaw <- smile_L <- jaw", id="cycle"),
        pytest.param("jaw50,jaw,,half", "is no combination: .*'half'", id="text"),
        pytest.param("jaw50,tongue jaw,,0.5", "tongue@0.5 [*] jaw: tongue is no", id="few weights"),
        pytest.param(
            "jaw50,jaw lid,,0.5\njaw50,jaw", "in two ways: jaw50 = jaw@0.5 [*] lid", id="two ways"
        ),
    ],
)
def test_what_cannot_be_is_named_and_nothing_written(rig: Path, table: str, message: str) -> None:
    file = rig.with_name("logic.csv")
    file.write_text(f"shape,parts,mode,weights\n{table}\n")
    with pytest.raises(InputError, match=message):
        logic(rig, definition=file)
    assert not rig.with_name("logic.usda").exists()


@pytest.mark.parametrize(
    "text",
    [
        '[{"shape": "jaw50", "parts": ["jaw"], "weights": [1' + 400 * "0" + "]}]",
        '[{"shape": "jaw50", "parts": 7}]',
        "[7]",
        '{"combinations": 7}',
        '{"progressions": [{"pairs": [[1e999, 1]]}], "shapes": ["jaw"], "sliders": [],'
        ' "combos": []}',
    ],
    ids=["huge", "parts", "row", "list", "simplex"],
)
def test_json_of_wrong_types_is_refused(rig: Path, text: str) -> None:
    file = rig.with_name("logic.json")
    file.write_text(text)
    with pytest.raises(InputError, match=r"logic\.json.*(is no|is neither)"):
        logic(rig, definition=file)


def test_sources_that_disagree_are_refused(rig: Path) -> None:
    file = rig.with_name("logic.csv")
    file.write_text("shape,parts\njaw_smile_L,jaw smile_R\n")
    with pytest.raises(InputError, match="stated in two ways: jaw_smile_L = jaw"):
        logic(rig, definition=file, naming=True)
