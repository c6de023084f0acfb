"""What a review judges: weights over a shot's frames, and how far each is off."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from usdface.core.arrays import FloatArray, IntArray
from usdface.core.assets import Rig
from usdface.core.errors import InputError
from usdface.media.picture.error_strip import ErrorCurve
from usdface.model.selection.baseline import BlendshapeEquation, set_up_equation
from usdface.steps.inputs.weight_tables import read_weight_table
from usdface.steps.review.pictures import Shot


@dataclass(frozen=True)
class Score:
    """Weights over the frames that a sheet may show, and their error.

    Attributes
    ----------
    label : str
    weights : (frames, shapes) float array
        In the rig's order.
    error_mm : (frames,) float array
        NaN where it is not known.
    against_truth : bool
        Whether the error is one of the surface; else it is what markers leave unexplained.
    """

    label: str
    weights: FloatArray
    error_mm: FloatArray
    against_truth: bool = False


def set_up_shot_baseline(shot: Shot) -> BlendshapeEquation:
    """Bind a shot's markers to its rig, as the equation-solving baseline needs them."""
    take, markers = shot.take, shot.take.markers
    if markers is None:
        raise InputError(f"{take.name}: has no markers")
    row = min(max(markers.neutral_frame - take.first_frame, 0), take.frame_count - 1)
    return set_up_equation(
        shot.rig,
        shot.deformer,
        neutral=markers.positions[row].astype(np.float64),
        positions=markers.positions,
        visible=markers.visible | (markers.confidence > 0),
        rigid=tuple(markers.names.index(name) for name in markers.rigid),
    )


def read_keys(file: Path | None, rig: Rig, frames: IntArray) -> FloatArray | None:
    """Return what the weights should have been; NaN at frames the file does not have."""
    if file is None:
        return None
    table = read_weight_table(file)
    if not set(table.names) & set(rig.shapes):
        raise InputError(f"{file}: names none of the rig's shapes; is it the right file?")
    row_of = {frame: row for row, frame in enumerate(table.frames)}
    known = table.columns(rig.shapes)
    truth = np.full((len(frames), len(rig.shapes)), np.nan)
    for index, frame in enumerate(frames.tolist()):
        if frame in row_of:
            truth[index] = known[row_of[frame]]
    if np.isnan(truth).all():
        raise InputError(f"{file}: has none of the frames {frames[0]}-{frames[-1]}")
    return truth


def score(
    label: str,
    shot: Shot,
    weights: FloatArray,
    truth: FloatArray | None,
    equation: BlendshapeEquation,
) -> Score:
    """Measure weights on the surface where the truth is known, else by the markers."""
    if truth is None:
        return Score(label, weights, equation.residual_mm(shot.positions, weights))
    return Score(label, weights, surface_distance(shot, weights - truth), against_truth=True)


def surface_distance(shot: Shot, difference: FloatArray) -> FloatArray:
    """Return the RMS distance of the surface that differences of weights make, (frames,) [mm]."""
    squared = np.einsum("fs,st,ft->f", difference, shot.deformer.shapes.gram(), difference)
    return np.asarray(np.sqrt(np.maximum(squared, 0.0)))


def uncertainty_curves(shot: Shot) -> tuple[ErrorCurve, ...]:
    """Return how little the performance trusts itself, 1 less its confidence; none if unknown."""
    confidence = shot.performance.confidence
    if confidence is None:
        return ()
    own = confidence[shot.frames - shot.performance.weights.first_frame]
    return (ErrorCurve("doubt", 1.0 - np.asarray(own, np.float64), high=1.0, unit=""),)
