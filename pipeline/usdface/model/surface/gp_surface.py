"""Gaussian process over a surface (W06): displacements of a mesh from noisy markers."""

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import ClassVar, Literal

import numpy as np

from usdface.core.arrays import BoolArray, Float32Array, FloatArray, frame_blocks, nearest_distances
from usdface.core.errors import InputError
from usdface.core.processes import background_threads
from usdface.model.surface.distance import BLEND_PUBLISHED, SurfaceDistances
from usdface.model.surface.fit import (
    BLENDS_TRIED,
    SurfaceDiagnostics,
    SurfaceModel,
    SurfaceMotion,
    check_fit,
    find_surface_folds,
    fitted_frames,
)
from usdface.numerics.manifold.hybrid_monte_carlo import (
    CommonRandomNumbers,
    effective_sample_size,
    split_rhat,
)
from usdface.numerics.manifold.hyper_posterior import (
    HyperPrior,
    MarkerSpectrum,
    SharedTable,
    decompose,
)
from usdface.numerics.manifold.hyper_sampling import (
    fit_shared_mode,
    sample_hyperparameters,
    sample_shared,
)
from usdface.numerics.manifold.posterior_prediction import (
    SpreadFactors,
    average_dual_weights,
    calibrate_spread,
    frame_factors,
    join_moments,
    leave_markers_out,
    marker_precisions,
    mix_variances,
    predict_mean,
    predict_variance,
    prior_shares,
    surface_basis,
)
from usdface.numerics.manifold.surface_fields import (
    CovarianceShape,
    SurfaceCovariance,
    fit_covariance,
    similarity,
)
from usdface.numerics.manifold.unseen_markers import unseen_variances

Sampler = Literal["hmc", "shared"]

SCALES_TRIED = (1.0, 1.5, 2.0, 3.0, 4.5, 7.0, 12.0)
"""Length scales, in units of the median distance from a marker to the nearest other."""

SAMPLES_PUBLISHED = 200
"""Samples of the hyper-parameters (W06, section 4.1)."""

_CALIBRATION_SAMPLES = 10
"""Samples of each chain for the calibration of intervals."""

_SAMPLED_FRAMES = 1024
"""Frames whose chains run together: half as many take 20 % longer and 75 MB less memory."""

_MOMENT_FRAMES = 8
"""Frames whose dual weights are averaged together."""


@dataclass(frozen=True)
class GpOptions:
    """Options of `fit_gp_surface`."""

    sampler: Sampler = "hmc"
    """Hyper-parameters: Hybrid Monte Carlo for each frame and axis, as published (``'hmc'``), or
    for the whole take (``'shared'``)."""
    blend: float | None = BLEND_PUBLISHED
    """Share of the geodesic distance [0-1]; None: chosen by leave-one-out."""
    length_scale: float | None = None
    """[mm]; None: chosen by leave-one-out."""
    covariance: CovarianceShape = "creased"
    """``'published'`` is eq. 7."""
    prior: HyperPrior = field(default_factory=HyperPrior)
    folds: bool = True
    """Whether points in folds, such as the insides of lips, follow the markers of their side; no
    effect if `blend` is 0."""
    samples: int = SAMPLES_PUBLISHED
    burn_in: int = 40
    """`samples`, `burn_in`: Saved samples of ``'hmc'`` and ``'shared'``, and those before, in which
    the step size is tuned."""


