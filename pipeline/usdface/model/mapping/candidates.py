"""Comparison of a mapping's candidates by cross-validation."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from usdface.core.arrays import BoolArray, FloatArray, IntArray
from usdface.core.assets import CandidateScore, References
from usdface.core.errors import InputError
from usdface.core.progress import Progress
from usdface.model.mapping.corrected_pairs import (
    CorrectedPairs,
    displacements,
    fit_pairs_forward,
)
from usdface.model.mapping.uncertainty import UncertaintyModel
from usdface.model.regressions import AUTO, Choices, Pairs, Regression, Settings, find_method
from usdface.model.regressions.bent_weights import bend, unbend
from usdface.model.regressions.frame_solve import FrameSolver
from usdface.numerics.regression.cross_validation import (
    blocked_folds,
    surface_rms_mm,
    weight_rmse,
)

MINIMUM_TO_COMPARE = 8
"""Fewest pairs for cross-validation; with fewer, the first candidate is taken."""

OBSERVABLE_ERROR_SHARE = 0.9
"""Mean squared error of a shape, relative to its variance, above which it is not observable."""

_CRITICAL_T = 2.0
"""Student's t from which another method replaces the default: p = .05, two-sided."""

_NEIGHBOUR_SECONDS = 0.5
"""Margin between training and test pairs: nearer frames show the same expression."""

_BLOCK_SECONDS = 2.0
"""Length of a block of the paired test: about the correlation time of errors."""

_DEFAULT_RATE = 60.0
"""Frames per second of references without a rate."""


@dataclass(frozen=True)
class Candidate:
    """A method with settings."""

    method: Regression
    settings: Settings


@dataclass(frozen=True)
class OutOfFold:
    """Out-of-fold predictions of the pairs by one candidate."""

    errors: FloatArray
    """(pairs, shapes): predicted weights minus keys."""
    prior_mean: FloatArray
    """(pairs, shapes): bent weights predicted by the regression, before the frame solve."""
    prior_error: FloatArray | None
    """(pairs, shapes): standard deviation of their errors, as each fold's fit estimates it; None if
    the method does not solve frames."""


@dataclass(frozen=True)
class Comparison:
    """Result of the comparison."""

    best: Candidate
    out_of_fold: OutOfFold | None
    """Predictions of the best; None with too few pairs to compare."""
    observable: BoolArray
    """(shapes,): see `observable_shapes`."""
    scores: tuple[CandidateScore, ...]
    """In ascending order of error."""


@dataclass(frozen=True)
class _Scored:
    score: CandidateScore
    candidate: Candidate
    out_of_fold: OutOfFold


class PairFolds:
    """Pairs in folds blocked by take and time, with a forward model of each training set."""

    def __init__(self, corrected: CorrectedPairs, references: References) -> None:
        pairs, scales = corrected.pairs, corrected.forward.scales
        self.pairs, self.corrected = pairs, corrected
        frames, takes, rate = references.frames, references.takes, references.rate or _DEFAULT_RATE
        self.folds = blocked_folds(frames, takes, margin=round(_NEIGHBOUR_SECONDS * rate))
        self.blocks = time_blocks(frames, takes, length=max(round(_BLOCK_SECONDS * rate), 1))
        self.forwards = [fit_pairs_forward(pairs.rows(fold.train), scales) for fold in self.folds]
        self.targets = bend(pairs.face.normalise(pairs.outputs), scales.curve)
        self.curve = scales.curve

    def displacements(self, rows: IntArray) -> tuple[FloatArray, BoolArray]:
        """Return displacements [mm] and visibility of some pairs."""
        displaced = displacements(self.pairs.rows(rows))
        return displaced, np.ones(displaced.shape[:2], dtype=np.bool_)

    def predict(self, candidate: Candidate) -> OutOfFold:
        """Predict every pair by the fit to the other folds."""
        face, method = self.pairs.face, candidate.method
        errors, prior_mean, prior_error = (
            np.full_like(self.pairs.outputs, np.nan) for _ in range(3)
        )
        for fold, forward in zip(self.folds, self.forwards, strict=True):
            settings = dict(candidate.settings)
            if "dimensions" in settings:  # a training set may have fewer pairs than dimensions
                most = max(len(fold.train) - 1, 1)
                settings["dimensions"] = min(int(settings["dimensions"]), most)
            training = self.corrected.training_pairs(method).rows(fold.train)
            fitted = method.fit(replace(training, forward=forward), settings)
            weights = method.predict(fitted.arrays, fitted.settings, self.pairs.inputs[fold.test])
            prior_mean[fold.test] = bend(face.normalise(weights), self.curve)
            keys = self.corrected.original_keys[fold.test]
            errors[fold.test] = np.clip(weights, *face.ranges.T) - keys
            if method.solves_frames:
                prior_error[fold.test] = fitted.arrays["start_error"]
        if not method.solves_frames:
            return OutOfFold(errors, prior_mean, None)
        low, span = face.ranges[:, 0], np.ptp(face.ranges, axis=1)
        for fold, forward in zip(self.folds, self.forwards, strict=True):
            solver = FrameSolver(forward, prior_error[fold.test[0]], self.corrected.inflation)
            t = solver.solve(*self.displacements(fold.test), prior_mean[fold.test]).targets
            weights = low + span * np.clip(unbend(t, self.curve), 0.0, 1.0)
            errors[fold.test] = weights - self.corrected.original_keys[fold.test]
        return OutOfFold(errors, prior_mean, prior_error)

    def deviations(
        self,
        candidate: Candidate,
        predicted: OutOfFold,
        model: UncertaintyModel,
        default_error: FloatArray,
    ) -> FloatArray:
        """Return the uncalibrated uncertainty of every pair: (pairs, regions) [mm]."""
        out = np.empty((len(predicted.prior_mean), len(model.grams)))
        for fold, forward in zip(self.folds, self.forwards, strict=True):
            error = default_error
            if predicted.prior_error is not None:
                error = predicted.prior_error[fold.test[0]]
            solver = FrameSolver(forward, error, self.corrected.inflation)
            displaced, visible = self.displacements(fold.test)
            prior_mean, bounded = predicted.prior_mean[fold.test], candidate.method.solves_frames
            solution = solver.solve(displaced, visible, prior_mean, bounded=bounded)
            out[fold.test] = model.deviations(solver, solution, visible)
        return out


