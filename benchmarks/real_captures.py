"""Recorded markers: head pose, placement on a rig, and proposals.

Recorded: `markers_animface`, one performer, 41 markers, no skull cap. Distances to landmarks picked
by hand are measured in the front view; they are not errors, since a marker may be next to its
feature. Clear errors are a nose tip off the nose, a lid marker below the lid margin, and roll.
Simulated: `crosstake`, and performers made from each rig, with known weights and positions.
"""

import json
import tempfile
import time
from pathlib import Path

import numpy as np

from benchmarks._crosstalk import print_crosstalk
from benchmarks._damage import DAMAGES
from benchmarks._placement_subjects import Head, find_equation, head_of, simulate_take
from benchmarks._takes import markers_of, performer_of
from benchmarks.crosstake import prepare, read_ruler, score
from tests.conftest import SHARED_DATA
from tests.model.synthetic import skin_samples
from usdface.capture.sniff import read_capture
from usdface.core.arrays import FloatArray
from usdface.demo.rig import demo_rig
from usdface.model.placement.label_hints import label_hint, skin_motion_mm
from usdface.model.selection.baseline import BlendshapeEquation, set_up_equation
from usdface.numerics.registration.skin_placement import explained_share, solve_weights_at
from usdface.numerics.regression.cross_validation import surface_rms_mm
from usdface.numerics.repair.cleaning import clean_markers
from usdface.numerics.rigid.rigid_alignment import align_rigid_robust
from usdface.usdio.rig.read import read_rig
from usdface.usdio.take.read import read_take

TAKES = {
    "CheeksMoCap": ("forehead", "bridge", "brow", "eye corner"),
    "EyebrowsMoCap": ("mouth", "chin", "nose", "cheek"),
}
"""Recorded takes, with the regions that do not move."""

MOVING = {"CheeksMoCap": ("cheeks and nose", "mouth"), "EyebrowsMoCap": ("brows",)}
"""Regions of a rig that each take moves."""

BROWS = ("brow", "forehead")
"""Regions that move in EyebrowsMoCap; motion elsewhere is crosstalk or residual head motion."""

LANDMARKS = {"nose": "NoseHead", "chin": "Chin", "mouth_L": "Mouth_Lend", "mouth_R": "Mouth_Rend"}
LIDS = {"lidup_L": "Leye_Up", "lidup_R": "Reye_Up"}
SEEDS = (1, 2, 3)
"""Seeds of the simulated performers of each rig."""

EVERY_FRAME = 4
"""Every n-th frame of the recorded takes is used for shares."""


Claims = list[tuple[str, str, str]]


def run() -> None:
    """Print the tables."""
    if not (SHARED_DATA / "markers_animface").is_dir():
        print(f"skipped: no markers_animface in {SHARED_DATA}")
        return
    claims: Claims = []
    print("### Head pose: error at the mouth, against the part of each take that is still\n")
    print("| take | RMS [mm] |\n|---|---|")
    cleaned: dict[str, FloatArray] = {}
    labels: tuple[str, ...] = ()
    for name, still in TAKES.items():
        positions, labels = _read(name)
        cleaned[name], error = _clean(positions, labels, still)
        print(f"| {name} | {error:.2f} |", flush=True)
        target = "≤ 1.6" if name == "CheeksMoCap" else "≤ 0.45"
        claims.append((f"pose at the mouth [mm], {name}", f"{error:.2f}", target))
    heads = {
        "facecap_head": head_of(read_rig(SHARED_DATA / "rigs" / "facecap_head.usdc")),
        "ict_face": head_of(read_rig(SHARED_DATA / "rigs" / "ict_face.usdc")),
        "demo_character": head_of(demo_rig()),
    }
    equations = _placements(heads, cleaned, labels, claims)
    _motion_outside(equations, cleaned, labels, claims)
    print_crosstalk(equations, cleaned, MOVING, heads)
    _starting_weights(heads, claims)
    print("\n| measure | value | wanted |\n|---|---|---|")
    for measure, value, target in claims:
        print(f"| {measure} | {value} | {target} |")


def _read(name: str) -> tuple[FloatArray, tuple[str, ...]]:
    markers = markers_of(read_capture(SHARED_DATA / "markers_animface" / f"{name}.c3d").take)
    return markers.positions.astype(float), markers.names


