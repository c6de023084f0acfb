"""The fuzzer's harness runs, where the fuzzer is installed."""

import subprocess
import sys
from pathlib import Path

import pytest

pytestmark = pytest.mark.faults
REPOSITORY = Path(__file__).resolve().parents[2]


@pytest.mark.parametrize("reader", ["c3d", "trc"])
def test_ten_seconds_of_fuzzing_find_nothing(tmp_path: Path, reader: str) -> None:
    pytest.importorskip("atheris", reason="pip install atheris")
    done = subprocess.run(
        [sys.executable, "-m", "tests.faults.fuzz", reader, "--seconds", "10", "--kept", tmp_path],
        cwd=REPOSITORY,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr[-2000:]
    assert list(tmp_path.iterdir()) == []
