"""Markers to weights: a mapping's prediction for every frame, and its expected error."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from usdface.core.arrays import BoolArray, Float32Array, FloatArray, IntArray
from usdface.core.assets import Rig, SolveBasis, TrainedMapping
from usdface.core.errors import InputError
from usdface.model.mapping.coverage import CoverageModel
from usdface.model.mapping.head_space import MINIMUM_SHARE
from usdface.model.mapping.motion_space import marker_coordinates, motion_of
from usdface.model.mapping.rig_match import changed_shapes
from usdface.model.mapping.uncertainty import UncertaintyModel
from usdface.model.regressions import REMOVED_METHODS, find_method
from usdface.model.regressions.base import bend, unbend
from usdface.model.regressions.frame_solve import FrameSolution, FrameSolver
from usdface.numerics.regression.usage_prior import expected_weights

_BLOCK_FRAMES = 1024
"""What is worked on stays near the processor: a quarter quicker than in large blocks."""


_SOLVED_FRAMES = 64
"""Frames solved at once: each has a matrix of its own."""

_MEASURED_CONFIDENCE = 0.9
"""From which a sample counts as measured: where it was filled, one was seen within a twentieth of a
second. Most frames of a take have such a sample, which hardly counts and would cost."""


@dataclass(frozen=True)
class Prediction:
    """A mapping's answer."""

    weights: FloatArray
    """(frames, shapes): within the mapping's ranges."""
    uncertainty: FloatArray
    """(frames, regions): standard deviation of each region's surface around what an animator would
    key: in mm where training knew the rig, else in weights. See `uncertainty`."""
    coverage: FloatArray
    """(frames, regions): how far the references show what the frame does [0-1]; see `coverage`."""
    residual_mm: FloatArray
    """(frames, regions): root mean square distance of the markers seen from where the weights
    put them, less what is left at the references themselves [mm]: large where markers are
    swapped or the face does something that the weights do not follow. 0 where no marker of the
    region is seen."""
    regions: tuple[str, ...]
    """Parts of the face, the whole first."""
    left_mm: Float32Array
    """(frames, markers, 3): markers minus where the weights put them; 0 where unseen [mm]."""
    few_markers: BoolArray
    """(frames,): true where fewer than `head_space.MINIMUM_SHARE` of the mapping's markers are
    seen: the face is a guess there."""