def _clean(
    positions: FloatArray, labels: tuple[str, ...], still: tuple[str, ...]
) -> tuple[FloatArray, float]:
    """Clean a take; return its markers and the error of the pose at the mouth."""
    regions = [label_hint(label).region for label in labels]
    seen = np.ones(positions.shape[:2], bool)
    prior = skin_motion_mm(labels)
    rigid = [i for i, motion in enumerate(prior) if motion <= 1.0]
    cleaned = clean_markers(positions, seen, rigid=rigid, neutral=0, skin_motion_mm=prior)
    columns = [i for i, region in enumerate(regions) if region in still]
    true = align_rigid_robust(
        positions[:, columns], positions[0, columns], visible=seen[:, columns]
    ).matrices()
    mouth = positions[0, [i for i, region in enumerate(regions) if region == "mouth"]]
    points = np.column_stack([mouth, np.ones(len(mouth))])
    away = np.einsum("fij,mj->fmi", cleaned.head_motion - true, points)[..., :3]
    return cleaned.positions.astype(float), float(np.sqrt((away**2).sum(axis=2).mean()))


Equations = dict[tuple[str, str], BlendshapeEquation]


def _placements(
    heads: dict[str, Head],
    cleaned: dict[str, FloatArray],
    labels: tuple[str, ...],
    claims: Claims,
) -> Equations:
    """Print marker positions; return the equations of the placements by labels."""
    picked = json.loads((SHARED_DATA / "rigs" / "landmarks.json").read_text())
    print(
        "\n### Placement: distance from landmarks [mm]; lids above their margin [mm]; roll "
        "[degrees]\n"
    )
    print(
        "Roll is that of the line from chin to forehead; about 1.9 degrees of it are the "
        "performer's own: his forehead marker sits 6 mm beside his plane of symmetry.\n"
    )
    columns = (*LANDMARKS, *LIDS, "roll", "explained", "motion scale", "seconds")
    print(f"| rig, take, labels | {' | '.join(columns)} |\n|{'---|' * (len(columns) + 1)}")
    equations: Equations = {}
    silent = tuple(f"m{i}" for i in range(len(labels)))
    worst = {"nose": 0.0, "lid": np.inf, "roll": 0.0, "named": 0.0, "silent": 0.0}
    for rig_name, head in heads.items():
        for take, positions in cleaned.items():
            for kind, given in (("named", labels), ("silent", silent)):
                begun = time.process_time()
                equation = find_equation(head, positions, positions[0], (), given)
                seconds = time.process_time() - begun
                row = _row(equation, head, positions, picked[rig_name], labels)
                cells = " | ".join(f"{each:.2f}" for each in (*row, seconds))
                print(f"| {rig_name}, {take}, {kind} | {cells} |", flush=True)
                worst[kind] = max(worst[kind], seconds)
                if kind == "named":
                    equations[rig_name, take] = equation
                    worst["nose"] = max(worst["nose"], row[0])
                    worst["lid"] = min(worst["lid"], *row[4:6])
                    worst["roll"] = max(worst["roll"], row[6])
    claims += [
        ("nose tip from its landmark [mm], worst", f"{worst['nose']:.1f}", "≤ 4.5"),
        ("upper lids' markers above the margin [mm], worst", f"{worst['lid']:.1f}", "≥ 0"),
        ("roll [degrees], worst", f"{worst['roll']:.1f}", "≤ 2"),
        ("placement by labels [s], worst", f"{worst['named']:.1f}", "≤ 10"),
        ("placement by motion [s], worst", f"{worst['silent']:.1f}", "≤ 30"),
    ]
    return equations


def _row(
    equation: BlendshapeEquation,
    head: Head,
    positions: FloatArray,
    picked: dict[str, list[float]],
    labels: tuple[str, ...],
) -> list[float]:
    """Return distances, heights, roll, explained share and scale of a placement."""
    places = equation.virtual.places(head.deformer.neutral)
    at = dict(zip(labels, places, strict=True))
    row = [float(np.hypot(*(at[label][:2] - picked[name]))) for name, label in LANDMARKS.items()]
    row += [float(at[label][1] - picked[name][1]) for name, label in LIDS.items()]
    upward = at["ForeHead_M"] - at["Chin"]
    row.append(abs(float(np.degrees(np.arctan2(upward[0], upward[1])))))
    moved = head.skin.to_frame(equation.motion(positions))
    samples = skin_samples(head.skin, equation.virtual)
    weights = solve_weights_at(head.skin, samples, moved, head.rig.ranges)
    share = explained_share(head.skin, samples, moved, weights)
    return [*row, share, equation.virtual.motion_scale]


