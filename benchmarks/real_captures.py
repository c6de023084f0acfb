"""First contact with recorded markers: head pose, placement on a rig, and weights to start from.

Recorded: `markers_animface`, one performer, 41 markers, no skull cap. Distances are measured in the
front view to landmarks picked by hand; a marker may sit beside its feature, so that they are no
errors. Beyond doubt are a nose tip off the nose, a lid's marker below its margin, and roll.
Simulated: `crosstake`, whose keys are known.
"""

import json
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks._crosstalk import print_crosstalk
from benchmarks._damage import DAMAGES
from benchmarks.crosstake import prepare, read_ruler, score
from tests.conftest import SHARED_DATA
from usdface.capture.sniff import read_capture
from usdface.core.arrays import FloatArray
from usdface.core.deformer import Deformer
from usdface.demo.rig import demo_rig
from usdface.model.placement.label_hints import label_hint, skin_motion_mm
from usdface.model.placement.marker_cloud import marker_cloud
from usdface.model.placement.place import place_markers
from usdface.model.selection.baseline import set_up_equation
from usdface.numerics.registration.face_skin import sample_face_skin
from usdface.numerics.repair.cleaning import PosePrior, clean_markers
from usdface.numerics.rigid.rigid_alignment import align_rigid_robust
from usdface.usdio.rig.read import read_rig
from usdface.usdio.take.read import read_take

TAKES = {
    "CheeksMoCap": ("forehead", "bridge", "brow", "eye corner"),
    "EyebrowsMoCap": ("mouth", "chin", "nose", "cheek"),
}
"""Recorded takes, and the parts of the face that are still in each."""

MOVING = {"CheeksMoCap": ("cheeks and nose", "mouth"), "EyebrowsMoCap": ("brows",)}
"""Parts of a rig that each take moves."""

LANDMARKS = {"nose": "NoseHead", "chin": "Chin", "mouth_L": "Mouth_Lend", "mouth_R": "Mouth_Rend"}
LIDS = {"lidup_L": "Leye_Up", "lidup_R": "Reye_Up"}


def run() -> None:
    """Print the tables."""
    if not (SHARED_DATA / "markers_animface").is_dir():
        print(f"skipped: no markers_animface in {SHARED_DATA}")
        return
    takes = {name: _read(name) for name in TAKES}
    print("### Head pose: error at the mouth, against the part of each take that is still\n")
    print("| take | RMS [mm] |\n|---|---|")
    cleaned = {}
    for name, (positions, labels) in takes.items():
        cleaned[name], error = _clean(positions, labels, TAKES[name])
        print(f"| {name} | {error:.2f} |", flush=True)
    picked = json.loads((SHARED_DATA / "rigs" / "landmarks.json").read_text())
    rigs = {
        "facecap_head": read_rig(SHARED_DATA / "rigs" / "facecap_head.usdc"),
        "ict_face": read_rig(SHARED_DATA / "rigs" / "ict_face.usdc"),
        "demo_character": demo_rig(),
    }
    print(
        "\n### Placement: distance from landmarks [mm]; lids above their margin; roll [degrees]\n"
    )
    heads = (*LANDMARKS, *LIDS, "roll", "explained", "motion scale", "seconds")
    print(f"| rig, take, labels | {' | '.join(heads)} |\n|{'---|' * (len(heads) + 1)}")
    for rig_name, rig in rigs.items():
        deformer = Deformer(rig)
        skin = sample_face_skin(
            deformer.neutral, deformer.triangles, deformer.shapes.target_offsets()
        )
        for name, (_, labels) in takes.items():
            for known in ("labels", "no labels"):
                row = _placed(skin, rig, cleaned[name], labels, picked[rig_name], known)
                cells = " | ".join(f"{each:.2f}" for each in row)
                print(f"| {rig_name}, {name}, {known} | {cells} |", flush=True)
    print_crosstalk(
        {name: (cleaned[name], labels, MOVING[name]) for name, (_, labels) in takes.items()}, rigs
    )
    _starting_weights()


