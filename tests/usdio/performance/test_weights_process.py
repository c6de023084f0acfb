"""A process of its own that writes weights: the same bytes, and nothing left when it goes wrong."""

import contextlib
import io
import json
import os
import shutil
import signal
import subprocess
import sys
from collections.abc import Iterator
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest

from tests.usdio.small_rig import small_rig
from usdface.core.assets import Rig
from usdface.core.errors import InputError
from usdface.core.provenance import Provenance
from usdface.usdio.performance import weights_process
from usdface.usdio.performance.weights_layer import WeightsHeader, without_samples, writing_weights
from usdface.usdio.performance.weights_process import FrameWriter, write_received, writing_frames
from usdface.usdio.rig.read import read_rig
from usdface.usdio.rig.write import write_rig

HEADER = WeightsHeader(
    place="/Shot/Hero",
    shape_names=("jawOpen", 'odd "name"\n', "größer"),
    rate=Fraction(24000, 1001),
    first_frame=-3,
    last_frame=496,
    regions=("face", "mouth"),
    timecode_start="01:00:00:00",
)
MADE = Provenance(step="map", spec='{"a": 1}')


@pytest.fixture
def rig(tmp_path: Path) -> Rig:
    write_rig(tmp_path / "rig.usda", small_rig())
    return read_rig(tmp_path / "rig.usda")


@pytest.fixture
def apart(monkeypatch: pytest.MonkeyPatch) -> list[subprocess.Popen[bytes]]:
    """Every layer by a process; those that were started."""
    monkeypatch.setattr(weights_process, "MUCH", 1)
    monkeypatch.setattr(weights_process, "VALUES_AHEAD", 100)  # so that it is waited for
    monkeypatch.setattr(weights_process.os, "cpu_count", lambda: 2)
    started = []

    class Noted(subprocess.Popen[bytes]):
        def __init__(self, *args: object, **named: object) -> None:
            super().__init__(*args, **named)
            started.append(self)

    monkeypatch.setattr(weights_process.subprocess, "Popen", Noted)
    return started


def append_all(writer: FrameWriter, *, until: int = 500) -> None:
    rng = np.random.default_rng(0)
    weights, confidence, residual = rng.random((500, 3)), rng.random(500), rng.random((500, 2))
    confidence[200:] = 0.5  # a line, of which few samples are kept
    for start in range(0, until, 64):
        part = slice(start, min(start + 64, until))
        writer.append(weights[part], confidence=confidence[part], residual_mm=residual[part])


@contextlib.contextmanager
def nothing_changes(folder: Path) -> Iterator[None]:
    before = {each.name: each.read_bytes() for each in folder.iterdir()}
    yield
    assert {each.name: each.read_bytes() for each in folder.iterdir()} == before


def test_its_bytes_are_those_of_one_process(
    tmp_path: Path, rig: Rig, apart: list[subprocess.Popen[bytes]]
) -> None:
    for name, writing in (("one", writing_weights), ("two", writing_frames)):
        (tmp_path / name).mkdir()
        with writing(tmp_path / name / "a.weights.usdc", HEADER, rig, provenance=MADE) as writer:
            append_all(writer)
    assert [each.returncode for each in apart] == [0]
    one, two = ((tmp_path / name / "a.weights.usdc").read_bytes() for name in ("one", "two"))
    assert one == two
    assert [each.name for each in (tmp_path / "two").iterdir()] == ["a.weights.usdc"]


