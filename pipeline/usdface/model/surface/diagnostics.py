"""What a fit over a surface says of itself."""

from dataclasses import dataclass

import numpy as np

from usdface.core.arrays import FloatArray
from usdface.numerics.array_namespace import CPU, ArrayDevice
from usdface.numerics.manifold.chain_diagnostics import effective_sample_size, split_rhat
from usdface.numerics.manifold.hyper_sampling import sample_hyperparameters
from usdface.numerics.manifold.tabulated_energy import Precision, SharedTable


@dataclass(frozen=True)
class SurfaceDiagnostics:
    """How the fit came about.

    Attributes
    ----------
    clipped : float
        Change of the covariance between markers by which it became positive definite, as a share.
    left_out_rms_mm : float
        Error at markers that were left out of the fit, per coordinate [mm].
    acceptance, effective_samples, rhat : float
        Of the sampler on some of the fitted frames: mean probability of acceptance, effective
        samples of each chain and split R-hat of two chains, both medians over frames, axes and
        hyper-parameters. NaN without a sampler.
    two_modes : float
        Share of those posteriors with two modes.
    """

    clipped: float = 0.0
    left_out_rms_mm: float = float("nan")
    acceptance: float = float("nan")
    effective_samples: float = float("nan")
    rhat: float = float("nan")
    two_modes: float = float("nan")


def sample_twice(
    rng: np.random.Generator,
    table: SharedTable,
    rows: FloatArray,
    *,
    keep: int,
    device: ArrayDevice = CPU,
    dtype: Precision = "float32",
) -> tuple[FloatArray, dict[str, float]]:
    """Two chains for each row, the first of which is returned, and how well they agree."""
    first, modes = sample_hyperparameters(rng, table, rows, keep=keep, device=device, dtype=dtype)
    second, _ = sample_hyperparameters(
        rng, table, rows, keep=keep, modes=modes, device=device, dtype=dtype
    )
    both = np.stack([first.theta, second.theta], axis=1)
    return first.theta, {
        "acceptance": float(np.mean(first.acceptance)),
        "effective_samples": float(np.median(effective_sample_size(both))) / 2,
        "rhat": float(np.median(split_rhat(both))),
        "two_modes": float(np.mean(modes.double)),
    }