def explained_positions(equation: BlendshapeEquation, weights: FloatArray) -> FloatArray:
    """Return marker positions on the performer for given weights: (frames, markers, 3) [mm]."""
    keys = equation.keys
    moved = np.einsum("fk,kmc->fmc", keys.key_weights(weights), keys.deltas, optimize=True)
    virtual = equation.virtual
    return np.asarray(equation.neutral + moved / virtual.motion_scale @ virtual.rotation)


def _motion_outside(
    equations: Equations, cleaned: dict[str, FloatArray], labels: tuple[str, ...], claims: Claims
) -> None:
    """Print the share of motion outside the brows in a take that moves only the brows."""
    print("\n### Share of the solved motion outside the brows, EyebrowsMoCap\n")
    print("Sums over markers of the root mean square displacement.\n")
    print("| rig | share |\n|---|---|")
    outside = np.array([label_hint(label).region not in BROWS for label in labels])
    wanted = {"facecap_head": "≤ 28 %", "ict_face": "≤ 40 %"}
    for (rig_name, take), equation in equations.items():
        if take == "EyebrowsMoCap":
            weights = equation.propose(cleaned[take][::EVERY_FRAME])
            moved = ((explained_positions(equation, weights) - equation.neutral) ** 2).sum(axis=2)
            size = np.sqrt(moved.mean(axis=0))
            share = float(size[outside].sum() / size.sum())
            print(f"| {rig_name} | {share:.3f} |", flush=True)
            if rig_name in wanted:
                claims.append(
                    (f"motion outside the brows, {rig_name}", f"{share:.0%}", wanted[rig_name])
                )


def _starting_weights(heads: dict[str, Head], claims: Claims) -> None:
    """Measure proposals of performers with known weights."""
    print("\n### Weights to start from\n")
    print("Labels say nothing; or they number the markers of each part, as `mouth_R1`.\n")
    print("| performer | surface [mm] | blink bias | places, median [mm] |\n|---|---|---|---|")
    figures = {"crosstake": _crosstake(heads["facecap_head"])}
    for name, head in heads.items():
        for numbered in (False, True):
            rows = [_simulated(head, seed, numbered=numbered) for seed in SEEDS]
            surface, blink, places = np.mean(rows, axis=0)
            row = (float(surface), float(blink), float(places))
            figures[f"{name}, numbered" if numbered else name] = row
    for name, row in figures.items():
        cells = " | ".join(f"{each:.3f}" for each in row).replace("nan", "")
        print(f"| {name} | {cells} |", flush=True)
    surface, blink, _ = figures["crosstake"]
    claims.append(("weights to start from, crosstake [mm]", f"{surface:.3f}", "≤ 1.12"))
    claims.append(("their blink bias, off zero", f"{abs(blink):.3f}", "≤ 0.05"))


def _simulated(head: Head, seed: int, *, numbered: bool) -> tuple[float, float, float]:
    take = simulate_take(head.skin, head.rig.shapes, seed=seed)
    labels = take.numbered(head.skin, head.rig.shapes) if numbered else take.labels
    equation = find_equation(head, take.positions, take.neutral, take.rigid, labels)
    error = equation.propose(take.positions) - take.weights
    offsets = head.deformer.shapes.target_offsets()
    gram = (offsets @ offsets.T).toarray() / len(head.deformer.neutral)
    blinks = [i for i, name in enumerate(head.rig.shapes) if name.lower().startswith("eyeblink")]
    truth = take.weights[:, blinks]
    peaks = truth > np.quantile(truth, 0.97, axis=0)
    places = head.skin.to_frame(equation.virtual.places(head.deformer.neutral))
    away = np.linalg.norm(places - head.skin.positions[take.samples], axis=1)
    bias = float(error[:, blinks][peaks].mean())
    return surface_rms_mm(error, gram), bias, float(np.median(away))


def _crosstake(head: Head) -> tuple[float, float, float]:
    """Measure the second half of crosstake, without the unknown marker positions."""
    truth = np.load(SHARED_DATA / "crosstake" / "truth.npz")
    with tempfile.TemporaryDirectory() as name:
        prepare(Path(name), DAMAGES[0], truth)
        take = read_take(Path(name) / "x.clean.take.usda")
    equation = set_up_equation(head.rig, head.deformer, performer_of(take))
    weights = equation.propose(markers_of(take).positions)
    figures = score(read_ruler(), (head.rig.shapes, weights), truth, head.rig.file)
    return float(figures["vertex_rms_mm"]), float(figures["blink_bias"]), float("nan")
