"""An hour mapped in chunks by `openjd run`, relative to one process that maps it whole.

The take repeats the demo's actor for 432,000 frames. Both routes are the installed command on the
same files; elapsed time and processor time of all processes are measured. By default `usdface
submit` maps an hour in one task; it is also split into four, as value clips and merged. The time of
a task that only sleeps shows openjd's own cost, which is part of every row below.
"""

import os
import shutil
import sys
import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np
import yaml

from benchmarks._long_take import to_and_fro
from benchmarks._process import measure
from benchmarks._takes import markers_of
from tests.edited_weights import read_weights
from tests.steps.small_shot import make_inputs
from usdface.core.provenance import Provenance
from usdface.runner.job import run_job
from usdface.specs.reading import read_job
from usdface.usdio.take.read import read_take
from usdface.usdio.take.write import write_take

FRAMES = 432_000
MOST_OVERHEAD = 1.1
ROUNDS = 9
LONG_ROUNDS = 3
"""Rounds of routes without a target."""
WHOLE = "one process"
IDLE = "openjd run of a task that waits as long"


def run(frames: int = FRAMES) -> None:
    """Print processor and elapsed times of each route, and whether its weights are equal."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        _make_shot(folder, frames)
        print(f"{frames:,} frames; target {MOST_OVERHEAD}; medians of rounds\n")
        print("| route | rounds | tasks | processor s | ratio | elapsed s | ratio | equal |")
        print("|---|---|---|---|---|---|---|---|")
        quarter = ("--chunk", str(-(-frames // 4)))
        routes = {
            "openjd run, chunks as by default": ("default", ()),
            "openjd run, four chunks as value clips": ("clips", (*quarter, "--clips", "always")),
            "openjd run, four chunks merged": ("merged", (*quarter, "--clips", "never")),
        }
        found: dict[str, list[tuple[float, float]]] = {WHOLE: [], IDLE: []}
        for turn in range(ROUNDS):
            found[WHOLE].append(_timed(_job(folder, f"whole{turn}"), "usdface", "run"))
            for label, (name, options) in routes.items():
                if turn < LONG_ROUNDS or not options:
                    job = _job(folder, f"{name}{turn}")
                    found.setdefault(label, []).append(_timed(job, "usdface", "submit", *options))
            if turn < LONG_ROUNDS:
                idle = _idle(folder, found[WHOLE][-1][1])
                found[IDLE].append(_timed(idle, "openjd", "run"))
        for label, seconds in found.items():
            name = routes[label][0] if label in routes else ""
            bundle = f"{name}0.job-*.bundle/tasks/*/*.yaml"
            tasks = len(list(folder.glob(bundle))) if name else 1
            equal = str(_equal(folder, f"{name}0")) if name else ""
            ratios = np.array(seconds) / np.array(found[WHOLE][: len(seconds)])
            (used, elapsed), (own, other) = np.median(seconds, axis=0), np.median(ratios, axis=0)
            print(
                f"| {label} | {len(seconds)} | {tasks} | {used:.1f} | {own:.2f} "
                f"| {elapsed:.1f} | {other:.2f} | {equal} |",
                flush=True,
            )


def _make_shot(folder: Path, frames: int) -> None:
    """Train on a few seconds of the demo's actor, and repeat them into a long cleaned take."""
    make_inputs(folder)
    job = read_job(folder / "shot.job.yaml")
    wanted = [step for step in job.steps if step.step not in ("map", "sheet")]
    run_job(job.model_copy(update={"steps": tuple(wanted)}))
    take = read_take(folder / "shot.clean.take.usda")
    markers = markers_of(take)
    again = to_and_fro(frames, len(markers.positions))
    long = replace(
        take,
        markers=replace(
            markers,
            positions=markers.positions[again],
            visible=markers.visible[again],
            confidence=markers.confidence[again],
        ),
        head_motion=None if take.head_motion is None else take.head_motion[again],
    )
    write_take(folder / "long.take.usda", long, provenance=Provenance())


def _job(folder: Path, name: str) -> Path:
    steps = [
        {
            "step": "map",
            "take": "long.take.usda",
            "mapping": "hero.mapping.usdc",
            "rig": "hero.usdc",
            "out": f"{name}.usda",
        }
    ]
    file = folder / f"{name}.job.yaml"
    file.write_text(yaml.safe_dump({"job": name, "steps": steps}), encoding="utf-8")
    return file


def _idle(folder: Path, seconds: float) -> Path:
    """Write a job of one task that sleeps, to measure openjd's own cost."""
    action = {"onRun": {"command": "sleep", "args": [f"{seconds:.1f}"]}}
    job = {
        "specificationVersion": "jobtemplate-2023-09",
        "name": "idle",
        "steps": [{"name": "idle", "script": {"actions": action}}],
    }
    file = folder / "idle.yaml"
    file.write_text(yaml.safe_dump(job), encoding="utf-8")
    return file


def _timed(job: Path, *command: str) -> tuple[float, float]:
    """Return processor and elapsed time of a command with its child processes [s]."""
    found = shutil.which(command[0], path=str(Path(sys.executable).parent)) or command[0]
    cost = measure(job.parent, found, *command[1:], str(job), environment=dict(os.environ))
    return cost.seconds, cost.elapsed


def _equal(folder: Path, name: str) -> bool:
    whole, chunked = (read_weights(folder / f"{each}.usda") for each in ("whole0", name))
    return whole.names == chunked.names and bool(np.array_equal(whole.values, chunked.values))
