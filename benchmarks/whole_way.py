"""From capture to weights (ingest, clean, map), relative to the bare USD write of the weights.

Every stage is the installed command in a separate process. The lower bound is a process that only
passes rows of weights to USD and saves them. The bare write of the markers is given as well: the
stages write them twice and read them three times. The take repeats the demo's actor with noise; the
rigs have 46 and 946 shapes. `--full` runs an hour, 432,000 frames; otherwise two short takes are
run and extrapolated; `--quick` runs two shorter ones without extrapolation.
"""

import sys
import tempfile
from dataclasses import replace
from math import nan
from pathlib import Path

import numpy as np

from benchmarks._long_take import write_captures
from benchmarks._process import Cost, measure, measure_usdface
from benchmarks._takes import markers_of
from benchmarks.scale import HOUR
from tests.model.synthetic import sample_skin
from usdface.core.assets import Markers, MeshShape, References, Rig, WeightsClip
from usdface.core.deformer import Deformer
from usdface.core.provenance import Provenance
from usdface.demo.acting import performance
from usdface.demo.rig import demo_rig
from usdface.model.mapping.motion_space import fit_motion_space
from usdface.model.mapping.train import train_mapping
from usdface.usdio.mapping import write_mapping
from usdface.usdio.rig.read import read_rig
from usdface.usdio.rig.write import write_rig
from usdface.usdio.take.read import read_take

FRAMES = 12_000
SHAPES = (46, 946)
PAIRS = 50
METHOD = "face_map"
"""Method that `auto` chose on all data so far, named to shorten training."""
LEARNED_FRAMES = 1_500
WANTED = 4
"""Target of mapping and writing, relative to the bare write."""
MARKERS = 102
BARE_MARKERS = f"bare write of {MARKERS} markers, once"


