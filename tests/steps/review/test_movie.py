"""Review movies: the right frame at the right time, resumable, the same in parts."""

import json
import sys
import tracemalloc
from dataclasses import replace
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest

from tests.media.bar_code import read_number
from tests.media.film.stated_movie import write_stated_movie
from tests.steps.review.test_report import EARLY_PICTURES, give_video
from tests.steps.small_shot import Shot
from usdface.core.assets import Take, Video
from usdface.core.errors import InputError
from usdface.core.provenance import Provenance
from usdface.core.sidecars import work_folder
from usdface.farm.plan import in_chunks
from usdface.media.film.movie import read_movie_comment, write_movie
from usdface.media.film.movie_frame import MoviePanel, compose_movie_frame, movie_size
from usdface.media.film.video import VideoReader
from usdface.runner.execute import execute
from usdface.specs.commands import SubmitSpec
from usdface.specs.review import MovieJoinSpec, MovieSpec
from usdface.steps.review import movie as movie_step
from usdface.steps.review.clock import (
    SAMPLE_RATE,
    MovieClock,
    movie_rate,
    sound_between,
    take_sound,
)


def spec_of(shot: Shot, name: str, **options: object) -> MovieSpec:
    given = {"frames": "20-79", "height": 64, "workers": 1} | options
    return MovieSpec(
        performance=shot / "shot.hero.usda",
        take=shot / "shot.clean.take.usda",
        out=shot / name,
        **given,
    )


def pictures_of(path: Path) -> np.ndarray:
    with VideoReader(path) as movie:
        return np.array([movie.frame(index) for index in range(len(movie.times))])


def test_a_movie_has_the_length_the_rate_and_the_timecode_of_its_frames(shot: Shot) -> None:
    report = execute(spec_of(shot, "review.mp4", frames="20-49"))
    assert report.figures["pictures"] == 15  # 30 frames at 120, shown at 60
    with VideoReader(shot / "review.mp4") as movie:
        assert movie.rate == 60
        assert movie.timecode == "01:00:00:04"  # 19 frames on, at 4 frames a label
        assert (movie.width, movie.height) == movie_size([64, 64], 64)
        first = movie.frame(0)
    assert first[:64, 66:].std() > 20, "there is no face"
    said = json.loads(read_movie_comment(shot / "review.mp4"))
    assert said["step"] == "movie"
    assert (said["rate"], said["first_frame"], said["pictures"]) == ("60", 20, 15)
    assert "the take has no video" in report.notes[0]


def test_a_stopped_run_goes_on_where_it_stopped(shot: Shot, monkeypatch) -> None:
    monkeypatch.setattr(movie_step, "STRETCH_PICTURES", 3)
    drawn: list[int] = []
    draw = movie_step._draw_stretch

    def stop_at_the_third(studio, stretch) -> None:
        if len(drawn) == 2:
            raise KeyboardInterrupt
        drawn.append(stretch.start)
        draw(studio, stretch)

    monkeypatch.setattr(movie_step, "_draw_stretch", stop_at_the_third)
    with pytest.raises(KeyboardInterrupt):
        execute(spec_of(shot, "review.mp4", frames="20-37"))
    assert not (shot / "review.mp4").exists()
    monkeypatch.setattr(movie_step, "_draw_stretch", draw)
    report = execute(spec_of(shot, "review.mp4", frames="20-37"))
    assert "resumed: 2 of 3 stretches were drawn before" in report.notes
    execute(spec_of(shot, "again.mp4", frames="20-37"))
    np.testing.assert_array_equal(pictures_of(shot / "review.mp4"), pictures_of(shot / "again.mp4"))
    assert not list(shot.folder.glob(".*.stretches"))


def test_parts_joined_are_the_whole(shot: Shot) -> None:
    execute(spec_of(shot, "whole.mp4", frames="20-39"))
    parts = []
    for number, frames in enumerate(("20-29", "30-39")):
        execute(spec_of(shot, f"part{number}.mp4", frames=frames))
        parts.append(shot / f"part{number}.mp4")
    join = MovieJoinSpec(
        parts=tuple(parts), take=shot / "shot.clean.take.usda", out=shot / "joined.mp4"
    )
    assert execute(join).figures["pictures"] == 10
    whole, joined = pictures_of(shot / "whole.mp4"), pictures_of(shot / "joined.mp4")
    np.testing.assert_array_equal(joined, whole)
    with pytest.raises(InputError, match=r"begins at frame 20, before"):
        execute(join.model_copy(update={"parts": tuple(reversed(parts))}), overwrite=True)


