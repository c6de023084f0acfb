"""Contact sheets: video, markers, baseline, performances, differences."""

from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from usdface.core.arrays import FloatArray
from usdface.core.errors import InputError
from usdface.core.progress import Progress, silent
from usdface.core.provenance import Provenance
from usdface.core.text import pluralize
from usdface.media.picture.display_view import display_view
from usdface.media.picture.error_strip import ErrorCurve
from usdface.media.picture.image import write_image
from usdface.media.picture.sheet import SheetPage, SheetRow, Tile, compose_sheet, round_range
from usdface.model.selection.baseline import BlendshapeEquation
from usdface.runner.origin import provenance_metadata
from usdface.runner.result import StepResult
from usdface.specs.review import AUTO_CAMERA, FramePick, SheetLayout, SheetSpec
from usdface.steps.inputs.phone_labels import labels_at
from usdface.steps.review.pictures import RESIDUAL_SCALE, ShotPictures
from usdface.steps.review.scoring import (
    ChosenFrame,
    Score,
    choose_frames,
    read_keys,
    score,
    set_up_shot_baseline,
    solve_baseline,
    surface_distance,
    uncertainty_curves,
)
from usdface.steps.review.shot import Shot, ShotCamera, open_shot

PICKS: dict[SheetLayout, FramePick] = {
    "comparison": "expression",
    "worst": "residual",
    "strip": "even",
    "characters": "expression",
}
STRIP_ROWS, STRIP_TILE = 48, 192
OTHER_ROWS, OTHER_TILE = 12, 320

FIGURE_KEYS = {"solve": "usdface", "baseline": "equation"}
"""Of the labels on a sheet: scripts read these keys from ``--json``, so they stay."""


@dataclass(frozen=True)
class _Comparison:
    """What a sheet shows: shots, their weights with errors, and the frames chosen.

    Attributes
    ----------
    shots : list of Shot
        The performance first, then those beside it.
    truth : (frames, shapes) float array or None
        The keys; NaN at frames that have none.
    chosen : list of ChosenFrame
        Rows of the sheet.
    labels : tuple of str
        Phone and viseme of each chosen frame; empty where unknown.
    """

    shots: list[Shot]
    equation: BlendshapeEquation
    truth: FloatArray | None
    scores: list[Score]
    chosen: list[ChosenFrame]
    labels: tuple[str, ...]

    @property
    def high_mm(self) -> float:
        """Upper end of the range of errors."""
        return round_range(np.concatenate([each.error_mm for each in self.scores]))


@dataclass(frozen=True)
class Column:
    """Something drawn for every row."""

    head: str
    draw: Callable[[int], Tile]


def run(spec: SheetSpec, *, provenance: Provenance, progress: Progress = silent) -> StepResult:
    """Draw the sheet and write it."""
    comparison = _compare(spec, progress)
    shots = comparison.shots
    cameras = [each.camera(spec.camera, spec.camera_stage) for each in shots]
    with ExitStack() as open_files:
        pictures = _open_pictures(spec, shots, cameras, open_files)
        columns = sheet_columns(spec, comparison, pictures)
        page = _page(spec, comparison, columns, pictures)

        def draw(number: int) -> SheetRow:
            frame = comparison.chosen[number]
            at = int(shots[0].frames[frame.row])
            progress(0.2 + 0.75 * number / len(comparison.chosen), f"drawing frame {at}")
            return SheetRow(
                frame=at,
                timecode=shots[0].timecode(at),
                tiles=tuple(column.draw(frame.row) for column in columns),
                note=frame.reason,
                said=comparison.labels[number],
            )

        written = _write_pages(spec, page, draw, comparison, provenance)
    progress(1.0, "done")
    first = int(shots[0].frames[0])
    notes = dict.fromkeys(note for each in cameras for note in each.notes(first))
    notes |= dict.fromkeys(note for each in shots for note in each.rig.undrawn_notes())
    return _result(written, comparison, tuple(notes))


def _compare(spec: SheetSpec, progress: Progress) -> _Comparison:
    """Read the shots, measure their weights and choose frames."""
    progress(0.0, "reading")
    shots = _open_shots(spec)
    shot = shots[0]
    progress(0.1, "placing the markers on the rig")
    equations = [set_up_shot_baseline(each) for each in shots]
    truth = read_keys(spec.against, shot.rig, shot.frames)
    solve = score("solve", shot, shot.weights, truth, equations[0])
    chosen = _choose(spec, shot, solve)
    rows = [frame.row for frame in chosen]
    scores = [solve]
    if spec.baseline and spec.layout in ("comparison", "worst"):
        solved = solve_baseline(equations[0], shot, np.array(rows, np.int64))
        scores.insert(0, score("baseline", shot, solved, truth, equations[0]))
    labels = _labels([each.performance_file for each in shots[1:]])
    for other, equation, label in zip(shots[1:], equations[1:], labels, strict=True):
        known = truth if _same_face(other, shot) else None
        scores.append(score(label, other, other.weights, known, equation))
    spoken = labels_at(spec.phones, shot.take, shot.frames[rows])
    return _Comparison(shots, equations[0], truth, scores, chosen, spoken)


