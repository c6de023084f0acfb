"""Two people never tune at once, and nobody is shut out by a machine that is gone."""

import json
import os
import subprocess
import sys
import time
from pathlib import Path

import pytest

from usdface.core.errors import InputError
from usdface.core.locks import STALE_SECONDS, TuningLock


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "hero.references.tuned.lock"


def test_the_second_is_refused_and_told_who_where_and_since_when(path: Path) -> None:
    first = TuningLock(path)
    first.acquire()
    holder = first.holder()
    assert holder is not None
    with pytest.raises(InputError) as refused:
        TuningLock(path).acquire()
    for said in (holder.user, holder.host, holder.since, str(holder.process), "--take-over"):
        assert said in str(refused.value)
    first.release()
    TuningLock(path).acquire()


def test_who_was_taken_over_is_told_and_leaves_the_lock_alone(path: Path) -> None:
    first, second = TuningLock(path), TuningLock(path)
    first.acquire()
    second.acquire(take_over=True)
    assert second.taken_from is not None
    with pytest.raises(InputError, match="took it over"):
        first.check()
    first.renew()
    first.release()
    second.check()


def test_a_lock_of_a_process_that_died_is_free(path: Path) -> None:
    ended = subprocess.run([sys.executable, "-c", "import os; print(os.getpid())"],
                           capture_output=True, text=True, check=True)  # fmt: skip
    lock = TuningLock(path)
    lock.acquire()
    data = json.loads(path.read_text())
    path.write_text(json.dumps(data | {"process": int(ended.stdout)}))
    TuningLock(path).acquire()


def test_a_lock_of_another_machine_is_free_once_nobody_renews_it(path: Path) -> None:
    lock = TuningLock(path)
    lock.acquire()
    path.write_text(json.dumps(json.loads(path.read_text()) | {"host": "elsewhere"}))
    with pytest.raises(InputError, match="elsewhere"):
        TuningLock(path).acquire()
    long_ago = time.time() - STALE_SECONDS - 5
    os.utime(path, (long_ago, long_ago))
    TuningLock(path).acquire()


def test_renewing_keeps_a_lock_fresh(path: Path) -> None:
    lock = TuningLock(path)
    lock.acquire()
    long_ago = time.time() - 2 * STALE_SECONDS
    os.utime(path, (long_ago, long_ago))
    lock.renew()
    assert time.time() - path.stat().st_mtime < STALE_SECONDS


def test_a_lock_file_that_says_nothing_goes_stale_too(path: Path) -> None:
    path.write_text("")
    lock = TuningLock(path)
    lock.acquire()
    lock.check()


@pytest.mark.parametrize(
    "change",
    [
        {"process": "12"},
        {"process": 1.0},
        {"process": True},
        {"process": 0},
        {"process": -1},
        {"process": 1 << 80},
        {"user": None},
        {"host": ["here"]},
        {"since": {"of": "old"}},
        {"more": "than ours"},
    ],
    ids=str,
)
def test_a_lock_that_none_of_ours_wrote_holds_nobody_off(
    path: Path, change: dict[str, object]
) -> None:
    first = TuningLock(path)
    first.acquire()
    path.write_text(json.dumps(json.loads(path.read_text()) | change))
    assert first.holder() is None
    assert not first.is_ours()
    TuningLock(path).acquire()


@pytest.mark.parametrize(
    "text",
    [
        "[" * 100_000,
        "7",
        "null",
        '["user"]',
        "{}",
        '"' + "x" * 10_000_000 + '"',
        '{"process": ' + "9" * 3000 + "}",
    ],
    ids=range(7),
)
def test_a_lock_file_of_something_else_holds_nobody_off(path: Path, text: str) -> None:
    path.write_text(text)
    lock = TuningLock(path)
    assert lock.holder() is None
    lock.acquire()
    lock.check()


def test_a_removed_lock_stops_the_page(path: Path) -> None:
    lock = TuningLock(path)
    lock.acquire()
    path.unlink()
    with pytest.raises(InputError, match="its lock was removed"):
        lock.check()


def test_a_folder_that_cannot_be_written_is_named(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="cannot be written"):
        TuningLock(tmp_path / "missing" / "x.lock").acquire()


FULL = """
import resource, sys
from pathlib import Path
from usdface.core.errors import InputError
from usdface.core.locks import TuningLock
resource.setrlimit(resource.RLIMIT_FSIZE, (16, 16))
try:
    TuningLock(Path(sys.argv[1])).acquire()
except InputError as error:
    print(error)
"""


@pytest.mark.skipif(os.name != "posix", reason="limits the size of files")
def test_a_disk_that_is_full_leaves_no_half_lock(path: Path) -> None:
    done = subprocess.run(
        [sys.executable, "-c", FULL, str(path)], capture_output=True, text=True, check=True
    )
    assert "cannot be written (File too large)" in done.stdout
    assert not path.exists()
