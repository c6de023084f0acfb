"""Choose reference frames and propose weights for them."""

from dataclasses import dataclass

import numpy as np

from usdface.assets import BoolArray, FloatArray, IntArray, MotionSpace, References, Rig
from usdface.deformer import Deformer
from usdface.errors import InputError
from usdface.model.equation import set_up_equation
from usdface.model.motion import fit_motion_space
from usdface.numerics.regression.reference_design import design_gp_variance, whiten
from usdface.progress import Progress, silent
from usdface.provenance import Provenance
from usdface.specs.base import frame_range
from usdface.specs.references import SelectSpec, proposed_path, tuned_path
from usdface.steps.cleaned_takes import CleanedTakes, read_cleaned_takes
from usdface.steps.report import Report
from usdface.usdio.references import TunedPair, read_tuned_pairs, write_references
from usdface.usdio.rig import read_rig

DESIGN_DIMENSIONS = 32
"""Components that selection looks at: beyond these, faces differ by noise."""

USABLE_SHARE = 0.9
"""A frame with fewer markers than this is no example to learn from."""


def run(
    spec: SelectSpec, *, provenance: Provenance | None = None, progress: Progress = silent
) -> Report:
    """Choose pairs, propose weights by solving the blendshape equation, and write the asset."""
    progress(0.0, "reading the takes")
    takes = read_cleaned_takes(spec.takes)
    rig = read_rig(spec.rig, prim=spec.prim)
    progress(0.2, "measuring the motion")
    motion = fit_motion_space(takes.positions)
    kept = _kept_pairs(spec, takes)
    progress(0.3, "choosing frames")
    rows = _choose(spec, takes, motion, kept)
    progress(0.5, "placing the markers on the rig")
    weights = _propose(takes, rig, rows)
    references = _references(takes, rig, motion, rows, weights)
    progress(0.9, f"writing {spec.out.name}")
    write_references(
        spec.out,
        references,
        rig,
        tuned_path=tuned_path(spec.out),
        proposed_path=proposed_path(spec.out),
        provenance=provenance,
    )
    notes = []
    if takes.dropped:
        notes.append(
            f"{len(takes.dropped)} markers are not in every take and were left out: "
            f"{', '.join(takes.dropped[:5])}"
        )
    if kept:
        notes.append(f"{len(kept)} tuned pairs were kept where they are")
    progress(1.0, "done")
    return Report(
        (spec.out, proposed_path(spec.out), tuned_path(spec.out)),
        f"{len(rows)} pairs of {len(takes.frames)} frames, {len(rig.shapes)} shapes proposed",
        tuple(notes),
        {
            "pairs": len(rows),
            "frames": [int(takes.frames[row]) for row in rows],
            "takes": [takes.takes[row] for row in rows],
            "kept": len(kept),
        },
    )


@dataclass(frozen=True)
class _Kept:
    """A tuned pair of an earlier selection: its place, and its row among all frames."""

    pair: int
    row: int


def _kept_pairs(spec: SelectSpec, takes: CleanedTakes) -> list[_Kept]:
    """Find the frames of tuned pairs again; they must not move, or their weights would lie.

    Raises
    ------
    InputError
        If one is of a take that is not given, or there is no room for it.
    """
    rows = {(t, int(f)): i for i, (t, f) in enumerate(zip(takes.takes, takes.frames, strict=True))}
    tuned: list[TunedPair] = read_tuned_pairs(tuned_path(spec.out))
    lost = [each for each in tuned if (each.take, each.frame) not in rows]
    if lost:
        raise InputError(
            f"{tuned_path(spec.out)}: pair {lost[0].pair + 1} was tuned for frame "
            f"{lost[0].frame} of {lost[0].take}, which is not among the takes given; give that "
            "take as well, or write to another --out"
        )
    beyond = [each for each in tuned if each.pair >= spec.count]
    if beyond:
        raise InputError(
            f"{tuned_path(spec.out)}: pair {beyond[-1].pair + 1} is tuned, so --count must be at "
            f"least {beyond[-1].pair + 1}, not {spec.count}"
        )
    return [_Kept(each.pair, rows[each.take, each.frame]) for each in tuned]


def _choose(
    spec: SelectSpec, takes: CleanedTakes, motion: MotionSpace, kept: list[_Kept]
) -> IntArray:
    """Return the row of each pair; kept pairs stay where they are."""
    open_rows = _open_rows(spec, takes)
    already = np.array([each.row for each in kept], dtype=np.int64)
    free = int(open_rows.sum()) - int(open_rows[already].sum())
    wanted = spec.count - len(kept)
    if free < wanted:
        raise InputError(
            f"{spec.count} pairs are asked for and {free + len(kept)} frames can be used; lower "
            "--count, widen --frames or give more takes"
        )
    dimensions = min(DESIGN_DIMENSIONS, len(motion.variances))
    coordinates = np.concatenate(
        [
            (cloud.reshape(len(cloud), -1) - motion.mean) @ motion.components[:dimensions].T
            for cloud in takes.positions
        ]
    )
    features = whiten(coordinates, motion.variances[:dimensions])
    chosen = design_gp_variance(features, wanted, already=already, candidates=open_rows).chosen
    rows = np.full(spec.count, -1, dtype=np.int64)
    for each in kept:
        rows[each.pair] = each.row
    rows[rows < 0] = chosen
    return rows


def _open_rows(spec: SelectSpec, takes: CleanedTakes) -> BoolArray:
    usable = np.concatenate([each.mean(axis=1) for each in takes.usable])
    open_rows: BoolArray = usable >= USABLE_SHARE
    limits = frame_range(spec.frames)
    if limits is not None:
        open_rows &= (takes.frames >= limits[0]) & (takes.frames <= limits[1])
    return open_rows


def _propose(takes: CleanedTakes, rig: Rig, rows: IntArray) -> FloatArray:
    positions = np.concatenate(takes.positions)
    usable = np.concatenate(takes.usable)
    equation = set_up_equation(
        rig,
        Deformer(rig),
        neutral=takes.neutral,
        positions=positions,
        visible=usable,
        rigid=tuple(takes.marker_names.index(name) for name in takes.rigid),
    )
    return equation.propose(positions[rows], visible=usable[rows])


def _references(
    takes: CleanedTakes, rig: Rig, motion: MotionSpace, rows: IntArray, weights: FloatArray
) -> References:
    positions = np.concatenate(takes.positions)
    return References(
        marker_names=takes.marker_names,
        shape_names=rig.shapes,
        markers=positions[rows].astype(np.float64),
        weights=weights,
        frames=takes.frames[rows],
        takes=tuple(takes.takes[row] for row in rows),
        tuned=np.zeros(len(rows), dtype=np.bool_),
        rigid=takes.rigid,
        neutral=takes.neutral,
        rig_file=rig.file,
        rig_prim=rig.prim,
        motion=motion,
    )
