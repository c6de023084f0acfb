"""What weights do to a performer's markers: the rig's motion, corrected by the references.

For marker k, displacement ``y_k`` from the neutral [mm], and bent weights ``t`` (`bend`)::

    y_k = b_k + t'(E_k + D_k) + t'Q_k t + e_k

``E``: what the rig's shapes do where the marker sits (`expect_marker_motion`). ``D``: what the
performer's skin does otherwise, independent per shape, with variance ``alpha^2 |E_sk|^2 + floor^2
reach_sk``: in proportion to the rig's motion, and a little beside it, near what the shape moves.
``Q``: skin that saturates and shapes that pile up; only shapes that move a marker bend each other
there, so that what is local on the rig stays local. Each coordinate is a Gaussian process in t with

    k_k(t, u) = offset^2 + sum_s t_s u_s var(D_sk) + eta^2 / m_k (sum_s t_s u_s |E_sk|^2)^2
    noise     = sigma_k^2 + sum_s tau^2 (t_s^2 + 1/25) |E_sk|^2 / 3

``m_k`` is the marker's mean squared motion, so that eta has no unit. The second part of the noise
is that of the keys, which are set by eye: each is off by the share tau of itself, and by a fifth of
tau where it is small. Every scale (alpha, floor, eta, tau, the bend, and sigma per marker) is the
one under which the references are most probable, marginal over D and Q (Rasmussen and Williams
2006, eq. 5.8). Predictions, predictive variance and leave-one-out residuals are in closed form (eq.
2.25, 2.26 and 5.12). What combination shapes of the rig do is known, and taken out before.
"""

from dataclasses import dataclass, replace

import numpy as np

from usdface.core.arrays import Float32Array, FloatArray, RealArray, sample_frames
from usdface.model.regressions.base import Arrays, bend
from usdface.model.regressions.driven_motion import DrivenMotion

_NOISES_MM = (0.05, 0.1, 0.2, 0.35, 0.6, 1.0)
"""Noise of a marker's coordinate, tried for each marker: optical systems at their best, to skin
that no shape of the rig moves so."""

_USUAL_NOISE_MM, _LOG_NOISE_DEVIATION = 0.15, 1.0
"""Prior of that noise: few references tell little of one marker's."""

_OFFSET_MM = 0.3
"""Standard deviation of the neutral's error."""

_REACH_MM = 25.0
"""How far beside its motion on the rig a shape may move the performer's skin: about the distance
between neighbouring markers."""

_ANYWHERE_SHARE = 0.2
"""Of that variance, everywhere on the face: chains of muscles end far from where they pull."""

_LEAST_SHAPE_MM2 = 0.5
"""Largest squared motion of a shape below which it counts as having no place of its own."""

_ZERO_KEY_SHARE = 0.2
"""Error of a key at 0, in errors of a key at 1."""

_GRID: dict[str, tuple[float, ...]] = {
    "alpha": (0.15, 0.3, 0.6),
    "floor": (0.1, 0.2, 0.4),
    "eta": (0.05, 0.1, 0.2, 0.4),
    "tau": (0.0, 0.03, 0.06, 0.1, 0.15, 0.22),
    "curve": (0.0, 0.15, 0.3, 0.45),
}
"""Values tried of each scale [share; mm; share; share; bend], one after the other, twice. Of the
bend the quadratic part does the rest."""

_CLIMB_ROUNDS = 2
_EVIDENCE_PAIRS, _EVIDENCE_MARKERS = 60, 48
"""Most of each that the scales, which all share, are chosen by: the time is their product with the
pairs squared."""


@dataclass(frozen=True)
class ForwardScales:
    """Scales of the model's parts, shared by all markers; see the module."""

    alpha: float = 0.3
    """Difference of the performer's motion from the rig's, as a share of it."""
    floor: float = 0.1
    """The same where the rig does not move [mm]."""
    eta: float = 0.1
    """Quadratic part at full weight, as a share of the motion."""
    tau: float = 0.0
    """Error of keys, as a share of them."""
    curve: float = 0.3
    """Bend of weights, for all shapes."""

    def key_variance(self, targets: FloatArray) -> FloatArray:
        """Return the variance of the keys' errors, of the shape of the bent keys given."""
        return np.asarray(self.tau**2 * (targets**2 + _ZERO_KEY_SHARE**2))


