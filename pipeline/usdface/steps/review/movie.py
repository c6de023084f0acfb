"""Draw a review movie, in parallel and resumable."""

import contextlib
import json
from collections.abc import Callable, Iterator
from concurrent.futures import FIRST_COMPLETED, wait
from contextlib import ExitStack
from dataclasses import dataclass, replace
from pathlib import Path

from usdface.core.arrays import ByteImage
from usdface.core.assets import Take
from usdface.core.errors import CancelledError, InputError
from usdface.core.processes import process_count, worker_processes
from usdface.core.progress import Progress
from usdface.core.provenance import Provenance, canonical_json, hash_text
from usdface.core.rates import exact_rate
from usdface.core.side_files import (
    STRETCH_FILES,
    clear_side_folder,
    make_side_folder,
    remove_side_folder,
)
from usdface.core.sidecars import work_folder
from usdface.core.text import pluralize
from usdface.media.film.movie import write_movie
from usdface.media.film.movie_frame import MoviePanel, compose_movie_frame
from usdface.media.film.movie_join import join_movies
from usdface.model.review.verdict import judge_solve
from usdface.runner.result import StepResult
from usdface.specs.review import MovieSpec, PanelKind
from usdface.steps.review.clock import MovieClock, movie_rate, take_sound
from usdface.steps.review.head_turn import with_video_head_turn
from usdface.steps.review.pictures import ShotPictures
from usdface.steps.review.scoring import range_mm
from usdface.steps.review.shot import Shot, open_shot

STRETCH_PICTURES = 48
"""Largest number of pictures per stretch, the unit of work of a process and of an interrupted run;
fewer if all processes then get an equal number."""

_SLATE_SECONDS = 3
"""Duration of the verdict over the panels, from the performance's first frame."""

LABELS: dict[PanelKind, str] = {"video": "video", "markers": "markers", "performance": "solve"}


@dataclass(frozen=True)
class _Plan:
    """Options common to all stretches, sent to worker processes."""

    spec: MovieSpec
    panels: tuple[PanelKind, ...]
    clock: MovieClock


@dataclass(frozen=True)
class _Stretch:
    """Pictures `start` to `stop` of a movie, and their file."""

    start: int
    stop: int
    file: Path


@dataclass(frozen=True)
class _Studio:
    """State of a process that draws stretches."""

    plan: _Plan
    shot: Shot
    pictures: ShotPictures
    stopped: Callable[[], bool] = lambda: False
    """Whether the main process has stopped; called for every picture."""


def run(spec: MovieSpec, *, provenance: Provenance, progress: Progress) -> StepResult:
    """Draw the stretches of the movie, and join them with the sound."""
    shot = open_shot(spec.performance, spec.take, frames=spec.frames, video=spec.video)
    take = shot.take
    notes: list[str] = []
    panels = _panels(spec, take, notes)
    rate = movie_rate(take) if spec.rate is None else exact_rate(spec.rate, where="--rate")
    clock = shot.clock(rate)
    folder = work_folder(spec.out, "stretches")
    workers = process_count(spec.workers)
    stretches = _stretches(spec, clock, folder, provenance, workers)
    make_side_folder(folder)
    # Stretches of another spec or of older inputs are removed.
    clear_side_folder(folder, STRETCH_FILES, keep=frozenset(each.file.name for each in stretches))
    waiting = [stretch for stretch in stretches if not stretch.file.is_file()]
    if len(waiting) < len(stretches):
        notes.append(
            f"resumed: {len(stretches) - len(waiting)} of {len(stretches)} stretches were drawn "
            "before"
        )
    if "performance" in panels:
        notes += [
            *shot.camera(spec.camera, spec.camera_stage).notes(clock.first_frame),
            *shot.rig.undrawn_notes(),
        ]
    try:
        _draw_all(_Plan(spec, panels, clock), waiting, shot, min(workers, len(waiting)), progress)
    finally:
        with contextlib.suppress(OSError):  # holds stretches, for the join or the next run
            folder.rmdir()
    progress(0.97, "joining the stretches")
    sound = take_sound(take, clock, notes) if spec.sound else None
    comment = provenance.metadata | {
        "rate": str(rate),
        "first_frame": clock.first_frame,
        "pictures": clock.picture_count,
    }
    join_movies(
        spec.out,
        [stretch.file for stretch in stretches],
        audio=sound,
        rate=rate,
        timecode=clock.timecode(take.timecode_start, take.first_frame),
        comment=json.dumps(comment),
    )
    remove_side_folder(folder, STRETCH_FILES)
    seconds = clock.picture_count / float(rate)
    return StepResult(
        (spec.out,),
        f"{pluralize(clock.picture_count, 'picture')} at {float(rate):g} per second "
        f"({seconds:.1f} s), {' and '.join(panels)}, "
        f"{'with' if sound is not None else 'without'} sound",
        tuple(notes),
        {
            "pictures": clock.picture_count,
            "rate": float(rate),
            "panels": list(panels),
            "sound": sound is not None,
        },
    )


