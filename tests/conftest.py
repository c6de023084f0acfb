"""What many tests share."""

from pathlib import Path

import pytest

SHARED_DATA = Path(__file__).resolve().parents[2] / "shared" / "data"


@pytest.fixture(scope="session")
def shared_data() -> Path:
    """Folder of the fixture files; the test skips where they are not checked out beside us."""
    if not SHARED_DATA.is_dir():
        pytest.skip(f"fixture files are not at {SHARED_DATA}")
    return SHARED_DATA
