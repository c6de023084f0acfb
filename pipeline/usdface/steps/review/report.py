"""The report: one page with the face, the video, curves and what to know of a performance."""

import tempfile
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path

import numpy as np

from usdface.core.arrays import ByteImage, FloatArray, columns_by_name
from usdface.core.errors import InputError
from usdface.core.progress import Progress, part, silent
from usdface.core.provenance import Provenance
from usdface.core.replacing import replacing
from usdface.core.text import pluralize
from usdface.media.film.image_sequence import open_video
from usdface.media.film.movie import video_encoder, write_movie
from usdface.media.page.face_payload import pack_face
from usdface.media.page.report_page import (
    PagePicture,
    ReviewPage,
    Strip,
    WeightCurves,
    build_page,
)
from usdface.media.picture.sheet import round_range
from usdface.media.picture.tiles import empty_tile, fit_picture
from usdface.numerics.measure.face_regions import region_of_shape
from usdface.runner.origin import provenance_metadata
from usdface.runner.result import StepResult
from usdface.specs.review import AUTO_CAMERA, FramePick, ReportSpec
from usdface.steps.inputs.phone_labels import labels_at
from usdface.steps.review.clock import SAMPLE_RATE, MovieClock, movie_rate, take_sound
from usdface.steps.review.report_tables import evaluate_shown, listings, show_coverage
from usdface.steps.review.scoring import ChosenFrame, choose_frames, read_keys, set_up_shot_baseline
from usdface.steps.review.shot import Shot, open_shot
from usdface.usdio.performance.read import PerformanceReader

LONGEST_PICTURES = 36_000
"""Ten minutes at 60 pictures per second: a longer page would not open."""

SURE_MM = 0.5
"""Uncertainty up to which a frame is not worth a look for it: half of what is seen."""

LARGEST_SHEET_BYTES = 64 << 20
SHEET_TYPES = {".jpg": "image/jpeg", ".jpeg": "image/jpeg", ".png": "image/png"}


def run(spec: ReportSpec, *, provenance: Provenance, progress: Progress = silent) -> StepResult:
    """Gather everything and write the page."""
    progress(0.0, "reading")
    shot = open_shot(spec.performance, spec.take, frames=spec.frames)
    clock = _clock(spec, shot)
    notes: list[str] = []
    page = _page(spec, shot, clock, notes, provenance, progress)
    progress(0.97, f"writing {spec.out.name}")
    text = build_page(page)
    with replacing(spec.out) as temporary:
        temporary.write_text(text, encoding="utf-8")
    progress(1.0, "done")
    return StepResult(
        (spec.out,),
        f"{pluralize(clock.picture_count, 'picture')}, {pluralize(len(shot.rig.shapes), 'shape')}, "
        f"{len(text) / 1e6:.1f} MB; open it in a browser",
        tuple(notes),
        {
            "pictures": clock.picture_count,
            "megabytes": len(text) / 1e6,
            "worst_frames": [int(page.frames[picture]) for picture, _ in page.worst],
        },
    )


def _clock(spec: ReportSpec, shot: Shot) -> MovieClock:
    clock = MovieClock(
        rate=movie_rate(shot.take),
        take_rate=shot.take.rate,
        first_frame=int(shot.frames[0]),
        frame_count=len(shot.frames),
    )
    if clock.picture_count > LONGEST_PICTURES:
        raise InputError(
            f"{spec.performance}: {clock.picture_count} pictures are too many for a page, which "
            f"holds {LONGEST_PICTURES}; show parts of it with --frames"
        )
    return clock


