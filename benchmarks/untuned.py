"""Error and uncertainty of solves trained on no or few tuned pairs.

Performers are simulated as in `real_captures`, with other seeds. 50 references are selected from
the first half of the performance, and the second half is mapped. Tuned pairs have the true weights,
the others those proposed. The uncertainty without the term for proposals is given for comparison.
"""

from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy.stats import spearmanr

from benchmarks._placement_subjects import (
    Head,
    SimulatedTake,
    find_equation,
    head_of,
    simulate_take,
)
from benchmarks.performers import choose_pairs
from tests.conftest import SHARED_DATA
from tests.model.synthetic import sample_skin
from usdface.core.assets import References, TrainedMapping
from usdface.demo.rig import demo_rig
from usdface.model.mapping.motion_space import fit_motion_space
from usdface.model.mapping.predict import WeightPredictor
from usdface.model.mapping.train import train_mapping
from usdface.model.mapping.uncertainty import LIMIT_DEVIATIONS, proposal_error
from usdface.usdio.rig.read import read_rig

SEEDS = (11, 12)
PAIRS = 50
TUNED = (0, 10, 25, 40)


def run() -> None:
    """Print the table."""
    if not (SHARED_DATA / "rigs").is_dir():
        print(f"skipped: no rigs in {SHARED_DATA}")
        return
    heads = {
        name: head_of(read_rig(SHARED_DATA / "rigs" / f"{name}.usdc"))
        for name in ("facecap_head", "ict_face")
    }
    heads["demo_character"] = head_of(demo_rig())
    print(
        "error [mm], expected error [mm], Spearman of both, share within nine in ten, of the face"
    )
    print("and the worst region; then the last three without the proposals' error\n")
    cells = "error | expected | Spearman | face | worst | expected | face | worst"
    print(f"| performer | tuned | {cells} |\n|---|---|{'---|' * 8}")
    for name, head in heads.items():
        for seed in SEEDS:
            take = simulate_take(head.skin, head.rig.shapes, seed=seed)
            for tuned in TUNED:
                row = _score(head, take, tuned, seed)
                print(f"| {name}, {seed} | {tuned} of {PAIRS} | {' | '.join(row)} |", flush=True)


def _score(head: Head, take: SimulatedTake, tuned: int, seed: int) -> list[str]:
    half, rig = len(take.positions) // 2, head.rig
    first = take.positions[:half]
    equation = find_equation(head, first, take.neutral, take.rigid, take.labels)
    motion = fit_motion_space([first.astype(np.float32)])
    chosen = choose_pairs(first, motion, PAIRS)
    proposals = equation.propose(take.positions[chosen])
    is_tuned = np.random.default_rng(seed).permutation(PAIRS) < tuned
    weights = np.where(is_tuned[:, None], take.weights[chosen], proposals)
    references = References(
        marker_names=take.labels,
        shape_names=rig.shapes,
        markers=take.positions[chosen],
        weights=weights,
        frames=chosen,
        takes=("take",) * PAIRS,
        tuned=is_tuned,
        rigid=(),
        neutral=take.neutral,
        rig_file=Path("rig.usdc"),
        rig_prim="/",
        motion=motion,
    )
    offsets = head.deformer.shapes.target_offsets()
    mapping = train_mapping(
        references,
        ranges=rig.ranges,
        gram=(offsets @ offsets.T).toarray() / len(head.deformer.neutral),
        skin=sample_skin(offsets),
        method="face_map",
    )
    low, span = rig.ranges[:, 0], np.ptp(rig.ranges, axis=1)
    shown, proposed = (np.clip((each - low) / span, 0, 1) for each in (weights, proposals))
    own = proposal_error(mapping.arrays["uncertainty_grams"], shown, is_tuned, proposed)
    known = replace(mapping, arrays=mapping.arrays | {"uncertainty_proposals": own})
    error, said = _errors(known, take, half, span)
    without = _errors(mapping, take, half, span)[1]
    expected, *within = _cells(error, said)
    rank = spearmanr(error[:, 0], said[:, 0])[0]
    rms = np.sqrt((error[:, 0] ** 2).mean())
    return [f"{rms:.2f}", expected, f"{rank:.2f}", *within, *_cells(error, without)]


def _errors(
    mapping: TrainedMapping, take: SimulatedTake, half: int, span: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return error and uncertainty of the second half: (frames, regions) each [mm]."""
    found = WeightPredictor(mapping).predict(take.positions[half:])
    off = (found.weights - take.weights[half:]) / span
    grams = mapping.arrays["uncertainty_grams"]
    squared = np.einsum("fs,rst,ft->fr", off, grams, off, optimize=True)
    return np.sqrt(np.maximum(squared, 0)), found.uncertainty


def _cells(error: np.ndarray, said: np.ndarray) -> list[str]:
    within = (error <= LIMIT_DEVIATIONS * said).mean(axis=0)
    return [f"{said[:, 0].mean():.2f}", f"{within[0]:.0%}", f"{within[1:].min():.0%}"]
