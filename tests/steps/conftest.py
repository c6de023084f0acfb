"""The shot that step tests share."""

import shutil
from pathlib import Path

import pytest

from tests.steps.small_shot import Shot, make_inputs
from usdface.specs.reading import read_job
from usdface.steps.jobs import run_job


@pytest.fixture(scope="session")
def finished_shot(tmp_path_factory: pytest.TempPathFactory) -> Shot:
    """A shot whose job has been run; read only."""
    shot = make_inputs(tmp_path_factory.mktemp("shot"))
    run_job(read_job(shot / "shot.job.yaml"))
    return shot


@pytest.fixture
def shot(finished_shot: Shot, tmp_path: Path) -> Shot:
    """A copy of the finished shot that a test may change."""
    folder = tmp_path / "Schuss 1 ü"  # a name as users give them
    shutil.copytree(finished_shot.folder, folder)
    return Shot(folder, finished_shot.rigid, finished_shot.neutral)
