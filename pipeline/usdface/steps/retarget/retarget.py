"""Retarget weights to one or more characters."""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from usdface.core.arrays import FloatArray
from usdface.core.assets import Rig
from usdface.core.controls import Controls, Retargeting, shape_controls
from usdface.core.errors import InputError
from usdface.core.progress import Progress, part
from usdface.core.provenance import Provenance
from usdface.core.sidecars import LAYER_SUFFIXES, controls_path, head_path, weights_path
from usdface.core.text import first_few, frame_ranges, pluralize
from usdface.model.placement.rig_orientation import describe_orientation
from usdface.model.retarget.face_correspondence import Correspondence, correspond, match_positions
from usdface.model.retarget.name_matching import Transfer
from usdface.model.retarget.train import limited_controls, predict_coordinates, unspanned_shares
from usdface.model.review.verdict import worst_verdict
from usdface.runner.result import StepResult
from usdface.specs.paths import frame_range
from usdface.specs.retarget import RetargetSpec
from usdface.steps.inputs.alpha_keys import read_alpha
from usdface.steps.inputs.edit_ranges import performance_notes
from usdface.steps.inputs.head_drive import named_targets, take_head_source, weights_head_source
from usdface.steps.inputs.solve_verdict import judge_performance, with_verdict
from usdface.steps.inputs.source_motion import (
    MOVING_WEIGHT,
    SourceMotion,
    read_source_motion,
    source_transfer,
    unmatched_moving,
)
from usdface.usdio.performance.driving_layers import write_head_layer
from usdface.usdio.performance.read import PerformanceReader
from usdface.usdio.performance.weights_layer import WeightsHeader, append_rig_shapes, make_header
from usdface.usdio.retarget.control_performance import writing_control_performance
from usdface.usdio.retarget.retargeting import read_retargeting
from usdface.usdio.rig.drive_targets import HeadDrive
from usdface.usdio.rig.read import read_rig
from usdface.usdio.take.read import TakeReader, is_take

_CHUNK_FRAMES = 8192

_CUT_SHARE = 0.1
"""[of a control's range] Least excess over it that is reported."""

_UNSPANNED_SHARE = 0.25
"""Share of the motion, mean square, from which the error is half of the motion or more."""


@dataclass(frozen=True)
class _Target:
    """A character, and the method of retargeting to it."""

    rig: Rig
    trained: Retargeting | None
    """None for retargeting by names or positions."""
    transfer: Transfer
    """From the source's shapes to those of the training, or of the rig."""
    notes: tuple[str, ...]
    unmatched: tuple[str, ...]
    """Moving shapes of the source without a counterpart."""
    unpaired: tuple[str, ...] = ()
    """Moving shapes of the source that drive only shapes that no pair uses."""
    surfaces: Correspondence | None = None
    """Between the source's rig and this one, to match positions."""

    @property
    def method(self) -> str:
        if self.trained is not None:
            return self.trained.method
        return "names" if self.surfaces is None else "positions"

    @property
    def shapes(self) -> tuple[str, ...]:
        return self.rig.shapes if self.trained is None else self.trained.shapes

    def controls(self, source: FloatArray, alpha: FloatArray | None) -> tuple[Controls, FloatArray]:
        """Return the controls for source weights, and coordinates before they are limited."""
        columns = source @ self.transfer.matrix
        if self.trained is not None:
            coordinates = predict_coordinates(self.trained, columns, alpha=alpha)
            return limited_controls(self.trained, coordinates), coordinates
        if self.surfaces is not None:
            columns = match_positions(self.surfaces, columns)
        return shape_controls(self.rig.shapes, columns), columns


