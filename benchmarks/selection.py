"""Selection and proposals on a take with known weights.

References are from one half of the take and errors of the other, for both halves. Phones have
random positions, since the take has none.
"""

import json
import tempfile
import time
from dataclasses import dataclass
from fractions import Fraction
from itertools import pairwise
from pathlib import Path

import numpy as np

from benchmarks import crosstake
from benchmarks._damage import DAMAGES
from tests.conftest import SHARED_DATA
from tests.model.synthetic import sample_skin
from usdface.core.assets import Markers, References, Take, TrainedMapping
from usdface.core.deformer import Deformer
from usdface.core.provenance import Provenance
from usdface.model.mapping.predict import WeightPredictor
from usdface.model.mapping.train import train_mapping
from usdface.model.regressions.forward_model import ForwardScales, fit_forward_model
from usdface.numerics.measure.face_regions import blinks
from usdface.runner.execute import execute
from usdface.specs.references import SelectSpec
from usdface.steps.inputs.cleaned_takes import read_cleaned_takes
from usdface.tuning.targets import find_targets
from usdface.usdio.references.read import read_references
from usdface.usdio.rig.read import read_rig
from usdface.usdio.take.read import read_take
from usdface.usdio.take.write import write_take

METHOD = "face_map"
HALVES = ("1-4030", "4031-8059")
PHONES = "pau b p m k g ae aa f v ch sh iy ay ow oy n d t l eh er th dh s z r w uw hh".split()
EMOTIONS = ("neutral", "joy", "anger", "sadness")
LONG = 432_000
_LINEAR = ForwardScales(alpha=0.6, floor=0.4, eta=0.0, tau=0.1, curve=0.0)


@dataclass(frozen=True)
class Stage:
    """Data of all rows of the table."""

    folder: Path
    rig_file: Path
    references: References
    truth: np.ndarray
    positions: np.ndarray
    gram: np.ndarray
    skin: np.ndarray
    ranges: np.ndarray
    seen: np.ndarray


def run(*, quick: bool = False) -> None:
    """Print errors by method, errors of proposals, and the time for an hour.

    `quick` omits the errors by method, for which about twenty mappings are trained.
    """
    if not (SHARED_DATA / "crosstake").is_dir():
        print(f"skipped: no crosstake in {SHARED_DATA}")
        return
    with tempfile.TemporaryDirectory() as name:
        stage = _stage(Path(name))
        if quick:
            print("With `--quick`: errors by way of choosing, twenty mappings, are left out.\n")
        else:
            _print_errors(stage)
        _print_starts(stage)
        _print_keys(stage)
    with tempfile.TemporaryDirectory() as name:
        _print_speed(Path(name))


def _prepare(folder: Path) -> np.lib.npyio.NpzFile:
    truth: np.lib.npyio.NpzFile = np.load(SHARED_DATA / "crosstake" / "truth.npz")
    crosstake.prepare(folder, DAMAGES[0], truth)
    return truth


def _stage(folder: Path) -> Stage:
    rig_file = SHARED_DATA / "rigs" / "facecap_head.usdc"
    truth = _prepare(folder)
    rig = read_rig(rig_file)
    shapes = Deformer(rig).shapes
    columns = [list(truth["shapes"]).index(name) for name in rig.shapes]
    _write_phones(folder / "made.json", frames=len(truth["weights"]), rate=60.0)
    report = _select(folder, rig_file, "all", 2, "1-8059", "design")
    takes = read_cleaned_takes((folder / "x.clean.take.usda",))
    return Stage(
        folder=folder,
        rig_file=rig_file,
        references=read_references(report),
        truth=truth["weights"].astype(float)[:, columns],
        positions=takes.positions[0],
        gram=shapes.gram(),
        skin=sample_skin(shapes.target_offsets()),
        ranges=rig.ranges,
        seen=np.array([not name.lower().startswith("eyelook") for name in rig.shapes]),
    )


def _write_phones(path: Path, *, frames: int, rate: float) -> None:
    rng = np.random.default_rng(0)
    phones, at, duration = [], 0.0, frames / rate
    while at < duration - 0.2:
        end = at + float(rng.uniform(0.05, 0.15))
        phones.append({"start": at, "end": end, "label": PHONES[int(rng.integers(len(PHONES)))]})
        at = end
    edges = np.linspace(0, duration, 2 * len(EMOTIONS) + 1)  # every emotion in both halves
    emotions = [
        {"start": a, "end": b, "label": EMOTIONS[i % len(EMOTIONS)]}
        for i, (a, b) in enumerate(pairwise(edges))
    ]
    path.write_text(json.dumps({"phones": phones, "emotions": emotions}), encoding="utf-8")


