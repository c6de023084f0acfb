"""Takes and a rig in one feature space, for selection and coverage."""

from dataclasses import dataclass

import numpy as np

from usdface.core.arrays import BoolArray, Float32Array, FloatArray, IntArray
from usdface.core.assets import MotionSpace, Rig
from usdface.core.deformer import Deformer
from usdface.core.progress import Progress
from usdface.model.mapping.motion_space import (
    fit_motion_space,
    frames_at,
    marker_coordinates,
    sampled_frames,
)
from usdface.model.placement.shape_parts import missing_parts_note, shape_parts
from usdface.model.selection.baseline import BlendshapeEquation, PerformerMarkers, proposed_weights
from usdface.model.selection.design import SelectionSpace, WeightProposals, selection_space
from usdface.specs.paths import frame_range
from usdface.steps.inputs.cleaned_takes import CleanedTakes
from usdface.steps.inputs.placement import placed_equation
from usdface.usdio.surface.placement import RigPlacement

USABLE_SHARE = 0.9
"""Share of the markers that a pair needs; it has the prediction of the others."""

_MOTION_FRAMES = 60_000
"""Frames used to fit the space of the motion."""

_BLOCK_FRAMES = 2048
"""Frames per block: a block fits in the processor's cache."""


@dataclass(frozen=True)
class SelectionScene:
    """Takes of a performer, a rig, and the space in which their frames are compared."""

    takes: CleanedTakes
    rig: Rig
    deformer: Deformer
    parts: tuple[str, ...]
    """Part of the face of each shape; see `shape_parts`."""
    motion: MotionSpace
    equation: BlendshapeEquation
    space: SelectionSpace
    features: Float32Array
    """(frames, d): of every frame of the takes; single precision, at half the memory and time,
    rounds far below the noise of markers."""
    proposals: WeightProposals

    @property
    def notes(self) -> list[str]:
        """Notes on the weights proposed or measured here."""
        lids = self.equation.lids
        note = "" if lids is None else lids.note(self.rig.shapes)
        return [each for each in (note, missing_parts_note(self.parts)) if each]

    def displacements(self, rows: IntArray) -> FloatArray:
        """Return the displacements of markers at rows of all takes, at the rig's size."""
        return self.equation.motion(self.takes.positions_at(rows))


def set_up_scene(
    takes: CleanedTakes, rig: Rig, *, placement: RigPlacement | None, progress: Progress
) -> SelectionScene:
    """Fit the motion space, place the markers on the rig and compute the features of all frames."""
    progress(0.2, "measuring the motion")
    # Adjacent frames hardly differ: of an hour, every eighth is used.
    step = -(-len(takes.frames) // _MOTION_FRAMES)
    motion = fit_motion_space([clip[::step] for clip in takes.positions])
    progress(0.35, "placing the markers on the rig")
    deformer = Deformer(rig)
    equation = _equation(takes, rig, deformer, placement)
    weights = proposed_weights(equation, sampled_frames(motion))
    parts = shape_parts(rig, deformer)
    space = selection_space(motion, weights, parts)
    proposals = WeightProposals(
        features=space.features(motion.sample),
        weights=weights,
        of_rows=lambda rows: equation.propose(
            frames_at(
                motion, marker_coordinates(motion, takes.positions_at(rows).astype(np.float64))
            )
        ),
        gram=deformer.shapes.gram(),
    )
    features = _features(takes, motion, space)
    return SelectionScene(takes, rig, deformer, parts, motion, equation, space, features, proposals)


def candidate_frames(takes: CleanedTakes, frames: str | None) -> BoolArray:
    """Return which frames of all takes may be selected: with most markers, within a range."""
    markers = len(takes.marker_names)
    seen = np.concatenate([np.count_nonzero(each, axis=1) for each in takes.usable])
    candidates: BoolArray = seen >= USABLE_SHARE * markers
    limits = frame_range(frames)
    if limits is not None:
        candidates &= (takes.frames >= limits[0]) & (takes.frames <= limits[1])
    return candidates


def _features(takes: CleanedTakes, motion: MotionSpace, space: SelectionSpace) -> Float32Array:
    """Return the features of every frame, without storing its coordinates in between."""
    projection = motion.components.T @ space.projection
    mean = motion.mean.astype(np.float32)
    narrow, offset = projection.astype(np.float32), space.offset.astype(np.float32)
    out = np.empty((len(takes.frames), projection.shape[1]), np.float32)
    centred = np.empty((_BLOCK_FRAMES, len(mean)), np.float32)
    start = 0
    for clip in takes.positions:
        for first in range(0, len(clip), _BLOCK_FRAMES):
            part = clip[first : first + _BLOCK_FRAMES].reshape(-1, len(mean))
            rows = slice(start + first, start + first + len(part))
            # Centred first, as single precision would lose digits of large coordinates.
            np.subtract(part, mean, out=centred[: len(part)])
            np.matmul(centred[: len(part)], narrow, out=out[rows])
            out[rows] -= offset
        start += len(clip)
    return out


def _equation(
    takes: CleanedTakes, rig: Rig, deformer: Deformer, placement: RigPlacement | None
) -> BlendshapeEquation:
    one = len(takes.positions) == 1
    return placed_equation(
        placement,
        rig,
        deformer,
        PerformerMarkers(
            labels=takes.marker_names,
            neutral=takes.neutral,
            positions=takes.positions[0] if one else np.concatenate(takes.positions),
            visible=takes.usable[0] if one else np.concatenate(takes.usable),
            rigid=tuple(takes.marker_names.index(name) for name in takes.rigid),
            starts=tuple(takes.starts[:-1].tolist()),
        ),
    )
