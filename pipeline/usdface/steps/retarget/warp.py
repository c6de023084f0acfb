"""Blend keyed sequences into a target's performance."""

import math
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path

import numpy as np

from usdface.core.arrays import FloatArray, index_of
from usdface.core.assets import Rig
from usdface.core.controls import (
    ControlClip,
    Controls,
    ControlSpace,
    EmotionalSequence,
    SequenceMatch,
)
from usdface.core.deformer import Deformer
from usdface.core.errors import InputError
from usdface.core.progress import Progress, part
from usdface.core.provenance import Provenance
from usdface.core.sidecars import controls_path, weights_path
from usdface.core.text import first_few, pluralize
from usdface.media.charts.motion_curves import (
    FrameSpan,
    before_and_after,
    draw_motion_curves,
    windows_around,
)
from usdface.media.picture.image import write_image
from usdface.model.placement.shape_parts import shape_parts
from usdface.model.retarget.control_space import control_space
from usdface.numerics.measure.face_regions import shapes_by_region
from usdface.numerics.motion.blink_cuts import keep_blinks
from usdface.numerics.motion.laplacian_warp import (
    Insertion,
    ease_weights,
    stretch_motion,
    warp_motion,
)
from usdface.runner.result import StepResult
from usdface.specs.retarget import WarpSpec
from usdface.steps.inputs.edit_ranges import performance_notes
from usdface.steps.inputs.solve_verdict import judge_performance, with_verdict
from usdface.steps.retarget.make_sequence import read_sequence_at
from usdface.usdio.performance.driving_layers import head_layer_xforms
from usdface.usdio.performance.read import PerformanceReader
from usdface.usdio.performance.weights_layer import (
    NO_FIGURES,
    SolveFigures,
    WeightsHeader,
    animation_name,
)
from usdface.usdio.retarget.control_performance import writing_control_performance
from usdface.usdio.retarget.controls import read_control_clip
from usdface.usdio.retarget.sequences import read_matches
from usdface.usdio.rig.reference import read_rig_of_stage

PUBLISHED_KEEP = 1.0
_CHUNK_FRAMES = 8192


@dataclass(frozen=True)
class _Placement:
    """A sequence and the frames of the performance that it replaces."""

    match: SequenceMatch
    sequence: EmotionalSequence
    first_frame: int
    frame_count: int
    rate_note: str = ""
    """Note if the sequence was resampled."""

    @property
    def last_frame(self) -> int:
        return self.first_frame + self.frame_count - 1


def run(spec: WarpSpec, *, provenance: Provenance, progress: Progress) -> StepResult:
    """Warp every control to the sequences and write the performance."""
    reader = PerformanceReader(spec.performance)
    rig = read_rig_of_stage(reader.stage, reader.animation)
    read = read_control_clip(spec.performance)
    placements = _placements(spec, read)
    space = control_space(read.controls)
    before = space.encode(read.controls)
    progress(0.3, "warping")
    insertions = [_insertion(spec, each, read, space, before) for each in placements]
    lids = shapes_by_region(shape_parts(rig, Deformer(rig))).get("lids", ())
    columns = [column for column, name in enumerate(space.shapes) if rig.shapes.index(name) in lids]
    insertions = keep_blinks(
        before, insertions, np.array(columns, int), rate=float(read.rate), blend=spec.blend
    )
    keep = math.inf if spec.outside == "exact" else PUBLISHED_KEEP
    after = warp_motion(before, insertions, blend=spec.blend, keep=keep)
    # Weights stay in the ranges of the rig, the performance and the sequences together.
    count = len(space.shapes)
    ranges = rig.ranges_of(space.shapes)
    parts = [before[:, :count], *(each.keys[:, :count] for each in insertions)]
    low = np.min([ranges[:, 0], *(part.min(axis=0) for part in parts)], axis=0)
    high = np.max([ranges[:, 1], *(part.max(axis=0) for part in parts)], axis=0)
    np.clip(after[:, :count], low, high, out=after[:, :count])
    # Unchanged frames keep their controls, as rotations change by rounding when converted.
    warped = _replace_changed(read.controls, space.decode(after), after != before)
    progress(0.6, "writing")
    header = replace(reader.header, name=animation_name(rig), combinations=rig.combinations)
    figures = _figures_outside(spec, reader, placements)
    if figures is NO_FIGURES:
        header = replace(header, regions=(), basis=None)
    _write(spec, rig, header, warped, figures, part(progress, 0.6, 0.95), provenance)
    if spec.curves is not None:
        _draw(spec, spec.curves, placements, space, before, after, read, provenance)
    changed = int((after != before).any(axis=1).sum())
    outputs = [spec.out, weights_path(spec.out)]
    if warped.joints or warped.attributes:
        outputs.append(controls_path(spec.out))
    result = StepResult(
        (*outputs, *spec.paths_of("curves")),
        f"{pluralize(len(placements), 'sequence')} in {len(before)} frames; "
        f"{pluralize(changed, 'frame')} changed",
        (
            *filter(None, dict.fromkeys(each.rate_note for each in placements)),
            *_length_notes(placements),
            *performance_notes(spec.out),
            *_head_notes(reader),
        ),
        {
            "frames": len(before),
            "changed": changed,
            "sequences": [
                {
                    "label": each.sequence.label,
                    "found": [each.match.first_frame, each.match.last_frame],
                    "placed": [each.first_frame, each.last_frame],
                }
                for each in placements
            ],
        },
        table=tuple(
            f"{each.first_frame}-{each.last_frame} {each.sequence.label}, found at "
            f"{each.match.first_frame}-{each.match.last_frame}"
            for each in placements
        ),
    )
    return with_verdict(result, judge_performance(PerformanceReader(spec.out)))


