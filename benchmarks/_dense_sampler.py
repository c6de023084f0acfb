"""Dense sampler for comparison: one chain at a time, one Cholesky factor per gradient."""

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from usdface.numerics.manifold.hyper_posterior import MarkerSpectrum


def dense_energy(
    theta: np.ndarray, row: np.ndarray, parts: tuple[np.ndarray, ...], prior: tuple[np.ndarray, ...]
) -> tuple[float, np.ndarray]:
    """Evaluate W06's eq. 8 and its gradient as printed."""
    scales = np.exp(theta)
    whole = sum(scale * part for scale, part in zip(scales, parts, strict=True))
    factor = cho_factor(whole, lower=True)
    inverse = cho_solve(factor, np.eye(len(row)))
    alpha = inverse @ row
    away = (theta - prior[0]) / prior[1]
    energy = np.log(np.diag(factor[0])).sum() + 0.5 * (row @ alpha + away @ away)
    slope = [((inverse - np.outer(alpha, alpha)) * part).sum() for part in parts]
    return float(energy), 0.5 * scales * np.array(slope) + away / prior[1]


def sample_densely(
    rng: np.random.Generator,
    spectrum: MarkerSpectrum,
    rows: np.ndarray,
    roots: np.ndarray,
    modes: np.ndarray,
    *,
    burn: int = 40,
    keep: int = 200,
    step: float = 1.0,
    leapfrogs: tuple[int, int] = (2, 3),
) -> np.ndarray:
    """Run leapfrog trajectories chain by chain: (keep, 4, chains)."""
    Q, count = spectrum.vectors, len(spectrum.values)
    trend = Q @ spectrum.trend
    parts = (
        (Q * spectrum.values) @ Q.T,
        np.eye(count),
        np.outer(trend[:, 0], trend[:, 0]),
        trend[:, 1:] @ trend[:, 1:].T,
    )
    prior = spectrum.prior.centre, np.array(spectrum.prior.spread)
    out = np.empty((keep, 4, len(rows)))
    for chain, row in enumerate(rows):
        root, theta = roots[..., chain], modes[:, chain]
        energy, gradient = dense_energy(theta, row, parts, prior)
        length = step
        for index in range(burn + keep):
            momentum = rng.standard_normal(4)
            before = energy + 0.5 * momentum @ momentum
            place, slope = theta, gradient
            momentum = momentum - 0.5 * length * root.T @ slope
            count_leaps = int(rng.integers(leapfrogs[0], leapfrogs[1] + 1))
            for leap in range(count_leaps):
                place = place + length * root @ momentum
                try:
                    value, slope = dense_energy(place, row, parts, prior)
                except np.linalg.LinAlgError:
                    value = np.inf
                    break
                share = 0.5 if leap == count_leaps - 1 else 1.0
                momentum = momentum - share * length * root.T @ slope
            chance = np.exp(min(0.0, before - value - 0.5 * momentum @ momentum))
            if rng.random() < chance:
                theta, energy, gradient = place, value, slope
            if index < burn:
                length *= np.exp((chance - 0.8) / np.sqrt(index + 1.0))
            if index >= burn:
                out[index - burn, :, chain] = theta
    return out
