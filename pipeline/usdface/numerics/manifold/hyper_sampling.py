"""Samples of the hyper-parameters of every chain: start, modes, chains."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from usdface.core.arrays import BoolArray, FloatArray
from usdface.numerics.array_namespace import CPU, ArrayDevice, namespace_of
from usdface.numerics.manifold.hybrid_monte_carlo import Jumps, sample_chains, take_chains
from usdface.numerics.manifold.laplace import LaplaceFit, fit_laplace
from usdface.numerics.manifold.straight_coordinates import (
    StraightEnergy,
    noise_gain,
    phi_of,
    theta_of,
)
from usdface.numerics.manifold.tabulated_energy import Precision, SharedTable, TabulatedEnergy

_APART = 2.5
"""In standard deviations of the nearer mode: closer modes are one."""

_RARE = 7.0
"""A mode e^7 times less likely than the other is left out."""


@dataclass(frozen=True)
class HyperSamples:
    """Samples of the hyper-parameters.

    Attributes
    ----------
    theta : (kept, 4, chains) float array
        ``log(v0, v1, a0, a1)``
    acceptance : (chains,) float array
        Mean probability of acceptance of the steps kept.
    angle : (chains,) float array
        That chains turn by in a step [radians].
    """

    theta: FloatArray
    acceptance: FloatArray
    angle: FloatArray


@dataclass(frozen=True)
class Modes:
    """The modes of every chain.

    Attributes
    ----------
    best : LaplaceFit
        The one with the more mass, in `straight_coordinates`.
    second : LaplaceFit
        The other start's; only that of chains in `double` is a mode of its own.
    theta, second_theta : (4, chains) float array
        Where they are.
    double : (chains,) bool array
        Chains with two: what moves may be signal or noise. numpy's.
    device : ArrayDevice
        Where the fits are.
    """

    best: LaplaceFit
    second: LaplaceFit
    theta: FloatArray
    second_theta: FloatArray
    double: BoolArray
    device: ArrayDevice = CPU


def find_modes(
    table: SharedTable,
    displacements: FloatArray,
    *,
    energy: TabulatedEnergy | None = None,
    device: ArrayDevice = CPU,
    dtype: Precision = "float64",
) -> Modes:
    """Look for modes from two starts: all is signal, all is noise.

    Parameters
    ----------
    table : SharedTable
    displacements : (chains, N) float array
        [mm]
    energy : TabulatedEnergy, optional
        Of these displacements, on `device` and of `dtype`, where it is made already.
    device : ArrayDevice
    dtype : {'float64', 'float32'}
    """
    centre = table.spectrum.prior.centre
    power = np.maximum(displacements.var(axis=1), 1e-3)
    signal = np.repeat(centre[:, None], len(displacements), axis=1)
    noise = signal.copy()
    signal[0] = 0.5 * (centre[0] + np.log(power))
    noise[0], noise[1] = centre[0] - 3.0, np.log(power)
    gain = noise_gain(table.spectrum)
    whole = energy or TabulatedEnergy(table, displacements, device=device, dtype=dtype)
    straight = StraightEnergy(whole, gain)
    with np.errstate(all="ignore"):  # a step too far overflows, and is not taken
        first, second = (
            fit_laplace(straight, device.put(phi_of(start, gain), dtype=dtype))
            for start in (signal, noise)
        )
        swap = second.log_evidence > first.log_evidence
        best, other = _choose(swap, second, first), _choose(swap, first, second)
        xp = namespace_of(swap)
        nearer = xp.minimum(_distance(best, other), _distance(other, best))
        likely = best.log_evidence - other.log_evidence < _RARE
    theta, second_theta = (
        theta_of(device.fetch(fit.mode).astype(np.float64), gain) for fit in (best, other)
    )
    double = device.fetch((nearer > _APART) & likely)
    return Modes(best, other, theta, second_theta, double, device)


def sample_hyperparameters(
    rng: np.random.Generator,
    table: SharedTable,
    displacements: FloatArray,
    *,
    burn: int = 40,
    keep: int = 200,
    modes: Modes | None = None,
    device: ArrayDevice = CPU,
    dtype: Precision = "float32",
) -> tuple[HyperSamples, Modes]:
    """Sample every chain's posterior: W06, eq. 3 and "200 sampled values".

    Parameters
    ----------
    rng : numpy.random.Generator
        Drawn from in the same order on every device.
    table : SharedTable
    displacements : (chains, N) float array
        [mm]
    burn, keep : int
    modes : Modes, optional
        Known already, on this device and of this type.
    device : ArrayDevice
        Where chains run; the samples are numpy's.
    dtype : {'float32', 'float64'}
        In double precision all devices walk the same chains. In single precision a rounding may
        accept what another device refuses: other samples of the same posterior.
    """
    energy = TabulatedEnergy(table, displacements, device=device, dtype=dtype)
    found = modes or find_modes(table, displacements, energy=energy, device=device, dtype=dtype)
    gain = noise_gain(table.spectrum)
    double = np.flatnonzero(found.double)
    jumps = None
    if len(double):
        some = device.put(double)
        jumps = Jumps(
            double,
            StraightEnergy(
                TabulatedEnergy(table, displacements[double], device=device, dtype=dtype), gain
            ),
            (take_chains(found.best, some), take_chains(found.second, some)),
        )
    with np.errstate(all="ignore"):  # a proposal that overflows is rejected
        samples = sample_chains(
            rng,
            StraightEnergy(energy, gain),
            found.best,
            burn=burn,
            keep=keep,
            jumps=jumps,
            device=device,
        )
    phi, acceptance, angle = (
        device.fetch(each).astype(np.float64)
        for each in (samples.places, samples.acceptance, samples.angle)
    )
    theta = np.moveaxis(theta_of(np.moveaxis(phi, 1, 0), gain), 0, 1)
    return HyperSamples(theta, acceptance, angle), found


def draw_laplace(
    rng: np.random.Generator, table: SharedTable, modes: Modes, *, keep: int
) -> FloatArray:
    """Draw from the Gaussian around the best mode instead of walking: (keep, 4, chains) theta."""
    mode, root = modes.device.fetch(modes.best.mode), modes.device.fetch(modes.best.root)
    drawn = rng.standard_normal((keep, *mode.shape))
    phi = mode[:, None] + np.einsum("abc,kbc->akc", root, drawn)
    return np.moveaxis(theta_of(phi, noise_gain(table.spectrum)), 0, 1)


def _choose(which: Any, yes: LaplaceFit, no: LaplaceFit) -> LaplaceFit:
    xp = namespace_of(which)
    return LaplaceFit(
        xp.where(which, yes.mode, no.mode),
        xp.where(which, yes.energy, no.energy),
        xp.where(which, yes.root, no.root),
        xp.where(which, yes.inverse, no.inverse),
        xp.where(which, yes.log_evidence, no.log_evidence),
    )


def _distance(of: LaplaceFit, to: LaplaceFit) -> Any:
    white = of.whiten(to.mode)
    xp = namespace_of(white)
    return xp.sqrt(xp.sum(white * white, axis=0))
