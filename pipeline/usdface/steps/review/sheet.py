"""Draw a contact sheet of performances."""

from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack
from dataclasses import dataclass, replace
from pathlib import Path
from queue import SimpleQueue
from threading import Event

import numpy as np

from usdface.core.processes import background_threads, usable_cores
from usdface.core.progress import Progress
from usdface.core.provenance import Provenance
from usdface.core.text import pluralize
from usdface.media.picture.error_strip import ErrorCurve
from usdface.media.picture.image import display_view, write_image
from usdface.media.picture.sheet import SheetPage, SheetRow, compose_sheet
from usdface.model.review.verdict import worst_verdict
from usdface.runner.result import StepResult
from usdface.specs.review import AUTO_CAMERA, SheetSpec
from usdface.steps.inputs.sheet_pages import replacing_pages
from usdface.steps.review.pictures import ShotPictures
from usdface.steps.review.scoring import coverage_curves, range_mm
from usdface.steps.review.sheet_columns import (
    OTHER_TILE,
    STRIP_TILE,
    SheetColumn,
    SheetComparison,
    compare_shots,
    open_shots,
    sheet_columns,
)
from usdface.steps.review.shot import Shot, ShotCamera

FIGURE_KEYS = {"solve": "usdface", "baseline": "equation"}
"""Keys of ``--json`` for labels of a sheet, kept for existing scripts."""


@dataclass(frozen=True)
class _Desk:
    """State of a thread that draws rows."""

    comparison: SheetComparison
    columns: list[SheetColumn]
    stopped: Event
    """Whether the sheet is given up; asked before each tile."""

    def draw(self, number: int) -> SheetRow:
        """Draw a row of the sheet."""
        chosen, shot = self.comparison.chosen[number], self.comparison.shots[0]
        frame = int(shot.frames[chosen.row])
        return SheetRow(
            frame=frame,
            timecode=shot.timecode(frame),
            tiles=tuple(
                column.draw(chosen.row) for column in self.columns if not self.stopped.is_set()
            ),
            note=chosen.reason,
            spoken=self.comparison.labels[number],
        )


def run(spec: SheetSpec, *, provenance: Provenance, progress: Progress) -> StepResult:
    """Draw the sheet and write it."""
    shots = open_shots(spec)
    with ExitStack() as open_files:
        cameras = [each.camera(spec.camera, spec.camera_stage) for each in shots]
        submit = open_files.enter_context(background_threads())
        opening = submit(_open_pictures, spec, shots, cameras)
        comparison = compare_shots(spec, shots, progress)
        pictures = opening.result()
        desks, stopped = list[_Desk](), Event()
        for _ in range(min(usable_cores(), spec.cores)):
            threads = [open_files.enter_context(each.for_thread()) for each in pictures]
            desks.append(_Desk(comparison, sheet_columns(spec, comparison, threads), stopped))
        page = _page(spec, comparison, desks[0].columns, pictures)
        written = _write_pages(spec, page, desks, progress, provenance)
    first = int(shots[0].frames[0])
    notes = dict.fromkeys(comparison.notes)
    notes |= dict.fromkeys(note for each in cameras for note in each.notes(first))
    notes |= dict.fromkeys(note for each in shots for note in each.rig.undrawn_notes())
    return _result(written, comparison, tuple(notes))


def _rows(desks: list[_Desk], numbers: range, count: int, progress: Progress) -> Iterator[SheetRow]:
    """Draw rows in threads: ray casting and array arithmetic release the interpreter lock."""
    free = SimpleQueue[_Desk]()
    for desk in desks:
        free.put(desk)

    def draw(number: int) -> SheetRow:
        desk = free.get()
        try:
            return desk.draw(number)
        finally:
            free.put(desk)

    with ThreadPoolExecutor(len(desks)) as pool:
        rows = pool.map(draw, numbers)
        try:
            for number in numbers:
                progress(0.2 + 0.75 * number / count, f"drawing row {number + 1} of {count}")
                yield next(rows)
        except BaseException:
            desks[0].stopped.set()
            pool.shutdown(cancel_futures=True)
            raise


def _open_pictures(
    spec: SheetSpec, shots: list[Shot], cameras: list[ShotCamera]
) -> list[ShotPictures]:
    display, tile = display_view(spec.view), _tile_height(spec)
    return [
        ShotPictures(shot, height=tile, quality=spec.quality, display=display, camera=camera)
        for shot, camera in zip(shots, cameras, strict=True)
    ]


def _tile_height(spec: SheetSpec) -> int:
    return spec.tile or (STRIP_TILE if spec.layout == "strip" else OTHER_TILE)


