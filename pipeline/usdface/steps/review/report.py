"""Write the HTML report of a performance."""

from collections.abc import Iterator
from contextlib import suppress

import numpy as np

from usdface.core.arrays import ByteImage
from usdface.core.assets import Video
from usdface.core.errors import InputError
from usdface.core.processes import background_threads
from usdface.core.progress import Progress, part
from usdface.core.provenance import Provenance
from usdface.core.replacing import write_text
from usdface.core.side_files import emptied_side_folder
from usdface.core.sidecars import work_folder
from usdface.core.text import pluralize
from usdface.media.film.movie import video_encoder, write_movie
from usdface.media.film.video import open_video
from usdface.media.page.face_payload import pack_face
from usdface.media.page.report_page import PagePicture, ReviewPage, build_page
from usdface.media.picture.canvas import empty_tile, fit_picture
from usdface.model.review.moments import review_moments
from usdface.model.review.verdict import judge_solve
from usdface.numerics.measure.face_regions import region_of_shape
from usdface.runner.origin import check_same_take
from usdface.runner.result import StepResult
from usdface.specs.review import ReportSpec
from usdface.steps.inputs.phone_labels import labels_at
from usdface.steps.review.clock import MovieClock, take_sound
from usdface.steps.review.head_turn import with_video_head_turn
from usdface.steps.review.report_parts import (
    page_commands,
    page_curves,
    page_heat,
    page_markers,
    page_motion,
    page_notes,
    page_strips,
)
from usdface.steps.review.report_tables import find_references, listings, show_coverage
from usdface.steps.review.scoring import ShotMetric, read_keys, set_up_shot_baseline, solve_baseline
from usdface.steps.review.shot import Shot, open_shot

LONGEST_FRAMES = 36_000
"""Ten minutes at 60 frames per second; browsers do not open longer reports."""

LARGEST_SHEET_BYTES = 64 << 20
SHEET_TYPES = {".jpg": "image/jpeg", ".jpeg": "image/jpeg", ".png": "image/png"}


def run(spec: ReportSpec, *, provenance: Provenance, progress: Progress) -> StepResult:
    """Collect the contents of the report and write it."""
    check_same_take(spec.performance, spec.take, spec.also)
    shot = open_shot(spec.performance, spec.take, frames=spec.frames, video=spec.video)
    shot = with_video_head_turn(shot, spec.camera)
    # One picture per frame of the take, so that video frames match those of the sheet.
    clock = shot.clock(shot.take.rate)
    if len(shot.frames) > LONGEST_FRAMES:
        raise InputError(
            f"{spec.performance}: {len(shot.frames)} frames are too many for a report, at most "
            f"{LONGEST_FRAMES}; show parts of it with --frames"
        )
    notes: list[str] = []
    page = _page(spec, shot, clock, notes, provenance, progress)
    progress(0.97, f"writing {spec.out.name}")
    text = build_page(page)
    write_text(spec.out, text)
    return StepResult(
        (spec.out,),
        f"{page.verdict[1]} ({pluralize(len(page.frames), 'frame')}, "
        f"{pluralize(len(shot.rig.shapes), 'shape')}, {len(text) / 1e6:.1f} MB: open it in a "
        "browser)",
        tuple(notes),
        {
            "pictures": len(page.frames),
            "megabytes": len(text) / 1e6,
            "worst_frames": [int(page.frames[picture]) for picture, *_ in page.worst],
            "verdict": page.verdict[0],
        },
        level=page.verdict[0],
    )


