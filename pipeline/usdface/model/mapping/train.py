"""References to a mapping: choose a method and its settings, fit on all pairs."""

from dataclasses import replace

import numpy as np

from usdface.core.arrays import FloatArray
from usdface.core.assets import References, TrainedMapping
from usdface.core.progress import Progress, silent
from usdface.core.rig_logic import logic_of
from usdface.model.mapping.candidates import (
    Comparison,
    PairFolds,
    UnseenPairs,
    choose_common_error,
    compare_candidates,
    list_candidates,
)
from usdface.model.mapping.checks import check_dimensions, check_references, check_skin
from usdface.model.mapping.corrected_pairs import (
    CorrectedPairs,
    correct_pairs,
    find_contradicted,
)
from usdface.model.mapping.motion_space import marker_coordinates, motion_arrays, motion_of_pairs
from usdface.model.mapping.pair_gains import mean_gains
from usdface.model.mapping.regions import (
    membership,
    region_grams,
    region_points,
    unseen_regions,
)
from usdface.model.mapping.uncertainty import UncertaintyModel, calibrate_uncertainty
from usdface.model.regressions import (
    DEFAULT_CHOICES,
    Arrays,
    Choices,
    Face,
    Pairs,
    RestPlaces,
)
from usdface.model.regressions.base import DrivenSkin, Fitted
from usdface.model.regressions.frame_solve import VARIANCE_INFLATIONS, FrameSolver
from usdface.numerics.measure.face_regions import (
    gaze_shapes,
    shapes_by_region,
    tongue_shapes,
    unseen_shapes,
)

_TONGUE_SHARE = 0.2
"""Of the farthest that shapes of the tongue move a point: lips part less for it. The jaw moves the
tongue farther than these do."""

_STILL_SHARE = 0.1
"""Of its range: a region whose shapes all stay within it is one that no reference moves."""

_UNKNOWN_ERROR = 0.1
"""Of a weight: usual error where pairs are too few to measure it."""

_UNKNOWN_CALIBRATION = 2.0
"""Of uncertainty where pairs are too few to calibrate it."""


def train_mapping(
    references: References,
    *,
    ranges: FloatArray,
    gram: FloatArray | None,
    skin: FloatArray | None = None,
    rest: RestPlaces | None = None,
    method: str = "auto",
    choices: Choices = DEFAULT_CHOICES,
    progress: Progress = silent,
) -> TrainedMapping:
    """Learn the function from markers to weights that the references show.

    Every candidate predicts each pair from pairs of other moments; the one whose errors move the
    rig's surface least is fitted on all pairs.

    Parameters
    ----------
    references : References
        Pairs; `references.motion` holds what the face does beyond them, and `references.parts`,
        otherwise the shapes' names, tell the regions of the face.
    ranges : (shapes, 2) float array
        Lowest and highest weight of each shape. Weights beyond are limited to it, and their
        number is kept in ``settings['limited_weights']``.
    gram : (shapes, shapes) float array or None
        Mean over the rig's points of the dot products of the shapes' displacements [mm^2]: makes
        errors count as they show. Without it every weight counts alike.
    skin : (shapes + combinations, points, 3) float array, optional
        What each shape at 1, and after them each of the references' combinations, does to points
        spread over the rig's surface [mm]; see `sample_skin`. With it a mapping
        also uses the rig's geometry, beyond the pairs.
    rest : RestPlaces, optional
        Where those points, and markers, are on the rig's neutral: markers are then placed by where
        they are as well, not by their motion alone.
    method : str
        A key of `usdface.model.regressions.MAPPING_METHODS`, or ``'auto'`` to try several.
    choices : Choices, optional
        Numbers of principal components, and widths, to compare in place of the method's own.
    """
    sound = check_references(references, ranges=ranges, gram=gram)
    checked, parts = sound.references, references.parts or references.shape_names
    skin, rest = _outer_skin(skin, rest, references)
    motion = checked.motion if checked.motion is not None else motion_of_pairs(checked)
    check_dimensions(choices.dimensions, pairs=len(checked.weights), motion=motion)
    face = Face(
        ranges=ranges.astype(np.float64),
        gram=np.eye(len(ranges)) if gram is None else _skin_gram(gram, parts),
        motion=motion,
        skin=None if skin is None else skin[: len(ranges)],
        driven=_driven_skin(references, skin),
        rest=rest,
        neutral=checked.neutral.astype(np.float64),
    )
    progress(0.0, "fitting the forward model")
    folds = PairFolds(_corrected_pairs(checked, face), checked)
    candidates = list_candidates(folds.pairs, method, choices)
    compared = compare_candidates(candidates, folds, in_mm=gram is not None, progress=progress)
    folds, compared = choose_common_error(folds, compared, checked, gram)
    corrected, best = folds.corrected, compared.best
    progress(0.9, f"fitting {best.method.name}")
    fitted = best.method.fit(corrected.known_to(best.method), best.settings)
    progress(1.0, f"trained {best.method.name}")
    solver = _frame_solver(corrected, fitted, compared.unseen)
    regions, error_arrays = _uncertainty(compared, folds, parts, solver)
    return TrainedMapping(
        method=best.method.name,
        marker_names=checked.marker_names,
        shape_names=checked.shape_names,
        rigid=checked.rigid,
        neutral=checked.neutral.astype(np.float64),
        ranges=face.ranges,
        arrays=_as_stored(
            fitted.arrays | motion_arrays(motion) | solver.to_arrays() | error_arrays
        ),
        settings=fitted.settings
        | _region_settings(checked, folds, regions, parts)
        | _key_settings(corrected, checked, parts)
        | {
            "pairs": len(checked.weights),
            "limited_weights": sound.limited_weights,
            "unobservable_shapes": int((~compared.observable).sum()),
            "performer": checked.performer,
            "session": checked.session,
        },
        scores=compared.scores,
    )


