"""Learning from edits: the effect of ten corrected frames on the rest of the take.

References are from the first half of `crosstake`. In the second half the ten frames with the
largest errors, at least a second apart, are corrected. Frames within a second of a correction are
not evaluated.
"""

import csv
import tempfile
from pathlib import Path

import numpy as np

from benchmarks._damage import DAMAGES
from benchmarks.crosstake import (
    COLUMNS,
    HALF,
    choose_references,
    prepare,
    read_ruler,
)
from tests.conftest import SHARED_DATA
from tests.edited_weights import read_weights
from usdface.core.deformer import Deformer
from usdface.runner.execute import execute
from usdface.specs.edits import EditsImportSpec
from usdface.specs.performance import MapSpec, TrainSpec
from usdface.specs.references import ReferencesFromEditsSpec
from usdface.usdio.performance.read import PerformanceReader
from usdface.usdio.rig.read import read_rig

CORRECTED = 10
APART = 60
"""Minimum distance of corrections in frames: one second."""


def run(counts: tuple[int, ...] = (25, 50)) -> None:
    """Print the error of the rest of the take before and after ten corrections."""
    if not (SHARED_DATA / "crosstake").is_dir():
        print(f"skipped: no crosstake in {SHARED_DATA}")
        return
    ruler = read_ruler()
    rig_file = SHARED_DATA / "rigs" / "facecap_head.usdc"
    shapes_of = ruler.rig_shapes(str(rig_file))
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        truth = np.load(SHARED_DATA / "crosstake" / "truth.npz")
        prepare(folder, DAMAGES[0], truth)
        shapes = [str(each) for each in truth["shapes"]]
        wanted = truth["weights"].astype(float)
        seen = np.array([not each.lower().startswith("eyelook") for each in shapes])
        print(f"second half but for the {CORRECTED} corrected moments\n")
        print(f"| references | {' | '.join(COLUMNS)} |")
        print(f"|---|{'---|' * len(COLUMNS)}")
        for count in counts:
            references = choose_references(folder, rig_file, count)
            out = folder / f"{count}.hero.usda"
            first = _map(folder, references, rig_file, out, shapes)
            frames = _worst(first, wanted, rig_file, shapes)
            rest = np.ones(len(wanted), dtype=bool)
            rest[:HALF] = False
            for frame in frames:
                rest[max(frame - APART, 0) : frame + APART + 1] = False
            _correct(folder, out, frames, wanted, shapes)
            taught = folder / f"{count}.taught.references.usda"
            execute(ReferencesFromEditsSpec(performances=(out,), references=references, out=taught))
            second = _map(folder, taught, rig_file, folder / f"{count}.taught.usda", shapes)
            for label, weights in ((f"{count}", first), (f"{count} + {CORRECTED}", second)):
                row = ruler.metrics(weights[rest], wanted[rest], shapes, shapes_of, 60.0, seen)
                print(f"| {label} | {' | '.join(f'{row[c]:.3f}' for c in COLUMNS)} |", flush=True)


def _map(
    folder: Path, references: Path, rig_file: Path, out: Path, shapes: list[str]
) -> np.ndarray:
    mapping = references.with_suffix(".mapping.usdc")
    execute(TrainSpec(references=references, out=mapping, method="face_map"), overwrite=True)
    take = folder / "x.clean.take.usda"
    execute(MapSpec(take=take, mapping=mapping, rig=rig_file, out=out), overwrite=True)
    clip = read_weights(out)
    return np.stack([clip.values[:, clip.names.index(name)] for name in shapes], 1).astype(float)


def _worst(solved: np.ndarray, wanted: np.ndarray, rig_file: Path, shapes: list[str]) -> list[int]:
    """Return the frames of the second half with the largest surface errors, a second apart."""
    rig = read_rig(rig_file)
    deformer = Deformer(rig)
    columns = [shapes.index(name) for name in rig.shapes]
    rows = np.arange(HALF, len(wanted), 5)
    error = np.zeros(len(rows))
    for start in range(0, len(rows), 32):
        part = rows[start : start + 32]
        off = deformer.points(solved[part][:, columns]) - deformer.points(wanted[part][:, columns])
        error[start : start + 32] = np.sqrt((off**2).sum(axis=2).mean(axis=1))
    chosen: list[int] = []
    for row in rows[np.argsort(-error)].tolist():
        if all(abs(row - other) > 2 * APART for other in chosen):
            chosen.append(row)
        if len(chosen) == CORRECTED:
            break
    return sorted(chosen)


def _correct(
    folder: Path, performance: Path, frames: list[int], wanted: np.ndarray, shapes: list[str]
) -> None:
    names = PerformanceReader(performance).names
    with (folder / "corrected.csv").open("w", newline="") as stream:
        writer = csv.writer(stream)
        writer.writerow(["frame", *names])
        order = [shapes.index(name) for name in names]
        writer.writerows([frame + 1, *wanted[frame, order].tolist()] for frame in frames)
    execute(EditsImportSpec(performance=performance, changed=folder / "corrected.csv"))
