"""Measure the round-trip error of each retargeting method on a performance."""

from functools import partial
from pathlib import Path

import numpy as np

from usdface.core.arrays import ByteImage, FloatArray, columns_by_name
from usdface.core.assets import Rig
from usdface.core.controls import ExpressionPairs
from usdface.core.deformer import Deformer
from usdface.core.errors import InputError
from usdface.core.progress import Progress
from usdface.core.provenance import Provenance
from usdface.media.charts.motion_curves import FIGURE_WIDTH, Curve, Panel, draw_motion_curves
from usdface.media.face.camera import frame_rig
from usdface.media.face.render import FaceRenderer
from usdface.media.picture.canvas import new_picture
from usdface.media.picture.color import BRIGHT, PAGE, SERIES_COLORS, SOFT
from usdface.media.picture.image import write_measurements
from usdface.media.picture.text import TextStyle, draw_text
from usdface.model.placement.rig_orientation import facing_degrees
from usdface.model.regressions import find_retarget_method
from usdface.model.retarget.control_space import check_pairs
from usdface.model.retarget.cyclic import (
    KEYED_HYBRID,
    POSITION_MATCHING,
    CyclicError,
    CyclicVariant,
    evaluate_cyclic,
)
from usdface.runner.result import StepResult
from usdface.specs.paths import frame_range
from usdface.specs.retarget import METHODS, CyclicSpec
from usdface.steps.inputs.alpha_keys import read_alpha
from usdface.steps.inputs.source_motion import SourceMotion, read_source_motion, source_columns
from usdface.steps.inputs.weight_tables import read_weight_table
from usdface.steps.retarget.train import pair_notes, target_ranges
from usdface.usdio.retarget.pairs import read_pairs
from usdface.usdio.rig.read import read_rig

_FACES_MARGIN, _FACES_TEXT, _LARGEST_FACE = 36, 30, 320
"""Layout of the row of faces below the curves [pixels]."""
_FACES_HEAD = TextStyle(size=18, color=BRIGHT, weight="bold")
_FACES_LABEL = TextStyle(size=16, color=SOFT)

_NO_ERROR_MM = 0.005
"""Round-trip error that rounds to 0.00 mm."""


def run(spec: CyclicSpec, *, provenance: Provenance, progress: Progress) -> StepResult:
    """Measure every method and write figures and curves."""
    for method in spec.methods:
        if method not in ("auto", POSITION_MATCHING):
            find_retarget_method(method)
    pairs = read_pairs(spec.pairs)
    check_pairs(pairs, str(spec.pairs))
    source_rig = _rig(spec, pairs.source_rig, pairs.source_prim, "source")
    source_rig.check_has(pairs.source_shapes, source=spec.pairs, remedy="propose pairs again")
    target_rig = _rig(spec, pairs.target_rig, pairs.target_prim, "target")
    motion = read_source_motion(spec.source, frame_range(spec.frames))
    weights, source_notes = source_columns(spec.source, motion, pairs.source_shapes)
    picks = np.arange(0, len(weights), spec.every)
    alpha = None
    if spec.alpha is not None:
        frames = picks + motion.first_frame
        alpha = read_alpha(spec.alpha, frames, rate=motion.rate, whole=spec.frames is None)
    variant = CyclicVariant(
        truth=None if spec.truth is None else _truth(spec, spec.truth, motion, picks, pairs),
        alpha=alpha,
        published=spec.published,
    )
    measure = partial(
        evaluate_cyclic,
        pairs,
        weights[picks],
        rig=source_rig,
        target_rig=target_rig,
        shape_ranges=target_ranges(pairs),
        variant=variant,
    )
    methods = tuple(method for method in spec.methods if method != POSITION_MATCHING)
    if spec.alpha is not None:
        methods += (KEYED_HYBRID,)
    found = measure(methods=methods, progress=progress)
    notes = [*source_notes, *pair_notes(pairs)]
    if POSITION_MATCHING in spec.methods:
        try:
            found += measure(methods=(POSITION_MATCHING,))
        except InputError as error:
            if spec.methods != METHODS:  # given explicitly
                raise
            notes.append(f"positions were not matched: {error}")
    figures = _figures(spec, found, picks + motion.first_frame)
    source_weights = columns_by_name(weights[picks], pairs.source_shapes, source_rig.shapes)
    write_measurements(
        spec.out,
        {"pairs": str(spec.pairs), **figures},
        lambda: _draw(spec, found, motion.first_frame, source_rig, source_weights),
        metadata=provenance.metadata,
    )
    best = _least(found)
    return StepResult(
        spec.out,
        f"{len(picks)} frames, round trip; least error {best.mean_vertex_mm.mean():.3f} mm with "
        f"{best.method}",
        tuple(notes),
        figures,
        table=tuple(_line(each) for each in found),
    )


def _rig(spec: CyclicSpec, file: Path | None, prim: str, side: str) -> Rig:
    if file is None:
        raise InputError(
            f"{spec.pairs}: has no {side} rig, which errors in mm need; propose pairs from a rig "
            "instead of weights (`usdface pairs propose --source RIG --target RIG`)"
        )
    if not file.is_file():
        raise InputError(
            f"{spec.pairs}: its {side} rig, {file}, which errors in mm need, is gone; put it back"
        )
    return read_rig(file, prim=prim)


