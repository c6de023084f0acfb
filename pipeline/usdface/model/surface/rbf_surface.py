"""Multiquadrics over a surface, which interpolate every marker (W06)."""

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np

from usdface.core.arrays import BoolArray, Float32Array, FloatArray, frame_blocks
from usdface.core.errors import InputError
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
from usdface.numerics.manifold.surface_fields import (
    fit_distance_multiquadric,
    multiquadric_fields,
    nearest_stiffness,
)


@dataclass(frozen=True)
class RbfSurface(SurfaceModel):
    """Fitted multiquadrics: ``displacements of points = operator @ displacements of markers``."""

    predicts_sd: ClassVar[bool] = False

    operator: Float32Array = field(repr=False)
    """(points, markers): see `multiquadric_fields`."""

    def _predict(
        self, moved: FloatArray, measured: BoolArray, size: int
    ) -> Iterator[SurfaceMotion]:
        for rows in frame_blocks(len(moved), frames=size):
            part = moved[rows].astype(np.float32)
            flat = part.transpose(1, 0, 2).reshape(self.marker_count, -1)
            mean = (self.operator @ flat).reshape(self.point_count, -1, 3).transpose(1, 0, 2)
            yield SurfaceMotion(np.ascontiguousarray(mean), None)


def fit_rbf_surface(
    distances: SurfaceDistances,
    displacements: FloatArray,
    *,
    blend: float | None = BLEND_PUBLISHED,
    folds: bool = True,
) -> RbfSurface:
    """Fit multiquadrics to the markers of a mesh.

    Parameters
    ----------
    displacements : (frames, markers, 3) float array
        Of a take, from the neutral frame [mm]; used to choose the blend if it is not given.
    blend, folds
        See `GpOptions`.
    """
    frames = fitted_frames(check_fit(distances, displacements, blend))
    columns = frames.transpose(1, 0, 2).reshape(frames.shape[1], -1)
    tried: list[tuple[float, float, FloatArray, FloatArray]] = []
    for share in BLENDS_TRIED if blend is None else (blend,):
        between = distances.blended_between(share)
        try:
            stiffness = nearest_stiffness(between)
            inverse = fit_distance_multiquadric(between, stiffness)
        except ValueError as error:
            raise InputError(str(error)) from error
        # Leave-one-out errors in closed form: Rippa (1999).
        errors = (inverse @ columns) / np.diag(inverse)[:, None]
        tried.append((float(np.sqrt((errors**2).mean())), share, inverse, stiffness))
    rms, share, inverse, stiffness = min(tried, key=lambda each: each[0])
    operator = multiquadric_fields(inverse, stiffness, distances.blended_to_points(share))
    if folds and share > 0:
        find_surface_folds(distances).apply(operator, np.eye(len(columns)))
    return RbfSurface(
        blend=share,
        length_scale=0.0,
        diagnostics=SurfaceDiagnostics(rms),
        marker_count=len(columns),
        point_count=len(operator),
        precision=inverse,
        operator=operator,
    )