def _panels(spec: MovieSpec, take: Take, notes: list[str]) -> tuple[PanelKind, ...]:
    if spec.panels is not None:
        if "video" in spec.panels and take.video is None:
            raise InputError(
                f"{spec.take}: has no video to show; leave it out of --panels, or ingest with "
                "--video"
            )
        if "markers" in spec.panels and take.markers is None:
            raise InputError(f"{take.name}: has no markers to show; leave them out of --panels")
        return spec.panels
    if take.video is not None:
        return ("video", "performance")
    if take.markers is None:
        notes.append("the take has neither video nor markers: only the performance is shown")
        return ("performance",)
    notes.append("the take has no video: its markers are shown instead")
    return ("markers", "performance")


def _stretches(
    spec: MovieSpec, clock: MovieClock, folder: Path, provenance: Provenance, workers: int
) -> list[_Stretch]:
    """Split the movie into stretches of equal length, an equal number per process.

    A stretch's name has a hash of its provenance and the numbers of its pictures.
    """
    made_from = provenance.metadata | {"rate": str(clock.rate)}
    key = hash_text(canonical_json(made_from))[:16]
    count, rounds = clock.picture_count, -(-clock.picture_count // (STRETCH_PICTURES * workers))
    size = -(-count // (rounds * workers))
    return [
        _Stretch(start, stop, folder / f"{key}.{start:07d}-{stop:07d}{spec.out.suffix}")
        for start in range(0, count, size)
        for stop in (min(start + size, count),)
    ]


def _draw_all(
    plan: _Plan, stretches: list[_Stretch], shot: Shot, workers: int, progress: Progress
) -> None:
    if not stretches:
        return
    if workers <= 1:
        with ExitStack() as open_files:
            studio = _open_studio(plan, shot, open_files)
            for number, stretch in enumerate(stretches):
                progress(0.02 + 0.95 * number / len(stretches), f"drawing picture {stretch.start}")
                _draw_stretch(studio, stretch)
        return
    progress(0.02, f"drawing {pluralize(sum(s.stop - s.start for s in stretches), 'picture')}")
    with worker_processes(workers, _set_up, plan) as give_work:
        left = {give_work(_work, stretch) for stretch in stretches}
        while left:
            done, left = wait(left, return_when=FIRST_COMPLETED)
            for future in done:
                future.result()
            share = 1 - len(left) / len(stretches)
            progress(0.02 + 0.95 * share, f"{pluralize(len(left), 'part')} to draw")


def _open_studio(plan: _Plan, shot: Shot, open_files: ExitStack) -> _Studio:
    if "video" in plan.panels:
        shot = with_video_head_turn(shot, plan.spec.camera)
    pictures = ShotPictures(
        shot,
        height=plan.spec.height,
        quality=plan.spec.quality,
        camera=shot.camera(plan.spec.camera, plan.spec.camera_stage),
    )
    return _Studio(plan, shot, open_files.enter_context(pictures))


_shared: _Studio | None = None
"""State of a worker process."""


def _set_up(plan: _Plan, stopped: Callable[[], bool]) -> None:
    global _shared
    spec = plan.spec
    shot = open_shot(spec.performance, spec.take, frames=spec.frames, video=spec.video)
    _shared = replace(_open_studio(plan, shot, ExitStack()), stopped=stopped)


def _work(stretch: _Stretch) -> None:
    if _shared is None:
        raise RuntimeError("the worker was not set up")
    _draw_stretch(_shared, stretch)


def _draw_stretch(studio: _Studio, stretch: _Stretch) -> None:
    write_movie(stretch.file, _pictures(studio, stretch), rate=studio.plan.clock.rate)


def _pictures(studio: _Studio, stretch: _Stretch) -> Iterator[ByteImage]:
    plan, shot, pictures = studio.plan, studio.shot, studio.pictures
    height = plan.spec.height
    widths = {panel: height for panel in plan.panels}
    if "video" in plan.panels:
        widths["video"] = round(height * pictures.video_aspect / 2) * 2
    if "performance" in plan.panels:
        widths["performance"] = pictures.face_width
    title = f"{shot.take.name}  ·  {shot.rig.file.stem}"
    uncertainty = shot.face_uncertainty_mm()
    evidence = shot.evidence_at(slice(None))  # of the whole performance
    verdict, high = judge_solve(evidence), range_mm(evidence, keyed=False)
    slate_end = shot.performance.weights.first_frame + _SLATE_SECONDS * shot.take.rate
    for number in range(stretch.start, stretch.stop):
        if studio.stopped():
            raise CancelledError("the main process has stopped")
        row = plan.clock.row(number)
        frame = int(shot.frames[row])
        panels = []
        for panel in plan.panels:
            missing, pixels = "", None
            if panel == "video":
                # Not at the frame: pictures of a camera of another rate would double or be missed.
                tile = pictures.video(plan.clock.take_frame(number))
                pixels, missing = tile.pixels, tile.caption
            elif panel == "markers":
                pixels = pictures.markers(row)
            else:
                pixels = pictures.face(row, shot.weights[row])
            panels.append(MoviePanel(widths[panel], pixels, LABELS[panel], missing))
        # The label that players show; the take's timecode may have another rate.
        label = plan.clock.timecode(shot.take.timecode_start, shot.take.first_frame, number)
        yield compose_movie_frame(
            panels,
            height=height,
            title=title,
            clock="  ".join(filter(None, (label or shot.timecode(frame), str(frame)))),
            uncertainty=None if uncertainty is None else (float(uncertainty[row]), high),
            verdict=(verdict.level, *([verdict.sentence] if frame < slate_end else [])),
        )
