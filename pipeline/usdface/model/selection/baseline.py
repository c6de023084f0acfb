"""Weights from the rig's geometry alone: the blendshape equation, without references.

After Deng et al. 2006, section 7: the weights proposed to animators, and the baseline of sheets and
reports.
"""

from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from usdface.core.arrays import BoolArray, Float32Array, FloatArray, sample_frames
from usdface.core.assets import Markers, Rig, range_ends
from usdface.core.deformer import Deformer
from usdface.core.errors import as_input_error
from usdface.core.last_result import cache_last_result
from usdface.model.placement.label_hints import upper_lid_sides
from usdface.model.placement.marker_cloud import marker_cloud
from usdface.model.placement.place import place_markers
from usdface.model.selection.lid_evidence import LidEvidence, find_lid_evidence
from usdface.numerics.registration.virtual_markers import (
    VirtualMarkers,
    certain_errors,
    character_motion,
    marker_deltas,
    motion_by_rig,
)
from usdface.numerics.rigid.pose_error import PoseErrors
from usdface.numerics.rigid.skin_rotation import rotate_deltas, skin_rotations
from usdface.numerics.solve.blendshape_equation import (
    EquationSolution,
    MarkerKeys,
    solve_least_squares,
    solve_weights,
)
from usdface.numerics.solve.peak_matching import match_peaks

Positions = Float32Array | FloatArray

MOTION_FRAMES = 2000
"""Evenly spaced frames of a take used for placement."""

_NOISE_FRAMES = 500
"""Of these, frames used to measure the markers' residual."""

PROPOSAL_RIDGE = 10.0
"""Penalty of squared weights [mm^2]: keeps weights of nearly dependent shapes small."""


