"""Versions posted to Kitsu: to a stand-in here; `poe kitsu` posts to a real one."""

import json
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.hooks.kitsu_server import Kitsu
from tests.hooks.loading import load

pytest.importorskip("gazu", reason="needs the kitsu extra: gazu")

WHERE = ["--project", "Kitchen", "--sequence", "SQ01", "--shot", "SH010", "--task", "Facial"]


@pytest.fixture
def kitsu(monkeypatch: pytest.MonkeyPatch) -> Iterator[Kitsu]:
    server = Kitsu()
    monkeypatch.setenv("KITSU_URL", server.url)
    monkeypatch.setenv("KITSU_TOKEN", "secret-token")
    yield server
    server.close()


@pytest.fixture
def version(tmp_path: Path) -> Path:
    """As `integrate_performance` leaves it."""
    folder = tmp_path / "kitchen.hero" / "v003"
    folder.mkdir(parents=True)
    files = {"performance": "kitchen.hero.usda", "sheet": "a.sheet.jpg", "movie": "a.review.mp4"}
    for name in files.values():
        (folder / name).write_bytes(f"content of {name}".encode())
    manifest = {
        "name": "kitchen.hero",
        "version": 3,
        "comment": "softer jaw",
        "files": {role: {"name": name, "sha256": ""} for role, name in files.items()},
    }
    (folder / "publish.json").write_text(json.dumps(manifest))
    return folder


def post(version: Path, *more: str, status: str = "wfa") -> int:
    return load("kitsu/publish_to_kitsu.py").main([str(version), *WHERE, "--status", status, *more])


def test_a_version_is_a_revision_with_movie_and_sheet_and_a_status(
    kitsu: Kitsu, version: Path, capsys
) -> None:
    assert post(version) == 0
    (comment,) = kitsu.comments
    assert comment["comment"] == "kitchen.hero v003: softer jaw"
    assert comment["task_status_id"] == "task-status"
    assert [each["revision"] for each in kitsu.previews] == [3, 3]
    assert b"content of a.review.mp4" in kitsu.uploads["preview0"]
    assert b"content of a.sheet.jpg" in kitsu.uploads["preview1"]
    assert kitsu.main == "preview0", "the movie is what the shot is seen by"
    assert kitsu.tokens == {"Bearer secret-token"}
    assert capsys.readouterr().out == "posted\n"


def test_a_version_is_posted_once_however_often_it_is_tried(
    kitsu: Kitsu, version: Path, capsys
) -> None:
    assert post(version) == post(version) == 0
    assert len(kitsu.comments) == 1
    assert capsys.readouterr().out == "posted\nis there already\n"


@pytest.mark.parametrize("refused", ["review", "sheet"])
def test_a_post_that_broke_off_is_completed_by_the_next_try(
    kitsu: Kitsu, version: Path, capsys, refused: str
) -> None:
    kitsu.refused = refused
    for _ in range(2):
        assert post(version) == 1
        told = capsys.readouterr()
        assert "v003: Kitsu fails: RouteNotFoundException" in told.err
        assert not told.out
    kitsu.refused = ""
    assert post(version) == post(version) == 0
    assert capsys.readouterr().out == "posted\nis there already\n"
    assert len(kitsu.comments) == 1
    assert [each["original_name"] for each in kitsu.previews] == ["a.review", "a.sheet"]
    assert [each["revision"] for each in kitsu.previews] == [3, 3]
    assert kitsu.main == "preview0"


def test_a_version_without_pictures_is_posted_once_too(kitsu: Kitsu, version: Path, capsys) -> None:
    change(version, files={"performance": {"name": "kitchen.hero.usda"}})
    assert post(version) == post(version) == 0
    assert len(kitsu.comments) == 1
    assert capsys.readouterr().out == "posted\nis there already\n"


def test_the_comment_says_the_verdict(kitsu: Kitsu, version: Path) -> None:
    change(version, verdict={"level": "check", "sentence": "Check: expected error 0.6 mm"})
    assert post(version) == 0
    (comment,) = kitsu.comments
    assert comment["comment"] == "kitchen.hero v003: softer jaw\nCheck: expected error 0.6 mm"


