"""A mapping killed at any moment: no half file, edits intact, the rerun as if nothing had been."""

import os
import re
import resource
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from pxr import Sdf

from tests.steps.small_shot import Shot
from usdface.core.sidecars import edits_path
from usdface.runner.execute import execute
from usdface.specs.edits import EditSpec
from usdface.specs.performance import TrainSpec

SLOW = """
import sys, time
from pathlib import Path
from usdface.usdio.performance import weights_layer
from usdface.specs.performance import MapSpec
from usdface.steps.performance import map as map_step
from usdface.runner.execute import execute
from usdface.cli.console import raise_on_signals

raise_on_signals()
# Many saves and many blocks, so that a signal can fall into each of them.
weights_layer.FRAMES_IN_MEMORY = 32
map_step.BLOCK_FRAMES = 16
folder = Path(sys.argv[1])
print("started", flush=True)
execute(
    MapSpec(
        take=folder / "shot.clean.take.usda",
        mapping=folder / "quick.mapping.usdc",
        rig=folder / "hero.usdc",
        out=folder / "out" / "shot.hero.usda",
        chunk=int(sys.argv[2]) or None,
    ),
    overwrite=True,
)
"""


def start(folder: Path, chunk: int, limit: int | None = None) -> subprocess.Popen[str]:
    def limited() -> None:
        if limit is not None:
            resource.setrlimit(resource.RLIMIT_FSIZE, (limit, limit))

    process = subprocess.Popen(
        [sys.executable, "-c", SLOW, str(folder), str(chunk)],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        preexec_fn=limited,
        env=os.environ | {"PYTHONUNBUFFERED": "1"},
    )
    assert process.stdout is not None
    process.stdout.readline()
    return process


def contents(folder: Path) -> dict[str, bytes]:
    return {
        each.name: each.read_bytes() for each in folder.iterdir() if not each.name.startswith(".")
    }


def prepared(shot: Shot) -> tuple[Path, float]:
    """An edited performance in a folder of its own, and how long mapping it takes."""
    folder = shot.folder
    (folder / "out").mkdir()
    execute(
        TrainSpec(
            references=folder / "hero.references.usda",
            out=folder / "quick.mapping.usdc",
            method="ridge",
        )
    )
    before = time.perf_counter()
    done = start(folder, 0)
    _, told = done.communicate()
    assert done.returncode == 0, told
    took = time.perf_counter() - before
    path = folder / "out" / "shot.hero.usda"
    execute(EditSpec(performance=path, shape=("jawOpen",), add=0.2, frames="100-140", fade=5))
    return path, took


def check_whole(path: Path, edits: bytes) -> None:
    """Every file under a final name opens; the edits are as they were."""
    assert edits_path(path).read_bytes() == edits
    for each in path.parent.iterdir():
        if not each.name.startswith("."):
            layer = Sdf.Layer.OpenAsAnonymous(str(each))
            assert layer is not None, each
            for name in layer.ListAllTimeSamples()[:1]:
                assert np.isfinite(name)


@pytest.mark.slow
@pytest.mark.parametrize("chunk", [0, 100])
@pytest.mark.parametrize("kind", [signal.SIGKILL, signal.SIGTERM])
def test_killed_at_random(shot: Shot, kind: signal.Signals, chunk: int) -> None:
    path, took = prepared(shot)
    done = start(shot.folder, chunk)
    done.communicate()
    undisturbed, edits = contents(path.parent), edits_path(path).read_bytes()
    rng = np.random.default_rng(0)
    for _ in range(13):
        if rng.random() < 0.5:  # nothing is there yet, but for what the animator did
            for each in path.parent.iterdir():
                if each != edits_path(path):
                    each.unlink()
        process = start(shot.folder, chunk)
        time.sleep(float(rng.random()) * took * 0.6)
        process.send_signal(kind)
        process.communicate()
        check_whole(path, edits)
        rerun = start(shot.folder, chunk)
        _, told = rerun.communicate()
        assert rerun.returncode == 0, told
        assert contents(path.parent) == undisturbed
        assert not [each for each in path.parent.iterdir() if each.name.startswith(".")]


@pytest.mark.slow
@pytest.mark.parametrize("share", [0.05, 0.3, 0.6, 0.95])
def test_a_disk_that_is_full(shot: Shot, share: float) -> None:
    path, _ = prepared(shot)
    start(shot.folder, 0).communicate()
    undisturbed = contents(path.parent)
    largest = max(map(len, undisturbed.values()))
    for fresh in (False, True):
        if fresh:
            for each in path.parent.iterdir():
                if each != edits_path(path):
                    each.unlink()
        before = contents(path.parent)
        process = start(shot.folder, 0, limit=int(share * largest))
        _, told = process.communicate()
        assert process.returncode != 0
        assert re.search(r"shot\.hero.*(too large|is the disk full)", told), told
        assert contents(path.parent) == before
    start(shot.folder, 0).communicate()
    assert contents(path.parent) == undisturbed


@pytest.mark.slow
def test_the_folder_is_removed_meanwhile(shot: Shot) -> None:
    path, took = prepared(shot)
    start(shot.folder, 0).communicate()
    undisturbed = contents(path.parent)
    kept = shot.folder / "kept"
    for share in (0.1, 0.25, 0.4, 0.55):
        shutil.copytree(path.parent, kept)
        process = start(shot.folder, 0)
        time.sleep(share * took * 0.6)
        shutil.rmtree(path.parent, ignore_errors=True)
        process.communicate()
        shutil.rmtree(path.parent, ignore_errors=True)
        kept.rename(path.parent)
        assert contents(path.parent) == undisturbed
        assert start(shot.folder, 0).communicate() is not None
        assert contents(path.parent) == undisturbed


@pytest.mark.slow
def test_two_that_map_into_the_same_file(shot: Shot) -> None:
    path, _ = prepared(shot)
    processes = [start(shot.folder, 0) for _ in range(2)]
    told = [process.communicate()[1] for process in processes]
    codes = [process.returncode for process in processes]
    lost = [text for code, text in zip(codes, told, strict=True) if code]
    assert 0 in codes
    assert all("another process is writing it" in text for text in lost)
    start(shot.folder, 0).communicate()
    once = contents(path.parent)
    start(shot.folder, 0).communicate()
    assert contents(path.parent) == once
