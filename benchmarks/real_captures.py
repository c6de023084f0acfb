"""Recorded markers: head pose, placement on a rig, and proposals.

Recorded: `markers_animface`, one performer, 41 markers, no skull cap. Distances to landmarks picked
by hand are measured in the front view; they are not errors, since a marker may be next to its
feature. Clear errors are a nose tip off the nose, a lid marker below the lid margin, and roll.
Simulated: `crosstake`, and performers made from each rig, with known weights and positions.
Figures of commit ea0f6c3 on the same files are given for comparison: rigid markers chosen in each
take, closest points, three scales for motion.
"""

import json
import tempfile
import time
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from benchmarks._crosstalk import print_crosstalk
from benchmarks._damage import DAMAGES
from benchmarks._placement_subjects import simulate_take
from benchmarks.crosstake import prepare, read_ruler, score
from tests.conftest import SHARED_DATA
from tests.model.synthetic import skin_samples
from usdface.capture.sniff import read_capture
from usdface.core.arrays import FloatArray
from usdface.core.assets import Rig
from usdface.core.deformer import Deformer
from usdface.demo.rig import demo_rig
from usdface.model.placement.label_hints import label_hint, skin_motion_mm
from usdface.model.selection.baseline import BlendshapeEquation, PerformerMarkers, set_up_equation
from usdface.numerics.registration.face_skin import FaceSkin
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

FOLDS = 5
EVERY_FRAME = 4
"""Every n-th frame of the recorded takes is used for shares and left-out markers."""

EARLIER_POSE_MM = {"CheeksMoCap": 1.21, "EyebrowsMoCap": 0.41}
EARLIER_PLACES = {
    ("facecap_head", "CheeksMoCap"): (10.9, 9.4, 7.2, 8.1, -9.9, -12.9, 4.1, 0.740, 0.825),
    ("facecap_head", "EyebrowsMoCap"): (0.8, 13.9, 14.4, 13.6, -0.3, -0.7, 1.9, 0.532, 1.045),
    ("ict_face", "CheeksMoCap"): (5.9, 4.4, 9.8, 5.9, 2.7, 0.4, 1.1, 0.755, 0.833),
    ("ict_face", "EyebrowsMoCap"): (1.1, 13.6, 16.0, 12.1, 4.8, 0.4, 0.1, 0.460, 1.010),
    ("demo_character", "CheeksMoCap"): (20.0, 16.5, 4.1, 9.4, -43.9, -44.9, 9.4, 0.628, 0.338),
    ("demo_character", "EyebrowsMoCap"): (3.6, 7.4, 17.3, 16.8, -0.8, -0.5, 2.0, 0.390, 0.871),
}
EARLIER_OUTSIDE = {"facecap_head": 0.426, "ict_face": 0.502, "demo_character": 0.379}
EARLIER_HELD_OUT = {
    ("facecap_head", "CheeksMoCap"): 0.458,
    ("facecap_head", "EyebrowsMoCap"): 0.672,
    ("ict_face", "CheeksMoCap"): 0.455,
    ("ict_face", "EyebrowsMoCap"): 0.701,
    ("demo_character", "CheeksMoCap"): 0.531,
    ("demo_character", "EyebrowsMoCap"): 0.748,
}
EARLIER_MOTION_MM = {"CheeksMoCap": 6.62, "EyebrowsMoCap": 2.99}
"""Root mean square motion of the stabilised markers, which depends on the head pose."""
EARLIER_WEIGHTS = {
    "crosstake": (1.502, 0.014, np.nan),
    "facecap_head": (1.168, 0.007, 0.80),
    "ict_face": (1.001, -0.008, 1.01),
    "demo_character": (1.080, 0.026, 3.42),
}
"""Surface error [mm], blink bias, median error of marker positions [mm]."""


@dataclass(frozen=True)
class Head:
    """A rig with its deformer and skin."""

    rig: Rig
    deformer: Deformer
    skin: FaceSkin


Claims = list[tuple[str, str, str]]


