"""Face and video are one view: the head turns as the performer's does."""

from dataclasses import replace
from fractions import Fraction
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tests.browser import evaluate_array
from tests.steps.review.test_report import give_video, open_page
from tests.steps.small_shot import Shot
from usdface.core.assets import Take, WeightsClip
from usdface.core.provenance import Provenance
from usdface.demo.acting import performance
from usdface.runner.execute import execute
from usdface.specs.retarget import RetargetSpec
from usdface.specs.review import MovieSpec, ReportSpec, SheetSpec
from usdface.steps.review.head_turn import with_video_head_turn
from usdface.steps.review.pictures import ShotPictures
from usdface.steps.review.shot import open_shot
from usdface.usdio.rig.rig_motion import RigMotion
from usdface.usdio.take.write import write_take

TURNED = 347
"""A frame in which the demo's actor has turned his head by ten degrees."""


def degrees_between(one: np.ndarray, other: np.ndarray) -> float:
    return float(np.degrees(Rotation.from_matrix(one.T @ other).magnitude()))


def test_the_head_turns_as_the_actors_since_the_neutral_frame(shot: Shot) -> None:
    give_video(shot)
    opened = open_shot(shot / "shot.hero.usda")
    motion = with_video_head_turn(opened, "auto").motion
    assert motion is not None
    acted = performance()
    angles = acted.rotation[:, [1, 0, 2]]
    turns = Rotation.from_euler("YXZ", angles, degrees=True).as_matrix()
    neutral = turns[acted.neutral_frame - 1]
    for frame in (60, 203, TURNED, 470):
        turn = motion.transforms(frame)[0, :3, :3]
        expected = neutral.T @ turns[frame - 1]
        assert degrees_between(turn, expected) < 1.5
    assert degrees_between(motion.transforms(TURNED)[0, :3, :3], np.eye(3)) > 8


def test_without_video_or_from_the_front_or_by_a_camera_the_head_is_still(shot: Shot) -> None:
    still = open_shot(shot / "shot.hero.usda")
    assert with_video_head_turn(still, "auto").motion is None
    give_video(shot)
    opened = open_shot(shot / "shot.hero.usda")
    assert with_video_head_turn(opened, "front").motion is None
    assert with_video_head_turn(opened, "/Cut/main").motion is None
    (shot / "hero.references.placement.usda").unlink()  # how the performer lies is not known
    assert with_video_head_turn(opened, "auto").motion is None


def test_a_rig_whose_joints_move_is_not_turned_twice(shot: Shot) -> None:
    give_video(shot)
    opened = open_shot(shot / "shot.hero.usda")
    moving = RigMotion(opened.performance_file, opened.rig)
    assert with_video_head_turn(replace(opened, motion=moving), "auto").motion is moving


def test_markers_stay_on_the_face_that_turns(shot: Shot) -> None:
    from usdface.steps.review.scoring import set_up_shot_baseline

    give_video(shot)
    opened = with_video_head_turn(open_shot(shot / "shot.hero.usda"), "auto")
    equation = set_up_shot_baseline(opened)
    row = TURNED - int(opened.frames[0])
    with ShotPictures(opened, height=160, quality="draft") as pictures:
        bare = pictures.face(row, opened.weights[row])
        marked = pictures.markers_on_face(row, equation)
    dots = (marked != bare).any(axis=2)
    assert 0.01 < dots.mean() < 0.15, "dots and lines alone differ"
    sky = (bare == bare[0, 0]).all(axis=2)  # what is beside the head
    assert not (dots & sky).any()


def test_sheet_report_and_movie_turn_it(shot: Shot) -> None:
    give_video(shot)
    drawn = {}
    for camera in ("auto", "front"):
        given = {"performance": shot / "shot.hero.usda", "camera": camera}
        out = shot / f"{camera}.png"
        small = {"frames": str(TURNED), "tile": 64, "quality": "draft", "baseline": False}
        execute(SheetSpec(**given, **small, out=out))
        page, film = shot / f"{camera}.html", shot / f"{camera}.mp4"
        execute(ReportSpec(**given, out=page, frames="340-350", height=120, baseline=False))
        frames = f"{TURNED}-{TURNED + 11}"
        execute(MovieSpec(**given, out=film, frames=frames, height=64, rate=10, workers=1))
        text = page.read_text(encoding="utf-8")
        drawn[camera] = (out.read_bytes(), '"transforms":true' in text, film.read_bytes())
    auto, front = drawn["auto"], drawn["front"]
    assert auto[1]
    assert not front[1]
    assert auto[0] != front[0]
    assert auto[2] != front[2]


