"""Contact sheets: video, markers, baseline, performances, differences."""

from collections.abc import Callable, Iterator
from concurrent.futures import Future
from concurrent.futures.process import BrokenProcessPool
from contextlib import ExitStack, suppress
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from usdface.core.arrays import FloatArray
from usdface.core.errors import CancelledError, InputError, UsdfaceError
from usdface.core.processes import GiveWork, process_count, worker_processes
from usdface.core.progress import Progress, silent
from usdface.core.provenance import Provenance
from usdface.core.text import pluralize
from usdface.media.picture.display_view import display_view
from usdface.media.picture.error_strip import ErrorCurve
from usdface.media.picture.image import write_image
from usdface.media.picture.sheet import SheetPage, SheetRow, Tile, compose_sheet
from usdface.model.review.moments import ReviewSignals
from usdface.model.selection.baseline import BlendshapeEquation
from usdface.runner.origin import provenance_metadata
from usdface.runner.result import StepResult
from usdface.specs.paths import frame_list
from usdface.specs.review import AUTO_CAMERA, FramePick, SheetLayout, SheetSpec
from usdface.steps.inputs.phone_labels import labels_at
from usdface.steps.review.pictures import ShotPictures
from usdface.steps.review.scoring import (
    ChosenFrame,
    Score,
    ShotRuler,
    choose_frames,
    coverage_curves,
    range_mm,
    read_keys,
    score,
    set_up_shot_baseline,
    solve_baseline,
    surface_distance,
)
from usdface.steps.review.shot import Shot, ShotCamera, open_shot, version_labels

PICKS: dict[SheetLayout, FramePick] = {
    "comparison": "expression",
    "worst": "review",
    "strip": "even",
    "characters": "expression",
}
STRIP_ROWS, STRIP_TILE = 48, 192
OTHER_ROWS, OTHER_TILE = 12, 320

MOST_PROCESSES = 4
"""That draw a sheet: more would read longer than they draw."""
HELPED_PIXELS = 800_000
"""Of a column, for which a process more is worth its start."""

FIGURE_KEYS = {"solve": "usdface", "baseline": "equation"}
"""Of the labels on a sheet: scripts read these keys from ``--json``, so they stay."""


@dataclass(frozen=True)
class _Comparison:
    """What a sheet shows: shots, their weights with errors, and the frames chosen."""

    shots: list[Shot]
    """The performance first, then those beside it."""
    ruler: ShotRuler
    """Of the first."""
    signals: ReviewSignals
    """Of the first."""
    equation: BlendshapeEquation | None
    """None for a take without markers."""
    truth: FloatArray | None
    """(frames, shapes): the keys; NaN at frames that have none."""
    scores: list[Score]
    chosen: list[ChosenFrame]
    """Rows of the sheet."""
    labels: tuple[str, ...]
    """Phone and viseme of each chosen frame; empty where unknown."""


@dataclass(frozen=True)
class Column:
    """Something drawn for every row."""

    head: str
    draw: Callable[[int], Tile]


@dataclass(frozen=True)
class _Desk:
    """What rows are drawn with, in this process or in another."""

    comparison: _Comparison
    cameras: list[ShotCamera]
    pictures: list[ShotPictures]
    columns: list[Column]

    def draw(self, number: int) -> SheetRow:
        """Draw a row of the sheet."""
        chosen, shot = self.comparison.chosen[number], self.comparison.shots[0]
        frame = int(shot.frames[chosen.row])
        return SheetRow(
            frame=frame,
            timecode=shot.timecode(frame),
            tiles=tuple(column.draw(chosen.row) for column in self.columns),
            note=chosen.reason,
            said=self.comparison.labels[number],
        )


def run(spec: SheetSpec, *, provenance: Provenance, progress: Progress = silent) -> StepResult:
    """Draw the sheet and write it."""
    with ExitStack() as open_files:
        helpers = _helpers(spec)
        give_work = None
        if helpers:
            give_work = open_files.enter_context(worker_processes(helpers, _set_up, spec))
            give_work(int)  # so that they read while this process does
        desk = _open_desk(spec, open_files, progress)
        page = _page(spec, desk.comparison, desk.columns, desk.pictures)
        written = _write_pages(spec, page, desk, give_work, progress, provenance)
    progress(1.0, "done")
    first = int(desk.comparison.shots[0].frames[0])
    notes = dict.fromkeys(note for each in desk.cameras for note in each.notes(first))
    shots = desk.comparison.shots
    notes |= dict.fromkeys(note for each in shots for note in each.rig.undrawn_notes())
    return _result(written, desk.comparison, tuple(notes))