def _open_pictures(
    spec: SheetSpec, shots: list[Shot], cameras: list[ShotCamera], open_files: ExitStack
) -> list[ShotPictures]:
    display, tile = display_view(spec.view), _tile_height(spec)
    pictures = [
        ShotPictures(shot, height=tile, quality=spec.quality, display=display, camera=camera)
        for shot, camera in zip(shots, cameras, strict=True)
    ]
    for each in pictures:
        open_files.enter_context(each)
    return pictures


def _tile_height(spec: SheetSpec) -> int:
    return spec.tile or (STRIP_TILE if spec.layout == "strip" else OTHER_TILE)


def _page(
    spec: SheetSpec, comparison: _Comparison, columns: list[Column], pictures: list[ShotPictures]
) -> SheetPage:
    shot = comparison.shots[0]
    rigs = dict.fromkeys(each.rig.file.stem for each in comparison.shots)
    errors = (
        ErrorCurve(_label_of(each, comparison.scores), each.error_mm) for each in comparison.scores
    )
    return SheetPage(
        title=f"{shot.take.name} on {', '.join(rigs)}",
        facts=_facts(spec, shot),
        columns=tuple(column.head for column in columns),
        rows=(),
        curves=(*errors, *uncertainty_curves(shot)),
        first_frame=int(shot.frames[0]),
        notes=_notes(spec, comparison, stand_in_eyes=any(each.stand_in_eyes for each in pictures)),
        tile_height=_tile_height(spec),
        high=comparison.high_mm,
    )


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


def _labels(files: list[Path]) -> list[str]:
    """Return what each further performance is called: its name, with its folder where need be."""
    stems = [file.stem.split(".usd")[0] for file in files]
    taken, found = {"baseline", "solve"}, list[str]()
    for file, stem in zip(files, stems, strict=True):
        alone = stems.count(stem) == 1 and stem not in taken
        label = wanted = stem if alone else f"{file.resolve().parent.name}/{stem}"
        number = 1
        while label in taken:
            number += 1
            label = f"{wanted} ({number})"
        taken.add(label)
        found.append(label)
    return found


def _same_face(shot: Shot, other: Shot) -> bool:
    """Say whether weights of one mean the same on the other."""
    faces = [(each.rig.file.resolve(), each.rig.prim) for each in (shot, other)]
    return faces[0] == faces[1]


def _label_of(judged: Score, beside: list[Score]) -> str:
    """Return a label that says so where this one is measured otherwise than those beside it."""
    by_markers = not judged.against_truth and any(each.against_truth for each in beside)
    return f"{judged.label} (marker residual)" if by_markers else judged.label


def _choose(spec: SheetSpec, shot: Shot, judged: Score) -> list[ChosenFrame]:
    steps = np.diff(shot.weights, axis=0, prepend=shot.weights[:1])
    return choose_frames(
        spec.pick or PICKS[spec.layout],
        spec.rows or (STRIP_ROWS if spec.layout == "strip" else OTHER_ROWS),
        strength=surface_distance(shot, shot.weights),
        error_mm=judged.error_mm,
        uncertainty_mm=shot.face_uncertainty_mm(),
        jump_mm=surface_distance(shot, steps),
    )


def _write_pages(
    spec: SheetSpec,
    page: SheetPage,
    draw: Callable[[int], SheetRow],
    comparison: _Comparison,
    provenance: Provenance,
) -> tuple[Path, ...]:
    """Draw and write page by page, so that thousands of tiles are not held at once.

    The first page carries the name that was asked for.
    """
    shot, count = comparison.shots[0], len(comparison.chosen)
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
            metadata=provenance_metadata(provenance),
            timecode=shot.timecode(int(shot.frames[0])) or None,
            rate=shot.take.rate,
        )
        written.append(file)
    return tuple(written)


