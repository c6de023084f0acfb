"""Forward model of a performer's markers: displacements as a function of BlendShape weights.

The displacement ``y_k`` of marker k from the neutral [mm] is quadratic in the transformed weights
``t = bend(w, curve)``::

    y_k = b_k + t'(E_k + D_k) + t'Q_k t + e_k

``E``: displacement of the rig's surface at the marker, per shape (`fit_marker_basis`). ``D``:
deviation of the performer's motion from the rig's, independent per shape, with prior variance
``alpha^2 |E_sk|^2 + floor^2 reach_sk``. ``Q``: saturation of the skin and interaction of shapes,
zero for pairs of shapes of which one does not move the marker, so that shapes that are local on the
rig stay local. Each coordinate of a marker is a Gaussian process in t with covariance and noise ::

    k_k(t, u) = offset^2 + sum_s t_s u_s var(D_sk) + eta^2 / m_k (sum_s t_s u_s |E_sk|^2)^2
    noise     = sigma_k^2 + sum_s (tau^2 (t_s^2 + 1/25) + unset^2 [t_s = 0]) |E_sk|^2 / 3

``m_k``: mean squared motion of the marker [mm^2], at least 1; eta is dimensionless. The second term
of the noise propagates the errors of the keys, which animators set by eye: standard deviation about
tau at a weight of 1, tau / 5 at 0, and `unset` where small weights were not keyed
(`model.mapping.unset_keys`). The other scales (alpha, floor, eta, tau, curve, and sigma per marker)
maximise the marginal likelihood of the references (Rasmussen and Williams 2006, eq. 5.8) times the
prior of sigma. Predictions, predictive variance and leave-one-out residuals have closed forms (eq.
2.25, 2.26, 5.12). The motion of the rig's combination shapes is subtracted first (`driven_motion`).
"""

from dataclasses import astuple, dataclass, replace
from functools import cached_property

import numpy as np

from usdface.core.arrays import (
    Arrays,
    Float32Array,
    FloatArray,
    IntArray,
    RealArray,
    sample_frames,
    single_precision,
)
from usdface.core.errors import InputError
from usdface.model.regressions.bent_weights import bend
from usdface.model.regressions.driven_motion import DrivenMotion

_NOISES_MM = (0.05, 0.1, 0.2, 0.35, 0.6, 1.0)
"""Candidates of sigma, the noise of a marker's coordinate: from the best optical systems to skin
whose motion the rig cannot represent."""

_NOISE_MEDIAN_MM, _LOG_NOISE_DEVIATION = 0.15, 1.0
"""Log-normal prior of sigma: few references determine a single marker's noise poorly."""

_OFFSET_MM = 0.3
"""Prior standard deviation of the offset b, the error of the neutral."""

_REACH_MM = 25.0
"""Length scale over which a shape's motion may extend beyond its extent on the rig: about the
distance between neighbouring markers."""

_GLOBAL_REACH = 0.2
"""Reach at any distance: muscles also move skin far from where they insert."""

_MIN_SHAPE_MM2 = 0.5
"""Smallest normaliser of a shape's reach: the extent of a shape that moves less is noise."""

_MIN_MOTION_MM2 = 1.0
"""Smallest ``m_k``, for markers that the references hardly move."""

_ZERO_KEY_ERROR = 0.2
"""Standard deviation of the error of a key at 0, relative to that of a key at 1."""

_GRID: dict[str, tuple[float, ...]] = {
    "alpha": (0.15, 0.3, 0.6),
    "floor": (0.1, 0.2, 0.4),
    "eta": (0.05, 0.1, 0.2, 0.4),
    "tau": (0.0, 0.03, 0.06, 0.1, 0.15, 0.22),
    "curve": (0.0, 0.15, 0.3, 0.45),
}
"""Candidates of each scale; floor in mm, the others dimensionless. Values of curve stay below .5:
Q represents stronger saturation."""