def list_candidates(pairs: Pairs, method: str, choices: Choices) -> list[Candidate]:
    """Return the candidate settings of a method, or for ``auto`` of all methods in `AUTO`.

    Raises
    ------
    InputError
        If `choices` has widths, and the method none.
    """
    names = AUTO if method == "auto" else (method,)
    candidates = [
        Candidate(regression, settings)
        for regression in map(find_method, names)
        for settings in regression.candidates(pairs, choices)
    ]
    if choices.widths and not any("width" in each.settings for each in candidates):
        raise InputError(f"{method} has no width to choose; leave it out, or train rbf or d06")
    return candidates


def compare_candidates(
    candidates: list[Candidate],
    folds: PairFolds,
    *,
    in_mm: bool,
    progress: Progress,
) -> Comparison:
    """Cross-validate candidates; only a significantly better method replaces the default."""
    pairs, predictions = folds.pairs, []
    for i, candidate in enumerate(candidates if len(pairs.outputs) >= MINIMUM_TO_COMPARE else []):
        progress(0.9 * i / len(candidates), f"cross-validating {candidate.method.name}")
        predictions.append((folds.predict(candidate), candidate))
    observable = observable_shapes([each.errors for each, _ in predictions], pairs.outputs)
    gram = pairs.face.gram if in_mm else None
    scored = [
        _Scored(_score(candidate, predicted.errors, observable, gram), candidate, predicted)
        for predicted, candidate in predictions
    ]
    if not scored:
        return Comparison(candidates[0], None, observable, ())
    scored.sort(key=lambda entry: _sort_key(entry.score))
    best = scored[0]
    default = next((entry for entry in scored if entry.candidate.method.name == AUTO[0]), best)
    errors = default.out_of_fold.errors, best.out_of_fold.errors
    if paired_t(*errors, pairs.face.gram, folds.blocks) <= _CRITICAL_T:
        best = default
    scores = tuple(entry.score for entry in scored)
    return Comparison(best.candidate, best.out_of_fold, observable, scores)


def time_blocks(frames: IntArray, takes: Sequence[str], *, length: int) -> IntArray:
    """Return the index of each pair's block of `length` frames of one take: (pairs,)."""
    codes = np.unique(np.asarray(takes, dtype=str), return_inverse=True)[1]
    rows = np.column_stack([codes, np.asarray(frames) // length])
    return np.asarray(np.unique(rows, axis=0, return_inverse=True)[1]).ravel()


def paired_t(default: FloatArray, other: FloatArray, gram: FloatArray, blocks: IntArray) -> float:
    """Return Student's t of the decrease in squared error, paired over blocks of time.

    Errors within a block are correlated: its mean is one sample.

    Parameters
    ----------
    default, other : (pairs, shapes) float array
        Out-of-fold errors of two methods.
    gram : (shapes, shapes) float array
        Metric of the errors.
    blocks : (pairs,) int array
        From `time_blocks`.
    """
    decrease = np.einsum("ns,st,nt->n", default, gram, default, optimize=True)
    decrease -= np.einsum("ns,st,nt->n", other, gram, other, optimize=True)
    means = np.bincount(blocks, decrease) / np.bincount(blocks)
    if len(means) < 2 or not means.any():
        return 0.0
    error = max(float(means.std(ddof=1)) / np.sqrt(len(means)), np.finfo(float).tiny)
    return float(means.mean() / error)


def observable_shapes(errors: Sequence[FloatArray], weights: FloatArray) -> BoolArray:
    """Find the shapes that some candidate predicts out of fold better than their mean.

    Shapes that move no marker, such as gaze, would add only chance to the comparison.

    Parameters
    ----------
    errors : sequence of (pairs, shapes) float arrays
        Out-of-fold errors of each candidate.
    weights : (pairs, shapes) float array

    Returns
    -------
    (shapes,) bool array
        All True if there are no errors, or no shape would be.
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
    kept = errors[:, observable]
    return CandidateScore(
        method=candidate.method.name,
        settings=_readable(candidate.settings),
        weight_rmse=weight_rmse(kept),
        vertex_rms_mm=(
            float("nan")
            if gram is None
            else surface_rms_mm(kept, gram[np.ix_(observable, observable)])
        ),
    )


def _sort_key(score: CandidateScore) -> float:
    return score.weight_rmse if np.isnan(score.vertex_rms_mm) else score.vertex_rms_mm


def _readable(settings: Settings) -> str:
    return " ".join(
        f"{name}={value:g}" if isinstance(value, float) else f"{name}={value}"
        for name, value in settings.items()
    )