def _facts(spec: SheetSpec, shot: Shot) -> tuple[str, ...]:
    facts = [f"frames {shot.frames[0]}-{shot.frames[-1]}", f"{float(shot.take.rate):g} fps"]
    if spec.camera != AUTO_CAMERA:
        facts.append(f"camera {spec.camera}")
    if shot.take.performer:
        facts.insert(0, shot.take.performer)
    uncertainty = shot.face_uncertainty_mm()
    if uncertainty is not None:
        facts.append(f"mean uncertainty {float(uncertainty.mean()):.2f} mm")
    return tuple(facts)


def _notes(spec: SheetSpec, comparison: _Comparison, *, stand_in_eyes: bool) -> tuple[str, ...]:
    scores, shots = comparison.scores, comparison.shots
    what = "residual: RMS distance of the markers from the rig under the weights"
    if comparison.truth is not None:
        what = "error: RMS distance of the surface from the keys"
    means = (f"{_label_of(each, scores)} {np.nanmean(each.error_mm):.2f} mm" for each in scores)
    notes = [what, f"mean: {', '.join(means)}"]
    if spec.layout != "strip":
        notes.append(f"lines at markers: the residual, {RESIDUAL_SCALE:g} times as long")
    if shots[0].performance.uncertainty_mm is not None:
        notes.append("uncertainty: expected RMS distance of the surface from an animator's keys")
    if any(comparison.labels):
        notes.append("beside frames: phone and viseme")
    if stand_in_eyes:
        notes.append("the rig has no eyes: stand-ins are drawn")
    if any(each.rig.undrawn_notes() for each in shots):
        notes.append("textures are not drawn")
    return tuple(notes)


def _result(
    written: tuple[Path, ...], comparison: _Comparison, notes: tuple[str, ...]
) -> StepResult:
    scores, chosen = comparison.scores, comparison.chosen
    against_keys = comparison.truth is not None
    means = {each.label: float(np.nanmean(each.error_mm)) for each in scores}
    listed = ", ".join(f"{_label_of(each, scores)} {means[each.label]:.2f} mm" for each in scores)
    what = "surface error against the keys" if against_keys else "marker residual"
    return StepResult(
        written,
        f"{pluralize(len(chosen), 'row')}; mean {what}: {listed}",
        notes,
        {
            "frames": [int(comparison.shots[0].frames[frame.row]) for frame in chosen],
            "mean_error_mm": {FIGURE_KEYS.get(label, label): mean for label, mean in means.items()},
            "against_truth": against_keys,
        },
    )


def sheet_columns(
    spec: SheetSpec, comparison: _Comparison, pictures: list[ShotPictures]
) -> list[Column]:
    """Return what the layout puts side by side."""
    shot, drawn = comparison.shots[0], pictures[0]
    columns: list[Column] = []
    if shot.take.video is not None:
        columns.append(Column("video", lambda row: drawn.video(int(shot.frames[row]))))
    if spec.layout != "strip":
        rows = [frame.row for frame in comparison.chosen]
        explained = comparison.equation.explained(shot.weights[rows])
        at = dict(zip(rows, explained, strict=True))
        columns.append(Column("markers", lambda row: Tile(drawn.markers(row, explained=at[row]))))
    others = iter(pictures[1:])
    for each in comparison.scores:
        face = drawn if each.label in ("baseline", "solve") else next(others)
        columns.append(Column(each.label, _face(face, each)))
    compared = _compared(comparison.scores, comparison.truth)
    if spec.difference and compared is not None and spec.layout in ("comparison", "worst"):
        label, weights = compared
        distances = _distances(drawn, shot.weights, weights, high_mm=comparison.high_mm)
        columns.append(Column(f"difference to {label}", distances))
    return columns


def _face(pictures: ShotPictures, judged: Score) -> Callable[[int], Tile]:
    def draw(row: int) -> Tile:
        error = float(judged.error_mm[row])
        value = None if np.isnan(error) else error
        return Tile(pictures.face(row, judged.weights[row]), value=value)

    return draw


def _distances(
    pictures: ShotPictures, weights: FloatArray, other: FloatArray, *, high_mm: float
) -> Callable[[int], Tile]:
    def draw(row: int) -> Tile:
        if np.isnan(other[row]).any():
            return Tile(None, caption="nothing keyed here")
        painted = pictures.difference(row, weights[row], other[row], high_mm=high_mm)
        return Tile(painted.picture, caption=f"largest {painted.largest_mm:.1f} mm")

    return draw


def _compared(judged: list[Score], truth: FloatArray | None) -> tuple[str, FloatArray] | None:
    if truth is not None:
        return "keys", truth
    return next((("baseline", j.weights) for j in judged if j.label == "baseline"), None)
