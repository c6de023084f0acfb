"""Coordinates in which the posterior of the hyper-parameters is nearly Gaussian.

Displacements tell the power along each direction of the spectrum well, ``v0 l + v1``, but hardly
how much of it is noise. So in ``log(v0, v1, a0, a1)`` the posterior is bent: where v1 is small v0
is known, where it is large v0 makes room for it. With the bend taken out by ``k = 1 / median l``::

    phi = (log(v0 + k v1), log(v1 / v0), log a0, log a1)

chains of one gradient a step mix as those of leapfrog steps do in theta. Theta is a function of phi
whose determinant is 1, so densities, modes and evidence are the same in both.
"""

from typing import Any

import numpy as np

from usdface.numerics.array_namespace import namespace_of
from usdface.numerics.manifold.hyper_posterior import MarkerSpectrum
from usdface.numerics.manifold.laplace import Energy


def noise_gain(spectrum: MarkerSpectrum) -> float:
    """Return k: how much signal a unit of noise is mistaken for, in the spectrum's middle."""
    return float(1.0 / np.median(spectrum.values))


def theta_of(phi: Any, gain: float) -> Any:
    """Turn coordinates into log hyper-parameters.

    Parameters
    ----------
    phi : (4, ...) array
    gain : float
        See `noise_gain`.

    Returns
    -------
    (4, ...) array
    """
    xp = namespace_of(phi)
    log_v0 = phi[0, ...] - _log_total(phi[1, ...], gain)
    return xp.stack([log_v0, log_v0 + phi[1, ...], phi[2, ...], phi[3, ...]])


def phi_of(theta: Any, gain: float) -> Any:
    """Turn log hyper-parameters (4, ...) into coordinates."""
    xp = namespace_of(theta)
    ratio = theta[1, ...] - theta[0, ...]
    return xp.stack([theta[0, ...] + _log_total(ratio, gain), ratio, theta[2, ...], theta[3, ...]])


class StraightEnergy:
    """The energy of an `Energy` in these coordinates: call it with phi of shape (4, chains).

    Parameters
    ----------
    energy : callable
        Of theta.
    gain : float
        See `noise_gain`.
    """

    def __init__(self, energy: Energy, gain: float) -> None:
        self._energy, self._gain = energy, gain

    def __call__(self, phi: Any, with_energy: bool = True) -> tuple[Any, Any]:
        """Return the energies (chains,), or None, and gradients (4, chains)."""
        xp = namespace_of(phi)
        value, gradient = self._energy(theta_of(phi, self._gain), with_energy)
        by_total = gradient[0, :] + gradient[1, :]
        share = 1.0 / (1.0 + xp.exp(-phi[1, :]) / self._gain)  # of noise in the total
        by_ratio = gradient[1, :] - share * by_total
        return value, xp.stack([by_total, by_ratio, gradient[2, :], gradient[3, :]])


def _log_total(ratio: Any, gain: float) -> Any:
    """``log(1 + k e^ratio)``, which does not overflow."""
    xp = namespace_of(ratio)
    shifted = ratio + float(np.log(gain))
    return xp.clip(shifted, 0.0, None) + xp.log1p(xp.exp(-xp.abs(shifted)))
