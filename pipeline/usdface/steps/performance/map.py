"""Map a cleaned take to a performance, in blocks, so that memory is bounded."""

from collections import deque
from collections.abc import Callable, Iterator
from concurrent.futures import Future
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import tee

import numpy as np

from usdface.core.arrays import BoolArray, FloatArray
from usdface.core.assets import Rig, TrainedMapping
from usdface.core.errors import InputError, as_input_error
from usdface.core.processes import background_threads, usable_cores
from usdface.core.progress import Progress
from usdface.core.provenance import Provenance
from usdface.core.sidecars import head_path, weights_path
from usdface.core.text import counted, first_few, pluralize
from usdface.model.mapping.head_space import (
    MINIMUM_SHARE,
    HeadSpace,
    MappedMarkers,
    pose_error_note,
)
from usdface.model.mapping.performer_face import face_of_mapping
from usdface.model.mapping.predict import Prediction, WeightPredictor, basis_of, regions_of
from usdface.model.mapping.rig_match import check_same_rig
from usdface.model.mapping.temporal import TemporalSolve, smooth_weights
from usdface.model.placement.rig_orientation import check_rig_upright
from usdface.model.review.verdict import VISIBLE_ERROR_MM, judge_solve
from usdface.numerics.rigid.rigid_alignment import pose_matrices
from usdface.runner.result import StepResult
from usdface.specs.paths import frame_range
from usdface.specs.performance import MapSpec
from usdface.steps.inputs.alpha_keys import read_alpha
from usdface.steps.inputs.cleaned_takes import read_markers_at, take_head_space
from usdface.steps.inputs.edit_ranges import performance_notes
from usdface.steps.inputs.solve_verdict import evidence_of, with_verdict
from usdface.usdio.mapping import read_mapping
from usdface.usdio.performance.driving_layers import write_head_layer
from usdface.usdio.performance.read import PerformanceReader
from usdface.usdio.performance.weights_layer import SolveFigures, append_rig_shapes, make_header
from usdface.usdio.performance.write import writing_performance
from usdface.usdio.rig.drive_targets import HeadDrive
from usdface.usdio.rig.read import read_rig
from usdface.usdio.take.read import TakeReader

MAX_WORKERS = 4
"""Largest number of prediction threads; the writing thread cannot consume the output of more."""

MarkerSource = Callable[[], MappedMarkers]
"""Returns the markers of some frames in the mapping's space; called in a prediction thread."""

QUEUE_DEPTH = 2
"""Predicted blocks that wait to be written, to bound memory."""


def predict_pipelined(
    mapping: TrainedMapping, sources: Iterator[MarkerSource]
) -> Iterator[Prediction]:
    """Yield the prediction of each source, in order, while threads predict the next ones.

    Array arithmetic releases the interpreter lock, which writing samples needs. The result does not
    depend on the number of threads.
    """
    predictor = WeightPredictor(mapping)

    def predict(source: MarkerSource) -> Prediction:
        markers = source()
        return predictor.predict(
            markers.positions, visible=markers.visible, confidence=markers.confidence
        )

    workers = min(MAX_WORKERS, usable_cores())
    with background_threads(workers) as submit:
        pending: deque[Future[Prediction]] = deque()
        for source in sources:
            pending.append(submit(predict, source))
            if len(pending) >= workers + QUEUE_DEPTH:
                yield pending.popleft().result()
        while pending:
            yield pending.popleft().result()


def predict_with_keyed_blend(
    mapping: TrainedMapping, sources: Iterator[MarkerSource], keyed: list[FloatArray]
) -> Iterator[Prediction]:
    """Yield the prediction of each window of frames, with a share for each of its frames."""
    parts = [
        predict_pipelined(replace(mapping, settings=mapping.settings | {"alpha": share}), each)
        for share, each in zip((1.0, 0.0), tee(sources), strict=True)
    ]
    for share, network, regression in zip(keyed, *parts, strict=True):
        blend = share[:, None] * network.weights + (1 - share[:, None]) * regression.weights
        yield replace(regression, weights=blend)


BLOCK_FRAMES = 1024
"""Frames per block. Blocks are counted from the take's first frame, so that a frame's result does
not depend on the range that is mapped: sums of other lengths round differently."""

LARGEST_LAYER_BYTES = 1 << 30
PART_BYTES = 1 << 27
"""Weights above `LARGEST_LAYER_BYTES` are written in parts of about `PART_BYTES`."""

_LISTED_FRAMES = 1000

_CONSTANT_MM, _CONSTANT_SHARE = 0.3, 0.5
"""Root mean square over markers of the mean residual of a take, and its share of the whole
residual, above which it is noted: twice the noise of a cleaned marker, and half."""