def _page(
    spec: SheetSpec,
    comparison: SheetComparison,
    columns: list[SheetColumn],
    pictures: list[ShotPictures],
) -> SheetPage:
    shot = comparison.shots[0]
    rigs = dict.fromkeys(each.rig.file.stem for each in comparison.shots)
    keyed = comparison.truth is not None
    known = comparison.known_scores
    curves = [
        ErrorCurve(
            each.label if each.against_truth else f"{each.label}, uncertainty", each.error_mm
        )
        for each in known
    ]
    if not keyed and len(curves) == 1:
        curves = [replace(curves[0], label="uncertainty")]
    worst = worst_verdict(comparison.verdicts)
    advice = [f"To do: {worst.advice}"] if worst.advice else []
    rest = [
        f"{name}: {each.sentence}"
        for name, each in comparison.verdicts.items()
        if name != worst.figures.get("of", name)
    ]
    return SheetPage(
        title=f"{shot.take.name} on {', '.join(rigs)}",
        verdict=(worst.level, worst.sentence, *advice, *rest),
        facts=_facts(spec, shot),
        columns=tuple(column.head for column in columns),
        rows=(),
        curves=(*curves, *(() if keyed else coverage_curves(shot))),
        first_frame=int(shot.frames[0]),
        notes=_notes(spec, comparison, stand_in_eyes=any(each.stand_in_eyes for each in pictures)),
        tile_height=_tile_height(spec),
        high=range_mm(comparison.signals.evidence, keyed=keyed)
        if known or shot.performance.uncertainty_mm is not None
        else None,
        comparable=keyed,
    )


def _write_pages(
    spec: SheetSpec, page: SheetPage, desks: list[_Desk], progress: Progress, provenance: Provenance
) -> tuple[Path, ...]:
    """Draw and write page by page, to bound memory."""
    comparison = desks[0].comparison
    shot, count = comparison.shots[0], len(comparison.chosen)
    pages = -(-count // spec.page_rows)
    with replacing_pages(spec.out, pages, step=spec.step) as files:
        for number, file in enumerate(files):
            first = number * spec.page_rows
            numbers = range(first, min(first + spec.page_rows, count))
            rows = tuple(_rows(desks, numbers, count, progress))
            title = page.title if pages == 1 else f"{page.title}, page {number + 1} of {pages}"
            write_image(
                file,
                compose_sheet(replace(page, title=title, rows=rows)),
                metadata=provenance.metadata,
                timecode=shot.timecode(int(shot.frames[0])) or None,
                rate=shot.take.rate,
            )
    return tuple(files)


def _facts(spec: SheetSpec, shot: Shot) -> tuple[str, ...]:
    facts = [f"frames {shot.frames[0]}-{shot.frames[-1]}", f"{float(shot.take.rate):g} fps"]
    if spec.camera != AUTO_CAMERA:
        facts.append(f"camera {spec.camera}")
    if shot.take.performer:
        facts.insert(0, shot.take.performer)
    return tuple(facts)


def _notes(spec: SheetSpec, comparison: SheetComparison, *, stand_in_eyes: bool) -> tuple[str, ...]:
    shots, shot, truth = comparison.shots, comparison.shots[0], comparison.truth
    notes = [
        "uncertainty: expected RMS distance of the skin from an animator's keys; grey: not known"
    ]
    if truth is not None:
        notes = [
            "error: RMS distance of the skin from the keys, without gaze and tongue",
            *(f"{name} alone {mm:.3f} mm" for name, mm in comparison.unseen_mm.items() if mm),
        ]
        means = (
            f"{each.label} {np.nanmean(each.error_mm):.2f} mm"
            for each in comparison.scores
            if each.against_truth
        )
        notes.append(f"mean: {', '.join(means)}")
    elif shot.take.markers is None:
        with_video = "" if shot.take.video is None else "compare with the video, or "
        notes = [f"the take has weights and no markers: {with_video}give keys (--against)"]
    elif shot.performance.uncertainty_mm is None:
        notes = ["uncertainty unknown: only solves by a mapping of this version state it"]
    if spec.layout != "strip" and comparison.equation is not None:
        notes.append(
            "dots: markers on the character, hollow if repaired; white lines: residual; blue "
            "lines: lips, lids and brows"
        )
    if any(comparison.labels):
        notes.append("next to frames: phone and viseme")
    if stand_in_eyes:
        notes.append("the rig has no eyes: stand-ins are drawn")
    if any(each.rig.undrawn_notes() for each in shots):
        notes.append("textures are not drawn")
    return tuple(notes)


def _result(
    written: tuple[Path, ...], comparison: SheetComparison, notes: tuple[str, ...]
) -> StepResult:
    known, chosen = comparison.known_scores, comparison.chosen
    verdict = worst_verdict(comparison.verdicts)
    means = {each.label: float(np.nanmean(each.error_mm)) for each in known}
    kinds = {True: "off the keys", False: "uncertainty"}
    listed = ", ".join(
        f"{each.label} {means[each.label]:.2f} mm {kinds[each.against_truth]}" for each in known
    )
    return StepResult(
        written,
        f"{verdict.sentence} ({pluralize(len(chosen), 'row')}{f'; {listed}' if listed else ''})",
        notes,
        {
            "frames": [int(comparison.shots[0].frames[frame.row]) for frame in chosen],
            "mean_error_mm": {FIGURE_KEYS.get(label, label): mean for label, mean in means.items()},
            "against_truth": comparison.truth is not None,
            **{f"{name}_mean_mm": mm for name, mm in comparison.unseen_mm.items()},
            "verdict": verdict.figures,
            "verdicts": {FIGURE_KEYS.get(k, k): v.level for k, v in comparison.verdicts.items()},
        },
        level=verdict.level,
    )
