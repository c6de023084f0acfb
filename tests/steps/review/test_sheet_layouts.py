"""Every layout of a sheet, on a shot that has been solved."""

import json
import re
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import OpenImageIO as oiio  # noqa: N813
import pytest
from pxr import Gf, Usd, UsdGeom

from tests.steps.small_shot import Shot
from usdface.core.deformer import Deformer
from usdface.core.errors import InputError
from usdface.media.picture.color import bytes_from_linear
from usdface.media.picture.image import display_view, read_image_metadata
from usdface.media.picture.sheet import Tile
from usdface.model.mapping.evaluation import SkinMetric
from usdface.model.review.verdict import VERDICT_WORDS
from usdface.runner.execute import execute
from usdface.specs.edits import EditSpec
from usdface.specs.review import ReportSpec, SheetSpec
from usdface.speech.phones import viseme_label, viseme_of
from usdface.steps.review import sheet as sheet_step
from usdface.steps.review import sheet_columns
from usdface.steps.review.pictures import ShotPictures
from usdface.usdio.performance.read import read_performance
from usdface.usdio.rig.read import read_rig


def spec_of(shot: Shot, **options: object) -> SheetSpec:
    given = {"out": shot / "new.png", "tile": 64, "quality": "draft", "rows": 2} | options
    return SheetSpec(
        performance=shot / "shot.hero.usda", take=shot / "shot.clean.take.usda", **given
    )


def columns_of(shot: Shot, monkeypatch: pytest.MonkeyPatch, **options: object) -> tuple[str, ...]:
    pages = []
    compose = sheet_step.compose_sheet
    monkeypatch.setattr(
        sheet_step, "compose_sheet", lambda page: (pages.append(page), compose(page))[1]
    )
    execute(spec_of(shot, **options))
    return pages[0].columns


def test_skin_that_no_region_measures_has_no_uncertainty(shot: Shot, monkeypatch) -> None:
    painted = []
    monkeypatch.setattr(
        ShotPictures,
        "painted",
        lambda self, row, weights, values, **named: (
            painted.append(values) or np.zeros((64, 64, 3), np.uint8)
        ),
    )
    columns_of(shot, monkeypatch, baseline=False)
    rig = read_rig(shot / "hero.usdc")
    points = SkinMetric(rig, Deformer(rig)).points
    points.pop("face")
    measured = np.concatenate(list(points.values()))
    assert painted
    for values in painted:
        assert np.isfinite(values[measured]).all()
        assert np.isnan(np.delete(values, measured)).all()


def test_a_sheet_of_worst_frames_explains_its_lines_and_a_strip_has_none(
    shot: Shot, monkeypatch
) -> None:
    pages = []
    compose = sheet_step.compose_sheet
    monkeypatch.setattr(
        sheet_step, "compose_sheet", lambda page: (pages.append(page), compose(page))[1]
    )
    execute(spec_of(shot, layout="strip"))
    worst = spec_of(shot, layout="worst", baseline=False, rows=3, out=shot / "b.png")
    assert len(execute(worst).figures["frames"]) == 3
    assert pages[1].columns == ("markers", "solve", "uncertainty")
    told = ["lines: residual" in " ".join(page.notes) for page in pages]
    assert told == ["markers" in page.columns for page in pages] == [False, True]


def second_performance(shot: Shot) -> Path:
    for name in ("usda", "weights.usdc"):
        shutil.copy(shot / f"shot.hero.{name}", shot / f"other.{name}")
    text = (shot / "other.usda").read_text(encoding="utf-8")
    (shot / "other.usda").write_text(text.replace("shot.hero.weights", "other.weights"))
    return shot / "other.usda"


def test_several_characters_stand_side_by_side(shot: Shot, monkeypatch) -> None:
    also = (second_performance(shot),)
    columns = columns_of(shot, monkeypatch, layout="characters", also=also)
    assert columns == ("markers", "solve", "other")