_ASCENT_ROUNDS = 2
"""Passes of coordinate ascent over `_GRID`."""

_UNIFORM_DEVIATION = 12**-0.5
"""Standard deviation of a uniform distribution on [0, 1]."""

_MIN_SPREAD = 0.1
"""Smallest standard deviation of a weight over faces."""

_STILL_WEIGHT, _STILL_SPREAD = 0.25, 3**-0.5
"""Largest bent weight in the references of a shape that is still there, and its root mean square
distance from rest if it is uniform on [0, 1]: it may move in the next take."""

_COMMON_ERRORS = 32
"""Largest number of components of the errors that markers share: with 50 pairs, the others have
less than half of the variance of independent errors."""

_EVIDENCE_PAIRS, _EVIDENCE_MARKERS = 60, 48
"""Largest number of each in the evidence of the shared scales, which costs markers pairs^3."""


@dataclass(frozen=True)
class ForwardScales:
    """Scales that all markers share; formulas in the module's docstring."""

    alpha: float = 0.3
    """Standard deviation of D relative to the rig's motion."""
    floor: float = 0.1
    """Standard deviation of D where the rig does not move [mm]."""
    eta: float = 0.1
    """Standard deviation of the quadratic term at full weight, relative to the motion."""
    tau: float = 0.0
    """Standard deviation of the keys' relative error."""
    curve: float = 0.3
    """Parameter of `bend`."""
    unset: float = 0.0
    """Standard deviation of a bent weight whose key is exactly 0; not estimated with the others."""

    @property
    def has_key_errors(self) -> bool:
        """Whether the keys are taken to have errors."""
        return max(self.tau, self.unset) > 0

    def key_variance(self, keys: FloatArray) -> FloatArray:
        """Return the variance of the errors of bent keys: (pairs, shapes), as `keys`."""
        relative = self.tau**2 * (keys**2 + _ZERO_KEY_ERROR**2)
        return np.asarray(relative + self.unset**2 * (keys == 0))


