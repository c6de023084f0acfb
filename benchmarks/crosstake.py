"""Accuracy on a take with known weights: references from its first half, errors on its second.

Measures are those of the fixtures' ``tools/score.py``. All steps run through specs and files, as a
user would run them.
"""

import csv
import importlib.util
import json
import tempfile
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np

from benchmarks._damage import DAMAGES, damage
from benchmarks._takes import markers_of, performer_of
from tests.c3d_write import write_c3d
from tests.conftest import SHARED_DATA
from usdface.capture.sniff import read_capture
from usdface.core.deformer import Deformer
from usdface.model.regressions import MAPPING_METHODS
from usdface.model.selection.baseline import set_up_equation
from usdface.runner.execute import execute
from usdface.specs.capture import CleanSpec, IngestSpec
from usdface.specs.performance import MapSpec, TrainSpec
from usdface.specs.references import ReferencesImportSpec, SelectSpec
from usdface.usdio.performance.read import read_performance
from usdface.usdio.rig.read import read_rig
from usdface.usdio.take.read import read_take

HALF = 4030
"""Frames of the first half: the recording resampled from 30 to 60 frames per second is 8,059."""

COUNTS = (25, 30, 50, 100)
COLUMNS = ("weight_rmse", "vertex_rms_mm", "vertex_p95_mm", "blink_bias", "jitter")
SEED = 0

_PUBLISHED: dict[str, dict[str, Any]] = {
    "d06, 16 × nearest": {"widths": (16,)},
    "d06, 16 components, 16 × nearest": {"dimensions": (16,), "widths": (16,)},
    "d06, by cross-validation": {"dimensions": (4, 8, 16, 24), "widths": (2, 4, 8, 16, 32)},
}
"""Options of `train --method d06` that are compared with the published ones."""


def run(
    counts: tuple[int, ...] = COUNTS, methods: tuple[str, ...] = (), *, quick: bool = False
) -> None:
    """Print two tables per number of references: as recorded, and with several kinds of damage.

    `quick` runs one number and the main methods, in about two minutes.
    """
    if not (SHARED_DATA / "crosstake").is_dir():
        print(f"skipped: no crosstake in {SHARED_DATA}")
        return
    ruler = read_ruler()
    rig_file = SHARED_DATA / "rigs" / "facecap_head.usdc"
    if quick:
        counts, methods = (50,), methods or ("auto", "kernel_cca", "ridge")
    with tempfile.TemporaryDirectory() as name:
        folders = {kind: Path(name) / str(i) for i, kind in enumerate(DAMAGES)}
        truth = np.load(SHARED_DATA / "crosstake" / "truth.npz")
        for kind, folder in folders.items():
            folder.mkdir()
            prepare(folder, kind, truth)
        for count in counts:
            references = {
                kind: choose_references(folder, rig_file, count) for kind, folder in folders.items()
            }
            print(f"### {count} references from the first half, scored on the second\n")
            print(f"| method | {' | '.join(COLUMNS)} |")
            print(f"|---|{'---|' * len(COLUMNS)}")
            for label, weights in _equation(folders[DAMAGES[0]], rig_file).items():
                print_row(label, score(ruler, weights, truth, rig_file))
            for label, options in {} if quick else _PUBLISHED.items():
                solved = map_take(references[DAMAGES[0]], rig_file, "d06", **options)
                print_row(label, score(ruler, solved, truth, rig_file))
            spoiled: dict[str, list[dict[str, float]]] = {}
            for method in methods or ("auto", *MAPPING_METHODS):
                spoiled[method] = [
                    score(ruler, map_take(references[kind], rig_file, method), truth, rig_file)
                    for kind in DAMAGES
                ]
                print_row(method, spoiled[method][0])
            print(f"\n{count} references, spoiled captures: vertex RMS [mm], blink bias, jitter\n")
            print(f"| method | {' | '.join(DAMAGES)} |")
            print(f"|---|{'---|' * len(DAMAGES)}")
            for method, figures in spoiled.items():
                cells = [
                    f"{each['vertex_rms_mm']:.3f}, {each['blink_bias']:+.3f}, {each['jitter']:.2f}"
                    for each in figures
                ]
                print(f"| {method} | {' | '.join(cells)} |", flush=True)
            print()


