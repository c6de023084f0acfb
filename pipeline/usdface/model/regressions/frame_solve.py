"""The most probable weights of a frame, within their limits.

Start from what the regression on the examples says, ``t0``, with the error it usually has, and
bring in what the forward model f (`forward_model`) says of the markers y::

    min over 0 <= t <= 1:   sum_k v_k |y_k - f_k(t)|^2 / r_k  +  sum_s rho((t_s - t0_s) / sd_s)

``v``: visible. ``r_k``, of one coordinate: noise and the model's predictive variance at t0, so that
a combination no reference shows weighs less, times how much markers err together. ``rho``: Huber's,
quadratic up to `_TAIL_DEVIATIONS` and linear beyond: the examples may be wrong altogether.

``sd_s`` lies between the examples' usual error and the spread of the shape's weight over faces, by
shape and so by region. Where the markers that a shape moves are where t0 puts them, the frame looks
like the references there, and the examples decide; where they are not, the markers do::

    chi2_s = sum_k h_sk |y_k - f_k(t0)|^2 / (3 expected_k) / sum_k h_sk v_k
    sd_s   = error_s^(1 - g) spread_s^g,    g = log(chi2_s / .3) / log(10 / .3), in [0, 1]

``expected_k`` is the variance that noise, predictive variance and the usual errors explain, and
``h_sk`` how much marker k shows of shape s. Markers that are not seen let their shapes go in the
same way. The passage takes a decade and a half of chi2, so that it adds no jitter.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from usdface.core.arrays import (
    BoolArray,
    Float32Array,
    FloatArray,
    IntArray,
    RealArray,
    single_precision,
)
from usdface.model.regressions.base import Arrays, unbend
from usdface.model.regressions.forward_model import ForwardModel
from usdface.numerics.solve.bounded_least_squares import descend_in_boxes

CLEANED_NOISE_MM = 0.05
"""Noise of a coordinate that cleaning leaves."""

COMMON_ERRORS = (3.0, 9.0, 27.0, 81.0, 243.0)
"""Squared residuals of so many markers count as one: a forward model errs on neighbours alike. The
first holds for optical markers; landmarks that a model finds in pictures err as a face does, all
together: for them the last."""

_FAMILIAR_CHI2, _STRANGE_CHI2 = 0.3, 10.0
"""Where the examples alone decide, and where they say no more than how far weights spread."""

_WIDEST_SHARE = 0.8
"""Of the spread of a shape's weight: its prior there."""

_LEAST_ERROR = 0.01
"""Of a weight: no animator keys finer."""

_LEAST_SPREAD = 0.25
"""Of a weight over faces: a uniform one has .29. That references leave a shape alone says that
their take does, not that the next take will."""

_TAIL_DEVIATIONS = 1.5
"""Standard deviations beyond which the prior is linear (Huber 1964: 95 % efficient at 1.345)."""

_TAIL_ROUNDS = 2
"""Of reweighting for the tails: the first is without."""

_BEND_STEP = 1e-3
"""Of a bent weight, for the slope of unbending."""

_GRADIENT_STEPS = 30
"""Accelerated gradient steps of the bounded solve. The forward model is linearised once, at t0: a
second time changes crosstake by less than .001 mm and takes as long again."""

_MOST_SHAPES = 200
"""Up to which every frame has a slope and a Hessian. Beyond, frames share the slope at rest, the
quadratic part is left out, and uncertainty comes from `usual_posteriors`."""


