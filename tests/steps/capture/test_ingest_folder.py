"""A folder of captures becomes a folder of takes."""

import shutil

import numpy as np
import pytest

from tests.steps.small_shot import Shot
from usdface.cli import main
from usdface.core.errors import CheckFailedError, InputError
from usdface.media.film.movie import write_movie
from usdface.specs.capture import IngestSpec
from usdface.steps.capture.ingest_folder import find_bundles, ingest_folder
from usdface.usdio.take.read import read_take


@pytest.fixture
def captures(shot: Shot):
    folder = shot / "captures"
    folder.mkdir()
    for name in ("a 01", "b"):
        shutil.copy(shot / "shot.c3d", folder / f"{name}.c3d")
    frames = [np.full((32, 32, 3), shade, np.uint8) for shade in range(24)]
    write_movie(folder / "b.mp4", frames, rate=24)
    (folder / "notes.txt").write_text("not a capture")
    return folder


def options(shot: Shot) -> IngestSpec:
    return IngestSpec(sources=("x",), out="x.usda", rigid=shot.rigid, neutral=shot.neutral)


def test_files_of_one_stem_belong_together(captures) -> None:
    assert [(each.name, each.video is not None) for each in find_bundles(captures)] == [
        ("a 01", False),
        ("b", True),
    ]


def test_every_take_is_ingested_and_named(captures, shot: Shot, monkeypatch, capsys) -> None:
    monkeypatch.chdir(shot.folder)
    with pytest.raises(SystemExit) as stopped:
        main(["ingest", "captures", "--out", "takes", "--neutral", str(shot.neutral)])
    assert not stopped.value.code
    assert "2 takes of captures" in capsys.readouterr().out
    take = read_take(shot / "takes" / "b.take.usda")
    assert (take.name, take.markers.neutral_frame) == ("b", shot.neutral)
    assert take.video.rate == 24


@pytest.mark.parametrize(
    "option", ["--take", "--video", "--audio", "--save-spec", "--timecode=01:00:00:00"]
)
def test_what_is_of_one_take_is_refused_for_a_folder(
    captures, shot: Shot, monkeypatch, capsys, option: str
) -> None:
    monkeypatch.chdir(shot.folder)
    value = () if "=" in option else ("captures/b.mp4",)
    with pytest.raises(SystemExit) as stopped:
        main(["ingest", "captures", "--out", "takes", option, *value])
    assert stopped.value.code == 2
    assert f"captures: {option.split('=')[0]} " in capsys.readouterr().err
    assert not (shot / "takes").exists()


def test_one_broken_capture_does_not_stop_the_others(captures, shot: Shot) -> None:
    data = (captures / "b.c3d").read_bytes()
    (captures / "b.c3d").write_bytes(data[:4000])
    with pytest.raises(CheckFailedError, match=r"1 take of .* ingested, 1 failed.*\n.*b\.c3d"):
        ingest_folder(captures, shot / "takes", options(shot))
    assert read_take(shot / "takes" / "a 01.take.usda").frame_count == 480


def test_a_folder_without_captures_is_refused(shot: Shot) -> None:
    (shot / "empty").mkdir()
    with pytest.raises(InputError, match="holds no file of a known capture"):
        ingest_folder(shot / "empty", shot / "takes", options(shot))


def test_files_in_no_take_are_named(captures, shot: Shot) -> None:
    (captures / "lone.mov").write_bytes(b"")
    report = ingest_folder(captures, shot / "takes", options(shot), overwrite=True)
    assert any(
        "not used, as their content" in note and "lone.mov, notes.txt" in note
        for note in report.notes
    )


@pytest.mark.parametrize("name", ["c.c3d", "C.TRC"])
def test_an_empty_copy_of_a_capture_does_not_go_unseen(captures, shot: Shot, name: str) -> None:
    (captures / name).write_bytes(b"")
    with pytest.raises(CheckFailedError, match=rf"2 takes of .* 1 failed.*\n.*{name}"):
        ingest_folder(captures, shot / "takes", options(shot), overwrite=True)


def test_usd_captures_are_taken_however_their_suffix_is_written(captures) -> None:
    for name in ("d.USDA", "e.usdz", "d.take.usda", "d.take.samples.usdc"):
        (captures / name).write_bytes(b"#usda 1.0\n")
    assert [each.name for each in find_bundles(captures)] == ["a 01", "b", "d", "e"]