@dataclass(frozen=True)
class ForwardModel:
    """Posterior of the forward model given references."""

    scales: ForwardScales
    shape_size2: FloatArray
    """(shapes, markers): ``|E_sk|^2`` [mm^2]."""
    deviation2: FloatArray
    """(shapes, markers): prior variance of D [mm^2]."""
    quadratic: FloatArray
    """(markers,): ``eta^2 / m_k`` [mm^-2]."""
    targets: FloatArray
    """(pairs, shapes): bent keys."""
    dual: FloatArray
    """(pairs, markers, 3): inverse covariance times the deviations from ``t'E`` [mm^-1]."""
    inverse: FloatArray
    """(markers, pairs, pairs): inverse covariance of the references, noise included [mm^-2]."""
    noise: FloatArray
    """(markers,): ``sigma_k^2`` [mm^2]."""
    basis: FloatArray
    """(shapes, markers, 3): posterior mean of ``E + D`` [mm]."""
    offset: FloatArray
    """(markers, 3): posterior mean of ``b`` [mm]."""
    spread: FloatArray
    """(shapes,): standard deviation of a bent weight, where a frame does not resemble the pairs."""
    driven: DrivenMotion | None = None
    """Motion of the rig's combination shapes, added to the model's."""

    @property
    def residuals(self) -> FloatArray:
        """Leave-one-out residuals of the references: (pairs, markers, 3) [mm]."""
        precision = np.einsum("knn->nk", self.inverse)[:, :, None]
        return np.asarray(self.dual / precision)

    @cached_property
    def residual_variance(self) -> FloatArray:
        """Mean squared leave-one-out residual of a coordinate of each marker: (markers,) [mm^2]."""
        return np.asarray((self.residuals**2).mean(axis=(0, 2)))

    @cached_property
    def common_errors(self) -> FloatArray:
        """Errors that markers share: (components, 3 markers).

        The performer's skin departs from the model over whole regions of the face. With N pairs and
        Z their leave-one-out residuals, each marker divided by the root mean square of its
        coordinates, the rows U are the largest principal components: ``U'U ~ Z'Z / N``.
        """
        size2 = (self.residuals**2).sum(axis=(0, 2), keepdims=True) / 3
        scaled = (self.residuals / np.sqrt(np.maximum(size2, 1e-12))).reshape(len(self.targets), -1)
        _, size, directions = np.linalg.svd(scaled, full_matrices=False)
        return np.asarray((size[:, None] * directions)[:_COMMON_ERRORS])

    @property
    def motion2(self) -> FloatArray:
        """Mean squared motion ``m_k`` of each marker over the references: (markers,) [mm^2]."""
        return np.asarray(self.scales.eta**2 / self.quadratic)

    @property
    def leave_one_out_variance(self) -> FloatArray:
        """Leave-one-out predictive variance of a coordinate: (pairs, markers) [mm^2].

        It includes the noise, but not the error of the pair's own key.
        """
        precision = np.einsum("knn->nk", self.inverse)
        key_variance = self.scales.key_variance(self.targets) @ self.shape_size2 / 3
        return np.asarray(np.maximum(1 / precision - key_variance, self.noise))

    def curvature(self) -> Float32Array:
        """Return the posterior mean of Q: (shapes, shapes, 3 markers), symmetric [mm]."""
        rows = (self.targets[:, :, None] * self.shape_size2).transpose(2, 0, 1)
        scaled = (self.dual * self.quadratic[None, :, None]).transpose(1, 2, 0)
        axes = [(rows * scaled[:, c, :, None]).transpose(0, 2, 1) @ rows for c in range(3)]
        mean = np.stack(axes, axis=3).transpose(1, 2, 0, 3)
        return np.ascontiguousarray(mean.reshape(*mean.shape[:2], -1), dtype=np.float32)

    def variance(self, targets: RealArray) -> FloatArray:
        """Return the predictive variance of a coordinate of each marker, without noise.

        In single precision, as it only weighs markers: rounding changes a marker's weight by less
        than 2 % in 99 % of the faces tried, and by 30 % in the worst combination of shapes. Returns
        (frames, markers) [mm^2].

        `targets`: bent weights, (frames, shapes).
        """
        t = single_precision(targets)
        linear, product, root = self._kernel_factors
        cross = t @ product
        cross *= cross
        cross += t @ linear
        cross += np.float32(_OFFSET_MM**2)
        prior = t**2 @ self.deviation2 + _OFFSET_MM**2
        prior += self.quadratic * (t**2 @ self.shape_size2) ** 2
        cross = cross @ root
        explained = np.einsum("kfn,kfn->fk", cross, cross)
        return np.asarray(np.maximum(prior - explained, 0.0))

    @cached_property
    def _kernel_factors(self) -> tuple[Float32Array, Float32Array, Float32Array]:
        """Return ``var(D) u`` and ``eta / sqrt(m) |E|^2 u``, and the Cholesky factor of `inverse`.

        u: `targets` of the pairs. The first two are (markers, shapes, pairs).
        """
        product = self.shape_size2.T * np.sqrt(self.quadratic)[:, None]
        u = self.targets.T
        factors = self.deviation2.T[:, :, None] * u, product[:, :, None] * u
        linear, quadratic = map(single_precision, factors)
        return linear, quadratic, single_precision(np.linalg.cholesky(self.inverse))

    def to_arrays(self) -> Arrays:
        """Return the model as arrays of a mapping, the input of `from_arrays`."""
        names = ("shape_size2", "deviation2", "quadratic", "targets", "dual", "inverse", "noise")
        arrays = {name: getattr(self, name) for name in (*names, "basis", "offset", "spread")}
        arrays["scales"] = np.array(astuple(self.scales))
        driven = {} if self.driven is None else self.driven.to_arrays()
        return {f"forward_{name}": array for name, array in arrays.items()} | driven

    @classmethod
    def from_arrays(cls, arrays: Arrays) -> "ForwardModel":
        """Rebuild the model from the arrays of a mapping."""
        fields = {
            name.removeprefix("forward_"): array
            for name, array in arrays.items()
            if name.startswith("forward_")
        }
        driven = DrivenMotion.from_arrays(arrays)
        try:
            return cls(ForwardScales(*fields.pop("scales").tolist()), **fields, driven=driven)
        except (KeyError, TypeError) as error:
            raise InputError(
                f"the mapping's arrays of its forward model are incomplete: {error}; train it again"
            ) from error