@dataclass(frozen=True)
class FrameSolution:
    """Weights of frames, and how firmly they are held."""

    targets: FloatArray
    """(frames, shapes): bent weights [0-1]."""
    precision: RealArray
    """(frames, shapes): of the prior: ``1 / sd^2``, as its tails leave it."""
    left: RealArray
    """(frames, 3 markers): markers minus where the weights put them; 0 where unseen [mm]."""
    hessian: RealArray | None
    """(frames, shapes, shapes): of half the sum that is minimised; None on rigs of many shapes."""

    def take(self, rows: IntArray) -> "FrameSolution":
        """Return some of the frames."""
        hessian = None if self.hessian is None else self.hessian[rows]
        return FrameSolution(self.targets[rows], self.precision[rows], self.left[rows], hessian)

    def covariance(self, curve: float) -> RealArray:
        """Return the posterior covariance of the weights, as shares of their ranges.

        (frames, shapes, shapes).

        Raises
        ------
        ValueError
            If the rig has too many shapes for each frame to have a Hessian.
        """
        if self.hessian is None:
            raise ValueError("frames of rigs of many shapes have no Hessian of their own")
        ahead = unbend(self.targets + _BEND_STEP, curve)
        slope = ((ahead - unbend(self.targets, curve)) / _BEND_STEP).astype(np.float32)
        covariance: RealArray = np.linalg.inv(self.hessian)
        covariance *= slope[:, :, None] * slope[:, None]
        return covariance