def _select(
    folder: Path, rig_file: Path, name: str, count: int, frames: str, method: str, **more: object
) -> Path:
    out = folder / f"{name}.references.usda"
    given = {} if method == "design" else {"phones": (folder / "made.json",)}
    execute(
        SelectSpec(
            takes=(folder / "x.clean.take.usda",),
            rig=rig_file,
            out=out,
            count=count,
            frames=frames,
            method=method,
            **given,
            **more,
        ),
        overwrite=True,
    )
    return out


def _print_errors(stage: Stage) -> None:
    print(f"Held-out error of {METHOD}, both halves: vertex RMS [mm], blink bias\n")
    print("| references | first half, scored on the second | second, scored on the first |")
    print("|---|---|---|")
    rng = np.random.default_rng(0)
    for seed in range(3):
        rows = [_random_per_emotion(rng, half) for half in range(2)]
        _row(stage, f"100 random segments and extremes, {seed + 1}", rows)
    for method, count in (("viseme", 100), ("design", 50), ("both", 50), ("design", 40)):
        rows = [
            read_references(_select(stage.folder, stage.rig_file, "x", count, half, method)).frames
            - 1
            for half in HALVES
        ]
        _row(stage, f"{count} by `{method}`", rows)
    print()


def _random_per_emotion(rng: np.random.Generator, half: int) -> np.ndarray:
    """Choose 25 random frames per emotion, in place of 15 visemes and 10 extremes chosen by eye."""
    edges = np.linspace(4030 * half, 4030 * (half + 1) - 1, 5).astype(int)
    return np.concatenate(
        [rng.choice(np.arange(a, b), 25, replace=False) for a, b in pairwise(edges)]
    )


def _row(stage: Stage, label: str, rows: list[np.ndarray]) -> None:
    cells = []
    for half, picks in enumerate(rows):
        test = slice(4030, None) if half == 0 else slice(0, 4030)
        predicted = WeightPredictor(_train(stage, picks)).predict(stage.positions[test]).weights
        error = (predicted - stage.truth[test]) * stage.seen
        squared = np.einsum("fs,st,ft->f", error, stage.gram, error)
        shut = blinks(stage.references.shape_names)
        closed = stage.truth[test][:, shut].max(axis=1) > 0.7
        cells.append(f"{np.sqrt(squared.mean()):.3f}, {error[:, shut][closed].mean():+.3f}")
    print(f"| {label} | {' | '.join(cells)} |", flush=True)


def _train(stage: Stage, rows: np.ndarray) -> TrainedMapping:
    made = stage.references
    return train_mapping(
        References(
            marker_names=made.marker_names,
            shape_names=made.shape_names,
            markers=stage.positions[np.sort(rows)].astype(float),
            weights=stage.truth[np.sort(rows)],
            frames=np.sort(rows) + 1,
            takes=("x",) * len(rows),
            tuned=np.ones(len(rows), bool),
            rigid=made.rigid,
            neutral=made.neutral,
            rig_file=made.rig_file,
            rig_prim=made.rig_prim,
            motion=made.motion,
        ),
        ranges=stage.ranges,
        gram=stage.gram,
        skin=stage.skin,
        method=METHOD,
    )


def _print_starts(stage: Stage) -> None:
    """Print the error of proposals over 60 pairs."""
    print("Starting weights of 60 pairs of the first half: distance from the truth\n")
    print("| tuned before | from | vertex RMS [mm] | weight RMSE | sliders off by > 0.1 |")
    print("|---|---|---|---|---|")
    start = read_references(
        _select(stage.folder, stage.rig_file, "start", 110, HALVES[0], "design")
    )
    rows = start.frames - 1
    # Pairs are in order of gain: every other one is tuned, the others are measured.
    tuned, judged = rows[:100:2], np.setdiff1d(rows, rows[:100:2])
    place = {int(row): index for index, row in enumerate(rows)}
    proposed = start.weights[[place[int(row)] for row in judged]]
    _start_row(stage, "0", "the blendshape equation", proposed, judged)
    for count in (10, 25, 50):
        mapping = _train(stage, tuned[:count])
        proposed = WeightPredictor(mapping).predict(stage.positions[judged]).weights
        _start_row(stage, str(count), "the mapping", proposed, judged)
    print()