def _figures_outside(
    spec: WarpSpec, reader: PerformanceReader, placements: list[_Placement]
) -> SolveFigures:
    """Return the figures of a solve, which do not hold in sequences: interpolated there."""
    frames = reader.frames
    inside = np.zeros(len(frames), dtype=bool)
    for each in placements:
        first, last = each.first_frame - spec.blend, each.last_frame + spec.blend
        inside |= (first <= frames) & (frames <= last)
    if not reader.regions or inside.all():
        return NO_FIGURES

    def filled(column: FloatArray) -> FloatArray:
        return np.interp(frames, frames[~inside], column[~inside])

    figures = reader.figures()
    return SolveFigures(
        *(None if each is None else np.apply_along_axis(filled, 0, each) for each in figures)
    )


def _placements(spec: WarpSpec, read: ControlClip) -> list[_Placement]:
    matches = read_matches(spec.matches, rate=read.rate)
    if not matches:
        raise InputError(
            f"{spec.matches}: holds no active match; find sequences again or activate one"
        )
    first, last = read.first_frame, read.last_frame
    sequences: dict[Path, tuple[EmotionalSequence, str]] = {}
    placed = []
    for match in sorted(matches, key=lambda each: each.first_frame):
        if match.sequence not in sequences:
            sequences[match.sequence] = read_sequence_at(match.sequence, read.rate)
        sequence, note = sequences[match.sequence]
        _check_controls(match, sequence, read.controls, spec.performance)
        found = match.last_frame - match.first_frame + 1
        count = len(sequence.target) if spec.timing == "own" else found
        where = f"{match.sequence.name} at frame {match.first_frame}"
        stop = match.first_frame + count - 1
        if match.first_frame < first or stop > last:
            raise InputError(
                f"{where}: would replace frames {match.first_frame}-{stop}, but {spec.performance} "
                f"has {first}-{last}; deactivate the match, move it, or use --timing fit"
            )
        placed.append(_Placement(match, sequence, match.first_frame, count, note))
    for one, other in pairwise(placed):
        if other.first_frame <= one.last_frame:
            raise InputError(
                f"{spec.matches}: {one.sequence.label} at {one.first_frame}-{one.last_frame} and "
                f"{other.sequence.label} at {other.first_frame}-{other.last_frame} overlap; "
                "deactivate one, move it, or use --timing fit"
            )
    return placed


def _length_notes(placements: list[_Placement]) -> list[str]:
    """Return a note on frames between the ends of sequences and of their matches."""
    between = []
    for each in placements:
        ends = sorted((each.match.last_frame, each.last_frame))
        fate = "replaced" if each.last_frame == ends[1] else "kept"
        if ends[0] < ends[1]:
            after = f"{each.sequence.label} at {each.first_frame}-{ends[0]}"
            between.append(f"{ends[0] + 1}-{ends[1]} after {after} {fate}")
    if not between:
        return []
    return [
        f"sequences and their matches differ in length: {first_few(between, most=3)}; --timing fit "
        "fits sequences to their matches"
    ]


