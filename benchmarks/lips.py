"""Lip contact on a take with known weights: lips wrongly open and wrongly closed.

References are from the first half of `crosstake`, errors are those of the second, by the lip
distance of `evaluate`. The solve is compared with closing afterwards by the rule of proposals
(`usdface.model.selection.lip_contact`).
"""

import tempfile
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from benchmarks import crosstake
from benchmarks._damage import DAMAGES
from benchmarks._takes import markers_of, performer_of
from tests.conftest import SHARED_DATA
from usdface.core.assets import Rig
from usdface.core.deformer import Deformer
from usdface.model.mapping.evaluation import Evaluation, evaluate_weights
from usdface.model.selection.baseline import set_up_equation
from usdface.model.selection.lip_contact import find_lips, keep_lip_contact
from usdface.usdio.rig.read import read_rig
from usdface.usdio.take.read import read_take

COUNTS = (25, 50)

CLOSED_MM = 0.03
"""Distance of closed lips: a sixth of a pixel if a face fills an HD picture."""


def run(counts: tuple[int, ...] = COUNTS) -> None:
    """Print errors of the lips' distance, and the frames that are wrongly open or closed."""
    if not (SHARED_DATA / "crosstake").is_dir():
        print(f"skipped: no crosstake in {SHARED_DATA}")
        return
    rig_file = SHARED_DATA / "rigs" / "facecap_head.usdc"
    truth = np.load(SHARED_DATA / "crosstake" / "truth.npz")
    rig = read_rig(rig_file)
    wanted = _in_rig_order(rig, [str(name) for name in truth["shapes"]], truth["weights"])
    print(f"second half of crosstake; closed: lips nearer than {CLOSED_MM} mm\n")
    print(
        "| references | lips | distance off, RMS [mm] | overlap where truth is closed [mm] | "
        "truth's | open though truth is closed | by [mm] | closed though truth is open | "
        "vertex RMS [mm] |"
    )
    print(f"|{'---|' * 9}")
    kept = []
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        crosstake.prepare(folder, DAMAGES[0], truth)
        for count in counts:
            references = crosstake.choose_references(folder, rig_file, count)
            solved = _in_rig_order(rig, *crosstake.map_take(references, rig_file, "auto"))
            found = _evaluate(rig, solved, wanted)
            _print_row(f"{count} | as solved", found)
            forced = _close(folder / "x.clean.take.usda", rig, solved)
            _print_row(f"{count} | closed afterwards", _evaluate(rig, forced, wanted))
            if found.lips is not None:
                closed = found.lips.truth_mm < CLOSED_MM
                still = int((found.lips.solved_mm[closed] < CLOSED_MM).sum())
                kept.append((count, still, int(closed.sum())))
    print("\n| measure | value | wanted |")
    print("|---|---|---|")
    for count, still, total in kept:
        target = "≥ 95 %" if count == max(counts) else ""
        print(f"| frames kept closed, {count} references | {still} of {total} | {target} |")


def _in_rig_order(rig: Rig, names: Sequence[str], weights: np.ndarray) -> np.ndarray:
    """Return the second half's weights."""
    columns = [list(names).index(name) for name in rig.shapes]
    return weights[crosstake.HALF :, columns].astype(float)


def _evaluate(rig: Rig, solved: np.ndarray, wanted: np.ndarray) -> Evaluation:
    every = np.ones(len(rig.shapes), dtype=bool)
    frames = np.arange(crosstake.HALF, crosstake.HALF + len(wanted))
    return evaluate_weights(rig, solved, wanted, frames=frames, compared=every, observable=every)


def _close(take_file: Path, rig: Rig, solved: np.ndarray) -> np.ndarray:
    """Close the character's lips in frames with the performer's lip markers near rest."""
    take, deformer = read_take(take_file), Deformer(rig)
    markers = markers_of(take)
    equation = set_up_equation(
        rig,
        deformer,
        performer_of(take),
    )
    lips = find_lips(equation, deformer, rig.shapes)
    if lips is None:
        raise SystemExit("crosstake's rig has a mouth, and its performer markers on the lips")
    return keep_lip_contact(
        equation, deformer, lips, markers.positions[crosstake.HALF :].astype(float), solved
    )


def _print_row(label: str, found: Evaluation) -> None:
    if found.lips is None:
        raise SystemExit("crosstake's rig has a mouth that its jaw opens")
    truth, solved = found.lips.truth_mm, found.lips.solved_mm
    closed = truth < CLOSED_MM
    left_open = closed & (solved >= CLOSED_MM)
    apart = float(solved[left_open].mean()) if left_open.any() else 0.0
    print(
        f"| {label} | {found.lips.rms_mm:.2f} | {-solved[closed].mean():.2f} | "
        f"{-truth[closed].mean():.2f} | {int(left_open.sum())} of {int(closed.sum())} | "
        f"{apart:.2f} | {int((~closed & (solved < CLOSED_MM)).sum())} of {int((~closed).sum())} | "
        f"{found.surface.rms_mm:.3f} |",
        flush=True,
    )
