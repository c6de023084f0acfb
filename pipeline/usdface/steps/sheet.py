"""A contact sheet: video, markers, the equation-solving baseline and the performance."""

from collections.abc import Iterator
from contextlib import ExitStack
from dataclasses import dataclass

import numpy as np

from usdface.assets import BoolArray, FloatArray, IntArray, Performance, Rig, Take
from usdface.deformer import Deformer
from usdface.errors import InputError
from usdface.media.camera import frame_rig
from usdface.media.error_strip import ErrorCurve
from usdface.media.image import write_image
from usdface.media.image_sequence import ImageSequence, open_video
from usdface.media.markers_view import draw_markers, frame_markers
from usdface.media.render import FaceRenderer
from usdface.media.sheet import SheetPage, SheetRow, Tile, compose_sheet
from usdface.media.video import VideoReader
from usdface.model.equation import BlendshapeEquation, set_up_equation
from usdface.progress import Progress, silent
from usdface.provenance import Provenance
from usdface.specs.base import frame_range
from usdface.specs.sheet import SheetSpec
from usdface.steps.cleaned_takes import read_cleaned
from usdface.steps.outputs import provenance_metadata
from usdface.steps.report import Report
from usdface.steps.weight_tables import read_weight_table
from usdface.timecode import shift_timecode
from usdface.usdio.performance import read_performance
from usdface.usdio.rig import read_rig

YAW_DEGREES = 12.0
"""A little from the side, where lips and lids show their depth."""

WORST_SHARE = 6
"""One row in so many shows a worst frame; the others show what the face does."""


@dataclass(frozen=True)
class _Judged:
    """Weights over the frames that a sheet may show, and their error.

    Attributes
    ----------
    label : str
    weights : (frames, shapes) float array
        In the rig's order.
    error_mm : (frames,) float array
        NaN where it is not known.
    """

    label: str
    weights: FloatArray
    error_mm: FloatArray


@dataclass(frozen=True)
class _Scene:
    """What is drawn: the frames of a take, and the face that is to act them."""

    take: Take
    frames: IntArray
    positions: FloatArray
    deformer: Deformer
    equation: BlendshapeEquation
    renderer: FaceRenderer


def run(
    spec: SheetSpec, *, provenance: Provenance | None = None, progress: Progress = silent
) -> Report:
    """Draw the sheet and write it."""
    progress(0.0, "reading")
    performance = read_performance(spec.performance)
    take = read_cleaned(spec.take)
    rig = read_rig(performance.rig_file, prim=performance.rig_prim)
    deformer = Deformer(rig)
    frames = _shared_frames(spec, performance, take)
    weights = _in_rig_order(performance, rig, frames)
    progress(0.1, "placing the markers on the rig")
    equation = _equation(take, rig, deformer)
    positions = _positions(take, frames)
    truth = _truth(spec, rig, frames)
    judged = []
    if spec.baseline:
        solved = equation.solve_published(positions)
        judged.append(_judge("equation", solved, truth, equation, positions, deformer))
    judged.append(_judge("usdface", weights, truth, equation, positions, deformer))
    rows = _choose_rows(judged[-1], deformer, spec.rows)
    renderer = FaceRenderer(rig.meshes)
    scene = _Scene(take, frames, positions, deformer, equation, renderer)
    page = SheetPage(
        title=f"{take.name} on {rig.file.stem}",
        facts=_facts(performance, take, frames),
        columns=_columns(take, judged),
        rows=tuple(_draw_rows(spec, scene, rig, judged, rows, progress)),
        curves=tuple(ErrorCurve(each.label, each.error_mm) for each in judged),
        first_frame=int(frames[0]),
        notes=_notes(truth is not None, judged, stand_in_eyes=renderer.eyes_put_in),
        tile_height=spec.tile,
    )
    progress(0.95, f"writing {spec.out.name}")
    write_image(
        spec.out,
        compose_sheet(page),
        metadata={} if provenance is None else provenance_metadata(provenance),
        timecode=take.timecode_start or None,
        rate=take.rate,
    )
    progress(1.0, "done")
    return _report(spec, frames, judged, rows, truth is not None)


