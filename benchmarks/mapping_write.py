"""Mapping and writing a long take, relative to the bare USD write of the same array.

432,000 frames are an hour at 120 frames per second. Markers are simulated: an actor moves from one
expression of a repertoire to the next. Their generation is not timed. The target is for elapsed
time on two cores; processor time depends less on other work on the machine. Every route is a
separate process, with one thread for products as in the commands, so that its peak memory is
measured.
"""

import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterable, Iterator
from fractions import Fraction
from functools import partial
from pathlib import Path
from statistics import median

import numpy as np

FRAMES = 432_000
MARKERS, RIGID, SHAPES, MANY, PAIRS = 102, 12, 46, 946, 100
BLOCK = 4096
METHODS = ("ridge", "rbf", "face_map")
EXPRESSIONS, KEY_SECONDS = 24, 0.4

ROUNDS = 3
QUICK_FRAMES = 144_000
MOST_TIME = 4.0
MOST_MEMORY = 0.2


def run(quick: bool = False) -> None:
    """Print times as ratios to the bare write, and peaks of memory as ratios to the raw array."""
    frames = QUICK_FRAMES if quick else FRAMES
    targets = {"bare": "", "weights": "", "performance": ""}
    targets |= dict.fromkeys(METHODS, str(MOST_TIME))
    rounds = [{name: _route(name, frames) for name in targets} for _ in range(ROUNDS)]
    print(
        f"{frames:,} frames x {SHAPES} weights; ratios to the bare write of the same round, "
        f"medians of {ROUNDS}\n"
    )
    print("| route | elapsed s | ratio | target | processor s | its ratio |")
    print("|---|---|---|---|---|---|")
    for name, target in targets.items():
        cells = []
        for key in ("elapsed", "seconds"):
            spent = [each[name][key] for each in rounds]
            ratios = [each[name][key] / each["bare"][key] for each in rounds]
            cells += [f"{median(spent):.1f}", f"{median(ratios):.2f}"]
        label = _LABELS.get(name, f"mapped ({name}) and written")
        print(f"| {label} | {cells[0]} | {cells[1]} | {target} | {cells[2]} | {cells[3]} |")
    raw = frames * MANY * 4 / 1e6
    print(f"\n{frames:,} frames x {MANY} weights, {raw:.0f} MB raw; peaks beyond the start\n")
    print("| route | peak MB | ratio | target |")
    print("|---|---|---|---|")
    for name in ("one layer", "parts"):
        cost = _route(name, frames)
        ratio = cost["peak_mb"] / raw
        print(f"| {name} | {cost['peak_mb']:.0f} | {ratio:.2f} | {MOST_MEMORY} |", flush=True)


_LABELS = {
    "bare": "bare write",
    "weights": "our writer, weights alone",
    "performance": "our writer, with uncertainty and residual",
}


def _route(name: str, frames: int) -> dict[str, float]:
    """Run one route in a separate process."""
    done = subprocess.run(
        [sys.executable, "-m", "benchmarks.mapping_write", name, str(frames)],
        capture_output=True,
        text=True,
        check=True,
        env=os.environ | {"OPENBLAS_NUM_THREADS": "1"},
    )
    cost: dict[str, float] = json.loads(done.stdout.splitlines()[-1])
    return cost


def _peak_mb() -> float:
    """Return the peak memory of this process; `getrusage` includes that of the parent."""
    lines = Path("/proc/self/status").read_text(encoding="utf-8").splitlines()
    return next(int(line.split()[1]) for line in lines if line.startswith("VmHWM")) / 1000


def _weights(frames: int, shapes: int) -> Callable[[int], np.ndarray]:
    """Return blocks of weights that are cheap to make and differ in every frame."""
    rng = np.random.default_rng(0)
    waves = (0.5 + 0.4 * np.sin(rng.random((BLOCK, shapes)) * 6)).astype(np.float32)

    def block(start: int) -> np.ndarray:
        return waves[: frames - start] * np.float32(1 - 0.5 * start / frames)

    return block


def _bare(folder: Path, frames: int) -> dict[str, float]:
    from pxr import Sdf, Vt

    block = _weights(frames, SHAPES)
    layer = Sdf.Layer.CreateNew(str(folder / "bare.usdc"))
    prim = Sdf.CreatePrimInLayer(layer, "/Anim")
    path = Sdf.AttributeSpec(prim, "blendShapeWeights", Sdf.ValueTypeNames.FloatArray).path
    begun = _now()
    for start in range(0, frames, BLOCK):
        for index, row in enumerate(block(start)):
            layer.SetTimeSample(path, start + index, Vt.FloatArray.FromNumpy(row))
    layer.Save()
    return _since(begun)


def _now() -> tuple[float, float]:
    return time.perf_counter(), time.process_time()


def _since(
    begun: tuple[float, float], *, less: tuple[float, float] = (0.0, 0.0)
) -> dict[str, float]:
    elapsed, seconds = _now()
    return {"elapsed": elapsed - begun[0] - less[0], "seconds": seconds - begun[1] - less[1]}


def _written(
    folder: Path,
    frames: int,
    shapes: int,
    solved: Iterable[tuple[np.ndarray, np.ndarray | None]],
    *,
    part_frames: int | None = None,
) -> None:
    from tests.usdio.small_rig import small_rig
    from usdface.usdio.performance.weights_layer import SolveFigures, make_header
    from usdface.usdio.performance.write import writing_performance
    from usdface.usdio.rig.read import read_rig
    from usdface.usdio.rig.write import write_rig

    write_rig(folder / "rig.usda", small_rig())
    with writing_performance(
        folder / "a.usda",
        make_header(
            read_rig(folder / "rig.usda"),
            shape_names=tuple(f"shape{i}" for i in range(shapes)),
            rate=Fraction(120),
            first_frame=0,
            last_frame=frames - 1,
            regions=("face",),
        ),
        read_rig(folder / "rig.usda"),
        part_frames=part_frames,
    ) as writer:
        for weights, trust in solved:
            writer.append(weights, SolveFigures(uncertainty_mm=trust, residual_mm=trust))


