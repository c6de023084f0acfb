"""Smooth tracks as strongly as their noise asks for, each direction of motion by its own measure.

References
----------
Eilers (2003), A perfect smoother, Analytical Chemistry 75(14), 3631-3636.
Garcia (2010), Robust smoothing of gridded data in one and higher dimensions with missing values,
Computational Statistics and Data Analysis 54(4), 1167-1178: the cosine domain, and generalised
cross-validation (GCV) in it.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.fft import dct, idct
from scipy.ndimage import uniform_filter1d

_ORDER = 3
"""Third differences are penalised: position, velocity and acceleration pass."""
_BINS = 4096
"""Frequencies are gathered into so many bins to score a penalty; the scores do not change."""
_PENALTIES = 10.0 ** np.arange(-3.0, 9.01, 0.1)
_COLUMNS_AT_ONCE = 8
_DETAIL_PENALTY = 3.0
"""Halves movements of about eight frames: the quickest blink is slower."""
_DETAIL_FRAMES = 9
_DETAIL_NOISES = 4.0
"""Energy of nine frames of smoothed noise stays below it in 9,999 of 10,000 places."""
DETAIL_REACH = 96
"""[frames] Farther away, a sample changes no detail: the light smoother forgets 0.64 to the power
of the distance."""


@dataclass(frozen=True)
class SmoothedTracks:
    """Smoothed series and how strongly each was smoothed.

    Attributes
    ----------
    values : (frames, series) float array
    penalties : (series,) float array
        Weight of the squared third differences.
    """

    values: NDArray[np.float64]
    penalties: NDArray[np.float64]


def smooth_tracks(values: ArrayLike, *, penalties: ArrayLike | None = None) -> SmoothedTracks:
    """Minimise ``|x - y|² + penalty |third differences of x|²`` for every series.

    Parameters
    ----------
    values : (frames, series) array_like
        Evenly sampled.
    penalties : (series,) array_like, optional
        Not negative. By default each series gets the penalty with the least GCV score.

    Notes
    -----
    With the series mirrored at its ends, third differences are diagonal in the cosine domain: the
    whole smoother is two transforms, whatever the length and the penalty.
    """
    y = np.asarray(values)
    frames, count = y.shape
    smooth = np.empty(y.shape)
    given = None if penalties is None else np.broadcast_to(np.asarray(penalties, float), (count,))
    used = np.zeros(count)
    if frames <= _ORDER:
        return SmoothedTracks(np.array(y, np.float64), used)
    eigenvalues = difference_eigenvalues(frames)
    for start in range(0, count, _COLUMNS_AT_ONCE):
        columns = slice(start, start + _COLUMNS_AT_ONCE)
        spectrum = dct(y[:, columns].astype(np.float64), axis=0, norm="ortho")
        used[columns] = gcv_penalties(spectrum) if given is None else given[columns]
        spectrum /= 1.0 + eigenvalues[:, None] * used[columns]
        smooth[:, columns] = idct(spectrum, axis=0, norm="ortho", overwrite_x=True)
    return SmoothedTracks(smooth, used)


def significant_detail(rest: ArrayLike, *, noise: ArrayLike) -> NDArray[np.floating]:
    """Return the part of what smoothing took away that is too large, for a while, to be noise.

    One penalty per direction suits the whole take. A movement that happens once or twice in an
    hour hardly counts in it, and would be smoothed like the noise around it.

    Parameters
    ----------
    rest : (frames, markers, 3) array_like
        Unsmoothed less smoothed [mm].
    noise : (markers,) array_like
        Standard deviation of the measurement noise per coordinate [mm].

    Returns
    -------
    (frames, markers, 3) float array
        Zero nearly everywhere.

    Notes
    -----
    The rest is smoothed lightly; where its energy over a few frames exceeds several times that of
    smoothed noise, it is let through by positive-part James-Stein shrinkage.
    """
    away = np.asarray(rest)
    frames = len(away)
    if frames <= _DETAIL_FRAMES:
        return np.zeros_like(away)
    gain = 1.0 / (1.0 + _DETAIL_PENALTY * difference_eigenvalues(_BINS))
    floor = _DETAIL_NOISES * 3.0 * np.asarray(noise, float) ** 2 * float(np.mean(gain**2))
    spectrum = dct(away.reshape(frames, -1).astype(np.float64), axis=0, norm="ortho")
    spectrum /= 1.0 + _DETAIL_PENALTY * difference_eigenvalues(frames)[:, None]
    lightly = idct(spectrum, axis=0, norm="ortho", overwrite_x=True).reshape(away.shape)
    energy = uniform_filter1d(np.einsum("fki,fki->fk", lightly, lightly), _DETAIL_FRAMES, axis=0)
    share = np.maximum(0.0, 1.0 - floor / np.maximum(energy, 1e-12))
    telling = share.any(axis=0)
    lightly[:, ~telling] = 0.0
    if telling.any():
        share = uniform_filter1d(share[:, telling], _DETAIL_FRAMES, axis=0)  # no step at its ends
        lightly[:, telling] *= share[..., None]
    return np.asarray(lightly, away.dtype)


def difference_eigenvalues(frames: int) -> NDArray[np.float64]:
    """Return the squared third difference of each cosine of a series, (frames,)."""
    return np.asarray((2.0 - 2.0 * np.cos(np.pi * np.arange(frames) / frames)) ** _ORDER)


def gcv_penalties(spectrum: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the penalty of least generalised cross-validation score for each series.

    Parameters
    ----------
    spectrum : (frames, series) float array
        Orthonormal cosine transform of the series.
    """
    frames = len(spectrum)
    starts = np.unique(np.linspace(0, frames, min(_BINS, frames), endpoint=False).astype(np.int64))
    power = np.add.reduceat(spectrum**2, starts, axis=0)
    members = np.diff(np.append(starts, frames))
    eigenvalues = np.add.reduceat(difference_eigenvalues(frames), starts) / members
    scores = np.empty((len(_PENALTIES), spectrum.shape[1]))
    for i, penalty in enumerate(_PENALTIES):
        removed = 1.0 - 1.0 / (1.0 + penalty * eigenvalues)  # I - hat matrix, diagonal here
        scores[i] = (removed**2 @ power) / (removed @ members / frames) ** 2
    return np.asarray(_PENALTIES[scores.argmin(axis=0)])