def _start_row(
    stage: Stage, tuned: str, label: str, proposed: np.ndarray, judged: np.ndarray
) -> None:
    error = (proposed - stage.truth[judged]) * stage.seen
    squared = np.einsum("fs,st,ft->f", error, stage.gram, error)
    rmse = np.sqrt((error[:, stage.seen] ** 2).mean())
    off = (np.abs(error) > 0.1).sum(axis=1).mean()
    print(
        f"| {tuned} | {label} | {np.sqrt(squared.mean()):.3f} | {rmse:.3f} | {off:.1f} |",
        flush=True,
    )


def _print_keys(stage: Stage) -> None:
    """Print residuals of true keys and proposals, corrected by a model of the performer's skin.

    The model is fitted to tuned pairs and linear in the weights: the forward model of mappings
    without its quadratic part. Inexact keys have random errors proportional to each weight.
    """
    path = _select(stage.folder, stage.rig_file, "keys", 50, HALVES[0], "design")
    proposals, rig = read_references(path), read_rig(stage.rig_file)
    targets = find_targets(proposals, rig)
    of_face = np.array([region != "" for region in targets.regions])
    shapes = Deformer(rig).shapes

    def moved(weights: np.ndarray) -> np.ndarray:
        keys = shapes.key_weights(weights)
        return np.asarray(np.einsum("pk,kmc->pmc", keys, targets.key_deltas))

    basis, true = moved(np.eye(len(rig.shapes))), stage.truth[proposals.frames - 1]
    goal, rng = targets.targets - targets.rest, np.random.default_rng(0)
    print("Residual of 50 pairs of the first half [mm RMS], true keys and their proposals\n")
    print(
        "| keys err by | tuned | keys | proposals | keys that read worse |\n|---|---|---|---|---|"
    )
    for error in (0.0, 0.15):
        keys = np.clip(true * (1 + error * rng.normal(size=true.shape)), 0, 1)
        for tuned in (0, 5, 10, 25, 49):
            read = np.zeros((2, 50))
            rest = targets.rest.astype(np.float64)
            for pair in range(50):
                others = np.delete(np.arange(50), pair)[:tuned]
                both = np.stack([keys[pair], proposals.weights[pair]])
                left = goal[pair] - moved(both)
                if tuned:
                    seen = (goal - moved(keys))[others] + np.tensordot(keys[others], basis, 1)
                    model = fit_forward_model(
                        keys[others], seen, expected=basis, neutral=rest, scales=_LINEAR
                    )
                    left -= np.tensordot(both, model.basis - basis, 1) + model.offset
                read[:, pair] = np.sqrt((left[:, of_face] ** 2).sum(axis=2).mean(axis=1))
            cells = " | ".join(f"{each:.2f}" for each in read.mean(axis=1))
            worse = np.mean(read[0] > read[1])
            print(f"| {error:.0%} | {tuned} | {cells} | {worse:.0%} |", flush=True)
    print()


def _print_speed(folder: Path) -> None:
    """Compare the time of selection from an hour at 120 Hz with that of reading it."""
    _prepare(folder)
    take = read_take(folder / "x.clean.take.usda")
    path = folder / "long.take.usda"
    write_take(path, _stretched(take, LONG), provenance=Provenance())
    begun = time.process_time()
    read_take(path)
    reading = time.process_time() - begun
    begun = time.process_time()
    execute(
        SelectSpec(
            takes=(path,),
            rig=SHARED_DATA / "rigs" / "facecap_head.usdc",
            out=folder / "long.references.usda",
            count=100,
        )
    )
    selecting = time.process_time() - begun - reading  # without the reading
    ratio = selecting / reading + 1
    print(f"| {LONG:,} frames | processor seconds | wanted |\n|---|---|---|")
    print(f"| reading | {reading:.1f} | |")
    print(f"| selecting 100, reading apart | {selecting:.1f} | |")
    print(f"| selecting and its own reading, times reading | {ratio:.2f} | ≤ 2 |")


def _stretched(take: Take, frames: int) -> Take:
    """Repeat a take up to a length, with noise in every frame."""
    markers = take.markers
    if markers is None:
        raise SystemExit("the take has no markers")
    rng = np.random.default_rng(0)
    turns = np.arange(frames) % len(markers.positions)
    noise = rng.normal(0, 0.05, (frames, 1, 3)).astype(np.float32)
    return Take(
        name="long",
        rate=Fraction(120),
        first_frame=1,
        markers=Markers(
            names=markers.names,
            positions=markers.positions[turns] + noise,
            visible=markers.visible[turns],
            confidence=markers.confidence[turns],
            rigid=markers.rigid,
            neutral_frame=markers.neutral_frame,
            space="stabilized",
        ),
    )
