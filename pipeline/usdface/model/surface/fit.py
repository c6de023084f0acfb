"""What the models that move a mesh by markers have in common: W06's regression over the surface.

A model is fitted to frames of a take by `fit_gp_surface` or `fit_rbf_surface`; every frame is then
predicted by itself. Open settings are chosen by leaving out the markers one by one.
"""

from abc import ABC, abstractmethod
from collections.abc import Iterator
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from usdface.core.arrays import Float32Array, FloatArray
from usdface.core.errors import InputError
from usdface.core.progress import Progress, silent
from usdface.model.surface.distance import BLEND_PUBLISHED, SurfaceDistances
from usdface.numerics.manifold.surface_fields import Folds, find_folds

BLENDS_TRIED = (0.0, 0.2, BLEND_PUBLISHED, 0.6, 0.8, 1.0)

FITTED_FRAMES = 32
"""Frames that settings are chosen on, evenly spread over the take."""

_FIELD_VALUES = 1 << 22
"""Points times frames of a part of a stream: 16 MB of each field."""


@dataclass(frozen=True)
class SurfaceMotion:
    """How a mesh moves."""

    mean: Float32Array
    """(frames, points, 3): displacements from rest [mm]."""
    sd: Float32Array | None
    """(frames, points): standard deviation of a coordinate: root mean square over the axes [mm].
    None where the model predicts none."""
    sd_of_axes: Float32Array | None = None
    """(frames, points, 3): the same for each axis, on request [mm]."""


@dataclass(frozen=True)
class SurfaceDiagnostics:
    """Quality of a fit."""

    left_out_rms_mm: float
    """Error at markers that were left out of the fit, per coordinate [mm]."""
    clipped: float = 0.0
    """Relative change of the covariance between markers that made it positive definite."""
    acceptance: float = float("nan")
    effective_samples: float = float("nan")
    rhat: float = float("nan")
    """`acceptance`, `effective_samples`, `rhat`: Of the sampler on some of the fitted frames: mean
    probability of acceptance, effective samples of each chain and split R-hat of two chains, both
    medians over frames, axes and hyper-parameters. NaN without a sampler."""
    two_modes: float = float("nan")
    """Share of those posteriors with two modes."""


@dataclass(frozen=True)
class SurfaceModel(ABC):
    """A fitted regression from displacements of markers to those of a mesh."""

    predicts_sd: ClassVar[bool]

    blend: float
    """Share of the geodesic distance [0-1]."""
    length_scale: float
    """Of the covariance [mm]; 0 of a model without one."""
    diagnostics: SurfaceDiagnostics
    """Of the fit."""
    marker_count: int
    point_count: int
    """`marker_count`, `point_count`: Of the mesh and its binding."""

    def deform(
        self, displacements: FloatArray, *, of_axes: bool = False, progress: Progress = silent
    ) -> SurfaceMotion:
        """Move the mesh at all frames at once; `stream` needs less memory.

        Parameters
        ----------
        displacements : (frames, markers, 3) float array
            Of the markers from the neutral frame [mm].
        of_axes : bool
            Whether to predict `SurfaceMotion.sd_of_axes` too.
        """
        parts = list(self.stream(displacements, of_axes=of_axes, progress=progress))
        return SurfaceMotion(
            np.concatenate([part.mean for part in parts]),
            _concatenate([part.sd for part in parts]),
            _concatenate([part.sd_of_axes for part in parts]),
        )

    def stream(
        self,
        displacements: FloatArray,
        *,
        frames_per_part: int | None = None,
        of_axes: bool = False,
        progress: Progress = silent,
    ) -> Iterator[SurfaceMotion]:
        """Move the mesh part by part, in bounded memory; the parts do not change the result.

        Parameters
        ----------
        displacements : (frames, markers, 3) float array
            [mm]
        frames_per_part : int, optional
            At most; by default about 16 MB of each field.
        of_axes : bool
            Whether to predict `SurfaceMotion.sd_of_axes` too.
        """
        moved = check_displacements(displacements, self.marker_count)
        if not len(moved):
            sd = np.zeros((0, self.point_count), np.float32) if self.predicts_sd else None
            yield SurfaceMotion(np.zeros((0, self.point_count, 3), np.float32), sd)
        size = frames_per_part or max(1, _FIELD_VALUES // max(self.point_count, 1))
        done = 0
        for part in self._predict(moved, size, of_axes=of_axes):
            yield part
            done += len(part.mean)
            progress(done / len(moved), "moving the mesh")

    @abstractmethod
    def _predict(self, moved: FloatArray, size: int, *, of_axes: bool) -> Iterator[SurfaceMotion]:
        """Predict frames, at most `size` at once."""


def check_fit(
    distances: SurfaceDistances, displacements: FloatArray, blend: float | None
) -> FloatArray:
    """Return the displacements of a take to fit a model to."""
    moved = check_displacements(displacements, len(distances.marker_positions))
    if not len(moved):
        raise InputError("no frame to fit the regression to; give the take's displacements")
    if blend is not None and not 0 <= blend <= 1:
        raise InputError(f"blend is the geodesic distance's share, 0 to 1; got {blend}")
    return moved


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


def fitted_frames(moved: FloatArray) -> FloatArray:
    """Return the frames that settings are chosen on: (frames, markers, 3)."""
    picks = np.linspace(0, len(moved) - 1, min(FITTED_FRAMES, len(moved)))
    frames: FloatArray = moved[np.unique(picks.astype(int))]
    return frames


def find_surface_folds(distances: SurfaceDistances) -> Folds:
    """Find the folds of a mesh."""
    markers = distances.marker_positions
    return find_folds(
        distances.geodesic_to_points,
        distances.euclidean_to_points,
        spread=float((markers - markers.mean(axis=0)).std()),
    )


def _concatenate(parts: list[Float32Array | None]) -> Float32Array | None:
    known = [part for part in parts if part is not None]
    return np.concatenate(known) if known and len(known) == len(parts) else None
