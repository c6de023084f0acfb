"""What condensing the ensemble's corrections saves and changes, on takes with known weights.

References come from the first half of `crosstake`; the second half is mapped twice, with all
Gaussians and with those that they were condensed to. Processor time, of the method alone.
"""

import tempfile
import time
from dataclasses import replace
from pathlib import Path

import numpy as np

from benchmarks import crosstake
from tests.conftest import SHARED_DATA
from usdface.core.assets import TrainedMapping
from usdface.core.deformer import Deformer
from usdface.model.mapping.coordinates import marker_coordinates
from usdface.model.mapping.head_space import into_head_space
from usdface.model.mapping.predict import BLOCK_FRAMES
from usdface.model.mapping.train import motion_of
from usdface.model.regressions import find_method
from usdface.model.regressions.corrections import CONDENSED
from usdface.numerics.array_namespace import CPU
from usdface.numerics.regression.condensed_function import CondensedFunction
from usdface.numerics.regression.cross_validation import surface_rms_mm
from usdface.runner.execute import execute
from usdface.specs.performance import TrainSpec
from usdface.usdio.mapping import read_mapping
from usdface.usdio.rig.read import read_rig
from usdface.usdio.take.read import read_take

COUNTS = (50, 100)
ROUNDS = 5


def run(*, quick: bool = False) -> None:
    """Print times with and without, and how far weights and the surface move."""
    if not (SHARED_DATA / "crosstake").is_dir():
        print(f"skipped: no crosstake in {SHARED_DATA}")
        return
    rig_file = SHARED_DATA / "rigs" / "facecap_head.usdc"
    truth = np.load(SHARED_DATA / "crosstake" / "truth.npz")
    rig = read_rig(rig_file)
    gram = Deformer(rig).shapes.gram()
    print(
        "| capture | references | all [µs a frame] | condensed | shapes that keep theirs | "
        "frames that ask all | weights move by, RMS | at most | the surface, RMS [mm] |"
    )
    print(f"|{'---|' * 9}")
    with tempfile.TemporaryDirectory() as name:
        for kind in crosstake.DAMAGES[:1] if quick else crosstake.DAMAGES:
            folder = Path(name) / kind.replace(" ", "_")
            folder.mkdir()
            crosstake.prepare(folder, kind, truth)
            for count in COUNTS:
                references = crosstake.choose_references(folder, rig_file, count)
                mapping_file = folder / f"{count}.mapping.usdc"
                execute(TrainSpec(references=references, out=mapping_file, method="ensemble"))
                mapping = read_mapping(mapping_file)
                order = [rig.shapes.index(name) for name in mapping.shape_names]
                _compare(f"{kind} | {count}", folder, mapping, gram[np.ix_(order, order)])


def _compare(label: str, folder: Path, mapping: TrainedMapping, gram: np.ndarray) -> None:
    take = read_take(folder / "x.clean.take.usda")
    if take.markers is None:
        raise SystemExit("the take has no markers")
    placed = into_head_space(mapping, take.markers)
    seen = slice(crosstake.HALF, None)
    points = marker_coordinates(
        motion_of(mapping), placed.positions[seen], visible=placed.visible[seen]
    ).values
    condensed = {
        name.removeprefix(CONDENSED): value
        for name, value in mapping.arrays.items()
        if name.startswith(CONDENSED)
    }
    if not condensed:
        print(f"| {label} | | nothing condensed | | | | | |", flush=True)
        return
    dear = {k: v for k, v in mapping.arrays.items() if not k.startswith(CONDENSED)}
    wanted, all_time = _mapped(replace(mapping, arrays=dear), points)
    found, quick_time = _mapped(mapping, points)
    kept = int(mapping.settings["dimensions"])
    _, agree = CondensedFunction(condensed).both(points[:, :kept])
    away = found - wanted
    print(
        f"| {label} | {all_time:.1f} | {quick_time:.1f} | {int((condensed['smooth'] == 0).sum())} "
        f"of {len(mapping.shape_names)} | {1 - float(agree.mean()):.1%} | "
        f"{np.sqrt((away**2).mean()):.5f} | {np.abs(away).max():.4f} | "
        f"{surface_rms_mm(away, gram):.4f} |",
        flush=True,
    )


def _mapped(mapping: TrainedMapping, points: np.ndarray) -> tuple[np.ndarray, float]:
    """Weights, and the least processor time a frame of some rounds [µs]."""
    predict = find_method(mapping.method).predictor(mapping.arrays, mapping.settings, CPU)
    best = np.inf
    for _ in range(ROUNDS):
        begun = time.process_time()
        parts = [
            predict(points[start : start + BLOCK_FRAMES])
            for start in range(0, len(points), BLOCK_FRAMES)
        ]
        best = min(best, time.process_time() - begun)
    weights = np.clip(np.concatenate(parts), mapping.ranges[:, 0], mapping.ranges[:, 1])
    return weights, best / len(points) * 1e6
