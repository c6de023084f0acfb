"""Takes of weights, as phones record them, and files that moved after a performance was made."""

import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from pxr import Sdf

from tests.steps.review.test_report import give_video, spec_of
from tests.steps.small_shot import Shot
from usdface.core.assets import WeightsClip
from usdface.core.errors import InputError
from usdface.core.provenance import Provenance
from usdface.media.film.video import VideoReader
from usdface.media.picture.image import read_picture
from usdface.model.review.verdict import judge_solve
from usdface.runner.execute import execute
from usdface.specs.edits import BakeSpec, CombineSpec, EditSpec
from usdface.specs.performance import JoinSpec
from usdface.specs.references import (
    ReferencesAddSpec,
    ReferencesCoverageSpec,
    ReferencesFromEditsSpec,
)
from usdface.specs.review import EvaluateSpec, FacesSpec, MovieSpec, ReportSpec, SheetSpec
from usdface.steps.review.scoring import ShotMetric
from usdface.steps.review.shot import open_shot
from usdface.usdio.performance.read import PerformanceReader
from usdface.usdio.references.read import read_references
from usdface.usdio.take.read import read_take
from usdface.usdio.take.write import write_take

DRAFT = {"tile": 64, "rows": 1, "quality": "draft"}


def make_phone_take(shot: Shot, *, video: bool) -> None:
    """Replace the shot's take by one of weights alone."""
    if video:
        give_video(shot)
    path = shot / "shot.clean.take.usda"
    take = read_take(path)
    reader = PerformanceReader(shot / "shot.hero.usda")
    source = WeightsClip(reader.names, reader.solved(), reader.first_frame, reader.rate)
    for file in shot.folder.glob("shot.clean.take.*"):
        file.unlink()
    weights = replace(take, markers=None, head_motion=None, source=source)
    write_take(path, weights, provenance=Provenance())


@pytest.mark.parametrize("video", [pytest.param(True, marks=pytest.mark.slow), False])
def test_takes_of_weights_are_reviewed(shot: Shot, video: bool) -> None:
    make_phone_take(shot, video=video)
    hero = shot / "shot.hero.usda"
    reader = PerformanceReader(hero)
    jump = {"shape": ("mouthSmileLeft",), "add": 1.0, "frames": "200-200"}
    execute(EditSpec(performance=hero, **jump))
    sheet = execute(SheetSpec(performance=hero, out=shot / "phone.jpg", **DRAFT))
    assert sheet.figures["frames"]
    opened = open_shot(hero)
    nothing = {"uncertainty_mm": None, "coverage": None, "residual_mm": None, "regions": ()}
    opened = replace(opened, performance=replace(opened.performance, **nothing))
    moment = ShotMetric(opened).signals(None).moment(200 - reader.first_frame)
    assert moment.region == "mouth"
    assert moment.reason.startswith("jumps by")
    assert ("video" in judge_solve(opened.evidence()).advice) == video
    report = execute(
        ReportSpec(performance=hero, out=shot / "phone.html", frames="1-60", height=120)
    )
    text = (shot / "phone.html").read_text(encoding="utf-8")
    assert '"markers":null' in text
    assert ('"movie":""' in text) != video
    assert report.figures["pictures"] == 60
    movie = execute(
        MovieSpec(
            performance=hero, out=shot / "p.mp4", frames="1-24", height=64, rate=12, workers=1
        )
    )
    assert movie.figures["panels"] == (["video"] if video else []) + ["performance"]
    with VideoReader(shot / "p.mp4") as drawn:
        picture = drawn.frame_at(0.0)
    assert picture is not None
    assert picture.std() > 5, "nothing is drawn"
    with pytest.raises(InputError, match="has no markers to show"):
        execute(MovieSpec(performance=hero, out=shot / "m.mp4", panels=("markers",)))


def test_a_rig_that_moved_is_named_and_found_where_it_is_said_to_be(
    shot: Shot, tmp_path: Path
) -> None:
    hero, before = shot / "shot.hero.usda", PerformanceReader(shot / "shot.hero.usda").edited()
    (tmp_path / "rigs").mkdir()
    moved = Path(shutil.move(shot / "hero.usdc", tmp_path / "rigs" / "anders.usdc"))
    given = {"performance": hero, "out": shot / "x.jpg", **DRAFT}
    with pytest.raises(InputError, match=r"its rig, .*hero\.usdc, is gone;.* by --rig"):
        execute(SheetSpec(**given))
    execute(SheetSpec(**given, rig=moved))
    keys = {"against": shot / "keys.csv", "rig": moved}
    figures = execute(EvaluateSpec(performance=hero, out=(shot / "e.json",), **keys)).figures
    assert figures["weight_rmse"] < 0.2
    execute(BakeSpec(performance=hero, out=shot / "baked.usdc", rig=moved))
    np.testing.assert_allclose(PerformanceReader(shot / "baked.usdc").edited(), before, atol=1e-6)
    with pytest.raises(InputError, match="is gone"):  # it was said for one command
        execute(EvaluateSpec(performance=hero, against=shot / "keys.csv"))