def part_of(folder: Path, first: int, last: int, take_rate: int = 120, rate: int = 24) -> Path:
    """A part of one grey picture after another, with what `usdface movie` says of it."""
    clock = MovieClock(Fraction(rate), Fraction(take_rate), first, last - first + 1)
    said = {"rate": str(rate), "first_frame": first, "pictures": clock.picture_count}
    path = folder / f"{first}-{last}.mp4"
    pictures = [np.full((16, 16, 3), 99, np.uint8)] * clock.picture_count
    write_stated_movie(path, pictures, rate=Fraction(rate), comment=json.dumps(said))
    return path


@pytest.mark.parametrize(
    ("frames", "what"),
    [
        (((101, 200), (301, 400)), "ends with frame 200: frames 201-300 would be in no part"),
        (((101, 240), (200, 300)), "ends with frame 240: frames 200-240 would be in both parts"),
    ],
)
def test_parts_that_leave_frames_out_or_show_them_twice_are_refused(
    shot: Shot, frames: tuple[tuple[int, int], ...], what: str
) -> None:
    parts = tuple(part_of(shot.folder, *each) for each in frames)
    join = MovieJoinSpec(parts=parts, take=shot / "shot.clean.take.usda", out=shot / "joined.mp4")
    with pytest.raises(InputError, match=what):
        execute(join)
    silent = execute(join.model_copy(update={"take": None}))  # without a rate nobody knows
    assert "no search for missing frames" in silent.notes[0]


@pytest.mark.parametrize("size", [24, 31])
def test_parts_as_a_farm_makes_them_are_joined_whatever_their_size(shot: Shot, size: int) -> None:
    movie, take = spec_of(shot, "joined.mp4", rate=24), shot / "shot.clean.take.usda"
    submit = SubmitSpec(job=Path("j"), movie_chunk=size)
    *chunks, join = in_chunks(movie, submit, (20, 140), take=take)
    assert isinstance(join, MovieJoinSpec)
    for chunk in chunks:
        first, last = map(int, str(chunk.frames).split("-"))
        made = part_of(shot.folder, first, last)
        chunk.out.parent.mkdir(exist_ok=True)
        made.rename(chunk.out)
    execute(join)
    more = part_of(shot.folder, 141, 200)  # what was joined may be a part again
    execute(join.model_copy(update={"parts": (join.out, more), "out": shot / "all.mp4"}))


@pytest.mark.parametrize("size", [24, 29, 31, 3])
def test_pictures_and_sound_of_parts_stay_together_however_many_there_are(
    shot: Shot, size: int
) -> None:
    """Parts that are no whole number of pictures long end in one that lasts too long."""
    firsts = list(range(1, 241, size))
    parts = [part_of(shot.folder, first, min(first + size - 1, 240)) for first in firsts]
    parts = [part.rename(shot / f"{size}.{number}.mp4") for number, part in enumerate(parts)]
    join = MovieJoinSpec(
        parts=tuple(parts), take=shot / "shot.clean.take.usda", out=shot / "joined.mp4"
    )
    report = execute(join)
    assert abs(report.figures["pictures"] - 240 * 24 / 120) <= 1
    assert ("left out" in " ".join(report.notes)) == (size % 5 != 0)


def test_the_timecode_burnt_in_is_that_of_the_file(shot: Shot, monkeypatch) -> None:
    burnt: list[str] = []
    compose = movie_step.compose_movie_frame

    def keep(*given, clock: str, **more):
        burnt.append(clock)
        return compose(*given, clock=clock, **more)

    monkeypatch.setattr(movie_step, "compose_movie_frame", keep)
    execute(spec_of(shot, "film.mp4", rate=24, frames="100-160"))
    with VideoReader(shot / "film.mp4") as movie:
        assert movie.timecode == "01:00:00:19"  # 99 frames at 120
    assert burnt[:2] == ["01:00:00:19  100", "01:00:00:20  105"]
    assert burnt[-1] == "01:00:01:07  160"
    execute(spec_of(shot, "odd.mp4", rate=31, frames="100-110"))
    assert burnt[-3] == "01:00:00:24  100"  # a rate without labels: the take's own