@dataclass(frozen=True)
class FrameSolver:
    """The forward model and the examples' errors, ready for many frames."""

    forward: ForwardModel
    error: FloatArray
    """(shapes,): usual error of t0: standard deviation."""
    common: float = COMMON_ERRORS[0]
    """Markers whose squared residuals count as one."""

    @classmethod
    def from_arrays(cls, arrays: Arrays) -> "FrameSolver":
        """Put a mapping's solver together."""
        common = arrays.get("common_error", np.array(COMMON_ERRORS[:1]))
        return cls(ForwardModel.from_arrays(arrays), arrays["start_error"], float(common[0]))

    def to_arrays(self) -> Arrays:
        """Return what `from_arrays` reads."""
        own = {"start_error": self.error, "common_error": np.array([self.common])}
        return self.forward.to_arrays() | own

    def solve(
        self,
        displacements: FloatArray,
        visible: BoolArray,
        start: FloatArray,
        *,
        bounded: bool = True,
    ) -> FrameSolution:
        """Solve frames.

        Parameters
        ----------
        displacements : (frames, markers, 3) float array
            From the neutral [mm]; what is not visible is not read.
        visible : (frames, markers) bool array
        start : (frames, shapes) float array
            t0: bent weights of the regression on examples [0-1].
        bounded : bool
            False leaves weights as they are, another method's answer, and says how firmly they
            are held.
        """
        seen = np.repeat(visible, 3, axis=1)
        y = np.where(seen, displacements.reshape(len(seen), -1), 0.0)
        t0 = np.clip(start, 0.0, 1.0).astype(np.float32)
        predicted, slope = self.linearise(t0)
        left = np.where(seen, y - predicted, 0.0).astype(np.float32)
        unknown = self.forward.residual2 if slope is None else self.forward.variance(t0)
        precision = self._prior_precision(left, visible, unknown)
        noise = CLEANED_NOISE_MM**2 + 0.5 * self.forward.residual2 + unknown
        weight = np.repeat(visible / (self.common * noise), 3, axis=1).astype(np.float32)
        data = (
            _SharedSlope(self._linear[0], weight) if slope is None else _FrameSlopes(slope, weight)
        )
        if not bounded:
            return FrameSolution(start, precision, left, data.hessian(precision))
        gradient, diagonal = data.gradient(left), data.diagonal
        t: RealArray = t0
        for _ in range(_TAIL_ROUNDS):
            prior = precision / np.maximum(
                np.abs(t - t0) * np.sqrt(precision) / _TAIL_DEVIATIONS, 1
            )
            t = t0 + descend_in_boxes(
                data.product(prior),
                diagonal + prior,
                gradient,
                lower=-t0,
                upper=1 - t0,
                start=t - t0,
                steps=_GRADIENT_STEPS,
            )
        left = np.where(seen, left - data.moved(t - t0), 0)
        targets = np.clip(t, 0.0, 1.0).astype(np.float64)
        return FrameSolution(targets, prior, left, data.hessian(prior))

    def doubt(
        self, solution: FrameSolution, start: FloatArray, confidence: RealArray
    ) -> FrameSolution:
        """Return a solution as firmly held as its markers are known: its weights stay.

        A marker whose motion is known to the share c adds ``(1 - c) m_k / 3`` to the variance of
        its coordinates, ``m_k`` being its mean squared motion.

        Parameters
        ----------
        start : (frames, shapes) float array
            t0.
        confidence : (frames, markers) float array
            ``c`` [0-1]; 0 where a marker is not seen.
        """
        t0 = np.clip(start, 0.0, 1.0).astype(np.float32)
        _, slope = self.linearise(t0)
        unknown = self.forward.residual2 if slope is None else self.forward.variance(t0)
        noise = CLEANED_NOISE_MM**2 + 0.5 * self.forward.residual2 + unknown
        known = noise / (noise + (1 - confidence) * self.forward.motion2 / 3) * (confidence > 0)
        weight = np.repeat(known / (self.common * noise), 3, axis=1).astype(np.float32)
        data = (
            _SharedSlope(self._linear[0], weight) if slope is None else _FrameSlopes(slope, weight)
        )
        step = (solution.targets - t0).astype(np.float32)
        left = solution.left + data.moved(step)
        precision = self._prior_precision(left * (weight > 0), known, unknown)
        tail = np.maximum(np.abs(step) * np.sqrt(precision) / _TAIL_DEVIATIONS, 1)
        prior = np.asarray(precision / tail, dtype=np.float32)
        return replace(solution, precision=prior, hessian=data.hessian(prior))

    def linearise(self, targets: RealArray) -> tuple[Float32Array, Float32Array | None]:
        """Return where weights put the markers, and the derivatives.

        Parameters
        ----------
        targets : (frames, shapes) float array
            Bent weights.

        Returns
        -------
        displacements : (frames, 3 markers) float32 array
            [mm]
        slope : (frames, shapes, 3 markers) float32 array or None
            None on rigs of many shapes, whose quadratic part is left out.
        """
        basis, offset, curvature = self._linear
        t, driven = single_precision(targets), self.forward.driven
        predicted, slope = t @ basis + offset, None
        if curvature is not None:
            slope = (t @ curvature).reshape(len(t), *basis.shape)
            predicted += (t[:, None] @ slope)[:, 0]
            slope *= 2
            slope += basis
        if driven is not None:
            predicted += driven.put(t, self.forward.scales.curve, slope)
        return predicted, slope

    @cached_property
    def residual2(self) -> FloatArray:
        """Expected squared residual of a coordinate at right weights: (markers,) [mm^2]."""
        return np.asarray(CLEANED_NOISE_MM**2 + self.forward.residual2)

    @cached_property
    def marker_share(self) -> FloatArray:
        """``h``, how much each marker shows of each shape: (shapes, markers), rows of sum 1."""
        shown = self.forward.shape_size2 / (self.residual2 + self._carried)
        return np.asarray(shown / np.maximum(shown.sum(axis=1, keepdims=True), 1e-9))

    @cached_property
    def _carried(self) -> FloatArray:
        """Variance that the usual errors leave in a coordinate: (markers,) [mm^2]."""
        return np.asarray(self.error**2 @ ((self.forward.basis**2).sum(axis=2) / 3))

    @cached_property
    def _linear(self) -> tuple[Float32Array, Float32Array, Float32Array | None]:
        """Return basis (shapes, 3 markers), offset (3 markers) and packed curvature."""
        model = self.forward
        basis = single_precision(model.basis.reshape(len(model.basis), -1))
        curvature = None
        if len(basis) <= _MOST_SHAPES:
            curvature = single_precision(model.curvature().reshape(len(basis), -1))
        return basis, model.offset.reshape(-1).astype(np.float32), curvature

    @cached_property
    def usual_posteriors(self) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        """Return prior variance and posterior covariance at the narrowest and the widest prior.

        Returns
        -------
        error2, narrow : (shapes,) and (shapes, shapes) float arrays
        spread2, wide : (shapes,) and (shapes, shapes) float arrays
        """
        noise = CLEANED_NOISE_MM**2 + 1.5 * self.forward.residual2
        weighted = self.forward.basis / (self.common * noise)[:, None]
        markers = np.einsum("skc,tkc->st", weighted, self.forward.basis, optimize=True)
        error2 = np.maximum(self.error, _LEAST_ERROR) ** 2
        spread2 = np.maximum(self._spread**2, error2)
        narrow, wide = (np.linalg.inv(markers + np.diag(1 / each)) for each in (error2, spread2))
        return error2, narrow, spread2, wide

    @cached_property
    def _spread(self) -> FloatArray:
        return np.asarray(
            _WIDEST_SHARE * np.maximum(self.forward.targets.std(axis=0), _LEAST_SPREAD)
        )

    def _prior_precision(
        self, left: RealArray, visible: RealArray | BoolArray, unknown: RealArray
    ) -> Float32Array:
        """Return ``1 / sd^2`` of each shape, (frames, shapes); markers may be visible in part."""
        squared = (left.reshape(len(left), -1, 3) ** 2).sum(axis=2) / 3
        chi2 = (squared / (self.residual2 + self._carried + unknown)) @ self.marker_share.T
        seen = 1 - (1 - visible) @ self.marker_share.T
        chi2 /= np.maximum(seen, 1e-9)
        decades = np.log(np.maximum(chi2, 1e-9) / _FAMILIAR_CHI2)
        strange = np.clip(decades / np.log(_STRANGE_CHI2 / _FAMILIAR_CHI2), 0.0, 1.0)
        strange = 1 - (1 - strange) * seen
        error = np.maximum(self.error, _LEAST_ERROR)
        deviation = error * (np.maximum(self._spread, error) / error) ** strange
        return np.asarray(1 / deviation**2, dtype=np.float32)


