"""Choose reference frames and propose weights for them."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from usdface.assets import BoolArray, FloatArray, IntArray, Mapping, MotionSpace, References, Rig
from usdface.deformer import Deformer
from usdface.errors import InputError
from usdface.media.image import write_image
from usdface.model.equation import BlendshapeEquation, set_up_equation
from usdface.model.lip_contact import find_lips, keep_lip_contact
from usdface.model.motion import fit_motion_space
from usdface.model.selection import (
    Choice,
    StandIns,
    choose_by_design,
    choose_next,
    choose_visemes,
    in_order_of_worth,
)
from usdface.model.selection_space import SelectionSpace, selection_space
from usdface.numerics.regression.linear_ridge import fit_linear_ridge
from usdface.progress import Progress, silent
from usdface.provenance import Provenance
from usdface.specs.base import frame_range
from usdface.specs.references import SelectSpec, proposed_path, tuned_path
from usdface.steps.cleaned_takes import CleanedTakes, read_cleaned_takes
from usdface.steps.conflict_notes import tuned_conflicts
from usdface.steps.coverage_report import cover, coverage_figures, coverage_picture
from usdface.steps.kept_pairs import KeptPair, find_kept_pairs, rows_in_place
from usdface.steps.mapped_rows import MappedRows, mapped_rows
from usdface.steps.outputs import provenance_metadata
from usdface.steps.report import Report
from usdface.steps.spoken_frames import Spoken, read_spoken
from usdface.usdio.mapping import read_mapping
from usdface.usdio.references import write_references
from usdface.usdio.rig import read_rig

USABLE_SHARE = 0.9
"""A frame with fewer markers than this is no example to learn from."""

MOTION_FRAMES = 120_000
"""Frames from which the space of the motion is measured."""

FEWEST_TUNED = 2
"""Tuned pairs from which one can learn where a mapping errs."""


@dataclass(frozen=True)
class _Scene:
    """All that choosing looks at."""

    spec: SelectSpec
    takes: CleanedTakes
    rig: Rig
    deformer: Deformer
    motion: MotionSpace
    equation: BlendshapeEquation
    space: SelectionSpace
    features: FloatArray
    stand_ins: StandIns
    spoken: Spoken
    kept: list[KeptPair]
    candidates: BoolArray

    @property
    def already(self) -> IntArray:
        """Rows of the tuned pairs."""
        return np.array([each.row for each in self.kept], dtype=np.int64)

    @property
    def wanted(self) -> int:
        """How many pairs are to be found."""
        return self.spec.count - len(self.kept)


def run(
    spec: SelectSpec, *, provenance: Provenance | None = None, progress: Progress = silent
) -> Report:
    """Choose pairs, propose weights to start from, write the asset and draw its coverage."""
    progress(0.0, "reading the takes")
    takes = read_cleaned_takes(spec.takes)
    rig = read_rig(spec.rig, prim=spec.prim)
    spoken = read_spoken(spec, takes)
    kept = find_kept_pairs(spec, takes, rig)
    mapping = None if spec.mapping is None else _mapping_for(spec, rig)
    scene = _set_up(spec, takes, rig, spoken, kept, progress)
    progress(0.5, "choosing frames")
    mapped = None if mapping is None else mapped_rows(mapping, takes)
    choice = _choose(scene, mapped)
    rows = np.array(rows_in_place(spec.count, kept, choice.rows), dtype=np.int64)
    progress(0.7, "proposing weights")
    weights = _propose(scene, mapped, rows)
    references = _references(scene, choice, rows, weights)
    progress(0.85, f"writing {spec.out.name}")
    write_references(
        spec.out,
        references,
        rig,
        tuned_path=tuned_path(spec.out),
        proposed_path=proposed_path(spec.out),
        provenance=provenance,
    )
    progress(0.9, "measuring the coverage")
    covered = cover(scene.space, scene.features, rows, candidates=scene.candidates)
    write_image(
        spec.picture_path(),
        coverage_picture(covered, takes, rows, tuned=scene.already, title=spec.out.stem),
        metadata={} if provenance is None else provenance_metadata(provenance),
    )
    progress(1.0, "done")
    contradictions, conflicts = tuned_conflicts(spec.out)
    outputs = (spec.out, proposed_path(spec.out), tuned_path(spec.out), spec.picture_path())
    summary = (
        f"{len(rows)} pairs of {len(takes.frames)} frames, {len(rig.shapes)} shapes proposed; "
        f"they cover {covered.coverage.share:.0%} of the takes"
    )
    figures: dict[str, object] = {
        "pairs": len(rows),
        "frames": [int(takes.frames[row]) for row in rows],
        "takes": [takes.takes[row] for row in rows],
        "kept": len(kept),
        "conflicts": conflicts,
        "design": choice.design,
        "measured_mm": {name: round(mm, 4) for name, mm in choice.measured_mm.items()},
        "visemes": list(references.visemes),
        "emotions": list(references.emotions),
        **coverage_figures(covered, takes),
    }
    notes = (*_notes(scene, choice, mapping), *contradictions)
    return Report(outputs, summary, notes, figures)


def _mapping_for(spec: SelectSpec, rig: Rig) -> Mapping:
    """Read a mapping that is to say something of this rig.

    Raises
    ------
    InputError
        If it was trained for another rig.
    """
    if spec.mapping is None:
        raise InputError("no mapping is given")
    mapping = read_mapping(spec.mapping)
    strange = [name for name in mapping.shape_names if name not in rig.shapes]
    if strange:
        raise InputError(
            f"{spec.mapping}: was trained for another rig: {len(strange)} of its "
            f"{len(mapping.shape_names)} shapes are not on {rig.file} "
            f"({', '.join(strange[:3])}); give the mapping of this rig"
        )
    return mapping


def _set_up(
    spec: SelectSpec,
    takes: CleanedTakes,
    rig: Rig,
    spoken: Spoken,
    kept: list[KeptPair],
    progress: Progress,
) -> _Scene:
    progress(0.2, "measuring the motion")
    candidates = _candidates(spec, takes)
    free = candidates.copy()
    free[[each.row for each in kept]] = False
    if int(free.sum()) < spec.count - len(kept):
        raise InputError(
            f"{spec.count} pairs are asked for and {int(free.sum()) + len(kept)} frames can be "
            "used; lower --count, widen --frames or give more takes"
        )
    # Of an hour every fourth frame says as much of how a face moves as all of them.
    step = -(-len(takes.frames) // MOTION_FRAMES)
    motion = fit_motion_space([clip[::step] for clip in takes.positions])
    progress(0.35, "placing the markers on the rig")
    deformer = Deformer(rig)
    equation = _equation(takes, rig, deformer)

    def stand_in(coordinates: FloatArray) -> FloatArray:
        packed = motion.mean + coordinates @ motion.components
        return equation.propose(packed.reshape(len(packed), -1, 3))

    weights = stand_in(motion.sample)
    space = selection_space(motion, weights, rig.shapes)
    stand_ins = StandIns(
        features=space.features(motion.sample),
        weights=weights,
        of_rows=lambda rows: stand_in(_coordinates(takes, motion, rows)),
        gram=deformer.shapes.gram(),
    )
    # Frames straight to features: a long recording's coordinates would be another large array.
    projection = motion.components.T @ space.projection
    offset = motion.mean @ projection + space.offset
    features = np.concatenate(
        [
            _in_blocks(clip, lambda part: part.reshape(len(part), -1) @ projection - offset)
            for clip in takes.positions
        ]
    )
    return _Scene(
        spec,
        takes,
        rig,
        deformer,
        motion,
        equation,
        space,
        features,
        stand_ins,
        spoken,
        kept,
        candidates,
    )


def _in_blocks(clip: np.ndarray, change: Callable[[FloatArray], FloatArray]) -> FloatArray:
    return np.concatenate(
        [change(clip[i : i + 8192].astype(np.float64)) for i in range(0, len(clip), 8192)]
    )


def _candidates(spec: SelectSpec, takes: CleanedTakes) -> BoolArray:
    usable = np.concatenate([each.mean(axis=1) for each in takes.usable])
    candidates: BoolArray = usable >= USABLE_SHARE
    limits = frame_range(spec.frames)
    if limits is not None:
        candidates &= (takes.frames >= limits[0]) & (takes.frames <= limits[1])
    return candidates


def _equation(takes: CleanedTakes, rig: Rig, deformer: Deformer) -> BlendshapeEquation:
    return set_up_equation(
        rig,
        deformer,
        neutral=takes.neutral,
        positions=np.concatenate(takes.positions)
        if len(takes.positions) > 1
        else takes.positions[0],
        visible=np.concatenate(takes.usable) if len(takes.usable) > 1 else takes.usable[0],
        rigid=tuple(takes.marker_names.index(name) for name in takes.rigid),
    )


def _positions(takes: CleanedTakes, rows: IntArray) -> FloatArray:
    """Return markers at rows of all takes, without putting the takes together."""
    starts = np.cumsum([0, *(len(clip) for clip in takes.positions)])
    index = np.searchsorted(starts, rows, side="right") - 1
    return np.array(
        [takes.positions[i][row - starts[i]] for i, row in zip(index, rows, strict=True)],
        dtype=np.float64,
    ).reshape(len(rows), len(takes.marker_names), 3)


def _coordinates(takes: CleanedTakes, motion: MotionSpace, rows: IntArray) -> FloatArray:
    packed = _positions(takes, rows).reshape(len(rows), -1)
    return np.asarray((packed - motion.mean) @ motion.components.T)


def _choose(scene: _Scene, mapped: MappedRows | None) -> Choice:
    """Choose the frames that are to be found, by the method asked for."""
    spec = scene.spec
    if spec.method == "active":
        return _choose_next(scene, mapped)
    spoken = Choice(np.zeros(0, dtype=np.int64))
    if scene.spoken.segments and spec.method in ("viseme", "both"):
        spoken = choose_visemes(
            scene.features,
            # With both, half of the pairs are left to design, whatever is spoken.
            scene.wanted if spec.method == "viseme" else scene.wanted // 2,
            segments=scene.spoken.segments,
            emotion_of=scene.spoken.emotion_of,
            extremes=spec.extremes if spec.method == "viseme" else 0,
            already=scene.already,
            candidates=scene.candidates,
        )
    rest = scene.wanted - len(spoken.rows)
    if not rest:
        return spoken
    designed = choose_by_design(
        scene.features,
        rest,
        already=np.concatenate([scene.already, spoken.rows]),
        candidates=scene.candidates,
        stand_ins=scene.stand_ins,
    )
    together = np.concatenate([spoken.rows, designed.rows])
    return replace(
        designed,
        rows=in_order_of_worth(scene.features, together, scene.already),
        visemes=spoken.visemes,
        missing=spoken.missing,
    )


def _choose_next(scene: _Scene, mapped: MappedRows | None) -> Choice:
    if mapped is None or len(scene.kept) < FEWEST_TUNED:
        raise InputError(
            f"{tuned_path(scene.spec.out)}: {len(scene.kept)} pairs are tuned, and active needs "
            f"at least {FEWEST_TUNED} to see what would help next; tune some, or choose --method "
            "design"
        )
    shapes = mapped.shape_names
    tuned = np.array([[each.tuned.weights.get(s, 0.0) for s in shapes] for each in scene.kept])
    line = fit_linear_ridge(_coordinates(scene.takes, scene.motion, scene.already), tuned)
    columns = [scene.rig.shapes.index(name) for name in shapes]
    gram = scene.stand_ins.gram[np.ix_(columns, columns)]

    def disagreement_mm(rows: IntArray) -> FloatArray:
        """Return how far the mapping is from a straight line through the same pairs: doubt."""
        coordinates = _coordinates(scene.takes, scene.motion, rows)
        straight = (coordinates - line.mean) @ line.coefficients + line.intercept
        error = mapped.weights(rows) - straight
        return np.asarray(np.sqrt(np.maximum(np.einsum("fs,st,ft->f", error, gram, error), 0.0)))

    return choose_next(
        scene.features,
        scene.wanted,
        already=scene.already,
        candidates=scene.candidates,
        expected_error=disagreement_mm,
    )


def _propose(scene: _Scene, mapped: MappedRows | None, rows: IntArray) -> FloatArray:
    """Return weights to start from: the mapping's where there is one, else the rig's geometry."""
    positions = _positions(scene.takes, rows)
    weights = scene.equation.propose(positions, visible=np.concatenate(scene.takes.usable)[rows])
    lips = find_lips(scene.equation, scene.deformer, scene.rig.shapes)
    if lips is not None:
        weights = keep_lip_contact(scene.equation, scene.deformer, lips, positions, weights)
    if mapped is not None:
        columns = [scene.rig.shapes.index(name) for name in mapped.shape_names]
        weights[:, columns] = mapped.weights(rows)
    return weights


def _references(scene: _Scene, choice: Choice, rows: IntArray, weights: FloatArray) -> References:
    takes, spoken = scene.takes, scene.spoken
    return References(
        marker_names=takes.marker_names,
        shape_names=scene.rig.shapes,
        markers=_positions(takes, rows),
        weights=weights,
        frames=takes.frames[rows],
        takes=tuple(takes.takes[row] for row in rows),
        tuned=np.zeros(len(rows), dtype=np.bool_),
        rigid=takes.rigid,
        neutral=takes.neutral,
        rig_file=scene.rig.file,
        rig_prim=scene.rig.prim,
        motion=scene.motion,
        visemes=tuple(choice.visemes.get(row, spoken.viseme_of[row]) for row in rows.tolist()),
        emotions=tuple(spoken.emotion_of[row] for row in rows.tolist()),
    )


def _notes(scene: _Scene, choice: Choice, mapping: Mapping | None) -> list[str]:
    notes = list(scene.spoken.notes)
    if scene.takes.dropped:
        notes.append(
            f"{len(scene.takes.dropped)} markers are not in every take and were left out: "
            f"{', '.join(scene.takes.dropped[:5])}"
        )
    if scene.kept:
        notes.append(f"{len(scene.kept)} tuned pairs were kept where they are")
    if choice.missing:
        shown = [f"{viseme} {emotion}".strip() for emotion, viseme in choice.missing]
        notes.append(
            f"{len(shown)} visemes are not spoken in every emotion: {', '.join(shown[:8])}"
        )
    if scene.spec.method == "viseme" and choice.design:
        spoken = len(choice.rows) - len([r for r in choice.rows if int(r) not in choice.visemes])
        notes.append(
            f"{spoken} frames are of visemes; the rest of {scene.spec.count} was chosen by design"
        )
    if scene.spec.method == "both" and not scene.spec.phones:
        notes.append(
            "no phones are given, so frames were chosen by design alone; that costs nothing in "
            "accuracy, but pairs carry no viseme"
        )
    if mapping is not None:
        notes.append("weights to start from are the mapping's own predictions")
    return notes
