"""References to a mapping: choose a method and its settings, fit on all pairs."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from usdface.core.arrays import BoolArray, FloatArray, IntArray
from usdface.core.assets import CandidateScore, MotionSpace, References, TrainedMapping
from usdface.core.errors import InputError
from usdface.core.progress import Progress, silent
from usdface.model.mapping.checks import check_dimensions, check_references, check_skin
from usdface.model.mapping.coordinates import marker_coordinates
from usdface.model.mapping.error_model import fit_error_model
from usdface.model.mapping.motion_space import motion_from_pca
from usdface.model.mapping.performer_face import thinned_sample
from usdface.model.mapping.regions import marker_motion, membership, region_points
from usdface.model.regressions import (
    AUTO,
    Arrays,
    Face,
    Pairs,
    Regression,
    Settings,
    find_method,
)
from usdface.numerics.regression.cross_validation import (
    Fold,
    blocked_folds,
    predict_out_of_fold,
    surface_errors_mm,
    surface_rms_mm,
    weight_rmse,
)
from usdface.numerics.regression.pca import fit_pca

_FOLD_COUNT = 5

MINIMUM_TO_COMPARE = 8
"""Pairs below which cross-validation is chance: the first, simplest candidate is taken."""

OBSERVABLE_ERROR_SHARE = 0.9
"""Of a shape's variance: a mean squared error above it says that markers do not show the shape."""

SURFACE_TOLERANCE_MM = 1.0
WEIGHT_TOLERANCE = 0.1
"""Errors that would be seen: confidence is the probability of smaller ones."""


@dataclass(frozen=True)
class _Candidate:
    method: Regression
    settings: Settings


@dataclass(frozen=True)
class _Compared:
    """Candidates by error, the best first.

    Attributes
    ----------
    errors : (pairs, shapes) float array or None
        Of the best on unseen pairs; None where pairs were too few to compare.
    observable : (shapes,) bool array
    """

    best: _Candidate
    errors: FloatArray | None
    observable: BoolArray
    scores: tuple[CandidateScore, ...]


def train_mapping(
    references: References,
    *,
    ranges: FloatArray,
    gram: FloatArray | None,
    skin: FloatArray | None = None,
    method: str = "auto",
    dimensions: int | None = None,
    progress: Progress = silent,
) -> TrainedMapping:
    """Learn the function from markers to weights that the references show.

    Every candidate predicts each pair from pairs of other moments; the one whose errors move the
    rig's surface least is fitted on all pairs.

    Parameters
    ----------
    references : References
        Pairs; `references.motion` holds what the face does beyond them.
    ranges : (shapes, 2) float array
        Lowest and highest weight of each shape. Weights beyond are limited to it, and their
        number is kept in ``settings['limited_weights']``.
    gram : (shapes, shapes) float array or None
        Mean over the rig's points of the dot products of the shapes' displacements [mm^2]: makes
        errors count as they show. Without it every weight counts alike.
    skin : (shapes, points, 3) float array, optional
        What each shape at 1 does to points spread over the rig's surface [mm]; see `sample_skin`.
        With it a mapping also uses the rig's geometry, beyond the pairs.
    method : str
        A key of `usdface.model.regressions.MAPPING_METHODS`, or ``'auto'`` to try several.
    dimensions : int, optional
        Principal components to use; by default chosen.

    Raises
    ------
    InputError
        If the references cannot be learned from; all faults are listed.
    """
    sound = check_references(references, ranges=ranges, gram=gram)
    check_skin(skin, shapes=len(references.shape_names))
    checked = sound.references
    motion = checked.motion if checked.motion is not None else _motion_of_pairs(checked)
    check_dimensions(dimensions, pairs=len(checked.weights), available=len(motion.components))
    face = Face(
        ranges=ranges.astype(np.float64),
        gram=np.eye(len(ranges)) if gram is None else gram.astype(np.float64),
        motion=motion,
        skin=skin,
    )
    coordinates = marker_coordinates(motion, checked.markers).values
    pairs = Pairs(coordinates, checked.weights, face)
    folds = blocked_folds(checked.frames, checked.takes, folds=_FOLD_COUNT)
    candidates = _candidates(pairs, method, dimensions)
    compared = _compare(candidates, pairs, folds, in_mm=gram is not None, progress=progress)
    best = compared.best
    progress(0.9, f"fitting {best.method.name}")
    fitted = best.method.fit(pairs, best.settings)
    progress(1.0, f"trained {best.method.name}")
    regions, error_arrays = _error_model(compared.errors, pairs, folds, checked, gram)
    arrays = fitted.arrays | _motion_arrays(motion) | error_arrays
    return TrainedMapping(
        method=best.method.name,
        marker_names=checked.marker_names,
        shape_names=checked.shape_names,
        rigid=checked.rigid,
        neutral=checked.neutral.astype(np.float64),
        ranges=face.ranges,
        arrays={
            name: np.ascontiguousarray(value, dtype=np.float64) for name, value in arrays.items()
        },
        settings=fitted.settings
        | {
            "pairs": len(pairs.outputs),
            "limited_weights": sound.limited_weights,
            "regions": ",".join(regions),
            "unobservable_shapes": int((~compared.observable).sum()),
            "performer": checked.performer,
            "session": checked.session,
        },
        scores=compared.scores,
    )


