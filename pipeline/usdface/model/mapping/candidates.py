"""Compare candidates of a mapping on pairs that their fits have not seen."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from usdface.core.arrays import BoolArray, FloatArray, IntArray
from usdface.core.assets import CandidateScore, References
from usdface.core.errors import InputError
from usdface.core.progress import Progress
from usdface.model.mapping.corrected_pairs import (
    CorrectedPairs,
    correct_pairs,
    displacements,
    fit_pairs_forward,
)
from usdface.model.mapping.uncertainty import UncertaintyModel
from usdface.model.regressions import AUTO, Choices, Pairs, Regression, Settings, find_method
from usdface.model.regressions.base import bend, unbend
from usdface.model.regressions.frame_solve import VARIANCE_INFLATIONS, FrameSolver
from usdface.numerics.regression.cross_validation import (
    blocked_folds,
    surface_rms_mm,
    weight_rmse,
)

MINIMUM_TO_COMPARE = 8
"""Pairs below which cross-validation is chance: the first, simplest candidate is taken."""

OBSERVABLE_ERROR_SHARE = 0.9
"""Of a shape's variance: a mean squared error above it says that markers do not show the shape."""

_LEAST_T = 2.0
"""Student's t beyond which another method than the default is no chance: one in twenty."""

_STANDARD_ERROR_T = 1.0
"""The same of a method's own setting: the usual one is kept within a standard error of the best
(Breiman et al. 1984, the one-standard-error rule)."""

_NEIGHBOUR_SECONDS = 0.5
"""Pairs nearer are one moment: neither tells how the other would be predicted without it."""

_BLOCK_SECONDS = 2.0
"""Faces and their errors last about as long."""

_USUAL_RATE = 60.0
"""Frames per second, where references do not say theirs."""


@dataclass(frozen=True)
class Candidate:
    """A method and the settings to try it with."""

    method: Regression
    settings: Settings


@dataclass(frozen=True)
class UnseenPairs:
    """What a candidate makes of pairs that its fit has not seen."""

    errors: FloatArray
    """(pairs, shapes): of weights."""
    start: FloatArray
    """(pairs, shapes): bent weights, before the frames are solved."""
    usual: FloatArray | None
    """(pairs, shapes): the fits' own estimates of that start's error, normalised; None where it
    makes none."""


@dataclass(frozen=True)
class Comparison:
    """Candidates by error, the best first."""

    best: Candidate
    unseen: UnseenPairs | None
    """Of the best; None where pairs were too few to compare."""
    observable: BoolArray
    """(shapes,)"""
    scores: tuple[CandidateScore, ...]


