"""Whatever befalls a step, its outputs are old or new, and never half; run again, they are new.

`poe faults` runs these, a step on each core; docs/development.md says how long. Every step of a job
has its command in `commands.COMMANDS`, so a new one is put through all of this or fails the first
test.
"""

import contextlib
import ctypes
import os
import resource
import shutil
import signal
import subprocess
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from pxr import UsdUtils

from tests.faults.commands import (
    ALL_STEPS,
    COMMANDS,
    contents,
    finish,
    leftovers,
    limited,
    start,
)
from tests.faults.conftest import together
from tests.faults.world import RECORDING, World, copy_of

pytestmark = pytest.mark.faults

NEVER_FRESH = ("select", "align", "references-import")
"""What they make is filled by a later step, or was there before: nothing to begin anew."""

DAY = 86_400


@dataclass(frozen=True)
class Settled:
    """A folder in which a step has just been run; read only.

    Attributes
    ----------
    folder : Path
    step, words : str
        Its name and its command.
    whole : dict
        Every file.
    made : frozenset of str
        Those that the step makes.
    seconds : float
        How long it took.
    """

    folder: Path
    step: str
    words: str
    whole: dict[str, bytes]
    made: frozenset[str]
    seconds: float

    def copy(self, target: Path) -> Path:
        return copy_of(self.folder, target / "Schuss 1 ü")  # a name as users give them


@pytest.fixture(scope="module", params=together(ALL_STEPS))
def settled(
    request: pytest.FixtureRequest, world: World, tmp_path_factory: pytest.TempPathFactory
) -> Iterator[Settled]:
    """One step after the other, each run once more where everything is there."""
    step = request.param
    if step not in world.made:
        pytest.skip(f"{step} needs {RECORDING}")
    folder = copy_of(world.folder, tmp_path_factory.mktemp("settled") / "Schuss 1 ü")
    begun = time.perf_counter()
    finish(folder, COMMANDS[step])
    took = time.perf_counter() - begun
    yield Settled(folder, step, COMMANDS[step], contents(folder), world.made[step], took)
    shutil.rmtree(folder)


def check_old_or_new(folder: Path, settled: Settled, *, may_lack: frozenset[str]) -> None:
    """The same bytes come out each time, so old and new are one: nothing may differ or be gone."""
    now = contents(folder)
    # A killed process leaves its tuning lock, which holds nobody off: the next run takes it away.
    now = {name: content for name, content in now.items() if not name.endswith(".tuned.lock")}
    assert now.keys() <= settled.whole.keys()
    assert settled.whole.keys() - now.keys() <= may_lack
    assert [name for name in now if now[name] != settled.whole[name]] == []
    for name in now.keys() & settled.made:
        if Path(name).suffix in (".usda", ".usdc") and may_lack:
            *_, lost = UsdUtils.ComputeAllDependencies(str(folder / name))
            assert lost == [], f"{name} is there before what it refers to"


def mend(folder: Path, settled: Settled) -> None:
    """Run again undisturbed: all is as if nothing had been, and leftovers are cleared."""
    finish(folder, settled.words)
    check_old_or_new(folder, settled, may_lack=frozenset())
    assert leftovers(folder) == []
    assert list(folder.glob("*.tuned.lock")) == []


def test_every_step_of_a_job_has_a_command_here() -> None:
    assert set(COMMANDS) == set(ALL_STEPS)


def test_killed(settled: Settled, tmp_path: Path) -> None:
    folder = settled.copy(tmp_path)
    rng = np.random.default_rng(0)
    for number in range(4):
        kind = (signal.SIGKILL, signal.SIGTERM)[number % 2]
        fresh = settled.made if number >= 2 and settled.step not in NEVER_FRESH else frozenset()
        for name in fresh:
            (folder / name).unlink(missing_ok=True)
        process = start(folder, settled.words)
        time.sleep(float(rng.uniform(0.3, 1.0)) * settled.seconds)
        process.send_signal(kind)
        _, told = process.communicate()
        assert "Traceback" not in told
        check_old_or_new(folder, settled, may_lack=fresh)
    mend(folder, settled)


