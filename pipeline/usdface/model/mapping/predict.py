"""Prediction of a mapping: weights of each frame from its markers, with their uncertainty."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from usdface.core.arrays import BoolArray, Float32Array, FloatArray, RealArray, frame_blocks
from usdface.core.assets import Rig, SolveBasis, TrainedMapping
from usdface.core.errors import InputError
from usdface.model.mapping.coverage import CoverageModel
from usdface.model.mapping.head_space import MINIMUM_SHARE
from usdface.model.mapping.motion_space import frames_at, marker_coordinates, motion_of
from usdface.model.mapping.rig_match import changed_shapes
from usdface.model.mapping.uncertainty import UncertaintyModel
from usdface.model.regressions import REMOVED_METHODS, find_method
from usdface.model.regressions.bent_weights import unbend
from usdface.model.regressions.forward_model import ForwardModel
from usdface.model.regressions.frame_solve import FrameSolver
from usdface.model.regressions.shape_sides import JOINED_OUTPUTS, ShapeSides

_BLOCK_FRAMES = 1024
"""Frames per block: a block fits in the cache, which is 25 % faster than larger ones."""

_SOLVED_FRAMES = 128
"""Frames per call of the solver, each with a Jacobian and a Hessian: 8 MB at 102 markers."""

_MISSING_SHARE = 0.9
"""A region is unseen if the take lacks the markers of more than this share of its markers' squared
motion: those of its neighbours follow it a little."""


@dataclass(frozen=True)
class Prediction:
    """Predicted weights, with measures of their quality by region."""

    weights: FloatArray
    """(frames, shapes): within the mapping's ranges."""
    uncertainty: FloatArray
    """(frames, regions): standard deviation of the error of each region's surface with respect to
    keys: in mm if trained with a rig, else in weights. See `uncertainty`."""
    coverage: FloatArray
    """(frames, regions): see `coverage` [0-1]."""
    residual_mm: FloatArray
    """(frames, regions): root mean square residual of the visible markers, in excess of that of the
    references [mm]: large if markers are swapped, or the weights cannot represent the motion. 0
    where no marker of the region is visible."""
    regions: tuple[str, ...]
    """Regions of the face, the whole face first."""
    residuals_mm: Float32Array
    """(frames, markers, 3): residual, the displacement of a marker minus the forward model's; 0
    where it is not visible [mm]."""
    few_markers: BoolArray
    """(frames,): True where fewer than `head_space.MINIMUM_SHARE` of the mapping's markers are
    visible: too few for a prediction."""


