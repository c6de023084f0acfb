"""Edits: in a layer of their own, above the weights, for any tool to read and write."""

from dataclasses import replace
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pxr import Sdf, Ts, Usd

from tests.usdio.small_rig import small_rig
from usdface.core.errors import InputError
from usdface.core.provenance import Provenance
from usdface.core.sidecars import edits_path
from usdface.numerics.motion.key_reduction import EditCurve
from usdface.runner.execute import execute
from usdface.specs.edits import BakeSpec, EditSpec
from usdface.usdio.performance.edits import ShapeEdit, read_edits, write_edits
from usdface.usdio.performance.read import PerformanceReader
from usdface.usdio.performance.weights_layer import make_header
from usdface.usdio.performance.write import writing_performance
from usdface.usdio.rig.read import read_rig
from usdface.usdio.rig.write import write_rig
from usdface.usdio.validation import validate

NAMES = ("smile", "jawOpen", "eyeBlink")
WEIGHTS = np.random.default_rng(0).random((40, 3)).astype(np.float32)
FRAMES = np.arange(101, 141)


def perform(
    folder: Path,
    names: tuple[str, ...] = NAMES,
    *,
    rate: int = 24,
    first: int = 101,
    last: int = 140,
    **header: Any,
) -> Path:
    write_rig(folder / "rig.usda", small_rig())
    path = folder / "shot.hero.usda"
    with writing_performance(
        path,
        replace(
            make_header(
                read_rig(folder / "rig.usda"),
                shape_names=names,
                rate=Fraction(rate),
                first_frame=first,
                last_frame=last,
            ),
            **header,
        ),
        read_rig(folder / "rig.usda"),
    ) as writer:
        writer.append(np.resize(WEIGHTS, (last - first + 1, len(names))))
    return path


def author(path: Path, **attributes: object) -> None:
    """What an animator does by hand, in any tool, with a layer above."""
    layer = Sdf.Layer.CreateNew(str(path.with_name("hand.usda")))
    layer.timeCodesPerSecond = layer.framesPerSecond = 24
    prim = Sdf.CreatePrimInLayer(layer, "/Hero/FaceSolve")
    for name, value in attributes.items():
        attribute = Sdf.AttributeSpec(prim, name.replace("__", ":"), Sdf.ValueTypeNames.Float)
        if isinstance(value, dict):
            for time, each in value.items():
                layer.SetTimeSample(attribute.path, time, each)
        else:
            attribute.default = value
    layer.Save()
    top = Sdf.Layer.FindOrOpen(str(path))
    top.subLayerPaths.insert(0, "./hand.usda")
    top.Save()


def column(path: Path, name: str) -> np.ndarray:
    return PerformanceReader(path).edited()[:, NAMES.index(name)]


def test_what_is_written_reads_back_and_opens_above_the_weights(tmp_path: Path) -> None:
    path = perform(tmp_path)
    rng = np.random.default_rng(0)
    curve = EditCurve(rng.normal(0, 0.2, 40), rng.random(40), rng.random(40))
    solved = WEIGHTS[:, 1].astype(float)
    reader = PerformanceReader(path)
    write_edits(
        path,
        reader.animation,
        {"jawOpen": ShapeEdit(curve, solved)},
        FRAMES,
        provenance=Provenance(),
    )
    top = Sdf.Layer.FindOrOpen(str(path))
    assert list(top.subLayerPaths) == ["./shot.hero.edits.usda", "./shot.hero.weights.usdc"]
    back = PerformanceReader(path).edits
    assert list(back) == ["jawOpen"]
    for name in ("offset", "override", "mask"):
        found, wanted = getattr(back["jawOpen"].curve, name), getattr(curve, name)
        np.testing.assert_allclose(found, wanted, atol=1e-6)
    np.testing.assert_allclose(back["jawOpen"].solve_when_edited, solved, atol=1.1e-3)
    assert {each.check for each in validate(path)} <= {"usdface:Provenance", "usdface:Curves"}


