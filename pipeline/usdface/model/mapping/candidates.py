"""Comparison of a mapping's candidates by cross-validation."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from usdface.core.arrays import BoolArray, FloatArray, IntArray
from usdface.core.assets import CandidateScore, References
from usdface.core.errors import InputError
from usdface.core.progress import Progress
from usdface.model.mapping.corrected_pairs import CorrectedPairs, correct_pairs
from usdface.model.mapping.uncertainty import TOLERANCE_CONFIDENCE, UncertaintyModel, squared_motion
from usdface.model.placement.label_hints import are_image_landmarks
from usdface.model.regressions import AUTO, find_method
from usdface.model.regressions.base import Choices, Fitted, Pairs, Regression, Settings
from usdface.model.regressions.bent_weights import unbend
from usdface.model.regressions.frame_solve import FrameSolution, FrameSolver
from usdface.numerics.regression.cross_validation import blocked_folds, surface_rms_mm, weight_rmse

MINIMUM_TO_COMPARE = 8
"""Fewest pairs for cross-validation; with fewer, the first candidate is taken."""

OBSERVABLE_ERROR_SHARE = 0.9
"""Mean squared error of a shape, relative to its variance, above which it is not observable."""

_CRITICAL_T = 2.0
"""Student's t above which another method replaces the default: p = .05, two-sided."""

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
class FoldModel:
    """A candidate fitted to the training pairs of a fold."""

    method: Regression
    fitted: Fitted
    corrected: CorrectedPairs
    """The training pairs."""

    def weights(self, pairs: Pairs) -> FloatArray:
        """Return the normalised weights of pairs: (pairs, shapes)."""
        solves = self.method.solves_frames
        targets = self.solve(pairs, self.solver).targets if solves else self._prior(pairs)[0]
        return np.clip(unbend(targets, self.corrected.forward.scales.curve), 0.0, 1.0)

    @cached_property
    def solver(self) -> FrameSolver:
        """The solver of a method that solves frames."""
        return self.solver_of(self.fitted.arrays["start_error"])

    def solver_of(self, error: FloatArray) -> FrameSolver:
        """Return a solver with the error of the method's weights: (shapes,)."""
        return FrameSolver(self.corrected.forward, error, self.corrected.inflation)

    def solve(self, pairs: Pairs, solver: FrameSolver) -> FrameSolution:
        """Return the solution of pairs, at the predicted weights if the method solves no frames."""
        displaced, bounded = pairs.displacements, self.method.solves_frames
        visible = np.ones(displaced.shape[:2], np.bool_)
        return solver.solve(displaced, visible, *self._prior(pairs), bounded=bounded)

    def _prior(self, pairs: Pairs) -> tuple[FloatArray, FloatArray | None]:
        predict = self.method.prepare_prior(
            self.fitted.arrays,
            self.fitted.settings,
            sides=pairs.face.sides,
            curve=self.corrected.forward.scales.curve,
        )
        return predict(pairs.inputs, pairs.displacements)


@dataclass(frozen=True)
class OutOfFold:
    """Out-of-fold predictions of the pairs by one candidate."""

    errors: FloatArray
    """(pairs, shapes): predicted weights minus keys."""
    models: tuple[FoldModel, ...]
    """One for each fold."""


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


