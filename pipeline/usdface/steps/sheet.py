"""Contact sheets: video, markers, the equation-solving baseline, performances, differences."""

from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from usdface.assets import FloatArray, IntArray, Rig
from usdface.errors import InputError
from usdface.media.display_view import display_view
from usdface.media.error_strip import ErrorCurve
from usdface.media.image import write_image
from usdface.media.sheet import SheetPage, SheetRow, Tile, compose_sheet, round_range
from usdface.model.equation import BlendshapeEquation, set_up_equation
from usdface.progress import Progress, silent
from usdface.provenance import Provenance
from usdface.specs.camera import AUTO
from usdface.specs.sheet import FramePick, SheetLayout, SheetSpec
from usdface.steps.frame_choice import ChosenFrame, choose_frames
from usdface.steps.outputs import provenance_metadata
from usdface.steps.report import Report
from usdface.steps.shot_camera import ShotCamera
from usdface.steps.shot_phones import said_at
from usdface.steps.shot_pictures import (
    EXAGGERATION,
    Shot,
    ShotPictures,
    open_shot,
    undrawn,
)
from usdface.steps.weight_tables import read_weight_table

PICKS: dict[SheetLayout, FramePick] = {
    "comparison": "expression",
    "worst": "residual",
    "strip": "even",
    "characters": "expression",
}
STRIP_ROWS, STRIP_TILE = 48, 192
OTHER_ROWS, OTHER_TILE = 12, 320


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
class _Column:
    """Something drawn for every row."""

    head: str
    draw: Callable[[int], Tile]


def run(
    spec: SheetSpec, *, provenance: Provenance | None = None, progress: Progress = silent
) -> Report:
    """Draw the sheet and write it."""
    progress(0.0, "reading")
    shots = _open_shots(spec)
    shot = shots[0]
    progress(0.1, "placing the markers on the rig")
    equations = [place_markers(each) for each in shots]
    truth = read_truth(spec.against, shot.rig, shot.frames)
    judged = [_judge("usdface", shot, shot.weights, truth, equations[0])]
    if spec.baseline and spec.layout in ("comparison", "worst"):
        solved = equations[0].solve_published(shot.positions)
        judged.insert(0, _judge("equation", shot, solved, truth, equations[0]))
    for other, equation in zip(shots[1:], equations[1:], strict=True):
        label = other.performance_file.stem.split(".usd")[0]
        judged.append(_judge(label, other, other.weights, None, equation))
    chosen = _choose(spec, shot, next(each for each in judged if each.label == "usdface"))
    said = said_at(spec.phones, shot.take, shot.frames[[frame.row for frame in chosen]])
    high = round_range(np.concatenate([each.error_mm for each in judged]))
    tile = spec.tile or (STRIP_TILE if spec.layout == "strip" else OTHER_TILE)
    show = display_view(spec.view)
    cameras = [_camera(spec, each) for each in shots]
    with ExitStack() as open_files:
        pictures = [
            ShotPictures(s, height=tile, quality=spec.quality, display=show, camera=camera)
            for s, camera in zip(shots, cameras, strict=True)
        ]
        for each in pictures:
            open_files.enter_context(each)
        columns = _columns(spec, shots, pictures, judged, equations[0], truth, chosen, high)
        page = SheetPage(
            title=f"{shot.take.name} on {', '.join(dict.fromkeys(s.rig.file.stem for s in shots))}",
            facts=_facts(spec, shot),
            columns=tuple(column.head for column in columns),
            rows=(),
            curves=(*(ErrorCurve(each.label, each.error_mm) for each in judged), *_doubt(shot)),
            first_frame=int(shot.frames[0]),
            notes=_notes(
                truth is not None,
                judged,
                stand_in_eyes=any(each.stand_in_eyes for each in pictures),
                doubted=shot.performance.confidence is not None,
                plain=any(undrawn(each.rig) for each in shots),
                spoken=any(said),
            ),
            tile_height=tile,
            high=high,
        )

        def draw(number: int) -> SheetRow:
            frame = chosen[number]
            at = int(shot.frames[frame.row])
            progress(0.2 + 0.75 * number / len(chosen), f"drawing frame {at}")
            return SheetRow(
                frame=at,
                timecode=shot.timecode(at),
                tiles=tuple(column.draw(frame.row) for column in columns),
                note=frame.reason,
                said=said[number],
            )

        written = _write_pages(spec, page, len(chosen), draw, shot, provenance)
    progress(1.0, "done")
    told = dict.fromkeys(note for each in cameras for note in each.notes(int(shot.frames[0])))
    told |= dict.fromkeys(note for each in shots for note in undrawn(each.rig))
    return _report(written, shot.frames, judged, chosen, truth is not None, tuple(told))


