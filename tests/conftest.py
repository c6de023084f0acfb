"""What many tests share."""

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # as the command line does
# Images of containers set it; workers and commands would each compile the tests and the package.
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)

import gc
import pickle
import shutil
import signal
import sys
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest
from hypothesis import settings

# What is slow to import is imported by the fixtures: workers start once this file is read.
if TYPE_CHECKING:
    import numpy as np

    from tests.steps.small_shot import Shot

sys.dont_write_bytecode = False
# Objects of 5,000 tests stay to the end of a run, and each full collection visits them again.
gc.set_threshold(20_000, 20, 20)

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


@pytest.fixture(scope="session")
def remembered_folder(run_folder: Path) -> Path:
    """Where one run's processes remember what they computed."""
    return run_folder / "remembered"


@pytest.fixture(scope="session", autouse=True)
def _remembered(remembered_folder: Path) -> Iterator[None]:
    from tests.remembered import REMEMBERED, remember

    with pytest.MonkeyPatch.context() as patch:
        remember(remembered_folder, REMEMBERED, patch.setattr)
        yield


@pytest.fixture(scope="session", autouse=True)
def _drawn_here() -> Iterator[None]:
    """Draw movies in the test's own process, unless a test asks for more: pytest fills the cores.

    A process that draws imports and reads all that the test's has read.
    """
    from usdface.core.processes import process_count
    from usdface.steps.review import movie

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(movie, "process_count", lambda wanted=None: process_count(wanted or 1))
        yield


@pytest.fixture(scope="session", autouse=True)
def _known_libraries() -> Iterator[None]:
    """Look for the process's linear algebra once rather than for each step."""
    from threadpoolctl import ThreadpoolController

    from usdface.runner import execute

    limit = ThreadpoolController().limit
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(
            execute,
            "threadpool_limits",
            lambda count, user_api: limit(limits=count, user_api=user_api),
        )
        yield


@pytest.fixture(scope="session", autouse=True)
def _interruptible() -> None:
    """Let commands under test be interrupted, which inherit that a run in the background is not."""
    if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
        signal.signal(signal.SIGINT, signal.default_int_handler)


@pytest.fixture(scope="session", autouse=True)
def _not_waiting_for_disks() -> Iterator[None]:
    """Leave files of tests to the system's cache: no test survives a power cut."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(os, "fsync", lambda _: None)
        yield


@pytest.fixture(scope="session")
def finished_shot(run_folder: Path) -> "Shot":
    """A shot whose job has been run, by the first worker that needs it; read only."""
    from tests.remembered import store
    from tests.steps.small_shot import make_inputs
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
        store(done, shot)
    return shot


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    """A browser, started once for the tests of a file, each of which opens its own pages."""
    from tests.browser import chromium

    with chromium() as running:
        yield running


@pytest.fixture
def without_comparison(monkeypatch: pytest.MonkeyPatch) -> None:
    """Train without cross-validation, as with few pairs, where a test is not of what it judges."""
    from usdface.model.mapping import candidates

    monkeypatch.setattr(candidates, "MINIMUM_TO_COMPARE", sys.maxsize)


@pytest.fixture
def placement_not_drawn(monkeypatch: pytest.MonkeyPatch) -> None:
    """Leave the picture of the placement empty, where a test is not of it."""
    from usdface.steps.references import select

    monkeypatch.setattr(select, "draw_placement", _empty_picture)


@pytest.fixture
def coverage_not_drawn(monkeypatch: pytest.MonkeyPatch) -> None:
    """Leave the picture of the coverage empty, and as it is when pairs change, in other tests."""
    from usdface.steps.inputs import coverage_report
    from usdface.steps.references import from_edits, import_

    monkeypatch.setattr(coverage_report, "draw_coverage", _empty_picture)
    for step in (from_edits, import_):
        monkeypatch.setattr(step, "redraw_coverage", lambda *_: ((), []))


def _empty_picture(*_: object, **__: object) -> "np.ndarray":
    import numpy as np

    return np.zeros((8, 8, 3), np.uint8)


@pytest.fixture
def shot(finished_shot: "Shot", tmp_path: Path) -> "Shot":
    """A copy of the finished shot that a test may change."""
    folder = tmp_path / "Schuss 1 ü"  # a name as users give them
    shutil.copytree(finished_shot.folder, folder)
    return replace(finished_shot, folder=folder)
