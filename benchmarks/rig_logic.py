"""Rigs with logic: lost energy of correctives, and the cost of their evaluation.

`compskin` has 72 primaries and 181 evaluated correctives of a production rig over 2,800 frames,
without meshes. The logic is inferred from 50 rows and tested on the others. *Independent channels*
are correctives learnt from the primaries, as on a rig without logic.

Errors of N(0, 0.05) on all primaries are amplified by in-betweens that start at 0. The loss of the
logic inferred from every fourth row is the minimum for evaluation alone.

The effect on mapped primaries is measured on the half of crosstake without references, with
in-betweens on every shape of the skin that start at 0 and peak at 0.25 and 0.5, without
displacements.
"""

import tempfile
import time
from dataclasses import replace
from pathlib import Path

import numpy as np

from benchmarks import crosstake
from benchmarks._damage import DAMAGES
from tests.conftest import SHARED_DATA
from usdface.core.arrays import FloatArray, IntArray
from usdface.core.assets import MeshShape, References, Rig, ShapeKey
from usdface.core.deformer import Deformer
from usdface.core.rig_logic import Combination, RigLogic
from usdface.model.mapping.motion_space import fit_motion_space
from usdface.model.mapping.predict import WeightPredictor
from usdface.model.mapping.regions import skin_points
from usdface.model.mapping.train import train_mapping
from usdface.model.regressions.base import RestPlaces
from usdface.numerics.measure.face_regions import gaze_shapes
from usdface.numerics.regression.combination_inference import infer_combinations
from usdface.numerics.regression.linear_ridge import fit_linear_ridge
from usdface.numerics.regression.reference_design import pivoted_selection
from usdface.steps.performance.train import separate_motion
from usdface.usdio.rig.read import read_rig

PRIMARIES = 72
ROWS = 50
NOISE = 0.05
COMBINATIONS = 200
MARKERS, PAIRS, FRAMES = 100, 40, 2048


def run() -> None:
    """Print lost energy, and ratios of times."""
    weights = np.load(SHARED_DATA / "compskin" / "test_anim.npz")["weights"].astype(np.float64)
    print(f"| correctives of compskin, logic from {ROWS} rows | energy lost | wanted |")
    print("|---|---|---|")
    for label, rows in (
        ("rows that differ most", pivoted_selection(weights, ROWS)),
        ("rows farthest apart in the primaries", _farthest(weights[:, :PRIMARIES], ROWS)),
    ):
        _print_lost(label, weights, rows)
    _print_mapped()
    ratio = _mapping_ratio()
    print("\n| mapping on facecap_head, 51 shapes | measured | wanted |\n|---|---|---|")
    print(f"| time with {COMBINATIONS} combinations over that without | {ratio:.2f} × | ≤ 1.3 × |")


def _print_lost(label: str, weights: FloatArray, rows: IntArray) -> None:
    primaries, driven = weights[:, :PRIMARIES], weights[:, PRIMARIES:]
    rest = np.setdiff1d(np.arange(len(weights)), rows)
    noise = NOISE * np.random.default_rng(0).normal(size=primaries[rest].shape)
    off = np.clip(primaries[rest] + noise, 0.0, 1.0)
    inferred, stated = _Logic(weights[rows]), _Logic(weights[::4])
    line = fit_linear_ridge(primaries[rows], driven[rows])
    channels = np.clip((primaries[rest] - line.mean) @ line.coefficients + line.intercept, 0, 1)

    def lost(predicted: FloatArray) -> str:
        return f"{100 * ((predicted - driven[rest]) ** 2).sum() / (driven[rest] ** 2).sum():.1f} %"

    print(f"| {label}: primaries exact | {lost(inferred(primaries[rest]))} | ≤ 5 % |")
    error = f"off by N(0, {NOISE})"
    print(f"| primaries {error} | {lost(inferred(off))} |  |")
    print(f"| logic of every fourth row: primaries exact | {lost(stated(primaries[rest]))} |  |")
    print(f"| {error} | {lost(stated(off))} |  |")
    print(f"| independent channels, linear ridge | {lost(channels)} |  |", flush=True)


class _Logic:
    """Correctives by the logic inferred from rows; 0 without logic."""

    def __init__(self, rows: FloatArray) -> None:
        shapes = [f"p{index}" for index in range(PRIMARIES)]
        driven = [f"c{index}" for index in range(rows.shape[1] - PRIMARIES)]
        found = infer_combinations(shapes, rows[:, :PRIMARIES], driven, rows[:, PRIMARIES:])
        self._logic = RigLogic(shapes, found)
        self._columns = [driven.index(each.shape) for each in found]
        self._count = len(driven)

    def __call__(self, primaries: FloatArray) -> FloatArray:
        out = np.zeros((len(primaries), self._count))
        out[:, self._columns] = self._logic.evaluate(primaries)[:, PRIMARIES:]
        return out