@dataclass(frozen=True)
class GpSurface(SurfaceModel):
    """A fitted Gaussian process."""

    predicts_sd: ClassVar[bool] = True

    options: GpOptions
    table: SharedTable = field(repr=False)
    """Table of the posterior's energy."""
    basis: Float32Array = field(repr=False)
    """(points, markers + 4): see `surface_basis`."""
    factors: SpreadFactors = field(repr=False)
    """Calibration of standard deviations."""
    added: Float32Array = field(repr=False)
    """(points,): variance that the prior and folds add, as a share of v0."""
    alone: BoolArray = field(repr=False)
    """(points,): those of parts without a marker."""
    typical: FloatArray = field(repr=False)
    """(4,): mean log hyper-parameters of the frames of the fit."""
    shared: FloatArray | None = field(repr=False)
    """(samples, 4): log hyper-parameters of the whole take, with the sampler ``'shared'``."""

    @property
    def least_variance(self) -> float:
        """Variance of a point at which all N markers are, ``1 / (1 / v0 + N / v1)`` [mm^2].

        Rounding in single precision may give less.
        """
        v0, v1 = np.exp(self.typical[:2])
        return float(1.0 / (1.0 / v0 + self.marker_count / v1))

    def _predict(
        self, moved: FloatArray, measured: BoolArray, size: int
    ) -> Iterator[SurfaceMotion]:
        # The next block is sampled while this one is predicted.
        with background_threads() as submit:
            sampled = submit(self._sample, moved[:_SAMPLED_FRAMES])
            for rows in frame_blocks(len(moved), frames=_SAMPLED_FRAMES):
                theta = sampled.result()
                following = moved[rows.stop : rows.stop + _SAMPLED_FRAMES]
                sampled = submit(self._sample, following)
                block, known = moved[rows], measured[rows]
                for part in frame_blocks(len(block), frames=size):
                    yield self._fields(block[part], known[part], theta[..., part])

    def _sample(self, moved: FloatArray) -> FloatArray:
        """Return hyper-parameters of each frame and axis: (samples, 4, 3, frames)."""
        if self.shared is not None:
            return np.broadcast_to(
                self.shared[:, :, None, None], (*self.shared.shape, 3, len(moved))
            )
        if not len(moved):
            return np.zeros((0, 4, 3, 0))
        # The same random numbers for all frames: sampling errors of neighbouring frames are equal.
        rng = CommonRandomNumbers(np.random.default_rng(0))
        rows = _rows_of_axes(moved)
        theta, _, _ = sample_hyperparameters(
            rng, self.table, rows, burn=self.options.burn_in, keep=self.options.samples
        )
        return np.moveaxis(theta.reshape(len(theta), 4, len(moved), 3), 3, 2)

    def _fields(self, moved: FloatArray, measured: BoolArray, theta: FloatArray) -> SurfaceMotion:
        parts = []
        for part in frame_blocks(len(moved), frames=_MOMENT_FRAMES):
            chains = np.moveaxis(theta[..., part], 2, 3).reshape(len(theta), 4, -1)
            rows = _rows_of_axes(moved[part])
            parts.append(average_dual_weights(self.table.spectrum, rows, chains))
        moments = join_moments(parts)
        mean = predict_mean(self.basis, moments)
        shares = self.factors.of_axes**2 / 3.0
        mixed = mix_variances(moments, shares)
        variance = predict_variance(self.basis, mixed)
        np.maximum(variance, np.float32(shares.sum() * self.least_variance), out=variance)
        if not measured.all():
            variance += np.float32(shares.sum()) * unseen_variances(
                self.basis, self.table.spectrum, self.typical, measured, self.precision
            )
        # No marker tells how a separate part moves: its deviation is that of any point.
        variance[:, self.alone] = np.maximum(variance[:, self.alone], mixed.constant[:, None])
        variance += mixed.constant[:, None] * self.added
        sd = np.sqrt(variance) * self.factors.of_points
        if self.shared is not None:
            sd *= frame_factors(moved, self.precision, measured).astype(np.float32)[:, None]
        return SurfaceMotion(mean, sd)