class WeightPredictor:
    """Predictor of a mapping, prepared for many frames; safe to use from several threads.

    Raises
    ------
    InputError
        If its method was removed, or a trial prediction shows that arrays are missing or do not fit
        each other.
    """

    def __init__(self, mapping: TrainedMapping) -> None:
        if mapping.method in REMOVED_METHODS:
            raise InputError(
                f"the mapping was trained by {mapping.method}, which was removed in this "
                "version; train again with auto"
            )
        self._mapping = mapping
        try:
            self._motion = motion_of(mapping)
            self._sides = ShapeSides.from_arrays(mapping.arrays, mapping.ranges)
            self._regions = regions_of(mapping)
            self._solver = FrameSolver.from_arrays(mapping.arrays)
            self._uncertainty = UncertaintyModel.from_arrays(mapping.arrays)
            self._region_markers = mapping.arrays["region_markers"]
            # Coverage by the references, with the forward model's displacements.
            packed, _ = self._solver.linearise(self._solver.forward.targets.astype(np.float32))
            pairs = packed.reshape(len(packed), -1, 3).astype(np.float64)
            self._coverage = CoverageModel(self._solver.forward.basis, pairs, self._region_markers)
            self._method = find_method(mapping.method)
            with np.errstate(all="ignore"):  # values that are not finite are refused below
                joined = JOINED_OUTPUTS in mapping.arrays
                self._prior = self._method.prepare_prior(
                    mapping.arrays,
                    mapping.settings,
                    sides=self._sides if joined else ShapeSides.undivided(self._sides.ranges),
                    curve=self._solver.forward.scales.curve,
                )
                trial = self.predict(mapping.neutral[None])
        except (KeyError, ValueError, IndexError, TypeError) as error:
            raise InputError(
                f"the mapping's arrays do not fit its method, {mapping.method}: "
                f"{type(error).__name__}: {error}; train it again"
            ) from error
        if not all(np.isfinite(each).all() for each in (trial.weights, trial.uncertainty)):
            raise InputError(
                "the mapping predicts values that are not finite for its neutral face, by "
                f"{mapping.method}; its arrays are damaged: train it again"
            )

    def predict(
        self,
        positions: RealArray,
        *,
        visible: BoolArray | None = None,
        confidence: Float32Array | None = None,
    ) -> Prediction:
        """Predict weights from stabilised markers.

        Parameters
        ----------
        positions : (frames, markers, 3) float array
            In the mapping's marker order and head space [mm]; see `find_head_space`.
        visible : (frames, markers) bool array, optional
            False where a position is ignored: it is estimated from the others, and the uncertainty
            is larger. By default all are visible.
        confidence : (frames, markers) float array, optional
            Confidence in visible positions [0-1], less than 1 in filled gaps. It affects the
            uncertainty, not the weights. By default 1.

        Raises
        ------
        InputError
            If shapes do not fit, or a visible position is not finite.
        """
        mapping = self._mapping
        seen = np.ones(positions.shape[:2], np.bool_) if visible is None else visible
        _check_positions(mapping, positions, seen)
        frames, regions = len(positions), len(self._regions)
        weights = np.empty((frames, len(mapping.shape_names)))
        residual_mm, uncertainty, coverage = (np.empty((frames, regions)) for _ in range(3))
        residual = np.empty((frames, len(mapping.marker_names), 3), dtype=np.float32)
        for block in frame_blocks(frames, frames=_BLOCK_FRAMES):
            block_confidence = None if confidence is None else confidence[block]
            coordinates = marker_coordinates(self._motion, positions[block], visible=seen[block])
            displacements = self._displacements(positions[block], seen[block], coordinates)
            columns, uncertainty[block], residual[block] = self._solve(
                coordinates, displacements, seen[block], block_confidence
            )
            weights[block] = self._sides.join(columns)
            residual_mm[block] = self._excess_residual(residual[block], seen[block])
            coverage[block] = self._coverage.measure(displacements)
        few_markers = seen.sum(axis=1) < MINIMUM_SHARE * seen.shape[1]
        return Prediction(
            weights, uncertainty, coverage, residual_mm, self._regions, residual, few_markers
        )

    def _displacements(
        self, positions: RealArray, visible: BoolArray, coordinates: FloatArray
    ) -> FloatArray:
        """Return the displacements of all markers, conditional means where they are not visible."""
        displacements = np.asarray(positions - self._mapping.neutral, dtype=np.float64)
        if not visible.all():
            rows = np.flatnonzero(~visible.all(axis=1))
            expected = frames_at(self._motion, coordinates[rows]) - self._mapping.neutral
            displacements[rows] = np.where(visible[rows, :, None], displacements[rows], expected)
        return displacements

    def _excess_residual(self, residual: Float32Array, visible: BoolArray) -> FloatArray:
        """Return the root mean square residual of each region beyond that of references [mm]."""
        seen = visible.astype(np.float64)
        squared = np.square(residual).sum(axis=2, dtype=np.float64)
        squared -= 3 * self._solver.residual_variance
        counts = np.maximum(seen @ self._region_markers.T, 1)
        mean = (seen * squared) @ self._region_markers.T / counts
        return np.asarray(np.sqrt(np.maximum(mean, 0.0)))

    def _solve(
        self,
        coordinates: FloatArray,
        displacements: FloatArray,
        visible: BoolArray,
        confidence: Float32Array | None,
    ) -> tuple[FloatArray, FloatArray, Float32Array]:
        """Return weights, uncertainty and residuals.

        (frames, columns of `ShapeSides`), (frames, regions) and (frames, markers, 3).
        """
        low, high = self._sides.ranges.T
        solver, curve = self._solver, self._solver.forward.scales.curve
        solves = self._method.solves_frames
        prior_mean, deviation = self._prior(coordinates, displacements)
        weights = np.empty_like(prior_mean)
        uncertainty = np.empty((len(weights), len(self._regions)))
        residual = np.empty(displacements.shape, dtype=np.float32)
        for rows in frame_blocks(len(weights), frames=_SOLVED_FRAMES):
            moved, seen, mean = displacements[rows], visible[rows], prior_mean[rows]
            error = None if deviation is None else deviation[rows]
            known = None if confidence is None else confidence[rows]
            solution = solver.solve(moved, seen, mean, error, bounded=solves, confidence=known)
            solved = np.clip(unbend(solution.targets, curve), 0.0, 1.0)
            weights[rows] = low + (high - low) * solved
            residual[rows] = solution.residual.reshape(-1, *residual.shape[1:])
            uncertainty[rows] = self._uncertainty.deviations(solver, solution, seen)
        return weights, uncertainty, residual


