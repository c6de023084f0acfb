"""Processes that work for another: started once, without its script, and ended with it."""

import os
import signal
import subprocess
import sys
import time
from contextlib import suppress
from pathlib import Path
from threading import Event

import pytest

from usdface.core.processes import (
    background_threads,
    map_threads,
    process_count,
    worker_processes,
)

SCRIPT = """
import os, signal, sys, threading, time
from functools import partial
from usdface.core.processes import worker_processes
print("script", flush=True)
with worker_processes(1, partial(print, flush=True), "set up") as give_work:
    print(give_work(os.getpid).result() != os.getpid(), flush=True)
    work = give_work(time.sleep, float(sys.argv[1]))
    print("sleeping", flush=True)
    work.result()
"""


def run_script(folder: Path, seconds: float) -> subprocess.Popen[str]:
    script = folder / "publish.py"
    script.write_text(SCRIPT)
    return subprocess.Popen(
        [sys.executable, str(script), str(seconds)],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )


def test_a_script_without_a_main_guard_is_not_run_again(tmp_path: Path) -> None:
    told, errors = run_script(tmp_path, 0).communicate(timeout=60)
    assert [line.split(" <")[0] for line in told.splitlines()] == [
        "script",
        "set up",
        "True",
        "sleeping",
    ]
    assert not errors


def test_ctrl_c_in_a_terminal_ends_all_of_them_and_only_the_first_says_so(tmp_path: Path) -> None:
    process = run_script(tmp_path, 60)
    assert process.stdout is not None
    assert any(line == "sleeping\n" for line in process.stdout)
    time.sleep(0.2)
    begun = time.monotonic()
    os.killpg(process.pid, signal.SIGINT)
    _, errors = process.communicate(timeout=30)
    assert time.monotonic() - begun < 10, "it waited for the work"
    assert errors.count("Traceback") == 1
    assert "KeyboardInterrupt" in errors
    assert ends(process.pid), "one of them lives on"


def test_they_end_if_the_first_is_killed(tmp_path: Path) -> None:
    process = run_script(tmp_path, 60)
    assert process.stdout is not None
    assert any(line == "sleeping\n" for line in process.stdout)
    process.kill()
    process.communicate(timeout=30)  # until none of them holds its output
    assert ends(process.pid), "one of them lives on"


def ends(group: int) -> bool:
    """Wait for a group of processes; multiprocessing's own helper may be the last."""
    for _ in range(100):
        try:
            os.killpg(group, 0)
        except ProcessLookupError:
            return True
        time.sleep(0.1)
    return False


def test_an_interrupted_command_leaves_no_warning_of_its_processes(tmp_path: Path) -> None:
    (tmp_path / "ending.py").write_text(
        "from usdface.cli.console import exit_at_once\n"
        "from usdface.core.processes import worker_processes\n"
        "with worker_processes(1, print) as give_work:\n"
        "    give_work(abs, -1).result()\n"
        "    kept = give_work\n"
        "exit_at_once(3)\n"
    )
    line = [sys.executable, str(tmp_path / "ending.py")]
    ended = subprocess.run(line, capture_output=True, text=True, timeout=60, check=False)
    assert (ended.returncode, ended.stderr) == (3, "")


def test_work_that_fails_is_raised_here() -> None:
    with (
        pytest.raises(ZeroDivisionError),
        worker_processes(1, print) as give_work,
    ):
        give_work(divmod, 1, 0).result()


def test_an_error_does_not_wait_for_the_background_threads() -> None:
    ended, waiting = Event(), []
    with suppress(ZeroDivisionError), background_threads() as submit:
        waiting += [submit(ended.wait, 60) for _ in range(2)]
        divmod(1, 0)
    assert not waiting[0].done()
    assert waiting[1].cancelled()
    ended.set()
    with background_threads() as submit:
        work = submit(time.sleep, 0.1)
    assert work.done()


def test_there_are_as_many_as_are_wanted_or_as_there_are_cores(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    assert 1 <= process_count() <= (os.cpu_count() or 1)
    assert process_count(5) == 5
    monkeypatch.setattr(sys, "orig_argv", ["/opt/maya/bin/maya.bin"])
    assert process_count(5) == process_count() == 1


def test_threads_return_results_in_the_order_of_the_items() -> None:
    assert map_threads(lambda item: item**2, range(50)) == [item**2 for item in range(50)]
    assert map_threads(abs, []) == []
    with pytest.raises(ZeroDivisionError):
        map_threads(lambda item: 1 / item, range(5))
