"""Bounded maximum a posteriori estimate of a frame's weights.

The prior is centred on the regression's prediction ``t0``, with its predictive standard deviation
``error``; the likelihood is that of the markers y under the forward model f (`forward_model`)::

    min over 0 <= t <= 1:   e' W e  +  sum_s rho((t_s - t0_s) / sd_s),    e = y - f(t)
    W^-1 = diag(sqrt r) (I + U'U) diag(sqrt r),    r_k = c (noise_k + predictive variance at t0)

of the visible markers (`frame_likelihood`). ``U``: errors that markers share
(`ForwardModel.common_errors`), as the performer's skin departs from the model over whole regions;
differences of markers, such as the aperture of an eye, are then known better than positions. ``c``:
variance inflation. The predictive variance gives markers less weight for combinations that no
reference shows. ``rho``: Huber's function, quadratic up to `_HUBER_THRESHOLD` and linear beyond, as
the regression has outliers.

``sd_s`` is interpolated, shape by shape, between the regression's error and the spread of the
shape's weight over faces. Where the markers that a shape moves agree with t0, the frame resembles
references and the regression determines the shape; where they disagree, the markers do. With
``v_k`` 1 where marker k is visible, else 0::

    chi2_s = sum_k h_sk v_k |y_k - f_k(t0)|^2 / (3 expected_k) / sum_k h_sk v_k
    g_s    = log(chi2_s / .3) / log(10 / .3), limited to [0, 1]
    sd_s   = error_s^(1 - g'_s) spread_s^g'_s,    1 - g'_s = (1 - g_s) sum_k h_sk v_k

``expected_k``: variance of a coordinate in frames similar to references, due to noise, predictive
variance and the regression's error. ``h_sk``: share of marker k in the information of the markers
on shape s; its sum over k is 1. The more of its markers are occluded, the closer a shape's sd is to
its spread. The transition takes one and a half decades of chi2, so that it adds no jitter.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from usdface.core.arrays import (
    Arrays,
    BoolArray,
    Float32Array,
    FloatArray,
    RealArray,
    single_precision,
)
from usdface.core.assets import MEASURED_CONFIDENCE
from usdface.model.regressions.bent_weights import unbend_slope
from usdface.model.regressions.forward_model import ForwardModel
from usdface.model.regressions.frame_likelihood import FrameJacobians, MarkerWeight, SharedJacobian
from usdface.numerics.solve.bounded_least_squares import minimise_within_bounds
from usdface.numerics.solve.hessian import invert_by_halves

CLEANED_NOISE_MM = 0.05
"""Standard deviation of a marker's coordinate after cleaning."""

MARKER_INFLATION, LANDMARK_INFLATION = 1.0, 9.0
"""``c`` of optical markers, and of landmarks detected in images, whose errors depend on the pose of
the head and on light as well, and are correlated in time."""

_RESIDUAL_NOISE_SHARE = 0.5
"""Share of the mean squared leave-one-out residual that counts as noise: the residual also contains
predictive variance, which is added for each frame."""

_CHI2_FAMILIAR, _CHI2_UNFAMILIAR = 0.3, 10.0
"""chi2 up to which sd is the regression's error, and from which it is the spread."""

_MIN_ERROR = 0.01
"""Smallest error of a normalised weight: keys are not set more finely."""

_HUBER_THRESHOLD = 1.5
"""In standard deviations (Huber 1964: 1.345 is 95 % efficient)."""

_REWEIGHTING_ROUNDS = 2
"""Iteratively reweighted solves for the Huber function; the first is unweighted."""

_GRADIENT_STEPS = 30
"""Accelerated gradient steps of the bounded solve. The forward model is linearised once, at t0: a
second linearisation changes crosstake by less than .001 mm and doubles the time."""

_MAX_DENSE_SHAPES = 200
"""Largest number of shapes with a Jacobian and a Hessian per frame. Beyond, all frames share the
Jacobian at rest, the quadratic term is omitted, and uncertainty is interpolated between
`limiting_posteriors`."""


