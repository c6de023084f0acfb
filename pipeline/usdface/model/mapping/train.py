"""Training of a mapping: choice of method and settings by cross-validation, fit to all pairs."""

import json
from dataclasses import replace

import numpy as np

from usdface.core.arrays import Arrays, FloatArray
from usdface.core.assets import References, TrainedMapping
from usdface.core.progress import Progress, silent
from usdface.core.rig_logic import logic_of
from usdface.core.text import first_few
from usdface.core.trajectories import displacements_at
from usdface.model.mapping.candidates import (
    Comparison,
    OutOfFold,
    PairFolds,
    compare_candidates,
    list_candidates,
)
from usdface.model.mapping.checks import check_dimensions, check_references, check_skin
from usdface.model.mapping.corrected_pairs import (
    CorrectedPairs,
    find_contradicted,
    find_forgotten,
    fit_pairs_forward,
    fit_rig_prior,
)
from usdface.model.mapping.key_delays import find_key_delays
from usdface.model.mapping.motion_space import (
    marker_coordinates,
    motion_arrays,
    motion_of_pairs,
    motion_without_errors,
    sampled_frames,
)
from usdface.model.mapping.pair_gains import mean_gains
from usdface.model.mapping.regions import (
    membership,
    region_grams,
    region_points,
    regions_without_markers,
    regions_without_shapes,
)
from usdface.model.mapping.take_neutral import find_take_offsets
from usdface.model.mapping.uncertainty import UncertaintyModel, calibrate_uncertainty
from usdface.model.regressions.base import (
    DEFAULT_CHOICES,
    Choices,
    DrivenSkin,
    Face,
    Fitted,
    Pairs,
    RestPlaces,
)
from usdface.model.regressions.forward_model import ForwardScales
from usdface.model.regressions.frame_solve import FrameSolver
from usdface.model.regressions.shape_sides import JOINED_OUTPUTS, ShapeSides
from usdface.numerics.measure.face_regions import (
    gaze_and_tongue_shapes,
    gaze_shapes,
    shapes_by_region,
    tongue_shapes,
)
from usdface.numerics.rigid.pose_error import expression_motion

_TONGUE_SHARE = 0.2
"""Points that shapes of the tongue move by more than this, relative to their largest displacement,
belong to the tongue: the lips move less with it."""

_STILL_SHARE = 0.1
"""A region is still if the references move none of its shapes over more than this share of its
range."""

_POSE_ROUNDS = 3
"""Alternations of locating the markers on the rig and removing errors of poses from the pairs; the
third reduces the remaining error by a tenth."""

_DEFAULT_ERROR = 0.1
"""Standard deviation of the error of a normalised weight with too few pairs for cross-validation.
"""

