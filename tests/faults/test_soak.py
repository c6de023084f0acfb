"""Many small jobs in one process, as a DCC or a service runs them: nothing piles up."""

import gc
import os
from pathlib import Path

import pytest

from tests.steps.small_shot import Shot
from usdface.runner.execute import execute
from usdface.runner.job import run_job
from usdface.specs.edits import BakeSpec
from usdface.specs.job import JobSpec
from usdface.specs.performance import MapSpec, TrainSpec
from usdface.steps.edits.validate import validate_layers

pytestmark = pytest.mark.faults

JOBS = int(os.environ.get("USDFACE_SOAK_JOBS", "100"))
WARM_UP = 0.3
"""Share of the jobs after which caches are full and memory should be flat."""

MOST_GROWTH_KB_A_JOB = 64
LEAST_GROWTH_KB = 8 << 10
"""The allocator's own unrest."""

PROCESS = Path("/proc/self")


def resident_kb() -> int:
    text = (PROCESS / "status").read_text()
    return int(text.split("VmRSS:")[1].split()[0])


def open_files() -> int:
    return len(list((PROCESS / "fd").iterdir()))


def threads() -> int:
    return len(list((PROCESS / "task").iterdir()))


def children() -> list[str]:
    tasks = (PROCESS / "task").iterdir()
    return [child for task in tasks for child in (task / "children").read_text().split()]


@pytest.mark.skipif(not PROCESS.is_dir(), reason="memory is read from /proc")
def test_many_jobs_leave_nothing_behind(shot: Shot) -> None:
    folder = shot.folder
    execute(
        TrainSpec(
            references=folder / "hero.references.usda",
            out=folder / "quick.mapping.usdc",
            method="ridge",
        )
    )
    warm: tuple[int, int, int] | None = None
    for number in range(JOBS):
        first = 1 + 8 * (number % 40)
        mapped = MapSpec(
            take=folder / "shot.clean.take.usda",
            mapping=folder / "quick.mapping.usdc",
            rig=folder / "hero.usdc",
            out=folder / "soak.hero.usda",
            frames=f"{first}-{first + 31}",
        )
        baked = BakeSpec(performance=mapped.out, out=folder / "soak.baked.usdc")
        run_job(JobSpec(job=f"soak {number}", steps=(mapped, baked)), overwrite=True)
        validate_layers((mapped.out,))
        if number == int(WARM_UP * JOBS):
            gc.collect()
            warm = resident_kb(), open_files(), threads()
    gc.collect()
    assert warm is not None
    grown = resident_kb() - warm[0]
    counted = JOBS - int(WARM_UP * JOBS) - 1
    told = (
        f"{counted} jobs after {JOBS - counted}: {grown:+} KB, {open_files() - warm[1]:+} files, "
    )
    told += f"{threads() - warm[2]:+} threads, {len(children())} processes, at {resident_kb()} KB"
    print(told)  # noqa: T201 - `pytest -s` shows what docs/security.md quotes
    assert open_files() <= warm[1]
    assert threads() <= warm[2]
    assert children() == []
    assert grown <= LEAST_GROWTH_KB + MOST_GROWTH_KB_A_JOB * counted, f"{grown} KB, {counted} jobs"
    assert not [each for each in folder.iterdir() if each.name.startswith(".")]