@pytest.mark.slow
def test_two_processes_draw_what_one_draws(shot: Shot) -> None:
    execute(spec_of(shot, "one.mp4", frames="20-33"))
    execute(spec_of(shot, "two.mp4", frames="20-33", workers=2))
    np.testing.assert_array_equal(pictures_of(shot / "two.mp4"), pictures_of(shot / "one.mp4"))


def test_another_programs_python_starts_no_process(shot: Shot, monkeypatch) -> None:
    """Publish hooks draw movies inside DCCs, where a new process would be another DCC."""
    monkeypatch.setattr(movie_step, "worker_processes", lambda *_: pytest.fail("a pool"))
    monkeypatch.setattr(sys, "orig_argv", ["/opt/maya/bin/maya.bin"])
    execute(spec_of(shot, "dcc.mp4", frames="20-33", workers=2))
    assert len(pictures_of(shot / "dcc.mp4")) == 7


@pytest.mark.parametrize("workers", [1, 2, 5])
@pytest.mark.parametrize("last", [20, 33, 120, 2000])
def test_every_process_draws_as_much(shot: Shot, workers: int, last: int) -> None:
    spec = spec_of(shot, "cut.mp4")
    clock = MovieClock(Fraction(60), Fraction(120), first_frame=20, frame_count=last - 19)
    cut = movie_step._stretches(spec, clock, shot.folder, Provenance("movie"), workers)
    sizes = [stretch.stop - stretch.start for stretch in cut]
    assert [stretch.start for stretch in cut] == list(np.cumsum([0, *sizes[:-1]]))
    assert sum(sizes) == clock.picture_count
    assert max(sizes) <= movie_step.STRETCH_PICTURES
    busiest = sum(sizes[::workers])
    assert busiest <= clock.picture_count / workers + len(sizes[::workers])


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"panels": ("video", "performance")}, "has no video to show"),
        ({"frames": "9000-9100"}, "has no frame in 9000-9100; choose some of "),
    ],
)
def test_what_cannot_be_shown_is_said(shot: Shot, change, message) -> None:
    with pytest.raises(InputError, match=message):
        execute(spec_of(shot, "review.mp4", **change))
    assert not (shot / "review.mp4").exists()


def test_a_movie_that_somebody_else_made_is_not_replaced(shot: Shot) -> None:
    (shot / "review.mp4").write_bytes(b"an edit by hand")
    with pytest.raises(InputError, match="was not written by usdface"):
        execute(spec_of(shot, "review.mp4"))
    assert (shot / "review.mp4").read_bytes() == b"an edit by hand"


@pytest.mark.parametrize("rate", [Fraction(24000, 1001), Fraction(25), Fraction(60), Fraction(120)])
def test_each_picture_shows_the_frame_nearest_its_moment(rate: Fraction) -> None:
    clock = MovieClock(rate=rate, take_rate=Fraction(120), first_frame=7, frame_count=997)
    rows = np.array([clock.row(picture) for picture in range(clock.picture_count)])
    moments = np.arange(clock.picture_count) / float(rate)
    nearest = np.abs(np.arange(997)[None] / 120 - moments[:, None]).min(axis=1)
    np.testing.assert_allclose(np.abs(rows / 120 - moments), nearest, atol=1e-12)
    assert abs(clock.picture_count / float(rate) - 997 / 120) <= 1 / float(rate)


def test_no_picture_of_a_camera_is_missed_or_shown_twice(shot: Shot, monkeypatch) -> None:
    give_video(shot)
    seen: list[int] = []
    compose = movie_step.compose_movie_frame

    def keep(panels, **more):
        seen.append(read_number(panels[0].pixels))
        return compose(panels, **more)

    monkeypatch.setattr(movie_step, "compose_movie_frame", keep)
    execute(spec_of(shot, "review.mp4", frames="1-240", panels=("video",)))
    # the capture has 120 frames a second
    assert seen == list(range(EARLY_PICTURES, EARLY_PICTURES + 50))


@pytest.mark.parametrize(
    ("take_rate", "rate", "start", "label"),
    [
        (Fraction(60), Fraction(30000, 1001), "10:00:00:00", ""),  # was 09:59:24:01
        (Fraction(120000, 1001), Fraction(24), "01:00:00:00", ""),
        (Fraction(60000, 1001), Fraction(30000, 1001), "01:00:00;00", "01:00:00;00"),
        (Fraction(30000, 1001), Fraction(24000, 1001), "01:00:00:00", "01:00:00:00"),
        (Fraction(120), Fraction(25), "01:00:00:00", "01:00:00:00"),
    ],
)
def test_a_movie_has_timecode_only_if_its_labels_count_the_takes_seconds(
    take_rate: Fraction, rate: Fraction, start: str, label: str
) -> None:
    clock = MovieClock(rate, take_rate, first_frame=1, frame_count=10)
    assert clock.timecode(start, 1) == label