@dataclass
class _Residuals:
    """Sums of the written frames' residuals."""

    frames: int = 0
    total: FloatArray | float = 0.0
    """Sum over frames of each marker's residual vector."""
    squares: float = 0.0
    few_markers: list[BoolArray] = field(default_factory=list)
    """Frames with few markers, one array per block."""

    def add(self, solved: Prediction, rows: slice) -> None:
        residuals = solved.residuals_mm[rows].astype(np.float64)
        self.frames += len(residuals)
        self.total = self.total + residuals.sum(axis=0)
        self.squares += float((residuals**2).sum())
        self.few_markers.append(solved.few_markers[rows])


def run(spec: MapSpec, *, provenance: Provenance, progress: Progress) -> StepResult:
    """Map every frame of a take, block by block, and write the performance."""
    if spec.mapping is None:
        from usdface.steps.performance.baseline import run_baseline  # slow to import

        return run_baseline(spec, provenance, progress)
    mapping = read_mapping(spec.mapping)
    rig = read_rig(spec.rig, prim=spec.rig_prim)
    rig.check_has(
        mapping.shape_names, source=spec.mapping, remedy="select and train again for this rig"
    )
    notes = [*check_same_rig(mapping, rig), *check_rig_upright(rig)]
    if spec.alpha is not None and mapping.method != "hybrid":
        raise InputError(
            f"{spec.mapping}: alpha blends the two parts of a hybrid, and this mapping is "
            f"{mapping.method}; train with --method hybrid"
        )
    take = TakeReader(spec.take)
    first, last = take.frames_within(frame_range(spec.frames))
    space = take_head_space(take, face_of_mapping(mapping))
    driven = _driven(spec, take, mapping, space, rig, (first, last))
    temporal = TemporalSolve(spec.temporal, spec.cutoff, spec.lag, spec.bands)
    margin = temporal.margin_at(float(take.rate))
    blocks = list(take_blocks(take, first, last))
    windows = [_window(take, block, margin) for block in blocks]
    residuals = _Residuals()
    header = replace(
        make_header(
            rig,
            shape_names=append_rig_shapes(mapping.shape_names, rig),
            rate=take.rate,
            first_frame=first,
            last_frame=last,
            rig_path=spec.prim,
            regions=regions_of(mapping),
            timecode_start=take.timecode_at(first),
        ),
        neutral_frame=space.neutral.neutral_frame,
        basis=basis_of(mapping, rig, missing=space.missing),
        zeroed_shapes=driven.zeroed_shapes,
    )
    with writing_performance(
        spec.out,
        header,
        rig,
        part_frames=frames_per_part(spec, last - first + 1, len(rig.shapes)),
        above=[head_path(spec.out)] if spec.drive else [],
        provenance=provenance,
    ) as writer:
        predictions = _predict(spec, mapping, take, space, windows)
        for block, window, solved in zip(blocks, windows, predictions, strict=True):
            weights = smooth_weights(
                solved.weights,
                uncertainty_mm=solved.uncertainty[:, 0],
                ranges=mapping.ranges,
                rate=float(take.rate),
                solve=temporal,
            )
            rows = slice(
                max(first, block.start) - window.start, min(last + 1, block.stop) - window.start
            )
            figures = SolveFigures(solved.uncertainty, solved.coverage, solved.residual_mm)
            writer.append(weights[rows], figures.rows(rows))
            residuals.add(solved, rows)
            done = min(block.stop - 1, last)
            progress((done - first + 1) / (last - first + 1), f"mapped to frame {done}")
        write_head_layer(spec.out, header, rig, driven.transforms, provenance=provenance)
    notes += [*driven.notes, *_marker_notes(space), *space.neutral.notes(take.name)]
    if not np.ndim(space.pair_offset):  # a take with two pairs or more is aligned by them
        notes += _constant_residual_notes(residuals)
    notes += _few_marker_notes(first, np.concatenate(residuals.few_markers))
    notes += performance_notes(spec.out)
    return _report(spec, notes, space.neutral.figures())


def _predict(
    spec: MapSpec, mapping: TrainedMapping, take: TakeReader, space: HeadSpace, windows: list[range]
) -> Iterator[Prediction]:
    """Yield the prediction of each window of frames."""
    sources = (partial(space.place, read_markers_at(take, window)) for window in windows)
    if spec.alpha is None:
        return predict_pipelined(mapping, sources)
    first = windows[0].start  # windows overlap
    frames = np.arange(first, windows[-1].stop)
    alpha = read_alpha(spec.alpha, frames, rate=take.rate, whole=spec.frames is None)
    keyed = [alpha[window.start - first : window.stop - first] for window in windows]
    return predict_with_keyed_blend(mapping, sources, keyed)