@pytest.mark.parametrize("moved", [Sdf.LayerOffset(900), Sdf.LayerOffset(-50, 2)])
def test_edits_of_layers_that_were_moved_in_time_stay_where_they_are_shown(
    tmp_path: Path, moved: Sdf.LayerOffset
) -> None:
    path = perform(tmp_path)
    execute(EditSpec(performance=path, shape=("smile",), add=0.25, frames="110-115"))
    top = Sdf.Layer.FindOrOpen(str(path))
    for at in range(len(top.subLayerPaths)):
        top.subLayerOffsets[at] = moved
    top.startTimeCode, top.endTimeCode = moved * 101, moved * 140
    top.Save()
    first, last = round(moved * 130), round(moved * 132)
    execute(
        EditSpec(performance=path, shape=("smile",), add=0.5, frames=f"{first}-{last}"),
        overwrite=True,
    )
    reader = PerformanceReader(path)
    added = (reader.edited() - reader.solved())[:, NAMES.index("smile")]
    back = (reader.frames - moved.offset) / moved.scale
    wanted = np.select([(back >= 110) & (back <= 115), (back >= 130) & (back <= 132)], [0.25, 0.5])
    whole = np.isin(back, FRAMES)
    np.testing.assert_allclose(added[whole], wanted[whole], atol=1e-6)
    layer = Sdf.Layer.FindOrOpen(str(edits_path(path)))
    assert (layer.startTimeCode, layer.endTimeCode) == (101, 140)


def test_frames_that_a_performance_names_are_moved_with_its_weights(tmp_path: Path) -> None:
    path = perform(tmp_path, neutral_frame=105, gaps=((120, 130),))
    cut = Sdf.Layer.CreateNew(str(tmp_path / "cut.usda"))
    cut.timeCodesPerSecond, cut.subLayerPaths = 24, [f"./{path.name}"]
    cut.subLayerOffsets[0] = Sdf.LayerOffset(900)
    cut.Save()
    execute(BakeSpec(performance=tmp_path / "cut.usda", out=tmp_path / "baked.usdc"))
    for each in ("cut.usda", "baked.usdc"):
        reader = PerformanceReader(tmp_path / each)
        assert (reader.first_frame, reader.neutral_frame) == (1001, 1005)
        assert reader.header.gaps == ((1020, 1030),)


def test_edits_that_are_not_changed_stay_in_time_when_the_rate_is_another(tmp_path: Path) -> None:
    path = perform(tmp_path)
    reader = PerformanceReader(path)
    offset = np.where((FRAMES >= 110) & (FRAMES <= 120), 0.25, 0.0)
    edit = ShapeEdit(EditCurve(offset, np.zeros(40), np.zeros(40)), np.full(40, np.nan))
    write_edits(path, reader.animation, {"smile": edit}, FRAMES, provenance=Provenance())
    stage, spline = Usd.Stage.Open(str(tmp_path / "shot.hero.edits.usda")), Ts.Spline("float")
    for time, value in ((110, 0.1), (130, 0.5)):
        knot = Ts.Knot(typeName="float", time=time, value=value)
        knot.SetNextInterpolation(Ts.InterpCurve)
        knot.SetPostTanWidth(6)
        knot.SetPreTanWidth(6)
        spline.SetKnot(knot)
    blink = stage.GetPrimAtPath("/Hero/FaceSolve").CreateAttribute(
        "face:edit:eyeBlink", Sdf.ValueTypeNames.Float
    )
    blink.SetSpline(spline)
    stage.Save()
    eased = [blink.Get(frame / 2) for frame in range(202, 281)]
    perform(tmp_path, rate=48, first=202, last=280)  # the same seconds, twice as many frames
    reader = PerformanceReader(path)
    frames = np.arange(202, 281)
    flat = EditCurve(np.full(79, 0.5), np.zeros(79), np.zeros(79))
    write_edits(
        path,
        reader.animation,
        {"jawOpen": ShapeEdit(flat, np.full(79, np.nan))},
        frames,
        provenance=Provenance(),
    )
    changed = PerformanceReader(path).edited() - PerformanceReader(path).solved()
    np.testing.assert_allclose(changed[:, NAMES.index("jawOpen")], 0.5, atol=1e-6)
    full = np.flatnonzero(changed[:, NAMES.index("smile")] > 0.249) + 202
    assert (full[0], full[-1]) == (220, 240)
    np.testing.assert_allclose(changed[:, NAMES.index("eyeBlink")], eased, atol=1e-6)