class PairFolds:
    """Pairs in folds of other moments, with a forward model that has not seen each."""

    def __init__(self, corrected: CorrectedPairs, references: References) -> None:
        pairs, scales = corrected.pairs, corrected.forward.scales
        self.pairs, self.corrected = pairs, corrected
        frames, takes, rate = references.frames, references.takes, references.rate or _USUAL_RATE
        self.folds = blocked_folds(frames, takes, margin=round(_NEIGHBOUR_SECONDS * rate))
        self.blocks = time_blocks(frames, takes, length=max(round(_BLOCK_SECONDS * rate), 1))
        self.forwards = [fit_pairs_forward(pairs.rows(fold.train), scales) for fold in self.folds]
        self.targets = bend(pairs.face.normalise(pairs.outputs), scales.curve)
        self.curve = scales.curve

    def displacements(self, rows: IntArray) -> tuple[FloatArray, BoolArray]:
        """Return displacements [mm] and visibility of some pairs."""
        moved = displacements(self.pairs.rows(rows))
        return moved, np.ones(moved.shape[:2], dtype=np.bool_)

    def predict(self, candidate: Candidate) -> UnseenPairs:
        """Predict every pair by a fit that has not seen it."""
        face, method = self.pairs.face, candidate.method
        errors, start, usual = (np.full_like(self.pairs.outputs, np.nan) for _ in range(3))
        for fold, forward in zip(self.folds, self.forwards, strict=True):
            settings = dict(candidate.settings)
            if "dimensions" in settings:  # a fold may have too few pairs for what all of them carry
                most = max(len(fold.train) - 1, 1)
                settings["dimensions"] = min(int(settings["dimensions"]), most)
            known = self.corrected.known_to(method).rows(fold.train)
            fitted = method.fit(replace(known, forward=forward), settings)
            found = method.predict(fitted.arrays, fitted.settings, self.pairs.inputs[fold.test])
            start[fold.test] = bend(face.normalise(found), self.curve)
            errors[fold.test] = np.clip(found, *face.ranges.T) - self.corrected.given[fold.test]
            if method.solves_frames:
                usual[fold.test] = fitted.arrays["start_error"]
        if method.solves_frames:
            return self.solve(start, usual, self.corrected.common)
        return UnseenPairs(errors, start, None)

    def solve(self, start: FloatArray, usual: FloatArray, common: float) -> UnseenPairs:
        """Solve every pair as a frame; see `UnseenPairs` and `FrameSolver.common`."""
        low, span = self.pairs.face.ranges[:, 0], np.ptp(self.pairs.face.ranges, axis=1)
        errors = np.empty_like(start)
        for fold, forward in zip(self.folds, self.forwards, strict=True):
            solver = FrameSolver(forward, usual[fold.test[0]], common)
            t = solver.solve(*self.displacements(fold.test), start[fold.test]).targets
            found = low + span * np.clip(unbend(t, self.curve), 0.0, 1.0)
            errors[fold.test] = found - self.corrected.given[fold.test]
        return UnseenPairs(errors, start, usual)

    def deviations(
        self, candidate: Candidate, unseen: UnseenPairs, model: UncertaintyModel, error: FloatArray
    ) -> FloatArray:
        """Return the uncalibrated uncertainty of every pair: (pairs, regions) [mm]."""
        out = np.empty((len(unseen.start), len(model.grams)))
        for fold, forward in zip(self.folds, self.forwards, strict=True):
            own = error if unseen.usual is None else unseen.usual[fold.test[0]]
            solver = FrameSolver(forward, own, self.corrected.common)
            moved, visible = self.displacements(fold.test)
            bounded = candidate.method.solves_frames
            solution = solver.solve(moved, visible, unseen.start[fold.test], bounded=bounded)
            out[fold.test] = model.deviations(solver, solution, visible)
        return out


def list_candidates(pairs: Pairs, method: str, choices: Choices) -> list[Candidate]:
    """Return what to compare: every setting of a method, or of all that ``auto`` tries.

    Raises
    ------
    InputError
        If the method has no width, and one is asked for.
    """
    names = AUTO if method == "auto" else (method,)
    found = [
        Candidate(each, settings)
        for each in map(find_method, names)
        for settings in each.candidates(pairs, choices)
    ]
    if choices.widths and not any("width" in each.settings for each in found):
        raise InputError(f"{method} has no width to choose; leave it out, or train rbf or d06")
    return found


def compare_candidates(
    candidates: list[Candidate],
    folds: PairFolds,
    *,
    in_mm: bool,
    progress: Progress,
) -> Comparison:
    """Predict each pair by every candidate from pairs of other moments."""
    pairs, tried = folds.pairs, []
    for i, candidate in enumerate(candidates if len(pairs.outputs) >= MINIMUM_TO_COMPARE else []):
        progress(0.9 * i / len(candidates), f"cross-validating {candidate.method.name}")
        tried.append((folds.predict(candidate), candidate))
    observable = observable_shapes([unseen.errors for unseen, _ in tried], pairs.outputs)
    gram = pairs.face.gram if in_mm else None
    scored = [
        (_score(candidate, unseen.errors, observable, gram), candidate, unseen)
        for unseen, candidate in tried
    ]
    scored.sort(key=lambda entry: _order(entry[0]))
    best, unseen = candidates[0], None
    if scored:
        winner = scored[0]
        usual = next((each for each in scored if each[1].method.name == AUTO[0]), winner)
        errors = usual[2].errors, winner[2].errors
        if paired_t(*errors, pairs.face.gram, folds.blocks) <= _LEAST_T:
            winner = usual
        best, unseen = winner[1], winner[2]
    return Comparison(best, unseen, observable, tuple(score for score, _, _ in scored))