def _page(
    spec: ReportSpec,
    shot: Shot,
    clock: MovieClock,
    notes: list[str],
    provenance: Provenance,
    progress: Progress,
) -> ReviewPage:
    """Return the contents of the report; notes on missing parts are appended."""
    take, rig, metric = shot.take, shot.rig, ShotMetric(shot)
    keys = read_keys(spec.against, shot, spec.weight_unit, notes)
    pictures, review_notes = _sheet(spec), page_notes(spec, shot)  # errors before long work
    spoken = labels_at(spec.phones, take, shot.frames) if spec.phones else ()
    progress(0.05, "placing the markers on the rig")
    equation = set_up_shot_baseline(shot) if take.markers is not None else None
    signals, parts = metric.signals(keys, equation), metric.skin.parts
    verdict = judge_solve(signals.evidence)
    rows = np.arange(len(shot.frames))
    baseline = solve_baseline(equation, shot, rows) if spec.baseline and equation else None
    tables = listings(shot, keys, provenance)
    view = shot.camera(spec.camera, spec.camera_stage)
    notes += [*view.notes(clock.first_frame), *rig.undrawn_notes()]
    shares = None if shot.motion is None else shot.motion.shares
    first, more_notes = view.at(clock.first_frame, still=True), list[str]()
    with background_threads() as submit:  # codecs release the interpreter lock
        face = submit(pack_face, rig, camera=first, shares=shares, parts=parts)
        covered = submit(show_coverage, spec, shot, more_notes)
        movie = _movie(spec, shot, clock, notes, part(progress, 0.25, 0.97))
    notes += more_notes
    coverage_tables, coverage_pictures = covered.result()
    tables = (*tables[:-1], *coverage_tables, tables[-1])  # provenance stays last
    pictures += coverage_pictures
    moments = review_moments(signals, spec.worst, rate=float(take.rate))
    curves = page_curves(spec, shot, keys, baseline)
    return ReviewPage(
        title=f"{take.name} on {rig.file.stem}",
        verdict=(verdict.level, verdict.sentence, verdict.advice),
        facts=_facts(shot),
        rate=float(take.rate),
        frames=shot.frames.tolist(),
        timecodes=list(map(shot.timecode, shot.frames.tolist())) if take.timecode_start else [],
        shapes=rig.shapes,
        regions=tuple(region_of_shape(each) or "other" for each in parts),
        curves=curves,
        strips=page_strips(signals),
        worst=tuple((each.row, each.region, each.reason) for each in moments),
        listings=tables,
        face=face.result(),
        transforms=page_motion(shot),
        moves_as_one=shot.motion is not None and shot.motion.moves_as_one,
        movie=movie,
        movie_type=_movie_kind()[1],
        pictures=pictures,
        spoken=spoken,
        origin=provenance.metadata,
        markers=None if equation is None else page_markers(shot, equation),
        heat=page_heat(signals, curves),
        left_out=tuple(rig.shapes[column] for column in metric.skin.excluded.tolist()),
        notes=review_notes,
        commands=page_commands(spec, shot, spec.references or find_references(spec.performance)),
    )


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
    return tuple(facts)


def _movie_kind() -> tuple[str, str]:
    """Return suffix and type of a movie that browsers play."""
    h264 = "264" in video_encoder("mp4")
    return (".mp4", "video/mp4") if h264 else (".webm", "video/webm")


def _movie(
    spec: ReportSpec, shot: Shot, clock: MovieClock, notes: list[str], progress: Progress
) -> bytes:
    """Return the take's video at the report's frames, encoded; empty without a video."""
    take = shot.take
    if take.video is None:
        notes.append("the take has no video: the report shows only the face")
        return b""
    sound = take_sound(take, clock, notes)
    with emptied_side_folder(work_folder(spec.out, "video")) as folder:
        file = folder / f"video{_movie_kind()[0]}"
        write_movie(
            file,
            _camera_pictures(spec, shot, take.video, clock, progress),
            rate=clock.rate,
            audio=sound,
            proxy=True,
        )
        return file.read_bytes()


def _camera_pictures(
    spec: ReportSpec, shot: Shot, video: Video, clock: MovieClock, progress: Progress
) -> Iterator[ByteImage]:
    """Yield the video's picture at each frame of the take; repeated pictures are the same array."""
    take = shot.take
    shown = tile = None
    with open_video(video.file, video.rate) as movie:
        lines, columns = spec.height, spec.height * 16 // 9
        with suppress(InputError):  # the first picture of a sequence may be damaged
            lines, columns = movie.frame(0).shape[:2]
        height = min(spec.height, lines)  # browsers enlarge smaller videos
        width = 2 * round(height * columns / lines / 2)
        for picture, frame in enumerate(shot.frames.tolist()):
            if picture % 60 == 0:
                progress(picture / clock.picture_count, f"video picture {picture}")
            index = movie.index_at(take.video_seconds(frame))
            if tile is None or index != shown:
                pixels, missing = None, "no video here"
                try:
                    pixels = None if index is None else movie.frame(index)
                except InputError:
                    missing = "cannot be decoded"
                shown = index
                tile = (
                    empty_tile(width, height, missing)
                    if pixels is None
                    else fit_picture(pixels, width=width, height=height)
                )
            yield tile


def _sheet(spec: ReportSpec) -> tuple[PagePicture, ...]:
    if spec.sheet is None:
        return ()
    kind = SHEET_TYPES.get(spec.sheet.suffix.lower())
    if kind is None:
        raise InputError(
            f"{spec.sheet}: browsers show only {', '.join(SHEET_TYPES)}; draw the sheet as one of "
            "these"
        )
    if spec.sheet.stat().st_size > LARGEST_SHEET_BYTES:
        raise InputError(f"{spec.sheet}: is larger than 64 MB; make it with fewer rows")
    return (PagePicture("Contact sheet", "Contact sheet", spec.sheet.read_bytes(), kind),)