def test_a_key_set_by_hand_in_another_tool_counts(tmp_path: Path) -> None:
    path = perform(tmp_path)
    author(
        path,
        face__edit__jawOpen={110: 0.0, 120: 0.5, 130: 0.0},
        face__override__smile={115: 0.2, 118: 0.2},  # without a mask: where it has samples
        face__edit__eyeBlink=0.25,  # without time samples: always
    )
    added = np.interp(FRAMES, [110, 120, 130], [0, 0.5, 0])
    np.testing.assert_allclose(column(path, "jawOpen"), WEIGHTS[:, 1] + added, atol=1e-6)
    held = (FRAMES >= 115) & (FRAMES <= 118)
    np.testing.assert_allclose(column(path, "smile"), np.where(held, 0.2, WEIGHTS[:, 0]), atol=1e-6)
    np.testing.assert_allclose(column(path, "eyeBlink"), WEIGHTS[:, 2] + 0.25, atol=1e-6)


def test_a_spline_of_an_animator_counts_between_its_knots(tmp_path: Path) -> None:
    path = perform(tmp_path)
    author(path, face__edit__jawOpen=0.0, face__override__smile=0.0)
    stage = Usd.Stage.Open(str(tmp_path / "hand.usda"))
    for name, values in (("edit:jawOpen", (0.0, 0.5, 0.0)), ("override:smile", (0.2, 0.2, 0.2))):
        spline = Ts.Spline("float")
        for time, value in zip((109.5, 120, 130), values, strict=True):
            knot = Ts.Knot(typeName="float", time=time, value=value)
            knot.SetNextInterpolation(Ts.InterpCurve)
            knot.SetPostTanWidth(3)
            knot.SetPreTanWidth(3)
            spline.SetKnot(knot)
        assert stage.GetPrimAtPath("/Hero/FaceSolve").GetAttribute(f"face:{name}").SetSpline(spline)
    stage.Save()
    bezier = [
        stage.GetAttributeAtPath("/Hero/FaceSolve.face:edit:jawOpen").Get(int(f)) for f in FRAMES
    ]
    assert bezier[FRAMES.tolist().index(112)] < 0.11  # eased, not linear
    np.testing.assert_allclose(column(path, "jawOpen"), WEIGHTS[:, 1] + bezier, atol=1e-6)
    held = (FRAMES >= 110) & (FRAMES <= 130)
    np.testing.assert_allclose(column(path, "smile"), np.where(held, 0.2, WEIGHTS[:, 0]), atol=1e-6)