class PairFolds:
    """Pairs in folds blocked by take and time.

    Keys are corrected in each training set anew: corrections from all pairs would make the models
    of the folds agree.
    """

    def __init__(self, pairs: Pairs, references: References) -> None:
        self.parts = references.parts or references.shape_names
        self._landmarks = are_image_landmarks(references.marker_names)
        self.corrected = correct_pairs(pairs, self.parts, landmarks=self._landmarks)
        self.pairs = self.corrected.pairs
        frames, takes, rate = references.frames, references.takes, references.rate or _DEFAULT_RATE
        self.folds = blocked_folds(frames, takes, margin=round(_NEIGHBOUR_SECONDS * rate))
        self.blocks = time_blocks(frames, takes, length=max(round(_BLOCK_SECONDS * rate), 1))

    @cached_property
    def training_sets(self) -> list[CorrectedPairs]:
        """Training pairs of each fold."""
        corrected = self.corrected
        original = replace(corrected.pairs, outputs=corrected.original_keys)
        return [
            correct_pairs(
                original.rows(fold.train),
                self.parts,
                landmarks=self._landmarks,
                scales=corrected.scales,
            )
            for fold in self.folds
        ]

    def predict(self, candidate: Candidate) -> OutOfFold:
        """Predict every pair by the fit to the other folds."""
        face, method = self.pairs.face, candidate.method
        low, span = face.ranges[:, 0], np.ptp(face.ranges, axis=1)
        errors, models = -self.corrected.original_keys, []
        for fold, training in zip(self.folds, self.training_sets, strict=True):
            settings = dict(candidate.settings)
            if "dimensions" in settings:  # a training set may have fewer pairs than dimensions
                most = max(len(fold.train) - 1, 1)
                settings["dimensions"] = min(int(settings["dimensions"]), most)
            fitted = method.fit(training.training_pairs(method), settings)
            models.append(FoldModel(method, fitted, training))
            errors[fold.test] += low + span * models[-1].weights(self.pairs.rows(fold.test))
        return OutOfFold(errors, tuple(models))

    def deviations(
        self, predicted: OutOfFold, model: UncertaintyModel, default_error: FloatArray
    ) -> FloatArray:
        """Return the uncalibrated uncertainty of every pair: (pairs, regions) [mm].

        `default_error`, (shapes,), is for methods that do not estimate their own.
        """
        out = np.empty((len(predicted.errors), len(model.grams)))
        for fold, each in zip(self.folds, predicted.models, strict=True):
            solves = each.method.solves_frames
            solver = each.solver if solves else each.solver_of(default_error)
            solution = each.solve(self.pairs.rows(fold.test), solver)
            visible = np.ones((len(fold.test), len(solver.forward.noise)), np.bool_)
            out[fold.test] = model.uncalibrated(solver, solution, visible)
        return out

    def squared_errors(self, predicted: OutOfFold, grams: FloatArray) -> FloatArray:
        """Return the estimated squared error of the surface of every pair: (pairs, regions) [mm^2].

        That of the out-of-fold error, relative to the corrected keys if the original ones have
        random errors, plus the variance of the prediction by the grouped jackknife: corrected keys
        do not show errors that the original ones have in common by chance, such as a gain of one
        shape. As the variance of few folds is imprecise, its upper confidence limit is used.

        Parameters
        ----------
        grams : (regions, shapes, shapes) float array
            Of normalised weights [mm^2].

        References
        ----------
        Shao and Tu (1995), The Jackknife and Bootstrap, section 2.3.
        """
        from scipy.special import chdtri  # only training needs SciPy: mapping starts faster without

        errors = predicted.errors
        if self.corrected.has_random_errors:
            errors = errors + self.corrected.original_keys - self.pairs.outputs
        errors = errors / np.ptp(self.pairs.face.ranges, axis=1)
        squared, count = squared_motion(grams, errors), len(self.folds)
        limit = (count - 2) / chdtri(count - 2, TOLERANCE_CONFIDENCE)
        factor = limit * (count - 1) ** 2 / (count * (count - 2))
        weights = np.stack([each.weights(self.pairs) for each in predicted.models])
        for k, fold in enumerate(self.folds):
            # the fold's own model lacks these pairs and their neighbours
            others = np.delete(weights[:, fold.test], k, axis=0)
            spread = sum(squared_motion(grams, each) for each in others - others.mean(axis=0))
            squared[fold.test] += factor * spread
        return squared


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
    candidates: list[Candidate], folds: PairFolds, *, in_mm: bool, progress: Progress
) -> Comparison:
    """Cross-validate candidates; only a significantly better method replaces the default."""
    pairs, predictions = folds.pairs, []
    for i, candidate in enumerate(candidates if len(pairs.outputs) >= MINIMUM_TO_COMPARE else []):
        progress(0.9 * i / len(candidates), f"cross-validating {candidate.method.name}")
        predictions.append((folds.predict(candidate), candidate))
    judged = [each.errors for each, _ in predictions]
    if judged and all(candidate.method.name != AUTO[0] for candidate in candidates):
        # Shapes that a method cannot predict are its errors: markers may show them nevertheless.
        judged += [
            folds.predict(each).errors for each in list_candidates(pairs, AUTO[0], Choices())
        ]
    observable = observable_shapes(judged, pairs.outputs)
    if not predictions:
        return Comparison(candidates[0], None, observable, ())
    gram = pairs.face.gram if in_mm else None
    scored = [(_score(each, out.errors, observable, gram), each, out) for out, each in predictions]
    scored.sort(key=lambda entry: entry[0].vertex_rms_mm if in_mm else entry[0].weight_rmse)
    best = scored[0]
    default = next((entry for entry in scored if entry[1].method.name == AUTO[0]), best)
    before, after = (out.errors[:, observable] for _, _, out in (default, best))
    metric = pairs.face.gram[np.ix_(observable, observable)]
    # Other methods predict the zeros of keys that were not set, by which errors are measured.
    unset = folds.corrected.scales.unset > 0
    if unset or paired_t(before, after, metric, folds.blocks) <= _CRITICAL_T:
        best = default
    return Comparison(*best[1:], observable, tuple(score for score, _, _ in scored))


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

    Shapes that move no marker, such as gaze, would add only chance to the comparison. Returns
    (shapes,), True also for shapes of constant weight; all True without errors, or if none is.

    Parameters
    ----------
    errors : sequence of (pairs, shapes) float arrays
        Out-of-fold errors of each candidate.
    weights : (pairs, shapes) float array
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
    errors = errors[:, observable]
    return CandidateScore(
        method=candidate.method.name,
        settings=_readable(candidate.settings),
        weight_rmse=weight_rmse(errors),
        vertex_rms_mm=(
            float("nan")
            if gram is None
            else surface_rms_mm(errors, gram[np.ix_(observable, observable)])
        ),
    )


def _readable(settings: Settings) -> str:
    return " ".join(
        f"{name}={value:g}" if isinstance(value, float) else f"{name}={value}"
        for name, value in settings.items()
    )
