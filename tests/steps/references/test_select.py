"""Selecting as a user does: every way of choosing, and what must never be lost."""

import json
from bisect import bisect_right
from dataclasses import replace
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
from pxr import Sdf, Usd, UsdGeom, UsdSkel, Vt
from pydantic import ValidationError

from tests.steps.small_shot import PAIRS, Shot
from usdface.core.arrays import columns_by_name
from usdface.core.assets import Video
from usdface.core.errors import InputError
from usdface.core.provenance import Provenance
from usdface.core.sidecars import tuned_path
from usdface.media.picture.image import read_image_metadata
from usdface.media.picture.reference_sheet import ReferenceRow, compose_reference_sheet
from usdface.numerics.measure.face_regions import REGIONS
from usdface.runner.execute import execute
from usdface.specs.references import ReferenceSheetSpec, ReferencesImportSpec, SelectSpec
from usdface.usdio.performance.read import read_performance
from usdface.usdio.references.read import read_references
from usdface.usdio.references.weight_layers import read_keyed_references, read_tuned_pairs
from usdface.usdio.rig.read import read_rig
from usdface.usdio.rig.write import write_rig
from usdface.usdio.take.read import read_take
from usdface.usdio.take.write import write_take
from usdface.usdio.validation import validate

pytestmark = pytest.mark.usefixtures("placement_not_drawn", "coverage_not_drawn")


def spec(shot: Shot, **changed: object) -> SelectSpec:
    given: dict[str, object] = {
        "takes": (shot / "shot.clean.take.usda",),
        "rig": shot / "hero.usdc",
        "out": shot / "new.references.usda",
        "count": 12,
    }
    return SelectSpec(**(given | changed))  # type: ignore[arg-type]


def make_phones(shot: Shot, name: str = "said.json", *, emotions: bool = True) -> Path:
    """Four seconds of three visemes in two emotions."""
    labels = ("M", "AA", "S", "sil")
    phones = [{"start": 0.1 * i, "end": 0.1 * (i + 1), "label": labels[i % 4]} for i in range(40)]
    moods = [
        {"start": 0.0, "end": 2.0, "label": "joy"},
        {"start": 2.0, "end": 4.0, "label": "anger"},
    ]
    data = {"phones": phones} | ({"emotions": moods} if emotions else {})
    (shot / name).write_text(json.dumps(data), encoding="utf-8")
    return shot / name


def test_visemes_of_every_emotion_are_among_the_pairs_and_in_the_asset(shot: Shot) -> None:
    report = execute(spec(shot, method="viseme", phones=(make_phones(shot),), count=28))
    references = read_references(shot / "new.references.usda")
    assert (
        len(references.frames) == len(set(references.frames.tolist())) == 28
    )  # 8, and ten extremes of each emotion
    kinds = set(zip(references.visemes, references.emotions, strict=True))
    assert {(v, e) for v in ("b", "ae", "s", "pau") for e in ("joy", "anger")} <= kinds
    assert list(references.visemes) == report.figures["visemes"]
    for frame, viseme in zip(references.frames.tolist(), references.visemes, strict=True):
        moment = (frame - 1) / 120  # the shot runs at 120 frames a second
        phone = bisect_right([0.1 * i for i in range(40)], moment) - 1
        expected = ("b", "ae", "s", "pau")[phone % 4]
        assert viseme == expected
    stage = Usd.Stage.Open(str(shot / "new.references.usda"))
    root = stage.GetPrimAtPath("/References")
    assert root.GetAttribute("face:reference:viseme").Get(1) == references.visemes[0]


def test_both_gives_half_to_visemes_and_design_says_what_it_measured(shot: Shot) -> None:
    both = execute(spec(shot, phones=(make_phones(shot),)))
    assert both.figures["design"] in both.figures["measured_mm"]
    assert {"b", "ae", "s", "pau"} <= set(both.figures["visemes"])
    design = execute(spec(shot, method="design"), overwrite=True)
    assert len(design.figures["measured_mm"]) == 3
    assert set(design.figures["visemes"]) == {""}


def test_coverage_is_told_and_drawn_beside(shot: Shot) -> None:
    report = execute(spec(shot))
    assert any("no phones are given" in note for note in report.notes), "both designs then"
    assert 0.5 < report.figures["coverage"] < 1.0
    assert set(report.figures["coverage_by_region"]) >= {"lids", "jaw", "mouth"}
    assert len(report.figures["growth"]) == 13
    assert report.figures["next"][0]["frame"] not in report.figures["frames"]
    picture = shot / "new.references.coverage.png"
    assert picture in report.outputs
    assert read_image_metadata(picture)["step"] == "select"
    more = execute(spec(shot, count=24), overwrite=True)
    assert more.figures["coverage"] > report.figures["coverage"]
    # Names that say nothing leave the coverage of all regions.
    rig = other_rig(shot, "Form_{number}")
    foreign = execute(spec(shot, rig=rig, out=shot / "foreign.references.usda"))
    found = foreign.figures["coverage_by_region"]
    assert found.keys() == report.figures["coverage_by_region"].keys()
    assert set(found) == set(REGIONS)
    assert not any("is known to move" in note for note in foreign.notes)