@dataclass(frozen=True)
class ForwardModel:
    """The posterior of the model given references."""

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
    """(pairs, markers, 3)"""
    inverse: FloatArray
    """(markers, pairs, pairs): of the references' covariance, noise included [mm^-2]."""
    noise: FloatArray
    """(markers,): ``sigma_k^2`` [mm^2]."""
    basis: FloatArray
    """(shapes, markers, 3): ``E + D`` [mm]."""
    offset: FloatArray
    """(markers, 3): ``b`` [mm]."""
    driven: DrivenMotion | None = None
    """What the rig's combinations do beside it."""

    @property
    def residuals(self) -> FloatArray:
        """Leave-one-out residuals of the references: (pairs, markers, 3) [mm]."""
        own = np.einsum("knn->nk", self.inverse)[:, :, None]
        return np.asarray(self.dual / own)

    @property
    def residual2(self) -> FloatArray:
        """Mean squared leave-one-out residual of a coordinate of each marker: (markers,) [mm^2]."""
        return np.asarray((self.residuals**2).mean(axis=(0, 2)))

    @property
    def motion2(self) -> FloatArray:
        """Mean squared motion ``m_k`` of each marker over the references: (markers,) [mm^2]."""
        return np.asarray(self.scales.eta**2 / self.quadratic)

    @property
    def unseen_variance(self) -> FloatArray:
        """Variance of a coordinate of each reference for a model without it: (pairs, markers).

        Noise is part of it, the error of the reference's own key is not [mm^2].
        """
        own = np.einsum("knn->nk", self.inverse)
        keys = self.scales.key_variance(self.targets) @ self.shape_size2 / 3
        return np.asarray(np.maximum(1 / own - keys, self.noise))

    def curvature(self) -> Float32Array:
        """Return the posterior mean of Q: (shapes, shapes, 3 markers), symmetric [mm]."""
        rows = (self.targets[:, :, None] * self.shape_size2).transpose(2, 0, 1)
        scaled = (self.dual * self.quadratic[None, :, None]).transpose(1, 2, 0)
        parts = [(rows * scaled[:, c, :, None]).transpose(0, 2, 1) @ rows for c in range(3)]
        whole = np.stack(parts, axis=3).transpose(1, 2, 0, 3)
        return np.ascontiguousarray(whole.reshape(*whole.shape[:2], -1), dtype=np.float32)

    def variance(self, targets: RealArray) -> FloatArray:
        """Return what the references leave open of a coordinate of each marker.

        In double precision: what is left is a ten-thousandth of what it is the difference of.

        Parameters
        ----------
        targets : (frames, shapes) float array
            Bent weights.

        Returns
        -------
        (frames, markers) float array
            [mm^2]; noise is not part of it.
        """
        t = targets.astype(np.float64)
        known = _kernel(t, self.targets, self.deviation2, self.shape_size2, self.quadratic)
        prior = t**2 @ self.deviation2 + _OFFSET_MM**2
        prior += self.quadratic * (t**2 @ self.shape_size2) ** 2
        explained = ((known @ self.inverse) * known).sum(axis=2).T
        return np.asarray(np.maximum(prior - explained, 0.0))

    def to_arrays(self) -> Arrays:
        """Return what `from_arrays` reads, as arrays of a mapping."""
        names = ("shape_size2", "deviation2", "quadratic", "targets", "dual", "inverse", "noise")
        arrays = {name: getattr(self, name) for name in (*names, "basis", "offset")}
        scales = self.scales
        values = [scales.alpha, scales.floor, scales.eta, scales.tau, scales.curve]
        driven = {} if self.driven is None else self.driven.to_arrays()
        return {f"forward_{name}": each for name, each in arrays.items()} | {
            "forward_scales": np.array(values),
            **driven,
        }

    @classmethod
    def from_arrays(cls, arrays: Arrays) -> "ForwardModel":
        """Put a mapping's forward model together."""
        known = {
            name.removeprefix("forward_"): each
            for name, each in arrays.items()
            if name.startswith("forward_")
        }
        scales, driven = known.pop("scales").tolist(), DrivenMotion.from_arrays(arrays)
        return cls(ForwardScales(*scales), **known, driven=driven)


def fit_forward_model(
    weights: FloatArray,
    displacements: FloatArray,
    *,
    expected: FloatArray,
    neutral: FloatArray,
    scales: ForwardScales | None = None,
) -> ForwardModel:
    """Condition the model on references; its scales are chosen by their evidence.

    Parameters
    ----------
    weights : (pairs, shapes) float array
        Normalised: [0-1] over each shape's range.
    displacements : (pairs, markers, 3) float array
        From the neutral [mm].
    expected : (shapes, markers, 3) float array
        ``E`` [mm].
    neutral : (markers, 3) float array
        [mm]
    scales : ForwardScales, optional
        Given, they are not chosen.
    """
    if scales is None:
        scales = _choose_scales(weights, displacements, expected, neutral)
    return _Prior(weights, displacements, expected, neutral, scales).posterior()