def regions_of(mapping: TrainedMapping) -> tuple[str, ...]:
    """Return the regions for which a mapping predicts residual and uncertainty.

    Raises
    ------
    InputError
        If the mapping was trained by a version without regions.
    """
    needed = ("region_markers", "uncertainty_calibration", "forward_basis")
    missing = [name for name in needed if name not in mapping.arrays]
    if missing or "regions" not in mapping.settings:
        raise InputError(
            f"the mapping lacks {', '.join(missing) or 'its regions'}; train it again with this "
            "version"
        )
    return tuple(str(mapping.settings["regions"]).split(","))


def basis_of(
    mapping: TrainedMapping, rig: Rig, *, missing: Sequence[str] = ()
) -> SolveBasis | None:
    """Return the basis of a take's solve on a rig; None if an earlier version trained the mapping.

    `missing`: markers of the mapping that the take lacks.
    """
    settings = mapping.settings
    if "tuned" not in settings or "pairs" not in settings:
        return None
    still, unmarked, shapeless = (
        tuple(filter(None, str(settings.get(f"{each}_regions", "")).split(",")))
        for each in ("still", "unseen", "shapeless")
    )
    regions, is_missing = regions_of(mapping), np.isin(mapping.marker_names, missing)
    motion2 = ForwardModel.from_arrays(mapping.arrays).motion2 * mapping.arrays["region_markers"]
    unseen = motion2 @ is_missing > _MISSING_SHARE * motion2.sum(axis=1)
    unmarked += tuple(
        region
        for region, is_unseen in zip(regions, unseen, strict=True)
        if is_unseen and region not in unmarked
    )
    return SolveBasis(
        pairs=int(settings["pairs"]),
        tuned=int(settings["tuned"]),
        still_regions=still,
        regions_without_markers=unmarked,
        regions_without_shapes=shapeless,
        changed_shapes=changed_shapes(mapping, rig),
        motion_scale=UncertaintyModel.from_arrays(mapping.arrays).motion_scale,
    )


def _check_positions(mapping: TrainedMapping, positions: RealArray, visible: BoolArray) -> None:
    markers = len(mapping.marker_names)
    if positions.ndim != 3 or positions.shape[1:] != (markers, 3):
        raise InputError(
            f"positions have shape {positions.shape}, the mapping reads (frames, {markers}, 3); "
            "bring the take's markers into the mapping's order first"
        )
    if visible.shape != positions.shape[:2]:
        raise InputError(f"visible has shape {visible.shape}; give {positions.shape[:2]}")
    if np.isfinite(positions.sum()):
        return  # a sum with a non-finite term is not finite
    bad = visible & ~np.isfinite(positions).all(axis=2)
    if bad.any():
        frame, marker = np.argwhere(bad)[0]
        raise InputError(
            f"marker {mapping.marker_names[marker]} of frame index {frame} is not finite; "
            "clean the take, or mark it as not visible"
        )
