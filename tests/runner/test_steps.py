"""Single steps, as their users meet them."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from pxr import Sdf, Usd, UsdGeom, Vt
from pydantic import ValidationError

from tests.model.synthetic import align_markers
from tests.steps.small_shot import PAIRS, Shot
from usdface.core.errors import InputError
from usdface.core.provenance import Provenance
from usdface.core.sidecars import weights_path
from usdface.media.picture.image import read_image_metadata
from usdface.model.mapping.predict import WeightPredictor
from usdface.model.mapping.train import train_mapping
from usdface.model.review.verdict import SolveEvidence, judge_solve
from usdface.runner.execute import execute
from usdface.runner.result import StepResult
from usdface.specs.base import Spec
from usdface.specs.capture import IngestSpec
from usdface.specs.performance import MapSpec, TrainSpec
from usdface.specs.references import ReferencesImportSpec, SelectSpec
from usdface.specs.review import SheetSpec
from usdface.steps.capture import ingest
from usdface.steps.performance.train import _read_pairs
from usdface.usdio.mapping import read_mapping, write_mapping
from usdface.usdio.performance.read import PerformanceReader, read_performance
from usdface.usdio.references.read import read_references
from usdface.usdio.rig.read import read_rig
from usdface.usdio.take.read import read_take

pytestmark = pytest.mark.usefixtures(
    "without_comparison", "placement_not_drawn", "coverage_not_drawn"
)


def run(spec: Spec) -> StepResult:
    return execute(spec, overwrite=True)


def test_a_usd_capture_becomes_the_same_take_as_its_c3d(shot: Shot) -> None:
    take = read_take(shot / "shot.take.usda")
    stage = Usd.Stage.CreateNew(str(shot / "mocap.usda"))
    stage.SetTimeCodesPerSecond(120)
    stage.SetFramesPerSecond(120)
    UsdGeom.SetStageMetersPerUnit(stage, 0.001)
    UsdGeom.SetStageUpAxis(stage, "Z")
    points = UsdGeom.Points.Define(stage, "/mocap/face")
    labels = UsdGeom.PrimvarsAPI(points).CreatePrimvar(
        "names", Sdf.ValueTypeNames.TokenArray, UsdGeom.Tokens.vertex
    )
    labels.Set(list(take.markers.names))
    x, y, z = np.moveaxis(take.markers.positions, -1, 0)
    z_up = np.ascontiguousarray(np.stack([x, -z, y], axis=-1))
    for index, frame in enumerate(take.frames.tolist()):
        points.GetPointsAttr().Set(Vt.Vec3fArray.FromNumpy(z_up[index]), frame)
    stage.Save()
    run(IngestSpec(sources=(shot / "mocap.usda",), out=shot / "usd.take.usda", rigid=shot.rigid))
    again = read_take(shot / "usd.take.usda")
    assert again.markers.names == take.markers.names
    assert again.markers.rigid == take.markers.rigid
    np.testing.assert_allclose(again.markers.positions, take.markers.positions, rtol=1e-5)


def test_a_take_ingested_again_keeps_all_it_knows(shot: Shot) -> None:
    run(
        IngestSpec(
            sources=(shot / "shot.take.usda",), out=shot / "again.take.usda", performer="Ada"
        )
    )
    before, again = read_take(shot / "shot.take.usda"), read_take(shot / "again.take.usda")
    assert again.performer == "Ada"
    assert again.timecode_start == before.timecode_start
    assert again.markers.rigid == before.markers.rigid
    np.testing.assert_array_equal(again.markers.positions, before.markers.positions)


def test_a_timecode_that_the_rate_has_not_is_no_take_s(shot: Shot, monkeypatch) -> None:
    spec = IngestSpec(sources=(shot / "shot.c3d",), out=shot / "a.take.usda", rigid=shot.rigid)
    with pytest.raises(InputError, match=r"--timecode: .*:30' does not exist at 30 labels"):
        run(spec.model_copy(update={"timecode": "01:00:00:30"}))
    assert not spec.out.exists()
    whole = ingest.read_capture(shot / "shot.c3d", rigid=shot.rigid)
    said = replace(whole, take=replace(whole.take, timecode_start="01:00:00;10"))
    monkeypatch.setattr(ingest, "read_capture", lambda *_, **__: said)
    report = run(spec)
    assert any("timecode was left out: 01:00:00;10: drop frame" in note for note in report.notes)
    assert read_take(spec.out).timecode_start == ""


def test_selecting_again_keeps_tuned_pairs_where_they_are(shot: Shot) -> None:
    path = shot / "hero.references.usda"
    before = read_references(path)
    run(
        SelectSpec(
            takes=(shot / "shot.clean.take.usda",),
            rig=shot / "hero.usdc",
            out=path,
            count=PAIRS + 4,
        )
    )
    after = read_references(path)
    np.testing.assert_array_equal(after.frames[:PAIRS], before.frames)
    np.testing.assert_array_equal(after.weights[:PAIRS], before.weights)
    assert after.tuned.tolist() == [True] * PAIRS + [False] * 4
    assert len(set(after.frames.tolist())) == PAIRS + 4, "no frame twice"


def test_proposals_are_within_the_rigs_ranges_and_near_what_was_keyed(shot: Shot) -> None:
    proposed = shot / "hero.references.proposed.usda"
    layer = Sdf.Layer.FindOrOpen(str(proposed))
    weights = np.array(
        [
            layer.QueryTimeSample("/References/Weights.blendShapeWeights", i + 1)
            for i in range(PAIRS)
        ]
    )
    tuned = read_references(shot / "hero.references.usda").weights
    assert weights.min() >= 0
    assert weights.max() <= 1
    assert np.abs(weights - tuned).mean() < np.abs(tuned - tuned.mean(axis=0)).mean()


def test_importing_part_of_the_shapes_keeps_the_rest(shot: Shot) -> None:
    references = read_references(shot / "hero.references.usda")
    frame = int(references.frames[2])
    (shot / "part.csv").write_text(f"frame,jawOpen,not_a_shape\n{frame},0.625,1\n")
    report = run(
        ReferencesImportSpec(references=shot / "hero.references.usda", weights=shot / "part.csv")
    )
    after = read_references(shot / "hero.references.usda")
    changed = after.weights != references.weights
    jaw = references.shape_names.index("jawOpen")
    assert np.argwhere(changed).tolist() == [[2, jaw]]
    assert after.weights[2, jaw] == 0.625
    assert any("not_a_shape" in note for note in report.notes)


def test_weights_come_back_from_the_usd_that_a_dcc_scrubbed(shot: Shot) -> None:
    references = read_references(shot / "hero.references.usda")
    layer = Sdf.Layer.CreateNew(str(shot / "dcc.usda"))
    layer.timeCodesPerSecond = layer.framesPerSecond = 24
    prim = Sdf.CreatePrimInLayer(layer, "/anim")
    prim.specifier, prim.typeName = Sdf.SpecifierDef, "SkelAnimation"
    names = Sdf.AttributeSpec(prim, "blendShapes", Sdf.ValueTypeNames.TokenArray)
    names.default = list(references.shape_names)[::-1]
    Sdf.AttributeSpec(prim, "blendShapeWeights", Sdf.ValueTypeNames.FloatArray)
    rows = np.random.default_rng(0).random((PAIRS, len(references.shape_names))).astype(np.float32)
    for pair, row in enumerate(rows):
        layer.SetTimeSample(
            "/anim.blendShapeWeights", pair + 1, Vt.FloatArray.FromNumpy(row[::-1].copy())
        )
    layer.Save()
    run(
        ReferencesImportSpec(
            references=shot / "hero.references.usda", weights=shot / "dcc.usda", at="pairs"
        )
    )
    np.testing.assert_array_equal(read_references(shot / "hero.references.usda").weights, rows)


def test_what_lies_between_two_keyed_pairs_is_nobodys_tuning(shot: Shot) -> None:
    asset = shot / "hero.references.usda"
    before = read_references(asset)
    layer = Sdf.Layer.CreateNew(str(shot / "sparse.usda"))
    layer.timeCodesPerSecond = before.rate
    prim = Sdf.CreatePrimInLayer(layer, "/anim")
    prim.specifier, prim.typeName = Sdf.SpecifierDef, "SkelAnimation"
    names = Sdf.AttributeSpec(prim, "blendShapes", Sdf.ValueTypeNames.TokenArray)
    names.default = ["jawOpen"]
    Sdf.AttributeSpec(prim, "blendShapeWeights", Sdf.ValueTypeNames.FloatArray)
    for pair, weight in ((2, 0.25), (6, 0.75)):
        layer.SetTimeSample("/anim.blendShapeWeights", pair, Vt.FloatArray([weight]))
    layer.Save()
    given = {"references": asset, "weights": shot / "sparse.usda"}
    report = run(ReferencesImportSpec(**given, at="pairs"))
    after = read_references(asset)
    assert np.flatnonzero((after.weights != before.weights).any(axis=1)).tolist() == [1, 5]
    assert after.weights[[1, 5], before.shape_names.index("jawOpen")].tolist() == [0.25, 0.75]
    assert report.figures["pairs"] == 2

    first, last = sorted(before.frames.tolist())[0], sorted(before.frames.tolist())[-1]
    layer.EraseTimeSample("/anim.blendShapeWeights", 2)
    layer.EraseTimeSample("/anim.blendShapeWeights", 6)
    for frame in (first, last):
        layer.SetTimeSample("/anim.blendShapeWeights", frame, Vt.FloatArray([0.5]))
    layer.Save()
    report = run(ReferencesImportSpec(**given))
    assert any(note.endswith(f"sparse.usda: {PAIRS - 2} pairs") for note in report.notes)


def test_decimal_commas_are_refused_and_not_read_as_columns(shot: Shot) -> None:
    asset = shot / "hero.references.usda"
    before = read_references(asset)
    one, two = before.frames[:2].tolist()
    table = shot / "comma.csv"
    table.write_text(f"frame,jawOpen,mouthClose\n{one},0,0\n{two},0,5,0,25\n")
    with pytest.raises(InputError, match="line 3: 5 cells, 3 expected"):
        run(ReferencesImportSpec(references=asset, weights=table))
    np.testing.assert_array_equal(read_references(asset).weights, before.weights)
    table.write_text(f"frame,jawOpen,mouthClose\n{one},0,0,,\n{two},0.5,0.25,,\n")
    assert run(ReferencesImportSpec(references=asset, weights=table)).figures["pairs"] == 2


def test_keys_are_matched_by_meaning_take_and_unit(shot: Shot) -> None:
    """Spellings, a semicolon, a take column and percent, as a spreadsheet of people has them."""
    asset = shot / "hero.references.usda"
    before = read_references(asset)
    frame, other = before.frames[:2].tolist()
    take = before.takes[0]
    jaw = before.shape_names.index("jawOpen")
    table = shot / "people.csv"
    rows = f"Frame;Take;JawOpen;smirk\n{frame};{take};45;100\n{other};elsewhere;80;0\n"
    table.write_text(rows)
    with pytest.raises(InputError, match=r"smirk is 100.*--weight-unit percent"):
        run(ReferencesImportSpec(references=asset, weights=table))
    given = {"references": asset, "weights": table, "weight_unit": "percent"}
    report = run(ReferencesImportSpec(**given))
    assert report.figures["pairs"] == 1
    assert any(
        "left out 1 column of" in note and note.endswith("not on the rig: smirk")
        for note in report.notes
    )
    after = read_references(asset).weights
    assert after[0, jaw] == pytest.approx(0.45)
    assert after[1, jaw] == before.weights[1, jaw]
    table.write_text(rows.replace(take, "nowhere"))
    with pytest.raises(InputError, match=r"takes \(nowhere, elsewhere\) is one of the pairs'"):
        run(ReferencesImportSpec(**given))


def test_keys_without_frame_numbers_count_from_1_at_the_rate_of_the_take(shot: Shot) -> None:
    asset = shot / "hero.references.usda"
    before = read_references(asset)
    last = int(before.frames.max())
    jaw, rate = before.shape_names.index("jawOpen"), float(read_take(shot / "shot.take.usda").rate)
    names, values = ["JawOpen", "smirk"], [[n / (2 * last), 0.0] for n in range(1, last + 1)]
    table = shot / "spoken.json"
    table.write_text(json.dumps({"exportFps": 30, "facsNames": names, "weightMat": values}))
    with pytest.raises(InputError, match=f"runs at 30 frames per second.*at {rate:g}"):
        run(ReferencesImportSpec(references=asset, weights=table))
    table.write_text(json.dumps({"exportFps": rate, "facsNames": names, "weightMat": values}))
    report = run(ReferencesImportSpec(references=asset, weights=table))
    assert any("count from frame 1" in note for note in report.notes)
    expected = before.frames / (2 * last)
    np.testing.assert_allclose(read_references(asset).weights[:, jaw], expected, atol=1e-6)
    np.save(shot / "poses.npy", [[0.125, 0.0]] * len(before.frames))
    (shot / "names.txt").write_text("jaw_open\nsmirk\n")
    given = {"weights": shot / "poses.npy", "shapes": shot / "names.txt", "at": "pairs"}
    run(ReferencesImportSpec(references=asset, **given))
    np.testing.assert_allclose(read_references(asset).weights[:, jaw], 0.125)


def test_an_untuned_start_is_named_and_imports_count_all_that_is_tuned(shot: Shot) -> None:
    asset = shot / "untuned.references.usda"
    selected = run(
        SelectSpec(
            takes=(shot / "shot.clean.take.usda",), rig=shot / "hero.usdc", out=asset, count=6
        )
    )
    _, trained = _read_pairs(TrainSpec(references=asset, out=shot / "untuned.mapping.usdc"))
    for notes in (selected.notes, trained):
        assert any(note.startswith("an untuned start: all ") for note in notes)
        assert any("`usdface tune " in note for note in notes)
    for count, frame in enumerate(read_references(asset).frames[:2].tolist(), start=1):
        table = shot / f"tuned{count}.csv"
        table.write_text(f"frame,jawOpen\n{frame},0.25\n")
        imported = run(ReferencesImportSpec(references=asset, weights=table))
        assert imported.summary == f"1 pair imported, 1 shape each; {count} of 6 pairs are tuned"
        assert (imported.figures["pairs"], imported.figures["tuned"]) == (1, count)


def test_a_reopened_mapping_predicts_the_same_to_the_last_bit(shot: Shot) -> None:
    references = read_references(shot / "hero.references.usda")
    rig = read_rig(shot / "hero.usdc")
    mapping = train_mapping(references, ranges=rig.ranges, gram=None)
    write_mapping(shot / "bits.mapping.usdc", mapping, provenance=Provenance())
    reopened = read_mapping(shot / "bits.mapping.usdc")
    markers = read_take(shot / "shot.clean.take.usda").markers
    first, second = (
        WeightPredictor(each).predict(align_markers(each, markers, rate=120.0).positions)
        for each in (mapping, reopened)
    )
    np.testing.assert_array_equal(first.weights, second.weights)
    np.testing.assert_array_equal(first.uncertainty, second.uncertainty)


def test_mapping_a_part_equals_that_part_of_the_whole(shot: Shot) -> None:
    whole = read_performance(shot / "shot.hero.usda").weights
    report = run(
        MapSpec(
            take=shot / "shot.clean.take.usda",
            mapping=shot / "hero.mapping.usdc",
            rig=shot / "hero.usdc",
            out=shot / "part.usda",
            frames="101-140",
            prim="/shot/hero",
        )
    )
    part = read_performance(shot / "part.usda")
    assert part.weights.first_frame == 101
    np.testing.assert_array_equal(part.weights.values, whole.values[100:140])
    assert part.timecode_start == "01:00:00:25"
    reader = PerformanceReader(shot / "part.usda")
    evidence = SolveEvidence(
        reader.regions,
        *reader.figures(101, 140),
        basis=reader.basis,
    )
    verdict = judge_solve(evidence)  # by what the layer keeps of it
    assert report.figures["verdict"]["level"] == verdict.level
    assert report.level == verdict.level
    assert report.summary.startswith(f"{verdict.sentence.split(':')[0]}: ")
    assert report.summary.endswith("(40 frames)")
    assert Sdf.Layer.FindOrOpen(str(weights_path(shot / "part.usda"))).defaultPrim == "shot"


def test_training_leaves_proposals_out_once_enough_pairs_are_tuned(shot: Shot) -> None:
    run(
        SelectSpec(
            takes=(shot / "shot.clean.take.usda",),
            rig=shot / "hero.usdc",
            out=shot / "hero.references.usda",
            count=PAIRS + 4,
        )
    )
    train = TrainSpec(references=shot / "hero.references.usda", out=shot / "a.usdc", method="ridge")
    usual = run(train)
    assert usual.notes[0].startswith(
        f"trained on the {PAIRS} tuned pairs; 4 untuned proposals left"
    )
    assert read_mapping(shot / "a.usdc").settings["pairs"] == PAIRS
    every, notes = _read_pairs(train.model_copy(update={"all_pairs": True}))
    assert notes[0].startswith(f"trained on {PAIRS} tuned pairs and 4 untuned proposals")
    assert len(every.frames) == PAIRS + 4
    only, notes = _read_pairs(train.model_copy(update={"tuned_only": True}))
    assert not any("proposals" in note for note in notes)
    assert len(only.frames) == PAIRS
    few = shot / "few.references.usda"
    take = shot / "shot.clean.take.usda"
    run(SelectSpec(takes=(take,), rig=shot / "hero.usdc", out=few, count=12))
    frames = read_references(few).frames[:7]
    (shot / "few.csv").write_text("frame,jawOpen\n" + "".join(f"{f},0.25\n" for f in frames))
    run(ReferencesImportSpec(references=few, weights=shot / "few.csv"))
    mixed, notes = _read_pairs(train.model_copy(update={"references": few}))
    assert notes[0].startswith("trained on 7 tuned pairs and 5 untuned proposals")
    assert len(mixed.frames) == 12
    with pytest.raises(ValidationError, match="all_pairs has no effect with tuned_only"):
        TrainSpec.model_validate(train.model_dump() | {"tuned_only": True, "all_pairs": True})


@pytest.mark.parametrize("suffix", ["jpg", "png", "exr"])
def test_a_sheets_metadata_says_how_it_was_made(shot: Shot, suffix: str) -> None:
    out = shot / f"new.{suffix}"
    report = run(
        SheetSpec(
            performance=shot / "shot.hero.usda",
            take=shot / "shot.clean.take.usda",
            out=out,
            rows=1,
            tile=64,
            quality="draft",
            baseline=False,
        )
    )
    metadata = read_image_metadata(out)
    assert metadata["step"] == "sheet"
    assert "shot.hero.usda" in metadata["inputs"]
    assert metadata["timecode"] == "01:00:00:00"
    assert report.figures["against_truth"] is False


def test_a_take_without_markers_says_so(shot: Shot, tmp_path: Path) -> None:
    from usdface.core.assets import Take, WeightsClip
    from usdface.core.errors import InputError
    from usdface.specs.capture import CleanSpec
    from usdface.usdio.take.write import write_take

    clip = WeightsClip(
        ("a",), np.zeros((3, 1), np.float32), 1, read_take(shot / "shot.take.usda").rate
    )
    write_take(
        tmp_path / "w.take.usda", Take("w", clip.rate, 1, source=clip), provenance=Provenance()
    )
    with pytest.raises(InputError, match="has no markers to clean"):
        run(CleanSpec(take=tmp_path / "w.take.usda", out=tmp_path / "n.take.usda"))


def test_a_neutral_frame_without_the_rigid_markers_is_named_by_its_number(
    shot: Shot, tmp_path: Path
) -> None:
    from usdface.specs.capture import CleanSpec
    from usdface.usdio.take.write import write_take

    take = read_take(shot / "shot.take.usda")
    assert take.markers is not None
    rigid = take.markers.names[:3]
    visible = take.markers.visible.copy()
    visible[4, 1:3] = False
    hidden = tmp_path / "hidden.take.usda"
    write_take(
        hidden,
        replace(take, markers=replace(take.markers, visible=visible)),
        provenance=Provenance(),
    )
    neutral = take.first_frame + 4
    spec = CleanSpec(take=hidden, out=tmp_path / "c.take.usda", rigid=rigid, neutral=neutral)
    with pytest.raises(InputError, match=f"1 of the rigid markers .* neutral frame {neutral}, 3 "):
        run(spec)


@pytest.mark.parametrize(
    ("asked", "message"),
    [
        ({"units": "cm"}, "a USD file states its units"),
        ({"neutral": 99_999}, "neutral frame 99999 is outside the take"),
        ({"rigid": ("nobody",)}, "rigid marker nobody not among"),
    ],
)
def test_what_a_take_ingested_again_cannot_be_told_is_refused(
    shot: Shot, tmp_path: Path, asked: dict[str, object], message: str
) -> None:
    spec = IngestSpec(sources=(shot / "shot.take.usda",), out=tmp_path / "b.take.usda", **asked)
    with pytest.raises(InputError, match=message):
        run(spec)


def test_a_clean_take_is_not_cleaned_again_and_keeps_its_heads_motion(shot: Shot) -> None:
    from usdface.specs.capture import CleanSpec

    assert read_take(shot / "shot.clean.take.usda").head_motion is not None
    with pytest.raises(InputError, match="is cleaned already"):
        run(CleanSpec(take=shot / "shot.clean.take.usda", out=shot / "twice.take.usda"))
