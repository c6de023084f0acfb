"""Waiting times of users, with their goals, for one or two versions.

Each wait is the installed command in a separate process, the median of three runs (`--quick`: one).
`USDFACE_BEFORE` names the `pipeline` folder of another checkout, whose commands are run in
alternation. Processor seconds are comparable on a busy machine, elapsed seconds only on a quiet
one.
"""

import os
import subprocess
import sys
import tempfile
from dataclasses import dataclass, replace
from pathlib import Path
from statistics import median

import numpy as np

from benchmarks._process import Cost, measure
from tests.c3d_write import write_c3d
from usdface.core.arrays import columns_by_name
from usdface.core.assets import Rig
from usdface.demo.acting import performance
from usdface.demo.capture import ActorFace
from usdface.demo.head import HeadPart
from usdface.demo.rig import demo_rig, make_head
from usdface.demo.sculpt import ACTOR
from usdface.usdio.rig.write import write_rig

RUNS = 3
DENSE_MARKERS, DENSE_FRAMES = 1000, 400
SHAPES = 946


@dataclass(frozen=True)
class Wait:
    """A command, and its goal."""

    name: str
    words: str
    goal_seconds: float
    """Elapsed time on a quiet machine with two cores."""


WAITS = (
    Wait("`usdface --help`", "--help", 0.28),
    Wait("`map --help`", "map --help", 0.25),
    Wait("`demo`, whole", "demo --out {run}.demo", 30),
    Wait("`train`, 50 references × 51 shapes", "train demo/demo.references.usda --out t.usdc", 5),
    Wait(
        "`sheet`, 12 rows, final",
        "sheet demo/demo.character.usda --take demo/demo.clean.take.usda --out s.jpg",
        5,
    ),
    Wait(
        "`report`, 15 s, every frame",
        "report demo/demo.character.usda --take demo/demo.clean.take.usda --out r.html",
        8,
    ),
    Wait(
        "`movie`, draft, 640 × 360, 361 pictures",
        "movie demo/demo.character.usda --take demo/demo.clean.take.usda --height 360 --rate 24 "
        "--out m.mp4",
        36,
    ),
    Wait(
        f"`select`, {SHAPES} shapes, no in-betweens",
        "select demo/demo.clean.take.usda --rig many.rig.usdc --count 100 --out many.usda",
        20,
    ),
    Wait(
        f"`clean`, {DENSE_MARKERS:,} markers × {DENSE_FRAMES} frames",
        "clean dense.take.usda --out dense.clean.take.usda",
        20,
    ),
)


def run(*, quick: bool = False) -> None:
    """Print the table of waits."""
    before = os.environ.get("USDFACE_BEFORE")
    sources = ([Path(before)] if before else []) + [Path(__file__).parents[1] / "pipeline"]
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for source in sources:
            words = [sys.executable, "-m", "compileall", "-q", str(source)]
            subprocess.run(words, env=_environment(source), check=True)
        _prepare(folder)
        print("| wait | processor s | elapsed s | MB | goal, elapsed s |")
        print("|---|---|---|---|---|")
        for wait in WAITS:
            costs: list[list[Cost]] = [[] for _ in sources]
            for number in range(1 if quick else RUNS):
                for index, (source, found) in enumerate(zip(sources, costs, strict=True)):
                    line = wait.words.format(run=f"{number}.{index}")
                    more = [] if "help" in line or line.startswith("demo") else ["--overwrite"]
                    found.append(_usdface(folder, source, line.split() + more))
            shown = [[median(getattr(c, key) for c in found) for found in costs] for key in _SHOWN]
            cells = (
                " → ".join(f"{value:.{2 if value < 10 else 0}f}" for value in row) for row in shown
            )
            print(f"| {wait.name} | {' | '.join(cells)} | {wait.goal_seconds:g} |", flush=True)


_SHOWN = ("seconds", "elapsed", "peak_mb")


def _usdface(folder: Path, source: Path, words: list[str]) -> Cost:
    return measure(
        folder, sys.executable, "-m", "usdface", *words, environment=_environment(source)
    )


def _environment(source: Path) -> dict[str, str]:
    """Return variables for a package with compiled bytecode, as installed by pip."""
    return os.environ | {
        "OPENBLAS_NUM_THREADS": "1",
        "PYTHONPATH": str(source),
        "PYTHONDONTWRITEBYTECODE": "",
    }


def _prepare(folder: Path) -> None:
    """Make a demo, a rig with 946 shapes and a take with 1,000 markers."""
    here = Path(__file__).parents[1] / "pipeline"
    _usdface(folder, here, ["demo", "--out", "demo"])
    write_rig(folder / "many.rig.usdc", many_shapes(SHAPES))
    rng = np.random.default_rng(0)
    head, acted = make_head(ACTOR), performance()
    front = (head.parts == HeadPart.SKIN) & (head.points[:, 2] > 0)
    face = ActorFace(head, rng.choice(np.flatnonzero(front), DENSE_MARKERS, replace=False))
    clip = acted.weights
    weights = columns_by_name(clip.values[:DENSE_FRAMES], clip.names, tuple(head.shapes))
    positions = np.stack([face.pose(row) for row in weights])
    positions += rng.normal(0, 0.15, positions.shape)
    seen = rng.random(positions.shape[:2]) > 0.01
    seen[0] = True
    names = tuple(f"m{number}" for number in range(DENSE_MARKERS))
    rate = acted.weights.rate
    write_c3d(
        folder / "dense.c3d", positions.astype(np.float32), seen, names, rate=rate, first_frame=1
    )
    _usdface(folder, here, "ingest dense.c3d --out dense.take.usda --neutral 1".split())


def many_shapes(shapes: int) -> Rig:
    """Return the demo's rig without in-betweens, with correctives that are parts of its shapes."""
    rig = demo_rig()
    own = rig.shapes
    count = shapes - len(own)
    names = tuple(f"corrective_{number}" for number in range(count))
    meshes = []
    for mesh in rig.meshes:
        plain = [replace(shape, keys=shape.keys[-1:]) for shape in mesh.shapes]
        by_name = {shape.name: shape for shape in plain}
        for number, name in enumerate(names):
            shape = by_name.get(own[number % len(own)])
            if shape is None:
                continue
            key = shape.keys[0]
            part = key.points[number // len(own) :: 7]  # parts of a shape differ
            offsets = 0.3 * key.offsets[number // len(own) :: 7]
            plain.append(
                replace(shape, name=name, keys=(replace(key, points=part, offsets=offsets),))
            )
        meshes.append(replace(mesh, shapes=tuple(plain)))
    ranges = np.tile([0.0, 1.0], (shapes, 1))
    return replace(rig, shapes=(*own, *names), meshes=tuple(meshes), ranges=ranges)
