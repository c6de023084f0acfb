"""Choose how far the surface's distance counts, and the length scale, by leaving markers out."""

from dataclasses import dataclass

import numpy as np

from usdface.core.arrays import FloatArray
from usdface.model.surface.distance import BLEND, SurfaceDistances
from usdface.numerics.manifold.hyper_posterior import HyperPrior, MarkerSpectrum, decompose
from usdface.numerics.manifold.left_out import leave_markers_out
from usdface.numerics.manifold.multiquadric import fit_distance_multiquadric
from usdface.numerics.manifold.shared_posterior import fit_shared_mode
from usdface.numerics.manifold.surface_covariance import Shape, SurfaceCovariance, fit_covariance
from usdface.numerics.manifold.tabulated_energy import SharedTable

BLENDS = (0.0, 0.2, BLEND, 0.6, 0.8, 1.0)
SCALES = (1.0, 1.5, 2.0, 3.0, 4.5, 7.0, 12.0)
"""Length scales tried, in median distances between a marker and its nearest."""

FRAMES = 32
"""Frames the settings are chosen on, spread over the take."""


@dataclass(frozen=True)
class SurfaceSettings:
    """What was chosen.

    Attributes
    ----------
    blend : float
    length_scale : float
        [mm]; 0 for ``'rbf'``.
    theta : (4,) float array
        Log hyper-parameters of the frames together; zeros for ``'rbf'``.
    left_out_rms_mm : float
        Error at left-out markers, per coordinate [mm].
    frames : (frames, markers, 3) float array
        The displacements it was chosen on [mm].
    """

    blend: float
    length_scale: float
    theta: FloatArray
    left_out_rms_mm: float
    frames: FloatArray


def choose_settings(
    distances: SurfaceDistances,
    displacements: FloatArray,
    *,
    method: str,
    blend: float | None,
    length_scale: float | None,
    shape: Shape = "creased",
    prior: HyperPrior | None = None,
) -> SurfaceSettings:
    """Try every setting that is open on markers left out one by one, in closed form.

    Parameters
    ----------
    distances : SurfaceDistances
    displacements : (frames, markers, 3) float array
        [mm]
    method : {'gp', 'rbf'}
    blend, length_scale : float or None
        None where it is to be chosen.
    shape : {'creased', 'squared-exponential'}
        Of the covariance.
    prior : HyperPrior, optional
    """
    pick = np.linspace(0, len(displacements) - 1, min(FRAMES, len(displacements)))
    frames = displacements[np.unique(pick.astype(int))]
    best: SurfaceSettings | None = None
    for weight in BLENDS if blend is None else (blend,):
        between = distances.blended_between(weight)
        nearest = np.where(between > 0, between, np.inf).min(axis=1)
        scales: tuple[float, ...] = (0.0,)
        if method == "gp":
            spacing = float(np.median(nearest))
            scales = tuple(s * spacing for s in SCALES) if length_scale is None else (length_scale,)
        for scale in scales:
            found = _try(distances, frames, between, weight, scale, shape, prior)
            if best is None or found.left_out_rms_mm < best.left_out_rms_mm:
                best = found
    if best is None:
        raise ValueError("nothing to choose from")
    return best


def marker_spectrum(
    distances: SurfaceDistances,
    blend: float,
    length_scale: float,
    *,
    shape: Shape = "creased",
    prior: HyperPrior | None = None,
) -> tuple[MarkerSpectrum, SurfaceCovariance]:
    """Take apart the covariance between markers under one setting."""
    between = distances.blended_between(blend)
    covariance = fit_covariance(between, length_scale=length_scale, shape=shape)
    places = distances.scaled(distances.marker_positions)
    return decompose(covariance.matrix(), places, prior=prior), covariance


def _try(
    distances: SurfaceDistances,
    frames: FloatArray,
    between: FloatArray,
    blend: float,
    scale: float,
    shape: Shape,
    prior: HyperPrior | None,
) -> SurfaceSettings:
    columns = frames.transpose(1, 0, 2).reshape(frames.shape[1], -1)
    theta = np.zeros(4)
    if scale == 0.0:
        inverse = fit_distance_multiquadric(between).inverse
        errors = (inverse @ columns) / np.diag(inverse)[:, None]  # Rippa (1999)
    else:
        spectrum, _ = marker_spectrum(distances, blend, scale, shape=shape, prior=prior)
        theta = fit_shared_mode(SharedTable(spectrum), columns.T).mode[:, 0]
        errors = leave_markers_out(spectrum, columns.T, theta[None, :, None]).errors
    rms = float(np.sqrt((errors**2).mean()))
    return SurfaceSettings(blend, scale, theta, rms, frames)