def test_more_pairs_keep_what_is_tuned_and_start_from_the_mapping(shot: Shot) -> None:
    out = shot / "hero.references.usda"
    before = read_references(out)
    report = execute(
        spec(shot, out=out, count=PAIRS + 6, mapping=shot / "hero.mapping.usdc"),
        overwrite=True,
    )
    after = read_references(out)
    np.testing.assert_array_equal(after.frames[:PAIRS], before.frames)
    np.testing.assert_array_equal(after.weights[:PAIRS], before.weights)
    assert not after.tuned[PAIRS:].any()
    assert not set(after.frames[PAIRS:].tolist()) & set(before.frames.tolist())
    assert any("predictions of the mapping" in note for note in report.notes)


def test_proposals_of_a_mapping_are_nearer_the_truth_than_the_geometrys(shot: Shot) -> None:
    execute(spec(shot, method="design", out=shot / "a.references.usda"))
    execute(
        spec(
            shot,
            method="design",
            out=shot / "b.references.usda",
            mapping=shot / "hero.mapping.usdc",
        )
    )
    execute(spec(shot, method="design", out=shot / "c.references.usda"))
    execute(ReferencesImportSpec(references=shot / "c.references.usda", weights=shot / "keys.csv"))
    solved, mapped, truth = (read_references(shot / f"{n}.references.usda") for n in "abc")
    np.testing.assert_array_equal(solved.frames, mapped.frames)
    error = [np.sqrt(np.mean((each.weights - truth.weights) ** 2)) for each in (solved, mapped)]
    assert error[1] < 0.7 * error[0]


@pytest.mark.slow
def test_the_solve_of_one_take_keys_references_of_another_of_the_same_performance(
    shot: Shot,
) -> None:
    """Half the rate, other markers, a second later by its own clock: one video tells the time."""
    take, video = read_take(shot / "shot.clean.take.usda"), shot / "camera.mp4"
    video.write_bytes(b"")
    timed = replace(take, video=Video(video, Fraction(24), offset=-0.25, drift=100.0))
    write_take(shot / "shot.clean.take.usda", timed, provenance=None)
    rows, markers = slice(60, None, 2), take.markers
    other = replace(
        take,
        name="filmed",
        rate=take.rate / 2,
        first_frame=901,
        markers=replace(
            markers,
            names=tuple(f"spot_{name}" for name in markers.names),
            rigid=tuple(f"spot_{name}" for name in markers.rigid),
            positions=markers.positions[rows],
            visible=markers.visible[rows],
            confidence=markers.confidence[rows],
            neutral_frame=901,
        ),
        source=None,
        head_motion=take.head_motion[rows],
        video=Video(video, Fraction(24), offset=-0.25 - 60 / float(take.rate), drift=100.0),
    )
    filmed, out = shot / "filmed.take.usda", shot / "filmed.references.usda"
    write_take(filmed, other, provenance=None)
    execute(spec(shot, takes=(filmed,), out=out, method="design", count=8, landmarks=None))
    asked = ReferencesImportSpec(references=out, weights=shot / "shot.hero.usda", at="video")
    execute(asked)
    found = read_references(out)
    solve = read_performance(shot / "shot.hero.usda").weights
    frames = 60 + 2 * (found.frames - 901)
    expected = columns_by_name(solve.values[frames], solve.names, found.shape_names)
    assert found.tuned.all()
    np.testing.assert_allclose(found.weights, expected, atol=1e-5)
    elsewhere = Video(shot / "shot.c3d", Fraction(24))
    write_take(filmed, replace(other, video=elsewhere), provenance=None)
    with pytest.raises(InputError, match=r"its take has the video .*camera\.mp4, and the"):
        execute(asked, overwrite=True)
    write_take(filmed, replace(other, video=None), provenance=None)
    with pytest.raises(
        InputError, match=r"filmed\.take\.usda: has no video, which --at video needs"
    ):
        execute(asked, overwrite=True)
    with pytest.raises(InputError, match=r"keys\.csv: does not name a single take"):
        execute(asked.model_copy(update={"weights": shot / "keys.csv"}), overwrite=True)


