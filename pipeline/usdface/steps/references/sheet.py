"""Draw reference pairs as a sheet for tuning."""

from contextlib import ExitStack, suppress
from pathlib import Path

import numpy as np

from usdface.core.arrays import ByteImage, columns_by_name
from usdface.core.assets import References, Rig, Take
from usdface.core.deformer import Deformer
from usdface.core.errors import InputError
from usdface.core.progress import Progress
from usdface.core.provenance import Provenance
from usdface.core.rates import shift_timecode
from usdface.core.text import pluralize
from usdface.media.face.camera import frame_rig
from usdface.media.face.markers_view import MarkersFrame, draw_markers, frame_markers
from usdface.media.face.render import FaceRenderer
from usdface.media.face.sculpted_normals import SculptedNormals
from usdface.media.film.video import open_video, picture_at_frame
from usdface.media.picture.image import read_picture, write_image
from usdface.media.picture.reference_sheet import PAGE_PAIRS, ReferenceRow, compose_reference_sheet
from usdface.model.placement.rig_orientation import facing_degrees
from usdface.model.selection.baseline import PerformerMarkers
from usdface.runner.result import StepResult
from usdface.specs.paths import frame_range
from usdface.specs.references import ReferenceSheetSpec
from usdface.speech.phones import viseme_label
from usdface.steps.inputs.marker_lines import lines_on_rig
from usdface.steps.inputs.placement import placed_equation, stored_placement
from usdface.steps.inputs.sheet_pages import replacing_pages
from usdface.usdio.references.read import read_pair_notes, read_rig_of
from usdface.usdio.references.weight_layers import read_keyed_references
from usdface.usdio.take.read import read_first_frame

_LEAST_SHOWN_WEIGHT = 0.05
"""Smallest weight that is listed."""