def _compare(
    candidates: list[_Candidate],
    pairs: Pairs,
    folds: tuple[Fold, ...],
    *,
    in_mm: bool,
    progress: Progress,
) -> _Compared:
    """Predict each pair by every candidate from pairs of other moments."""
    tried = []
    for i, candidate in enumerate(candidates if len(pairs.outputs) >= MINIMUM_TO_COMPARE else []):
        progress(0.9 * i / len(candidates), f"cross-validating {candidate.method.name}")
        tried.append((_unseen_errors(candidate, pairs, folds), candidate))
    observable = observable_shapes([errors for errors, _ in tried], pairs.outputs)
    gram = pairs.face.gram if in_mm else None
    scored = [
        (_score(candidate, errors, observable, gram), candidate, errors)
        for errors, candidate in tried
    ]
    scored.sort(key=lambda entry: _order(entry[0]))
    best, errors = (scored[0][1], scored[0][2]) if scored else (candidates[0], None)
    return _Compared(best, errors, observable, tuple(score for score, _, _ in scored))


def _error_model(
    errors: FloatArray | None,
    pairs: Pairs,
    folds: tuple[Fold, ...],
    references: References,
    gram: FloatArray | None,
) -> tuple[tuple[str, ...], Arrays]:
    """Return the parts of the face, and the arrays that tell each part's expected error."""
    motion = marker_motion(pairs.outputs, references.markers.astype(np.float64))
    points = region_points(references.shape_names, motion)
    regions = tuple(points)
    tolerance, seen = _seen_errors(errors, pairs, regions, references.shape_names, gram)
    arrays = fit_error_model(
        pairs.inputs, pairs.face.motion, folds=folds, error_over_tolerance=seen
    )
    arrays["region_markers"] = membership(points, len(references.marker_names))
    arrays["region_tolerance"] = np.array([tolerance])
    return regions, arrays


def _motion_arrays(motion: MotionSpace) -> Arrays:
    return {
        "motion_mean": motion.mean,
        "motion_components": motion.components,
        "motion_variances": motion.variances,
        "motion_total": np.array([motion.total_variance]),
        "takes_sample": thinned_sample(motion),
    }


def motion_of(mapping: TrainedMapping) -> MotionSpace:
    """Put the motion space of a mapping together; without the sample: prediction needs none."""
    try:
        return MotionSpace(
            mean=mapping.arrays["motion_mean"],
            components=mapping.arrays["motion_components"],
            variances=mapping.arrays["motion_variances"],
            total_variance=float(mapping.arrays["motion_total"][0]),
            sample=np.zeros((0, len(mapping.arrays["motion_variances"]))),
        )
    except KeyError as error:
        raise InputError(
            f"the mapping lacks the array {error}; train it again with this version"
        ) from error


def _motion_of_pairs(references: References) -> MotionSpace:
    packed = references.markers.reshape(len(references.markers), -1).astype(np.float64)
    return motion_from_pca(fit_pca(packed), packed)


def _candidates(pairs: Pairs, method: str, dimensions: int | None) -> list[_Candidate]:
    names = AUTO if method == "auto" else (method,)
    return [
        _Candidate(found, settings)
        for found in map(find_method, names)
        for settings in found.candidates(pairs, dimensions)
    ]


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


def _unseen_errors(candidate: _Candidate, pairs: Pairs, folds: tuple[Fold, ...]) -> FloatArray:
    def fit_predict(train: IntArray, test: IntArray) -> FloatArray:
        seen = pairs.rows(train)
        settings = dict(candidate.settings)
        if "dimensions" in settings:  # a fold may have too few pairs for what all of them carry
            settings["dimensions"] = min(int(settings["dimensions"]), max(len(train) - 1, 1))
        fitted = candidate.method.fit(seen, settings)
        predicted = candidate.method.predict(fitted.arrays, fitted.settings, pairs.inputs[test])
        return np.clip(predicted, *pairs.face.ranges.T)

    predicted = predict_out_of_fold(fit_predict, folds, width=pairs.outputs.shape[1])
    return predicted - pairs.outputs


def _score(
    candidate: _Candidate, errors: FloatArray, observable: BoolArray, gram: FloatArray | None
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


def _seen_errors(
    errors: FloatArray | None,
    pairs: Pairs,
    regions: tuple[str, ...],
    names: tuple[str, ...],
    gram: FloatArray | None,
) -> tuple[float, FloatArray]:
    """Return the tolerance, and errors over it: (pairs, regions), or a row where none are known."""
    tolerance = WEIGHT_TOLERANCE if gram is None else SURFACE_TOLERANCE_MM
    if errors is None:
        return tolerance, np.ones((1, len(regions)))
    whole = np.sqrt((errors**2).mean(axis=1)) if gram is None else surface_errors_mm(errors, gram)
    each = np.tile(whole[:, None], (1, len(regions)))
    if gram is not None and pairs.face.skin is not None:
        for region, points in region_points(names, pairs.face.skin).items():
            if region in regions[1:]:
                moved = np.einsum("ns,spc->npc", errors, pairs.face.skin[:, points], optimize=True)
                size = np.sqrt((moved**2).sum(axis=2).mean(axis=1))
                each[:, regions.index(region)] = size
    return tolerance, each / tolerance


def _order(score: CandidateScore) -> float:
    return score.weight_rmse if np.isnan(score.vertex_rms_mm) else score.vertex_rms_mm


def _readable(settings: Settings) -> str:
    return " ".join(
        f"{name}={value:g}" if isinstance(value, float) else f"{name}={value}"
        for name, value in settings.items()
    )
