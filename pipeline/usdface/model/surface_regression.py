"""Markers move any mesh: W06's regression over the surface, fitted once, streamed over a take."""

from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from usdface.assets import Float32Array, FloatArray
from usdface.errors import InputError
from usdface.model.surface_choice import choose_settings, marker_spectrum
from usdface.model.surface_diagnostics import SurfaceDiagnostics, sample_twice
from usdface.model.surface_distance import (
    BLEND,
    FEWEST_MARKERS,
    SurfaceDistances,
    UnreachedReport,
    surface_distances,
)
from usdface.numerics.manifold.fold_sides import FoldSides, find_fold_sides
from usdface.numerics.manifold.hyper_posterior import HyperPrior
from usdface.numerics.manifold.hyper_sampling import (
    draw_laplace,
    find_modes,
    sample_hyperparameters,
)
from usdface.numerics.manifold.left_out import Widening, calibrate_spread, leave_markers_out
from usdface.numerics.manifold.multiquadric import fit_distance_multiquadric, multiquadric_fields
from usdface.numerics.manifold.posterior_prediction import (
    SurfaceFields,
    average_dual_weights,
    join_moments,
    make_fields,
    mix_variances,
    predict_mean,
    predict_variance,
)
from usdface.numerics.manifold.shared_posterior import SharedSamples, sample_shared
from usdface.numerics.manifold.surface_covariance import Shape
from usdface.numerics.manifold.tabulated_energy import SharedTable
from usdface.progress import Progress, silent

__all__ = [
    "BLEND",
    "FEWEST_MARKERS",
    "SurfaceDiagnostics",
    "SurfaceDistances",
    "SurfaceMotion",
    "SurfaceRegression",
    "UnreachedReport",
    "fit_surface_regression",
    "surface_distances",
]

Method = Literal["gp", "rbf"]
Sampler = Literal["hmc", "map", "shared"]

SAMPLES = 200
"""Saved samples of the hyper-parameters: W06, section 4.1."""

_SAMPLED_FRAMES = 1024
"""Frames whose chains run in lockstep: half as many are a fifth slower and hold 75 MB less."""

_MOMENT_FRAMES = 8
_THINNED = 10  # samples of each chain by which intervals are calibrated
_FIELD_VALUES = 1 << 22
"""Points times frames of fields that are held at once."""


@dataclass(frozen=True)
class SurfaceMotion:
    """How a mesh moves.

    Attributes
    ----------
    mean : (frames, points, 3) float32 array
        Displacements from rest [mm].
    sd : (frames, points) float32 array or None
        Standard deviation of a coordinate: the root of the mean square over the axes [mm]. None
        where the method has none to tell (``'rbf'``).
    sd_of_axes : (frames, points, 3) float32 array or None
        The same for each axis by itself, on request [mm].
    """

    mean: Float32Array
    sd: Float32Array | None
    sd_of_axes: Float32Array | None = None


