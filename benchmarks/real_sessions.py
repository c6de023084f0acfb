"""Several takes of one performer in one mapping: neutral faces, and markers reapplied.

Recorded: `markers_animface`, two takes with one application of markers. Simulated: the halves of
`crosstake` as two takes, the second with a random offset of each marker. All steps run through
specs and files, with untuned proposals.
"""

import json
import tempfile
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from benchmarks.crosstake import HALF
from tests.c3d_write import write_c3d
from tests.conftest import SHARED_DATA
from usdface.capture.sniff import read_capture
from usdface.core.arrays import FloatArray
from usdface.core.deformer import Deformer
from usdface.model.mapping.take_neutral import TakeNeutral
from usdface.runner.execute import execute
from usdface.specs.capture import CleanSpec, IngestSpec
from usdface.specs.performance import MapSpec, TrainSpec
from usdface.specs.references import SelectSpec
from usdface.steps.inputs.cleaned_takes import read_cleaned_takes
from usdface.steps.review.scoring import set_up_shot_baseline
from usdface.steps.review.shot import Shot, open_shot

PAIRS = 40
"""Pairs per take."""

LARGEST_WEIGHT = 0.15
"""Limit of the weights at a take's neutral frame."""

LARGEST_INCREASE = 0.05
"""Limit of the relative increase of a take's residual when another take is trained with it."""

SHIFTS_MM = (0.0, 1.0, 1.5, 2.0, 2.5, 3.0, 4.0)
HALVES = {"first": slice(0, HALF), "second": slice(HALF, None)}

EVERY = 4
"""Every n-th frame is used for the residual."""


def run() -> None:
    """Print the tables."""
    recorded = SHARED_DATA / "markers_animface"
    if not recorded.is_dir() or not (SHARED_DATA / "crosstake").is_dir():
        print(f"skipped: no markers_animface and crosstake in {SHARED_DATA}")
        return
    rigs = [SHARED_DATA / "rigs" / f"{name}.usdc" for name in ("facecap_head", "ict_face")]
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        takes = [
            _cleaned(folder, recorded / f"{each}MoCap.c3d", each) for each in ("Cheeks", "Eyebrows")
        ]
        halves = _write_halves(folder, 0.0)
        print("### Two takes trained together\n")
        print("| claim | wanted | measured |\n|---|---|---|")
        for rig in rigs:
            _together(folder, takes, rig)
        _together(folder, halves, rigs[0])
        print("\n### Reapplied markers\n")
        print(
            "| takes | shift, root mean square [mm] | distances with nothing in common | finding "
            "| error of the shift taken out [mm] |\n|---|---|---|---|---|"
        )
        _print_shift("AnimFace, as recorded", takes, None)
        _print_shift("AnimFace, in the other order", takes[::-1], None)
        for shift in SHIFTS_MM:
            _print_shift("crosstake", _write_halves(folder, shift), _shifts(shift))


def _cleaned(
    folder: Path, capture: Path, name: str, rigid: tuple[str, ...] = (), neutral: int | None = None
) -> Path:
    take, out = folder / f"{name}.take.usda", folder / f"{name}.clean.take.usda"
    execute(IngestSpec(sources=(capture,), out=take, rigid=rigid, neutral=neutral), overwrite=True)
    execute(CleanSpec(take=take, out=out), overwrite=True)
    return out


def _shifts(shift_mm: float) -> FloatArray:
    """Return random offsets of the markers."""
    said = json.loads((SHARED_DATA / "crosstake" / "take.json").read_text())
    rng = np.random.default_rng(22)
    return np.asarray(rng.normal(size=(len(said["labels"]), 3)) * shift_mm / np.sqrt(3))


def _write_halves(folder: Path, shift_mm: float) -> list[Path]:
    """Write the halves of crosstake as takes; the second states no neutral frame.

    Offsets are in head space: they are applied after head motion is removed.
    """
    source = SHARED_DATA / "crosstake"
    said = json.loads((source / "take.json").read_text())
    take = read_capture(source / "take.c3d").take
    if take.markers is None:
        raise SystemExit("crosstake has no markers")
    clean = folder / "whole.clean.take.usda"
    if not clean.exists():
        rigid = tuple(said["rigid"])
        _cleaned(folder, source / "take.c3d", "whole", rigid, said["neutral_frame"] + 1)
    whole = read_cleaned_takes((clean,))
    out = []
    for name, part in HALVES.items():
        positions = whole.positions[0][part].astype(np.float64)
        if name == "second":
            positions = positions + _shifts(shift_mm)
        capture = folder / f"{name}.c3d"
        write_c3d(
            capture,
            positions,
            whole.usable[0][part],
            whole.marker_names,
            rate=take.rate,
            first_frame=1,
        )
        neutral = said["neutral_frame"] + 1 if name == "first" else None
        out.append(_cleaned(folder, capture, name, tuple(said["rigid"]), neutral))
    return out


