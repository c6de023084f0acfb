"""A contact sheet: video, markers, the equation-solving baseline and the performance."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from usdface.assets import FloatArray, IntArray, Performance, Rig, Take
from usdface.deformer import Deformer
from usdface.errors import InputError
from usdface.media.error_strip import ErrorCurve
from usdface.media.image import write_image
from usdface.media.sheet import SheetPage, SheetRow, Tile, compose_sheet
from usdface.model.equation import BlendshapeEquation, set_up_equation
from usdface.progress import Progress, silent
from usdface.provenance import Provenance
from usdface.specs.sheet import SheetSpec
from usdface.steps.outputs import provenance_metadata
from usdface.steps.report import Report
from usdface.steps.shot_pictures import Shot, ShotPictures, open_shot
from usdface.steps.weight_tables import read_weight_table

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


def run(
    spec: SheetSpec, *, provenance: Provenance | None = None, progress: Progress = silent
) -> Report:
    """Draw the sheet and write it."""
    progress(0.0, "reading")
    shot = open_shot(spec.performance, spec.take, frames=spec.frames)
    take, rig, deformer, frames = shot.take, shot.rig, shot.deformer, shot.frames
    progress(0.1, "placing the markers on the rig")
    equation = _equation(take, rig, deformer)
    positions = shot.positions
    truth = _truth(spec, rig, frames)
    judged = []
    if spec.baseline:
        solved = equation.solve_published(positions)
        judged.append(_judge("equation", solved, truth, equation, positions, deformer))
    judged.append(_judge("usdface", shot.weights, truth, equation, positions, deformer))
    rows = _choose_rows(judged[-1], deformer, spec.rows)
    pictures = ShotPictures(shot, height=spec.tile, quality=spec.quality)
    page = SheetPage(
        title=f"{take.name} on {rig.file.stem}",
        facts=_facts(shot.performance, take, frames),
        columns=_columns(take, judged),
        rows=tuple(_draw_rows(shot, pictures, equation, judged, rows, progress)),
        curves=tuple(ErrorCurve(each.label, each.error_mm) for each in judged),
        first_frame=int(frames[0]),
        notes=_notes(truth is not None, judged, stand_in_eyes=pictures.stand_in_eyes),
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
    shot: Shot,
    pictures: ShotPictures,
    equation: BlendshapeEquation,
    judged: list[_Judged],
    rows: list[tuple[int, str]],
    progress: Progress,
) -> Iterator[SheetRow]:
    explained = equation.explained(judged[-1].weights[[row for row, _ in rows]])
    with pictures:
        for number, (row, note) in enumerate(rows):
            frame = int(shot.frames[row])
            progress(0.3 + 0.65 * number / len(rows), f"drawing frame {frame}")
            tiles = [pictures.video(frame)] if shot.take.video is not None else []
            tiles.append(Tile(pictures.markers(row, explained=explained[number])))
            for each in judged:
                error = float(each.error_mm[row])
                value = None if np.isnan(error) else error
                tiles.append(Tile(pictures.face(each.weights[row]), value=value))
            yield SheetRow(
                frame=frame, timecode=shot.timecode(frame), tiles=tuple(tiles), note=note
            )


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
