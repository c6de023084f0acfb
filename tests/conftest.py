"""What many tests share."""

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # as the command line does

import shutil
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
def finished_shot(tmp_path_factory: pytest.TempPathFactory) -> Shot:
    """A shot whose job has been run; read only."""
    from usdface.runner.job import run_job
    from usdface.specs.reading import read_job

    shot = make_inputs(tmp_path_factory.mktemp("shot"))
    run_job(read_job(shot / "shot.job.yaml"))
    return shot


@pytest.fixture
def shot(finished_shot: Shot, tmp_path: Path) -> Shot:
    """A copy of the finished shot that a test may change."""
    folder = tmp_path / "Schuss 1 ü"  # a name as users give them
    shutil.copytree(finished_shot.folder, folder)
    return Shot(folder, finished_shot.rigid, finished_shot.neutral)