def test_phones_and_emotions_go_with_takes(shot: Shot) -> None:
    said = make_phones(shot)
    with pytest.raises(ValidationError, match="2 phones for 1 takes"):
        spec(shot, phones=(said, said))
    with pytest.raises(ValidationError, match="3 emotions for 1 takes"):
        spec(shot, emotions=("joy", "anger", "fear"))
    with pytest.raises(ValidationError, match="viseme needs --phones"):
        spec(shot, method="viseme")
    with pytest.raises(ValidationError, match="should be 'viseme', 'design' or 'both'"):
        spec(shot, method="active")


def test_unmarked_emotions_are_said_and_a_takes_own_emotion_counts(shot: Shot) -> None:
    said = make_phones(shot, emotions=False)
    report = execute(spec(shot, phones=(said,)))
    assert any("no emotion is marked in shot" in note for note in report.notes)
    report = execute(spec(shot, phones=(said,), emotions=("fear",)), overwrite=True)
    assert set(report.figures["emotions"]) == {"fear"}
    assert not any("no emotion is marked" in note for note in report.notes)


def test_phones_of_another_take_are_refused(shot: Shot) -> None:
    (shot / "long.lab").write_text("0.0 1.0 m\n1.0 60.0 aa\n", encoding="utf-8")
    with pytest.raises(InputError, match=r"lasts 60\.0 s and its take shot 4\.0 s"):
        execute(spec(shot, phones=(shot / "long.lab",)))


def test_fewer_frames_than_pairs_are_refused(shot: Shot) -> None:
    with pytest.raises(InputError, match="--count is 1000, but"):
        execute(spec(shot, count=1000))
    assert not (shot / "new.references.usda").exists()


def other_rig(shot: Shot, pattern: str = "x_{name}") -> Path:
    """The same head whose shapes are called otherwise."""
    rig = read_rig(shot / "hero.usdc")
    rename = {n: pattern.format(name=n, number=i) for i, n in enumerate(rig.shapes)}
    meshes = tuple(
        replace(m, shapes=tuple(replace(s, name=rename[s.name]) for s in m.shapes))
        for m in rig.meshes
    )
    renamed = replace(rig, shapes=tuple(rename.values()), meshes=meshes)
    write_rig(shot / "other.usdc", renamed)
    return shot / "other.usdc"


def test_pairs_tuned_on_one_rig_are_not_mixed_with_another(shot: Shot) -> None:
    out = shot / "hero.references.usda"
    tuned = tuned_path(out).read_bytes()
    rig = other_rig(shot)
    with pytest.raises(InputError, match=r"pair 1: \d+ of its \d+ shapes are not on .*another rig"):
        execute(spec(shot, out=out, count=PAIRS, rig=rig), overwrite=True)
    with pytest.raises(InputError, match="was trained for another rig"):
        execute(spec(shot, rig=rig, mapping=shot / "hero.mapping.usdc"))
    assert tuned_path(out).read_bytes() == tuned


def test_tuning_of_an_older_selection_is_refused_and_not_touched(shot: Shot) -> None:
    new = shot / "new.references.usda"
    execute(spec(shot, method="design", count=PAIRS, frames="200-480"))
    stale = tuned_path(shot / "hero.references.usda").read_bytes()
    tuned_path(new).write_bytes(stale)
    with pytest.raises(InputError, match="it is of an older selection"):
        read_references(new)
    assert tuned_path(new).read_bytes() == stale
    # Selecting again takes the old tuning in, at the time codes it has.
    execute(spec(shot, count=PAIRS), overwrite=True)
    assert read_references(new).tuned.all()
    kept = read_tuned_pairs(tuned_path(shot / "hero.references.usda"))
    assert [e.weights for e in read_tuned_pairs(tuned_path(new))] == [e.weights for e in kept]


def test_pairs_keyed_in_a_dcc_are_kept_as_tuned_ones_are(shot: Shot) -> None:
    new = spec(shot)
    execute(new)
    before = read_references(new.out)
    layer = Sdf.Layer.FindOrOpen(str(tuned_path(new.out)))
    prim = Sdf.CreatePrimInLayer(layer, "/References/Weights")
    names = Sdf.AttributeSpec(prim, "blendShapes", Sdf.ValueTypeNames.TokenArray)
    names.default = list(before.shape_names)
    place = Sdf.AttributeSpec(prim, "blendShapeWeights", Sdf.ValueTypeNames.FloatArray).path
    keyed = before.weights.copy()
    keyed[4] = 0.25  # the one that somebody changed; a DCC writes all
    for pair, row in enumerate(keyed.astype(np.float32)):
        layer.SetTimeSample(place, pair + 1, Vt.FloatArray.FromNumpy(row))
    layer.Save()
    assert np.flatnonzero(read_keyed_references(new.out).tuned).tolist() == [4]
    report = execute(spec(shot, count=14, frames="1-300", method="design"), overwrite=True)
    after = read_references(new.out)
    assert np.flatnonzero(after.tuned).tolist() == [4]
    assert after.frames[4] == before.frames[4]
    assert (after.weights[4] == 0.25).all()
    assert any("keyed in the asset, and now" in note for note in report.notes)