def test_a_fast_capture_without_video_is_shown_at_a_rate_of_screens() -> None:
    take = Take("talk", Fraction(120000, 1001), 1)
    assert movie_rate(take) == Fraction(60000, 1001)
    camera = Video(Path("a.mov"), rate=Fraction(25))
    assert movie_rate(replace(take, video=camera)) == 25


def test_the_cameras_sound_is_put_on_the_takes_clock(tmp_path: Path) -> None:

    click = np.zeros(SAMPLE_RATE * 4, np.float32)
    click[SAMPLE_RATE * 2 : SAMPLE_RATE * 2 + 96] = 0.9
    still = [np.zeros((32, 32, 3), np.uint8)] * 100
    write_movie(tmp_path / "cam.mkv", still, rate=Fraction(25), audio=click)
    camera = Video(tmp_path / "cam.mkv", offset=-0.5, drift=0.0)
    take = Take("talk", Fraction(120), 11, video=camera)
    clock = MovieClock(
        rate=Fraction(60), take_rate=Fraction(120), first_frame=11 + 60, frame_count=240
    )
    heard = take_sound(take, clock, [])
    assert heard is not None
    assert len(heard) == 2 * SAMPLE_RATE
    # second 2 of the camera is second 1.5 of the take and second 1.0 of this movie
    assert abs(int(np.abs(heard).argmax()) / SAMPLE_RATE - 1.0) < 0.025


def test_the_sound_of_a_part_takes_the_memory_of_the_part(monkeypatch) -> None:
    monkeypatch.setattr("usdface.steps.review.clock._BLOCK_SAMPLES", 1000)
    recorded = np.random.default_rng(0).normal(size=2_000_000).astype(np.float32)
    take = Take("talk", Fraction(120), 1, video=Video(Path("a.mov"), offset=-0.5, drift=40.0))
    for first in (0.0, -2.0, 39.5):  # the video ends at 41.2 s
        tracemalloc.start()
        heard = sound_between(take, recorded, first, first + 2.0)
        assert tracemalloc.get_traced_memory()[1] < 1_000_000  # [bytes] 0.4 of them the result
        tracemalloc.stop()
        at = take.video.video_time(first + np.arange(len(heard)) / SAMPLE_RATE) * SAMPLE_RATE
        whole = np.interp(at, np.arange(len(recorded)), recorded, left=0.0, right=0.0)
        np.testing.assert_allclose(heard, whole, atol=1e-6)


def test_a_frame_of_a_movie_keeps_its_size_whatever_is_missing() -> None:
    wide, height = movie_size([160, 91], 91)
    grey = np.full((50, 80, 3), 90, np.uint8)
    for pixels in (grey, None):
        panels = [MoviePanel(160, pixels, "video", "no video here"), MoviePanel(91, grey, "face")]
        made = compose_movie_frame(
            panels, height=91, title="a " * 200, clock="01:00:00:00 7", uncertainty=(0.4, 3.0)
        )
        assert made.shape == (height, wide, 3)
        assert made[92:].max() > 200  # there are letters


@pytest.mark.parametrize("width", [400, 300, 220, 120])
def test_the_uncertainty_of_a_narrow_movie_is_no_part_of_its_digits(
    width: int, monkeypatch
) -> None:
    """At 128 pixels, 1.00 was drawn as 00."""
    drawn: list[str] = []
    monkeypatch.setattr(
        "usdface.media.picture.text._cut", lambda text, kept: drawn.append(text) or ""
    )
    panels = [MoviePanel(width, np.full((128, 128, 3), 90, np.uint8), "face")]
    compose_movie_frame(
        panels, height=128, title="", clock="01:00:00:00  7", uncertainty=(1.0, 3.0)
    )
    assert not [text for text in drawn if "uncertainty" in text or "1.00" in text]


def test_movies_of_like_names_share_no_stretches(tmp_path: Path) -> None:
    names = ["a.mp4", "a.webm", *(f"{'long' * 30}.{number:04}.mp4" for number in (1, 2))]
    folders = {work_folder(tmp_path / name, "stretches") for name in names}
    assert len(folders) == 4
    assert all(len(each.name) < 100 for each in folders)
