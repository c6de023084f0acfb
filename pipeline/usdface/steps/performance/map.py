"""A cleaned take and a mapping in, a performance out; a take of any length in bounded memory."""

from collections.abc import Iterator
from functools import partial

import numpy as np

from usdface.core.assets import Rig, TrainedMapping
from usdface.core.errors import InputError
from usdface.core.progress import Progress, silent
from usdface.core.provenance import Provenance
from usdface.core.sidecars import weights_path
from usdface.core.text import pluralize
from usdface.model.mapping.head_space import MINIMUM_SHARE, HeadSpace
from usdface.model.mapping.predict import regions_of
from usdface.model.mapping.rig_match import check_same_rig
from usdface.model.mapping.temporal import TemporalSolve, smooth_weights
from usdface.numerics.array_namespace import ArrayDevice, open_device
from usdface.runner.result import StepResult
from usdface.specs.paths import frame_range
from usdface.specs.performance import MapSpec
from usdface.steps.inputs.edit_ranges import edit_notes
from usdface.steps.inputs.take_head_space import read_markers, take_head_space
from usdface.steps.performance.predict_blocks import check_blend, predict_pipelined, solve_blended
from usdface.usdio.mapping import read_mapping
from usdface.usdio.performance.weights_layer import make_header
from usdface.usdio.performance.write import writing_performance
from usdface.usdio.rig.read import read_rig
from usdface.usdio.take.read import TakeReader

BLOCK_FRAMES = 1024
"""Frames are solved in blocks counted from the take's first frame, whichever of them are asked for:
sums of another length would round otherwise, and frames mapped apart would not fit exactly."""

LARGEST_LAYER_BYTES = 1 << 30
PART_BYTES = 1 << 27
"""Weights that take more than the first are written in parts of about the second."""

_DOUBTFUL = 0.5
"""Confidence below which a frame is worth a look."""


def run(
    spec: MapSpec, *, provenance: Provenance | None = None, progress: Progress = silent
) -> StepResult:
    """Map every frame of a take and write the performance as it goes."""
    device = _open_device(spec)
    mapping = read_mapping(spec.mapping)
    rig = read_rig(spec.rig, prim=spec.rig_prim)
    changes = _check_rig(spec, mapping, rig)
    if spec.alpha is not None:
        check_blend(spec.mapping, mapping)
    take = TakeReader(spec.take)
    first, last = frame_range(spec.frames) or (take.first_frame, take.last_frame)
    _check_frames(spec, take, first, last)
    space = take_head_space(take, mapping)
    solve = TemporalSolve(spec.temporal, spec.cutoff, spec.lag, spec.bands)
    confidence: list[np.ndarray] = []
    residual: list[np.ndarray] = []
    lacking: list[np.ndarray] = []
    with writing_performance(
        spec.out,
        make_header(
            rig,
            shape_names=mapping.shape_names,
            rate=take.rate,
            first_frame=first,
            last_frame=last,
            place=spec.prim,
            regions=regions_of(mapping),
            timecode_start=take.timecode_at(first),
        ),
        rig,
        part_frames=_part_frames(spec, last - first + 1, len(mapping.shape_names)),
        provenance=provenance,
    ) as writer:
        blocks = list(_blocks(take, first, last))
        windows = [_window(take, block, solve.margin_at(float(take.rate))) for block in blocks]
        placed = (
            partial(space.place, read_markers(take, each.start, each.stop - 1)) for each in windows
        )
        answers = (
            predict_pipelined(mapping, placed, device=device)
            if spec.alpha is None
            else solve_blended(mapping, placed, spec.alpha, windows, device=device)
        )
        for block, window, solved in zip(blocks, windows, answers, strict=True):
            weights = smooth_weights(
                solved.weights,
                confidence=solved.confidence,
                ranges=mapping.ranges,
                rate=float(take.rate),
                solve=solve,
                device=device,
            )
            asked = slice(
                max(first, block.start) - window.start, min(last + 1, block.stop) - window.start
            )
            writer.append(
                weights[asked],
                confidence=solved.confidence[asked],
                residual_mm=solved.region_residual_mm[asked],
            )
            confidence.append(solved.confidence[asked])
            residual.append(solved.residual_mm[asked])
            lacking.append(solved.lacking[asked])
            done = min(block.stop - 1, last)
            progress((done - first + 1) / (last - first + 1), f"mapped to frame {done}")
    notes = [
        *changes,
        *_notes(space),
        *_lacking_notes(first, np.concatenate(lacking)),
        *edit_notes(spec.out),
    ]
    return _report(spec, first, np.concatenate(confidence), np.concatenate(residual), notes)