def run(spec: RetargetSpec, *, provenance: Provenance, progress: Progress) -> StepResult:
    """Retarget to each target in turn; all are read before the first is written."""
    motion = read_source_motion(
        spec.source,
        frame_range(spec.frames),
        rate=spec.rate,
        weight_unit=spec.weight_unit,
        shapes=spec.shapes,
        take=spec.take,
    )
    targets = [_target(spec, index, motion) for index in range(len(spec.out))]
    heads = _heads(spec, motion, targets)
    alpha = None
    if spec.alpha is not None:
        frames = np.arange(motion.first_frame, motion.last_frame + 1)
        alpha = read_alpha(spec.alpha, frames, rate=motion.rate, whole=spec.frames is None)
    notes = [f"{spec.source.name}: {note}" for note in motion.notes]
    if motion.gaps:
        notes.append(
            f"{spec.source.name}: nothing was captured in {frame_ranges(motion.gaps)}; weights "
            "are interpolated there"
        )
    outputs: list[Path] = []
    for index, target in enumerate(targets):
        out = spec.out[index]
        share = part(progress, index / len(targets), (index + 1) / len(targets))
        header = _header(spec, motion, target, heads[index])
        extremes = _write(out, header, motion, target, heads[index], alpha, share, provenance)
        target_notes = (
            *target.notes,
            *_unlimited(target, extremes),
            *describe_orientation(target.rig),
            *heads[index].notes,
            *performance_notes(out),
        )
        notes += [f"{out.name}: {note}" for note in target_notes]
        outputs += [out, weights_path(out)]
        if target.trained and (target.trained.joints or target.trained.attributes):
            outputs.append(controls_path(out))
        if spec.drive:
            outputs.append(head_path(out))
    count = len(motion.weights)
    result = StepResult(
        tuple(outputs),
        f"{pluralize(count, 'frame')} on {pluralize(len(targets), 'target')}",
        tuple(notes),
        {
            "frames": count,
            "targets": [
                {
                    "out": str(out),
                    "method": target.method,
                    "shapes": len(target.shapes),
                    "joints": len(target.trained.joints) if target.trained else 0,
                    "attributes": len(target.trained.attributes) if target.trained else 0,
                    "pairs": target.transfer.rows(),
                    "unmatched": list(target.unmatched),
                }
                for out, target in zip(spec.out, targets, strict=True)
            ],
        },
    )
    verdicts = {out.name: judge_performance(PerformanceReader(out)) for out in spec.out}
    worst = worst_verdict({name: each for name, each in verdicts.items() if each is not None})
    return with_verdict(result, worst) if worst.level == "bad" else result


def _target(spec: RetargetSpec, index: int, motion: SourceMotion) -> _Target:
    if not spec.retargeting:
        rig = read_rig(spec.rig[index])
        if spec.source_rig is not None:
            source = read_rig(spec.source_rig)
            transfer, notes = source_transfer(spec.source, motion, source.shapes, spec.names)
            unmatched = unmatched_moving(transfer, motion)
            return _Target(rig, None, transfer, notes, unmatched, surfaces=correspond(source, rig))
        motion = replace(motion, driven=motion.driven | rig.logic.driven)
        transfer, notes = source_transfer(spec.source, motion, rig.shapes, spec.names)
        return _Target(rig, None, transfer, notes, unmatched_moving(transfer, motion))
    path = spec.retargeting[index]
    trained = read_retargeting(path)
    file = spec.rig[index] if spec.rig else trained.target_rig
    if file is None or not file.is_file():
        raise InputError(f"{path}: its target's rig {file or ''} is gone; name it with --rig")
    rig = read_rig(file, prim=None if spec.rig else trained.target_prim or None)
    rig.check_has(trained.shapes, source=path, remedy="train again for this rig")
    if spec.alpha is not None and trained.method != "hybrid":
        raise InputError(
            f"{path}: alpha blends the two parts of a hybrid, and this retargeting is "
            f"{trained.method}; train with --method hybrid"
        )
    transfer, notes = source_transfer(spec.source, motion, trained.source_shapes, spec.names)
    dead = _dead(spec, trained, motion, transfer)
    if dead:
        notes = (
            *notes,
            f"{len(dead)} source shapes move but are in no pair, or in a region that no pair keys "
            f"on the target, so the target does not follow: {first_few(dead)}",
        )
    notes = (*notes, *_unspanned(trained, motion.weights @ transfer.matrix))
    unmatched = unmatched_moving(transfer, motion)
    return _Target(rig, trained, transfer, notes, unmatched, unpaired=dead)


def _heads(spec: RetargetSpec, motion: SourceMotion, targets: list[_Target]) -> list[HeadDrive]:
    """Return the transforms of --drive for each target."""
    if not spec.drive:
        return [HeadDrive() for _ in targets]
    driven = [named_targets(each.rig, spec.drive) for each in targets]
    if spec.source.suffix.lower() in LAYER_SUFFIXES and is_take(spec.source):
        take = TakeReader(spec.source)
        head = take_head_source(take, motion.first_frame, motion.last_frame)
    else:
        head = weights_head_source(spec.source, motion.names, motion.weights)
    return [head.drive(each.rig, parts) for each, parts in zip(targets, driven, strict=True)]


def _header(
    spec: RetargetSpec, motion: SourceMotion, target: _Target, head: HeadDrive
) -> WeightsHeader:
    header = make_header(
        target.rig,
        shape_names=append_rig_shapes(target.shapes, target.rig),
        rate=motion.rate,
        first_frame=motion.first_frame,
        last_frame=motion.last_frame,
        rig_path=spec.prim,
        timecode_start=motion.timecode_start,
    )
    lost = set(target.unmatched) | set(target.unpaired)
    shares = {name: share for name, share in motion.shares.items() if name in lost}
    by_table = spec.names is not None  # then shapes are left out on purpose
    return replace(
        header,
        unmatched=tuple(shares),
        gaps=motion.gaps,
        zeroed_shapes=head.zeroed_shapes,
        unmatched_shares=() if by_table else tuple(shares.values()),
    )