def test_a_file_may_not_grow(settled: Settled, tmp_path: Path) -> None:
    folder = settled.copy(tmp_path)
    written = [len(data) for name, data in settled.whole.items() if name in settled.made]
    largest = max(written, default=1000)
    for share in (0.01, 0.6):
        process = start(folder, settled.words, first=limited(max(1, int(share * largest))))
        _, told = process.communicate()
        assert "Traceback" not in told
        assert process.returncode in (0, 2), told  # 0: what it writes is smaller than the limit
        check_old_or_new(folder, settled, may_lack=frozenset())
    mend(folder, settled)


@pytest.fixture
def small_disk(settled: Settled, tmp_path: Path) -> Iterator[Path]:
    """The folder on a disk of its own, nearly full."""
    disk = tmp_path / "disk"
    disk.mkdir()
    page = 4096
    pages = sum(-(-len(data) // page) + 1 for data in settled.whole.values())
    size = (pages + 64) * page
    done = subprocess.run(
        ["mount", "-t", "tmpfs", "-o", f"size={size}", "none", str(disk)],
        capture_output=True,
        check=False,
    )
    if done.returncode:
        pytest.skip("a disk of its own needs the right to mount one")
    try:
        folder = settled.copy(disk)
        yield folder
    finally:
        subprocess.run(["umount", str(disk)], check=True)


@pytest.mark.skipif(shutil.which("mount") is None, reason="mounts a small disk")
def test_the_disk_is_full(settled: Settled, small_disk: Path) -> None:
    with contextlib.suppress(OSError), (small_disk / ".filling").open("wb", 0) as stream:
        while True:
            stream.write(bytes(512))
    process = start(small_disk, settled.words)
    _, told = process.communicate()
    assert "Traceback" not in told
    assert process.returncode == 2, told
    check_old_or_new(small_disk, settled, may_lack=frozenset())


MEMORY = [
    (resource.RLIMIT_AS, 1500),
    (resource.RLIMIT_DATA, 160),
]
"""Address space and data [MB]: enough to start with, and too little to finish."""


MOST_SECONDS = 60
"""A command that has not ended by then, short of memory, is stopped as a farm would."""


def test_memory_is_short(settled: Settled, tmp_path: Path) -> None:
    folder = settled.copy(tmp_path)
    for of, megabytes in MEMORY:
        process = start(folder, settled.words, first=limited(megabytes << 20, of))
        try:  # a native library may end the process, or ask for memory for ever, as OpenBLAS does
            process.communicate(timeout=MOST_SECONDS)
        except subprocess.TimeoutExpired:
            process.kill()
            process.communicate()
        check_old_or_new(folder, settled, may_lack=frozenset())
    mend(folder, settled)


def without_privilege() -> None:
    """Give up what lets root write anywhere; Linux's names for it."""
    drop_from_bounding_set, dac_override = 24, 1
    if os.geteuid() == 0:
        ctypes.CDLL(None).prctl(drop_from_bounding_set, dac_override, 0, 0, 0)


def test_the_folder_is_read_only(settled: Settled, tmp_path: Path) -> None:
    folder = settled.copy(tmp_path)
    folder.chmod(0o555)
    try:
        process = start(folder, settled.words, first=without_privilege)
        _, told = process.communicate()
    finally:
        folder.chmod(0o755)
    if process.returncode == 0 and os.geteuid() == 0:
        pytest.skip("root here may write anywhere and cannot give it up")
    assert process.returncode == 2, told
    assert "cannot be written" in told
    check_old_or_new(folder, settled, may_lack=frozenset())


@pytest.mark.parametrize("days", [-20_000, 3_650], ids=["1971", "in ten years"])
def test_every_file_has_a_time_that_is_not_now(settled: Settled, tmp_path: Path, days: int) -> None:
    folder = settled.copy(tmp_path)
    when = time.time() + days * DAY
    for each in folder.iterdir():
        os.utime(each, (max(when, 0.0), max(when, 0.0)))
    mend(folder, settled)


BACKWARDS = """
import time

_begun, _ticks = time.time(), iter(range(1 << 60))


def _backwards():
    return _begun - 3600.0 * next(_ticks)


time.time = _backwards
time.time_ns = lambda: int(1e9 * _backwards())
"""


def test_the_clock_runs_backwards(settled: Settled, tmp_path: Path) -> None:
    folder = settled.copy(tmp_path)
    (tmp_path / "clock").mkdir()
    (tmp_path / "clock" / "sitecustomize.py").write_text(BACKWARDS)
    finish(folder, settled.words, python_path=tmp_path / "clock")
    check_old_or_new(folder, settled, may_lack=frozenset())
