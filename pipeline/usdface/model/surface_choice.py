"""Choose how far the surface's distance counts, and the length scale, by leaving markers out."""

from dataclasses import dataclass

import numpy as np

from usdface.assets import FloatArray
from usdface.model.surface_distance import BLEND, SurfaceDistances
from usdface.numerics.manifold.hyper_posterior import HyperPrior, decompose
from usdface.numerics.manifold.multiquadric import fit_distance_multiquadric
from usdface.numerics.manifold.shared_posterior import fit_shared_mode
from usdface.numerics.manifold.surface_covariance import fit_covariance
from usdface.numerics.manifold.tabulated_energy import SharedTable

BLENDS = (0.0, 0.2, BLEND, 0.6, 0.8, 1.0)
SCALES = (1.0, 1.5, 2.0, 3.0, 4.0, 6.0)
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
    left_out_z : (frames, markers, 3) float array
        Those errors over what the process expected of them; empty for ``'rbf'``.
    frames : (frames, markers, 3) float array
        The displacements it was chosen on [mm].
    """

    blend: float
    length_scale: float
    theta: FloatArray
    left_out_rms_mm: float
    left_out_z: FloatArray
    frames: FloatArray


def choose_settings(
    distances: SurfaceDistances,
    displacements: FloatArray,
    *,
    method: str,
    blend: float | None,
    length_scale: float | None,
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
            found = _try(distances, frames, between, weight, scale, prior)
            if best is None or found.left_out_rms_mm < best.left_out_rms_mm:
                best = found
    if best is None:
        raise ValueError("nothing to choose from")
    return best


def _try(
    distances: SurfaceDistances,
    frames: FloatArray,
    between: FloatArray,
    blend: float,
    scale: float,
    prior: HyperPrior | None,
) -> SurfaceSettings:
    columns = frames.transpose(1, 0, 2).reshape(frames.shape[1], -1)
    theta, z = np.zeros(4), np.zeros(0)
    if scale == 0.0:
        inverse = fit_distance_multiquadric(between).inverse
        errors = (inverse @ columns) / np.diag(inverse)[:, None]  # Rippa (1999)
    else:
        covariance = fit_covariance(between, length_scale=scale).matrix()
        centre = distances.marker_positions.mean(axis=0)
        size = np.sqrt(((distances.marker_positions - centre) ** 2).mean())
        places = (distances.marker_positions - centre) / size
        spectrum = decompose(covariance, places, prior=prior)
        table = SharedTable(spectrum)
        theta = fit_shared_mode(table, columns.T).mode[:, 0]
        v0, v1, a0, a1 = np.exp(theta)
        whole = v0 * covariance + a0 + a1 * places @ places.T + v1 * np.eye(len(places))
        inverse = np.linalg.inv(whole)
        own = np.diag(inverse)[:, None]
        errors = (inverse @ columns) / own  # Rasmussen and Williams, eq. 5.12
        z = (errors * np.sqrt(own)).reshape(len(columns), -1, 3).transpose(1, 0, 2)
    rms = float(np.sqrt((errors**2).mean()))
    return SurfaceSettings(blend, scale, theta, rms, z, frames)
