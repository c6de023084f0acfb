"""SIGTERM, as a farm sends it: once, at any moment; and Ctrl+C, as a person does."""

import importlib
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from usdface.cli import app, console
from usdface.core.errors import CancelledError, InputError

KINDS: dict[signal.Signals, type[BaseException]] = {
    signal.SIGTERM: CancelledError,
    signal.SIGINT: KeyboardInterrupt,
}


@pytest.fixture
def terminable():
    before = {each: signal.getsignal(each) for each in KINDS}
    signal.signal(signal.SIGINT, signal.default_int_handler)
    hook = sys.unraisablehook
    console.raise_on_signals()
    yield
    sys.unraisablehook = hook
    for each, handler in before.items():
        signal.signal(each, handler)


def stop_and_wait(kind: signal.Signals) -> None:
    os.kill(os.getpid(), kind)
    wait()


def import_and_wait() -> None:
    importlib.import_module("slow_to_import")
    wait()


def wait() -> None:
    end = time.monotonic() + 10
    while time.monotonic() < end:
        time.sleep(0.01)


@pytest.mark.parametrize("kind", KINDS)
def test_it_becomes_an_exception_at_once(terminable, kind: signal.Signals) -> None:
    with pytest.raises(KINDS[kind]):
        stop_and_wait(kind)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("package", ["pxr", "OpenImageIO", None])
def test_some_imports_end_first_and_others_are_cut_short(
    terminable, tmp_path: Path, monkeypatch, package: str | None, kind: signal.Signals
) -> None:
    stop = f"os.kill(os.getpid(), {int(kind)})"
    name = f'__name__ = "{package}.module"\n' if package else ""
    text = f"{name}import os, signal, time\n{stop}\ntime.sleep(0.2)\nwhole = 1\n"
    (tmp_path / "slow_to_import.py").write_text(text, encoding="utf-8")
    monkeypatch.syspath_prepend(tmp_path)
    with pytest.raises(KINDS[kind] if package else KeyboardInterrupt):
        import_and_wait()
    module = sys.modules.pop("slow_to_import", None)
    assert getattr(module, "whole", None) == (1 if package else None)


@pytest.mark.parametrize("kind", KINDS)
def test_where_a_library_drops_the_exception_the_signal_comes_again(
    terminable, capsys, kind: signal.Signals
) -> None:
    class Dropping:  # an exception in a finalizer reaches nobody
        def __del__(self) -> None:
            stop_and_wait(kind)

    def drop_and_wait() -> None:
        dropping = Dropping()
        del dropping
        wait()

    with pytest.raises(KINDS[kind]):
        drop_and_wait()
    assert capsys.readouterr().err == ""


def test_a_process_that_ignores_ctrl_c_goes_on_doing_so(terminable) -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    console.raise_on_signals()
    assert signal.getsignal(signal.SIGINT) is signal.SIG_IGN


def test_ctrl_c_ends_a_command_as_interrupted_and_says_so(
    terminable, tmp_path: Path, monkeypatch, capsys
) -> None:
    def interrupted(*given: object, **options: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("usdface.demo.job.run_demo", interrupted)
    with pytest.raises(SystemExit) as stopped:
        app.main(["demo", "--out", str(tmp_path)])
    assert stopped.value.code == 3
    assert "usdface: interrupted; no partly written files remain" in capsys.readouterr().err
    monkeypatch.setattr("usdface.steps.edits.list_.list_edit_ranges", interrupted)
    with pytest.raises(SystemExit) as stopped:  # a command of a group, too
        app.main(["edits", "list", "shot.usda"])
    assert stopped.value.code == 3


@pytest.mark.parametrize("error", [ValueError("invalid bounding box"), InputError("no such prim")])
def test_an_error_that_a_library_makes_of_a_stop_is_a_stop(
    tmp_path: Path, monkeypatch, capsys, error: Exception
) -> None:
    def replaced(*given: object, **options: object) -> None:
        try:
            stop_and_wait(signal.SIGTERM)
        except CancelledError:
            raise error from None

    monkeypatch.setattr("usdface.demo.job.run_demo", replaced)
    with pytest.raises(SystemExit) as stopped:
        app.main(["demo", "--out", str(tmp_path)])
    assert stopped.value.code == 3
    lines = capsys.readouterr().err.splitlines()
    assert lines[1:] == ["usdface: interrupted; no partly written files remain"]


def test_a_thread_that_nobody_ends_does_not_keep_a_stopped_command(tmp_path: Path) -> None:
    program = """
import os, signal, sys, threading, time
from usdface.cli import main
import usdface.demo.job
def stopped(*given, **options):
    threading.Thread(target=threading.Event().wait).start()
    os.kill(os.getpid(), signal.SIGTERM)
    time.sleep(30)
usdface.demo.job.run_demo = stopped
sys.argv = ["usdface", "demo", "--out", sys.argv[1]]
main()
"""
    done = subprocess.run([sys.executable, "-c", program, tmp_path], timeout=30, check=False)
    assert done.returncode == 3
