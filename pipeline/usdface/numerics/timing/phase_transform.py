"""Cross spectra that count phase alone, as far as speech reaches.

The generalised cross-correlation with phase transform (Knapp and Carter 1976, IEEE Transactions on
Acoustics, Speech and Signal Processing 24(4), 320-327) sharpens the peak of the direct path, which
reverberation smears in a plain correlation.
"""

import numpy as np
from scipy import fft

from usdface.core.arrays import ComplexArray, Float32Array

_WHITENING = 0.8
"""Exponent of the phase transform: 1 would lift frequencies at which nothing sounds."""

_LOWEST_HZ, _HIGHEST_HZ = 200.0, 6000.0


def speech_band(length: int, *, rate: int) -> Float32Array:
    """Return 1 for the frequencies of a transform of so many samples that speech has, else 0.

    Parameters
    ----------
    length : int
        Samples transformed.
    rate : int
        Samples per second.

    Returns
    -------
    (length // 2 + 1,) float32 array
    """
    frequency = fft.rfftfreq(length, 1 / rate)
    band = (frequency > _LOWEST_HZ) & (frequency < min(_HIGHEST_HZ, 0.45 * rate))
    return band.astype(np.float32)


def whitened_product(
    first: ComplexArray, second: ComplexArray, *, band: Float32Array
) -> ComplexArray | None:
    """Return the cross spectrum of two sounds, its sizes nearly levelled.

    Parameters
    ----------
    first, second : (n,) complex array
        Spectra of two sounds.
    band : (n,) float array
        Weight of each frequency.

    Returns
    -------
    (n,) complex array or None
        None for silence.
    """
    cross = first.conj() * second
    size = np.abs(cross)
    usual = float(np.median(size))
    if not usual > 0:
        return None
    product: ComplexArray = cross * (band / (size**_WHITENING + 1e-3 * usual**_WHITENING))
    return product