def _write(
    out: Path,
    header: WeightsHeader,
    motion: SourceMotion,
    target: _Target,
    head: HeadDrive,
    alpha: FloatArray | None,
    progress: Progress,
    provenance: Provenance,
) -> FloatArray:
    """Write a performance; return the extremes of each coordinate without limits: (2, k)."""
    trained, extremes = target.trained, []
    with writing_control_performance(
        out,
        header,
        target.rig,
        joints=trained.joints if trained else (),
        attributes=trained.attributes if trained else (),
        above=[head_path(out)] if head.transforms else [],
        provenance=provenance,
    ) as writer:
        count = len(motion.weights)
        for start in range(0, count, _CHUNK_FRAMES):
            rows = slice(start, start + _CHUNK_FRAMES)
            keyed = None if alpha is None else alpha[rows]
            controls, coordinates = target.controls(motion.weights[rows], keyed)
            writer.append(controls)
            extremes += [coordinates.min(axis=0), coordinates.max(axis=0)]
            done = min(start + _CHUNK_FRAMES, count)
            progress(done / count, f"{out.name}: frame {motion.first_frame + done - 1}")
        write_head_layer(
            out, header, target.rig, head.transforms, controls=writer.layer, provenance=provenance
        )
    return np.stack([np.min(extremes, axis=0), np.max(extremes, axis=0)])


def _dead(
    spec: RetargetSpec, trained: Retargeting, motion: SourceMotion, transfer: Transfer
) -> tuple[str, ...]:
    """Return moving source shapes that are in no pair, or in a region that no pair keys.

    A motion of shapes that are in no pair is refused.
    """
    columns = motion.weights @ transfer.matrix
    moving = np.abs(columns).max(axis=0, initial=0.0) > MOVING_WEIGHT
    unused = trained.arrays["unused"] > 0
    linked = transfer.matrix != 0
    silent = unused | (trained.arrays["unfollowed"] > 0)
    dead = linked.any(axis=1) & ~linked[:, ~silent].any(axis=1)
    lost = {name for name, each in zip(transfer.source, dead, strict=True) if each}
    names = tuple(name for name in motion.shares if name in lost)
    if names and not (moving & ~unused).any():
        raise InputError(
            f"{spec.source}: moves only {first_few(names, most=3)}, which no pair of the "
            "retargeting uses, so nothing would move; key pairs for them and train again"
        )
    return names


def _unspanned(trained: Retargeting, source: FloatArray) -> list[str]:
    """Return a note on motion that is no sum of the pairs' expressions."""
    shares = unspanned_shares(trained, source)
    total = float(shares.sum())
    if total < _UNSPANNED_SHARE:
        return []
    largest = [trained.source_shapes[i] for i in np.argsort(-shares)[: np.count_nonzero(shares)]]
    return [
        f"{total:.0%} of the motion (mean square) is no sum of the pairs' expressions, most of it "
        f"of {first_few(largest, most=3)}: the target may be wrong by as much; key pairs in which "
        "they move alone, and train again"
    ]


def _unlimited(target: _Target, extremes: FloatArray) -> list[str]:
    """Return a note on controls that exceed their range, or would without limits."""
    names, ranges = target.rig.shapes, target.rig.ranges
    if target.trained is not None:
        names, ranges = target.trained.names, target.trained.ranges
        cause = "expressions that add up would drive"
        remedy = (
            "cut there, at the range of rig and pairs: key pairs of such expressions, or a pair "
            "with the full motion"
        )
    elif target.surfaces is not None:
        cause = "positions, which are matched without an upper limit, drive"
        remedy = "train on pairs, or `bake --limit`"
    else:
        extremes = np.where((target.transfer.matrix != 0).sum(axis=0) > 1, extremes, ranges.T)
        cause = "several source shapes add up on"
        remedy = (
            "MetaHuman's rig clamps its controls, for other rigs lower the weights with --names"
        )
    low, high = ranges.T
    below = np.where(low == 0, 0, low - extremes[0])  # below 0 overshoots rest, and is cut rightly
    beyond = np.maximum(below, extremes[1] - high) / np.maximum(high - low, 1e-9)
    above = np.flatnonzero(beyond > _CUT_SHARE).tolist()
    if not above:
        return []
    listed = first_few([f"{names[i]} (by {beyond[i]:.0%})" for i in above], most=3)
    whose = "its" if len(above) == 1 else "their"
    return [f"{cause} {pluralize(len(above), 'control')} beyond {whose} range: {listed}; {remedy}"]
