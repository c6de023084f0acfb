"""Markers to weights: what a mapping says about every frame, and how sure it can be."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from usdface.assets import BoolArray, FloatArray, Mapping
from usdface.errors import InputError
from usdface.model.coordinates import marker_coordinates
from usdface.model.familiarity import familiarity
from usdface.model.methods import find_method
from usdface.model.train import motion_of

BLOCK_FRAMES = 4096


@dataclass(frozen=True)
class Prediction:
    """A mapping's answer.

    Attributes
    ----------
    weights : (frames, shapes) float array
        Within the mapping's ranges.
    confidence : (frames,) float array
        [0-1]: how well the references cover the frame, times how much of the face's motion the
        markers seen determine.
    residual_mm : (frames,) float array
        Root mean square distance of the markers seen from anything the performer's takes showed
        [mm]: large where markers are swapped or the face does something new.
    """

    weights: FloatArray
    confidence: FloatArray
    residual_mm: FloatArray


def predict_weights(
    mapping: Mapping,
    positions: NDArray[np.float32] | NDArray[np.float64],
    *,
    visible: BoolArray | None = None,
) -> Prediction:
    """Evaluate a mapping on stabilised markers.

    Parameters
    ----------
    mapping : Mapping
    positions : (frames, markers, 3) float array
        In the mapping's marker order and head space [mm]; see `into_head_space`.
    visible : (frames, markers) bool array, optional
        False where a position is not to be used; the others then speak for it, and the
        confidence falls. By default all are used.

    Raises
    ------
    InputError
        If shapes do not fit the mapping, or a position to be used is not finite.
    """
    method = find_method(mapping.method)
    motion = motion_of(mapping)
    _check_positions(mapping, positions, visible)
    frames = len(positions)
    weights = np.empty((frames, len(mapping.shape_names)))
    confidence, residual = np.empty(frames), np.empty(frames)
    for start in range(0, frames, BLOCK_FRAMES):
        part = slice(start, start + BLOCK_FRAMES)
        found = marker_coordinates(
            motion, positions[part], visible=None if visible is None else visible[part]
        )
        raw = method.predict(mapping.arrays, mapping.settings, found.values)
        np.clip(raw, mapping.ranges[:, 0], mapping.ranges[:, 1], out=weights[part])
        confidence[part] = familiarity(mapping.arrays, found.values) * found.certainty
        residual[part] = found.residual_mm
    return Prediction(weights, confidence, residual)


def _check_positions(
    mapping: Mapping,
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
    bad = ~np.isfinite(positions).all(axis=2)
    if visible is not None:
        bad &= visible
    if bad.any():
        frame, marker = np.argwhere(bad)[0]
        raise InputError(
            f"marker {mapping.marker_names[marker]} of frame index {frame} is not finite; "
            "clean the take, or mark it as not visible"
        )