def run(frames: int = FRAMES, *, full: bool = False, quick: bool = False) -> None:
    """Print each stage as seconds, and as a ratio to the bare write."""
    lengths: tuple[int, ...] = (
        (HOUR,) if full else (frames // 12, frames // 3) if quick else (frames // 4, frames)
    )
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        _prepare(folder, lengths)
        costs = {count: _way(folder, count) for count in lengths}
        measured = () if full or quick else SHAPES
        bare = {f"bare write, {n} shapes": _bare(folder, HOUR, n) for n in measured}
    for count, stages in costs.items():
        print(f"\n{count:,} frames, 102 markers, `{METHOD}`, {PAIRS} pairs: as measured\n")
        _table(stages)
    if not bare:  # an hour, or takes too short to extrapolate
        return
    few, many = (costs[count] for count in lengths)
    more = (HOUR - lengths[1]) / (lengths[1] - lengths[0])
    hour = {
        stage: Cost(
            bare[stage].seconds
            if stage in bare
            else cost.seconds + more * max(cost.seconds - few[stage].seconds, 0.0),
            nan,
            nan,
        )
        for stage, cost in many.items()
    }
    print(f"\nAn hour, {HOUR:,} frames: the bare write measured, the rest extrapolated\n")
    _table(hour)


def _table(stages: dict[str, Cost]) -> None:
    print("| stage | processor s | elapsed s | of the bare write | target |")
    print("|---|---|---|---|---|")
    for shapes in SHAPES:
        bare = stages[f"bare write, {shapes} shapes"]
        names = ("ingest", "clean", f"map and write, {shapes} shapes")
        whole = sum(stages[stage].seconds for stage in names)
        elapsed = sum(stages[stage].elapsed for stage in names)
        for label, cost, target in (
            (f"bare write, {shapes} shapes", bare, ""),
            (BARE_MARKERS, stages[BARE_MARKERS], ""),
            ("ingest", stages["ingest"], ""),
            ("clean", stages["clean"], ""),
            (names[2], stages[names[2]], f"≤ {WANTED}"),
            (f"the whole way, {shapes} shapes", Cost(whole, elapsed, nan), ""),
        ):
            print(
                f"| {label} | {cost.seconds:.1f} | {_elapsed(cost)} | "
                f"{cost.seconds / bare.seconds:.2f} | {target} |"
            )


def _elapsed(cost: Cost) -> str:
    return "" if cost.elapsed != cost.elapsed else f"{cost.elapsed:.1f}"


def _way(folder: Path, frames: int) -> dict[str, Cost]:
    clean = f"{frames}.clean.take.usda"
    costs = {
        BARE_MARKERS: _bare(folder, frames, MARKERS, size=3),
        "ingest": measure_usdface(
            folder, f"ingest {frames}.c3d --out {frames}.take.usda --neutral 31"
        ),
        "clean": measure_usdface(folder, f"clean {frames}.take.usda --out {clean}"),
    }
    for shapes in SHAPES:
        costs[f"bare write, {shapes} shapes"] = _bare(folder, frames, shapes)
        costs[f"map and write, {shapes} shapes"] = measure_usdface(
            folder,
            f"map {clean} --mapping {shapes}.mapping.usdc --rig {shapes}.rig.usdc "
            f"--out {frames}.{shapes}.usda",
        )
    return costs


_BARE = """
import sys
import numpy as np
from pxr import Sdf, Vt
frames, count, size = map(int, sys.argv[1:])
kind, array = {
    1: (Sdf.ValueTypeNames.FloatArray, Vt.FloatArray),
    3: (Sdf.ValueTypeNames.Point3fArray, Vt.Vec3fArray),
}[size]
shape = (4096, count) if size == 1 else (4096, count, size)
waves = np.random.default_rng(0).random(shape, dtype=np.float32)
layer = Sdf.Layer.CreateNew(f"{frames}.{count}.{size}.bare.usdc")
prim = Sdf.CreatePrimInLayer(layer, "/Bare")
path = Sdf.AttributeSpec(prim, "values", kind).path
for frame in range(frames):
    row = waves[frame % 4096] * np.float32(1 - 0.5 * frame / frames)
    layer.SetTimeSample(path, frame, array.FromNumpy(row))
layer.Save()
"""


def _bare(folder: Path, frames: int, count: int, *, size: int = 1) -> Cost:
    return measure(folder, sys.executable, "-c", _BARE, *map(str, (frames, count, size)))


def _prepare(folder: Path, lengths: tuple[int, ...]) -> None:
    """Write captures, rigs, and mappings that were trained on the beginning of the take."""
    write_captures(folder, (LEARNED_FRAMES, *lengths))
    learned = f"{LEARNED_FRAMES}.take.usda"
    measure_usdface(folder, f"ingest {LEARNED_FRAMES}.c3d --out {learned} --neutral 31")
    measure_usdface(folder, f"clean {learned} --out learned.take.usda")
    markers = markers_of(read_take(folder / "learned.take.usda"))
    for shapes in SHAPES:
        _train(folder, shapes, markers, performance().weights)


def _train(folder: Path, shapes: int, markers: Markers, clip: WeightsClip) -> None:
    rig, weights = _rig(shapes, clip)
    write_rig(folder / f"{shapes}.rig.usdc", rig)
    rig = read_rig(folder / f"{shapes}.rig.usdc")
    clouds = markers.positions.astype(np.float64)
    picks = np.linspace(0, min(len(clouds), len(weights)) - 1, PAIRS).astype(int)
    moved = Deformer(rig).shapes
    mapping = train_mapping(
        References(
            marker_names=markers.names,
            shape_names=rig.shapes,
            markers=clouds[picks],
            weights=weights[picks],
            frames=picks,
            takes=("take",) * PAIRS,
            tuned=np.ones(PAIRS, dtype=bool),
            rigid=markers.rigid,
            neutral=clouds[30],
            rig_file=rig.file,
            rig_prim=rig.prim,
            motion=fit_motion_space([markers.positions]),
        ),
        ranges=rig.ranges,
        gram=moved.gram(),
        skin=sample_skin(moved.target_offsets()),
        method=METHOD,
    )
    write_mapping(folder / f"{shapes}.mapping.usdc", mapping, provenance=Provenance())


def _rig(shapes: int, clip: WeightsClip) -> tuple[Rig, np.ndarray]:
    """Return the demo's rig with a number of shapes, and their weights in the demo's frames.

    Additional shapes are correctives with 1/20 of a shape's displacements, driven by it and another
    shape.
    """
    rig = demo_rig()
    own = rig.shapes[: min(shapes, len(rig.shapes))]
    values = np.zeros((len(clip.values), shapes))
    for column, name in enumerate(own):
        if name in clip.names:
            values[:, column] = clip.values[:, clip.names.index(name)]
    pairs = [(k % len(own), (k * 7 + k // len(own)) % len(own)) for k in range(len(own), shapes)]
    for column, (one, other) in enumerate(pairs, start=len(own)):
        values[:, column] = values[:, one] * values[:, other]
    meshes = []
    for mesh in rig.meshes:
        by_name = {shape.name: shape for shape in mesh.shapes}
        kept = [by_name[name] for name in own if name in by_name]
        for column, (one, _) in enumerate(pairs, start=len(own)):
            if own[one] in by_name:
                keys = tuple(
                    replace(key, offsets=0.05 * key.offsets) for key in by_name[own[one]].keys
                )
                kept.append(MeshShape(f"corrective_{column}", keys))
        meshes.append(replace(mesh, shapes=tuple(kept)))
    names = (*own, *(f"corrective_{column}" for column in range(len(own), shapes)))
    made = replace(rig, shapes=names, meshes=tuple(meshes), ranges=np.tile([0.0, 1.0], (shapes, 1)))
    return made, values