@dataclass(frozen=True)
class SurfaceRegression:
    """A fitted regression; see `fit_surface_regression`.

    Attributes
    ----------
    method : {'gp', 'rbf'}
    sampler : {'hmc', 'map', 'shared'}
    blend : float
        Share of the geodesic distance.
    length_scale : float
        [mm]; of the covariance. 0 for ``'rbf'``.
    diagnostics : SurfaceDiagnostics
    """

    method: Method
    sampler: Sampler
    blend: float
    length_scale: float
    diagnostics: SurfaceDiagnostics
    marker_count: int
    point_count: int
    operator: Float32Array | None = field(default=None, repr=False)
    widening: Widening | None = field(default=None, repr=False)
    table: SharedTable | None = field(default=None, repr=False)
    fields: SurfaceFields | None = field(default=None, repr=False)
    shared: SharedSamples | None = field(default=None, repr=False)
    samples: int = SAMPLES
    seed: int = 0

    def deform(
        self, displacements: FloatArray, *, of_axes: bool = False, progress: Progress = silent
    ) -> SurfaceMotion:
        """Move the whole mesh; the result is held in memory, `stream` holds a part.

        Parameters
        ----------
        displacements : (frames, markers, 3) float array
            Of the markers from the neutral frame [mm].
        of_axes : bool
            Whether `SurfaceMotion.sd_of_axes` is wanted too.
        progress : callable

        Raises
        ------
        InputError
            If markers are others than those fitted or positions are not finite.
        """
        parts = list(self.stream(displacements, of_axes=of_axes, progress=progress))
        return SurfaceMotion(
            np.concatenate([part.mean for part in parts]),
            _join([part.sd for part in parts]),
            _join([part.sd_of_axes for part in parts]),
        )

    def stream(
        self,
        displacements: FloatArray,
        *,
        frames_per_part: int | None = None,
        of_axes: bool = False,
        progress: Progress = silent,
    ) -> Iterator[SurfaceMotion]:
        """Move the mesh part by part: memory is bounded however long the take is.

        A part's result does not depend on how the take is cut.

        Parameters
        ----------
        displacements : (frames, markers, 3) float array
            [mm]
        frames_per_part : int, optional
            At most; by default about 16 MB of each field.
        of_axes : bool
        progress : callable
        """
        moved = _check_displacements(displacements, self.marker_count)
        size = frames_per_part or max(1, _FIELD_VALUES // max(self.point_count, 1))
        if not len(moved):
            yield SurfaceMotion(
                np.zeros((0, self.point_count, 3), np.float32),
                None if self.method == "rbf" else np.zeros((0, self.point_count), np.float32),
            )
        starts = range(0, len(moved), _SAMPLED_FRAMES)
        # the next block is sampled while this one becomes fields: two cores are busy
        with ThreadPoolExecutor(max_workers=1) as ahead:
            sampled = ahead.submit(self._sample, moved[:_SAMPLED_FRAMES], 0)
            for start in starts:
                theta = sampled.result()
                after = start + _SAMPLED_FRAMES
                sampled = ahead.submit(self._sample, moved[after : after + _SAMPLED_FRAMES], after)
                block = moved[start:after]
                for first in range(0, len(block), size):
                    part = slice(first, min(first + size, len(block)))
                    own = None if theta is None else theta[..., part]
                    yield self._fields(block[part], own, of_axes)
                    progress((start + part.stop) / len(moved), "moving the mesh")

    def _sample(self, moved: FloatArray, start: int) -> FloatArray | None:
        """Hyper-parameters of each frame and axis: (samples, 4, 3, frames)."""
        if self.table is None or self.shared is not None or not len(moved):
            return None
        rng = np.random.default_rng((self.seed, start))
        rows = _rows(moved)
        if self.sampler == "map":
            theta = draw_laplace(rng, self.table, find_modes(self.table, rows), keep=16)
        else:
            theta = sample_hyperparameters(rng, self.table, rows, keep=self.samples)[0].theta
        return np.moveaxis(theta.reshape(len(theta), 4, len(moved), 3), 3, 2)

    def _fields(self, moved: FloatArray, theta: FloatArray | None, of_axes: bool) -> SurfaceMotion:
        if self.operator is not None:
            flat = moved.astype(np.float32).transpose(1, 0, 2).reshape(self.marker_count, -1)
            mean = (self.operator @ flat).reshape(self.point_count, -1, 3).transpose(1, 0, 2)
            if self.shared is None:
                return SurfaceMotion(np.ascontiguousarray(mean), None)
        if self.table is None or self.fields is None or self.widening is None:
            raise InputError("this regression holds no surface; fit it again")
        parts = []
        for first in range(0, len(moved), _MOMENT_FRAMES):
            part = slice(first, first + _MOMENT_FRAMES)
            rows = _rows(moved[part])
            if theta is not None:
                own = np.moveaxis(theta[..., part], 2, 3).reshape(len(theta), 4, -1)
            elif self.shared is not None:
                own = np.repeat(self.shared.theta[:, :, None], len(rows), axis=2)
            parts.append(average_dual_weights(self.table.spectrum, rows, own))
        moments = join_moments(parts)
        shares = self.widening.of_axes**2
        sd = np.sqrt(predict_variance(self.fields, mix_variances(moments, shares / 3.0)))
        sd *= self.widening.of_points
        if not of_axes:
            return SurfaceMotion(predict_mean(self.fields, moments), sd)
        each = predict_variance(self.fields, moments).reshape(-1, 3, self.point_count)
        each = np.sqrt(each * shares.astype(np.float32)[:, None]) * self.widening.of_points
        each = np.ascontiguousarray(each.transpose(0, 2, 1))
        return SurfaceMotion(predict_mean(self.fields, moments), sd, each)


def _join(parts: list[Float32Array | None]) -> Float32Array | None:
    there = [part for part in parts if part is not None]
    return np.concatenate(there) if there and len(there) == len(parts) else None


def fit_surface_regression(
    distances: SurfaceDistances,
    displacements: FloatArray,
    *,
    method: Method = "gp",
    sampler: Sampler = "hmc",
    blend: float | None = BLEND,
    length_scale: float | None = None,
    covariance_shape: Shape = "creased",
    prior: HyperPrior | None = None,
    folds: bool = True,
    samples: int = SAMPLES,
    seed: int = 0,
) -> SurfaceRegression:
    """Fit a regression from markers to a surface.

    Parameters
    ----------
    distances : SurfaceDistances
    displacements : (frames, markers, 3) float array
        A take's, or frames spread over it, from the neutral frame [mm]. Settings are chosen on
        them; every frame is regressed by itself later.
    method : {'gp', 'rbf'}
        A Gaussian process under eq. 7, or multiquadrics.
    sampler : {'hmc', 'map', 'shared'}
        Hyper-parameters of each frame and axis by Hybrid Monte Carlo; by their mode and the
        Gaussian around it; or by one sample of them for the whole take.
    blend : float or None
        Share of the geodesic distance [0-1]; None chooses it by leaving markers out.
    length_scale : float, optional
        [mm]; by default chosen by leaving markers out.
    covariance_shape : {'creased', 'squared-exponential'}
        The second is eq. 7 as published.
    prior : HyperPrior, optional
    folds : bool
        Whether points in folds, such as the insides of lips, follow the markers of their own
        side; never where the distance is Euclidean (`blend` 0), which knows no sides.
    samples : int
    seed : int
        Of every random choice: the same take moves the same way each time.

    Raises
    ------
    InputError
        If displacements do not fit the markers or are not finite, or two markers sit at one place.
    """
    count = len(distances.marker_positions)
    moved = _check_displacements(displacements, count)
    if not len(moved):
        raise InputError("no frame to fit the regression to; give the take's displacements")
    if blend is not None and not 0 <= blend <= 1:
        raise InputError(f"blend is the geodesic distance's share, 0 to 1; got {blend}")
    try:
        chosen = choose_settings(
            distances,
            moved,
            method=method,
            blend=blend,
            length_scale=length_scale,
            shape=covariance_shape,
            prior=prior,
        )
    except ValueError as error:
        raise InputError(str(error)) from error
    points = distances.points
    between = distances.blended_between(chosen.blend)
    to_points = distances.blended_to_points(chosen.blend)
    sides = _sides(distances) if folds and chosen.blend > 0 else None
    if method == "rbf":
        operator = multiquadric_fields(fit_distance_multiquadric(between), to_points)
        if sides is not None:
            sides.apply(operator, np.eye(count))
        return SurfaceRegression(
            method=method,
            sampler=sampler,
            blend=chosen.blend,
            length_scale=0.0,
            diagnostics=SurfaceDiagnostics(0.0, chosen.left_out_rms_mm),
            marker_count=count,
            point_count=len(points),
            operator=operator,
        )
    spectrum, covariance = marker_spectrum(
        distances, chosen.blend, chosen.length_scale, shape=covariance_shape, prior=prior
    )
    table = SharedTable(spectrum)
    rng = np.random.default_rng(seed)
    cross = covariance.cross(to_points)
    places = distances.scaled(points).astype(np.float32)
    if sides is not None:
        sides.apply(cross, covariance.matrix())
        sides.apply(places, distances.scaled(distances.marker_positions))
    fields = make_fields(spectrum, cross, places, rng=rng)
    rows = _rows(chosen.frames)
    shared = None
    facts: dict[str, float] = {}
    if sampler == "shared":
        shared = sample_shared(rng, table, rows, keep=samples)
        theta = shared.theta[:, :, None]
        facts["acceptance"] = shared.acceptance
    elif sampler == "map":
        theta = find_modes(table, rows).theta[None]
    else:
        theta, facts = sample_twice(rng, table, rows, keep=samples)
    thin = max(1, len(theta) // _THINNED)
    left_out = leave_markers_out(spectrum, rows, theta[::thin])
    return SurfaceRegression(
        method=method,
        sampler=sampler,
        blend=chosen.blend,
        length_scale=chosen.length_scale,
        diagnostics=SurfaceDiagnostics(covariance.clipped, chosen.left_out_rms_mm, **facts),
        marker_count=count,
        point_count=len(points),
        widening=calibrate_spread(left_out, covariance.matrix(), cross),
        table=table,
        fields=fields,
        shared=shared,
        samples=samples,
        seed=seed,
    )


def _sides(distances: SurfaceDistances) -> FoldSides:
    markers = distances.marker_positions
    return find_fold_sides(
        distances.geodesic_to_points,
        distances.euclidean_to_points,
        spread=float((markers - markers.mean(axis=0)).std()),
    )


def _rows(moved: FloatArray) -> FloatArray:
    """One row for each frame and axis: (frames * 3, markers)."""
    return np.ascontiguousarray(moved.transpose(0, 2, 1).reshape(-1, moved.shape[1]))


def _check_displacements(displacements: FloatArray, markers: int) -> FloatArray:
    moved = np.asarray(displacements, np.float64)
    if moved.ndim != 3 or moved.shape[1:] != (markers, 3):
        raise InputError(
            f"displacements must be (frames, {markers}, 3) for the {markers} markers bound to "
            f"the mesh, got {moved.shape}"
        )
    bad = ~np.isfinite(moved).all(axis=(1, 2))
    if bad.any():
        raise InputError(
            f"displacements of {bad.sum()} frames are not finite, the first is index "
            f"{int(bad.argmax())}; clean the take first"
        )
    return moved
