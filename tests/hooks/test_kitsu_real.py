"""A version posted to a real Kitsu server that this test starts: `poe kitsu`."""

import json
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest

from tests.hooks.loading import load
from tests.hooks.zou_server import LOGIN, PASSWORD, missing, running_zou
from usdface.media.film.movie import write_movie
from usdface.media.picture.image import write_image

gazu = pytest.importorskip("gazu", reason="needs the kitsu extra: gazu")

pytestmark = [
    pytest.mark.kitsu,
    # zou's test server and gazu's session leave their sockets to the end of the process.
    pytest.mark.filterwarnings("ignore::ResourceWarning"),
]


def make_version(folder: Path, version: int) -> Path:
    """As `integrate_performance` leaves one, with a real picture and a real movie."""
    made = folder / f"v{version:03}"
    made.mkdir(parents=True)
    pictures = np.random.default_rng(version).integers(0, 256, (24, 96, 128, 3), dtype=np.uint8)
    write_image(made / "x.sheet.png", pictures[0])
    write_movie(made / "x.review.mp4", iter(pictures), rate=Fraction(24))
    files = {"sheet": {"name": "x.sheet.png"}, "movie": {"name": "x.review.mp4"}}
    manifest = {"name": "x", "version": version, "comment": "softer jaw", "files": files}
    (made / "publish.json").write_text(json.dumps(manifest))
    return made


def test_versions_become_revisions_of_a_real_kitsu(tmp_path: Path, monkeypatch) -> None:
    if missing():
        pytest.skip(missing())
    monkeypatch.setenv("KITSU_LOGIN", LOGIN)
    monkeypatch.setenv("KITSU_PASSWORD", PASSWORD)
    with running_zou(tmp_path) as url:
        monkeypatch.setenv("KITSU_URL", url)
        client = gazu.client.create_client(url)
        gazu.log_in(LOGIN, PASSWORD, client=client)
        project = gazu.project.new_project("Kitchen", client=client)
        sequence = gazu.shot.new_sequence(project, "SQ01", client=client)
        shot = gazu.shot.new_shot(project, sequence, "SH010", client=client)
        kind = gazu.task.get_task_type_by_name("Animation", client=client)
        task = gazu.task.new_task(shot, kind, client=client)
        post = load("kitsu/publish_to_kitsu.py").main
        where = ["--project", "Kitchen", "--sequence", "SQ01", "--shot", "SH010"]
        where += ["--task", "Animation", "--status", "wfa"]
        third, fourth = (make_version(tmp_path / "x", version) for version in (3, 4))
        for folder in (third, fourth, fourth):  # the last, a retry, posts nothing
            assert post([str(folder), *where]) == 0
        comments = gazu.task.all_comments_for_task(task, client=client)
        assert sorted(each["text"] for each in comments) == [
            "x v003: softer jaw",
            "x v004: softer jaw",
        ]
        previews = gazu.task.all_previews_for_task(task, client=client)
        assert sorted(each["revision"] for each in previews) == [3, 3, 4, 4]
        assert {each["extension"] for each in previews} == {"png", "mp4"}
        told = gazu.task.get_task(task["id"], client=client)
        assert told["task_status"]["short_name"] == "wfa"
