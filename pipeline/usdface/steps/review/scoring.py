"""What a review judges: weights over a shot's frames, and how far each is off."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from usdface.core.arrays import BoolArray, FloatArray, IntArray, index_of
from usdface.core.assets import Rig
from usdface.core.errors import InputError
from usdface.media.picture.error_strip import ErrorCurve
from usdface.model.selection.baseline import BlendshapeEquation
from usdface.specs.review import FramePick
from usdface.steps.inputs.placement import placed_equation, placement_of_performance
from usdface.steps.inputs.weight_tables import read_weight_table
from usdface.steps.review.shot import Shot

_BASELINE_FRAMES = 20_000
"""Frames at which a long shot's baseline is solved: more than a sheet's curve can show."""


@dataclass(frozen=True)
class Score:
    """Weights over the frames that a sheet may show, and their error.

    Attributes
    ----------
    weights : (frames, shapes) float array
        In the rig's order.
    error_mm : (frames,) float array
        NaN where it is not known.
    against_truth : bool
        Whether the error is one of the surface; else it is the residual of the markers.
    """

    label: str
    weights: FloatArray
    error_mm: FloatArray
    against_truth: bool = False


def set_up_shot_baseline(shot: Shot) -> BlendshapeEquation:
    """Bind a shot's markers to its rig, as the baseline needs them."""
    take, markers = shot.take, shot.take.markers
    if markers is None:
        raise InputError(f"{take.name}: has no markers")
    frame = shot.performance.neutral_frame  # where the take's own is not neutral, another
    if frame is None:
        frame = markers.neutral_frame
    row = min(max(frame - take.first_frame, 0), take.frame_count - 1)
    return placed_equation(
        placement_of_performance(shot.performance_file, shot.rig),
        shot.rig,
        shot.deformer,
        neutral=markers.positions[row].astype(np.float64),
        positions=markers.positions,
        visible=markers.visible | (markers.confidence > 0),
        rigid=tuple(markers.names.index(name) for name in markers.rigid),
        labels=markers.names,
    )


def solve_baseline(equation: BlendshapeEquation, shot: Shot, rows: IntArray) -> FloatArray:
    """Solve a shot as `select` proposes weights, but for lips that touch: (frames, shapes).

    Parameters
    ----------
    rows : (n,) int array
        Rows that are shown. In a long shot the others hold the weights of a row shortly before.
    """
    positions = shot.positions
    step = -(-len(positions) // _BASELINE_FRAMES)
    weights = np.repeat(equation.propose(positions[::step]), step, axis=0)[: len(positions)]
    if step > 1:
        weights[rows] = equation.propose(positions[rows])
    return weights


def read_keys(file: Path | None, rig: Rig, frames: IntArray) -> FloatArray | None:
    """Return what the weights should have been; NaN at frames the file does not have."""
    if file is None:
        return None
    table = read_weight_table(file)
    if not set(table.names) & set(rig.shapes):
        raise InputError(f"{file}: names none of the rig's shapes; is it the right file?")
    row_of = index_of(table.frames)
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
    """Return the uncertainty of the solve; none if unknown."""
    uncertainty = shot.face_uncertainty_mm()
    return () if uncertainty is None else (ErrorCurve("uncertainty", uncertainty),)


WORST_SHARE = 6
"""Among expressions, one frame in so many is a worst one."""


@dataclass(frozen=True)
class ChosenFrame:
    """A row of the shot, and why it was chosen; empty where it shows what the face does."""

    row: int
    reason: str = ""


def choose_frames(
    pick: FramePick,
    count: int,
    *,
    strength: FloatArray,
    error_mm: FloatArray,
    uncertainty_mm: FloatArray | None,
    jump_mm: FloatArray,
) -> list[ChosenFrame]:
    """Choose frames, in order of time and spread over it.

    Parameters
    ----------
    pick : {'expression', 'residual', 'uncertainty', 'jump', 'even'}
        What makes a frame worth it; ``'expression'`` takes some of the largest errors too.
    count : int
        Fewer where there are fewer frames, or fewer whose error is known, of the worst.
    strength : (frames,) float array
        How far the face is from neutral.
    error_mm : (frames,) float array
        NaN where it is not known.
    uncertainty_mm : (frames,) float array or None
        Without it, `error_mm` stands in.
    jump_mm : (frames,) float array
        How far the surface moved since the frame before.
    """
    frames = len(strength)
    count = min(count, frames)
    apart = max(frames // (3 * count), 1)
    known = np.isfinite(error_mm)
    error = np.where(known, error_mm, -1.0)
    if pick == "even":
        spread = np.unique(np.linspace(0, frames - 1, count).round().astype(np.int64))
        return [ChosenFrame(row) for row in spread.tolist()]
    if pick == "expression":
        worst = min(count // WORST_SHARE, count - 1)
        chosen = _strongest(strength, count - worst, apart)
        rows = _largest(error, count, apart, taken=chosen)
        found = [ChosenFrame(row) for row in chosen]
        found += [ChosenFrame(row, "worst" if known[row] else "") for row in rows]
    elif pick == "uncertainty" and uncertainty_mm is not None:
        rows = _largest(uncertainty_mm, count, apart)
        found = [ChosenFrame(row, f"uncertainty {uncertainty_mm[row]:.2f} mm") for row in rows]
    elif pick == "jump":
        rows = _largest(jump_mm, count, apart)
        found = [ChosenFrame(row, f"moved {jump_mm[row]:.2f} mm") for row in rows]
    else:
        rows = _largest(error, count, apart, among=known if known.any() else None)
        found = [
            ChosenFrame(row, f"error {error[row]:.2f} mm" if known[row] else "") for row in rows
        ]
    return sorted(found, key=lambda frame: frame.row)


def _strongest(strength: FloatArray, count: int, apart: int) -> list[int]:
    """Return the strongest row of each of so many stretches of time."""
    chosen: list[int] = []
    for stretch in np.array_split(np.arange(len(strength)), count):
        free = [row for row in stretch if all(abs(row - other) >= apart for other in chosen)]
        chosen.append(int(max(free or stretch, key=lambda row: strength[row])))
    return chosen


def _largest(
    values: FloatArray,
    count: int,
    apart: int,
    *,
    taken: list[int] | None = None,
    among: BoolArray | None = None,
) -> list[int]:
    """Return rows by falling value, none near another or one that is taken, up to `count` of both.

    One bad moment is one row, not all of them; where the shot is too short for that, rows that are
    near others fill up.
    """
    known = list(taken or ())
    chosen: list[int] = []
    blocked = np.zeros(len(values), bool)
    for row in known:
        blocked[max(row - apart + 1, 0) : row + apart] = True
    order = np.argsort(-values, kind="stable")
    if among is not None:
        order = order[among[order]]
    for row in order.tolist():
        if len(known) + len(chosen) >= count:
            return chosen
        if not blocked[row]:
            chosen.append(row)
            blocked[max(row - apart + 1, 0) : row + apart] = True
    left = [row for row in order.tolist() if row not in {*known, *chosen}]
    return chosen + left[: max(count - len(known) - len(chosen), 0)]