@dataclass(frozen=True)
class BlendshapeEquation:
    """The blendshape equation of a performer's markers on a character."""

    virtual: VirtualMarkers
    deltas: FloatArray
    """(shapes, markers, 3): displacements of the virtual markers by each shape at 1 [mm]."""
    keys: MarkerKeys
    """The same for every key, including in-betweens."""
    neutral: FloatArray
    """(markers, 3): the performer's neutral face [mm]."""
    ranges: FloatArray
    """(shapes, 2)"""
    trust: FloatArray
    """(markers,): weight in the solve; 0 for rigid markers, whose motion is noise."""
    gain: FloatArray
    """(markers,): factor of a marker's motion with which blinks close the eye."""
    noise_mm: float = 0.0
    """RMS residual of the solve: the error of skin, placement and capture."""
    lids: LidEvidence | None = None
    """None to solve blinks as any shape."""
    unplaced: tuple[int, ...] = ()
    """Markers without a place on the character: they have no residual."""
    pose_errors: PoseErrors | None = None

    def motion(self, positions: Positions, visible: BoolArray | None = None) -> FloatArray:
        """Return displacements from the neutral in the character's space and size [mm].

        Errors of poses are removed.
        """
        if self.pose_errors is not None:
            seen = np.ones(positions.shape[:2], np.bool_) if visible is None else visible
            positions = self.pose_errors.remove(positions, seen)
        return character_motion(self.virtual, positions, self.neutral)

    def solve_published(
        self, positions: Positions, *, visible: BoolArray | None = None
    ) -> FloatArray:
        """Return weights by plain least squares over all markers, without limits.

        Deng et al. 2006, eq. 7: the comparison of the paper. Parameters are those of `propose`.
        """
        motion = character_motion(self.virtual, positions, self.neutral)
        placed = np.ones(len(self.neutral))
        placed[list(self.unplaced)] = 0.0
        return solve_least_squares(self.deltas, motion, visible=visible, marker_trust=placed)

    def propose(
        self,
        positions: Positions,
        *,
        visible: BoolArray | None = None,
        ranges: FloatArray | None = None,
    ) -> FloatArray:
        """Return weights for an animator to start from: (frames, shapes).

        Least squares within the ranges, with in-betweens and a ridge penalty; shapes cost more
        where their markers are still. Blinks are treated by `lids`.

        Parameters
        ----------
        positions : (frames, markers, 3) float array
            Stabilised [mm].
        visible : (frames, markers) bool array, optional
        ranges : (shapes, 2) float array, optional
            Instead of the rig's; equal limits hold a shape.
        """
        limits = self.ranges if ranges is None else ranges
        solved = self._solve(positions, visible, limits.copy())
        return np.clip(solved.weights, limits[:, 0], limits[:, 1])

    def _solve(
        self, positions: Positions, visible: BoolArray | None, limits: FloatArray
    ) -> EquationSolution:
        motion = self.motion(positions, visible)
        fixed = [] if self.lids is None else list(self.lids.fixed)
        limits[fixed] = np.clip(0.0, limits[fixed, 0], limits[fixed, 1])[:, None]
        full = range_ends(self.ranges)  # the ridge is for weights of 1 where a shape is full
        solution = solve_weights(
            self.deltas * full[:, None, None],
            motion * self.gain[:, None],
            ranges=np.sort(limits / full[:, None], axis=1),
            visible=visible,
            marker_trust=self.trust,
            ridge=PROPOSAL_RIDGE,
            keys=None
            if self.keys.linear
            else replace(self.keys, key_weights=partial(_full_key_weights, self.keys, full)),
            noise_mm=self.noise_mm,
            tied=() if self.lids is None else self.lids.tied,
        )
        return replace(solution, weights=solution.weights * full)

    def residual_mm(
        self,
        positions: Positions,
        weights: FloatArray,
        *,
        visible: BoolArray | None = None,
        without: tuple[int, ...] = (),
    ) -> FloatArray:
        """Return the RMS residual of the visible markers, but some, for given weights: (frames,).

        0 where no marker is visible.
        """
        counted = np.ones(positions.shape[:2], np.bool_) if visible is None else visible.copy()
        counted[:, [*self.unplaced, *without]] = False
        squared = ((self.motion(positions, visible) - self._moved(weights)) ** 2).sum(axis=2)
        total = np.where(counted, squared, 0.0).sum(axis=1)
        return np.asarray(np.sqrt(total / np.maximum(counted.sum(axis=1), 1)))

    def _moved(self, weights: FloatArray) -> FloatArray:
        """Return displacements of the virtual markers, including in-betweens."""
        return self.keys.move(self.keys.key_weights(weights))


def _full_key_weights(keys: MarkerKeys, full: FloatArray, shares: FloatArray) -> FloatArray:
    """Return the weights of keys, in a form that can be pickled."""
    return keys.key_weights(shares * full)


@dataclass(frozen=True)
class PerformerMarkers:
    """A performer's stabilised markers over one or several takes."""

    labels: tuple[str, ...]
    """Names of the markers, used as hints of their place."""
    neutral: FloatArray
    """(markers, 3): the performer's neutral face [mm]."""
    positions: Positions
    """(frames, markers, 3): of all takes, one after the other [mm]; evenly spaced frames are used.
    """
    visible: BoolArray
    """(frames, markers)"""
    rigid: tuple[int, ...]
    """Markers of the skull."""
    starts: tuple[int, ...] = (0,)
    """Row of the first frame of each take."""

    @classmethod
    def of_take(cls, markers: Markers, neutral: Positions) -> "PerformerMarkers":
        """Return the markers of one take; `neutral`: (markers, 3) [mm]."""
        return cls(
            labels=markers.names,
            neutral=neutral.astype(np.float64),
            positions=markers.positions,
            visible=markers.usable,
            rigid=tuple(markers.names.index(n) for n in markers.rigid if n in markers.names),
        )


