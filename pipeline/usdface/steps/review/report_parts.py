"""Contents of a report's player: curves, markers, colours on the face, notes, commands."""

import os
import shlex
from pathlib import Path
from typing import Any

import numpy as np

from usdface.core.arrays import FloatArray, columns_by_name
from usdface.core.errors import InputError
from usdface.core.sidecars import notes_path
from usdface.core.text import first_few
from usdface.media.page.report_page import (
    PageCommands,
    PageHeat,
    PageMarkers,
    PageNotes,
    Strip,
    WeightCurves,
)
from usdface.model.review.moments import ReviewSignals
from usdface.model.selection.baseline import BlendshapeEquation
from usdface.runner.outputs import confine
from usdface.specs.notes import read_notes
from usdface.specs.review import ReportSpec
from usdface.steps.inputs.marker_lines import lines_on_rig
from usdface.steps.review.scoring import range_mm
from usdface.steps.review.shot import Shot, version_labels, weights_in_rig_order
from usdface.usdio.performance.read import PerformanceReader, performance_of
from usdface.usdio.references.read import read_references
from usdface.usdio.rig.read import read_rig


def page_curves(
    spec: ReportSpec, shot: Shot, truth: FloatArray | None, baseline: FloatArray | None
) -> tuple[WeightCurves, ...]:
    """Return all sets of weights; the first is the one that is published."""
    reader = PerformanceReader(shot.performance_file)
    kind = "edited" if reader.edits else "solve"
    curves = [WeightCurves(kind, shot.weights, kind)]
    if reader.edits:
        solved = reader.solved(int(shot.frames[0]), int(shot.frames[-1]))
        ordered = columns_by_name(solved, reader.names, shot.rig.shapes)
        curves.append(WeightCurves("solve", ordered))
    if truth is not None:
        curves.append(WeightCurves("keys", truth, "keys"))
    if baseline is not None:
        curves.append(WeightCurves("baseline", baseline, "baseline"))
    labels = version_labels(list(spec.also), taken={each.name for each in curves})
    for file, label in zip(spec.also, labels, strict=True):
        curves.append(WeightCurves(label, _version_weights(file, shot), "version"))
    return tuple(curves)


def _version_weights(file: Path, shot: Shot) -> FloatArray:
    """Return another performance's weights at a shot's frames; NaN outside its range."""
    reader = PerformanceReader(file)
    if reader.time_shift != PerformanceReader(shot.performance_file).time_shift:
        raise InputError(
            f"{file}: a layer moves its weights {reader.time_shift or 'by 0 frames'}, unlike those "
            f"of {shot.performance_file.name}; give the performance as mapped"
        )
    other = performance_of(reader)
    shapes = read_rig(other.rig_file, prim=other.rig_prim).shapes
    if set(shapes) != set(shot.rig.shapes):
        other_shapes = sorted(set(shapes) ^ set(shot.rig.shapes))
        raise InputError(
            f"{file}: is on a rig with other shapes ({first_few(other_shapes, most=3)}); --also "
            "takes performances on the same rig, `usdface faces` draws several characters"
        )
    clip = other.weights
    last = clip.first_frame + len(clip.values)
    inside = (shot.frames >= clip.first_frame) & (shot.frames < last)
    if not inside.any():
        raise InputError(
            f"{file}: has none of the frames {shot.frames[0]}-{shot.frames[-1]}; give performances "
            "of the same take"
        )
    weights = np.full((len(shot.frames), len(shot.rig.shapes)), np.nan)
    weights[inside] = weights_in_rig_order(other, shot.rig, shot.frames[inside])
    return weights


def page_strips(signals: ReviewSignals) -> tuple[Strip, ...]:
    """Return error, uncertainty and coverage over time, on the scales of all pictures."""
    evidence = signals.evidence
    strips = []
    if evidence.error_mm is not None:
        strips.append(
            Strip("error", evidence.error_mm[:, 0], 0.0, range_mm(evidence, keyed=True), "mm")
        )
    if evidence.uncertainty_mm is not None:
        shown = evidence.uncertainty_mm[:, 0]
        strips.append(Strip("uncertainty", shown, 0.0, range_mm(evidence, keyed=False), "mm"))
    if evidence.coverage is not None:
        strips.append(Strip("coverage", 100 * evidence.coverage[:, 0], 0.0, 100.0, "%"))
    return tuple(strips)


