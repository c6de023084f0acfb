"""A process small enough to be checked densely: markers on a bent sheet, and what they do."""

import numpy as np
from scipy.spatial.distance import cdist

from usdface.numerics.manifold.hyper_posterior import (
    SYMMETRIC_ENTRIES,
    HyperPrior,
    MarkerSpectrum,
    PosteriorMoments,
    decompose,
)
from usdface.numerics.manifold.surface_fields import fit_covariance


def small_spectrum(markers: int = 12, prior: HyperPrior | None = None) -> MarkerSpectrum:
    places = small_places(markers)
    covariance = fit_covariance(cdist(places, places), length_scale=1.0)
    return decompose(covariance.matrix(), places, prior or HyperPrior())


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


def direct_moments(
    spectrum: MarkerSpectrum, rotated: np.ndarray, x: np.ndarray
) -> PosteriorMoments:
    """Sum over the markers, without a table: z (chains, N) at x = log(v0 / v1)."""
    P = spectrum.trend
    products = np.stack([P[:, i] * P[:, j] for i, j in SYMMETRIC_ENTRIES], axis=1)
    R = 1.0 / (1.0 + np.exp(x)[:, None] * spectrum.values)
    slope = R * (R - 1.0)
    shared = np.concatenate([(R @ products).T, -np.log(R).sum(axis=1)[None]])
    shared_slope = np.concatenate([(slope @ products).T, (1.0 - R).sum(axis=1)[None]])
    b, c = ((R * rotated) @ P).T, (R * rotated**2).sum(axis=1)[None]
    b_slope, c_slope = ((slope * rotated) @ P).T, (slope * rotated**2).sum(axis=1)[None]
    return PosteriorMoments(
        shared,
        np.concatenate([b, c]),
        shared_slope,
        np.concatenate([b_slope, c_slope]),
        np.zeros(len(x), bool),
    )
