"""Our sampler compared with long chains of numpyro's NUTS; skipped without numpyro."""

from importlib.util import find_spec

import numpy as np

from tests.numerics.manifold.small_process import dense_parts, draw_rows, small_spectrum
from usdface.numerics.manifold.hyper_posterior import SharedTable
from usdface.numerics.manifold.hyper_sampling import sample_hyperparameters

ROWS = 4
MARKERS = 20


def run() -> None:
    """Print posterior means and spreads of both samplers."""
    if find_spec("numpyro") is None or find_spec("jax") is None:
        print("skipped: numpyro is not installed")
        return
    rng = np.random.default_rng(0)
    spectrum = small_spectrum(MARKERS)
    rows = draw_rows(spectrum, rng, ROWS)
    many = np.repeat(rows, 40, axis=0)
    theta = sample_hyperparameters(rng, SharedTable(spectrum), many)[0].theta
    ours = np.moveaxis(theta.reshape(200, 4, ROWS, 40), 3, 1).reshape(-1, 4, ROWS)
    print("| row | parameter | mean, ours | mean, NUTS | spread, ours | spread, NUTS |")
    print("|---|---|---|---|---|---|")
    for row in range(ROWS):
        theirs = _nuts(spectrum, rows[row])
        for k, name in enumerate(("v0", "v1", "a0", "a1")):
            a, b = ours[:, k, row], theirs[:, k]
            print(
                f"| {row} | log {name} | {a.mean():.3f} | {b.mean():.3f} | "
                f"{a.std():.3f} | {b.std():.3f} |"
            )


def _nuts(spectrum, row: np.ndarray) -> np.ndarray:  # type: ignore[no-untyped-def]
    """Sample eq. 8 by Cholesky factors: (draws, 4)."""
    import jax
    import jax.numpy as jnp
    from numpyro.infer import MCMC, NUTS

    jax.config.update("jax_enable_x64", True)
    K, trend = (jnp.asarray(part) for part in dense_parts(spectrum))
    centre, spread = jnp.asarray(spectrum.prior.centre), jnp.asarray(spectrum.prior.spread)

    def energy(theta):  # type: ignore[no-untyped-def]
        v0, v1, a0, a1 = jnp.exp(theta)
        whole = v0 * K + v1 * jnp.eye(len(K)) + (trend * jnp.array([a0, a1, a1, a1])) @ trend.T
        factor = jnp.linalg.cholesky(whole)
        white = jax.scipy.linalg.solve_triangular(factor, jnp.asarray(row), lower=True)
        away = (theta - centre) / spread
        return jnp.log(jnp.diag(factor)).sum() + 0.5 * (white @ white + away @ away)

    sampler = MCMC(NUTS(potential_fn=energy), num_warmup=1000, num_samples=8000, progress_bar=False)
    sampler.run(jax.random.PRNGKey(0), init_params=centre)
    return np.asarray(sampler.get_samples())