def read_ruler() -> ModuleType:
    path = SHARED_DATA.parent / "tools" / "score.py"
    spec = importlib.util.spec_from_file_location("score", path)
    if spec is None or spec.loader is None:
        raise SystemExit(f"no ruler at {path}")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def prepare(folder: Path, kind: str, truth: Any, name: str = "crosstake") -> None:
    """Damage, ingest and clean a fixture's capture; write the keys."""
    source = SHARED_DATA / name
    said = json.loads((source / "take.json").read_text())
    capture = source / "take.c3d"
    if kind != DAMAGES[0]:
        take = read_capture(capture).take
        markers = markers_of(take)
        spoiled = damage(kind, markers.positions, markers.visible, np.random.default_rng(SEED))
        capture = folder / "take.c3d"
        write_c3d(capture, *spoiled, markers.names, rate=take.rate, first_frame=take.first_frame)
    execute(
        IngestSpec(
            sources=(capture,),
            out=folder / "x.take.usda",
            rigid=tuple(said["rigid"]),
            neutral=said["neutral_frame"] + 1,  # index to frame number
        )
    )
    execute(CleanSpec(take=folder / "x.take.usda", out=folder / "x.clean.take.usda"))
    with (folder / "keys.csv").open("w", newline="") as stream:
        writer = csv.writer(stream)
        writer.writerow(["frame", *truth["shapes"]])
        writer.writerows([i, *row] for i, row in enumerate(truth["weights"], start=1))


def _equation(folder: Path, rig_file: Path) -> dict[str, tuple[tuple[str, ...], np.ndarray]]:
    """Solve the blendshape equation, which needs no references."""
    take, rig = read_take(folder / "x.clean.take.usda"), read_rig(rig_file)
    markers = markers_of(take)
    equation = set_up_equation(
        rig,
        Deformer(rig),
        performer_of(take),
    )
    printed = equation.solve_published(markers.positions)
    return {
        "baseline, eq. 7 as printed": (rig.shapes, printed),
        "the same weights, limited": (rig.shapes, np.clip(printed, 0.0, 1.0)),
        "baseline within the ranges": (rig.shapes, equation.propose(markers.positions)),
    }


def choose_references(
    folder: Path, rig_file: Path, count: int, *, first: int = 1, out: Path | None = None
) -> Path:
    references = out or folder / f"{count}.references.usda"
    execute(
        SelectSpec(
            takes=(folder / "x.clean.take.usda",),
            rig=rig_file,
            out=references,
            count=count,
            frames=f"{first}-{HALF}",
        )
    )
    execute(ReferencesImportSpec(references=references, weights=folder / "keys.csv"))
    return references


def map_take(
    references: Path, rig_file: Path, method: str, **options: Any
) -> tuple[tuple[str, ...], np.ndarray]:
    folder = references.parent
    mapping, out = folder / "x.mapping.usdc", folder / "x.hero.usda"
    train = TrainSpec(references=references, out=mapping, method=method, **options)
    execute(train, overwrite=True)
    execute(
        MapSpec(take=folder / "x.clean.take.usda", mapping=mapping, rig=rig_file, out=out),
        overwrite=True,
    )
    clip = read_performance(out).weights
    return clip.names, clip.values.astype(float)


def score(
    ruler: ModuleType, solved: tuple[tuple[str, ...], np.ndarray], truth: Any, rig_file: Path
) -> dict[str, float]:
    names, weights = solved
    shapes = [str(name) for name in truth["shapes"]]
    ordered = np.stack([weights[:, names.index(name)] for name in shapes], axis=1)
    seen = np.array([not name.lower().startswith("eyelook") for name in shapes])
    figures: dict[str, float] = ruler.metrics(
        ordered[HALF:],
        truth["weights"].astype(float)[HALF:],
        shapes,
        ruler.rig_shapes(str(rig_file)),
        60.0,
        seen,
    )
    return figures


def print_row(label: str, figures: dict[str, float]) -> None:
    print(f"| {label} | {' | '.join(f'{figures[name]:.3f}' for name in COLUMNS)} |", flush=True)
