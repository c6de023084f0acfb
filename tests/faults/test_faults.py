"""Whatever befalls a step, its outputs are old or new, and never half; run again, they are new.

`poe faults` runs these; they take minutes.
"""

import os
import resource
import signal
import time
from pathlib import Path

import numpy as np
import pytest

from tests.faults.commands import STEPS, contents, finish, leftovers, start
from tests.steps.small_shot import Shot

pytestmark = pytest.mark.faults


@pytest.fixture(params=STEPS)
def prepared(request, shot: Shot) -> tuple[str, Path, float]:
    """A command, the folder it runs in, its outputs there already, and how long it takes."""
    words, before = STEPS[request.param], time.perf_counter()
    if request.param not in ("references import", "train", "map", "bake"):
        finish(shot.folder, words)
    else:
        for each in ("train", "map", request.param):
            finish(shot.folder, STEPS[each])
            if each != request.param:
                before = time.perf_counter()
    return words, shot.folder, time.perf_counter() - before


def check_old_or_new(folder: Path, whole: dict[str, bytes]) -> None:
    """The same bytes come out each time, so old and new are one: nothing may differ or be gone."""
    now = contents(folder)
    assert now.keys() == whole.keys()
    assert [name for name in now if now[name] != whole[name]] == []


def mend(folder: Path, words: str, whole: dict[str, bytes]) -> None:
    """Run again undisturbed: all is as if nothing had been, and leftovers are cleared."""
    finish(folder, words)
    check_old_or_new(folder, whole)
    assert leftovers(folder) == []


@pytest.mark.parametrize("kind", [signal.SIGKILL, signal.SIGTERM])
def test_killed(prepared: tuple[str, Path, float], kind: signal.Signals) -> None:
    words, folder, took = prepared
    finish(folder, words)
    whole = contents(folder)
    rng = np.random.default_rng(0)
    for _ in range(4):
        process = start(folder, words)
        time.sleep(float(rng.uniform(0.3, 1.0)) * took)
        process.send_signal(kind)
        _, told = process.communicate()
        assert "Traceback" not in told
        check_old_or_new(folder, whole)
    mend(folder, words, whole)


@pytest.mark.parametrize("share", [0.01, 0.4, 0.9])
def test_the_disk_is_full(prepared: tuple[str, Path, float], share: float) -> None:
    words, folder, _ = prepared
    whole = contents(folder)
    made = folder / words.split("--out ")[-1].split()[0]
    largest = max(len(data) for name, data in whole.items() if name.startswith(made.stem))
    process = start(folder, words, limit=max(1, int(share * largest)))
    _, told = process.communicate()
    assert "Traceback" not in told
    assert process.returncode in (0, 2), told  # 0: what it writes is smaller than the limit
    check_old_or_new(folder, whole)
    mend(folder, words, whole)


@pytest.mark.parametrize("megabytes", [600, 1200, 1800])
def test_memory_is_short(prepared: tuple[str, Path, float], megabytes: int) -> None:
    words, folder, _ = prepared
    whole = contents(folder)
    process = start(folder, words, limit=megabytes << 20, of=resource.RLIMIT_AS)
    process.communicate()  # a native library may end the process; its files may not suffer
    check_old_or_new(folder, whole)
    mend(folder, words, whole)


@pytest.mark.skipif(os.name != "posix" or os.geteuid() == 0, reason="root may write anywhere")
def test_the_folder_is_read_only(prepared: tuple[str, Path, float]) -> None:
    words, folder, _ = prepared
    whole = contents(folder)
    folder.chmod(0o555)
    try:
        process = start(folder, words)
        _, told = process.communicate()
    finally:
        folder.chmod(0o755)
    assert process.returncode == 2
    assert "cannot be written" in told
    check_old_or_new(folder, whole)
