"""SIGTERM, as a farm sends it: once, at any moment; and Ctrl+C, as a person does."""

import importlib
import os
import signal
import sys
import time
from pathlib import Path

import pytest

from usdface.cli import app, console
from usdface.errors import CancelledError


@pytest.fixture
def terminable():
    before = signal.getsignal(signal.SIGTERM)
    console.raise_on_terminate()
    yield
    signal.signal(signal.SIGTERM, before)


def stop_and_wait() -> None:
    os.kill(os.getpid(), signal.SIGTERM)
    wait()


def import_and_wait() -> None:
    importlib.import_module("slow_to_import")
    wait()


def wait() -> None:
    end = time.monotonic() + 10
    while time.monotonic() < end:
        time.sleep(0.01)


def test_it_becomes_an_exception_at_once(terminable) -> None:
    with pytest.raises(CancelledError):
        stop_and_wait()


def test_inside_an_import_it_waits_for_the_import_to_end(
    terminable, tmp_path: Path, monkeypatch
) -> None:
    stop = "os.kill(os.getpid(), signal.SIGTERM)"
    text = f"import os, signal, time\n{stop}\ntime.sleep(0.2)\nwhole = 1\n"
    (tmp_path / "slow_to_import.py").write_text(text, encoding="utf-8")
    monkeypatch.syspath_prepend(tmp_path)
    with pytest.raises(CancelledError):
        import_and_wait()
    assert sys.modules.pop("slow_to_import").whole == 1


def test_ctrl_c_ends_a_command_as_interrupted_and_says_so(
    terminable, tmp_path: Path, monkeypatch, capsys
) -> None:
    def interrupted(*given: object, **options: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("usdface.demo.job.run_demo", interrupted)
    with pytest.raises(SystemExit) as stopped:
        app.main(["demo", "--out", str(tmp_path)])
    assert stopped.value.code == 3
    assert "usdface: stopped on request; nothing half done was left" in capsys.readouterr().err
    monkeypatch.setattr("usdface.steps.edited.list_edits", interrupted)
    with pytest.raises(SystemExit) as stopped:  # a command of a group, too
        app.main(["edits", "list", "shot.usda"])
    assert stopped.value.code == 3