_DEFAULT_CALIBRATION = 2.0
"""Factor on the uncertainty with too few pairs for its calibration."""


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
    """Fit the function from markers to weights given by pairs of both.

    Candidates are compared by cross-validation, in folds blocked by take and time; the one of least
    surface error is fitted to all pairs.

    Parameters
    ----------
    references : References
        Pairs, with the takes' principal components in `references.motion`. Regions of the face
        follow from `references.parts`, otherwise from the names of the shapes.
    ranges : (shapes, 2) float array
        Lowest and highest weight of each shape, to which weights are limited.
    gram : (shapes, shapes) float array or None
        Mean over the rig's points of the dot products of the shapes' displacements [mm^2]: the
        metric of errors. Without it, all shapes have equal weight.
    skin : (shapes + combinations, points, 3) float array, optional
        Displacement by each shape at 1, then by each of the references' combinations, of points
        spread over the rig's surface [mm]; see `skin_points`. It is the prior of the forward model.
    rest : RestPlaces, optional
        Positions of those points, and of the markers, on the rig's neutral: markers are then
        located on the rig by position as well as by motion.
    method : str
        A key of `usdface.model.regressions.MAPPING_METHODS`, or ``'auto'`` to try several.
    choices : Choices, optional
        Numbers of principal components, and widths, to compare in place of the method's candidates.

    Raises
    ------
    InputError
        If the references, the skin or the choices do not fit each other or the method.
    """
    limited = check_references(references, ranges=ranges, gram=gram)
    sides = ShapeSides.divided(ranges.astype(np.float64))
    checked = sides.references(limited)
    face = _face(references, checked, sides, gram=gram, skin=skin, rest=rest)
    check_dimensions(choices.dimensions, pairs=len(checked.weights), motion=face.motion)
    progress(0.0, "fitting the forward model")
    delays = _key_delays(checked, face)
    timed = _remove_key_delays(checked, delays)
    aligned = _remove_take_offsets(timed, face)
    pair_arrays = _pair_arrays(checked, timed.markers - aligned.markers)
    checked, face, pose_arrays, pose_error_mm = _remove_pose_errors(aligned, face)
    folds = PairFolds(_pairs(checked, face), checked)
    candidates = list_candidates(folds.pairs, method, choices)
    compared = compare_candidates(candidates, folds, in_mm=gram is not None, progress=progress)
    corrected, best = folds.corrected, compared.best
    progress(0.9, f"fitting {best.method.name}")
    fitted = best.method.fit(corrected.training_pairs(best.method), best.settings)
    progress(1.0, f"trained {best.method.name}")
    solver = _frame_solver(corrected, fitted, compared.out_of_fold)
    regions, error_arrays = _uncertainty(compared, folds, solver)
    arrays = fitted.arrays | motion_arrays(face.motion) | solver.to_arrays() | error_arrays
    arrays |= sides.to_arrays() | pose_arrays | pair_arrays
    if not best.method.solves_frames and (sides.signs < 0).any():
        arrays[JOINED_OUTPUTS] = np.ones(1)
    return TrainedMapping(
        method=best.method.name,
        marker_names=checked.marker_names,
        shape_names=references.shape_names,
        rigid=checked.rigid,
        neutral=checked.neutral.astype(np.float64),
        ranges=sides.limits,
        # As read from a file, so that the reopened mapping predicts the same.
        arrays={name: np.ascontiguousarray(each, np.float64) for name, each in arrays.items()},
        settings=fitted.settings
        | _region_settings(checked, folds, regions)
        | _key_settings(folds, checked, delays)
        | {"pair_takes": json.dumps(sorted(set(checked.takes)), ensure_ascii=False)}
        | {"pose_error_mm": pose_error_mm}
        | {"unobservable_shapes": int((~compared.observable).sum())},
        scores=compared.scores,
    )


def _face(
    references: References,
    checked: References,
    sides: ShapeSides,
    *,
    gram: FloatArray | None,
    skin: FloatArray | None,
    rest: RestPlaces | None,
) -> Face:
    """Return the face of a training; `checked` has the columns of `sides`."""
    skin, rest = _outer_skin(skin, rest, references)
    parts = checked.parts or checked.shape_names
    return Face(
        sides=sides,
        gram=np.eye(len(parts)) if gram is None else _skin_gram(sides.gram(gram), parts),
        motion=checked.motion if checked.motion is not None else motion_of_pairs(checked),
        skin=None if skin is None else sides.motion(skin[: len(sides.limits)]),
        lids=shapes_by_region(parts).get("lids"),
        driven=_driven_skin(references, skin),
        rest=rest,
        neutral=checked.neutral.astype(np.float64),
    )


def _key_delays(references: References, face: Face) -> FloatArray:
    """Return the delay of each pair's keys: (pairs,) [s]; see `find_key_delays`."""
    if references.trajectories is None or face.neutral is None:
        return np.zeros(len(references.weights))
    take = np.unique(references.takes, return_inverse=True)[1]
    take = np.where(references.tuned, take, -1)
    return find_key_delays(_pairs(references, face), references.trajectories, take)


def _remove_key_delays(references: References, delays: FloatArray) -> References:
    """Return the references with the markers of the times that their keys describe."""
    if references.trajectories is None or not delays.any():
        return references
    markers = references.markers + displacements_at(references.trajectories, -delays)
    return replace(references, markers=markers)