def _open_shots(spec: SheetSpec) -> list[Shot]:
    """Open every performance over the frames that all of them have."""
    files = (spec.performance, *spec.also)
    shots = [open_shot(file, spec.take, frames=spec.frames) for file in files]
    first = max(int(shot.frames[0]) for shot in shots)
    last = min(int(shot.frames[-1]) for shot in shots)
    if last < first:
        raise InputError(f"{', '.join(map(str, files))}: share no frame of {spec.take}")
    return [
        replace(
            shot,
            frames=shot.frames[(shot.frames >= first) & (shot.frames <= last)],
            weights=shot.weights[(shot.frames >= first) & (shot.frames <= last)],
        )
        for shot in shots
    ]


def _camera(spec: SheetSpec, shot: Shot) -> ShotCamera:
    return ShotCamera(
        shot.performance_file,
        shot.performance,
        shot.rig,
        name=spec.camera,
        stage=spec.camera_stage,
    )


def place_markers(shot: Shot) -> BlendshapeEquation:
    """Bind a shot's markers to its rig, as the equation-solving baseline needs them."""
    take, markers = shot.take, shot.take.markers
    if markers is None:
        raise InputError(f"{take.name}: has no markers")
    row = min(max(markers.neutral_frame - take.first_frame, 0), take.frame_count - 1)
    return set_up_equation(
        shot.rig,
        shot.deformer,
        neutral=markers.positions[row].astype(np.float64),
        positions=markers.positions,
        visible=markers.visible | (markers.confidence > 0),
        rigid=tuple(markers.names.index(name) for name in markers.rigid),
    )


def read_truth(file: Path | None, rig: Rig, frames: IntArray) -> FloatArray | None:
    """Return what the weights should have been; NaN at frames the file does not have."""
    if file is None:
        return None
    table = read_weight_table(file)
    if not set(table.names) & set(rig.shapes):
        raise InputError(f"{file}: names none of the rig's shapes; is it the right file?")
    row_of = {frame: row for row, frame in enumerate(table.frames)}
    known = table.columns(rig.shapes)
    truth = np.full((len(frames), len(rig.shapes)), np.nan)
    for index, frame in enumerate(frames.tolist()):
        if frame in row_of:
            truth[index] = known[row_of[frame]]
    if np.isnan(truth).all():
        raise InputError(f"{file}: has none of the frames {frames[0]}-{frames[-1]}")
    return truth


def _judge(
    label: str,
    shot: Shot,
    weights: FloatArray,
    truth: FloatArray | None,
    equation: BlendshapeEquation,
) -> _Judged:
    """Measure weights on the surface where the truth is known, else by the markers."""
    if truth is None:
        return _Judged(label, weights, equation.residual_mm(shot.positions, weights))
    return _Judged(label, weights, _surface_distance(shot, weights - truth))


def _surface_distance(shot: Shot, difference: FloatArray) -> FloatArray:
    """Return the RMS distance of the surface that differences of weights make, (frames,) [mm]."""
    squared = np.einsum("fs,st,ft->f", difference, shot.deformer.shapes.gram(), difference)
    return np.asarray(np.sqrt(np.maximum(squared, 0.0)))


def _doubt(shot: Shot) -> tuple[ErrorCurve, ...]:
    """Return how little the performance trusts itself, 1 less its confidence; none if unknown."""
    confidence = shot.performance.confidence
    if confidence is None:
        return ()
    own = confidence[shot.frames - shot.performance.weights.first_frame]
    return (ErrorCurve("doubt", 1.0 - np.asarray(own, np.float64), high=1.0, unit=""),)


def _choose(spec: SheetSpec, shot: Shot, judged: _Judged) -> list[ChosenFrame]:
    confidence = shot.performance.confidence
    if confidence is not None:
        confidence = confidence[shot.frames - shot.performance.weights.first_frame]
    steps = np.diff(shot.weights, axis=0, prepend=shot.weights[:1])
    return choose_frames(
        spec.pick or PICKS[spec.layout],
        spec.rows or (STRIP_ROWS if spec.layout == "strip" else OTHER_ROWS),
        strength=_surface_distance(shot, shot.weights),
        error_mm=judged.error_mm,
        confidence=confidence,
        jump_mm=_surface_distance(shot, steps),
    )


def _columns(
    spec: SheetSpec,
    shots: list[Shot],
    pictures: list[ShotPictures],
    judged: list[_Judged],
    equation: BlendshapeEquation,
    truth: FloatArray | None,
    chosen: list[ChosenFrame],
    high: float,
) -> list[_Column]:
    """Return what the layout puts side by side."""
    shot, drawn = shots[0], pictures[0]
    columns: list[_Column] = []
    if shot.take.video is not None:
        columns.append(_Column("video", lambda row: drawn.video(int(shot.frames[row]))))
    if spec.layout != "strip":
        explained = dict(
            zip(
                [frame.row for frame in chosen],
                equation.explained(shot.weights[[frame.row for frame in chosen]]),
                strict=True,
            )
        )
        columns.append(
            _Column("markers", lambda row: Tile(drawn.markers(row, explained=explained[row])))
        )
    names = {"equation": "equation solving", "usdface": "this performance"}
    others = iter(pictures[1:])
    for each in judged:
        own = drawn if each.label in names else next(others)
        columns.append(_Column(names.get(each.label, each.label), _face(own, each)))
    compared = _compared(judged, truth)
    if spec.difference and compared is not None and spec.layout in ("comparison", "worst"):
        columns.append(
            _Column(
                f"away from {compared[0]}", _away(drawn, shot.weights, compared[1], high_mm=high)
            )
        )
    return columns


