"""Smoothing by bands of frequencies, as the paper of the cross-mapping does it.

A motion is split into a pyramid of bands, each an octave wide; gains scale each of them.
With gains of 0 and 1, finest bands left out, the pyramid is one short filter of finite length:
what it does at a frame ends `reach` frames away.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from usdface.core.arrays import FloatArray

_KERNEL = np.array([1.0, 4.0, 6.0, 4.0, 1.0]) / 16.0  # Burt and Adelson's, a = 3/8


def apply_filter_bank(values: ArrayLike, *, gains: Sequence[float]) -> FloatArray:
    """Split curves into bands, weigh the bands and add them up again.

    G₀ is the curve and G₍ₖ₊₁₎ = Gₖ smoothed by a kernel spread over 2ᵏ frames; the bands are
    Lₖ = Gₖ − G₍ₖ₊₁₎, and the result is G_n + Σ gainₖ Lₖ. Curves go on at their ends as they end.

    Parameters
    ----------
    values : (frames, curves) array
    gains : sequence of float
        One for each band, the finest first: band k holds about rate/2ᵏ⁺² to rate/2ᵏ⁺¹ Hz. All 1
        gives the curves back.

    Returns
    -------
    (frames, curves) float array
        Bands amplified or left out may take values beyond where they were: limit them last.

    Raises
    ------
    ValueError
        If a value or a gain is not finite.

    References
    ----------
    Bruderlin and Williams (1995), Motion signal processing, SIGGRAPH, section 2.1; Deng et al.
    (2006), section 6: weights smoothed after mapping.
    """
    level = _checked(values)
    if not np.isfinite(gains).all():
        raise ValueError(f"gains must be finite, got {list(gains)}")
    out = np.zeros_like(level)
    for band, gain in enumerate(gains):
        coarser = _smoothed(level, 1 << band)
        out += gain * (level - coarser)
        level = coarser
    out += level
    return out


def filter_reach(bands: int) -> int:
    """Return how many frames away a frame still counts with so many bands left out."""
    return 2 * ((1 << bands) - 1)


def _checked(values: ArrayLike) -> FloatArray:
    curves = np.array(values, dtype=np.float64)
    if curves.ndim != 2:
        raise ValueError(f"values have shape {curves.shape}, not (frames, curves)")
    if not np.isfinite(curves).all():
        raise ValueError("values must be finite")
    return curves


def _smoothed(level: FloatArray, spread: int) -> FloatArray:
    frames = len(level)
    if not frames:
        return level
    padded = np.pad(level, ((2 * spread, 2 * spread), (0, 0)), mode="edge")
    out = np.zeros_like(level)
    for tap, share in enumerate(_KERNEL):
        out += share * padded[tap * spread : tap * spread + frames]
    return out