def run() -> None:
    """Print the tables."""
    if not (SHARED_DATA / "markers_animface").is_dir():
        print(f"skipped: no markers_animface in {SHARED_DATA}")
        return
    claims: Claims = []
    print("### Head pose: error at the mouth, against the part of each take that is still\n")
    print("| take | RMS [mm] | ea0f6c3 |\n|---|---|---|")
    cleaned: dict[str, FloatArray] = {}
    labels: tuple[str, ...] = ()
    for name, still in TAKES.items():
        positions, labels = _read(name)
        cleaned[name], error = _clean(positions, labels, still)
        print(f"| {name} | {error:.2f} | {EARLIER_POSE_MM[name]:.2f} |", flush=True)
        target = "≤ 1.6" if name == "CheeksMoCap" else "≤ 0.45"
        claims.append((f"pose at the mouth [mm], {name}", f"{error:.2f}", target))
    heads = {
        "facecap_head": head_of(read_rig(SHARED_DATA / "rigs" / "facecap_head.usdc")),
        "ict_face": head_of(read_rig(SHARED_DATA / "rigs" / "ict_face.usdc")),
        "demo_character": head_of(demo_rig()),
    }
    equations = _placements(heads, cleaned, labels, claims)
    _motion_outside(equations, cleaned, labels, claims)
    _held_out_markers(equations, cleaned)
    print_crosstalk(
        {name: (cleaned[name], labels, MOVING[name]) for name in TAKES},
        {name: head.rig for name, head in heads.items()},
    )
    _starting_weights(heads, claims)
    print("\n| measure | value | wanted |\n|---|---|---|")
    for measure, value, target in claims:
        print(f"| {measure} | {value} | {target} |")


def head_of(rig: Rig) -> Head:
    deformer = Deformer(rig)
    return Head(rig, deformer, deformer.face_skin())


def _read(name: str) -> tuple[FloatArray, tuple[str, ...]]:
    markers = read_capture(SHARED_DATA / "markers_animface" / f"{name}.c3d").take.markers
    if markers is None:
        raise SystemExit(f"{name}: no markers")
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
                print(f"| {rig_name}, {take}, {kind} | {_cells([*row, seconds])} |", flush=True)
                worst[kind] = max(worst[kind], seconds)
                if kind == "named":
                    equations[rig_name, take] = equation
                    worst["nose"] = max(worst["nose"], row[0])
                    worst["lid"] = min(worst["lid"], *row[4:6])
                    worst["roll"] = max(worst["roll"], row[6])
            print(f"| {rig_name}, {take}, ea0f6c3 | {_cells(EARLIER_PLACES[rig_name, take])} | |")
    claims += [
        ("nose tip from its landmark [mm], worst", f"{worst['nose']:.1f}", "≤ 4.5"),
        ("upper lids' markers above the margin [mm], worst", f"{worst['lid']:.1f}", "≥ 0"),
        ("roll [degrees], worst", f"{worst['roll']:.1f}", "≤ 2"),
        ("placement by labels [s], worst", f"{worst['named']:.1f}", "≤ 10"),
        ("placement by motion [s], worst", f"{worst['silent']:.1f}", "≤ 30"),
    ]
    return equations


def _cells(values: list[float] | tuple[float, ...]) -> str:
    return " | ".join(f"{each:.2f}" for each in values)


def find_equation(
    head: Head,
    positions: FloatArray,
    neutral: FloatArray,
    rigid: tuple[int, ...],
    labels: tuple[str, ...],
) -> BlendshapeEquation:
    return set_up_equation(
        head.rig,
        head.deformer,
        PerformerMarkers(
            neutral=neutral,
            positions=positions,
            visible=np.ones(positions.shape[:2], np.bool_),
            rigid=rigid,
            labels=labels,
        ),
    )


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
    moved = equation.motion(positions) @ head.skin.frame.T
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
    print("| rig | share | ea0f6c3 |\n|---|---|---|")
    outside = np.array([label_hint(label).region not in BROWS for label in labels])
    wanted = {"facecap_head": "≤ 28 %", "ict_face": "≤ 40 %"}
    for (rig_name, take), equation in equations.items():
        if take == "EyebrowsMoCap":
            weights = equation.propose(cleaned[take][::EVERY_FRAME])
            moved = ((explained_positions(equation, weights) - equation.neutral) ** 2).sum(axis=2)
            size = np.sqrt(moved.mean(axis=0))
            share = float(size[outside].sum() / size.sum())
            print(f"| {rig_name} | {share:.3f} | {EARLIER_OUTSIDE[rig_name]:.3f} |", flush=True)
            if rig_name in wanted:
                claims.append(
                    (f"motion outside the brows, {rig_name}", f"{share:.0%}", wanted[rig_name])
                )