def choose_common_error(
    folds: PairFolds, compared: Comparison, references: References, gram: FloatArray | None
) -> tuple[PairFolds, Comparison]:
    """Let more markers count as one for as long as pairs not seen are predicted better by it.

    From the largest number of `VARIANCE_INFLATIONS`, that of landmarks, let fewer.

    Gaze counts as well: landmarks that a model finds show it, and err together there too. Keys are
    corrected anew, since they too are moved as far as markers are believed.

    Parameters
    ----------
    gram : (shapes, shapes) float array or None
        Of all shapes [mm^2]; None counts every weight alike.
    """
    every = folds.pairs.face.gram if gram is None else gram.astype(np.float64)
    best, usual, common = compared.best, compared.unseen, folds.corrected.common
    if usual is None or usual.usual is None:
        return folds, compared
    unseen = usual
    numbers = VARIANCE_INFLATIONS if common == VARIANCE_INFLATIONS[0] else VARIANCE_INFLATIONS[::-1]
    for other in numbers[1:]:
        found = folds.solve(usual.start, usual.usual, other)
        if paired_t(unseen.errors, found.errors, every, folds.blocks) <= _STANDARD_ERROR_T:
            break
        common, unseen = other, found
    if common == folds.corrected.common:
        return folds, compared
    parts = references.parts or references.shape_names
    corrected = correct_pairs(folds.corrected.as_given(), parts, common=common)
    chosen = PairFolds(corrected, references)
    unseen = chosen.predict(best)
    if paired_t(usual.errors, unseen.errors, every, folds.blocks) <= _STANDARD_ERROR_T:
        return folds, compared
    named = Candidate(best.method, best.settings | {"common_error": common})
    skin = None if np.isnan(compared.scores[0].vertex_rms_mm) else folds.pairs.face.gram
    score = _score(named, unseen.errors, compared.observable, skin)
    scores = tuple(sorted((score, *compared.scores), key=_order))
    return chosen, replace(compared, unseen=unseen, scores=scores)


def time_blocks(frames: IntArray, takes: Sequence[str], *, length: int) -> IntArray:
    """Return the number of the block of `length` frames that each pair is in: (pairs,)."""
    codes = np.unique(np.asarray(takes, dtype=str), return_inverse=True)[1]
    rows = np.column_stack([codes, np.asarray(frames) // length])
    return np.asarray(np.unique(rows, axis=0, return_inverse=True)[1]).ravel()


def paired_t(usual: FloatArray, other: FloatArray, gram: FloatArray, blocks: IntArray) -> float:
    """Return Student's t of by how much another method errs less, paired over blocks of time.

    Errors within a block are alike, and count as one.

    Parameters
    ----------
    usual, other : (pairs, shapes) float array
        Errors of the two methods on pairs they have not seen.
    gram : (shapes, shapes) float array
        Makes errors squared distances.
    blocks : (pairs,) int array
        From `time_blocks`.
    """
    gained = np.einsum("ns,st,nt->n", usual, gram, usual, optimize=True)
    gained -= np.einsum("ns,st,nt->n", other, gram, other, optimize=True)
    means = np.bincount(blocks, gained) / np.bincount(blocks)
    if len(means) < 2 or not means.any():
        return 0.0
    error = max(float(means.std(ddof=1)) / np.sqrt(len(means)), np.finfo(float).tiny)
    return float(means.mean() / error)


def observable_shapes(errors: Sequence[FloatArray], weights: FloatArray) -> BoolArray:
    """Find the shapes that markers tell anything about.

    Where the eyes look moves no marker: what candidates make of it is chance, and chance must not
    decide between them. A shape counts if some candidate predicts unseen pairs of it better than
    its mean does.

    Parameters
    ----------
    errors : sequence of (pairs, shapes) float arrays
        Of every candidate, on pairs it has not seen.
    weights : (pairs, shapes) float array

    Returns
    -------
    (shapes,) bool array
        All True where there is nothing to tell by.
    """
    variance = weights.var(axis=0)
    if not len(errors):
        return np.ones(len(variance), dtype=np.bool_)
    least = np.min([(each**2).mean(axis=0) for each in errors], axis=0)
    observable = (least < OBSERVABLE_ERROR_SHARE * variance) | (variance == 0)
    return observable if observable.any() else np.ones_like(observable)


def _score(
    candidate: Candidate, errors: FloatArray, observable: BoolArray, gram: FloatArray | None
) -> CandidateScore:
    seen = errors[:, observable]
    return CandidateScore(
        method=candidate.method.name,
        settings=_readable(candidate.settings),
        weight_rmse=weight_rmse(seen),
        vertex_rms_mm=(
            float("nan")
            if gram is None
            else surface_rms_mm(seen, gram[np.ix_(observable, observable)])
        ),
    )


def _order(score: CandidateScore) -> float:
    return score.weight_rmse if np.isnan(score.vertex_rms_mm) else score.vertex_rms_mm


def _readable(settings: Settings) -> str:
    return " ".join(
        f"{name}={value:g}" if isinstance(value, float) else f"{name}={value}"
        for name, value in settings.items()
    )