def _shared_frames(spec: SheetSpec, performance: Performance, take: Take) -> IntArray:
    """Return the frame numbers that performance, take and --frames have in common."""
    first = max(performance.weights.first_frame, take.first_frame)
    last = min(
        performance.weights.first_frame + len(performance.weights.values),
        take.first_frame + take.frame_count,
    )
    limits = frame_range(spec.frames)
    if limits is not None:
        first, last = max(first, limits[0]), min(last, limits[1] + 1)
    if last <= first:
        raise InputError(
            f"{spec.performance}: shares no frame with {spec.take}"
            + (f" in {spec.frames}" if spec.frames else "")
            + "; is it the take it was mapped from?"
        )
    return np.arange(first, last, dtype=np.int64)


def _in_rig_order(performance: Performance, rig: Rig, frames: IntArray) -> FloatArray:
    clip = performance.weights
    rows = clip.values[frames - clip.first_frame].astype(np.float64)
    place = {name: index for index, name in enumerate(clip.names)}
    out = np.zeros((len(frames), len(rig.shapes)))
    for index, name in enumerate(rig.shapes):
        if name in place:
            out[:, index] = rows[:, place[name]]
    return out


def _equation(take: Take, rig: Rig, deformer: Deformer) -> BlendshapeEquation:
    markers = take.markers
    if markers is None:
        raise InputError(f"{take.name}: has no markers")
    row = min(max(markers.neutral_frame - take.first_frame, 0), take.frame_count - 1)
    return set_up_equation(
        rig,
        deformer,
        neutral=markers.positions[row].astype(np.float64),
        positions=markers.positions,
        visible=markers.visible | (markers.confidence > 0),
        rigid=tuple(markers.names.index(name) for name in markers.rigid),
    )


def _positions(take: Take, frames: IntArray) -> FloatArray:
    if take.markers is None:
        raise InputError(f"{take.name}: has no markers")
    return take.markers.positions[frames - take.first_frame].astype(np.float64)


def _truth(spec: SheetSpec, rig: Rig, frames: IntArray) -> FloatArray | None:
    """Return what the weights should have been; NaN at frames the file does not have."""
    if spec.against is None:
        return None
    table = read_weight_table(spec.against)
    if not set(table.names) & set(rig.shapes):
        raise InputError(f"{spec.against}: names none of the rig's shapes; is it the right file?")
    row_of = {frame: row for row, frame in enumerate(table.frames)}
    known = table.columns(rig.shapes)
    truth = np.full((len(frames), len(rig.shapes)), np.nan)
    for index, frame in enumerate(frames.tolist()):
        if frame in row_of:
            truth[index] = known[row_of[frame]]
    if np.isnan(truth).all():
        raise InputError(f"{spec.against}: has none of the frames {frames[0]}-{frames[-1]}")
    return truth


def _judge(
    label: str,
    weights: FloatArray,
    truth: FloatArray | None,
    equation: BlendshapeEquation,
    positions: FloatArray,
    deformer: Deformer,
) -> _Judged:
    """Measure weights on the surface where the truth is known, else by the markers."""
    if truth is None:
        return _Judged(label, weights, equation.residual_mm(positions, weights))
    error = weights - truth
    squared = np.einsum("fs,st,ft->f", error, deformer.shapes.gram(), error)
    return _Judged(label, weights, np.sqrt(np.maximum(squared, 0.0)))