def test_references_hold_what_blender_needs(shot: Shot) -> None:
    """As found by trying: a Skeleton, every prim typed, whole last time code, short names."""
    execute(spec(shot, method="viseme", phones=(make_phones(shot),)))
    path = shot / "new.references.usda"
    stage = Usd.Stage.Open(str(path))
    assert validate(path) == []
    assert stage.GetEndTimeCode() == int(stage.GetEndTimeCode()) == 12
    assert stage.GetDefaultPrim()
    prims = list(stage.Traverse())
    assert all(prim.GetTypeName() for prim in prims), [
        str(p.GetPath()) for p in prims if not p.GetTypeName()
    ]
    skeletons = [prim for prim in prims if prim.IsA(UsdSkel.Skeleton)]
    assert skeletons
    for prim in skeletons:
        source = UsdSkel.BindingAPI(prim).GetAnimationSourceRel().GetTargets()
        assert [str(target) for target in source] == ["/References/Weights"]
    for prim in prims:
        if prim.IsA(UsdGeom.Mesh) and prim.HasAPI(UsdSkel.BindingAPI):
            assert UsdSkel.BindingAPI(prim).GetInheritedSkeleton()
    animation = UsdSkel.Animation(stage.GetPrimAtPath("/References/Weights"))
    names = animation.GetBlendShapesAttr().Get()
    assert max(len(name.encode()) for name in names) < 64
    samples = animation.GetBlendShapeWeightsAttr().GetTimeSamples()
    assert samples == [float(i) for i in range(1, 13)]


def test_the_sheet_shows_pairs_as_they_are_now(shot: Shot, monkeypatch: pytest.MonkeyPatch) -> None:
    rows: list[ReferenceRow] = []

    def kept(page: tuple[ReferenceRow, ...], **options: object) -> np.ndarray:
        rows[:] = page
        return compose_reference_sheet(page, **options)  # type: ignore[arg-type]

    monkeypatch.setattr("usdface.steps.references.sheet.compose_reference_sheet", kept)
    execute(spec(shot))
    execute(
        ReferenceSheetSpec(
            references=spec(shot).out, out=shot / "new.png", pairs="1-2", tile=64, quality="draft"
        )
    )
    assert all(row.residual_mm is not None and not row.tuned for row in rows)
    for paper, name in ((False, "screen.png"), (True, "paper.png")):
        report = execute(
            ReferenceSheetSpec(
                references=shot / "hero.references.usda",
                takes=(shot / "shot.clean.take.usda",),
                out=shot / name,
                pairs="2-5",
                paper=paper,
                tile=64,
                quality="draft",
            )
        )
        assert report.figures["pairs"] == [2, 3, 4, 5]
        assert report.summary == "4 pairs drawn, 4 of them tuned"
        assert [row.residual_mm for row in rows] == [None] * 4, "no measure of a key"
        assert any("no video frame" in note for note in report.notes)
        assert read_image_metadata(shot / name)["step"] == "references-sheet"


@pytest.mark.slow
def test_further_pages_of_pairs_replace_their_own_alone(shot: Shot) -> None:
    given = {"references": shot / "hero.references.usda", "out": shot / "x.png", "tile": 64}
    sheet = ReferenceSheetSpec(**given, pairs="1-7", quality="draft")
    theirs = shot / "x.2.png"
    theirs.write_bytes(b"my drawing")
    with pytest.raises(InputError, match=r"x\.2\.png: exists, and would be replaced by a page"):
        execute(sheet)
    assert theirs.read_bytes() == b"my drawing"
    theirs.unlink()
    assert execute(sheet).outputs == (shot / "x.png", theirs)
    execute(sheet.model_copy(update={"pairs": "1-2"}), overwrite=True)
    assert not theirs.exists()


def test_a_sheet_of_pairs_that_are_not_there_or_of_another_take_is_refused(shot: Shot) -> None:
    given = {"references": shot / "hero.references.usda", "out": shot / "x.png", "tile": 64}
    with pytest.raises(InputError, match="has pairs 1-24; --pairs 30-40"):
        execute(ReferenceSheetSpec(**given, pairs="30-40"))
    take = replace(read_take(shot / "shot.clean.take.usda"), name="other")
    write_take(shot / "other.take.usda", take, provenance=Provenance())
    with pytest.raises(InputError, match=r"no pair is of take 'other'; .* from, shot"):
        execute(ReferenceSheetSpec(**given, takes=(shot / "other.take.usda",)))