@pytest.mark.parametrize("channel", ["HeadYaw", "jawOpen"])
def test_a_phones_channels_turn_it_without_markers(shot: Shot, channel: str) -> None:
    values = np.stack([np.linspace(0, 0.5, 60), np.linspace(0, 1, 60)], axis=1)
    source = WeightsClip((channel, "smile"), values.astype(np.float32), 1, Fraction(30))
    give_video(shot)
    video = open_shot(shot / "shot.hero.usda").take.video
    take = Take("phone", Fraction(30), 1, source=source, video=video)
    write_take(shot / "phone.take.usda", take, provenance=Provenance())
    out = shot / "phone.hero.usda"
    names = shot / "names.csv"
    names.write_text("source,target\njawOpen,jawOpen\nsmile,mouthSmileLeft\n", encoding="utf-8")
    execute(
        RetargetSpec(
            source=shot / "phone.take.usda", rig=(shot / "hero.usdc",), names=names, out=(out,)
        )
    )
    motion = with_video_head_turn(open_shot(out), "auto").motion
    if channel != "HeadYaw":
        assert motion is None
        return
    assert motion is not None
    forward = motion.transforms(60)[0, :3, :3] @ np.array([0.0, 0.0, 1.0])
    assert np.arctan2(abs(forward[0]), forward[2]) == pytest.approx(0.5, abs=1e-5)


@pytest.mark.slow
def test_markers_of_the_report_turn_with_the_head(shot: Shot, browser: Any) -> None:
    give_video(shot)
    frames = f"{TURNED - 5}-{TURNED + 5}"
    out = shot / "turned.html"
    given = {"performance": shot / "shot.hero.usda", "frames": frames, "baseline": False}
    execute(ReportSpec(**given, out=out, height=120))
    opened = with_video_head_turn(open_shot(shot / "shot.hero.usda"), "auto")
    assert opened.motion is not None
    turn = opened.motion.transforms(TURNED)[0]
    faults: list[str] = []
    page = open_page(browser, out, faults)
    page.evaluate("report.show(5)")
    seen = {}
    page.click("#markers")
    for head in (True, False):
        page.set_checked("#head", head)
        marks = {
            name: evaluate_array(page, f"() => Float32Array.from(report.viewer.marks.{name})")
            for name in ("points", "targets")
        }
        skin = evaluate_array(
            page, "() => { report.viewer.draw(); return report.viewer.face.positions; }"
        )
        seen[head] = {
            name: np.array(values, np.float64).reshape(-1, 3)
            for name, values in {**marks, "skin": skin}.items()
        }
    page.close()
    assert not faults
    for name, still in seen[False].items():
        turned = still @ turn[:3, :3].T + turn[:3, 3]
        np.testing.assert_allclose(seen[True][name], turned, atol=0.02)
        assert np.nanmax(np.abs(turned - still)) > 5


@pytest.mark.slow
def test_a_page_with_moving_joints_says_that_markers_hold_the_head_still(
    shot: Shot, browser: Any
) -> None:
    give_video(shot)
    out = shot / "turned.html"
    execute(ReportSpec(performance=shot / "shot.hero.usda", out=out, frames="1-9", baseline=False))
    text = out.read_text(encoding="utf-8")
    assert '"movesAsOne":true' in text
    out.write_text(text.replace('"movesAsOne":true', '"movesAsOne":false'), encoding="utf-8")
    page = open_page(browser, out, [])
    assert page.is_enabled("#head")
    page.click("#markers")
    assert page.is_disabled("#head")
    assert page.evaluate("report.viewer.face.transforms") is None
    page.close()