def _page(
    spec: ReportSpec,
    shot: Shot,
    clock: MovieClock,
    notes: list[str],
    provenance: Provenance,
    progress: Progress,
) -> ReviewPage:
    """Measure, pack and draw what the page shows; what could not be had is added to the notes."""
    take, rig = shot.take, shot.rig
    rows = np.array([clock.row(picture) for picture in range(clock.picture_count)])
    frames = shot.frames[rows]
    keys = read_keys(spec.against, rig, shot.frames)
    progress(0.05, "placing the markers on the rig")
    equation = set_up_shot_baseline(shot)
    residual = equation.residual_mm(shot.positions, shot.weights)
    baseline = equation.propose(shot.positions[rows]) if spec.baseline else None
    pictures, strips = _sheet(spec), _strips(shot, residual, rows)
    tables = listings(shot, evaluate_shown(shot, keys), provenance)
    progress(0.2, "packing the face")
    view = shot.camera(spec.camera, spec.camera_stage)
    notes += [*view.notes(clock.first_frame), *rig.undrawn_notes()]
    face = pack_face(rig, camera=None if spec.camera == AUTO_CAMERA else view.at(clock.first_frame))
    movie = _movie(spec, shot, clock, notes, part(progress, 0.25, 0.93))
    coverage = show_coverage(spec, shot, rows, notes, part(progress, 0.93, 0.97))
    if coverage is not None:
        strips = (*strips, coverage.strip)
        tables = (*tables[:-1], *coverage.listings, tables[-1])  # provenance is last
        pictures = (*pictures, coverage.picture)
    return ReviewPage(
        title=f"{take.name} on {rig.file.stem}",
        facts=_facts(shot),
        rate=float(clock.rate),
        frames=frames.tolist(),
        timecodes=list(map(shot.timecode, frames.tolist())) if take.timecode_start else [],
        shapes=rig.shapes,
        regions=tuple(region_of_shape(name) or "other" for name in rig.shapes),
        curves=_curves(shot, rows, keys, baseline),
        strips=strips,
        worst=_worst(spec, shot, residual, clock),
        listings=tables,
        face=face,
        movie=movie,
        movie_type=_movie_kind()[1],
        pictures=pictures,
        said=labels_at(spec.phones, take, frames) if spec.phones else (),
        origin=provenance_metadata(provenance),
    )


def _curves(
    shot: Shot, rows: FloatArray, truth: FloatArray | None, baseline: FloatArray | None
) -> tuple[WeightCurves, ...]:
    """Return every set of weights there is; the first is what is published."""
    reader = PerformanceReader(shot.performance_file)
    shown = WeightCurves("edited" if reader.edits else "solve", shot.weights[rows])
    found = [shown]
    if reader.edits:
        solved = reader.solved(int(shot.frames[0]), int(shot.frames[-1]))
        ordered = columns_by_name(solved, reader.names, shot.rig.shapes)
        found.append(WeightCurves("solve", ordered[rows]))
    if truth is not None:
        found.append(WeightCurves("keys", truth[rows]))
    if baseline is not None:
        found.append(WeightCurves("baseline", baseline))
    return tuple(found)


def _strips(shot: Shot, residual: FloatArray, rows: FloatArray) -> tuple[Strip, ...]:
    strips = [
        Strip("residual", residual[rows], 0.0, round_range(residual), "mm"),
    ]
    uncertainty = shot.face_uncertainty_mm()
    if uncertainty is not None:
        shown = uncertainty[rows]
        strips.insert(0, Strip("uncertainty", shown, 0.0, round_range(uncertainty), "mm"))
    return tuple(strips)