def _together(folder: Path, takes: Sequence[Path], rig: Path) -> None:
    """Print each take's residual by the mapping of all takes, divided by that of its own."""
    every = _mapping(folder, takes, rig, "together")
    for take in takes:
        name = f"{take.name.split('.')[0]} on {rig.stem}"
        own = _mapping(folder, [take], rig, "alone")
        alone, shared = folder / "alone.usda", folder / "together.usda"
        execute(MapSpec(take=take, mapping=own, rig=rig, out=alone), overwrite=True)
        execute(MapSpec(take=take, mapping=every, rig=rig, out=shared), overwrite=True)
        first, second = open_shot(alone, take), open_shot(shared, take)
        ruler = set_up_shot_baseline(first)
        rows = slice(None, None, EVERY)
        if name.startswith(tuple(HALVES)):
            # Neutral faces differ, and so do the reference positions of the markers.
            what = "error"
            residual = [_true_error(s, HALVES[take.name.split(".")[0]]) for s in (first, second)]
        else:
            what = "residual"
            residual = [
                float(np.sqrt((ruler.residual_mm(s.positions[rows], s.weights[rows]) ** 2).mean()))
                for s in (first, second)
            ]
        increase = residual[1] / residual[0] - 1
        print(
            f"| {name}: {what} {residual[0]:.2f} mm alone, {residual[1]:.2f} together: increase "
            f"| ≤ {LARGEST_INCREASE:.2f} | {increase:+.3f} |"
        )
        frame = second.performance.neutral_frame
        row = 0 if frame is None else frame - int(second.frames[0])
        most = int(second.weights[row].argmax())
        print(
            f"| {name}: largest weight at its neutral frame {frame} ({second.rig.shapes[most]}) "
            f"| ≤ {LARGEST_WEIGHT:g} | {second.weights[row, most]:.3f} |",
            flush=True,
        )


def _true_error(shot: Shot, part: slice) -> float:
    """Return the error of the surface by the true weights, root mean square [mm]."""
    truth = np.load(SHARED_DATA / "crosstake" / "truth.npz")
    names = [str(name) for name in truth["shapes"]]
    columns = [names.index(name) for name in shot.rig.shapes]
    off = shot.weights - truth["weights"].astype(float)[part][:, columns]
    off[:, [name.startswith("eyeLook") for name in shot.rig.shapes]] = 0.0
    gram = Deformer(shot.rig).shapes.gram()
    return float(np.sqrt(np.einsum("fs,st,ft->f", off, gram, off).mean()))


def _mapping(folder: Path, takes: Sequence[Path], rig: Path, name: str) -> Path:
    references, mapping = folder / f"{name}.references.usda", folder / f"{name}.mapping.usdc"
    for each in folder.glob(f"{name}.references*"):
        each.unlink()
    count = PAIRS * len(takes)
    execute(SelectSpec(takes=tuple(takes), rig=rig, out=references, count=count), overwrite=True)
    execute(TrainSpec(references=references, out=mapping), overwrite=True)
    return mapping


def _print_shift(name: str, takes: Sequence[Path], true: FloatArray | None) -> None:
    found: TakeNeutral = read_cleaned_takes(tuple(takes)).neutrals[1]
    error = "not known"
    shift = "0"
    if true is not None:
        away = found.offset - true
        away -= away.mean(axis=0)  # a common offset is head motion
        error = f"{np.sqrt((away**2).sum(axis=1).mean()):.2f}"
        shift = f"{np.sqrt((true**2).sum(axis=1).mean()):.1f}"
    finding = "reapplied" if found.is_reapplied else "nothing"
    print(f"| {name} | {shift} | {found.reapplied_share:.1%} | {finding} | {error} |", flush=True)