def _head_notes(reader: PerformanceReader) -> list[str]:
    """Return a note on animated Xforms, which are not warped."""
    xforms = head_layer_xforms(reader)
    if not xforms:
        return []
    return [
        f"not warped nor written, as Xforms are no controls: {first_few(xforms)}; their motion is "
        "in the performance's head layer"
    ]


def _check_controls(
    match: SequenceMatch, sequence: EmotionalSequence, controls: Controls, performance: Path
) -> None:
    target = sequence.target
    for kind, needed, available in (
        ("shapes", target.shapes, controls.shapes),
        ("joints", target.joints, controls.joints),
        ("attributes", target.attributes, controls.attributes),
    ):
        unknown = [name for name in needed if name not in available]
        if unknown:
            raise InputError(
                f"{match.sequence}: {len(unknown)} of its {kind} are not in {performance}: "
                f"{first_few(unknown)}; give sequences of the same character"
            )


def _insertion(
    spec: WarpSpec, each: _Placement, read: ControlClip, space: ControlSpace, before: FloatArray
) -> Insertion:
    """Return a sequence as keys of the performance's controls.

    Controls that the sequence lacks keep the performance's values.
    """
    target = each.sequence.target
    start = each.first_frame - read.first_frame
    rows = slice(start, start + each.frame_count)
    rows_of_joints = [space.joints.index(name) for name in target.joints]
    sequence_space = ControlSpace(
        target.shapes,
        target.joints,
        target.attributes,
        space.mean_rotations[rows_of_joints],
        space.scale_signs[rows_of_joints],
    )
    motion = sequence_space.encode(target)
    weights = each.sequence.key_weights[:, None]
    if len(motion) != each.frame_count:
        motion = stretch_motion(motion, each.frame_count)
        weights = stretch_motion(weights, each.frame_count)
    keys = before[rows].copy()
    place = index_of(space.names)
    keys[:, [place[name] for name in sequence_space.names]] = motion
    ease = min(spec.blend, each.frame_count // 4)
    eased = ease_weights(each.frame_count, spec.weight, ease=ease)
    return Insertion(start, keys, eased * np.maximum(weights[:, 0], 0.0))


def _replace_changed(old: Controls, new: Controls, changed: np.ndarray) -> Controls:
    rows = changed.any(axis=1)

    def pick(one: FloatArray, other: FloatArray) -> FloatArray:
        return np.where(rows.reshape(-1, *(1,) * (one.ndim - 1)), other, one)

    return old.mapped(pick, new)


def _write(
    spec: WarpSpec,
    rig: Rig,
    header: WeightsHeader,
    warped: Controls,
    figures: SolveFigures,
    progress: Progress,
    provenance: Provenance,
) -> None:
    with writing_control_performance(
        spec.out,
        header,
        rig,
        joints=warped.joints,
        attributes=warped.attributes,
        provenance=provenance,
    ) as writer:
        for start in range(0, len(warped), _CHUNK_FRAMES):
            rows = slice(start, start + _CHUNK_FRAMES)
            writer.append(warped.rows(rows), figures.rows(rows))
            progress(start / len(warped), f"writing frame {header.first_frame + start}")


def _draw(
    spec: WarpSpec,
    path: Path,
    placements: list[_Placement],
    space: ControlSpace,
    before: FloatArray,
    after: FloatArray,
    read: ControlClip,
    provenance: Provenance,
) -> None:
    labels = ", ".join(dict.fromkeys(each.sequence.label for each in placements))
    spans = [FrameSpan(p.first_frame, p.last_frame, p.sequence.label) for p in placements]
    picture = draw_motion_curves(
        f"{spec.performance.stem}: before and after warping",
        (
            f"{pluralize(len(placements), 'sequence')}: {labels}",
            f"weight {spec.weight:g}, blend {spec.blend}",
        ),
        before_and_after(space.names, before, after),
        first_frame=read.first_frame,
        windows=windows_around(spans, first_frame=read.first_frame, last_frame=read.last_frame),
        spans=spans,
    )
    write_image(path, picture, metadata=provenance.metadata)