def fit_forward_model(
    weights: FloatArray,
    displacements: FloatArray,
    *,
    expected: FloatArray,
    neutral: FloatArray,
    scales: ForwardScales | None = None,
    unset: float = 0.0,
    lids: IntArray | None = None,
) -> ForwardModel:
    """Return the posterior given references, at the scales that maximise their evidence.

    Parameters
    ----------
    weights : (pairs, shapes) float array
        Normalised: [0-1] over each shape's range.
    displacements : (pairs, markers, 3) float array
        From the neutral [mm].
    expected : (shapes, markers, 3) float array
        ``E`` [mm].
    neutral : (markers, 3) float array
        Marker positions [mm].
    scales : ForwardScales, optional
        Fixed scales; by default they are estimated.
    unset : float
        The scale of this name, if the others are estimated.
    lids : int array, optional
        As of `weight_spread`.
    """
    if scales is None:
        scales = _maximise_evidence(weights, displacements, expected, neutral, unset)
    return _Prior(weights, displacements, expected, neutral, scales).posterior(lids)


def weight_spread(targets: FloatArray, lids: IntArray | None = None) -> FloatArray:
    """Return the standard deviation of weights where a frame does not resemble the references.

    That of a uniform distribution between rest and the largest weight in the references; for shapes
    that are at rest there, `_STILL_SPREAD`. Returns (shapes,).

    Parameters
    ----------
    targets : (pairs, shapes) float array
        Bent weights.
    lids : int array, optional
        Shapes of the lids, which never get `_STILL_SPREAD`: markers above the lids follow the brows
        as well, and eyes that close with the brows are a conspicuous error.
    """
    largest = targets.max(axis=0)
    still = largest <= _STILL_WEIGHT
    if lids is not None:
        still[lids] = False
    moving = np.maximum(_UNIFORM_DEVIATION * largest, _MIN_SPREAD)
    return np.where(still, _STILL_SPREAD, moving)


def _maximise_evidence(
    weights: FloatArray,
    displacements: FloatArray,
    expected: FloatArray,
    neutral: FloatArray,
    unset: float,
) -> ForwardScales:
    """Return the scales of largest evidence, by coordinate ascent on a sample of the data."""
    rows = sample_frames(len(weights), _EVIDENCE_PAIRS)
    columns = sample_frames(len(neutral), _EVIDENCE_MARKERS)
    sample = weights[rows], displacements[rows][:, columns], expected[:, columns], neutral[columns]
    scales, cache = ForwardScales(unset=unset), dict[ForwardScales, float]()

    def evidence(candidate: ForwardScales) -> float:
        if candidate not in cache:
            cache[candidate] = float(_Prior(*sample, candidate).log_evidence().max(axis=0).sum())
        return cache[candidate]

    for _ in range(_ASCENT_ROUNDS):
        for name, values in _GRID.items():
            scales = max((replace(scales, **{name: value}) for value in values), key=evidence)
    return scales


