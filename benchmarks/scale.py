"""Cost of a take by step: fixed and per frame, and extrapolated to an hour and a season.

The demo's actor is repeated in two takes of different length. Each step is the installed command in
a separate process; times are processor times. The line through both lengths is the cost model of
`docs/scale.md`. `scaling` measures whether costs are linear, and their growth in markers,
references, shapes and points.
"""

import json
import os
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np

SHORT, LONG = 6_000, 18_000
NOISE_MM = 0.1
"""Noise of every frame, since USD stores equal samples once."""

HOUR = 432_000
SEASON, SEASON_FRAMES = 500, 7_200
"""A season: 500 takes of a minute at 120 frames per second."""


@dataclass(frozen=True)
class Cost:
    """Cost of a run of a command."""

    seconds: float
    peak_mb: float
    disk_mb: float


def run(short: int = SHORT, long: int = LONG) -> None:
    """Print measured costs, the fitted line, and its values for an hour and a season."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        _prepare(folder, (short, long))
        rows = []
        for step, words, made in (
            ("ingest", "ingest {n}.c3d --out {n}.take.usda --neutral 31", "{n}.take*"),
            ("clean", "clean {n}.take.usda --out {n}.clean.take.usda", "{n}.clean*"),
            (
                "map",
                "map {n}.clean.take.usda --mapping hero.mapping.usdc --rig hero.usdc "
                "--out {n}.hero.usda",
                "{n}.hero*",
            ),
        ):
            rows.append((step, [_cost(folder, words, made, n) for n in (short, long)]))
    print(f"24 pairs, `auto`; seconds of the processor at {short:,} and {long:,} frames\n")
    print(
        "| step | short | long | to begin [s] | ms a frame | MB at first | KB a frame | "
        "disk, B a frame |"
    )
    print("|---|---|---|---|---|---|---|---|")
    lines = []
    for step, (few, many) in rows:
        slope = (many.seconds - few.seconds) / (long - short)
        begin = few.seconds - slope * short
        memory = (many.peak_mb - few.peak_mb) / (long - short)
        base = few.peak_mb - memory * short
        disk = (many.disk_mb - few.disk_mb) / (long - short)
        lines.append((step, begin, slope, base, memory))
        print(
            f"| {step} | {few.seconds:.1f} | {many.seconds:.1f} | {begin:.1f} | {1e3 * slope:.2f} "
            f"| {base:.0f} | {1e3 * memory:.1f} | {1e6 * disk:.0f} |"
        )
    print("\n| step | an hour [min] | peak [GB] | 500 takes of a minute [core hours] |")
    print("|---|---|---|---|")
    for step, begin, slope, base, memory in lines:
        season = SEASON * (begin + slope * SEASON_FRAMES) / 3600
        print(
            f"| {step} | {(begin + slope * HOUR) / 60:.1f} | {(base + memory * HOUR) / 1e3:.1f} "
            f"| {season:.1f} |"
        )


def _prepare(folder: Path, lengths: tuple[int, ...]) -> None:
    """Train on the small shot, and write captures that repeat it."""
    from tests.c3d_write import write_c3d
    from tests.steps.small_shot import make_inputs
    from usdface.demo.acting import performance
    from usdface.demo.capture import demo_markers, simulate_capture
    from usdface.demo.rig import make_head
    from usdface.demo.sculpt import ACTOR
    from usdface.runner.job import run_job
    from usdface.specs.reading import read_job

    make_inputs(folder)
    job = read_job(folder / "shot.job.yaml")
    wanted = [step for step in job.steps if step.step not in ("map", "sheet")]
    run_job(job.model_copy(update={"steps": tuple(wanted)}))
    actor, acted = make_head(ACTOR), performance()
    markers = demo_markers(actor)
    captured = simulate_capture(actor, acted, markers)
    count = len(captured.positions)
    rng = np.random.default_rng(0)
    for frames in lengths:
        again = np.abs((np.arange(frames) + count - 1) % (2 * count - 2) - (count - 1))
        write_c3d(
            folder / f"{frames}.c3d",
            captured.positions[again]
            + rng.normal(0, NOISE_MM, (frames, *captured.positions.shape[1:])),
            captured.visible[again],
            markers.names,
            rate=acted.weights.rate,
            first_frame=1,
        )


_LAUNCH = """
import json, os, subprocess, sys
process = subprocess.Popen(sys.argv[1:], stdout=subprocess.DEVNULL)
_, status, used = os.wait4(process.pid, 0)
process.returncode = os.waitstatus_to_exitcode(status)
print(json.dumps([process.returncode, used.ru_utime + used.ru_stime, used.ru_maxrss]))
"""
"""Small intermediate process, since Linux counts the parent's memory in the child's peak."""


def _cost(folder: Path, words: str, made: str, frames: int) -> Cost:
    command = [sys.executable, "-m", "usdface", *words.format(n=frames).split()]
    environment = os.environ | {"OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"}
    done = subprocess.run(
        [sys.executable, "-c", _LAUNCH, *command],
        cwd=folder,
        env=environment,
        stdout=subprocess.PIPE,
        check=True,
    )
    code, seconds, peak_kb = json.loads(done.stdout)
    if code:
        raise SystemExit(f"{' '.join(command)} ended with {code}")
    size = sum(path.stat().st_size for path in folder.glob(made.format(n=frames)))
    return Cost(seconds, peak_kb / 1e3, size / 1e6)
