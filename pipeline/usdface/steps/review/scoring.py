"""Errors of weights over a shot's frames, and the choice of frames to review."""

from dataclasses import dataclass, replace
from functools import cached_property
from itertools import islice
from pathlib import Path

import numpy as np

from usdface.core.arrays import FloatArray, IntArray, spaced_rows
from usdface.core.assets import Rig, WeightsClip
from usdface.core.errors import InputError
from usdface.media.picture.color import KEYS_RANGE_MM, UNKEYED_RANGE_MM
from usdface.media.picture.error_strip import ErrorCurve
from usdface.model.mapping.evaluation import SkinMetric
from usdface.model.retarget.name_matching import meaning_notes
from usdface.model.review.moments import (
    MOMENT_SECONDS,
    Moment,
    ReviewSignals,
    region_distances,
    review_moments,
    surface_jumps,
)
from usdface.model.review.verdict import SolveEvidence
from usdface.model.selection.baseline import BlendshapeEquation, PerformerMarkers, proposed_weights
from usdface.model.selection.lip_contact import (
    CONTACT_MM,
    Lips,
    captured_gap_mm,
    find_lips,
    lip_gap_mm,
)
from usdface.specs.review import FramePick
from usdface.steps.inputs.placement import placed_equation, placement_of_performance
from usdface.steps.inputs.weight_tables import WeightTable, missing_shape_notes, read_weight_table
from usdface.steps.review.shot import Shot

_BASELINE_FRAMES = 20_000
"""Largest number of frames at which a long shot's baseline is solved, enough for a curve."""

_MEASURED_GAPS = 200
"""Largest number of frames whose lip distance is measured on the rig's surface."""


@dataclass(frozen=True)
class ShotMetric:
    """Distances of the skin of a shot's rig between sets of weights."""

    shot: Shot

    @cached_property
    def skin(self) -> SkinMetric:
        """Measure of the skin, without gaze and tongue."""
        return SkinMetric(self.shot.rig, self.shot.deformer)

    @property
    def regions(self) -> tuple[str, ...]:
        """Names of the regions that are measured."""
        return tuple(self.skin.points)

    def distances(self, weights: FloatArray, truth: FloatArray) -> FloatArray:
        """Return the distance of the skin from the keys': (frames, regions) [mm]."""
        return region_distances(self.skin.differences(weights, truth), self.skin.grams)

    def evidence(self, truth: FloatArray | None) -> SolveEvidence:
        """Return the evidence of the shot's verdict; errors against keys replace uncertainty."""
        evidence = self.shot.evidence()
        if truth is None:
            return evidence
        error_mm = self.distances(self.shot.weights, truth)
        covered = None if evidence.coverage is None else evidence.coverage[:, :1]
        return SolveEvidence(
            self.regions, error_mm=error_mm, coverage=covered, basis=evidence.basis
        )

    def signals(
        self, truth: FloatArray | None, equation: BlendshapeEquation | None = None
    ) -> ReviewSignals:
        """Return the signals by which frames are ranked; `equation` detects closed lips."""
        shot = self.shot
        keys = self.skin.differences(shot.weights, np.zeros_like(shot.weights))
        jumps = surface_jumps(keys, self.skin.grams)
        signals = ReviewSignals(self.evidence(truth), jumps, jump_regions=self.regions)
        if equation is None or truth is not None:
            return signals
        lips = find_lips(equation, shot.deformer, self.skin.parts)
        if lips is None:
            return signals
        on_lips = len(np.union1d(lips.pairs.upper, lips.pairs.lower))
        share = on_lips / len(shot.deformer.neutral)
        return replace(signals, gap_mm=lip_gaps(shot, equation, lips), lip_share=share)


def lip_gaps(shot: Shot, equation: BlendshapeEquation, lips: Lips) -> FloatArray:
    """Return the lip distance where the performer's lips are closed, else 0: (frames,) [mm]."""
    captured = captured_gap_mm(equation, lips, shot.positions)
    estimate = np.where(captured < CONTACT_MM, shot.weights[:, lips.columns] @ lips.opening, 0.0)
    rows = np.argsort(-estimate, kind="stable")[:_MEASURED_GAPS]
    rows = rows[estimate[rows] > CONTACT_MM]
    gaps = np.zeros(len(estimate))
    measured = lip_gap_mm(shot.deformer, lips, shot.weights[rows])
    expected = np.maximum(captured[rows], 0.0) + CONTACT_MM
    gaps[rows] = np.maximum(measured - expected, 0.0)
    return gaps


