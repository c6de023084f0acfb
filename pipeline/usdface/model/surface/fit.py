"""Common parts of the models that deform a mesh by markers: regression over the surface (W06).

A model is fitted to frames of a take by `fit_gp_surface` or `fit_rbf_surface`. Frames are then
predicted independently. Settings that are not given are chosen by leave-one-out over the markers.
"""

from abc import ABC, abstractmethod
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np

from usdface.core.arrays import BoolArray, Float32Array, FloatArray, RealArray, sample_frames
from usdface.core.assets import MEASURED_CONFIDENCE
from usdface.core.errors import InputError
from usdface.model.surface.distance import BLEND_PUBLISHED, SurfaceDistances
from usdface.numerics.manifold.surface_fields import Folds, find_folds
from usdface.numerics.manifold.unseen_markers import predict_unseen

BLENDS_TRIED = (0.0, 0.2, BLEND_PUBLISHED, 0.6, 0.8, 1.0)

FITTED_FRAMES = 32
"""Frames on which settings are chosen, evenly spread over the take."""

_FIELD_VALUES = 1 << 22
"""Points times frames in one part of a stream: 16 MB per field."""


@dataclass(frozen=True)
class SurfaceMotion:
    """Predicted displacements of a mesh."""

    mean: Float32Array
    """(frames, points, 3): displacements from rest [mm]."""
    sd: Float32Array | None
    """(frames, points): standard deviation, root mean square over the axes [mm]; None if the model
    predicts none."""


@dataclass(frozen=True)
class SurfaceDiagnostics:
    """Quality of a fit."""

    left_out_rms_mm: float
    """Leave-one-out error over the markers, per coordinate [mm]."""
    clipped: float = 0.0
    """Relative change of the covariance between markers that made it positive definite."""
    acceptance: float = float("nan")
    effective_samples: float = float("nan")
    rhat: float = float("nan")
    """`acceptance`, `effective_samples`, `rhat`: Of the sampler: mean acceptance probability;
    effective samples per chain and split R-hat of two chains, medians over frames, axes and
    hyper-parameters. NaN without a sampler."""
    two_modes: float = float("nan")
    """Share of the posteriors with two modes [0-1]."""


@dataclass(frozen=True)
class SurfaceModel(ABC):
    """A fitted regression from displacements of markers to those of a mesh."""

    predicts_sd: ClassVar[bool]

    blend: float
    """Share of the geodesic distance [0-1]."""
    length_scale: float
    """Of the covariance [mm]; 0 for a model without one."""
    diagnostics: SurfaceDiagnostics
    marker_count: int
    point_count: int
    precision: FloatArray = field(repr=False)
    """(markers, markers): inverse covariance of the markers, up to a factor."""

    def deform(
        self, displacements: FloatArray, confidence: RealArray | None = None
    ) -> SurfaceMotion:
        """Predict all frames at once; `stream` needs less memory.

        Parameters
        ----------
        displacements : (frames, markers, 3) float array
            From the neutral frame [mm].
        confidence : (frames, markers) float array, optional
            [0-1]. Markers of confidence 0 are predicted from the others. Those below
            `MEASURED_CONFIDENCE` are filled: the points are as uncertain as if these were
            predicted. Default: 1.
        """
        parts = list(self.stream(displacements, confidence))
        deviations = [part.sd for part in parts if part.sd is not None]
        return SurfaceMotion(
            np.concatenate([part.mean for part in parts]),
            np.concatenate(deviations) if self.predicts_sd else None,
        )

    def stream(
        self, displacements: FloatArray, confidence: RealArray | None = None
    ) -> Iterator[SurfaceMotion]:
        """Predict part by part, in bounded memory; what `deform` returns, whatever the parts."""
        moved = check_displacements(displacements, self.marker_count)
        if confidence is None:
            confidence = np.ones(moved.shape[:2])
        moved = predict_unseen(moved, confidence > 0, self.precision)
        if not len(moved):
            sd = np.zeros((0, self.point_count), np.float32) if self.predicts_sd else None
            yield SurfaceMotion(np.zeros((0, self.point_count, 3), np.float32), sd)
        size = max(1, _FIELD_VALUES // max(self.point_count, 1))
        yield from self._predict(moved, confidence >= MEASURED_CONFIDENCE, size)

    @abstractmethod
    def _predict(
        self, moved: FloatArray, measured: BoolArray, size: int
    ) -> Iterator[SurfaceMotion]:
        """Predict frames in parts of at most `size`; `measured` is for the standard deviations."""


def check_fit(
    distances: SurfaceDistances, displacements: FloatArray, blend: float | None
) -> FloatArray:
    """Return checked displacements, in double precision."""
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
    """Return the frames on which settings are chosen: (frames, markers, 3)."""
    return np.asarray(moved[sample_frames(len(moved), FITTED_FRAMES)])


def find_surface_folds(distances: SurfaceDistances) -> Folds:
    """Find the folds of a mesh."""
    markers, along = distances.marker_positions, distances.geodesic_between
    return find_folds(
        distances.geodesic_to_points,
        distances.euclidean_to_points,
        detours=(along - distances.euclidean_between) / np.maximum(along, 1e-6),
        spread=float((markers - markers.mean(axis=0)).std()),
    )