def _acted(rng: np.random.Generator) -> Callable[[np.ndarray], np.ndarray]:
    """Return weights over time [s]: from one expression to the next, with varying amplitude."""
    poses = rng.random((EXPRESSIONS, SHAPES)) * (rng.random((EXPRESSIONS, SHAPES)) < 0.35)
    keys = rng.integers(EXPRESSIONS, size=int(FRAMES / 120 / KEY_SECONDS) + 2)
    strength = rng.uniform(0.3, 1.0, len(keys))

    def weights(seconds: np.ndarray) -> np.ndarray:
        at = seconds / KEY_SECONDS
        key = at.astype(int)
        share = (at - key)[:, None]
        share = share * share * (3 - 2 * share)
        before, after = (poses[keys[k]] * strength[k, None] for k in (key, key + 1))
        return (1 - share) * before + share * after

    return weights


def _mapped(folder: Path, frames: int, method: str) -> dict[str, float]:
    from usdface.core.assets import References
    from usdface.model.mapping.head_space import MappedMarkers
    from usdface.model.mapping.motion_space import fit_motion_space
    from usdface.model.mapping.train import train_mapping
    from usdface.steps.performance.map import MarkerSource, predict_pipelined

    rng = np.random.default_rng(0)
    neutral = rng.uniform(-70, 70, (MARKERS, 3))
    moves = 4 * rng.normal(size=(SHAPES, MARKERS, 3)) * (rng.random((SHAPES, MARKERS, 1)) < 0.3)
    moves[:, :RIGID] = 0
    acted = _acted(rng)

    def markers(start: int, count: int) -> tuple[np.ndarray, np.ndarray]:
        weights = acted((start + np.arange(count)) / 120)
        moved = neutral + np.tensordot(weights, moves, 1)
        noise = np.random.default_rng(start).normal(0, 0.05, moved.shape)
        return (moved + noise).astype(np.float32), weights

    clouds, truth = markers(0, 6000)
    picks = np.linspace(0, 5999, PAIRS).astype(int)
    mapping = train_mapping(
        References(
            marker_names=tuple(f"m{i}" for i in range(MARKERS)),
            shape_names=tuple(f"shape{i}" for i in range(SHAPES)),
            markers=clouds[picks].astype(float),
            weights=truth[picks],
            frames=picks,
            takes=("take",) * PAIRS,
            tuned=np.ones(PAIRS, dtype=bool),
            rigid=tuple(f"m{i}" for i in range(RIGID)),
            neutral=neutral,
            rig_file=Path("rig.usd"),
            rig_prim="/Rig",
            motion=fit_motion_space([clouds]),
        ),
        ranges=np.tile([0.0, 1.0], (SHAPES, 1)),
        gram=np.einsum("smc,tmc->st", moves, moves) / MARKERS,
        skin=moves,
        method=method,
    )
    clouds, _ = markers(0, 10 * BLOCK)
    visible, sure = np.ones((BLOCK, MARKERS), dtype=bool), np.ones((BLOCK, MARKERS), np.float32)

    def placed() -> Iterator[MarkerSource]:
        for start in range(0, frames, BLOCK):
            part = clouds[start % len(clouds) :][: min(BLOCK, frames - start)]
            yield partial(MappedMarkers, part, visible[: len(part)], sure[: len(part)])

    begun = _now()
    answers = (
        (each.weights, each.uncertainty[:, :1]) for each in predict_pipelined(mapping, placed())
    )
    _written(folder, frames, SHAPES, answers)
    return _since(begun)


def _measure(name: str, frames: int) -> dict[str, float]:
    with tempfile.TemporaryDirectory() as folder:
        where = Path(folder)
        if name == "bare":
            return _bare(where, frames)
        # Imports do not depend on the length of a take and are not timed.
        _written(where, BLOCK, SHAPES, [(_weights(BLOCK, SHAPES)(0), None)])
        if name in ("weights", "performance"):
            # A slow wave, and the effect of marker noise of 0.05 mm.
            trust = 0.9 + 0.05 * np.sin(np.arange(BLOCK) / 20)
            trust += np.random.default_rng(0).normal(0, 0.003, BLOCK)
            block = _weights(frames, SHAPES)
            rows = (block(start) for start in range(0, frames, BLOCK))
            begun = _now()
            with_trust = name == "performance"
            _written(
                where,
                frames,
                SHAPES,
                ((r, trust[: len(r), None] if with_trust else None) for r in rows),
            )
            return _since(begun)
        if name in ("one layer", "parts"):
            block = _weights(frames, MANY)

            def solved(count: int) -> Iterator[tuple[np.ndarray, None]]:
                return ((block(start)[: count - start], None) for start in range(0, count, BLOCK))

            _written(where, 2 * BLOCK, MANY, solved(2 * BLOCK))  # imports modules
            before = _peak_mb()
            part_frames = (1 << 27) // (4 * MANY) if name == "parts" else None
            _written(where, frames, MANY, solved(frames), part_frames=part_frames)
            return {"peak_mb": _peak_mb() - before}
        return _mapped(where, frames, name)


if __name__ == "__main__":
    sys.stdout.write(json.dumps(_measure(sys.argv[1], int(sys.argv[2]))) + "\n")