def _driven(
    spec: MapSpec,
    take: TakeReader,
    mapping: TrainedMapping,
    space: HeadSpace,
    rig: Rig,
    frames: tuple[int, int],
) -> HeadDrive:
    """Return the transforms of --drive."""
    if not spec.drive:
        return HeadDrive()
    from usdface.model.retarget.head_pose import performer_onto_rig  # slow to import
    from usdface.steps.inputs.head_drive import named_targets, take_head_source

    targets = named_targets(rig, spec.drive)
    with as_input_error(f"{spec.mapping}: the performer cannot be aligned with the rig"):
        onto = performer_onto_rig(mapping, rig) @ pose_matrices(space.rotation, space.shift)
    return take_head_source(take, *frames).drive(rig, targets, onto)


def take_blocks(take: TakeReader, first: int, last: int) -> Iterator[range]:
    """Yield the whole blocks of the take that contain frames from first to last."""
    start = first - (first - take.first_frame) % BLOCK_FRAMES
    for block in range(start, last + 1, BLOCK_FRAMES):
        yield range(block, min(block + BLOCK_FRAMES, take.last_frame + 1))


def _window(take: TakeReader, block: range, margin: int) -> range:
    """Return a block with a margin of frames on both sides, within the take."""
    return range(
        max(block.start - margin, take.first_frame), min(block.stop + margin, take.last_frame + 1)
    )


def frames_per_part(spec: MapSpec, frames: int, shapes: int) -> int | None:
    """Return the frames of each part of the weights; None to write them whole."""
    if spec.chunk is not None:
        return spec.chunk
    frame_bytes = 4 * shapes
    return None if frames * frame_bytes <= LARGEST_LAYER_BYTES else PART_BYTES // frame_bytes


def _marker_notes(space: HeadSpace) -> list[str]:
    notes = []
    if space.missing:
        notes.append(
            f"the take lacks {len(space.missing)} of the mapping's markers: "
            f"{first_few(space.missing)}; they are estimated from the others, with higher "
            "uncertainty"
        )
    if space.extra:
        notes.append(f"not used, as the mapping lacks them: {counted(space.extra, 'marker')}")
    if space.pose_errors is not None and space.pose_errors.size_mm:
        notes.append(pose_error_note("the take", space.pose_errors.size_mm))
    if space.template is not None:
        notes.append(
            "its head motion was removed by other rigid markers than that of the references; its "
            "frames were aligned by those of the references"
        )
    if space.scale != 1.0:
        notes.append(
            f"every distance between its rigid markers is {space.scale:.3f} times that of the "
            "references, as if calibrations differed; ingest it again with "
            f"{1 / space.scale:.3f} times its --scale (default 1)"
        )
    if space.moved_mm:
        notes.append(
            f"the rigid markers were put on again, {space.moved_mm:.1f} mm (root mean square) "
            "from where they were. The whole face determines the head's pose instead; look at the "
            "neutral frame"
        )
    return notes


def _constant_residual_notes(residuals: _Residuals) -> list[str]:
    """Return a note if most of the residual is the same in every frame."""
    mean = np.asarray(residuals.total) / max(residuals.frames, 1)
    constant_mm = float(np.sqrt((mean**2).sum(axis=-1).mean()))
    share = residuals.frames * float((mean**2).sum()) / max(residuals.squares, 1e-12)
    if constant_mm <= _CONSTANT_MM or share <= _CONSTANT_SHARE:
        return []
    return [
        f"{share:.0%} of the residual is the same in every frame, {constant_mm:.2f} mm: this take "
        "differs as a whole from those of the references; key two or more of its frames, which "
        "align it, and add them to the references"
    ]


def _few_marker_notes(first: int, few_markers: BoolArray) -> list[str]:
    frames = first + np.flatnonzero(few_markers)
    if not len(frames):
        return []
    return [
        f"fewer than {MINIMUM_SHARE:.0%} of the mapping's markers in "
        f"{pluralize(len(frames), 'frame')} ({first_few(frames)}): weights there are unreliable; "
        "fill the markers in the take, or key the frames as edits"
    ]


def _report(spec: MapSpec, notes: list[str], neutral: dict[str, object]) -> StepResult:
    """Return the result, by the figures that the layer stores, as every later step reads them."""
    reader = PerformanceReader(spec.out)
    evidence = evidence_of(reader)
    uncertainty, residual = map(np.asarray, (evidence.uncertainty_mm, evidence.residual_mm))
    uncertain = np.flatnonzero(uncertainty[:, 0] > evidence.on_rig(VISIBLE_ERROR_MM))
    result = StepResult(
        (spec.out, weights_path(spec.out), *([head_path(spec.out)] if spec.drive else [])),
        pluralize(len(uncertainty), "frame"),
        tuple(notes),
        {
            "frames": len(uncertainty),
            "mean_uncertainty_mm": float(uncertainty[:, 0].mean()),
            "uncertain_frames": (reader.first_frame + uncertain)[:_LISTED_FRAMES].tolist(),
            "residual_mm": float(np.sqrt((residual[:, 0] ** 2).mean())),
            "neutral": neutral,
        },
    )
    return with_verdict(result, judge_solve(evidence))