def set_up_equation(
    rig: Rig, deformer: Deformer, performer: PerformerMarkers
) -> BlendshapeEquation:
    """Return the equation of a performer's markers, placed on a character."""
    positions, visible = performer.positions, performer.visible
    picks = sample_frames(len(positions), MOTION_FRAMES)
    with as_input_error(f"the markers cannot be placed on {rig.file}"):
        skin = deformer.face_skin()
        cloud = marker_cloud(
            performer.labels,
            performer.neutral,
            positions[picks],
            visible=visible[picks],
            rigid=performer.rigid,
        )
        placement = place_markers(cloud, skin, rig.shapes, ranges=rig.ranges_of_ends)
    return equation_at(rig, deformer, placement.virtual, performer)


@cache_last_result
def equation_at(
    rig: Rig, deformer: Deformer, virtual: VirtualMarkers, performer: PerformerMarkers
) -> BlendshapeEquation:
    """Return the equation of markers at known places, `virtual`, on a character."""
    positions, visible, neutral = performer.positions, performer.visible, performer.neutral
    picks = sample_frames(len(positions), MOTION_FRAMES)
    deltas = marker_deltas(virtual, deformer.shapes.target_offsets())
    keys = MarkerKeys(
        deltas=marker_deltas(virtual, deformer.shapes.key_offsets),
        channels=deformer.shapes.key_channels,
        key_weights=deformer.shapes.key_weights,
        linear=deformer.shapes.is_linear,
    )
    trust = np.ones(len(neutral))
    trust[list(performer.rigid)] = 0.0
    full = range_ends(rig.ranges)[:, None, None] * deltas
    expressions = motion_by_rig(virtual, full, neutral, rigid=performer.rigid)
    errors = certain_errors(expressions.find_errors(positions[picks], visible[picks]))
    motion = character_motion(virtual, errors.remove(positions[picks], visible[picks]), neutral)
    lids = find_lid_evidence(
        rig.shapes,
        deformer.full_offsets(),
        full,
        np.split(motion, np.searchsorted(picks, performer.starts[1:])),
        trust,
        lid_sides=upper_lid_sides(performer.labels),
    )
    gain = match_peaks(
        full,
        motion,
        lids.closing,
        ranges=rig.ranges_of_ends,
        visible=visible[picks],
        marker_trust=trust,
    )
    equation = BlendshapeEquation(
        virtual, deltas, keys, neutral, rig.ranges, trust, gain, lids=lids, pose_errors=errors
    )
    few = picks[:: -(-len(picks) // _NOISE_FRAMES)]
    equation = replace(equation, noise_mm=_noise_mm(equation, positions[few], visible[few]))
    equation = _turn_skin(equation, positions[few], visible[few])
    return replace(equation, noise_mm=_noise_mm(equation, positions[few], visible[few]))


@cache_last_result
def proposed_weights(equation: BlendshapeEquation, positions: Positions) -> FloatArray:
    """Return the weights proposed for positions; steps of a job ask for the same ones."""
    return equation.propose(positions)


def _turn_skin(
    equation: BlendshapeEquation, positions: Positions, visible: BoolArray
) -> BlendshapeEquation:
    """Return the equation with the markers' motion turned as the performer's skin slopes."""
    weights = equation._solve(positions, visible, equation.ranges.copy()).weights
    turned = skin_rotations(
        equation.neutral,
        equation._moved(weights),
        equation.motion(positions, visible),
        visible=visible & (equation.trust > 0),
    )
    keys = replace(equation.keys, deltas=rotate_deltas(equation.keys.deltas, turned))
    return replace(equation, deltas=rotate_deltas(equation.deltas, turned), keys=keys)


def _noise_mm(equation: BlendshapeEquation, positions: Positions, visible: BoolArray) -> float:
    """Return the RMS residual of a solve, of the visible markers that it uses."""
    away = equation._solve(positions, visible, equation.ranges.copy()).residual_mm[
        :, equation.trust > 0
    ]
    seen = np.isfinite(away)
    return float(np.sqrt((away[seen] ** 2).mean())) if seen.any() else 0.0
