"""References and their takes in, a sheet to tune by out."""

from contextlib import ExitStack
from pathlib import Path

import numpy as np

from usdface.core.arrays import ByteImage
from usdface.core.assets import References, Take
from usdface.core.deformer import Deformer
from usdface.core.errors import InputError
from usdface.core.progress import Progress, silent
from usdface.core.provenance import Provenance
from usdface.core.text import pluralize
from usdface.core.timecode import shift_timecode
from usdface.media.face.camera import frame_rig
from usdface.media.face.markers_view import draw_markers, frame_markers
from usdface.media.face.render import FaceRenderer
from usdface.media.face.sculpted_normals import SculptedNormals
from usdface.media.film.image_sequence import ImageSequence, open_video
from usdface.media.film.video import VideoReader
from usdface.media.picture.image import read_picture, write_image
from usdface.media.picture.reference_sheet import ReferenceRow, compose_reference_sheet
from usdface.model.selection.baseline import set_up_equation
from usdface.runner.origin import provenance_metadata
from usdface.runner.result import StepResult
from usdface.specs.paths import frame_range
from usdface.specs.references import ReferenceSheetSpec
from usdface.speech.visemes import viseme_label
from usdface.steps.inputs.tuned_pairs import read_set_references
from usdface.usdio.references.tuning import read_pair_notes
from usdface.usdio.rig.read import read_rig
from usdface.usdio.take.read import read_take

_YAW_DEGREES = 12.0
"""A little from the side, where lips and lids show their depth."""

LEAST_WEIGHT = 0.05
"""Weights below are not worth naming."""

_Video = VideoReader | ImageSequence


def run(
    spec: ReferenceSheetSpec, *, provenance: Provenance, progress: Progress = silent
) -> StepResult:
    """Draw every pair and write the sheet."""
    progress(0.0, "reading")
    references = read_set_references(spec.references)
    rig = read_rig(references.rig_file, prim=references.rig_prim)
    rig.check_has(
        references.shape_names, source=spec.references, remedy="select again for this rig"
    )
    columns = [rig.shapes.index(name) for name in references.shape_names]
    takes = _takes(spec.takes, references)
    pairs = _pairs(spec, references)
    deformer, renderer = Deformer(rig), FaceRenderer(rig.meshes)
    normals = SculptedNormals(rig, deformer)
    weights = np.zeros((len(references.weights), len(rig.shapes)))
    weights[:, columns] = references.weights
    equation = set_up_equation(
        rig,
        deformer,
        neutral=references.neutral,
        positions=references.markers,
        visible=np.ones(references.markers.shape[:2], dtype=np.bool_),
        rigid=tuple(references.marker_names.index(name) for name in references.rigid),
    )
    residual = equation.residual_mm(references.markers, weights)
    camera = frame_rig(rig.meshes, yaw_degrees=_YAW_DEGREES)
    cloud = frame_markers(references.markers)
    rows = []
    pair_notes = read_pair_notes(spec.references)
    with ExitStack() as open_files:
        videos = {name: _open_video(take, open_files) for name, take in takes.items()}
        for number, pair in enumerate(pairs):
            progress(0.2 + 0.7 * number / len(pairs), f"drawing pair {pair + 1}")
            name, frame = references.takes[pair], int(references.frames[pair])
            picture, missing = _video_picture(takes.get(name), videos.get(name), frame)
            if picture is None:
                picture = _archived_picture(pair_notes[pair].image)
            face = renderer.render(
                deformer.points(weights[pair : pair + 1])[0],
                camera=camera,
                width=spec.tile,
                height=spec.tile,
                quality=spec.quality,
                sculpted=normals.at(weights[pair]),
            )
            rows.append(
                ReferenceRow(
                    number=pair + 1,
                    place=_place(takes.get(name), name, frame),
                    said=_labels(references, pair),
                    tuned=bool(references.tuned[pair]),
                    video=picture,
                    missing=missing,
                    markers=draw_markers(
                        references.markers[pair], width=spec.tile, height=spec.tile, frame=cloud
                    ),
                    face=face,
                    weights=_strongest(references, pair),
                    residual_mm=float(residual[pair]),
                )
            )
    progress(0.95, f"writing {spec.out.name}")
    facts = [
        rig.file.name,
        f"{len(pairs)} of {len(references.frames)} pairs",
        f"{int(references.tuned.sum())} tuned",
    ]
    if renderer.eyes_put_in:
        facts.append("the rig has no eyes: stand-ins are drawn")
    plain = rig.undrawn_notes()
    if plain:
        facts.append("textures are not drawn")
    page = compose_reference_sheet(
        tuple(rows),
        title=spec.references.stem,
        facts=tuple(facts),
        tile=spec.tile,
        paper=spec.paper,
    )
    metadata = provenance_metadata(provenance)
    write_image(spec.out, page, metadata=metadata)
    progress(1.0, "done")
    blind = sum(row.video is None for row in rows)
    notes = (*((f"no video frame for {pluralize(blind, 'pair')}",) if blind else ()), *plain)
    return StepResult(
        (spec.out,),
        f"{pluralize(len(rows), 'pair')} drawn, {int(references.tuned[pairs].sum())} of them tuned",
        notes,
        {"pairs": [pair + 1 for pair in pairs], "width": page.shape[1], "height": page.shape[0]},
    )