def _truth(
    spec: CyclicSpec, path: Path, motion: SourceMotion, picks: np.ndarray, pairs: ExpressionPairs
) -> FloatArray:
    given = read_weight_table(path, known=pairs.target.shapes, unit=spec.weight_unit)
    given.check_rate(motion.rate, file=path, performance=spec.source)
    table, _ = given.by_meaning(pairs.target.shapes)
    table.shapes_among(pairs.target.shapes, file=path, owner="of the pairs' target")
    frames = picks + motion.first_frame
    truth = table.at_frames(frames, pairs.target.shapes)
    missing = frames[np.isnan(truth).any(axis=1)]
    if len(missing):
        raise InputError(
            f"{path}: has no weights at {len(missing)} of the frames to measure, the first "
            f"{missing[0]}; narrow --frames"
        )
    return truth


def _least(found: tuple[CyclicError, ...]) -> CyclicError:
    return min(found, key=lambda each: float(each.mean_vertex_mm.mean()))


def _line(each: CyclicError) -> str:
    errors = each.mean_vertex_mm
    line = (
        f"{each.method}: {errors.mean():.4f} mm, 95th percentile {np.percentile(errors, 95):.4f} mm"
    )
    if each.direct_mm is not None:
        line += f"; direct {each.direct_mm.mean():.4f} mm"
    return line + (f" ({each.settings})" if each.settings else "")


def _figures(
    spec: CyclicSpec, found: tuple[CyclicError, ...], frames: np.ndarray
) -> dict[str, object]:
    return {
        "frames": [int(frames[0]), int(frames[-1])],
        "every": spec.every,
        "methods": {
            each.method: {
                "settings": each.settings,
                "mean_mm": float(each.mean_vertex_mm.mean()),
                "p95_mm": float(np.percentile(each.mean_vertex_mm, 95)),
                "worst_frame": int(frames[each.mean_vertex_mm.argmax()]),
            }
            | ({} if each.direct_mm is None else {"direct_mm": float(each.direct_mm.mean())})
            for each in found
        },
    }


def _draw(
    spec: CyclicSpec,
    found: tuple[CyclicError, ...],
    first_frame: int,
    rig: Rig,
    weights: FloatArray,
) -> ByteImage:
    """Draw the curves, and below them the source's face and each round trip."""
    best = _least(found)
    facts: tuple[str, ...] = (
        f"least error {best.mean_vertex_mm.mean():.2f} mm with {best.method}",
    )
    if best.mean_vertex_mm.mean() < _NO_ERROR_MM and best.direct_mm is None:
        facts += ("an invertible map has no round-trip error: measure it against --truth",)
    curves = draw_motion_curves(
        f"{spec.source.stem}: round trip by {spec.pairs.stem}",
        facts,
        _panels(found),
        first_frame=first_frame,
        step=spec.every,
        from_zero=True,
    )
    return np.concatenate([curves, _draw_returned(found, rig, weights, first_frame, spec.every)])


def _draw_returned(
    found: tuple[CyclicError, ...], rig: Rig, weights: FloatArray, first_frame: int, step: int
) -> ByteImage:
    """Draw the source's face and each round trip at the frame of the largest mean error."""
    at = int(np.mean([each.mean_vertex_mm for each in found], axis=0).argmax())
    faces = [("source", weights[at])]
    faces += [
        (f"{each.method} {each.mean_vertex_mm[at]:.2f} mm", each.returned[at]) for each in found
    ]
    gap, margin = 12, _FACES_MARGIN
    tile = min((FIGURE_WIDTH - 2 * margin) // len(faces) - gap, _LARGEST_FACE)
    page = new_picture(FIGURE_WIDTH, tile + 2 * _FACES_TEXT + margin, PAGE)
    frame = first_frame + step * at
    draw_text(page, f"frame {frame}: largest error", x=margin, y=0, style=_FACES_HEAD)
    renderer = FaceRenderer(rig.meshes)
    camera = frame_rig(rig.meshes, yaw_degrees=facing_degrees(rig), hair=True)
    deformer = Deformer(rig)
    for number, (label, face_weights) in enumerate(faces):
        x = margin + number * (tile + gap)
        draw_text(page, label, x=x, y=_FACES_TEXT, style=_FACES_LABEL, max_width=tile)
        points = deformer.points(face_weights[None])[0]
        face = renderer.render(points, camera=camera, width=tile, height=tile)
        page[2 * _FACES_TEXT : 2 * _FACES_TEXT + tile, x : x + tile] = face
    return page


def _panels(found: tuple[CyclicError, ...]) -> tuple[Panel, ...]:
    """Return a plot of all round-trip errors, and with --truth one of direct errors."""
    colors = [SERIES_COLORS[index % len(SERIES_COLORS)] for index in range(len(found))]

    def curves(values: list[FloatArray]) -> tuple[Curve, ...]:
        drawn = [
            Curve(f"{each.method} {value.mean():.2f} mm", value, color)
            for each, value, color in zip(found, values, colors, strict=True)
        ]
        return tuple(sorted(drawn, key=lambda each: -float(each.values.mean())))

    unit = "mean distance of the surface's points, mm"
    panels = [Panel("source to target to source", unit, curves([e.mean_vertex_mm for e in found]))]
    direct = [each.direct_mm for each in found if each.direct_mm is not None]
    if len(direct) == len(found):
        panels.append(Panel("target against keys", unit, curves(direct)))
    return tuple(panels)