class WeightPredictor:
    """A mapping made ready for many frames; safe to use from several threads.

    Raises
    ------
    InputError
        If its method is one of earlier versions, or arrays are missing or do not fit each other:
        one frame is tried.
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
            self._regions = regions_of(mapping)
            self._solver = FrameSolver.from_arrays(mapping.arrays)
            self._uncertainty = UncertaintyModel.from_arrays(mapping.arrays)
            self._members = mapping.arrays["region_markers"]
            self._coverage = _coverage_of(self._solver, self._members)
            self._method = find_method(mapping.method)
            self._driving = self._find_driving()
            with np.errstate(all="ignore"):  # what is not finite is refused below
                self._predict = self._method.prepare(mapping.arrays, mapping.settings)
                tried = self.predict(mapping.neutral[None])
        except (KeyError, ValueError, IndexError, TypeError) as error:
            raise InputError(
                f"the mapping's arrays do not fit its method, {mapping.method}: "
                f"{type(error).__name__}: {error}; train it again"
            ) from error
        if not all(np.isfinite(each).all() for each in (tried.weights, tried.uncertainty)):
            raise InputError(
                "the mapping predicts values that are not finite for its neutral face, by "
                f"{mapping.method}; its arrays are damaged: train it again"
            )

    def predict(
        self,
        positions: NDArray[np.float32] | NDArray[np.float64],
        *,
        visible: BoolArray | None = None,
        confidence: Float32Array | None = None,
    ) -> Prediction:
        """Evaluate the mapping on stabilised markers; see `predict_weights`."""
        mapping = self._mapping
        _check_positions(mapping, positions, visible)
        frames, regions = len(positions), len(self._regions)
        weights = np.empty((frames, len(mapping.shape_names)))
        residual, uncertainty, coverage = (np.empty((frames, regions)) for _ in range(3))
        left = np.empty((frames, len(mapping.marker_names), 3), dtype=np.float32)
        for start in range(0, frames, _BLOCK_FRAMES):
            part = slice(start, start + _BLOCK_FRAMES)
            seen = None if visible is None else visible[part]
            found = marker_coordinates(self._motion, positions[part], visible=seen)
            sure = None if confidence is None else confidence[part]
            weights[part], uncertainty[part], left[part] = self._solve(
                found, positions[part], seen, sure
            )
            residual[part] = self._excess(left[part], seen)
            coverage[part] = self._coverage.measure(self._moved(positions[part], seen, found))
        few_markers = _has_few_markers(frames, visible)
        return Prediction(
            weights, uncertainty, coverage, residual, self._regions, left, few_markers
        )

    def _moved(
        self,
        positions: NDArray[np.float32] | NDArray[np.float64],
        visible: BoolArray | None,
        coordinates: FloatArray,
    ) -> FloatArray:
        """Return the displacement of all markers; unseen ones as the others let expect."""
        moved = np.asarray(positions - self._mapping.neutral, dtype=np.float64)
        if visible is not None and not visible.all():
            rows = np.flatnonzero(~visible.all(axis=1))
            expected = self._motion.mean + coordinates[rows] @ self._motion.components
            expected = expected.reshape(len(rows), -1, 3) - self._mapping.neutral
            moved[rows] = np.where(visible[rows, :, None], moved[rows], expected)
        return moved

    def _excess(self, left: Float32Array, visible: BoolArray | None) -> FloatArray:
        """Return what is left at each region's markers beyond what is at the references' [mm]."""
        seen = np.ones(left.shape[:2]) if visible is None else visible.astype(np.float64)
        squared = np.square(left).sum(axis=2, dtype=np.float64) - 3 * self._solver.residual_variance
        mean = (seen * squared) @ self._members.T / np.maximum(seen @ self._members.T, 1)
        return np.asarray(np.sqrt(np.maximum(mean, 0.0)))

    def _solve(
        self,
        coordinates: FloatArray,
        positions: NDArray[np.float32] | NDArray[np.float64],
        visible: BoolArray | None,
        confidence: Float32Array | None,
    ) -> tuple[FloatArray, FloatArray, Float32Array]:
        """Return weights, uncertainty (frames, regions), and what the weights leave over."""
        low, high = self._mapping.ranges.T
        weights = np.clip(self._predict(coordinates), low, high)
        if visible is None:
            visible = np.ones(positions.shape[:2], dtype=np.bool_)
        solver, curve = self._solver, self._solver.forward.scales.curve
        solves = self._method.solves_frames
        uncertainty = np.empty((len(weights), len(self._regions)))
        left = np.empty(positions.shape, dtype=np.float32)
        for first in range(0, len(weights), _SOLVED_FRAMES):
            rows = slice(first, first + _SOLVED_FRAMES)
            moved = positions[rows] - self._mapping.neutral
            start = bend((weights[rows] - low) / (high - low), curve)
            solution = solver.solve(moved, visible[rows], start, bounded=solves)
            estimated = len(self._driving) > 0 and solution.hessian is not None
            if estimated:
                start[:, self._driving] = self._expected(solution)
                solution = solver.solve(moved, visible[rows], start, bounded=False)
            if solves or estimated:
                solved = np.clip(unbend(solution.targets, curve), 0.0, 1.0)
                weights[rows] = low + (high - low) * solved
            left[rows] = solution.residual.reshape(-1, *left.shape[1:])
            uncertainty[rows] = self._uncertainty.deviations(solver, solution, visible[rows])
            if confidence is not None:
                sure = np.where(visible[rows], confidence[rows], 0.0)
                guessed = visible[rows] & (sure < _MEASURED_CONFIDENCE)
                some = np.flatnonzero(guessed.any(axis=1))
                if len(some):
                    doubted = solver.with_confidence(solution.take(some), start[some], sure[some])
                    seen = visible[rows][some]
                    uncertainty[first + some] = self._uncertainty.deviations(solver, doubted, seen)
        return weights, uncertainty, left

    def _find_driving(self) -> IntArray:
        """Return the shapes that drive combinations, where the method says less than is known.

        A method that solves frames has weighed its error already. In-betweens of a shape itself,
        which have one part and no span, are no combinations.
        """
        driven = self._solver.forward.driven
        if driven is None or self._method.solves_frames:
            return np.zeros(0, np.int64)
        combinations = [
            each for each in driven.logic.combinations if len(each.parts) > 1 or each.spans
        ]
        parts = {part for each in combinations for part in each.parts}
        known = driven.logic.shapes[: len(self._mapping.shape_names)]
        return np.flatnonzero([name in parts for name in known])

    def _expected(self, solution: FrameSolution) -> FloatArray:
        """Return the expected bent weights of `_driving`, as the references use them."""
        curve = self._solver.forward.scales.curve
        variance = np.einsum("fss->fs", solution.covariance(curve))[:, self._driving]
        keys, solved = (
            unbend(each[:, self._driving], curve)
            for each in (self._solver.forward.targets, solution.targets)
        )
        return bend(expected_weights(solved, np.sqrt(variance), keys), curve)


def predict_weights(
    mapping: TrainedMapping,
    positions: NDArray[np.float32] | NDArray[np.float64],
    *,
    visible: BoolArray | None = None,
    confidence: Float32Array | None = None,
) -> Prediction:
    """Evaluate a mapping on stabilised markers.

    Parameters
    ----------
    positions : (frames, markers, 3) float array
        In the mapping's marker order and head space [mm]; see `into_head_space`.
    visible : (frames, markers) bool array, optional
        False where a position is not to be used; it is then estimated from the others, and the
        uncertainty grows. By default all are used.
    confidence : (frames, markers) float array, optional
        Of positions that are used [0-1]: those of filled gaps count for the weights as others do,
        and for the uncertainty as far as they are known. By default they are measured.
    """
    return WeightPredictor(mapping).predict(positions, visible=visible, confidence=confidence)


def _coverage_of(solver: FrameSolver, membership: FloatArray) -> CoverageModel:
    """Return what the references show: where the forward model puts their markers."""
    packed, _ = solver.linearise(solver.forward.targets.astype(np.float32))
    shown = packed.reshape(len(packed), -1, 3).astype(np.float64)
    return CoverageModel(solver.forward.basis, shown, membership)


def _has_few_markers(frames: int, visible: BoolArray | None) -> BoolArray:
    """Return the frames that see too few markers: what a whole take is refused for."""
    if visible is None:
        return np.zeros(frames, dtype=np.bool_)
    few: BoolArray = visible.sum(axis=1) < MINIMUM_SHARE * visible.shape[1]
    return few


def regions_of(mapping: TrainedMapping) -> tuple[str, ...]:
    """Return the parts of the face that a mapping tells residual and uncertainty for.

    Raises
    ------
    InputError
        If the mapping was trained before there were any.
    """
    needed = ("region_markers", "uncertainty_calibration", "forward_basis")
    missing = [name for name in needed if name not in mapping.arrays]
    if missing or "regions" not in mapping.settings:
        raise InputError(
            f"the mapping lacks {', '.join(missing) or 'its regions'}; train it again with this "
            "version"
        )
    return tuple(str(mapping.settings["regions"]).split(","))


def basis_of(mapping: TrainedMapping, rig: Rig) -> SolveBasis | None:
    """Return what a mapping learnt of a rig; None where an earlier version trained it."""
    settings = mapping.settings
    if "tuned" not in settings or "pairs" not in settings:
        return None
    still, unseen = (str(settings.get(f"{each}_regions", "")) for each in ("still", "unseen"))
    return SolveBasis(
        pairs=int(settings["pairs"]),
        tuned=int(settings["tuned"]),
        still_regions=tuple(filter(None, still.split(","))),
        unseen_regions=tuple(filter(None, unseen.split(","))),
        changed_shapes=changed_shapes(mapping, rig),
    )


def _check_positions(
    mapping: TrainedMapping,
    positions: NDArray[np.float32] | NDArray[np.float64],
    visible: BoolArray | None,
) -> None:
    markers = len(mapping.marker_names)
    if positions.ndim != 3 or positions.shape[1:] != (markers, 3):
        raise InputError(
            f"positions have shape {positions.shape}, the mapping reads (frames, {markers}, 3); "
            "bring the take's markers into the mapping's order first"
        )
    if visible is not None and visible.shape != positions.shape[:2]:
        raise InputError(f"visible has shape {visible.shape}, positions {positions.shape}")
    if np.isfinite(positions.sum()):
        return  # one sum tells of all: what is not finite stays so
    bad = ~np.isfinite(positions).all(axis=2)
    if visible is not None:
        bad &= visible
    if bad.any():
        frame, marker = np.argwhere(bad)[0]
        raise InputError(
            f"marker {mapping.marker_names[marker]} of frame index {frame} is not finite; "
            "clean the take, or mark it as not visible"
        )