def test_another_performance_of_the_same_number_is_another_version(
    kitsu: Kitsu, version: Path
) -> None:
    assert post(version) == 0
    change(version, name="kitchen.villain")
    assert post(version) == 0
    assert len(kitsu.comments) == 2
    assert len(kitsu.uploads) == 4


@pytest.mark.parametrize(
    ("more", "message"),
    [
        ({"version": None}, "lacks a name or a version"),
        ({"name": 7}, "lacks a name or a version"),
        ({"files": {"sheet": "a.sheet.jpg"}}, "does not describe a published version"),
        ({"files": {"sheet": {"name": "gone.jpg"}}}, "the sheet 'gone.jpg' is not in it"),
        ({"files": {"sheet": {"name": "../../secret.jpg"}}}, "secret.jpg' is not in it"),
    ],
)
def test_a_manifest_that_is_none_posts_nothing(
    kitsu: Kitsu, version: Path, tmp_path: Path, capsys, more, message: str
) -> None:
    (tmp_path / "secret.jpg").write_bytes(b"not of this version")
    change(version, **more)
    assert post(version) == 2
    assert message in capsys.readouterr().err
    assert kitsu.comments == []


def change(version: Path, /, **more: object) -> None:
    manifest = json.loads((version / "publish.json").read_text())
    (version / "publish.json").write_text(json.dumps(manifest | more))


def test_a_login_by_name_works_too(kitsu: Kitsu, version: Path, monkeypatch) -> None:
    monkeypatch.delenv("KITSU_TOKEN")
    monkeypatch.setenv("KITSU_LOGIN", "td@example.com")
    monkeypatch.setenv("KITSU_PASSWORD", "password")
    assert post(version, "--comment", "see the lips") == 0
    assert kitsu.comments[0]["comment"] == "kitchen.hero v003: see the lips"


def test_open_notes_of_a_report_follow_the_comment(
    kitsu: Kitsu, version: Path, tmp_path: Path
) -> None:
    notes = [
        {"id": "b", "frame": 9, "text": "lids", "made": "2026-01-01", "version": "old"},
        {"id": "a", "frame": 4, "last": 6, "text": "jaw", "made": "2026-01-02", "version": "new"},
        {"id": "c", "frame": 2, "text": "mended", "done": True},
    ]
    file = tmp_path / "notes.json"
    file.write_text(json.dumps({"usdface_notes": 1, "notes": notes}), encoding="utf-8")
    assert post(version, "--notes", str(file)) == 0
    assert kitsu.comments[0]["comment"].splitlines()[1:] == [
        "- frames 4-6: jaw",
        "- frame 9: lids [on another version]",
    ]


def test_what_is_not_there_is_named(kitsu: Kitsu, version: Path, tmp_path: Path, capsys) -> None:
    assert post(version, status="approved") == 2
    assert "there is no status 'approved'" in capsys.readouterr().err
    assert post(version, "--shot", "SH999") == 2
    assert "there is no shot 'SH999'" in capsys.readouterr().err
    assert post(tmp_path) == 2
    assert "is this a published version" in capsys.readouterr().err
    assert kitsu.comments == []


def test_without_a_server_or_a_login_nothing_is_tried(version: Path, monkeypatch, capsys) -> None:
    for name in ("KITSU_URL", "KITSU_TOKEN", "KITSU_LOGIN", "KITSU_PASSWORD"):
        monkeypatch.delenv(name, raising=False)
    assert post(version) == 2
    assert "set KITSU_URL, and KITSU_TOKEN or" in capsys.readouterr().err
    monkeypatch.setenv("KITSU_URL", "http://127.0.0.1:9/api")
    monkeypatch.setenv("KITSU_LOGIN", "td@example.com")
    monkeypatch.setenv("KITSU_PASSWORD", "hunter2")
    assert post(version) == 2
    told = capsys.readouterr().err
    assert "refuses the login" in told
    assert "hunter2" not in told