def test_a_video_that_moved_is_named_and_found_where_it_is_said_to_be(shot: Shot) -> None:
    give_video(shot)
    moved = Path(shutil.move(shot / "camera.mp4", shot / "kamera 2.mp4"))
    with pytest.raises(InputError, match=r"its video, .*camera\.mp4, is gone;.* by --video"):
        execute(spec_of(shot, frames="1-24"))
    execute(spec_of(shot, frames="1-24", video=moved))
    assert '"movie":"video' in (shot / "shot.html").read_text(encoding="utf-8")


def test_every_command_whose_rig_moved_finds_it_or_names_one_that_does(
    shot: Shot, capfd: pytest.CaptureFixture[str]
) -> None:
    hero, out = shot / "shot.hero.usda", shot / "out"
    out.mkdir()
    faces = {"performances": (hero,), "rows": 1, "tile": 64, "quality": "draft"}
    joined = {"parts": (hero,), "out": out / "joined.usda"}
    covered = {
        "references": shot / "hero.references.usda",
        "takes": (shot / "shot.clean.take.usda",),
    }
    execute(FacesSpec(**faces, out=out / "before.png"))
    moved = Path(shutil.move(shot / "hero.usdc", out / "hero.usdc"))
    for spec in (
        FacesSpec(**faces, out=out / "x.png"),
        JoinSpec(**joined),
        ReferencesCoverageSpec(**covered, out=out / "x.png"),
    ):
        with pytest.raises(InputError, match=r"hero\.usdc.* say where it is by --rig"):
            execute(spec)
    with pytest.raises(InputError, match=r"hero\.usdc.*put it back, or .*usdface join .*--rig"):
        execute(CombineSpec(performances=(hero,), out=out / "takes.usda"))
    with pytest.raises(InputError, match="--rig names 2 rigs for 1 performances"):
        execute(FacesSpec(**faces, out=out / "x.png", rig=(moved,) * 2))
    execute(FacesSpec(**faces, out=out / "after.png", rig=(moved,)))
    np.testing.assert_array_equal(read_picture(out / "after.png"), read_picture(out / "before.png"))
    execute(ReferencesCoverageSpec(**covered, out=out / "x.png", rig=moved))
    execute(JoinSpec(**joined, rig=moved))
    assert PerformanceReader(out / "joined.usda").rig()[0].resolve() == moved.resolve()
    execute(CombineSpec(performances=(out / "joined.usda",), out=out / "takes.usda"))
    capfd.readouterr()
    execute(SheetSpec(performance=hero, out=shot / "x.jpg", rig=moved, **DRAFT))
    execute(EditSpec(performance=hero, shape=("jawOpen",), frames="10-20", add=0.2))
    assert capfd.readouterr().err == "", "USD's own warnings are no words of ours"


def test_a_take_that_moved_is_named_and_found_where_it_is_said_to_be(shot: Shot) -> None:
    hero, references = shot / "shot.hero.usda", shot / "hero.references.usda"
    execute(EditSpec(performance=hero, shape=("jawOpen",), frames="100-130", add=0.3))
    steps = {
        ReferencesAddSpec: {"performance": hero, "references": references, "frames": "301"},
        ReferencesFromEditsSpec: {"performances": (hero,), "references": references},
    }
    before = {}
    for number, (spec, given) in enumerate(steps.items()):
        execute(spec(**given, out=shot / f"before{number}.references.usda"))
        before[spec] = read_references(shot / f"before{number}.references.usda")
    (shot / "hero.mapping.usdc").unlink()
    moved = Path(shutil.move(shot / "shot.clean.take.usda", shot / "moved.take.usda"))
    for number, (spec, given) in enumerate(steps.items()):
        out = shot / f"after{number}.references.usda"
        with pytest.raises(InputError, match=r"its take, .*, is gone;.* by --take"):
            execute(spec(**given, out=out))
        execute(spec(**given, take=(moved,) if number else moved, out=out))
        np.testing.assert_array_equal(read_references(out).markers, before[spec].markers)
    learned = steps[ReferencesFromEditsSpec] | {"take": (moved,) * 2}
    with pytest.raises(InputError, match="--take names 2 takes for 1 performances"):
        execute(ReferencesFromEditsSpec(**learned, out=shot / "x.references.usda"))


def test_a_version_that_was_moved_in_time_is_not_compared(shot: Shot) -> None:
    hero, moved = (Sdf.Layer.FindOrOpen(str(shot / "shot.hero.usda")), shot / "moved.usda")
    layer = Sdf.Layer.CreateNew(str(moved))
    layer.subLayerPaths = ["./shot.hero.usda"]
    layer.subLayerOffsets[0] = Sdf.LayerOffset(40)
    layer.timeCodesPerSecond, layer.defaultPrim = hero.timeCodesPerSecond, hero.defaultPrim
    layer.Save()
    with pytest.raises(InputError, match=r"moved\.usda: a layer moves its weights by \+40 frames"):
        execute(spec_of(shot, also=(moved,), worst=2))
