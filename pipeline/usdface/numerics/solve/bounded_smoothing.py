"""Least squares within bounds whose solution moves smoothly over time.

All frames are one problem. In the cosine transform of time and the eigenvectors of the shared
matrix it is diagonal, so that the alternating direction method of multipliers needs two products
and two transforms a step, whatever the number of frames.
"""

import numpy as np
from numpy.typing import ArrayLike
from scipy.fft import dct, idct

from usdface.core.arrays import FloatArray

_STEPS = 2000
_ADAPT = 20  # steps between changes of the penalty [Boyd et al. 2011, section 3.4.1]
_RELAX = 1.6  # over-relaxation, section 3.4.3


def minimise_bounded_smooth(
    hessian: ArrayLike,
    linear: ArrayLike,
    *,
    lower: ArrayLike,
    upper: ArrayLike,
    smoothness: float,
    l1: float = 0.0,
    start: ArrayLike | None = None,
    tolerance: float = 1e-7,
) -> FloatArray:
    """Minimise ``sum_t 0.5 x_t'Hx_t - l_t'x_t + l1 |x_t|_1 + 0.5 smoothness |x''|^2`` in bounds.

    ``x''`` is the second difference over frames; the ends are mirrored, so that a constant and
    nothing else is free.

    Parameters
    ----------
    hessian : (n, n) array
        Symmetric and positive semidefinite.
    linear : (frames, n) array
        In the order of time.
    lower, upper : (n,) arrays
    smoothness, l1 : float
        Not negative.
    start : (frames, n) array, optional
        A first guess, such as the solution without smoothness.
    tolerance : float, optional
        On the change of `x` and on its distance to the bounds, in the units of `x`.

    Returns
    -------
    (frames, n) float array
        Within the bounds exactly.

    Raises
    ------
    ValueError
        If a penalty is negative or a value is not finite.

    References
    ----------
    Boyd, Parikh, Chu, Peleato and Eckstein (2011), Foundations and Trends in Machine Learning 3(1).
    """
    H, b = np.asarray(hessian, float), np.asarray(linear, float)
    if not smoothness >= 0 or not l1 >= 0:
        raise ValueError(f"smoothness and l1 must not be negative, got {smoothness} and {l1}")
    if not np.isfinite(H).all() or not np.isfinite(b).all():
        raise ValueError("matrix and targets must be finite; mask or fill missing samples first")
    lo, hi = np.asarray(lower, float), np.asarray(upper, float)
    values, vectors = np.linalg.eigh(H)
    values = np.maximum(values, 0.0)
    bend = smoothness * _second_difference_spectrum(len(b))
    penalty = float(np.sqrt(max(values[-1], 1e-12) * max(np.median(values), 1e-3 * values[-1])))
    z = np.clip(np.zeros_like(b) if start is None else np.asarray(start, float), lo, hi)
    u = np.zeros_like(b)
    for step in range(_STEPS):
        spectrum = dct((b + penalty * (z - u)) @ vectors, axis=0, norm="ortho")
        spectrum /= values[None] + bend[:, None] + penalty
        x = idct(spectrum, axis=0, norm="ortho") @ vectors.T
        relaxed = _RELAX * x + (1 - _RELAX) * z
        before = z
        z = np.clip(_shrink(relaxed + u, l1 / penalty), lo, hi)
        u += relaxed - z
        apart, moved = np.abs(x - z).max(), np.abs(z - before).max()
        if max(apart, moved) < tolerance:
            break
        if step % _ADAPT == _ADAPT - 1:
            gap, drift = float(np.linalg.norm(x - z)), float(np.linalg.norm(z - before))
            factor = float(np.clip(np.sqrt(gap / max(drift, 1e-300)), 0.2, 5.0))
            if factor > 1.5 or factor < 1 / 1.5:
                penalty *= factor
                u /= factor
    return np.asarray(z, float)


def _second_difference_spectrum(frames: int) -> FloatArray:
    """Return the eigenvalues of the squared, mirrored second difference in the cosine transform."""
    return np.asarray((2 - 2 * np.cos(np.pi * np.arange(frames) / frames)) ** 2, float)


def _shrink(x: FloatArray, by: float) -> FloatArray:
    """Move towards zero by as much as the absolute value costs."""
    return x if by == 0 else np.asarray(np.sign(x) * np.maximum(np.abs(x) - by, 0.0), float)