@dataclass(frozen=True)
class FrameSolution:
    """Weights of frames, with the terms of their posterior covariance."""

    targets: FloatArray
    """(frames, shapes): bent weights [0-1]."""
    precision: RealArray
    """(frames, shapes): prior precision ``1 / sd^2`` after the last reweighting."""
    residual: RealArray
    """(frames, 3 markers): ``y - f(t)``, f linear about t0; 0 where a marker is hidden [mm]."""
    predictive: RealArray
    """(frames, markers): predictive variance of a coordinate at t0, without noise [mm^2]."""
    unknown2: RealArray
    """(frames, markers): mean squared error of the markers by their confidence [mm^2]."""
    hessian: RealArray | None
    """(frames, shapes, shapes): of half the objective; None for rigs of many shapes."""

    def covariance(self, curve: float) -> RealArray:
        """Return the posterior covariance of the normalised weights: (frames, shapes, shapes).

        Raises
        ------
        ValueError
            If there is no Hessian.
        """
        if self.hessian is None:
            raise ValueError("no Hessian per frame: the rig has too many shapes")
        slope = unbend_slope(self.targets, curve).astype(np.float32)
        covariance = invert_by_halves(self.hessian)
        covariance *= slope[:, :, None] * slope[:, None]
        return covariance


@dataclass(frozen=True)
class FrameSolver:
    """Estimator of frames' weights, given a forward model and the regression's error."""

    forward: ForwardModel
    error: FloatArray
    """(shapes,): root mean square of the error of t0 over the references."""
    inflation: float = MARKER_INFLATION
    """``c``, factor on the variance of the markers."""

    @classmethod
    def from_arrays(cls, arrays: Arrays) -> "FrameSolver":
        """Rebuild the solver from the arrays of a mapping."""
        inflation = arrays.get("common_error", np.array([MARKER_INFLATION]))
        return cls(ForwardModel.from_arrays(arrays), arrays["start_error"], float(inflation[0]))

    def to_arrays(self) -> Arrays:
        """Return the solver as arrays of a mapping, the input of `from_arrays`."""
        # Files have the name that `inflation` had in earlier versions.
        arrays = {"start_error": self.error, "common_error": np.array([self.inflation])}
        return self.forward.to_arrays() | arrays

    def solve(
        self,
        displacements: FloatArray,
        visible: BoolArray,
        prior_mean: FloatArray,
        prior_deviation: FloatArray | None = None,
        *,
        bounded: bool = True,
        confidence: RealArray | None = None,
    ) -> FrameSolution:
        """Estimate the weights of frames.

        Parameters
        ----------
        displacements : (frames, markers, 3) float array
            From the neutral [mm]; ignored where a marker is not visible.
        visible : (frames, markers) bool array
        prior_mean : (frames, shapes) float array
            t0: bent weights predicted by the regression [0-1].
        prior_deviation : (frames, shapes) float array, optional
            Standard deviation of the error of t0; by default `error` in each frame.
        bounded : bool
            If False, the weights stay at t0, the prediction of another method, and only the terms
            of their posterior covariance are computed.
        confidence : (frames, markers) float array, optional
            Confidence q in visible markers [0-1], which affects the posterior covariance, not the
            weights: in frames with some q below `MEASURED_CONFIDENCE`, the variance of coordinates
            is ``r_k + c (1 - q) m_k / 3``, with ``m_k`` the marker's mean squared motion.
        """
        seen = np.repeat(visible, 3, axis=1)
        y = np.where(seen, displacements.reshape(len(seen), -1), 0.0)
        t0 = np.clip(prior_mean, 0.0, 1.0).astype(np.float32)
        predicted, slope = self.linearise(t0)
        residual = np.where(seen, y - predicted, 0.0).astype(np.float32)
        # With many shapes, the mean over the pairs.
        variance = self.forward.residual_variance if slope is None else self.forward.variance(t0)
        predictive = np.broadcast_to(variance, visible.shape)
        error = self.error if prior_deviation is None else prior_deviation
        error = np.maximum(np.broadcast_to(error, t0.shape), _MIN_ERROR)
        precision = self._prior_precision(residual, visible, predictive, error)
        likelihood = self._likelihood(slope, visible, predictive)
        step, targets = np.zeros_like(t0), prior_mean
        if bounded:
            step, precision = _minimise(likelihood, residual, precision, t0)
            targets = np.clip(t0 + step, 0.0, 1.0).astype(np.float64)
        hessian, unknown2 = likelihood.hessian(precision), np.zeros(visible.shape)
        if confidence is not None and (confidence[visible] < MEASURED_CONFIDENCE).any():
            rows = np.flatnonzero((visible & (confidence < MEASURED_CONFIDENCE)).any(axis=1))
            unknown2[rows] = (1 - confidence[rows]) * self.forward.motion2
            visibility = visible[rows] * self._visibility(predictive[rows], confidence[rows])
            at_t0 = residual[rows] * np.repeat(visibility > 0, 3, axis=1)
            prior = self._prior_precision(at_t0, visibility, predictive[rows], error[rows])
            precision[rows] = prior / _huber_divisor(step[rows], prior)
            if hessian is not None and slope is not None:
                known = self._likelihood(slope[rows], visibility, predictive[rows])
                hessian[rows] = known.hessian(precision[rows])
        residual = np.where(seen, residual - likelihood.displacements(step), 0)
        return FrameSolution(targets, precision, residual, predictive, unknown2, hessian)

    def linearise(self, targets: RealArray) -> tuple[Float32Array, Float32Array | None]:
        """Return the forward model's prediction and its Jacobian.

        Parameters
        ----------
        targets : (frames, shapes) float array
            Bent weights.

        Returns
        -------
        displacements : (frames, 3 markers) float32 array
            [mm]
        slope : (frames, shapes, 3 markers) float32 array or None
            None for rigs of many shapes, whose quadratic term is omitted.
        """
        basis, offset, curvature = self._linear
        t, driven = single_precision(targets), self.forward.driven
        predicted, slope = t @ basis + offset, None
        if curvature is not None:
            slope = (t @ curvature).reshape(len(t), *basis.shape)
            predicted += 0.5 * (t[:, None] @ slope)[:, 0]
            slope += basis
        if driven is not None:
            predicted += driven.displacements(t, self.forward.scales.curve, slope)
        return predicted, slope

    @cached_property
    def residual_variance(self) -> FloatArray:
        """Expected squared residual of a coordinate at the true weights: (markers,) [mm^2]."""
        return np.asarray(CLEANED_NOISE_MM**2 + self.forward.residual_variance)

    @cached_property
    def marker_share(self) -> FloatArray:
        """``h``: (shapes, markers), squared motion over its variance, rows normalised to sum 1."""
        information = self.forward.shape_size2 / (self.residual_variance + self._propagated_error)
        return np.asarray(information / np.maximum(information.sum(axis=1, keepdims=True), 1e-9))

    @cached_property
    def limiting_posteriors(self) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        """Return prior variance and posterior covariance at the narrowest and the widest prior.

        Returns
        -------
        error2, narrow : (shapes,) and (shapes, shapes) float arrays
        spread2, wide : (shapes,) and (shapes, shapes) float arrays
        """
        variance = self.inflation * self._marker_variance(self.forward.residual_variance)
        weight = MarkerWeight(1 / variance[None], self.forward.common_errors)
        basis = self.forward.basis.reshape(1, len(self.error), -1)
        information = (weight(basis) @ basis.transpose(0, 2, 1))[0]
        error2 = np.maximum(self.error, _MIN_ERROR) ** 2
        spread2 = np.maximum(self.forward.spread**2, error2)
        narrow, wide = (
            np.linalg.inv(information + np.diag(1 / prior)) for prior in (error2, spread2)
        )
        return error2, narrow, spread2, wide

    @cached_property
    def _propagated_error(self) -> FloatArray:
        """Variance of a coordinate due to the error of t0: (markers,) [mm^2]."""
        return np.asarray(self.error**2 @ ((self.forward.basis**2).sum(axis=2) / 3))

    @cached_property
    def _linear(self) -> tuple[Float32Array, Float32Array, Float32Array | None]:
        """Return basis (shapes, 3 markers), offset (3 markers) and packed 2 Q, if it is used."""
        model = self.forward
        basis = single_precision(model.basis.reshape(len(model.basis), -1))
        curvature = None
        if len(self.error) <= _MAX_DENSE_SHAPES:
            curvature = single_precision(2 * model.curvature().reshape(len(basis), -1))
        return basis, model.offset.reshape(-1).astype(np.float32), curvature

    def _marker_variance(self, predictive: FloatArray) -> FloatArray:
        """Return ``r / c``: ([frames,] markers) [mm^2]."""
        noise = CLEANED_NOISE_MM**2 + _RESIDUAL_NOISE_SHARE * self.forward.residual_variance
        return np.asarray(noise + predictive)

    def _visibility(self, predictive: FloatArray, confidence: RealArray) -> FloatArray:
        """Return the share of a marker's information that is left at its confidence; 0 at 0."""
        variance, unknown = self._marker_variance(predictive), self.forward.motion2 / 3
        return np.asarray((confidence > 0) * variance / (variance + (1 - confidence) * unknown))

    def _likelihood(
        self, slope: RealArray | None, visibility: RealArray | BoolArray, predictive: FloatArray
    ) -> FrameJacobians | SharedJacobian:
        variance = self.inflation * self._marker_variance(predictive)
        weight = MarkerWeight(visibility / variance, self.forward.common_errors)
        if slope is None:
            return SharedJacobian(self._linear[0], weight)
        return FrameJacobians(slope, weight)

    def _prior_precision(
        self,
        residual: RealArray,
        visibility: RealArray | BoolArray,
        predictive: RealArray,
        error: FloatArray,
    ) -> Float32Array:
        """Return ``1 / sd^2`` from residuals at t0: (frames, shapes); visibility is in [0-1]."""
        squared = (residual.reshape(len(residual), -1, 3) ** 2).sum(axis=2) / 3
        expected = self.residual_variance + self._propagated_error + predictive
        chi2 = (visibility * squared / expected) @ self.marker_share.T
        seen = 1 - (1 - visibility) @ self.marker_share.T
        chi2 /= np.maximum(seen, 1e-9)
        decades = np.log(np.maximum(chi2, 1e-9) / _CHI2_FAMILIAR)
        gate = np.clip(decades / np.log(_CHI2_UNFAMILIAR / _CHI2_FAMILIAR), 0.0, 1.0)
        gate = 1 - (1 - gate) * seen
        deviation = error * (np.maximum(self.forward.spread, error) / error) ** gate
        return np.asarray(1 / deviation**2, dtype=np.float32)


def _minimise(
    likelihood: FrameJacobians | SharedJacobian,
    residual: Float32Array,
    precision: RealArray,
    t0: Float32Array,
) -> tuple[RealArray, RealArray]:
    """Return the step from t0 and the precision after the last reweighting."""
    gradient, diagonal = likelihood.gradient(residual), likelihood.diagonal
    step, reweighted = np.zeros_like(t0), precision
    for _ in range(_REWEIGHTING_ROUNDS):
        reweighted = precision / _huber_divisor(step, precision)
        step = minimise_within_bounds(
            likelihood.product(reweighted),
            diagonal + reweighted,
            gradient,
            lower=-t0,
            upper=1 - t0,
            start=step,
            steps=_GRADIENT_STEPS,
        )
    return step, reweighted


def _huber_divisor(step: RealArray, precision: RealArray) -> RealArray:
    """Return the divisor of the precision that makes the quadratic prior tangent to Huber's."""
    return np.asarray(np.maximum(np.abs(step) * np.sqrt(precision) / _HUBER_THRESHOLD, 1))
