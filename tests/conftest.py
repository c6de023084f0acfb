"""What many tests share."""

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # as the command line does

import pickle
import shutil
import time
from collections.abc import Callable, Iterator
from hashlib import sha256
from pathlib import Path

import pytest
from hypothesis import settings

from tests.steps.small_shot import Shot, make_inputs

# A run must say the same twice; USDFACE_FUZZ=random searches anew each time. How long an example
# takes says more of what else the machine does than of us.
settings.register_profile("repeatable", derandomize=True, deadline=None)
settings.register_profile("random", derandomize=False, deadline=None)
settings.load_profile(os.environ.get("USDFACE_FUZZ", "repeatable"))

SHARED_DATA = Path(__file__).resolve().parents[2] / "shared" / "data"


@pytest.fixture(scope="session")
def shared_data() -> Path:
    """Folder of the fixture files; the test skips where they are not checked out beside us."""
    if not SHARED_DATA.is_dir():
        pytest.skip(f"fixture files are not at {SHARED_DATA}")
    return SHARED_DATA


@pytest.fixture(scope="session")
def run_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder that all workers of one run share."""
    base = tmp_path_factory.getbasetemp()
    return base.parent if "PYTEST_XDIST_WORKER" in os.environ else base


def _remember(function: Callable[..., object], folder: Path) -> Callable[..., object]:
    """Return a function that computes once, for all workers, what follows from its arguments."""

    def remembering(*given: object, **named: object) -> object:
        content = pickle.dumps((given, named))
        file = folder / f"{function.__name__}.{sha256(content).hexdigest()}"
        if not file.is_file():
            _store(file, function(*given, **named))
        return pickle.loads(file.read_bytes())

    return remembering


def _store(file: Path, value: object) -> None:
    """Write a file that other workers see whole or not at all."""
    part = file.with_name(f"{file.name}.{os.getpid()}")
    part.write_bytes(pickle.dumps(value))
    part.replace(file)


@pytest.fixture(scope="session", autouse=True)
def _remembered(run_folder: Path) -> Iterator[None]:
    """Compute once in a run what most steps ask of the same shot and character.

    That is the demo's heads, where the shot's markers are placed and how far they move there, the
    picture of it, what is drawn of a rig, and how much light falls on each of the face's points.
    What is remembered goes by the content of all arguments. Tests of one of these call it under its
    own name.
    """
    from usdface.demo import rig
    from usdface.media.face import render, surface
    from usdface.media.page import face_payload
    from usdface.model.selection import baseline
    from usdface.steps.inputs import coverage_report, placement

    folder = run_folder / "remembered"
    folder.mkdir(exist_ok=True)
    with pytest.MonkeyPatch.context() as patch:
        for module, name in (
            (rig, "bare_head"),
            (baseline, "place_markers"),
            (baseline, "match_peaks"),
            (baseline, "_noise_mm"),
            (placement, "place_markers"),
            (placement, "sample_face_skin"),
            (placement, "judge_placement"),
            (placement, "bind_at"),
            (placement, "draw_binding"),
            (coverage_report, "draw_coverage"),
            (surface, "_rest_exposure"),
            (render, "build_surface"),
            (face_payload, "build_surface"),
            (face_payload, "_sky_of"),
        ):
            patch.setattr(module, name, _remember(getattr(module, name), folder))
        yield


@pytest.fixture(scope="session", autouse=True)
def _drawn_here() -> Iterator[None]:
    """Draw in the test's own process, unless a test asks for more: pytest's workers fill the cores.

    A process that draws imports and reads all that the test's has read.
    """
    from usdface.core.processes import process_count
    from usdface.steps.review import movie, sheet

    with pytest.MonkeyPatch.context() as patch:
        for module in (movie, sheet):
            patch.setattr(module, "process_count", lambda wanted=None: process_count(wanted or 1))
        yield


@pytest.fixture(scope="session", autouse=True)
def _not_waiting_for_disks() -> Iterator[None]:
    """Leave files of tests to the system's cache: no test survives a power cut."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(os, "fsync", lambda _: None)
        yield


@pytest.fixture(scope="session")
def finished_shot(run_folder: Path) -> Shot:
    """A shot whose job has been run, by the first worker that needs it; read only."""
    from usdface.runner.job import run_job
    from usdface.specs.reading import read_job

    folder, done = run_folder / "shot", run_folder / "shot.pickle"
    shot: Shot | None = None
    try:
        folder.mkdir()
    except FileExistsError:  # another worker makes it
        while not done.exists():
            time.sleep(0.2)
        shot = pickle.loads(done.read_bytes())
        assert shot is not None, "the worker that made the shot failed"
        return shot
    try:
        made = make_inputs(folder)
        run_job(read_job(made / "shot.job.yaml"))
        shot = made
    finally:
        _store(done, shot)
    return shot


@pytest.fixture
def shot(finished_shot: Shot, tmp_path: Path) -> Shot:
    """A copy of the finished shot that a test may change."""
    folder = tmp_path / "Schuss 1 ü"  # a name as users give them
    shutil.copytree(finished_shot.folder, folder)
    return Shot(folder, finished_shot.rigid, finished_shot.neutral)