def _takes(files: tuple[Path, ...], references: References) -> dict[str, Take]:
    found = {take.name: take for take in map(read_take, files)}
    unknown = [name for name in found if name not in references.takes]
    if unknown:
        raise InputError(
            f"no pair is of take {unknown[0]!r}, but of {', '.join(sorted(set(references.takes)))}"
            "; give the takes the references were selected from"
        )
    return found


def _pairs(spec: ReferenceSheetSpec, references: References) -> list[int]:
    limits = frame_range(spec.pairs) or (1, len(references.frames))
    last = min(limits[1], len(references.frames))
    pairs = [pair - 1 for pair in range(max(limits[0], 1), last + 1)]
    if not pairs:
        raise InputError(
            f"{spec.references}: has pairs 1-{len(references.frames)}, none of {spec.pairs}"
        )
    return pairs


def _open_video(take: Take, stack: ExitStack) -> _Video | None:
    if take.video is None:
        return None
    video = open_video(take.video.file, take.video.rate)
    stack.enter_context(video)
    return video


def _video_picture(
    take: Take | None, video: _Video | None, frame: int
) -> tuple[ByteImage | None, str]:
    """Find the camera's picture of a pair, by the clock that aligns the two."""
    if take is None or take.video is None or video is None:
        return None, "no video"
    seconds = (frame - take.first_frame) / float(take.rate)
    at = take.video.video_time(seconds)
    try:
        return video.frame_at(at), "no video here"
    except InputError:
        return None, "cannot be decoded"


def _archived_picture(image: Path | None) -> ByteImage | None:
    """Return the picture that `select` archived, where the asset names it and it still exists."""
    try:
        return None if image is None else read_picture(image)
    except InputError:
        return None


def _place(take: Take | None, name: str, frame: int) -> str:
    timecode = ""
    if take is not None:
        timecode = shift_timecode(take.timecode_start, frame - take.first_frame, take.rate)
    return "  ".join(part for part in (name, f"frame {frame}", timecode) if part)


def _labels(references: References, pair: int) -> str:
    viseme = references.visemes[pair] if references.visemes else ""
    emotion = references.emotions[pair] if references.emotions else ""
    return "  ".join(part for part in (viseme_label(viseme), emotion) if part)


def _strongest(references: References, pair: int) -> tuple[tuple[str, float], ...]:
    weights = references.weights[pair]
    order = np.argsort(-np.abs(weights), kind="stable")
    return tuple(
        (references.shape_names[i], float(weights[i]))
        for i in order
        if abs(weights[i]) >= LEAST_WEIGHT
    )
