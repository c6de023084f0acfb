"""Speed of the sampler relative to a dense one, and of the prediction of whole meshes."""

import time
from dataclasses import replace

import numpy as np

from benchmarks._dense_sampler import sample_densely
from benchmarks._surface_subjects import demo_subject
from usdface.model.surface.distance import surface_distances
from usdface.model.surface.gp_surface import GpOptions, GpSurface, fit_gp_surface
from usdface.numerics.manifold.hybrid_monte_carlo import effective_sample_size, split_rhat
from usdface.numerics.manifold.hyper_posterior import TabulatedEnergy, noise_gain, to_theta
from usdface.numerics.manifold.hyper_sampling import sample_hyperparameters
from usdface.numerics.manifold.laplace import fit_laplace

TURNS = 5
"""Runs of each sampler, of which the fastest is used."""


def run(frames: int = 512) -> None:
    """Print the sampler's speed relative to a dense one in the same run, and that of meshes."""
    subject = demo_subject(frames, markers=42)
    distances = surface_distances(
        subject.points,
        subject.counts,
        subject.indices,
        subject.places,
    )
    rng = np.random.default_rng(0)
    moved = subject.motion[:, subject.chosen]
    moved = moved + 0.15 * rng.standard_normal(moved.shape)
    fitted = fit_gp_surface(distances, moved, GpOptions(length_scale=40.0))
    table = fitted.table
    rows = np.ascontiguousarray(moved.transpose(0, 2, 1).reshape(-1, moved.shape[1]))
    samples, acceptance, modes = sample_hyperparameters(rng, table, rows)
    again = sample_hyperparameters(rng, table, rows)[0]
    modes_theta = to_theta(modes.best.mode[:, :3].astype(np.float64), noise_gain(table.spectrum))
    around = fit_laplace(TabulatedEnergy(table, rows[:3]), modes_theta)
    times = np.empty((TURNS, 2))
    for turn in times:  # alternating, for equal load
        start = time.process_time()
        sample_hyperparameters(rng, table, rows)
        turn[0] = (time.process_time() - start) / frames
        start = time.process_time()
        sample_densely(rng, table.spectrum, rows[:3], around.root, around.mode)
        turn[1] = time.process_time() - start
    ours, dense = 1 / times.min(axis=0)
    start = time.process_time()
    plain, began = np.repeat(np.eye(4)[:, :, None], 3, axis=2), table.spectrum.prior.centre
    published = sample_densely(
        rng,
        table.spectrum,
        rows[:3],
        plain,
        np.repeat(began[:, None], 3, axis=1),
        burn=200,
        step=0.2,
        leapfrogs=(10, 10),
    )
    cold = 1 / (time.process_time() - start)
    ess_cold = np.median(effective_sample_size(published[:, None]))
    theta = np.stack([samples, again], axis=1)
    ess = np.median(effective_sample_size(theta[:, :1]))
    squares = (theta[:, :1] - theta.mean(axis=(0, 1))) ** 2
    ess_squared = np.median(effective_sample_size(squares))
    points = np.tile(subject.points, (3, 1))[:26_719]
    whole = _grown(fitted, np.tile(fitted.basis, (3, 1))[: len(points)])
    took = np.empty((2, 2))
    for turn in took:
        start, wall = time.process_time(), time.perf_counter()
        for _ in whole.stream(moved):
            pass
        turn[:] = time.process_time() - start, time.perf_counter() - wall
    cpu, wall = took.min(axis=0)
    print("| 42 markers, 3 axes, 200 saved samples | | wanted |")
    print("|---|---|---|")
    print(f"| sampled frames a second of one core | {ours:.0f} | |")
    print(f"| a dense sampler's, from the prior, 200 burn-in, 10 leapfrogs | {cold:.2f} | |")
    print(f"| its effective samples, median | {ess_cold:.0f} | |")
    print(f"| ratio | {ours / cold:.0f}× | ≥ 300× |")
    print(f"| a dense sampler's, given our modes, two or three leapfrogs | {dense:.2f} | |")
    print(f"| ratio | {ours / dense:.0f}× | ≥ 300× |")
    print(f"| effective samples, median | {ess:.0f} | ≥ 150 |")
    print(f"| of squares, which spreads are made of | {ess_squared:.0f} | |")
    print(f"| split R-hat, median | {np.median(split_rhat(theta)):.4f} | |")
    print(f"| acceptance | {acceptance.mean():.2f} | |")
    print(f"| posteriors with two modes | {100 * modes.double.mean():.1f} % | |")
    print(
        f"| mean and deviation on {len(points):,} points, frames a CPU second | "
        f"{frames / cpu:.0f} | ≥ 60 |"
    )
    print(f"| the same, frames a second as measured | {frames / wall:.0f} | ≥ 120 |")


def _grown(fitted: GpSurface, basis: np.ndarray) -> GpSurface:
    """Return the model on a mesh with the number of points of ICT's head."""
    count = len(basis)
    factors = replace(fitted.factors, of_points=np.tile(fitted.factors.of_points, 3)[:count])
    return replace(
        fitted,
        basis=basis,
        factors=factors,
        added=np.tile(fitted.added, 3)[:count],
        alone=np.tile(fitted.alone, 3)[:count],
        point_count=count,
    )
