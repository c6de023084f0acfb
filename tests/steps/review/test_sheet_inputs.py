"""Videos that end early or are damaged, and sheets of more tiles than memory would hold."""

import weakref

import numpy as np
import pytest

from tests.media.bar_code import turn_in_header
from tests.steps.review.test_report import give_video
from tests.steps.small_shot import FRAMES, Shot
from usdface.core.errors import InputError
from usdface.media.film.video import VideoReader
from usdface.media.picture.image import read_picture
from usdface.media.picture.sheet import Tile
from usdface.runner.execute import execute
from usdface.specs.edits import EditSpec
from usdface.specs.performance import MapSpec
from usdface.specs.review import SheetSpec
from usdface.steps.review.pictures import ShotPictures
from usdface.steps.review.shot import open_shot


def pictures_of(shot: Shot) -> ShotPictures:
    opened = open_shot(shot / "shot.hero.usda", shot / "shot.clean.take.usda")
    return ShotPictures(opened, height=64, quality="draft")


def test_tiles_without_video_say_why(shot: Shot, monkeypatch: pytest.MonkeyPatch) -> None:
    with pictures_of(shot) as drawn:
        assert drawn.video(1) == Tile(None, caption="no video")
    give_video(shot, pictures=40)  # 1.6 s, begun 0.2 s before a take of 4 s
    with pictures_of(shot) as drawn:
        assert drawn.video(120).pixels is not None
        assert drawn.video(300) == Tile(None, caption="no video here")

        def damaged(self: VideoReader, seconds: float) -> np.ndarray:
            raise InputError("camera.mp4: cannot be decoded here")

        monkeypatch.setattr(VideoReader, "frame_at", damaged)
        assert drawn.video(120) == Tile(None, caption="cannot be decoded")


def test_a_video_whose_picture_begins_after_time_0_has_its_aspect(
    shot: Shot, monkeypatch: pytest.MonkeyPatch
) -> None:
    give_video(shot)
    turn_in_header(shot / "camera.mp4")
    monkeypatch.setattr(VideoReader, "index_at", lambda self, seconds: None)
    with pictures_of(shot) as drawn:
        assert drawn.video_aspect == 9 / 16


@pytest.mark.slow
def test_ten_thousand_tiles_are_drawn_page_by_page(shot: Shot, monkeypatch) -> None:
    made: list[weakref.ref[np.ndarray]] = []
    most = 0

    def draw(self: ShotPictures, row: int, weights: np.ndarray) -> np.ndarray:
        nonlocal most
        picture = np.full((64, 64, 3), 90, np.uint8)
        made.append(weakref.ref(picture))
        most = max(most, sum(each() is not None for each in made[-200:]))
        return picture

    monkeypatch.setattr(ShotPictures, "face", draw)
    blank = np.zeros((64, 64, 3), "u1")
    monkeypatch.setattr(ShotPictures, "markers_on_face", lambda self, row, equation: blank)
    report = execute(
        SheetSpec(
            performance=shot / "shot.hero.usda",
            take=shot / "shot.clean.take.usda",
            out=shot / "all.jpg",
            layout="worst",
            pick="residual",
            difference=False,
            frames="101-250",
            rows=10_000,
            page_rows=50,
            tile=64,
            baseline=False,
        )
    )
    # As many rows as there are frames, whatever is asked for.
    assert len(report.figures["frames"]) == len(made) == 150
    assert len(report.outputs) == 3
    assert most <= 101, "a page and the one before it, not all of them"


@pytest.mark.slow
def test_performances_of_one_name_have_an_error_each(shot: Shot) -> None:
    (shot / "b").mkdir()
    other = shot / "b/shot.hero.usda"
    execute(
        MapSpec(
            take=shot / "shot.clean.take.usda",
            mapping=shot / "hero.mapping.usdc",
            rig=shot / "hero.usdc",
            out=other,
            frames="1-120",
        )
    )
    execute(EditSpec(performance=other, shape=("jawOpen",), add=0.3))
    report = execute(
        SheetSpec(
            performance=shot / "shot.hero.usda",
            take=shot / "shot.clean.take.usda",
            also=(other, shot / "shot.hero.usda", shot / "shot.hero.usda"),
            out=shot / "all.jpg",
            against=shot / "keys.csv",
            rows=1,
            tile=64,
            quality="draft",
            baseline=False,
        )
    )
    means = report.figures["mean_error_mm"]
    folder = shot.folder.name
    same = ("usdface", f"{folder}/shot.hero", f"{folder}/shot.hero_2")
    assert list(means) == ["usdface", "b/shot.hero", *same[1:]]
    assert means["b/shot.hero"] > 2 * means["usdface"]
    assert {means[name] for name in same} == {means["usdface"]}
    assert f"b/shot.hero {means['b/shot.hero']:.2f} mm" in report.summary


def test_shapes_that_the_keys_lack_are_named_as_they_count_as_0(shot: Shot) -> None:
    lines = ["frame,jawOpen,wiggle", *(f"{frame},0.5,0" for frame in range(1, FRAMES + 1))]
    (shot / "jaw.csv").write_text("\n".join(lines))
    spec = SheetSpec(
        performance=shot / "shot.hero.usda",
        out=shot / "jaw.png",
        against=shot / "jaw.csv",
        rows=1,
        tile=64,
        quality="draft",
        baseline=False,
    )
    notes = execute(spec).notes
    assert any("left out 1 column of" in note and "wiggle" in note for note in notes)
    assert any("jaw.csv lacks" in note and "taken as 0" in note for note in notes)


def test_several_threads_draw_the_sheet_that_one_draws(shot: Shot, monkeypatch) -> None:
    def draw(cores: int) -> bytes:
        monkeypatch.setattr("usdface.steps.review.sheet.usable_cores", lambda: cores)
        out = shot / f"{cores}.png"
        given = {"performance": shot / "shot.hero.usda", "rows": 3, "tile": 64, "quality": "draft"}
        execute(SheetSpec(**given, out=out))
        return read_picture(out).tobytes()

    assert draw(2) == draw(1)


def test_a_sheet_that_is_given_up_draws_no_further_tile(shot: Shot, monkeypatch) -> None:
    drawn = list[int]()

    def draw(
        self: ShotPictures, row: int, weights: np.ndarray, *, still: bool = False
    ) -> np.ndarray:
        drawn.append(row)
        raise KeyboardInterrupt

    monkeypatch.setattr(ShotPictures, "face", draw)
    spec = SheetSpec(performance=shot / "shot.hero.usda", out=shot / "s.png", rows=12, tile=64)
    with pytest.raises(KeyboardInterrupt):
        execute(spec)
    assert len(drawn) <= 4, "one that each thread had begun, and one more each"
    assert not spec.out.exists()
