"""A regression fitted over a surface, streamed over a take of any length."""

from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from usdface.core.arrays import Float32Array, FloatArray
from usdface.core.errors import InputError
from usdface.core.progress import Progress, silent
from usdface.model.surface.diagnostics import SurfaceDiagnostics
from usdface.numerics.array_namespace import CPU, ArrayDevice
from usdface.numerics.manifold.hyper_sampling import (
    draw_laplace,
    find_modes,
    sample_hyperparameters,
)
from usdface.numerics.manifold.left_out import Widening
from usdface.numerics.manifold.posterior_prediction import (
    SurfaceFields,
    average_dual_weights,
    join_moments,
    mix_variances,
    predict_mean,
    predict_variance,
)
from usdface.numerics.manifold.shared_posterior import SharedSamples
from usdface.numerics.manifold.tabulated_energy import Precision as DType
from usdface.numerics.manifold.tabulated_energy import SharedTable

Method = Literal["gp", "rbf"]
Sampler = Literal["hmc", "map", "shared"]
Precision = Literal["single", "double"]

DTYPES: dict[Precision, DType] = {"single": "float32", "double": "float64"}
"""As numerics call them."""

SAMPLES = 200
"""Saved samples of the hyper-parameters: W06, section 4.1."""

_SAMPLED_FRAMES = 1024
"""Frames whose chains run in lockstep: half as many are a fifth slower and hold 75 MB less."""

_MOMENT_FRAMES = 8
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
    device: ArrayDevice = CPU
    precision: Precision = "single"

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
        moved = check_displacements(displacements, self.marker_count)
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
        rows = rows_of_axes(moved)
        if self.sampler == "map":
            theta = draw_laplace(
                rng, self.table, find_modes(self.table, rows, device=self.device), keep=16
            )
        else:
            found, _ = sample_hyperparameters(
                rng,
                self.table,
                rows,
                keep=self.samples,
                device=self.device,
                dtype=DTYPES[self.precision],
            )
            theta = found.theta
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
            rows = rows_of_axes(moved[part])
            if theta is not None:
                own = np.moveaxis(theta[..., part], 2, 3).reshape(len(theta), 4, -1)
            elif self.shared is not None:
                own = np.repeat(self.shared.theta[:, :, None], len(rows), axis=2)
            parts.append(
                average_dual_weights(
                    self.table.spectrum,
                    rows,
                    own,
                    device=self.device,
                    dtype=DTYPES[self.precision],
                )
            )
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


def rows_of_axes(moved: FloatArray) -> FloatArray:
    """One row for each frame and axis: (frames * 3, markers)."""
    return np.ascontiguousarray(moved.transpose(0, 2, 1).reshape(-1, moved.shape[1]))


def check_displacements(displacements: FloatArray, markers: int) -> FloatArray:
    """Refuse displacements that are not (frames, markers, 3) or not finite."""
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