def fit_gp_surface(
    distances: SurfaceDistances, displacements: FloatArray, options: GpOptions
) -> GpSurface:
    """Fit a Gaussian process to the markers of a mesh.

    Parameters
    ----------
    displacements : (frames, markers, 3) float array
        Of a take, from the neutral frame [mm]; settings are chosen on some of the frames.
    """
    frames = fitted_frames(check_fit(distances, displacements, options.blend))
    rows = _rows_of_axes(frames)
    try:
        chosen = _choose_settings(distances, rows, options)
    except ValueError as error:
        raise InputError(str(error)) from error
    covariance, table = chosen.covariance, SharedTable(chosen.spectrum)
    rng = np.random.default_rng(0)
    cross = covariance.cross(distances.blended_to_points(chosen.blend))
    places = distances.scaled(distances.points)
    of_folds = np.zeros(len(places), np.float32)
    if options.folds and chosen.blend > 0:
        folds = find_surface_folds(distances)
        near = similarity(folds.away, chosen.length_scale, shape=options.covariance)
        of_folds[folds.points] = 2.0 * folds.share * (1.0 - near)
        folds.apply(cross, covariance.matrix())
        folds.apply(places, distances.scaled(distances.marker_positions))
    theta, facts = _sample_fitted(rng, table, rows, options)
    thin = max(1, len(theta) // _CALIBRATION_SAMPLES)
    errors, expected = leave_markers_out(chosen.spectrum, rows, theta[::thin], with_nearest=True)
    typical = theta.mean(axis=(0, 2))
    precision = marker_precisions(chosen.spectrum, typical[None])[0]
    if options.sampler == "shared":
        all_measured = np.ones(frames.shape[:2], np.bool_)
        of_frames = frame_factors(frames, precision, all_measured)
        expected = expected * np.repeat(of_frames, 3)[:, None]
    factors = calibrate_spread(errors, expected, covariance.matrix(), cross)
    return GpSurface(
        blend=chosen.blend,
        length_scale=chosen.length_scale,
        diagnostics=SurfaceDiagnostics(chosen.left_out_rms_mm, covariance.clipped, **facts),
        marker_count=frames.shape[1],
        point_count=len(places),
        precision=precision,
        options=options,
        table=table,
        basis=surface_basis(chosen.spectrum, cross, places),
        factors=factors,
        added=of_folds + _prior_shares(distances, chosen, factors, theta, options),
        alone=distances.unreached.points,
        typical=typical,
        shared=theta[:, :, 0] if options.sampler == "shared" else None,
    )


def _prior_shares(
    distances: SurfaceDistances,
    chosen: "_Settings",
    factors: SpreadFactors,
    theta: FloatArray,
    options: GpOptions,
) -> Float32Array:
    shortest = _median_spacing(distances.blended_between(chosen.blend))
    nearest = distances.blended_to_points(chosen.blend).min(axis=0)
    level = np.exp(theta[:, 0]).mean() * (factors.of_axes**2).mean() * factors.of_points**2
    return prior_shares(
        similarity(nearest, shortest, shape=options.covariance),
        level,
        options.prior,
        markers=len(chosen.spectrum.values),
    )


@dataclass(frozen=True)
class _Settings:
    blend: float
    length_scale: float
    covariance: SurfaceCovariance
    spectrum: MarkerSpectrum
    left_out_rms_mm: float


def _choose_settings(
    distances: SurfaceDistances, rows: FloatArray, options: GpOptions
) -> _Settings:
    """Choose settings that are not given by leave-one-out over the markers, in closed form."""
    tried = []
    places = distances.scaled(distances.marker_positions)
    for blend in BLENDS_TRIED if options.blend is None else (options.blend,):
        between = distances.blended_between(blend)
        spacing = _median_spacing(between)
        scales = [scale * spacing for scale in SCALES_TRIED]
        for scale in scales if options.length_scale is None else [options.length_scale]:
            covariance = fit_covariance(between, length_scale=scale, shape=options.covariance)
            spectrum = decompose(covariance.matrix(), places, options.prior)
            mode = fit_shared_mode(SharedTable(spectrum), rows).mode.astype(np.float64)
            errors, _ = leave_markers_out(spectrum, rows, mode[None])
            rms = float(np.sqrt((errors**2).mean()))
            tried.append(_Settings(blend, scale, covariance, spectrum, rms))
    return min(tried, key=lambda each: each.left_out_rms_mm)


def _sample_fitted(
    rng: np.random.Generator, table: SharedTable, rows: FloatArray, options: GpOptions
) -> tuple[FloatArray, dict[str, float]]:
    """Sample the fitted frames: theta (samples, 4, chains or 1), and diagnostics."""
    if options.sampler == "shared":
        shared = sample_shared(rng, table, rows, burn=options.burn_in, keep=options.samples)
        return shared.theta[:, :, None], {
            "acceptance": shared.acceptance,
            "effective_samples": shared.effective_samples,
            "rhat": shared.rhat,
        }
    burn, keep = options.burn_in, options.samples
    first, acceptance, modes = sample_hyperparameters(rng, table, rows, burn=burn, keep=keep)
    second, _, _ = sample_hyperparameters(rng, table, rows, burn=burn, keep=keep, modes=modes)
    both = np.stack([first, second], axis=1)
    return first, {
        "acceptance": float(np.mean(acceptance)),
        "effective_samples": float(np.median(effective_sample_size(both))) / 2,
        "rhat": float(np.median(split_rhat(both))),
        "two_modes": float(np.mean(modes.double)),
    }


def _median_spacing(between: FloatArray) -> float:
    """Return the median distance from a marker to the nearest other place [mm]."""
    return float(np.median(nearest_distances(between)))


def _rows_of_axes(moved: FloatArray) -> FloatArray:
    """Return one row per frame and axis: (frames * 3, markers)."""
    return np.ascontiguousarray(moved.transpose(0, 2, 1).reshape(-1, moved.shape[1]))