def _choose_rows(judged: _Judged, deformer: Deformer, count: int) -> list[tuple[int, str]]:
    """Return rows in order of time: the strongest expression of each stretch, and the worst."""
    count = min(count, len(judged.weights))
    worst_count = min(count // WORST_SHARE, count - 1)
    gram = deformer.shapes.gram()
    strength = np.einsum("fs,st,ft->f", judged.weights, gram, judged.weights)
    apart = max(len(strength) // (3 * count), 1)
    chosen: dict[int, str] = {}
    for stretch in np.array_split(np.arange(len(strength)), count - worst_count):
        free = [row for row in stretch if all(abs(row - other) >= apart for other in chosen)]
        chosen[int(max(free or stretch, key=lambda row: strength[row]))] = ""
    error = np.nan_to_num(judged.error_mm, nan=-1.0)
    for row in np.argsort(-error).tolist():
        if len(chosen) >= count:
            break
        if all(abs(row - other) >= apart for other in chosen):
            chosen[row] = "worst"
    return sorted(chosen.items())


def _draw_rows(
    spec: SheetSpec,
    scene: _Scene,
    rig: Rig,
    judged: list[_Judged],
    rows: list[tuple[int, str]],
    progress: Progress,
) -> Iterator[SheetRow]:
    take = scene.take
    visible = _visible(take, scene.frames)
    explained = scene.equation.explained(judged[-1].weights[[row for row, _ in rows]])
    camera = frame_rig(rig.meshes, yaw_degrees=YAW_DEGREES)
    cloud_frame = frame_markers(scene.positions)
    with ExitStack() as open_files:
        video: VideoReader | ImageSequence | None = None
        if take.video is not None:
            video = open_video(take.video.file, take.video.rate)
            open_files.enter_context(video)
        for number, (row, note) in enumerate(rows):
            frame = int(scene.frames[row])
            progress(0.3 + 0.65 * number / len(rows), f"drawing frame {frame}")
            tiles = []
            if video is not None:
                tiles.append(_video_tile(video, take, frame))
            tiles.append(
                Tile(
                    draw_markers(
                        scene.positions[row],
                        width=spec.tile,
                        height=spec.tile,
                        frame=cloud_frame,
                        visible=visible[row],
                        explained=explained[number],
                    )
                )
            )
            for each in judged:
                picture = scene.renderer.render(
                    scene.deformer.points(each.weights[row : row + 1])[0],
                    camera=camera,
                    width=spec.tile,
                    height=spec.tile,
                    quality=spec.quality,
                )
                error = float(each.error_mm[row])
                tiles.append(Tile(picture, value=None if np.isnan(error) else error))
            timecode = shift_timecode(take.timecode_start, frame - take.first_frame, take.rate)
            yield SheetRow(frame=frame, timecode=timecode, tiles=tuple(tiles), note=note)


def _visible(take: Take, frames: IntArray) -> BoolArray:
    if take.markers is None:
        raise InputError(f"{take.name}: has no markers")
    return take.markers.visible[frames - take.first_frame]


def _video_tile(video: VideoReader | ImageSequence, take: Take, frame: int) -> Tile:
    """Find the video's picture at a frame of the take, by the clock that aligns the two."""
    if take.video is None:
        raise InputError(f"{take.name}: has no video")
    seconds = (frame - take.first_frame) / float(take.rate)
    at = (seconds - take.video.offset) / (1.0 + take.video.drift * 1e-6)
    try:
        picture = video.frame_at(at)
    except InputError:
        return Tile(None, caption="cannot be decoded")
    return Tile(picture, caption="" if picture is not None else "no video here")


def _columns(take: Take, judged: list[_Judged]) -> tuple[str, ...]:
    names = {"equation": "equation solving", "usdface": "this performance"}
    video = ("video",) if take.video is not None else ()
    return (*video, "markers", *(names[each.label] for each in judged))


def _facts(performance: Performance, take: Take, frames: IntArray) -> tuple[str, ...]:
    facts = [f"frames {frames[0]}-{frames[-1]}", f"{float(take.rate):g} fps"]
    if take.performer:
        facts.insert(0, take.performer)
    if performance.confidence is not None:
        facts.append(f"mean confidence {float(performance.confidence.mean()):.2f}")
    return tuple(facts)


def _notes(truth_known: bool, judged: list[_Judged], *, stand_in_eyes: bool) -> tuple[str, ...]:
    what = (
        "error: RMS distance of the surface from what was keyed"
        if truth_known
        else "error: RMS distance of the markers from what the weights explain; not the truth"
    )
    means = ", ".join(f"{each.label} {np.nanmean(each.error_mm):.2f} mm" for each in judged)
    eyes = ("the rig has no eyes: stand-ins are drawn",) if stand_in_eyes else ()
    return (what, f"mean: {means}", *eyes)


def _report(
    spec: SheetSpec,
    frames: IntArray,
    judged: list[_Judged],
    rows: list[tuple[int, str]],
    truth_known: bool,
) -> Report:
    means = {each.label: float(np.nanmean(each.error_mm)) for each in judged}
    told = ", ".join(f"{label} {value:.2f} mm" for label, value in means.items())
    what = "surface error against the truth" if truth_known else "marker residual"
    return Report(
        (spec.out,),
        f"{len(rows)} rows; mean {what}: {told}",
        (),
        {
            "frames": [int(frames[row]) for row, _ in rows],
            "mean_error_mm": means,
            "against_truth": truth_known,
        },
    )
