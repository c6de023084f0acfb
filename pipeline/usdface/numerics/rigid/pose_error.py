"""Errors of a take's stabilisation: head motion that its markers still have.

A band slips, and markers that are taken as rigid sit on skin. The error of a frame's pose displaces
all markers as one body, expressions do not. The displacements of the markers from the neutral are::

    d_k = B_k' z + P_k p + e_k,    P_k p = r x (n_k - c) + s

- z ~ N(0, 1): expressions. ``B'B`` is the second moment of the motion by the rig's shapes, for
  weights as in the references plus uniform ones, which references need not show;
- p = (r, s) ~ N(m, S): rotation [rad] and translation [mm] about the centre c of the neutral n;
- e_k ~ N(0, nu_k): the performer's departure from the rig, which grows with the motion, and noise,
  with Huber's weights beyond `_HUBER_THRESHOLD`. nu is larger in frames whose chi2 exceeds
  `_USUAL_CHI2`. Rigid markers tell nothing of p, as the stabilisation has brought them to rest.

m and S maximise the likelihood over a take. The posterior mean of p is subtracted, unless S is
small, or not much larger than the posterior covariance: of a constant error alone, `head_space`
removes a large m. The markers' mean residual, weighted by 1 / nu, is subtracted before: that of
frames near rest is of markers that were reapplied, others have that of expressions.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from usdface.core.arrays import (
    Arrays,
    BoolArray,
    FloatArray,
    IntArray,
    RealArray,
    frame_blocks,
    sample_frames,
)
from usdface.numerics.rigid.rigid_alignment import rigid_displacements

_UNIFORM_VARIANCE = 1 / 12
"""Variance of a weight in [0, 1] of which nothing is known."""
_DEPARTURE_SHARE = 0.35
"""Standard deviation of a performer's motion by a shape, relative to the rig's: as that of the
amplitudes in `fit_marker_basis`."""
_SHAPE_DEPARTURE = 0.15
"""The same of what all markers have in common: a performer's shapes have other directions."""
_NOISE_MM = 0.15
"""Standard deviation of a coordinate of a marker at rest."""
_HUBER_THRESHOLD = 2.5
"""Distance of a marker from where it is expected, in standard deviations of a coordinate, beyond
which it counts less: a marker on a lid that the rig's placement missed moves by centimetres."""
_COMPONENT_COUNT = 40
"""Largest number of components of the expressions."""
_NOISE_ROUNDS = 2
"""Solves of a frame: with the departure of the mean motion, then of that in the frame."""
_OFFSET_ROUNDS = 2
"""Estimates of the markers' mean residual, without which it counts as an error of the pose."""
_USUAL_CHI2 = 0.1
"""Mean chi2 per degree of freedom of a take like the references, as weights move together and most
performers depart less from the rig. Where it is larger, unknown expressions pass as errors."""
_BLOCK_VALUES = 2_000_000
"""Of B, in all frames that are solved at once: 16 MB."""
_SAMPLED_FRAMES = 240
"""Frames in which the distribution is estimated: its standard deviations are known to 5 %."""
_START = np.array([0.02] * 3 + [2.0] * 3) ** 2
"""Variances of the errors from which maximisation starts: [rad^2], [mm^2]."""
_MAXIMISATION_ROUNDS = 30
"""Rounds of expectation maximisation; errors of 0.3 mm have converged after ten."""
_LEAST_MM = 0.2
"""Error that is removed, at the markers: less is no more than what a good head band leaves."""
_FEWEST_STEADY = 5
"""Markers of an alignment: of four, a swapped one cannot be told."""
_LEFT_OUT_AT_ONCE = 40
"""[of the markers left] One of so many is left out at once, so that a thousand markers take
some seconds."""
_FEWEST_FRAMES = 24
"""With fewer, the covariance of the errors is not known."""
_FEWEST_MARKERS = 6
"""On skin. Of fewer, expressions pass for errors: in takes without any, their mean is up to 0.4 mm
with six markers, 1 mm with five, 5 mm with four."""
_LEAST_SPREAD_MM = 1.0
"""Root mean square distance of the markers on skin from a line: nearer, a rotation about it is not
seen, and the mean error of takes without any is up to 1.5 mm at 0.5 mm, 8 mm at 0.1 mm."""
_LEAST_RATIO = 2.0
"""The same, relative to the posterior standard deviation: less may be expressions."""