@dataclass(frozen=True)
class Score:
    """Weights over a shot's frames, and their error or uncertainty."""

    label: str
    weights: FloatArray
    """(frames, shapes): in the rig's order."""
    error_mm: FloatArray
    """(frames,): of the skin against the keys, else the uncertainty; NaN if unknown."""
    against_truth: bool = False
    """Whether the error is against keys."""


def set_up_shot_baseline(shot: Shot) -> BlendshapeEquation:
    """Return the blendshape equation of a shot's markers on its rig."""
    markers = shot.markers
    return placed_equation(
        placement_of_performance(shot.performance_file, shot.rig),
        shot.rig,
        shot.deformer,
        PerformerMarkers.of_take(markers, markers.positions[shot.neutral_row]),
    )


def solve_baseline(
    equation: BlendshapeEquation, shot: Shot, rows: IntArray, *, curve: bool = True
) -> FloatArray:
    """Solve the baseline of a shot, (frames, shapes).

    For a curve of a long shot, rows that are not shown repeat the weights of a row shortly before;
    without a curve, they are NaN.
    """
    positions = shot.positions
    step = -(-len(positions) // _BASELINE_FRAMES)
    if curve:
        some = proposed_weights(equation, positions[::step])
        weights = np.repeat(some, step, axis=0)[: len(positions)]
    else:
        weights = np.full_like(shot.weights, np.nan)
    if step > 1 or not curve:
        weights[rows] = equation.propose(positions[rows])
    return weights


def read_keys(
    file: Path | None, shot: Shot, unit: str | None, notes: list[str]
) -> FloatArray | None:
    """Return the keys at a shot's frames, (frames, shapes); NaN at frames missing from the file.

    Notes are appended; see `read_key_table`.
    """
    if file is None:
        return None
    table, key_notes = read_key_table(
        file,
        shot.rig,
        shot.performance.weights,
        unit=unit,
        take=shot.take.name,
        performance=shot.performance_file,
    )
    truth = table.at_frames(shot.frames, shot.rig.shapes)
    if np.isnan(truth).all():
        raise InputError(
            f"{file}: has none of the frames {shot.frames[0]}-{shot.frames[-1]}; give keys of this "
            "take"
        )
    notes += key_notes
    return truth


def read_key_table(
    file: Path, rig: Rig, solved: WeightsClip, *, unit: str | None, take: str, performance: Path
) -> tuple[WeightTable, list[str]]:
    """Read keys of a performance, its shapes matched to the rig's by meaning, and notes.

    Refuses keys at another rate than the performance's, and keys without a shape of the rig. Notes
    are on columns that are left out, and on shapes without one.
    """
    given = read_weight_table(file, known=rig.shapes, unit=unit, take=take)
    given.check_rate(solved.rate, file=file, performance=performance)
    table, transfer = given.by_meaning(rig.shapes, leave=rig.logic.driven)
    table.check_numbering(solved, columns=rig.shapes, file=file, performance=performance)
    table.shapes_among(rig.shapes, file=file, owner=f"on {rig.file}")
    known = {*transfer.matched, *rig.logic.driven}
    notes = [
        *meaning_notes(transfer),
        *given.notes(file, known, owner="on the rig"),
        *missing_shape_notes(file, table.names, [n for n in rig.shapes if n in solved.names]),
    ]
    return table, notes


def score(label: str, shot: Shot, weights: FloatArray, truth: FloatArray | None) -> Score:
    """Measure weights against keys; without keys, the shot's own weights have an uncertainty."""
    if truth is not None:
        error = ShotMetric(shot).distances(weights, truth)[:, 0]
        return Score(label, weights, error, against_truth=True)
    uncertainty = shot.face_uncertainty_mm()
    if uncertainty is None or weights is not shot.weights:
        uncertainty = np.full(len(weights), np.nan)
    return Score(label, weights, uncertainty)


def surface_distance(shot: Shot, difference: FloatArray) -> FloatArray:
    """Return the RMS displacement of the surface by weight differences, (frames,) [mm]."""
    squared = ((difference @ shot.deformer.shapes.gram()) * difference).sum(axis=1)
    return np.asarray(np.sqrt(np.maximum(squared, 0.0)))


def range_mm(evidence: SolveEvidence, *, keyed: bool) -> float:
    """Return the end of the colour scale: the same for all faces, in proportion to other rigs."""
    return float(f"{evidence.on_rig(KEYS_RANGE_MM if keyed else UNKEYED_RANGE_MM):.2g}")


def coverage_curves(shot: Shot) -> tuple[ErrorCurve, ...]:
    """Return 1 - coverage of each frame; empty if unknown."""
    coverage = shot.evidence().coverage
    if coverage is None:
        return ()
    return (ErrorCurve("1 − coverage", 100 * (1 - coverage[:, 0]), high=100.0, unit="%"),)


WORST_SHARE = 6
"""Among expressions, one frame in `WORST_SHARE` is a worst one, at least one of two."""


@dataclass(frozen=True)
class ChosenFrame:
    """A row of the shot, and the reason for its choice; empty for an expression."""

    row: int
    reason: str = ""


def choose_frames(
    pick: FramePick, count: int, *, strength: FloatArray, signals: ReviewSignals, rate: float
) -> list[ChosenFrame]:
    """Choose at most `count` frames, at a distance from each other, in order of time.

    `strength`: distance of the face from neutral. ``'expression'`` includes some worst frames.
    """
    frames, evidence = len(strength), signals.evidence
    count = min(count, frames)
    near = max(frames // (3 * count), 1)
    if pick == "even":
        spread = np.unique(np.linspace(0, frames - 1, count).round().astype(np.int64))
        return [ChosenFrame(row) for row in spread.tolist()]
    if pick == "review":
        moments = review_moments(signals, count, rate=rate)
        return sorted(map(_chosen_moment, moments), key=lambda frame: frame.row)
    if pick == "expression":
        worst = min(max(count // WORST_SHARE, 1), count - 1)
        error = np.nan_to_num(signals.score_mm, nan=-1.0)
        rows = _largest(error, worst, near)
        found = [
            _chosen_moment(signals.moment(row)) if error[row] > 0 else ChosenFrame(row)
            for row in rows
        ]
        left = np.setdiff1d(np.arange(frames), rows)
        apart = np.abs(left[:, None] - rows).min(axis=1, initial=frames)
        other = left[apart >= MOMENT_SECONDS * rate]
        left = other if len(other) >= count - worst else left
        found += map(ChosenFrame, _strongest(strength, left, count - worst, near))
    else:
        values, words = signals.jump_mm[:, 0], "moved"
        if pick == "uncertainty" and evidence.uncertainty_mm is not None:
            values, words = evidence.uncertainty_mm[:, 0], "uncertainty"
        elif pick == "residual" and evidence.residual_mm is not None:
            values, words = evidence.residual_mm[:, 0], "residual"
        rows = _largest(values, count, near)
        found = [ChosenFrame(row, f"{words} {values[row]:.2f} mm") for row in rows]
    return sorted(found, key=lambda frame: frame.row)


def _chosen_moment(moment: Moment) -> ChosenFrame:
    words = f"{moment.region}: {moment.reason}" if moment.region else moment.reason
    return ChosenFrame(moment.row, words)


def _strongest(strength: FloatArray, rows: IntArray, count: int, apart: int) -> list[int]:
    """Return the strongest row of each of `count` equal parts of some rows."""
    chosen: list[int] = []
    for stretch in np.array_split(rows, count):
        free = [row for row in stretch if all(abs(row - other) >= apart for other in chosen)]
        chosen.append(int(max(free or stretch, key=lambda row: strength[row])))
    return chosen


def _largest(values: FloatArray, count: int, apart: int) -> list[int]:
    """Return `count` rows by decreasing value, at least `apart` rows apart as far as possible."""
    order = np.argsort(-values, kind="stable")
    chosen = list(islice(spaced_rows(order, apart), count))
    return [*chosen, *order[~np.isin(order, chosen)].tolist()][:count]