class _FrameSlopes:
    """The markers' half of the sum, where each frame has a slope: ``sum w (left - slope' d)^2``."""

    def __init__(self, slope: RealArray, weight: RealArray) -> None:
        self._slope, self._weighted = slope, slope * weight[:, None]
        self._squared = self._weighted @ slope.transpose(0, 2, 1)
        self.diagonal = np.einsum("fss->fs", self._squared)

    def gradient(self, left: RealArray) -> RealArray:
        return np.asarray((self._weighted @ left[:, :, None])[:, :, 0])

    def moved(self, step: RealArray) -> RealArray:
        """Return what a step does to the markers."""
        return np.asarray((step[:, None] @ self._slope)[:, 0])

    def hessian(self, prior: RealArray) -> RealArray:
        """Return the matrices, with a prior's precision on their diagonals."""
        system = self._squared.copy()
        diagonal = np.arange(system.shape[1])
        system[:, diagonal, diagonal] += prior
        return system

    def product(self, prior: RealArray) -> Callable[[RealArray], RealArray]:
        system = self.hessian(prior)
        return lambda rows: (system @ rows[:, :, None])[:, :, 0]


class _SharedSlope:
    """The same where shapes are too many: one slope for all frames, and no matrix."""

    def __init__(self, slope: RealArray, weight: RealArray) -> None:
        self._slope, self._weight = slope, weight
        self.diagonal = weight @ (slope**2).T

    def gradient(self, left: RealArray) -> RealArray:
        return np.asarray((self._weight * left) @ self._slope.T)

    def moved(self, step: RealArray) -> RealArray:
        return np.asarray(step @ self._slope)

    def hessian(self, _prior: RealArray) -> None:
        return None

    def product(self, prior: RealArray) -> Callable[[RealArray], RealArray]:
        return lambda rows: self.gradient(rows @ self._slope) + prior * rows