def _held_out_markers(equations: Equations, cleaned: dict[str, FloatArray]) -> None:
    """Print the error at left-out markers."""
    print(
        f"\n### Markers held out of the solve, {FOLDS} folds: error, and over that of no motion\n"
    )
    print("| rig, take | RMS [mm] | ea0f6c3 | ratio | ea0f6c3 |\n|---|---|---|---|---|")
    for (rig_name, take), equation in equations.items():
        positions = cleaned[take][::EVERY_FRAME]
        order = np.random.default_rng(0).permutation(positions.shape[1])
        off, still = 0.0, 0.0
        for fold in range(FOLDS):
            out = order[fold::FOLDS]
            trust = equation.trust.copy()
            trust[out] = 0.0
            part = replace(equation, trust=trust)
            predicted = explained_positions(part, part.propose(positions))
            off += float(((positions[:, out] - predicted[:, out]) ** 2).sum())
            still += float(((positions[:, out] - equation.neutral[out]) ** 2).sum())
        earlier = EARLIER_HELD_OUT[rig_name, take]
        ratio, motion_mm = np.sqrt(off / still), np.sqrt(still / positions[..., 0].size)
        print(
            f"| {rig_name}, {take} | {ratio * motion_mm:.2f} | "
            f"{earlier * EARLIER_MOTION_MM[take]:.2f} | {ratio:.3f} | {earlier:.3f} |",
            flush=True,
        )


def _starting_weights(heads: dict[str, Head], claims: Claims) -> None:
    """Measure proposals of performers with known weights."""
    print("\n### Weights to start from\n")
    print("Labels say nothing; or they number the markers of each part, as `mouth_R1`.\n")
    names = ("surface [mm]", "blink bias", "places, median [mm]")
    columns = [column for name in names for column in (name, "ea0f6c3")]
    print(f"| performer | {' | '.join(columns)} |\n|{'---|' * (len(columns) + 1)}")
    figures = {"crosstake": _crosstake(heads["facecap_head"])}
    for name, head in heads.items():
        for numbered in (False, True):
            rows = [_simulated(head, seed, numbered=numbered) for seed in SEEDS]
            surface, blink, places = np.mean(rows, axis=0)
            row = (float(surface), float(blink), float(places))
            figures[f"{name}, numbered" if numbered else name] = row
    for name, row in figures.items():
        pairs = zip(row, EARLIER_WEIGHTS.get(name, (np.nan,) * 3), strict=True)
        cells = " | ".join(f"{now:.3f} | {earlier:.3f}" for now, earlier in pairs)
        cells = cells.replace("nan", "")
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
    places = equation.virtual.places(head.deformer.neutral) @ head.skin.frame.T
    away = np.linalg.norm(places - head.skin.positions[take.samples], axis=1)
    bias = float(error[:, blinks][peaks].mean())
    return surface_rms_mm(error, gram), bias, float(np.median(away))


def _crosstake(head: Head) -> tuple[float, float, float]:
    """Measure the second half of crosstake, without the unknown marker positions."""
    truth = np.load(SHARED_DATA / "crosstake" / "truth.npz")
    with tempfile.TemporaryDirectory() as name:
        prepare(Path(name), DAMAGES[0], truth)
        take = read_take(Path(name) / "x.clean.take.usda")
    markers = take.markers
    if markers is None:
        raise SystemExit("crosstake has no markers")
    neutral = markers.positions[markers.neutral_frame - take.first_frame].astype(float)
    rigid = tuple(markers.names.index(each) for each in markers.rigid)
    equation = set_up_equation(
        head.rig,
        head.deformer,
        PerformerMarkers(
            neutral=neutral,
            positions=markers.positions,
            visible=markers.visible,
            rigid=rigid,
            labels=markers.names,
        ),
    )
    weights = equation.propose(markers.positions)
    figures = score(read_ruler(), (head.rig.shapes, weights), truth, head.rig.file)
    return float(figures["vertex_rms_mm"]), float(figures["blink_bias"]), float("nan")