def test_the_verdict_is_that_of_the_worst_character(shot: Shot, monkeypatch) -> None:
    other = second_performance(shot)
    execute(EditSpec(performance=other, shape=("jawOpen",), add=0.9))
    pages = []
    compose = sheet_step.compose_sheet
    monkeypatch.setattr(
        sheet_step, "compose_sheet", lambda page: (pages.append(page), compose(page))[1]
    )
    given = {"also": (other,), "against": shot / "keys.csv", "layout": "characters"}
    told = execute(spec_of(shot, **given))
    assert pages[0].verdict[0] == told.level == "bad"
    assert told.summary.startswith(pages[0].verdict[1])
    assert pages[0].verdict[1].startswith("Do not use (other): ")
    assert pages[0].verdict[-1].startswith("solve: Good")
    assert told.figures["verdicts"] == {"usdface": "good", "other": "bad"}


def test_a_performance_of_another_take_is_not_shown_beside_one(shot: Shot) -> None:
    other, take = second_performance(shot), (shot / "shot.clean.take.usda")
    both = {"performance": shot / "shot.hero.usda", "also": (other,)}
    small = {"tile": 64, "rows": 1, "quality": "draft"}
    sheet = SheetSpec(**both, out=shot / "x.png", layout="characters", **small)
    report = ReportSpec(**both, out=shot / "x.html", frames="1-24", baseline=False)
    text = other.read_text(encoding="utf-8")
    another = take.read_text(encoding="utf-8").replace('face:take = "shot', 'face:take = "nose')
    assert another.count("nose") == 1
    for name, content in (
        ("again.take.usda", take.read_text(encoding="utf-8")),  # the same take, cleaned again
        ("nose.take.usda", another),
    ):
        (shot / name).write_text(content, encoding="utf-8")
        other.write_text(text.replace(take.name, name), encoding="utf-8")
        for spec in (sheet, report):
            if name == "again.take.usda":
                execute(spec, overwrite=True)
                continue
            with pytest.raises(InputError, match=r"other.usda: is of another take than shot.hero"):
                execute(spec, overwrite=True)
    other.write_text(text.replace("timeCodesPerSecond = 120", "timeCodesPerSecond = 60"))
    with pytest.raises(InputError, match="it has 60 frames per second, not 120"):
        execute(sheet, overwrite=True)


def test_every_performance_of_a_face_is_judged_by_the_truth_and_another_face_says_how(
    shot: Shot, monkeypatch
) -> None:
    given = {"also": (second_performance(shot),), "against": shot / "keys.csv", "rows": 1}
    told = execute(spec_of(shot, layout="characters", **given))
    means = told.figures["mean_error_mm"]
    assert means["other"] == pytest.approx(means["usdface"])
    assert "off the keys" in told.summary
    monkeypatch.setattr(sheet_columns, "_same_face", lambda *_: False)
    told = execute(spec_of(shot, layout="characters", out=shot / "b.png", **given))
    assert told.figures["mean_error_mm"]["other"] != pytest.approx(means["usdface"])
    assert "mm uncertainty" in told.summary


def test_uncertainty_is_drawn_below_the_errors(shot: Shot, monkeypatch) -> None:
    pages = []
    compose = sheet_step.compose_sheet
    monkeypatch.setattr(
        sheet_step, "compose_sheet", lambda page: (pages.append(page), compose(page))[1]
    )
    execute(spec_of(shot))
    curve, covered = pages[0].curves
    assert (curve.label, covered.label) == ("uncertainty", "1 − coverage")
    assert (pages[0].high, pages[0].comparable) == (3.0, False)
    assert pages[0].verdict[0] in VERDICT_WORDS
    np.testing.assert_array_equal(
        curve.values, read_performance(shot / "shot.hero.usda").uncertainty_mm[:, 0]
    )
    execute(spec_of(shot, against=shot / "keys.csv", out=shot / "b.png"))
    assert (pages[1].high, pages[1].comparable) == (1.0, True)
    assert pages[1].columns == ("markers", "baseline", "solve", "error")
    assert all(re.search(r"references cover \d+% of the frames", p.verdict[1]) for p in pages)
    assert "gaze alone" in " ".join(pages[1].notes)