def _face(pictures: ShotPictures, judged: _Judged) -> Callable[[int], Tile]:
    def draw(row: int) -> Tile:
        error = float(judged.error_mm[row])
        value = None if np.isnan(error) else error
        return Tile(pictures.face(row, judged.weights[row]), value=value)

    return draw


def _away(
    pictures: ShotPictures, weights: FloatArray, other: FloatArray, *, high_mm: float
) -> Callable[[int], Tile]:
    def draw(row: int) -> Tile:
        if np.isnan(other[row]).any():
            return Tile(None, caption="nothing keyed here")
        painted = pictures.difference(row, weights[row], other[row], high_mm=high_mm)
        return Tile(painted.picture, caption=f"at most {painted.largest_mm:.1f} mm")

    return draw


def _compared(judged: list[_Judged], truth: FloatArray | None) -> tuple[str, FloatArray] | None:
    if truth is not None:
        return "truth", truth
    return next((("equation", j.weights) for j in judged if j.label == "equation"), None)


def _write_pages(
    spec: SheetSpec,
    page: SheetPage,
    count: int,
    draw: Callable[[int], SheetRow],
    shot: Shot,
    provenance: Provenance | None,
) -> tuple[Path, ...]:
    """Draw and write page by page, so that thousands of tiles are not held at once.

    The first page carries the name that was asked for.
    """
    pages = -(-count // spec.page_rows)
    written = []
    for number in range(pages):
        first = number * spec.page_rows
        rows = tuple(draw(row) for row in range(first, min(first + spec.page_rows, count)))
        title = page.title if pages == 1 else f"{page.title}, page {number + 1} of {pages}"
        file = spec.out
        if number:
            file = spec.out.with_name(f"{spec.out.stem}.{number + 1}{spec.out.suffix}")
        write_image(
            file,
            compose_sheet(replace(page, title=title, rows=rows)),
            metadata={} if provenance is None else provenance_metadata(provenance),
            timecode=shot.timecode(int(shot.frames[0])) or None,
            rate=shot.take.rate,
        )
        written.append(file)
    return tuple(written)


def _facts(spec: SheetSpec, shot: Shot) -> tuple[str, ...]:
    facts = [f"frames {shot.frames[0]}-{shot.frames[-1]}", f"{float(shot.take.rate):g} fps"]
    if spec.camera != AUTO:
        facts.append(f"camera {spec.camera}")
    if shot.take.performer:
        facts.insert(0, shot.take.performer)
    if shot.performance.confidence is not None:
        facts.append(f"mean confidence {float(shot.performance.confidence.mean()):.2f}")
    return tuple(facts)


def _notes(
    truth_known: bool,
    judged: list[_Judged],
    *,
    stand_in_eyes: bool,
    doubted: bool,
    plain: bool,
    spoken: bool,
) -> tuple[str, ...]:
    what = (
        "error: RMS distance of the surface from what was keyed"
        if truth_known
        else "error: RMS distance of the markers from what the weights explain; not the truth"
    )
    means = ", ".join(f"{each.label} {np.nanmean(each.error_mm):.2f} mm" for each in judged)
    eyes = ("the rig has no eyes: stand-ins are drawn",) if stand_in_eyes else ()
    doubt = ("doubt: 1 less the confidence",) if doubted else ()
    phones = ("beside frames: phone and viseme",) if spoken else ()
    textures = ("textures are not drawn",) if plain else ()
    lines = f"lines at markers: what is left unexplained, {EXAGGERATION:g} times as long"
    return (what, f"mean: {means}", lines, *doubt, *phones, *eyes, *textures)


def _report(
    written: tuple[Path, ...],
    frames: IntArray,
    judged: list[_Judged],
    chosen: list[ChosenFrame],
    truth_known: bool,
    notes: tuple[str, ...],
) -> Report:
    means = {each.label: float(np.nanmean(each.error_mm)) for each in judged}
    told = ", ".join(f"{label} {value:.2f} mm" for label, value in means.items())
    what = "surface error against the truth" if truth_known else "marker residual"
    return Report(
        written,
        f"{len(chosen)} rows; mean {what}: {told}",
        notes,
        {
            "frames": [int(frames[frame.row]) for frame in chosen],
            "mean_error_mm": means,
            "against_truth": truth_known,
        },
    )