def _worst(
    spec: ReportSpec, shot: Shot, residual: FloatArray, clock: MovieClock
) -> tuple[tuple[int, str], ...]:
    """Return pictures to look at first: by residual, up to half by uncertainty; by time."""
    uncertainty = shot.face_uncertainty_mm()
    zero = np.zeros(len(shot.frames))

    def pick(by: FramePick, count: int) -> list[ChosenFrame]:
        return choose_frames(
            by, count, strength=zero, error_mm=residual, uncertainty_mm=uncertainty, jump_mm=zero
        )

    doubtful: list[ChosenFrame] = []
    if uncertainty is not None and spec.worst > 1:
        doubtful = [
            frame
            for frame in pick("uncertainty", spec.worst // 2)
            if uncertainty[frame.row] > SURE_MM
        ]
    reasons: dict[int, str] = {}
    for frame in (*pick("residual", spec.worst - len(doubtful)), *doubtful):
        picture = min(round(frame.row * clock.rate / clock.take_rate), clock.picture_count - 1)
        reasons.setdefault(picture, frame.reason.replace("error", "residual"))
    return tuple(sorted(reasons.items()))


def _facts(shot: Shot) -> tuple[str, ...]:
    take = shot.take
    facts = [
        f"frames {shot.frames[0]}-{shot.frames[-1]}",
        f"{float(take.rate):g} frames per second",
        f"{len(shot.frames) / float(take.rate):.1f} s",
    ]
    if take.performer:
        facts.insert(0, take.performer)
    if take.timecode_start:
        facts.append(f"timecode {shot.timecode(int(shot.frames[0]))}")
    uncertainty = shot.face_uncertainty_mm()
    if uncertainty is not None:
        facts.append(f"mean uncertainty {float(uncertainty.mean()):.2f} mm")
    return tuple(facts)


def _movie_kind() -> tuple[str, str]:
    """Return suffix and type of a movie that browsers play."""
    h264 = "264" in video_encoder("mp4")
    return (".mp4", "video/mp4") if h264 else (".webm", "video/webm")


def _movie(
    spec: ReportSpec, shot: Shot, clock: MovieClock, notes: list[str], progress: Progress
) -> bytes:
    """Return the camera's pictures on the clock of the page; empty without a video."""
    take = shot.take
    if take.video is None:
        notes.append("the take has no video: the page shows the face alone")
        return b""
    sound = take_sound(take, clock, notes)
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / f"video{_movie_kind()[0]}"
        write_movie(
            file,
            _camera_pictures(spec, shot, clock, progress),
            rate=clock.rate,
            audio=sound,
            sample_rate=SAMPLE_RATE,
            proxy=True,
        )
        return file.read_bytes()


def _camera_pictures(
    spec: ReportSpec, shot: Shot, clock: MovieClock, progress: Progress
) -> Iterator[ByteImage]:
    take = shot.take
    if take.video is None:
        raise InputError(f"{take.name}: has no video")
    start = (clock.first_frame - take.first_frame) / float(take.rate)
    with ExitStack() as open_files:
        video = open_video(take.video.file, take.video.rate)
        open_files.enter_context(video)
        width = 0
        for picture in range(clock.picture_count):
            if picture % 60 == 0:
                progress(picture / clock.picture_count, f"video picture {picture}")
            seconds = start + picture / float(clock.rate)
            at = take.video.video_time(seconds)
            missing = "no video here"
            try:
                pixels = video.frame_at(at)
            except InputError:
                pixels, missing = None, "cannot be decoded"
            if not width:
                aspect = 16 / 9 if pixels is None else pixels.shape[1] / pixels.shape[0]
                width = round(spec.height * aspect / 2) * 2
            if pixels is None:
                yield empty_tile(width, spec.height, missing)
            else:
                yield fit_picture(pixels, width=width, height=spec.height)


def _sheet(spec: ReportSpec) -> tuple[PagePicture, ...]:
    if spec.sheet is None:
        return ()
    kind = SHEET_TYPES.get(spec.sheet.suffix.lower())
    if kind is None:
        raise InputError(f"{spec.sheet}: browsers show {', '.join(SHEET_TYPES)}; make the sheet so")
    if spec.sheet.stat().st_size > LARGEST_SHEET_BYTES:
        raise InputError(f"{spec.sheet}: is larger than 64 MB; make it with fewer rows")
    return (PagePicture("Contact sheet", "Contact sheet", spec.sheet.read_bytes(), kind),)