def _read(name: str) -> tuple[FloatArray, tuple[str, ...]]:
    markers = read_capture(SHARED_DATA / "markers_animface" / f"{name}.c3d").take.markers
    if markers is None:
        raise SystemExit(f"{name}: no markers")
    return markers.positions.astype(float), markers.names


def _clean(
    positions: FloatArray, labels: tuple[str, ...], still: tuple[str, ...]
) -> tuple[FloatArray, float]:
    """Clean a take by its labels' prior; return its markers and the pose's error at the mouth."""
    regions = [label_hint(label).region for label in labels]
    seen = np.ones(positions.shape[:2], bool)
    prior = skin_motion_mm(labels)
    rigid = [i for i, motion in enumerate(prior) if motion <= 1.0]
    cleaned = clean_markers(
        positions, seen, rigid=rigid, neutral=0, pose_prior=PosePrior(prior, 60.0)
    )
    columns = [i for i, region in enumerate(regions) if region in still]
    true = align_rigid_robust(
        positions[:, columns], positions[0, columns], visible=seen[:, columns]
    ).matrices()
    mouth = positions[0, [i for i, region in enumerate(regions) if region == "mouth"]]
    points = np.column_stack([mouth, np.ones(len(mouth))])
    away = np.einsum("fij,mj->fmi", cleaned.head_motion - true, points)[..., :3]
    return cleaned.positions.astype(float), float(np.sqrt((away**2).sum(axis=2).mean()))


def _placed(
    skin: Any,
    rig: Any,
    positions: FloatArray,
    labels: tuple[str, ...],
    picked: dict[str, list[float]],
    known: str,
) -> list[float]:
    """Place a take, and return distances, heights, roll, explained share, scale and seconds."""
    given = labels if known == "labels" else tuple(f"m{i}" for i in range(len(labels)))
    begun = time.perf_counter()
    cloud = marker_cloud(given, positions[0], positions)
    found = place_markers(cloud, skin, rig.shapes, ranges=rig.ranges)
    places, share = skin.positions[found.samples], found.explained
    scale = found.virtual.motion_scale
    seconds = time.perf_counter() - begun
    at = dict(zip(labels, places, strict=True))
    row = [float(np.hypot(*(at[label][:2] - picked[name]))) for name, label in LANDMARKS.items()]
    row += [float(at[label][1] - picked[name][1]) for name, label in LIDS.items()]
    upward = at["ForeHead_M"] - at["Chin"]
    row.append(abs(float(np.degrees(np.arctan2(upward[0], upward[1])))))
    return [*row, share, scale, seconds]


def _starting_weights() -> None:
    """Score weights that animators start from, by the shipped placement and the candidate's."""
    print("\n### Starting weights of crosstake's second half\n")
    truth = np.load(SHARED_DATA / "crosstake" / "truth.npz")
    rig_file = SHARED_DATA / "rigs" / "facecap_head.usdc"
    rig, ruler = read_rig(rig_file), read_ruler()
    deformer = Deformer(rig)
    with tempfile.TemporaryDirectory() as name:
        prepare(Path(name), DAMAGES[0], truth)
        take = read_take(Path(name) / "x.clean.take.usda")
    markers = take.markers
    if markers is None:
        raise SystemExit("crosstake has no markers")
    neutral = markers.positions[markers.neutral_frame - take.first_frame].astype(float)
    rigid = tuple(markers.names.index(each) for each in markers.rigid)
    print("| labels | surface [mm] | blink bias | jitter |\n|---|---|---|---|")
    equation = set_up_equation(
        rig,
        deformer,
        neutral=neutral,
        positions=markers.positions,
        visible=markers.visible,
        rigid=rigid,
        labels=markers.names,
    )
    weights = equation.propose(markers.positions)
    figures = score(ruler, (rig.shapes, weights), truth, rig_file)
    print(
        f"| silent | {figures['vertex_rms_mm']:.3f} | {figures['blink_bias']:+.3f} | "
        f"{figures['jitter']:.2f} |"
    )