def test_frames_that_are_named_are_drawn_and_the_take_is_the_performances_own(shot: Shot) -> None:
    named = SheetSpec(
        performance=shot / "shot.hero.usda",
        out=shot / "c.png",
        frames="200,7,31",
        tile=64,
        quality="draft",
    )
    assert execute(named).figures["frames"] == [7, 31, 200]
    with pytest.raises(InputError, match=r"some of --frames 7,9000 are outside 1-480"):
        execute(named.model_copy(update={"frames": "7,9000"}), overwrite=True)
    take = shot / "shot.clean.take.usda"
    other = shot / "nose.take.usda"
    other.write_text(take.read_text(encoding="utf-8").replace("Take", "Nose"), encoding="utf-8")
    with pytest.raises(InputError, match=r"nose.take.usda: not the take of shot.hero.usda"):
        execute(named.model_copy(update={"take": other}), overwrite=True)
    take.rename(shot / "moved.usda")
    with pytest.raises(InputError, match=r"its take, .*shot.clean.take.usda, is gone; give"):
        execute(named, overwrite=True)


def test_rows_that_do_not_fit_go_to_further_pages(shot: Shot) -> None:
    report = execute(spec_of(shot, layout="strip", rows=5, page_rows=2))
    assert [path.name for path in report.outputs] == ["new.png", "new.2.png", "new.3.png"]
    for path in report.outputs:
        assert read_image_metadata(path)["step"] == "sheet"
        pixels = oiio.ImageBuf(str(path)).get_pixels(oiio.UINT8)
        assert np.asarray(pixels).std() > 10


def test_further_pages_replace_their_own_alone(shot: Shot) -> None:
    sheet = spec_of(shot, layout="strip", rows=3, page_rows=1, quality="draft", tile=64)
    theirs = shot / "new.2.png"
    theirs.write_bytes(b"my drawing")
    with pytest.raises(
        InputError, match=r"new\.2\.png: exists, and would be replaced by a page of new\.png"
    ):
        execute(sheet)
    assert theirs.read_bytes() == b"my drawing"
    assert not (shot / "new.png").exists()
    theirs.unlink()
    execute(sheet)
    execute(sheet.model_copy(update={"out": shot / "new.4.png", "rows": 1}))  # a sheet of its own
    execute(sheet.model_copy(update={"page_rows": 2}), overwrite=True)
    pages = sorted(path.name for path in shot.folder.glob("new.*"))
    assert pages == ["new.2.png", "new.4.png", "new.png"]


def test_a_view_of_the_built_in_configuration_changes_light_as_it_says(monkeypatch) -> None:
    monkeypatch.delenv("OCIO", raising=False)
    ramp = np.linspace(0, 1, 48, dtype=np.float32).reshape(4, 4, 3)
    plain = display_view("sRGB - Display/Un-tone-mapped")(ramp)
    assert np.abs(plain.astype(int) - bytes_from_linear(ramp)).max() <= 1
    toned = display_view("ACES 2.0 - SDR 100 nits (Rec.709)")(ramp)
    assert np.abs(toned.astype(int) - plain).max() > 20


def test_a_view_that_is_not_there_is_refused_by_name(monkeypatch, tmp_path) -> None:
    monkeypatch.delenv("OCIO", raising=False)
    with pytest.raises(InputError, match=r"no view 'nope'; it has 'ACES"):
        display_view("nope")
    with pytest.raises(InputError, match="no display 'TV'"):
        display_view("TV/Raw")
    monkeypatch.setenv("OCIO", str(tmp_path / "none.ocio"))
    with pytest.raises(InputError, match=r"none\.ocio"):
        display_view("Raw")