def test_a_short_take_and_another_programs_python_need_none(
    tmp_path: Path, rig: Rig, apart: list[subprocess.Popen[bytes]], monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "a.weights.usdc"
    # An embedded interpreter names the program, or the Python that is first in PATH.
    for name, value in (("executable", "/opt/maya/bin/maya.bin"), ("orig_argv", [])):
        with monkeypatch.context() as changed:
            changed.setattr(weights_process.sys, name, value)
            with writing_frames(path, HEADER, rig) as writer:
                append_all(writer)
    monkeypatch.undo()
    with writing_frames(path, HEADER, rig) as writer:
        append_all(writer)
    assert not apart


def test_it_imports_from_where_this_process_does(
    tmp_path: Path, rig: Rig, apart: list[subprocess.Popen[bytes]], monkeypatch: pytest.MonkeyPatch
) -> None:
    note = "import pathlib; pathlib.Path('imported').touch()"
    (tmp_path / "sitecustomize.py").write_text(note, encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    # The folder we are in, as a notebook has it; and a path that is no text, which is ignored.
    monkeypatch.setattr(sys, "path", ["", tmp_path / "other", *sys.path])
    path = tmp_path / "a.weights.usdc"
    with writing_frames(path, HEADER, rig) as writer:
        append_all(writer)
    assert (tmp_path / "imported").is_file()


def test_an_interrupt_from_the_terminal_is_for_the_one_that_solves(
    tmp_path: Path, rig: Rig, apart: list[subprocess.Popen[bytes]]
) -> None:
    with writing_frames(tmp_path / "a.weights.usdc", HEADER, rig) as writer:
        assert os.getpgid(apart[0].pid) != os.getpgid(0)
        append_all(writer)


def test_what_fails_here_ends_it_and_leaves_the_old_file(
    tmp_path: Path, rig: Rig, apart: list[subprocess.Popen[bytes]]
) -> None:
    path = tmp_path / "a.weights.usdc"
    path.write_bytes(b"old")

    def interrupted() -> None:
        with writing_frames(path, HEADER, rig) as writer:
            append_all(writer, until=300)
            raise KeyboardInterrupt

    with nothing_changes(tmp_path), pytest.raises(KeyboardInterrupt):
        interrupted()
    with (
        nothing_changes(tmp_path),
        pytest.raises(ValueError, match="300 frames were appended where 500 were announced"),
        writing_frames(path, HEADER, rig) as writer,
    ):
        append_all(writer, until=300)
    assert all(each.returncode is not None for each in apart)


def test_a_process_that_is_killed_is_told(
    tmp_path: Path, rig: Rig, apart: list[subprocess.Popen[bytes]]
) -> None:
    path = tmp_path / "a.weights.usdc"

    def killed() -> None:
        with writing_frames(path, HEADER, rig) as writer:
            apart[0].send_signal(signal.SIGKILL)
            append_all(writer)

    told = r"a\.weights\.usdc: the process that writes it ended with -9"
    with nothing_changes(tmp_path), pytest.raises(InputError, match=told):
        killed()


def test_what_it_cannot_save_is_told_in_its_words(
    tmp_path: Path, rig: Rig, apart: list[subprocess.Popen[bytes]]
) -> None:
    path = tmp_path / "there" / "a.weights.usdc"
    path.parent.mkdir()

    def without_folder() -> None:
        with writing_frames(path, HEADER, rig) as writer:
            append_all(writer)
            shutil.rmtree(path.parent)
            path.parent.write_text("no folder any more", encoding="utf-8")

    with pytest.raises(InputError, match=r"there/a\.weights\.usdc: USD (failed|could not)"):
        without_folder()
    assert [each.returncode for each in apart] == [1]


@pytest.mark.parametrize("left", [10, 1000, 3000])
def test_what_stops_before_its_end_is_removed(tmp_path: Path, rig: Rig, left: int) -> None:
    temporary = tmp_path / ".a.usdc"
    sent = io.BytesIO()
    order = {
        "temporary": str(temporary),
        "path": "a.usdc",
        "header": vars(HEADER) | {"rate": "24"},
        "text": without_samples(HEADER, rig, None),
    }
    for told in (order, {"weights": [500, 3]}):
        sent.write(json.dumps(told).encode() + b"\n")
    sent.write(np.zeros((500, 3), np.float32).tobytes())
    whole = sent.getvalue()
    with pytest.raises(EOFError):
        write_received(io.BytesIO(whole[:left] if left < 2000 else whole))
    assert not temporary.exists()
    write_received(io.BytesIO(whole + b"{}\n"))
    assert temporary.exists()