def _open_device(spec: MapSpec) -> ArrayDevice:
    try:
        return open_device(spec.device)
    except ValueError as error:
        raise InputError(f"map --device: {error}") from error


def _check_frames(spec: MapSpec, take: TakeReader, first: int, last: int) -> None:
    if first < take.first_frame or last > take.last_frame:
        raise InputError(
            f"{spec.take}: frames {first}-{last} are not all in the take, which has "
            f"{take.first_frame}-{take.last_frame}"
        )


def _blocks(take: TakeReader, first: int, last: int) -> Iterator[range]:
    """Yield the whole blocks of the take that hold the frames asked for."""
    start = first - (first - take.first_frame) % BLOCK_FRAMES
    for block in range(start, last + 1, BLOCK_FRAMES):
        yield range(block, min(block + BLOCK_FRAMES, take.last_frame + 1))


def _window(take: TakeReader, block: range, margin: int) -> range:
    """Return a block with frames around it, as far as the take goes."""
    return range(
        max(block.start - margin, take.first_frame), min(block.stop + margin, take.last_frame + 1)
    )


def _part_frames(spec: MapSpec, frames: int, shapes: int) -> int | None:
    if spec.chunk is not None:
        return spec.chunk
    frame_bytes = 4 * shapes
    return None if frames * frame_bytes <= LARGEST_LAYER_BYTES else PART_BYTES // frame_bytes


def _check_rig(spec: MapSpec, mapping: TrainedMapping, rig: Rig) -> tuple[str, ...]:
    missing = [name for name in mapping.shape_names if name not in rig.shapes]
    if len(missing) == len(mapping.shape_names):
        raise InputError(
            f"{spec.rig}: none of the mapping's {len(missing)} shapes ({', '.join(missing[:3])}, "
            f"...) is on this rig, which has {', '.join(rig.shapes[:3])}, ...; is it the rig the "
            "mapping was trained for?"
        )
    if missing:
        raise InputError(
            f"{spec.rig}: {len(missing)} of the mapping's {len(mapping.shape_names)} shapes are "
            f"not on this rig: {', '.join(missing[:5])}; train again for it"
        )
    return check_same_rig(mapping, rig)


def _notes(space: HeadSpace) -> list[str]:
    notes = []
    if space.missing:
        notes.append(
            f"the take lacks {len(space.missing)} of the mapping's markers: "
            f"{', '.join(space.missing[:5])}; the others speak for them, with less confidence"
        )
    if space.extra:
        notes.append(
            f"unknown to the mapping, and not heard: {pluralize(len(space.extra), 'marker')}, "
            f"{', '.join(space.extra[:5])}"
        )
    return notes


def _lacking_notes(first: int, lacking: np.ndarray) -> list[str]:
    frames = first + np.flatnonzero(lacking)
    if not len(frames):
        return []
    some = ", ".join(map(str, frames[:5])) + (", ..." if len(frames) > 5 else "")
    return [
        f"fewer than {MINIMUM_SHARE:.0%} of the mapping's markers in "
        f"{pluralize(len(frames), 'frame')} ({some}): their weights are a guess, with "
        f"confidence 0; "
        "mend them in the take, or key them as edits"
    ]


def _report(
    spec: MapSpec, first: int, confidence: np.ndarray, residual: np.ndarray, notes: list[str]
) -> StepResult:
    low = np.flatnonzero(confidence < _DOUBTFUL)
    if len(low):
        worst = first + int(confidence.argmin())
        notes.append(
            f"confidence below {_DOUBTFUL:g} in {pluralize(len(low), 'frame')}, lowest at frame "
            f"{worst}: the references show nothing like them"
        )
    count = len(confidence)
    return StepResult(
        (spec.out, weights_path(spec.out)),
        f"{pluralize(count, 'frame')}, mean confidence {confidence.mean():.2f}, markers "
        f"{np.sqrt((residual**2).mean()):.2f} mm from what the references' takes showed",
        tuple(notes),
        {
            "frames": count,
            "mean_confidence": float(confidence.mean()),
            "doubtful_frames": [first + int(index) for index in low[:1000]],
            "residual_mm": float(np.sqrt((residual**2).mean())),
        },
    )
