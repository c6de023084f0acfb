"""A process small enough to be checked densely: markers on a bent sheet, and what they do."""

import numpy as np
from scipy.spatial.distance import cdist

from usdface.numerics.manifold.hyper_posterior import HyperPrior, MarkerSpectrum, decompose
from usdface.numerics.manifold.surface_covariance import fit_covariance


def small_spectrum(markers: int = 12, prior: HyperPrior | None = None) -> MarkerSpectrum:
    places = small_places(markers)
    covariance = fit_covariance(cdist(places, places), length_scale=1.0)
    return decompose(covariance.matrix(), places, prior=prior)


def small_places(markers: int = 12) -> np.ndarray:
    places = np.random.default_rng(1).standard_normal((markers, 3))
    return places - places.mean(axis=0)


def dense_parts(spectrum: MarkerSpectrum) -> tuple[np.ndarray, np.ndarray]:
    """K and [1 S] again."""
    Q = spectrum.vectors
    return (Q * spectrum.values) @ Q.T, Q @ spectrum.trend


def dense_covariance(spectrum: MarkerSpectrum, theta: np.ndarray) -> np.ndarray:
    K, trend = dense_parts(spectrum)
    v0, v1, a0, a1 = np.exp(theta)
    return v0 * K + v1 * np.eye(len(K)) + (trend * [a0, a1, a1, a1]) @ trend.T


def dense_energy(spectrum: MarkerSpectrum, theta: np.ndarray, row: np.ndarray) -> float:
    """Eq. 8 and the prior, without any of our algebra."""
    whole = dense_covariance(spectrum, theta)
    away = (theta - spectrum.prior.centre) / np.array(spectrum.prior.spread)
    fit = row @ np.linalg.solve(whole, row)
    return float(0.5 * (np.linalg.slogdet(whole)[1] + fit + away @ away))


def draw_rows(spectrum: MarkerSpectrum, rng: np.random.Generator, count: int) -> np.ndarray:
    """Displacements that the process itself could have made."""
    whole = dense_covariance(spectrum, np.log([4.0, 0.05, 1.0, 1.0]))
    return rng.standard_normal((count, len(whole))) @ np.linalg.cholesky(whole).T