def page_markers(shot: Shot, equation: BlendshapeEquation) -> PageMarkers | None:
    """Return the markers on the character, without rigid ones."""
    markers = shot.markers
    shown = np.array([i for i, name in enumerate(markers.names) if name not in markers.rigid])
    if not len(shown):
        return None
    rows = shot.frames - shot.take.first_frame
    motion = equation.motion(shot.positions)[:, shown]
    known = markers.visible[rows] | (markers.confidence[rows] > 0)
    motion = np.where(known[:, shown, None], motion, np.nan)
    names = tuple(markers.names[i] for i in shown.tolist())
    rest = equation.virtual.places(shot.deformer.neutral)[shown]
    lines = lines_on_rig(markers.names, equation, shot.deformer, shot.rig.shapes)
    return PageMarkers(
        names,
        rest,
        motion,
        np.asarray(equation.keys.deltas)[:, shown],
        np.searchsorted(shown, lines[np.isin(lines, shown).all(axis=1)]),
    )


def page_motion(shot: Shot) -> FloatArray | None:
    """Return the transforms of joints and Xforms: (pictures, parts, 3, 4) [mm]."""
    if shot.motion is None:
        return None
    return np.stack([shot.motion.transforms(frame)[:, :3] for frame in shot.frames.tolist()])


def page_heat(signals: ReviewSignals, curves: tuple[WeightCurves, ...]) -> PageHeat | None:
    """Return the values painted on the face: the error against keys, else the uncertainty."""
    kinds = [curve.kind for curve in curves]
    evidence = signals.evidence
    if "keys" in kinds:
        high = range_mm(evidence, keyed=True)
        return PageHeat("error", high, against=kinds.index("keys"))
    if evidence.uncertainty_mm is None or evidence.uncertainty_mm.shape[1] < 2:
        return None
    regions = evidence.regions[1 : evidence.uncertainty_mm.shape[1]]
    high, values = range_mm(evidence, keyed=False), evidence.uncertainty_mm[:, 1:]
    return PageHeat("uncertainty", high, regions=regions, values=values)


def page_notes(spec: ReportSpec, shot: Shot) -> PageNotes:
    """Return the initial notes of the report, the latest version of each."""
    files = spec.notes
    default = notes_path(spec.performance)
    if not files and default.is_file():
        confine("report", reads=[default])
        files = (default,)
    latest = dict[str, dict[str, Any]]()
    for file in files:
        for note in read_notes(file).notes:
            known = latest.get(note.id)
            if known is None or note.made >= known.get("made", ""):
                latest[note.id] = note.model_dump(mode="json", exclude_unset=True)
    return PageNotes(
        performance=shot.performance_file.name,
        take=shot.take.name,
        version=PerformanceReader(shot.performance_file).version,
        file=default.name,
        notes=tuple(sorted(latest.values(), key=lambda note: int(note["frame"]))),
    )


def page_commands(spec: ReportSpec, shot: Shot, references: Path | None) -> PageCommands:
    """Return the command lines that add a frame to the references and tune it."""
    if references is None:
        return PageCommands()
    try:
        pairs = read_references(references)
    except InputError:  # reported with the coverage
        return PageCommands()
    folder = spec.out.resolve().parent
    files = (os.path.relpath(path.resolve(), folder) for path in (spec.performance, references))
    names = [shlex.quote(file.replace(os.sep, "/")) for file in files]
    return PageCommands(
        add=f"usdface references add {names[0]} --references {names[1]} --out {names[1]}",
        tune=f"usdface tune {names[1]}",
        pairs=tuple(
            frame
            for take, frame in zip(pairs.takes, pairs.frames.tolist(), strict=True)
            if take == shot.take.name
        ),
    )
