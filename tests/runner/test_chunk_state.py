"""What a farm made in parts is done for a job that names it whole, as long as each part is."""

import shutil
from pathlib import Path

import numpy as np
import pytest

from tests.capture.simulated_faces import SimulatedFinder, turning_head
from tests.steps.small_shot import FRAMES, Shot
from usdface.core.sidecars import parts_folder
from usdface.farm.plan import in_chunks
from usdface.media.film.movie import write_movie
from usdface.runner.execute import execute
from usdface.runner.state import frames_made, job_states
from usdface.specs.base import Spec
from usdface.specs.capture import TrackSpec
from usdface.specs.commands import SubmitSpec
from usdface.specs.job import JobSpec
from usdface.specs.performance import JoinSpec, MapSpec, TrainSpec
from usdface.specs.review import MovieJoinSpec, MovieSpec
from usdface.steps.capture import track_pictures

pytestmark = pytest.mark.usefixtures("without_comparison")


def state(spec: Spec) -> tuple[str, str]:
    found = job_states(JobSpec(job="shot", steps=(spec,)))[0]
    return found.state, found.reason


def mapped_whole(folder: Path) -> MapSpec:
    """What a farm does in two parts and joins."""
    return MapSpec(
        take=folder / "shot.clean.take.usda",
        mapping=folder / "hero.mapping.usdc",
        rig=folder / "hero.usdc",
        out=folder / "parted.usda",
        temporal="whole",
    )


@pytest.fixture(scope="module")
def parted(finished_shot: Shot, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder in which a mapping was done in two parts and joined; read only."""
    folder = tmp_path_factory.mktemp("parted") / "shot"
    shutil.copytree(finished_shot.folder, folder)
    spec, parts = mapped_whole(folder), []
    for number, frames in enumerate(("1-200", f"201-{FRAMES}")):
        parts.append(folder / f"part.{number}.usda")
        execute(spec.model_copy(update={"frames": frames, "out": parts[-1]}))
    execute(JoinSpec(parts=tuple(parts), out=spec.out))
    return folder


@pytest.fixture
def whole(parted: Path, tmp_path: Path) -> MapSpec:
    """A mapping that was done in parts, in a copy of its folder that a test may change."""
    shutil.copytree(parted, tmp_path / "shot")
    return mapped_whole(tmp_path / "shot")


def test_parts_that_were_made_as_asked_are_the_whole(whole: MapSpec) -> None:
    assert state(whole) == ("done", "up to date, made in parts")
    assert state(whole.model_copy(update={"frames": f"1-{FRAMES}"}))[0] == "done"


@pytest.mark.parametrize(
    "change", [{"temporal": "none"}, {"frames": "1-200"}, {"cutoff": 5.0}], ids=str
)
def test_parts_of_other_settings_or_frames_are_not(
    whole: MapSpec, change: dict[str, object]
) -> None:
    assert state(whole.model_copy(update=change))[0] == "stale"


def test_parts_made_from_what_has_changed_since_are_not(whole: MapSpec) -> None:
    references = whole.out.with_name("hero.references.usda")
    train = TrainSpec(references=references, out=whole.mapping, method="ridge")
    execute(train, overwrite=True)
    assert state(whole) == ("stale", "hero.mapping.usdc has changed since")


def test_a_part_that_is_gone_or_was_made_anew_is_missed(whole: MapSpec) -> None:
    part = whole.out.with_name("part.0.usda")
    other = whole.model_copy(update={"frames": "1-200", "out": part, "temporal": "none"})
    execute(other, overwrite=True)
    assert state(whole)[0] == "stale"
    part.unlink()
    assert state(whole)[0] == "stale"


def test_a_file_that_names_itself_as_its_part_is_no_whole(whole: MapSpec) -> None:
    text = whole.out.read_text()
    whole.out.write_text(text.replace("part.0.usda", "parted.usda"))
    assert state(whole)[0] == "stale"


def test_a_movie_drawn_in_parts_is_done_too(shot: Shot) -> None:
    spec = MovieSpec(
        performance=shot / "shot.hero.usda",
        take=shot / "shot.clean.take.usda",
        out=shot / "parted.mp4",
        frames="1-20",
        rate=24,
        height=64,
        panels=("performance",),
    )
    parts = []
    for number, frames in enumerate(("1-10", "11-20")):
        parts.append(shot / f"part.{number}.mp4")
        execute(spec.model_copy(update={"frames": frames, "out": parts[-1], "sound": False}))
    execute(MovieJoinSpec(parts=tuple(parts), take=spec.take, out=spec.out))
    assert state(spec) == ("done", "up to date, made in parts")
    assert state(spec.model_copy(update={"quality": "final"}))[0] == "stale"


def test_a_video_tracked_in_parts_is_done_too(tmp_path: Path, monkeypatch) -> None:
    monkeypatch.setattr(track_pictures, "check_model", lambda path: "0" * 64)
    finder = SimulatedFinder(lambda number: [turning_head(number)], focal_pixels=400)
    monkeypatch.setattr(track_pictures, "FaceLandmarker", lambda path: finder)
    video, model = tmp_path / "x.mp4", tmp_path / "face_landmarker.task"
    write_movie(video, [np.zeros((96, 96, 3), np.uint8)] * 30, rate=24)
    model.write_bytes(b"")
    spec = TrackSpec(video=video, model=model, out=tmp_path / "x.take.usda", quality="draft")
    chunked = SubmitSpec(job=Path("j")).model_copy(update={"track_chunk": 12})
    for task in in_chunks(spec, chunked, frames_made(spec)):
        if task.part:
            parts_folder(spec.out).mkdir(exist_ok=True)
        execute(task)
    assert len(list(parts_folder(spec.out).glob("*.usda"))) == 3
    assert state(spec) == ("done", "up to date, made in parts")
    assert state(spec.model_copy(update={"frames": "1-30"}))[0] == "stale"
    assert state(spec.model_copy(update={"eye_distance": 60.0}))[0] == "stale"
    assert state(spec.model_copy(update={"quality": "final"}))[0] == "stale"