def test_an_edit_ends_where_its_value_is_blocked(tmp_path: Path) -> None:
    path = perform(tmp_path)
    author(path, face__edit__smile={110: 0.2, 120: Sdf.ValueBlock(), 130: 0.4})
    author_more = Sdf.Layer.FindOrOpen(str(tmp_path / "hand.usda"))
    prim = author_more.GetPrimAtPath("/Hero/FaceSolve")
    taken = Sdf.AttributeSpec(prim, "face:override:jawOpen", Sdf.ValueTypeNames.Float)
    for time, value in {105: 0.5, 115: Sdf.ValueBlock()}.items():
        author_more.SetTimeSample(taken.path, time, value)
    mask = Sdf.AttributeSpec(prim, "face:mask:jawOpen", Sdf.ValueTypeNames.Float)
    mask.default = 1.0
    author_more.Save()
    reader = PerformanceReader(path)
    smile = (reader.edited() - reader.solved())[:, NAMES.index("smile")]
    for frame, added in {101: 0.2, 110: 0.2, 119: 0.2, 120: 0.0, 129: 0.0, 130: 0.4}.items():
        assert smile[frame - 101] == pytest.approx(added, abs=1e-6), frame
    jaw = column(path, "jawOpen")
    np.testing.assert_allclose(jaw[:14], 0.5)
    np.testing.assert_array_equal(jaw[14:], WEIGHTS[14:, 1])


def test_a_stronger_layer_wins_as_in_any_usd(tmp_path: Path) -> None:
    path = perform(tmp_path)
    reader = PerformanceReader(path)
    everywhere = EditCurve(np.full(40, 0.1), np.zeros(40), np.zeros(40))
    unknown = np.full(40, np.nan)
    write_edits(
        path,
        reader.animation,
        {"jawOpen": ShapeEdit(everywhere, unknown)},
        FRAMES,
        provenance=Provenance(),
    )
    author(path, face__edit__jawOpen=0.3)
    np.testing.assert_allclose(column(path, "jawOpen"), WEIGHTS[:, 1] + 0.3, atol=1e-6)


def test_an_edit_that_is_not_finite_is_refused_by_name(tmp_path: Path) -> None:
    path = perform(tmp_path)
    author(path, face__edit__jawOpen={110: 0.0, 111: float("nan")})
    with pytest.raises(InputError, match=r"face:edit:jawOpen.* time code 111: is not finite"):
        _ = PerformanceReader(path).edits


def test_names_that_no_attribute_can_have_are_kept_whole(tmp_path: Path) -> None:
    names = ("jaw open; rm -rf $HOME", "head:smile", "1. blink`ls`")
    path = perform(tmp_path, names)
    reader = PerformanceReader(path)
    curve = EditCurve(np.full(40, 0.1), np.zeros(40), np.zeros(40))
    edits = {name: ShapeEdit(curve, np.full(40, np.nan)) for name in names}
    write_edits(path, reader.animation, edits, FRAMES, provenance=Provenance())
    assert set(PerformanceReader(path).edits) == set(names)
    np.testing.assert_allclose(PerformanceReader(path).edited(), WEIGHTS + 0.1, atol=1e-6)


def test_two_names_that_would_share_an_attribute_are_refused(tmp_path: Path) -> None:
    path = perform(tmp_path, ("jaw open", "jaw_open", "smile"))
    reader = PerformanceReader(path)
    curve = EditCurve(np.full(40, 0.1), np.zeros(40), np.zeros(40))
    before = path.read_bytes()
    with pytest.raises(InputError, match="would share the attribute"):
        write_edits(
            path,
            reader.animation,
            {"jaw open": ShapeEdit(curve, np.zeros(40))},
            FRAMES,
            provenance=Provenance(),
        )
    assert path.read_bytes() == before
    assert not edits_path(path).exists()


def test_an_edits_layer_of_a_newer_schema_is_refused(tmp_path: Path) -> None:
    path = perform(tmp_path)
    author(path, face__edit__jawOpen=0.1)
    layer = Sdf.Layer.FindOrOpen(str(tmp_path / "hand.usda"))
    layer.customLayerData = {"usdface": {"schema": 99}}
    layer.Save()
    with pytest.raises(InputError, match=r"hand.usda: written with usdface schema 99"):
        PerformanceReader(path)


def test_without_edits_nothing_is_read(tmp_path: Path) -> None:
    path = perform(tmp_path)
    stage = Usd.Stage.Open(str(path))
    assert read_edits(stage.GetPrimAtPath("/Hero/FaceSolve"), FRAMES) == {}