def _outer_skin(
    skin: FloatArray | None, rest: RestPlaces | None, references: References
) -> tuple[FloatArray | None, RestPlaces | None]:
    """Leave out eyeballs, what gaze moves most, and the tongue: no marker sits there."""
    check_skin(skin, shapes=len(references.shape_names) + len(references.combinations))
    if skin is None:
        return skin, rest
    parts = references.parts or references.shape_names
    length = np.linalg.norm(skin, axis=2)
    gaze, tongue = gaze_shapes(parts), length[tongue_shapes(parts)].max(axis=0, initial=0)
    kept = length[gaze].max(axis=0, initial=0) <= np.delete(length, gaze, axis=0).max(axis=0)
    kept &= tongue <= _TONGUE_SHARE * tongue.max(initial=0)
    return skin[:, kept], None if rest is None else replace(rest, points=rest.points[kept])


def _pairs(references: References, face: Face) -> Pairs:
    markers = references.markers.astype(np.float64)
    return Pairs(marker_coordinates(face.motion, markers), references.weights, face, markers)


def _corrected_pairs(references: References, face: Face) -> CorrectedPairs:
    """Correct the pairs, with as many markers to count as one as usual of their kind.

    What a model finds in pictures, `track` on irises and OpenFace all over, errs together.
    """
    landmarks = any(each.startswith(("iris_", "landmark_")) for each in references.marker_names)
    parts = references.parts or references.shape_names
    common = VARIANCE_INFLATIONS[-1 if landmarks else 0]
    return correct_pairs(_pairs(references, face), parts, common=common)


def _driven_skin(references: References, skin: FloatArray | None) -> DrivenSkin | None:
    logic = logic_of(references.shape_names, references.combinations)
    if skin is None or logic is None:
        return None
    return DrivenSkin(logic, skin[len(references.shape_names) :])


def _key_settings(
    corrected: CorrectedPairs, references: References, parts: tuple[str, ...]
) -> dict[str, float | str]:
    """Return what the markers say of the keys: errors, gains, contradictions."""
    gains = mean_gains(corrected.log_factor, references.authors)
    contradicted = find_contradicted(corrected.uncorrected, parts).items()
    return {
        "key_error": corrected.key_error,
        "gain_deviation": float(corrected.log_factor.std()),
        "author_gains": "; ".join(f"{author} {gain:.2f}" for author, gain in gains.items()),
        "contradicted": "; ".join(
            f"{references.takes[n]} {references.frames[n]} ({region}, {residual:.1f} mm)"
            for n, (region, residual) in contradicted
        ),
    }


def _as_stored(arrays: Arrays) -> Arrays:
    """Return arrays as a file gives them back, so that a mapping predicts the same reopened."""
    return {name: np.ascontiguousarray(each, dtype=np.float64) for name, each in arrays.items()}


def _frame_solver(
    corrected: CorrectedPairs, fitted: Fitted, unseen: UnseenPairs | None
) -> FrameSolver:
    """Return the solver, with the usual error of the method's normalised weights."""
    ranges = corrected.pairs.face.ranges
    if "start_error" in fitted.arrays:
        usual = fitted.arrays["start_error"]
    elif unseen is None:
        usual = np.full(len(ranges), _UNKNOWN_ERROR)
    else:
        usual = np.sqrt((unseen.errors**2).mean(axis=0)) / np.ptp(ranges, axis=1)
    return FrameSolver(corrected.forward, usual, corrected.common)


def _skin_gram(gram: FloatArray, parts: tuple[str, ...]) -> FloatArray:
    """Return a Gram matrix in which shapes count that markers show: gaze and tongue apart."""
    counted = gram.astype(np.float64)
    columns = unseen_shapes(parts)
    counted[columns] = counted[:, columns] = 0.0
    return counted


def _uncertainty(
    compared: Comparison, folds: PairFolds, parts: tuple[str, ...], solver: FrameSolver
) -> tuple[tuple[str, ...], Arrays]:
    """Return the regions of the face, and the arrays that tell each region's uncertainty."""
    face = folds.pairs.face
    span = np.ptp(face.ranges, axis=1)
    points = region_points(parts, solver.forward.basis)
    regions = tuple(points)
    grams = region_grams(face.gram, face.skin, parts, regions)
    grams = np.stack([_skin_gram(each, parts) for each in grams]) * np.outer(span, span)
    model = UncertaintyModel(grams, np.ones(len(regions)))
    calibration = np.full(len(regions), _UNKNOWN_CALIBRATION)
    unseen = compared.unseen
    if unseen is not None:
        deviations = folds.deviations(compared.best, unseen, model, solver.error)
        calibration = calibrate_uncertainty(grams, unseen.errors / span, deviations)
    arrays = UncertaintyModel(grams, calibration).to_arrays()
    arrays["region_markers"] = membership(points, len(solver.forward.noise))
    return regions, arrays


def _region_settings(
    references: References, folds: PairFolds, regions: tuple[str, ...], parts: tuple[str, ...]
) -> dict[str, str]:
    """Name the regions, those that no marker sees, and of the rest those that no reference moves.

    What moves a still region later, only the rig tells.
    """
    face, shapes = folds.pairs.face, shapes_by_region(parts)
    unseen = unseen_regions(parts, face, references.marker_names, references.rigid)
    reach = np.ptp(face.normalise(folds.pairs.outputs), axis=0)
    still = [
        region
        for region in regions[1:]
        if region in shapes and region not in unseen and reach[shapes[region]].max() < _STILL_SHARE
    ]
    named = {"regions": regions, "still_regions": still, "unseen_regions": unseen}
    return {name: ",".join(each) for name, each in named.items()}
