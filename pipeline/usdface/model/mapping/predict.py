"""Markers to weights: a mapping's prediction for every frame, and its expected error."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from usdface.core.arrays import BoolArray, Float32Array, FloatArray
from usdface.core.assets import TrainedMapping
from usdface.core.errors import InputError
from usdface.model.mapping.coordinates import marker_coordinates
from usdface.model.mapping.error_model import confidence_of, likely_error, predictive_variance
from usdface.model.mapping.head_space import MINIMUM_SHARE
from usdface.model.mapping.train import motion_of
from usdface.model.regressions import REMOVED_METHODS, find_method

_BLOCK_FRAMES = 1024
"""What is worked on stays near the processor: a quarter quicker than in large blocks."""


@dataclass(frozen=True)
class Prediction:
    """A mapping's answer.

    Attributes
    ----------
    weights : (frames, shapes) float array
        Within the mapping's ranges.
    confidence : (frames,) float array
        [0-1]: probability that the face is within the tolerance of what an animator would key
        (`train.SURFACE_TOLERANCE_MM`), times how much of the face's motion the
        markers seen determine.
    residual_mm : (frames,) float array
        Root mean square distance of the markers seen from anything the performer's takes showed
        [mm]: large where markers are swapped or the face does something new.
    regions : tuple of str
        Parts of the face, the whole first.
    region_confidence : (frames, regions) float array
    region_residual_mm : (frames, regions) float array
        0 where no marker of the region is seen [mm].
    region_error : (frames, regions) float array
        What the error stays below nine times in ten: in mm on the surface where training knew the
        rig, else in weights.
    few_markers : (frames,) bool array
        True where fewer than `head_space.MINIMUM_SHARE` of the mapping's markers are
        seen: the face is a guess there, and the confidence 0.
    """

    weights: FloatArray
    confidence: FloatArray
    residual_mm: FloatArray
    regions: tuple[str, ...]
    region_confidence: FloatArray
    region_residual_mm: FloatArray
    region_error: FloatArray
    few_markers: BoolArray


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
                f"the mapping was trained by {mapping.method}, which left the methods in this "
                "version; train again with auto"
            )
        self._mapping = mapping
        try:
            self._motion = motion_of(mapping)
            self._regions = regions_of(mapping)
            with np.errstate(all="ignore"):  # what is not finite is refused below
                self._predict = find_method(mapping.method).prepare(
                    mapping.arrays, mapping.settings
                )
                tried = self.predict(mapping.neutral[None])
        except (KeyError, ValueError, IndexError, TypeError) as error:
            raise InputError(
                f"the mapping's arrays do not fit its method, {mapping.method}: "
                f"{type(error).__name__}: {error}; train it again"
            ) from error
        if not all(np.isfinite(each).all() for each in (tried.weights, tried.region_error)):
            raise InputError(
                "the mapping predicts values that are not finite for its neutral face, by "
                f"{mapping.method}; its arrays are damaged: train it again"
            )

    def predict(
        self,
        positions: NDArray[np.float32] | NDArray[np.float64],
        *,
        visible: BoolArray | None = None,
    ) -> Prediction:
        """Evaluate the mapping on stabilised markers; see `predict_weights`."""
        mapping, arrays = self._mapping, self._mapping.arrays
        _check_positions(mapping, positions, visible)
        frames, regions = len(positions), len(self._regions)
        members = arrays["region_markers"].T
        weights = np.empty((frames, len(mapping.shape_names)))
        confidence, residual, error = (np.empty((frames, regions)) for _ in range(3))
        for start in range(0, frames, _BLOCK_FRAMES):
            part = slice(start, start + _BLOCK_FRAMES)
            found = marker_coordinates(
                self._motion, positions[part], visible=None if visible is None else visible[part]
            )
            raw = self._predict(found.values)
            np.clip(raw, mapping.ranges[:, 0], mapping.ranges[:, 1], out=weights[part])
            left = predictive_variance(arrays, found.values)
            confidence[part] = confidence_of(arrays, left) * found.certainty[:, None]
            error[part] = likely_error(arrays, left) * arrays["region_tolerance"]
            residual[part] = _by_region(found.away_mm, members)
        few_markers = _has_few_markers(frames, visible)
        confidence[few_markers] = 0.0
        return Prediction(
            weights,
            confidence[:, 0],
            residual[:, 0],
            self._regions,
            confidence,
            residual,
            error,
            few_markers,
        )


def predict_weights(
    mapping: TrainedMapping,
    positions: NDArray[np.float32] | NDArray[np.float64],
    *,
    visible: BoolArray | None = None,
) -> Prediction:
    """Evaluate a mapping on stabilised markers.

    Parameters
    ----------
    positions : (frames, markers, 3) float array
        In the mapping's marker order and head space [mm]; see `into_head_space`.
    visible : (frames, markers) bool array, optional
        False where a position is not to be used; it is then estimated from the others, and the
        confidence falls; to 0 where too few are left. By default all are used.

    Raises
    ------
    InputError
        If shapes do not fit the mapping, or a position to be used is not finite.
    """
    return WeightPredictor(mapping).predict(positions, visible=visible)


def _has_few_markers(frames: int, visible: BoolArray | None) -> BoolArray:
    """Return the frames that see too few markers: what a whole take is refused for."""
    if visible is None:
        return np.zeros(frames, dtype=np.bool_)
    few: BoolArray = visible.sum(axis=1) < MINIMUM_SHARE * visible.shape[1]
    return few


def _by_region(away_mm: Float32Array, members: FloatArray) -> FloatArray:
    """Root mean square over each region's markers seen; 0 where there are none."""
    seen = np.isfinite(away_mm)
    if seen.all():
        counts = members.sum(axis=0)
    else:
        away_mm, counts = np.where(seen, away_mm, 0.0), seen @ members
    mean: FloatArray = np.square(away_mm).astype(np.float64) @ members
    mean /= np.maximum(counts, 1)
    return np.sqrt(mean, out=mean)


def regions_of(mapping: TrainedMapping) -> tuple[str, ...]:
    """Return the parts of the face that a mapping tells residual and confidence for.

    Raises
    ------
    InputError
        If the mapping was trained before there were any.
    """
    needed = ("region_markers", "region_tolerance", "familiar_error")
    missing = [name for name in needed if name not in mapping.arrays]
    if missing or "regions" not in mapping.settings:
        raise InputError(
            f"the mapping lacks {', '.join(missing) or 'its regions'}; train it again with this "
            "version"
        )
    return tuple(str(mapping.settings["regions"]).split(","))


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