def run(spec: ReferenceSheetSpec, *, provenance: Provenance, progress: Progress) -> StepResult:
    """Draw every pair and write the sheet."""
    references = read_keyed_references(spec.references)
    rig = read_rig_of(references, spec.references)
    pairs = _pairs(spec, references)
    undrawn, without_video = rig.undrawn_notes(), 0
    pages = -(-len(pairs) // PAGE_PAIRS)
    with ExitStack() as open_files, replacing_pages(spec.out, pages, step=spec.step) as files:
        pictures = _PairPictures(spec, references, rig, open_files)
        facts = [
            rig.file.name,
            f"{len(pairs)} of {len(references.frames)} pairs",
            f"{int(references.tuned.sum())} tuned",
        ]
        if pictures.stand_in_eyes:
            facts.append("the rig has no eyes: stand-ins are drawn")
        if undrawn:
            facts.append("textures are not drawn")
        for number, file in enumerate(files):
            rows = []
            for pair in pairs[number * PAGE_PAIRS : (number + 1) * PAGE_PAIRS]:
                progress(0.2 + 0.75 * number / pages, f"drawing pair {pair + 1}")
                rows.append(pictures.row(pair))
            without_video += sum(row.video is None for row in rows)
            page = compose_reference_sheet(
                tuple(rows),
                title=spec.references.stem
                + (f", page {number + 1} of {pages}" if pages > 1 else ""),
                facts=tuple(facts),
                tile=spec.tile,
                paper=spec.paper,
            )
            write_image(file, page, metadata=provenance.metadata)
    notes = tuple(undrawn)
    if without_video:
        notes = (f"no video frame for {pluralize(without_video, 'pair')}", *notes)
    tuned = int(references.tuned[pairs].sum())
    return StepResult(
        tuple(files),
        f"{pluralize(len(pairs), 'pair')} drawn, {tuned} of them tuned",
        notes,
        {"pairs": [pair + 1 for pair in pairs], "width": page.shape[1], "height": page.shape[0]},
    )


class _PairPictures:
    """Draws single pairs with common renderer, cameras and open videos."""

    def __init__(
        self, spec: ReferenceSheetSpec, references: References, rig: Rig, open_files: ExitStack
    ) -> None:
        self._spec, self._references = spec, references
        self._takes = _takes(spec.takes, references)
        self._videos = {
            name: open_files.enter_context(open_video(take.video.file, take.video.rate))
            for name, take in self._takes.items()
            if take.video is not None
        }
        self._images = read_pair_notes(spec.references)
        self._deformer, self._renderer = Deformer(rig), FaceRenderer(rig.meshes, paper=spec.paper)
        self.stand_in_eyes = self._renderer.has_stand_in_eyes
        self._normals = SculptedNormals(rig, self._deformer)
        self._camera = frame_rig(rig.meshes, yaw_degrees=facing_degrees(rig), hair=True)
        self._weights = columns_by_name(references.weights, references.shape_names, rig.shapes)
        self._cloud: MarkersFrame | None = None
        if not references.marker_names:
            return
        self._cloud = frame_markers(references.markers)
        rigid = tuple(references.marker_names.index(name) for name in references.rigid)
        equation = placed_equation(
            stored_placement(references, rig),
            rig,
            self._deformer,
            PerformerMarkers(
                neutral=references.neutral,
                positions=references.markers,
                visible=np.ones(references.markers.shape[:2], dtype=np.bool_),
                rigid=rigid,
                labels=references.marker_names,
            ),
        )
        self._lines = lines_on_rig(references.marker_names, equation, self._deformer, rig.shapes)
        self._residual_mm = equation.residual_mm(references.markers, self._weights, without=rigid)

    def row(self, pair: int) -> ReferenceRow:
        """Draw one pair."""
        references, tile = self._references, self._spec.tile
        name, frame = references.takes[pair], int(references.frames[pair])
        take = self._takes.get(name)
        picture, missing = picture_at_frame(take, self._videos.get(name), frame)
        if picture is None:
            image = self._images[pair].image
            with suppress(InputError):  # stored by `select`, it may be gone
                picture = None if image is None else read_picture(image)
        markers, residual_mm = None, None
        if self._cloud is not None:
            size = {"width": tile, "height": tile}
            markers = draw_markers(
                references.markers[pair], **size, frame=self._cloud, lines=self._lines
            )
            if not references.tuned[pair]:  # the residual of a correct key may be larger
                residual_mm = float(self._residual_mm[pair])
        timecode = ""
        if take is not None:
            timecode = shift_timecode(take.timecode_start, frame - take.first_frame, take.rate)
        return ReferenceRow(
            number=pair + 1,
            place="  ".join(part for part in (name, f"frame {frame}", timecode) if part),
            spoken=_labels(references, pair),
            tuned=bool(references.tuned[pair]),
            video=picture,
            missing=missing,
            markers=markers,
            face=self._face(pair),
            weights=_strongest(references, pair),
            residual_mm=residual_mm,
        )

    def _face(self, pair: int) -> ByteImage:
        weights = self._weights[pair]
        return self._renderer.render(
            self._deformer.points(weights[None])[0],
            camera=self._camera,
            width=self._spec.tile,
            height=self._spec.tile,
            quality=self._spec.quality,
            sculpted=self._normals.at(weights),
        )


def _takes(files: tuple[Path, ...], references: References) -> dict[str, Take]:
    found = {take.name: take for take in map(read_first_frame, files)}
    unknown = [name for name in found if name not in references.takes]
    if unknown:
        raise InputError(
            f"no pair is of take {unknown[0]!r}; give the takes that the references were selected "
            f"from, {', '.join(sorted(set(references.takes)))}"
        )
    return found


def _pairs(spec: ReferenceSheetSpec, references: References) -> list[int]:
    limits = frame_range(spec.pairs) or (1, len(references.frames))
    last = min(limits[1], len(references.frames))
    pairs = [pair - 1 for pair in range(max(limits[0], 1), last + 1)]
    if not pairs:
        raise InputError(
            f"{spec.references}: has pairs 1-{len(references.frames)}; --pairs {spec.pairs} are "
            "none of them"
        )
    return pairs


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
        if abs(weights[i]) >= _LEAST_SHOWN_WEIGHT
    )
