"""Cost of a take by step: fixed and per frame, and extrapolated to an hour and a season.

The demo's actor is repeated in two takes of different length. Each step is the installed command in
a separate process; times are processor times. The line through both lengths is the cost model of
`docs/scale.md`. `scaling` measures whether costs are linear, and their growth in markers,
references, shapes and points.
"""

import tempfile
from pathlib import Path

from benchmarks._long_take import write_captures
from benchmarks._process import Cost, measure_usdface
from tests.steps.small_shot import make_inputs
from usdface.runner.job import run_job
from usdface.specs.reading import read_job

SHORT, LONG = 6_000, 18_000
HOUR = 432_000
SEASON, SEASON_FRAMES = 500, 7_200
"""A season: 500 takes of a minute at 120 frames per second."""


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
    for step, ((few, few_disk), (many, many_disk)) in rows:
        slope = (many.seconds - few.seconds) / (long - short)
        begin = few.seconds - slope * short
        memory = (many.peak_mb - few.peak_mb) / (long - short)
        base = few.peak_mb - memory * short
        disk = (many_disk - few_disk) / (long - short)
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
    make_inputs(folder)
    job = read_job(folder / "shot.job.yaml")
    wanted = [step for step in job.steps if step.step not in ("map", "sheet")]
    run_job(job.model_copy(update={"steps": tuple(wanted)}))
    write_captures(folder, lengths)


def _cost(folder: Path, words: str, made: str, frames: int) -> tuple[Cost, float]:
    """Return the cost of a command, and the size of its files [MB]."""
    cost = measure_usdface(folder, words.format(n=frames))
    size = sum(path.stat().st_size for path in folder.glob(made.format(n=frames)))
    return cost, size / 1e6