def _open_desk(spec: SheetSpec, open_files: ExitStack, progress: Progress) -> _Desk:
    comparison = _compare(spec, progress)
    shots = comparison.shots
    cameras = [each.camera(spec.camera, spec.camera_stage) for each in shots]
    pictures = _open_pictures(spec, shots, cameras, open_files)
    return _Desk(comparison, cameras, pictures, sheet_columns(spec, comparison, pictures))


def _helpers(spec: SheetSpec) -> int:
    """Return how many processes are to draw beside this one."""
    pixels = _row_count(spec) * _tile_height(spec) ** 2
    return min(process_count(), MOST_PROCESSES, 1 + pixels // HELPED_PIXELS) - 1


_desk: _Desk | None = None
"""Of a process that draws for another."""


def _set_up(spec: SheetSpec, stopped: Callable[[], bool]) -> None:
    def go_on(share: float, message: str) -> None:
        if stopped():
            raise CancelledError("nobody waits for this sheet any more")

    global _desk
    with suppress(UsdfaceError):  # the process that waits finds it itself, and says so
        _desk = _open_desk(spec, ExitStack(), go_on)


def _draw(number: int) -> SheetRow | None:
    return None if _desk is None else _desk.draw(number)


def _rows(
    desk: _Desk, numbers: range, give_work: GiveWork | None, progress: Progress
) -> Iterator[SheetRow]:
    """Draw rows, from the first on; helpers draw from the last on."""
    given, count = dict[int, Future[SheetRow | None]](), len(desk.comparison.chosen)
    with suppress(BrokenProcessPool):  # a helper less, not a sheet less
        given |= {each: give_work(_draw, each) for each in numbers[::-1] if give_work is not None}
    for number in numbers:
        progress(0.2 + 0.75 * number / count, f"drawing row {number + 1} of {count}")
        row, work = None, given.get(number)
        if work is not None and not work.cancel():
            with suppress(BrokenProcessPool):
                row = work.result()
        yield row or desk.draw(number)


def _compare(spec: SheetSpec, progress: Progress) -> _Comparison:
    """Read the shots, measure their weights and choose frames."""
    progress(0.0, "reading")
    shots = _open_shots(spec)
    shot = shots[0]
    progress(0.1, "placing the markers on the rig")
    equation = None if shot.take.markers is None else set_up_shot_baseline(shot)
    ruler = ShotRuler(shot)
    truth = read_keys(spec.against, shot, spec.weight_unit)
    signals = ruler.signals(truth, equation)
    chosen = _choose(spec, shot, signals)
    rows = [frame.row for frame in chosen]
    scores = [score("solve", shot, shot.weights, truth)]
    if equation is not None and spec.baseline and spec.layout in ("comparison", "worst"):
        solved = solve_baseline(equation, shot, np.array(rows, np.int64))
        scores.insert(0, score("baseline", shot, solved, truth))
    others = [each.performance_file for each in shots[1:]]
    labels = version_labels(others, taken={"baseline", "solve"})
    for other, label in zip(shots[1:], labels, strict=True):
        known = truth if _same_face(other, shot) else None
        scores.append(score(label, other, other.weights, known))
    spoken = labels_at(spec.phones, shot.take, shot.frames[rows])
    return _Comparison(shots, ruler, signals, equation, truth, scores, chosen, spoken)


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


def _row_count(spec: SheetSpec) -> int:
    listed = frame_list(spec.frames)
    if listed is not None:
        return len(listed)
    return spec.rows or (STRIP_ROWS if spec.layout == "strip" else OTHER_ROWS)


def _tile_height(spec: SheetSpec) -> int:
    return spec.tile or (STRIP_TILE if spec.layout == "strip" else OTHER_TILE)


def _page(
    spec: SheetSpec, comparison: _Comparison, columns: list[Column], pictures: list[ShotPictures]
) -> SheetPage:
    shot = comparison.shots[0]
    rigs = dict.fromkeys(each.rig.file.stem for each in comparison.shots)
    verdict = comparison.ruler.verdict(comparison.signals)
    keyed = comparison.truth is not None
    known = [each for each in comparison.scores if np.isfinite(each.error_mm).any()]
    curves = [
        ErrorCurve(
            each.label if each.against_truth else f"{each.label}, uncertainty", each.error_mm
        )
        for each in known
    ]
    if not keyed and len(curves) == 1:
        curves = [replace(curves[0], label="uncertainty")]
    return SheetPage(
        title=f"{shot.take.name} on {', '.join(rigs)}",
        verdict=(
            verdict.level,
            verdict.sentence,
            *([f"To do: {verdict.advice}"] if verdict.advice else []),
        ),
        facts=_facts(spec, shot),
        columns=tuple(column.head for column in columns),
        rows=(),
        curves=(*curves, *(() if keyed else coverage_curves(shot))),
        first_frame=int(shot.frames[0]),
        notes=_notes(spec, comparison, stand_in_eyes=any(each.stand_in_eyes for each in pictures)),
        tile_height=_tile_height(spec),
        high=range_mm(keyed=keyed),
        comparable=keyed,
    )


def _open_shots(spec: SheetSpec) -> list[Shot]:
    """Open every performance over the frames that all of them have."""
    files = (spec.performance, *spec.also)
    listed = frame_list(spec.frames)
    limits = spec.frames if listed is None else None
    shots = [open_shot(file, spec.take, frames=limits, video=spec.video) for file in files]
    first = max(int(shot.frames[0]) for shot in shots)
    last = min(int(shot.frames[-1]) for shot in shots)
    if last < first:
        raise InputError(f"{', '.join(map(str, files))}: share no frame of {shots[0].take.name}")
    if listed is not None and (listed[0] < first or listed[-1] > last):
        raise InputError(
            f"{spec.performance}: frames {spec.frames} are not all in it; it has {first}-{last}"
        )
    return [
        replace(
            shot,
            frames=shot.frames[(shot.frames >= first) & (shot.frames <= last)],
            weights=shot.weights[(shot.frames >= first) & (shot.frames <= last)],
        )
        for shot in shots
    ]


def _same_face(shot: Shot, other: Shot) -> bool:
    """Say whether weights of one mean the same on the other."""
    faces = [(each.rig.file.resolve(), each.rig.prim) for each in (shot, other)]
    return faces[0] == faces[1]


def _choose(spec: SheetSpec, shot: Shot, signals: ReviewSignals) -> list[ChosenFrame]:
    given = frame_list(spec.frames)
    if given is not None:
        rows = np.searchsorted(shot.frames, given)
        return [ChosenFrame(int(row)) for row in np.unique(rows)]
    return choose_frames(
        spec.pick or PICKS[spec.layout],
        _row_count(spec),
        strength=surface_distance(shot, shot.weights),
        signals=signals,
        rate=float(shot.take.rate),
    )


def _write_pages(
    spec: SheetSpec,
    page: SheetPage,
    desk: _Desk,
    give_work: GiveWork | None,
    progress: Progress,
    provenance: Provenance,
) -> tuple[Path, ...]:
    """Draw and write page by page, so that thousands of tiles are not held at once.

    The first page carries the name that was asked for.
    """
    shot, count = desk.comparison.shots[0], len(desk.comparison.chosen)
    pages = -(-count // spec.page_rows)
    written = []
    for number in range(pages):
        first = number * spec.page_rows
        numbers = range(first, min(first + spec.page_rows, count))
        rows = tuple(_rows(desk, numbers, give_work, progress))
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
    return tuple(facts)


def _notes(spec: SheetSpec, comparison: _Comparison, *, stand_in_eyes: bool) -> tuple[str, ...]:
    shots, shot, truth = comparison.shots, comparison.shots[0], comparison.truth
    notes = ["uncertainty: expected RMS distance of the skin from an animator's keys"]
    if truth is not None:
        notes = [
            "error: RMS distance of the skin from the keys, without the gaze",
            f"gaze alone {comparison.ruler.gaze_error_mm(truth):.2f} mm",
        ]
        means = (
            f"{each.label} {np.nanmean(each.error_mm):.2f} mm"
            for each in comparison.scores
            if each.against_truth
        )
        notes.append(f"mean: {', '.join(means)}")
    elif shot.take.markers is None:
        notes = ["the take is one of weights: compare with the video, or give keys (--against)"]
    elif shot.performance.uncertainty_mm is None:
        notes = ["the uncertainty is not known: the performance was not mapped by this version"]
    if spec.layout != "strip" and comparison.equation is not None:
        notes.append(
            "dots: the markers on the character, hollow where they were repaired; lines: from the "
            "solve to them"
        )
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
    verdict = comparison.ruler.verdict(comparison.signals)
    known = [each for each in scores if np.isfinite(each.error_mm).any()]
    means = {each.label: float(np.nanmean(each.error_mm)) for each in known}
    what = {True: "off the keys", False: "uncertainty"}
    listed = ", ".join(
        f"{each.label} {means[each.label]:.2f} mm {what[each.against_truth]}" for each in known
    )
    return StepResult(
        written,
        f"{pluralize(len(chosen), 'row')}; {f'{listed}; ' if listed else ''}{verdict.sentence}",
        notes,
        {
            "frames": [int(comparison.shots[0].frames[frame.row]) for frame in chosen],
            "mean_error_mm": {FIGURE_KEYS.get(label, label): mean for label, mean in means.items()},
            "against_truth": comparison.truth is not None,
            "verdict": verdict.figures,
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
    equation = comparison.equation
    if spec.layout != "strip" and equation is not None:
        columns.append(Column("markers", lambda row: Tile(drawn.markers_on_face(row, equation))))
    others = iter(pictures[1:])
    for each in comparison.scores:
        face = drawn if each.label in ("baseline", "solve") else next(others)
        columns.append(Column(each.label, _face(face, each)))
    if spec.difference and spec.layout in ("comparison", "worst"):
        if comparison.truth is not None:
            columns.append(Column("error", _errors(drawn, comparison)))
        elif comparison.signals.evidence.uncertainty_mm is not None:
            columns.append(Column("uncertainty", _uncertainties(drawn, comparison)))
    return columns


def _face(pictures: ShotPictures, judged: Score) -> Callable[[int], Tile]:
    def draw(row: int) -> Tile:
        error = float(judged.error_mm[row])
        value = None if np.isnan(error) else error
        return Tile(pictures.face(row, judged.weights[row]), value=value)

    return draw


def _errors(pictures: ShotPictures, comparison: _Comparison) -> Callable[[int], Tile]:
    """Return what paints how far the skin is from where the keys put it; the gaze is theirs."""
    shot, truth = comparison.shots[0], comparison.truth

    def draw(row: int) -> Tile:
        if truth is None or np.isnan(truth[row]).any():
            return Tile(None, caption="nothing keyed here")
        seen = shot.weights[row].copy()
        seen[comparison.ruler.gaze] = truth[row, comparison.ruler.gaze]
        ours, theirs = (np.asarray(shot.deformer.points(w[None])[0]) for w in (seen, truth[row]))
        away = np.linalg.norm(ours - theirs, axis=-1)
        picture = pictures.painted(row, seen, away, high=range_mm(keyed=True))
        return Tile(picture, caption=f"max {away.max():.1f} mm")

    return draw


def _uncertainties(pictures: ShotPictures, comparison: _Comparison) -> Callable[[int], Tile]:
    """Return what paints the uncertainty of each part of the face."""
    shot, evidence = comparison.shots[0], comparison.signals.evidence
    points = {name: comparison.ruler.points.get(name) for name in evidence.regions[1:]}

    def draw(row: int) -> Tile:
        if evidence.uncertainty_mm is None:
            return Tile(None)
        said = evidence.uncertainty_mm[row]
        values = np.zeros(len(shot.deformer.neutral))
        for (_, own), value in zip(points.items(), said[1:], strict=False):
            if own is not None:
                values[own] = value
        picture = pictures.painted(row, shot.weights[row], values, high=range_mm(keyed=False))
        covered = "" if evidence.coverage is None else f"{evidence.coverage[row, 0]:.0%} covered"
        return Tile(picture, caption=covered)

    return draw
