"""Contents of a contact sheet: shots, scores, chosen frames and columns."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.spatial import KDTree

from usdface.core.arrays import FloatArray
from usdface.core.errors import InputError
from usdface.core.progress import Progress
from usdface.media.picture.sheet import Tile
from usdface.model.review.moments import ReviewSignals
from usdface.model.review.verdict import SolveVerdict, judge_solve
from usdface.model.selection.baseline import BlendshapeEquation
from usdface.runner.origin import check_same_take
from usdface.specs.paths import frame_list
from usdface.specs.review import FramePick, SheetLayout, SheetSpec
from usdface.steps.inputs.phone_labels import labels_at
from usdface.steps.review.head_turn import with_video_head_turn
from usdface.steps.review.pictures import ShotPictures
from usdface.steps.review.scoring import (
    ChosenFrame,
    Score,
    ShotMetric,
    choose_frames,
    range_mm,
    read_keys,
    score,
    set_up_shot_baseline,
    solve_baseline,
    surface_distance,
)
from usdface.steps.review.shot import Shot, open_shot, version_labels

PICKS: dict[SheetLayout, FramePick] = {
    "comparison": "expression",
    "worst": "review",
    "strip": "even",
    "characters": "expression",
}
STRIP_ROWS, STRIP_TILE = 48, 192
OTHER_ROWS, OTHER_TILE = 12, 320

_BLENDED_SHARE = 1 / 200
"""[of a face's points] Nearest points whose uncertainty is averaged: 4 mm on an adult's face."""


@dataclass(frozen=True)
class SheetComparison:
    """Shots, their weights with errors, and the chosen frames."""

    shots: list[Shot]
    """The performance, then those of --also."""
    metric: ShotMetric
    """Of the first shot."""
    signals: ReviewSignals
    """Of the first shot."""
    equation: BlendshapeEquation | None
    """None for a take without markers."""
    truth: FloatArray | None
    """(frames, shapes): the keys; NaN at frames without keys."""
    scores: list[Score]
    chosen: list[ChosenFrame]
    """Rows of the sheet."""
    labels: tuple[str, ...]
    """Phone and viseme of each chosen frame; empty if unknown."""
    verdicts: dict[str, SolveVerdict]
    """By label of the performance."""
    notes: tuple[str, ...]
    """On the keys."""

    @property
    def known_scores(self) -> list[Score]:
        """Scores with an error or an uncertainty."""
        return [each for each in self.scores if np.isfinite(each.error_mm).any()]

    @cached_property
    def unseen_mm(self) -> dict[str, float]:
        """Errors of gaze and tongue against the keys; empty without keys."""
        if self.truth is None:
            return {}
        return self.metric.skin.excluded_mm(self.shots[0].weights, self.truth)


@dataclass(frozen=True)
class SheetColumn:
    """Heading of a column, and the function that draws a row of it."""

    head: str
    draw: Callable[[int], Tile]


def compare_shots(spec: SheetSpec, shots: list[Shot], progress: Progress) -> SheetComparison:
    """Measure the weights of the shots and choose frames."""
    shot = shots[0]
    progress(0.1, "placing the markers on the rig")
    equation = None if shot.take.markers is None else set_up_shot_baseline(shot)
    metric = ShotMetric(shot)
    notes: list[str] = []
    truth = read_keys(spec.against, shot, spec.weight_unit, notes)
    signals = metric.signals(truth, equation)
    chosen = _choose(spec, shot, signals)
    rows = [frame.row for frame in chosen]
    scores = [score("solve", shot, shot.weights, truth)]
    if equation is not None and spec.baseline and spec.layout in ("comparison", "worst"):
        shown, keyed = np.array(rows, np.int64), truth is not None
        solved = solve_baseline(equation, shot, shown, curve=keyed)
        scores.insert(0, score("baseline", shot, solved, truth))
    others = [each.performance_file for each in shots[1:]]
    labels = version_labels(others, taken={"baseline", "solve"})
    verdicts = {"solve": judge_solve(signals.evidence)}
    for other, label in zip(shots[1:], labels, strict=True):
        known = truth if _same_face(other, shot) else None
        scores.append(score(label, other, other.weights, known))
        verdicts[label] = judge_solve(ShotMetric(other).evidence(known))
    spoken = labels_at(spec.phones, shot.take, shot.frames[rows])
    return SheetComparison(
        shots, metric, signals, equation, truth, scores, chosen, spoken, verdicts, tuple(notes)
    )


def open_shots(spec: SheetSpec) -> list[Shot]:
    """Open every performance over the common frames."""
    check_same_take(spec.performance, spec.take, spec.also)
    files = (spec.performance, *spec.also)
    listed = frame_list(spec.frames)
    limits = spec.frames if listed is None else None
    shots = [
        with_video_head_turn(
            open_shot(file, spec.take, frames=limits, video=spec.video), spec.camera
        )
        for file in files
    ]
    first = max(int(shot.frames[0]) for shot in shots)
    last = min(int(shot.frames[-1]) for shot in shots)
    if last < first:
        raise InputError(
            f"{', '.join(map(str, files))}: have no common frame of {shots[0].take.name}; leave "
            "one of them out of --also"
        )
    if listed is not None and (listed[0] < first or listed[-1] > last):
        raise InputError(
            f"{spec.performance}: some of --frames {spec.frames} are outside {first}-{last}; leave "
            "them out"
        )
    return [
        replace(
            shot,
            frames=shot.frames[(shot.frames >= first) & (shot.frames <= last)],
            weights=shot.weights[(shot.frames >= first) & (shot.frames <= last)],
        )
        for shot in shots
    ]


def _same_face(shot: Shot, other: Shot) -> bool:
    """Whether both shots have the same rig, face and shapes, which variants may change."""
    faces = [(each.rig.file.resolve(), each.rig.prim, each.rig.shapes) for each in (shot, other)]
    return faces[0] == faces[1]


def _choose(spec: SheetSpec, shot: Shot, signals: ReviewSignals) -> list[ChosenFrame]:
    given = frame_list(spec.frames)
    if given is not None:
        rows = np.searchsorted(shot.frames, given)
        return [ChosenFrame(int(row)) for row in np.unique(rows)]
    return choose_frames(
        spec.pick or PICKS[spec.layout],
        spec.rows or (STRIP_ROWS if spec.layout == "strip" else OTHER_ROWS),
        strength=surface_distance(shot, shot.weights),
        signals=signals,
        rate=float(shot.take.rate),
    )


def sheet_columns(
    spec: SheetSpec, comparison: SheetComparison, pictures: list[ShotPictures]
) -> list[SheetColumn]:
    """Return the columns of the layout."""
    shot, drawn = comparison.shots[0], pictures[0]
    columns: list[SheetColumn] = []
    if shot.take.video is not None:
        columns.append(SheetColumn("video", lambda row: drawn.video(int(shot.frames[row]))))
    equation = comparison.equation
    if spec.layout != "strip" and equation is not None:
        columns.append(
            SheetColumn("markers", lambda row: Tile(drawn.markers_on_face(row, equation)))
        )
    others = iter(pictures[1:])
    for each in comparison.scores:
        face = drawn if each.label in ("baseline", "solve") else next(others)
        columns.append(SheetColumn(each.label, _face(face, each)))
    if spec.difference and spec.layout in ("comparison", "worst"):
        if comparison.truth is not None:
            columns.append(SheetColumn("error", _errors(drawn, comparison)))
        elif comparison.signals.evidence.uncertainty_mm is not None:
            columns.append(SheetColumn("uncertainty", _uncertainties(drawn, comparison)))
    return columns


def _face(pictures: ShotPictures, judged: Score) -> Callable[[int], Tile]:
    def draw(row: int) -> Tile:
        error = float(judged.error_mm[row])
        value = None if np.isnan(error) else error
        return Tile(pictures.face(row, judged.weights[row]), value=value)

    return draw


def _errors(pictures: ShotPictures, comparison: SheetComparison) -> Callable[[int], Tile]:
    """Return a function that paints the error of the skin, with gaze and tongue of the keys."""
    shot, truth = comparison.shots[0], comparison.truth
    high = range_mm(comparison.signals.evidence, keyed=True)

    def draw(row: int) -> Tile:
        if truth is None or np.isnan(truth[row]).any():
            return Tile(None, caption="no keys here")
        weights = shot.weights[row].copy()
        excluded = comparison.metric.skin.excluded
        weights[excluded] = truth[row, excluded]
        solved, keyed = (shot.deformer.points(w[None])[0] for w in (weights, truth[row]))
        error = np.linalg.norm(solved - keyed, axis=-1)
        picture = pictures.painted(row, weights, error, high=high)
        return Tile(picture, caption=f"max {error.max():.1f} mm")

    return draw


def _uncertainties(pictures: ShotPictures, comparison: SheetComparison) -> Callable[[int], Tile]:
    """Return a function that paints the uncertainty of each region, blended at the borders."""
    shot, evidence = comparison.shots[0], comparison.signals.evidence
    neutral, regions = shot.deformer.neutral, comparison.metric.skin.points
    region_of = np.full(len(neutral), -1)
    for number, name in enumerate(evidence.regions[1:]):
        region_of[regions.get(name, [])] = number
    owned = np.flatnonzero(region_of >= 0)
    near = owned[:, None]
    if len(owned):
        count = max(round(_BLENDED_SHARE * len(owned)), 1)
        near = owned[KDTree(neutral[owned]).query(neutral[owned], k=[*range(1, count + 1)])[1]]

    def draw(row: int) -> Tile:
        if evidence.uncertainty_mm is None:
            return Tile(None)
        values = np.full(len(neutral), np.nan)  # unknown outside of regions
        values[owned] = evidence.uncertainty_mm[row, 1 + region_of[near]].mean(axis=1)
        picture = pictures.painted(
            row, shot.weights[row], values, high=range_mm(evidence, keyed=False)
        )
        coverage = evidence.coverage
        caption = "" if coverage is None else f"coverage {coverage[row, 0]:.0%}"
        return Tile(picture, caption=caption)

    return draw