def test_a_camera_of_the_shot_gives_the_picture_its_width_and_its_view(shot, monkeypatch) -> None:
    stage = Usd.Stage.CreateNew(str(shot / "cut 1.usda"))
    stage.GetRootLayer().subLayerPaths.append("./shot.hero.usda")
    UsdGeom.SetStageMetersPerUnit(stage, 0.01)
    stage.SetTimeCodesPerSecond(120)
    for name, focal in (("near", 60.0), ("far", 6.0), ("away", 60.0)):
        camera = UsdGeom.Camera.Define(stage, f"/{name}")
        camera.AddTranslateOp().Set(Gf.Vec3d(0, 3, 70))
        camera.CreateFocalLengthAttr(focal)
        camera.CreateHorizontalApertureAttr(36)
        camera.CreateVerticalApertureAttr(24)
        if name == "away":
            camera.AddRotateYOp().Set(180)
    stage.Save()
    pages = []
    compose = sheet_step.compose_sheet
    monkeypatch.setattr(
        sheet_step, "compose_sheet", lambda page: (pages.append(page), compose(page))[1]
    )
    notes = {}
    for name in ("near", "far", "away"):
        given = {"camera": f"/{name}", "camera_stage": shot / "cut 1.usda", "rows": 1}
        report = execute(spec_of(shot, out=shot / f"{name}.png", baseline=False, **given))
        notes[name] = report.notes
    assert notes["near"] == ()
    assert "% of the picture's height" in notes["far"][0]
    assert notes["away"] == ("/away does not see the face at frame 1",)
    near, far = (page.rows[0].tiles[-1].pixels for page in pages[:2])
    assert near.shape == far.shape == (64, 96, 3)
    assert "camera /near" in pages[0].facts
    wall = far[:, :20].astype(int)
    assert np.ptp(wall, axis=1).max() < 12, "the far face does not reach the side"
    assert near[20:44, 30:66].std() > 10
    with pytest.raises(InputError, match=r"no prim </none>; its cameras are </near>, </far>"):
        execute(spec_of(shot, camera="/none", camera_stage=shot / "cut 1.usda"), overwrite=True)


def write_phones(path: Path, spans: list[tuple[float, float, str]]) -> Path:
    rows = [{"start": a, "end": b, "label": label} for a, b, label in spans]
    path.write_text(json.dumps({"phones": rows}), encoding="utf-8")
    return path


def test_rows_tell_what_is_said_where_phones_are_known(shot: Shot, monkeypatch) -> None:
    pages = []
    compose = sheet_step.compose_sheet
    monkeypatch.setattr(
        sheet_step, "compose_sheet", lambda page: (pages.append(page), compose(page))[1]
    )
    phones = write_phones(shot / "x.json", [(0.0, 1.0, ""), (1.0, 2.0, "M"), (2.0, 3.0, "AA1")])
    execute(spec_of(shot, layout="strip", pick="even", rows=5, phones=phones, out=shot / "a.png"))
    # frames 1, 121, 241, 360 and 480 at 120 per second
    assert [row.spoken for row in pages[0].rows] == [
        "silent",
        "M  /b/ /p/ /m/",
        "AA  " + viseme_label(viseme_of("aa") or ""),
        "AA  " + viseme_label(viseme_of("aa") or ""),
        "",
    ]
    assert "phone and viseme" in " ".join(pages[0].notes)
    row = replace(pages[0].rows[1], tiles=(Tile(np.zeros((320, 560, 3), np.uint8)),))
    wide = replace(pages[0], rows=(row,), tile_height=320)
    mute = replace(wide, rows=(replace(row, spoken=""),))
    assert np.any(compose(wide) != compose(mute)), "the label is drawn"
    late = write_phones(shot / "y.json", [(0.0, 100.0, "M")])
    with pytest.raises(InputError, match=r"lasts 100.0 s and its take .* 4.0 s"):
        execute(spec_of(shot, phones=late), overwrite=True)