def _pair_arrays(references: References, offset: FloatArray) -> Arrays:
    """Return the pairs' frames and markers, by which their takes are aligned when mapped.

    Also the root mean square offset of each take. `offset`: of the markers of each pair's take.
    """
    take = np.unique(references.takes, return_inverse=True)[1]
    squared = (offset**2).sum(axis=2).mean(axis=1)
    return {
        "pair_frames": np.stack([take, references.frames], axis=1),
        "pair_markers": references.markers - offset,
        "take_offset_mm": np.sqrt(np.bincount(take, squared) / np.bincount(take)),
    }


def _remove_take_offsets(references: References, face: Face) -> References:
    """Remove the offsets of the takes' markers from the pairs; see `find_take_offsets`."""
    names = list(dict.fromkeys([references.neutral_take, *references.takes]))
    take = np.array([names.index(each) for each in references.takes])
    if not references.neutral_take or not take.any():
        return references
    offsets = find_take_offsets(fit_pairs_forward(_pairs(references, face), ForwardScales()), take)
    markers = references.markers - offsets[take]
    return replace(references, markers=markers.astype(references.markers.dtype))


def _remove_pose_errors(
    references: References, face: Face
) -> tuple[References, Face, Arrays, float]:
    """Remove errors of the takes' poses from the pairs and the motion space; see `pose_error`.

    Returns also the arrays with which they are removed from other takes, and the errors' size [mm].
    """
    if face.skin is None or face.neutral is None:
        return references, face, {}, 0.0
    markers, frames = references.markers, sampled_frames(face.motion)
    seen, all_seen = (np.ones(each.shape[:2], np.bool_) for each in (markers, frames))
    rigid = np.array([references.marker_names.index(name) for name in references.rigid], np.int64)
    for _ in range(_POSE_ROUNDS):
        pairs = _pairs(replace(references, markers=markers), face)
        expressions = expression_motion(
            fit_rig_prior(pairs).basis, face.normalise(pairs.outputs), face.neutral, rigid=rigid
        )
        errors = expressions.find_errors(frames, all_seen)
        markers = errors.remove(references.markers, seen)
        if not errors.size_mm:
            break
    return (
        replace(references, markers=markers),
        replace(face, motion=motion_without_errors(face.motion, errors)),
        expressions.to_arrays(),
        errors.size_mm,
    )


def _outer_skin(
    skin: FloatArray | None, rest: RestPlaces | None, references: References
) -> tuple[FloatArray | None, RestPlaces | None]:
    """Return the skin without tongue and eyeballs, the points that gaze moves most.

    Shapes of gaze and tongue that are at rest in all pairs have no motion: markers do not observe
    them, and the solve would let the eyes turn with the brows.
    """
    check_skin(skin, shapes=len(references.shape_names) + len(references.combinations))
    if skin is None:
        return skin, rest
    parts = references.parts or references.shape_names
    length = np.linalg.norm(skin, axis=2)
    gaze, tongue = gaze_shapes(parts), length[tongue_shapes(parts)].max(axis=0, initial=0)
    is_skin = length[gaze].max(axis=0, initial=0) <= np.delete(length, gaze, axis=0).max(axis=0)
    is_skin &= tongue <= _TONGUE_SHARE * tongue.max(initial=0)
    unobserved = gaze_and_tongue_shapes(parts)
    skin = skin.copy()
    skin[unobserved[~references.weights[:, unobserved].any(axis=0)]] = 0.0
    return skin[:, is_skin], None if rest is None else replace(rest, points=rest.points[is_skin])


def _pairs(references: References, face: Face) -> Pairs:
    markers = references.markers.astype(np.float64)
    coordinates = marker_coordinates(face.motion, markers)
    return Pairs(coordinates, references.weights, face, markers, authors=references.authors)


def _driven_skin(references: References, skin: FloatArray | None) -> DrivenSkin | None:
    logic = logic_of(references.shape_names, references.combinations)
    if skin is None or logic is None:
        return None
    return DrivenSkin(logic, skin[len(references.shape_names) :])