def _choose_scales(
    weights: FloatArray, displacements: FloatArray, expected: FloatArray, neutral: FloatArray
) -> ForwardScales:
    """Climb the evidence, one scale at a time, on pairs and markers spread over all."""
    rows = sample_frames(len(weights), _EVIDENCE_PAIRS)
    columns = sample_frames(len(neutral), _EVIDENCE_MARKERS)
    some = weights[rows], displacements[rows][:, columns], expected[:, columns], neutral[columns]
    scales, tried = ForwardScales(), dict[ForwardScales, float]()

    def evidence(each: ForwardScales) -> float:
        if each not in tried:
            tried[each] = float(_Prior(*some, each).log_evidence().max(axis=0).sum())
        return tried[each]

    for _ in range(_CLIMB_ROUNDS):
        for name, values in _GRID.items():
            scales = max((replace(scales, **{name: each}) for each in values), key=evidence)
    return scales


class _Prior:
    """The model before any pair is seen, with the covariance that it gives the pairs."""

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
        self.quadratic = scales.eta**2 / np.maximum(motion2, 1.0)
        rest = displacements - np.einsum("ns,skc->nkc", t, expected, optimize=True)
        self.rest = rest.transpose(1, 0, 2)
        self.covariance = _kernel(t, t, self.deviation2, size2, self.quadratic)
        keys = scales.key_variance(t) @ size2 / 3
        diagonal = np.arange(len(t))
        self.covariance[:, diagonal, diagonal] += keys.T

    def log_evidence(self) -> FloatArray:
        """Return it for every noise tried, up to a constant: (noises, markers)."""
        out = np.empty((len(_NOISES_MM), len(self.covariance)))
        for row, sigma in enumerate(_NOISES_MM):
            root = np.linalg.cholesky(self.covariance + sigma**2 * np.eye(len(self.targets)))
            fit = (np.linalg.solve(root, self.rest) ** 2).sum(axis=(1, 2))
            log_determinant = 2 * np.log(np.einsum("knn->kn", root)).sum(axis=1)
            prior = (np.log(sigma / _USUAL_NOISE_MM) / _LOG_NOISE_DEVIATION) ** 2
            out[row] = -0.5 * (fit + 3 * log_determinant + prior)
        return out

    def posterior(self) -> ForwardModel:
        """Condition on the pairs, each marker's noise at its most probable."""
        noise = np.array(_NOISES_MM)[self.log_evidence().argmax(axis=0)] ** 2
        inverse = np.linalg.inv(self.covariance + noise[:, None, None] * np.eye(len(self.targets)))
        dual = (inverse @ self.rest).transpose(1, 0, 2)
        moved = np.einsum("sk,ns,nkc->skc", self.deviation2, self.targets, dual, optimize=True)
        return ForwardModel(
            self.scales,
            self.size2,
            self.deviation2,
            self.quadratic,
            self.targets,
            dual,
            inverse,
            noise,
            self.expected + moved,
            _OFFSET_MM**2 * dual.sum(axis=0),
        )


def _kernel(
    left: FloatArray,
    right: FloatArray,
    deviation2: FloatArray,
    size2: FloatArray,
    quadratic: FloatArray,
) -> FloatArray:
    """Return the covariance of a coordinate of each marker: (markers, left, right) [mm^2]."""
    covariance: FloatArray = (left * size2.T[:, None, :]) @ right.T
    covariance **= 2
    covariance *= quadratic[:, None, None]
    covariance += (left * deviation2.T[:, None, :]) @ right.T
    covariance += _OFFSET_MM**2
    return covariance


def _reach(size2: FloatArray, neutral: FloatArray) -> FloatArray:
    """Return how near each marker is to what each shape moves: (shapes, markers) [share]."""
    largest = np.maximum(size2.max(axis=1, keepdims=True), _LEAST_SHAPE_MM2)
    squared = ((neutral[:, None] - neutral) ** 2).sum(axis=2)
    near = np.exp(-0.5 * squared / _REACH_MM**2)
    return np.asarray((size2[:, None] * near).max(axis=2) / largest + _ANYWHERE_SHARE)