def _print_mapped() -> None:
    """Print the lost energy of in-betweens on a mapped take, and the error of the weights."""
    truth = np.load(SHARED_DATA / "crosstake" / "truth.npz")
    file = SHARED_DATA / "rigs" / "facecap_head.usdc"
    rig = read_rig(file)
    gaze = set(gaze_shapes(rig.shapes).tolist())
    skin = [name for index, name in enumerate(rig.shapes) if index not in gaze]
    between = tuple(
        Combination(f"{name}_{at:.0%}".rstrip("%"), (name,), weights=(at,), spans=((0.0, 2 * at),))
        for name in skin
        for at in (0.25, 0.5)
    )
    shapes = [str(name) for name in truth["shapes"]]
    wanted = truth["weights"][crosstake.HALF :].astype(np.float64)
    logic = RigLogic(shapes, between)
    values = logic.evaluate(wanted)[:, len(shapes) :]
    columns = [shapes.index(name) for name in skin]
    print(f"\n| in-betweens of a mapped take, {ROWS} references | energy lost | weights off by |")
    print("|---|---|---|")
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        crosstake.prepare(folder, DAMAGES[0], truth)
        references = crosstake.choose_references(folder, file, ROWS)
        for method in ("face_map", "ridge", "rbf"):
            names, weights = crosstake.map_take(references, file, method)
            solved = weights[crosstake.HALF :, [names.index(name) for name in shapes]]
            off = logic.evaluate(solved)[:, len(shapes) :] - values
            lost = 100 * (off**2).sum() / (values**2).sum()
            error = np.sqrt(((solved - wanted)[:, columns] ** 2).mean())
            print(f"| {method} | {lost:.1f} % | {error:.4f} |", flush=True)


def _farthest(points: FloatArray, count: int) -> IntArray:
    chosen = [int((points**2).sum(axis=1).argmax())]
    distance = ((points - points[chosen[0]]) ** 2).sum(axis=1)
    while len(chosen) < count:
        chosen.append(int(distance.argmax()))
        distance = np.minimum(distance, ((points - points[chosen[-1]]) ** 2).sum(axis=1))
    return np.array(chosen, np.int64)


def _mapping_ratio() -> float:
    """Return the time of a mapping with combinations divided by that without."""
    bare = read_rig(SHARED_DATA / "rigs" / "facecap_head.usdc")
    driven = with_combinations(bare, COMBINATIONS)
    predictors = [_trained(rig) for rig in (bare, driven)]
    seconds = [np.inf, np.inf]
    for _ in range(4):  # alternating, for equal load
        for index, (predictor, markers) in enumerate(predictors):
            start = time.process_time()
            predictor.predict(markers)
            seconds[index] = min(seconds[index], time.process_time() - start)
    return seconds[1] / seconds[0]


def with_combinations(rig: Rig, count: int) -> Rig:
    """Return a rig with products of two shapes, in the order of their overlap.

    Each product subtracts half of the common displacement.
    """
    mesh = max(rig.meshes, key=lambda each: len(each.points))
    moved = np.zeros((len(mesh.shapes), len(mesh.points), 3))
    for row, shape in enumerate(mesh.shapes):
        moved[row, shape.keys[-1].points] = shape.keys[-1].offsets
    length = np.linalg.norm(moved, axis=2)
    shared = length @ length.T
    first, second = np.tril_indices(len(shared), -1)
    order = np.argsort(-shared[first, second], kind="stable")[:count]
    shapes, combinations = [], []
    for a, b in zip(first[order].tolist(), second[order].tolist(), strict=True):
        both = moved[a] + moved[b]
        size = np.minimum(length[a], length[b])[:, None]
        offsets = -0.5 * size * both / np.maximum(np.linalg.norm(both, axis=1)[:, None], 1e-9)
        points = np.flatnonzero(size[:, 0] > 1e-4)
        name = f"{mesh.shapes[a].name}__{mesh.shapes[b].name}"
        shapes.append(MeshShape(name, (ShapeKey(1.0, points, offsets[points]),)))
        combinations.append(Combination(name, (mesh.shapes[a].name, mesh.shapes[b].name)))
    meshes = tuple(
        replace(each, shapes=(*each.shapes, *shapes)) if each is mesh else each
        for each in rig.meshes
    )
    return replace(rig, meshes=meshes, combinations=tuple(combinations))


def _trained(rig: Rig) -> tuple[WeightPredictor, FloatArray]:
    """Train on keys of crosstake with markers at points of the rig; return all frames' markers."""
    truth = np.load(SHARED_DATA / "crosstake" / "truth.npz")
    names = [str(name) for name in truth["shapes"]]
    weights = truth["weights"][:, [names.index(name) for name in rig.shapes]].astype(np.float64)
    deformer = Deformer(rig)
    points = skin_points(deformer.shapes.target_offsets())
    _, skin = separate_motion(rig, deformer, points, rig.shapes)
    markers = points[np.linspace(0, len(points) - 1, MARKERS).astype(int)]
    frames = np.linspace(0, len(weights) - 1, FRAMES).astype(int)
    clip = np.concatenate(
        [deformer.points(weights[frames[i : i + 64]])[:, markers] for i in range(0, FRAMES, 64)]
    )
    rows = pivoted_selection(weights[frames], PAIRS)
    references = References(
        marker_names=tuple(map(str, range(MARKERS))),
        shape_names=rig.shapes,
        markers=clip[rows],
        weights=weights[frames[rows]],
        frames=frames[rows],
        takes=("x",) * PAIRS,
        tuned=np.ones(PAIRS, dtype=np.bool_),
        rigid=("0", "1", "2"),
        neutral=deformer.neutral[markers],
        rig_file=rig.file,
        rig_prim=rig.prim,
        combinations=rig.combinations,
        motion=fit_motion_space([clip]),
    )
    mapping = train_mapping(
        references,
        ranges=rig.ranges,
        gram=deformer.shapes.gram(references.weights),
        skin=skin[: len(rig.shapes) + len(rig.combinations)],
        rest=RestPlaces(deformer.neutral[points], deformer.neutral[markers]),
        method="face_map",
    )
    predictor = WeightPredictor(mapping)
    solved = predictor.predict(clip).weights
    off = np.sqrt(((solved - weights[frames]) ** 2).mean())
    print(f"{len(rig.combinations)} combinations: weights off by {off:.3f}", flush=True)
    return predictor, clip
