"""Whether chains have mixed: split R-hat and effective sample size.

Gelman et al., *Bayesian Data Analysis* (3rd ed., 2013), section 11.4-11.5; autocorrelations are
summed in the initial positive sequence of Geyer (1992), in pairs that begin with an even lag: of a
reversible chain each such sum is positive, so that the first that is not is noise.
"""

import numpy as np

from usdface.core.arrays import FloatArray


def split_rhat(samples: FloatArray) -> FloatArray:
    """Compare the halves of chains with each other: 1 where all tell the same.

    Parameters
    ----------
    samples : (draws, chains, ...) float array
        Chains of the same posterior.

    Returns
    -------
    (...) float array
    """
    halves = _halves(samples)
    draws = len(halves)
    within = halves.var(axis=0, ddof=1).mean(axis=0)
    between = halves.mean(axis=0).var(axis=0, ddof=1)
    out: FloatArray = np.sqrt((draws - 1) / draws + between / np.maximum(within, 1e-300))
    return out


def effective_sample_size(samples: FloatArray) -> FloatArray:
    """How many independent draws would tell as much about the mean, at most the draws there are.

    Parameters
    ----------
    samples : (draws, chains, ...) float array
        Chains of the same posterior.

    Returns
    -------
    (...) float array
    """
    draws, chains = samples.shape[:2]
    centred = samples - samples.mean(axis=0)
    spectrum = np.fft.rfft(centred, 2 * draws, axis=0)
    products = np.fft.irfft(spectrum * spectrum.conj(), axis=0)[:draws].mean(axis=1) / draws
    within = samples.var(axis=0, ddof=1).mean(axis=0)
    total = (draws - 1) / draws * within
    if chains > 1:
        total = total + samples.mean(axis=0).var(axis=0, ddof=1)
    total = np.maximum(total, 1e-300)
    correlation = 1.0 - (within - products) / total
    pairs = correlation[0:-1:2] + correlation[1::2]
    positive = np.logical_and.accumulate(pairs > 0, axis=0)
    time = 2.0 * np.where(positive, pairs, 0.0).sum(axis=0) - 1.0
    return np.asarray(draws * chains / np.maximum(time, 1.0), np.float64)


def _halves(samples: FloatArray) -> FloatArray:
    half = len(samples) // 2
    return np.concatenate([samples[:half], samples[half : 2 * half]], axis=1)
