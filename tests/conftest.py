"""What many tests share."""

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # as the command line does

from pathlib import Path

import pytest
from hypothesis import settings

# A run must say the same twice; USDFACE_FUZZ=random searches anew each time.
settings.register_profile("repeatable", derandomize=True)
settings.register_profile("random", derandomize=False)
settings.load_profile(os.environ.get("USDFACE_FUZZ", "repeatable"))

SHARED_DATA = Path(__file__).resolve().parents[2] / "shared" / "data"


@pytest.fixture(scope="session")
def shared_data() -> Path:
    """Folder of the fixture files; the test skips where they are not checked out beside us."""
    if not SHARED_DATA.is_dir():
        pytest.skip(f"fixture files are not at {SHARED_DATA}")
    return SHARED_DATA