def _key_settings(
    folds: PairFolds, references: References, delays: FloatArray
) -> dict[str, float | str]:
    """Return what is known of the keys: errors, gains, delays, contradictions, and origin."""
    corrected = folds.corrected
    gains = mean_gains(corrected.log_factor, references.authors)
    late = {take: delay for take, delay in zip(references.takes, delays, strict=True) if delay}
    names = [f"{take} {n}" for take, n in zip(references.takes, references.frames, strict=True)]
    contradicted = find_contradicted(corrected.uncorrected, folds.parts).items()
    forgotten = find_forgotten(corrected.uncorrected, folds.parts).items()
    return {
        "pairs": len(references.weights),
        "performer": references.performer,
        "session": references.session,
        "key_error": corrected.scales.tau,
        "unset_keys": corrected.scales.unset,
        "gain_deviation": float(corrected.log_factor.std()),
        "author_gains": "; ".join(f"{author} {gain:.2f}" for author, gain in gains.items()),
        "key_delays": "; ".join(
            f"{take} ({abs(1000 * delay):.0f} ms {'late' if delay > 0 else 'early'})"
            for take, delay in late.items()
        ),
        "contradicted": "; ".join(
            f"{names[n]} ({region}, {residual:.1f} mm)" for n, (region, residual) in contradicted
        ),
        "forgotten": "; ".join(
            f"{region} in {first_few(names[n] for n in at)}" for region, at in forgotten
        ),
    }


def _frame_solver(
    corrected: CorrectedPairs, fitted: Fitted, predicted: OutOfFold | None
) -> FrameSolver:
    """Return the solver, with the error of the method's normalised weights."""
    ranges = corrected.pairs.face.ranges
    if "start_error" in fitted.arrays:
        error = fitted.arrays["start_error"]
    elif predicted is None:
        error = np.full(len(ranges), _DEFAULT_ERROR)
    else:
        error = np.sqrt((predicted.errors**2).mean(axis=0)) / np.ptp(ranges, axis=1)
    return FrameSolver(corrected.forward, error, corrected.inflation)


def _skin_gram(gram: FloatArray, parts: tuple[str, ...]) -> FloatArray:
    """Return a Gram matrix without gaze and tongue, which markers do not show."""
    skin_gram = gram.astype(np.float64)
    columns = gaze_and_tongue_shapes(parts)
    skin_gram[columns] = skin_gram[:, columns] = 0.0
    return skin_gram


def _uncertainty(
    compared: Comparison, folds: PairFolds, solver: FrameSolver
) -> tuple[tuple[str, ...], Arrays]:
    """Return the regions of the face, and the arrays of their uncertainty model."""
    face, parts = folds.pairs.face, folds.parts
    span = np.ptp(face.ranges, axis=1)
    points = region_points(parts, solver.forward.basis)
    regions = tuple(points)
    grams = region_grams(face.gram, face.skin, parts, regions)
    grams = np.stack([_skin_gram(each, parts) for each in grams]) * np.outer(span, span)
    model = UncertaintyModel(grams, np.ones(len(regions)))
    if face.rest is not None and face.rest.motion_scale is not None:
        model = replace(model, motion_scale=face.rest.motion_scale)
    calibration = np.full(len(regions), _DEFAULT_CALIBRATION)
    predicted = compared.out_of_fold
    if predicted is not None:
        deviations = folds.deviations(predicted, model, solver.error)
        calibration = calibrate_uncertainty(folds.squared_errors(predicted, grams), deviations)
    arrays = replace(model, calibration=calibration).to_arrays()
    arrays["region_markers"] = membership(points, len(solver.forward.noise))
    return regions, arrays


def _region_settings(
    references: References, folds: PairFolds, regions: tuple[str, ...]
) -> dict[str, str]:
    """Return the names of all regions, of those without markers or shapes, and of still ones.

    A still region is one that no reference moves: its motion in takes follows from the rig alone.
    """
    face, parts = folds.pairs.face, folds.parts
    shapes = shapes_by_region(parts)
    unmarked = regions_without_markers(parts, face, references.marker_names, references.rigid)
    used = np.ptp(face.normalise(folds.pairs.outputs), axis=0)
    still = [
        region
        for region in regions[1:]
        if region in shapes and region not in unmarked and used[shapes[region]].max() < _STILL_SHARE
    ]
    named = {"regions": regions, "still_regions": still, "unseen_regions": unmarked}
    shapeless = regions_without_shapes(parts, references.marker_names, references.rigid)
    if shapeless:
        named["shapeless_regions"] = shapeless
    return {name: ",".join(each) for name, each in named.items()}