class _Prior:
    """Prior of the model, with the covariance of the pairs under it, sigma left out."""

    def __init__(
        self,
        weights: FloatArray,
        displacements: FloatArray,
        expected: FloatArray,
        neutral: FloatArray,
        scales: ForwardScales,
    ) -> None:
        t = bend(weights, scales.curve)
        size2 = (expected**2).sum(axis=2)
        self.scales, self.targets, self.expected, self.size2 = scales, t, expected, size2
        self.deviation2 = scales.alpha**2 * size2 + scales.floor**2 * _reach(size2, neutral)
        motion2 = (displacements**2).sum(axis=2).mean(axis=0)
        self.quadratic = scales.eta**2 / np.maximum(motion2, _MIN_MOTION_MM2)
        deviations = displacements - np.einsum("ns,skc->nkc", t, expected, optimize=True)
        self.deviations = deviations.transpose(1, 0, 2)
        covariance: FloatArray = (t * size2.T[:, None, :]) @ t.T
        covariance **= 2
        covariance *= self.quadratic[:, None, None]
        covariance += (t * self.deviation2.T[:, None, :]) @ t.T
        covariance += _OFFSET_MM**2
        diagonal = np.arange(len(t))
        covariance[:, diagonal, diagonal] += (scales.key_variance(t) @ size2 / 3).T
        self.covariance = covariance

    def log_evidence(self) -> FloatArray:
        """Return the log evidence per candidate of sigma, up to a constant: (noises, markers)."""
        count, axes = len(self.targets), self.deviations.shape[2]
        size2 = (self.deviations**2).sum(axis=(1, 2))
        # With the deviations d as further rows, the factor of C = LL' has the rows d'L'^-1 as well.
        extended = np.zeros((len(size2), count + axes, count + axes))
        extended[:, count:, :count] = self.deviations.transpose(0, 2, 1)
        rest = np.arange(count, count + axes)
        out = np.empty((len(_NOISES_MM), len(size2)))
        for row, sigma in enumerate(_NOISES_MM):
            extended[:, :count, :count] = self.covariance + sigma**2 * np.eye(count)
            extended[:, rest, rest] = 1 + size2[:, None] / sigma**2  # more than d'C^-1 d
            root = np.linalg.cholesky(extended)
            fit = (root[:, count:, :count] ** 2).sum(axis=(1, 2))
            log_determinant = 2 * np.log(np.einsum("knn->kn", root[:, :count, :count])).sum(axis=1)
            prior = (np.log(sigma / _NOISE_MEDIAN_MM) / _LOG_NOISE_DEVIATION) ** 2
            out[row] = -0.5 * (fit + 3 * log_determinant + prior)
        return out

    def posterior(self, lids: IntArray | None) -> ForwardModel:
        """Condition on the pairs, with the most probable sigma of each marker."""
        noise = np.array(_NOISES_MM)[self.log_evidence().argmax(axis=0)] ** 2
        inverse = np.linalg.inv(self.covariance + noise[:, None, None] * np.eye(len(self.targets)))
        dual = (inverse @ self.deviations).transpose(1, 0, 2)
        mean = np.einsum("sk,ns,nkc->skc", self.deviation2, self.targets, dual, optimize=True)
        return ForwardModel(
            self.scales,
            self.size2,
            self.deviation2,
            self.quadratic,
            self.targets,
            dual,
            inverse,
            noise,
            self.expected + mean,
            _OFFSET_MM**2 * dual.sum(axis=0),
            weight_spread(self.targets, lids),
        )


def _reach(size2: FloatArray, neutral: FloatArray) -> FloatArray:
    """Return the reach of each shape at each marker: (shapes, markers).

    ``reach_sk = max_j |E_sj|^2 exp(-d_kj^2 / 2 R^2) / max_j |E_sj|^2 + global``, d: distance of
    markers in the neutral.
    """
    largest = np.maximum(size2.max(axis=1, keepdims=True), _MIN_SHAPE_MM2)
    squared = ((neutral[:, None] - neutral) ** 2).sum(axis=2)
    proximity = np.exp(-0.5 * squared / _REACH_MM**2)
    near2 = np.stack([(size2 * near).max(axis=1) for near in proximity], axis=1)
    return np.asarray(near2 / largest + _GLOBAL_REACH)