@dataclass(frozen=True)
class ExpressionMotion:
    """Distribution of a performer's marker displacements by expressions."""

    neutral: FloatArray
    """(markers, 3) [mm]"""
    components: FloatArray
    """(components, markers, 3): B [mm]."""
    motion2: FloatArray
    """(markers,): mean square of a coordinate's motion by expressions [mm^2]."""
    rigid_markers: BoolArray
    """(markers,)"""

    @cached_property
    def rigid(self) -> FloatArray:
        """(6, markers, 3): displacement by 1 rad about and by 1 mm along each axis, P."""
        return rigid_displacements(self.neutral)

    def likelihood(self, positions: RealArray, visible: BoolArray) -> "PoseLikelihood":
        """Return what frames tell of p, with expressions integrated out."""
        seen = visible & ~self.rigid_markers
        moved = np.where(seen[:, :, None], positions - self.neutral, 0.0)
        blocks = frame_blocks(len(positions), frames=max(_BLOCK_VALUES // self.components.size, 1))
        return PoseLikelihood(
            *map(
                np.concatenate,
                zip(*(self._integrate(moved[rows], seen[rows]) for rows in blocks), strict=True),
            )
        )

    def _integrate(self, moved: FloatArray, seen: BoolArray) -> tuple[FloatArray, ...]:
        """Return the fields of `likelihood` for a block of displacements."""
        both = np.concatenate([self.components, self.rigid])
        count, free, prior = len(self.components), 3 * seen.sum(axis=1), np.diag(1 / _START)
        flat, displaced = both.reshape(len(both), -1), moved.reshape(len(moved), -1)
        by_marker = both.transpose(1, 0, 2)
        products = (by_marker @ by_marker.transpose(0, 2, 1)).reshape(len(by_marker), -1)
        variance = np.broadcast_to(self.motion2, seen.shape)
        away = np.zeros(seen.shape)
        for _ in range(_NOISE_ROUNDS):
            precision = seen / (_NOISE_MM**2 + _DEPARTURE_SHARE**2 * variance)
            precision /= np.maximum(np.sqrt(precision) * away / _HUBER_THRESHOLD, 1)
            weight = np.repeat(precision, 3, axis=1)
            normal = (precision @ products).reshape(len(moved), len(both), len(both))
            right = (weight * displaced) @ flat.T
            inner = normal[:, :count, :count] + np.eye(count)
            solved = np.linalg.solve(
                inner, np.concatenate([normal[:, :count, count:], right[:, :count, None]], axis=2)
            )
            cross = normal[:, count:, :count]
            information = normal[:, count:, count:] - cross @ solved[:, :, :6]
            score = right[:, count:] - (cross @ solved[:, :, 6:])[:, :, 0]
            p = np.linalg.solve(information + prior, score[:, :, None])
            z = solved[:, :, 6:] - solved[:, :, :6] @ p
            variance = (np.tensordot(z[:, :, 0], self.components, 1) ** 2).mean(axis=2)
            residual = displaced - np.concatenate([z, p], axis=1)[:, :, 0] @ flat
            away = np.sqrt((residual.reshape(moved.shape) ** 2).sum(axis=2))
        chi2 = (weight * displaced * residual).sum(axis=1) / np.maximum(free - 6, 1)
        weighted = residual.reshape(moved.shape) * precision[:, :, None]
        # log det of B' B + P' S P + nu, by the matrix determinant lemma.
        spread = np.linalg.slogdet(inner)[1] + np.linalg.slogdet(information + prior)[1]
        spread -= 3 * np.log(np.where(seen, precision, 1.0)).sum(axis=1)
        evidence = -0.5 * (chi2 + spread / np.maximum(free - 6, 1))
        return information, score, chi2, weighted, precision, evidence

    def find_errors(self, positions: RealArray, visible: BoolArray) -> "PoseErrors":
        """Return the distribution of the errors of a take's poses.

        Parameters
        ----------
        positions : (frames, markers, 3) float array
            Frames spread over the take, in the neutral's head space [mm].
        visible : (frames, markers) bool array
        """
        rows = sample_frames(len(positions), _SAMPLED_FRAMES)
        positions, visible = positions[rows], visible[rows]
        offset = np.zeros_like(self.neutral)
        seen = self.neutral[visible.any(axis=0) & ~self.rigid_markers]
        from_line = 0.0  # root mean square distance from the nearest line
        if len(seen) >= _FEWEST_MARKERS:
            across = np.linalg.svd(seen - seen.mean(axis=0), compute_uv=False)[1:]
            from_line = float(np.sqrt((across**2).sum() / len(seen)))
        if from_line < _LEAST_SPREAD_MM:
            return PoseErrors(self, offset, 1.0, np.zeros(6), np.diag(_START), 0.0, 0.0, 0.0)
        for _ in range(_OFFSET_ROUNDS):
            found = self.likelihood(positions - offset, visible)
            precision = np.maximum(found.precision.sum(axis=0), 1e-9)[:, None]
            offset += found.weighted_residual.sum(axis=0) / precision
        found = self.likelihood(positions - offset, visible)
        scale = found.noise_scale
        mean, covariance, posterior = _maximise(
            found.information / scale[:, None, None], found.score / scale[:, None]
        )
        possible, unknown = self.size_mm(covariance), self.size_mm(posterior)
        if len(positions) < _FEWEST_FRAMES or possible < _LEAST_MM:
            possible = 0.0
        size = possible if possible >= _LEAST_RATIO * unknown else 0.0
        noise, evidence = float(scale.mean()), float(found.evidence.mean())
        return PoseErrors(self, offset, noise, mean, covariance, possible, size, evidence)

    def size_mm(self, covariance: FloatArray) -> float:
        """Return the root mean square displacement of the markers by p ~ N(0, covariance) [mm]."""
        squares = np.einsum("pmc,qmc,pq->m", self.rigid, self.rigid, covariance)
        return float(np.sqrt(squares.mean()))

    def alignment_error_mm(self, markers: IntArray) -> float:
        """Return the expected error of poses by rigid alignment with some markers [mm].

        As `size_mm`: the least squares estimate of p takes their expressions for head motion.
        """
        normal, cross, noise = (each[markers].sum(axis=0) for each in self._moments)
        return float(np.sqrt(self._alignment_error2(normal, cross, noise)))

    def steadiest_markers(self, candidates: BoolArray) -> IntArray:
        """Return the markers whose rigid alignment has the least expected error.

        By backward elimination among `candidates`, (markers,): the markers without which the error
        is least are left out, as long as five are left.
        """
        normal, cross, noise = self._moments
        left = np.flatnonzero(candidates)
        best, least = left, np.inf
        while len(left) >= _FEWEST_STEADY:
            error_mm = self.alignment_error_mm(left)
            if error_mm < least:
                best, least = left, error_mm
            without = (each[left].sum(axis=0) - each[left] for each in (normal, cross, noise))
            order = np.argsort(self._alignment_error2(*without), kind="stable")
            left = np.delete(left, order[: max(1, len(left) // _LEFT_OUT_AT_ONCE)])
        return best

    @cached_property
    def _moments(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return ``P_k P_k'``, ``P_k B_k'`` and ``nu_k P_k P_k'`` of each marker."""
        rigid, moved = self.rigid.transpose(1, 0, 2), self.components.transpose(1, 2, 0)
        normal = rigid @ rigid.transpose(0, 2, 1)
        variance = _NOISE_MM**2 + _DEPARTURE_SHARE**2 * self.motion2
        return normal, rigid @ moved, variance[:, None, None] * normal

    def _alignment_error2(
        self, normal: FloatArray, cross: FloatArray, noise: FloatArray
    ) -> FloatArray:
        """Return the mean square displacement by errors of alignment, for sums of `_moments`.

        Infinite where the markers are fewer than three, or collinear.
        """
        determined = np.linalg.matrix_rank(normal, hermitian=True) == len(_START)
        unit = np.eye(len(_START))
        inverse = np.linalg.inv(np.where(determined[..., None, None], normal, unit))
        response = inverse @ cross
        covariance = response @ np.swapaxes(response, -1, -2) + inverse @ noise @ inverse
        squares = (covariance * self._moments[0].mean(axis=0)).sum(axis=(-2, -1))
        return np.where(determined, squares, np.inf)

    def to_arrays(self) -> Arrays:
        """Return the distribution as arrays of a mapping."""
        return {
            "expression_components": self.components,
            "expression_motion2": self.motion2,
            "expression_rigid": self.rigid_markers.astype(np.float64),
        }

    @classmethod
    def from_arrays(cls, arrays: Arrays, neutral: FloatArray) -> "ExpressionMotion | None":
        """Rebuild the distribution from a mapping; None if it was trained without a rig."""
        if "expression_motion2" not in arrays:
            return None
        components, motion2, rigid = (
            arrays[f"expression_{name}"] for name in ("components", "motion2", "rigid")
        )
        return cls(neutral, components, motion2, rigid > 0)


class PoseLikelihood(NamedTuple):
    """What frames tell of p."""

    information: FloatArray
    """(frames, 6, 6): inverse covariance of the estimate of p."""
    score: FloatArray
    """(frames, 6): information times the estimate."""
    chi2: FloatArray
    """(frames,): squared residual over its variance, per degree of freedom."""
    weighted_residual: FloatArray
    """(frames, markers, 3): of the most probable expression and p, times `precision` [1/mm]."""
    precision: FloatArray
    """(frames, markers): of a coordinate; 0 where not used [mm^-2]."""
    evidence: FloatArray
    """(frames,): logarithm of the probability density with p ~ N(0, `_START`), per degree of
    freedom, up to a constant."""

    @property
    def noise_scale(self) -> FloatArray:
        """Factor on the variance of e in each frame, where the residuals exceed it: (frames,)."""
        return np.maximum(self.chi2 / _USUAL_CHI2, 1.0)


def _maximise(information: FloatArray, score: FloatArray) -> tuple[FloatArray, ...]:
    """Return m, S, and the mean posterior covariance of p."""
    covariance = np.diag(_START)
    for _ in range(_MAXIMISATION_ROUNDS):
        inverse = np.linalg.inv(covariance)
        posterior = np.linalg.inv(information + inverse)
        # Generalised least squares, with (S + I^-1)^-1 = S^-1 - S^-1 (S^-1 + I)^-1 S^-1.
        weight = inverse - inverse @ posterior.mean(axis=0) @ inverse
        scaled = (posterior @ score[:, :, None])[:, :, 0]
        mean = np.linalg.solve(weight, inverse @ scaled.mean(axis=0))
        away = scaled + posterior @ (inverse @ mean) - mean
        covariance = away.T @ away / len(away) + posterior.mean(axis=0)
    return mean, covariance, posterior.mean(axis=0)


@dataclass(frozen=True)
class PoseErrors:
    """Distribution of the errors of a take's poses."""

    expressions: ExpressionMotion
    offset: FloatArray
    """(markers, 3): mean residual over the take, as of reapplied markers [mm]."""
    noise_scale: float
    """Mean factor on the variance of e."""
    mean: FloatArray
    """(6,): m [rad, mm]."""
    covariance: FloatArray
    """(6, 6): S."""
    possible_mm: float
    """Root mean square displacement of the markers from that by m [mm]."""
    size_mm: float
    """The same; 0 if it may be expressions, and nothing is removed [mm]."""
    evidence: float
    """Mean of `PoseLikelihood.evidence`."""

    @property
    def mean_mm(self) -> float:
        """Root mean square displacement of the markers by m [mm]."""
        return self.expressions.size_mm(np.outer(self.mean, self.mean))

    @property
    def mean_transform(self) -> tuple[FloatArray, FloatArray]:
        """Rotation and shift that remove the mean, without linearisation."""
        from scipy.spatial.transform import Rotation  # slow to import

        turn: FloatArray = Rotation.from_rotvec(-self.mean[:3]).as_matrix()
        centre = self.expressions.neutral.mean(axis=0)
        return turn, centre - turn @ (centre + self.mean[3:])

    def remove(self, positions: RealArray, visible: BoolArray) -> FloatArray:
        """Return positions (frames, markers, 3) without the errors, rigid markers at rest [mm]."""
        if not self.size_mm or not len(positions):
            return np.asarray(positions, dtype=np.float64)
        found = self.expressions.likelihood(positions - self.offset, visible)
        inverse = np.linalg.inv(self.covariance)
        scale = found.noise_scale
        score = found.score / scale[:, None] + inverse @ self.mean
        precision = found.information / scale[:, None, None] + inverse
        error = np.linalg.solve(precision, score[:, :, None])[:, :, 0]
        moved: FloatArray = np.asarray(positions - np.tensordot(error, self.expressions.rigid, 1))
        at_rest = self.expressions.rigid_markers
        moved[:, at_rest] = self.expressions.neutral[at_rest]
        return moved


def observed_motion(
    frames: FloatArray, neutral: FloatArray, *, rigid: BoolArray
) -> ExpressionMotion:
    """Return the distribution of a performer's displacements, as frames show them.

    Parameters
    ----------
    frames : (frames, markers, 3) float array
        Without errors of poses [mm].
    neutral : (markers, 3) float array
        [mm]
    rigid : (markers,) bool array
        Rigid markers.
    """
    moved = (frames - neutral).reshape(len(frames), -1) / np.sqrt(len(frames))
    _, deviations, directions = np.linalg.svd(moved, full_matrices=False)
    components = (deviations[:, None] * directions)[:_COMPONENT_COUNT].reshape(-1, *neutral.shape)
    motion2 = (moved**2).sum(axis=0).reshape(neutral.shape).mean(axis=1)
    return ExpressionMotion(neutral, components, motion2, rigid)


def expression_motion(
    basis: FloatArray, weights: FloatArray, neutral: FloatArray, *, rigid: IntArray
) -> ExpressionMotion:
    """Return the distribution of displacements by a rig's shapes.

    Parameters
    ----------
    basis : (shapes, markers, 3) float array
        Displacement by each shape at 1 [mm].
    weights : (pairs, shapes) float array
        Normalised weights of references; none for uniform ones alone.
    neutral : (markers, 3) float array
        [mm]
    rigid : int array
        Rigid markers.
    """
    from scipy.linalg import eigh  # slow to import

    count, flat = len(basis), basis.reshape(len(basis), -1)
    moment = weights.T @ weights / max(len(weights), 1) + _UNIFORM_VARIANCE * np.eye(count)
    rows = np.linalg.cholesky(moment).T @ flat
    motion2 = (rows**2).sum(axis=0).reshape(len(neutral), 3).mean(axis=1)
    # Each shape times a random 3 x 3 matrix: other directions and proportions.
    sized = _SHAPE_DEPARTURE * np.sqrt(np.diag(moment))[:, None, None] * basis
    turned = np.kron(np.tensordot(sized, sized, ((0, 2), (0, 2))), np.eye(3))
    size = flat.shape[1]
    variances, directions = eigh(
        rows.T @ rows + turned, subset_by_index=[max(size - _COMPONENT_COUNT, 0), size - 1]
    )
    deviations = np.sqrt(np.maximum(variances, 0.0))
    components = (deviations * directions).T.reshape(-1, *basis.shape[1:])
    return ExpressionMotion(neutral, components, motion2, np.isin(np.arange(len(neutral)), rigid))
