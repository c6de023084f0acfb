"""Geodesic distances: time, error and memory."""

import resource
import time

import numpy as np

from tests.numerics.surface.test_geodesic import sphere
from usdface.numerics.surface.geodesic import geodesic_distances
from usdface.numerics.surface.surface_places import SurfacePoints
from usdface.numerics.surface.triangulation import triangulate

MARKERS = 102
RADIUS = 90.0
SIZES = ((134, 200), (500, 1000))
"""Rows and columns of a sphere of quads: 26,800 points, the size of a head, and half a million."""


def run(sizes: tuple[tuple[int, int], ...] = SIZES) -> None:
    """Print seconds and errors against great circles for each metric and size."""
    print("| points | metric | CPU seconds | mean error | worst | peak memory of the run so far |")
    print("|---|---|---|---|---|---|")
    for rows, columns in sizes:
        points, counts, indices = sphere(rows, columns, RADIUS)
        corners, owners = triangulate(counts, indices)
        rng = np.random.default_rng(0)
        chosen = rng.choice(len(corners), MARKERS)
        for metric in ("dijkstra", "dijkstra-diagonals"):
            start = time.process_time()
            found = geodesic_distances(
                points,
                counts,
                indices,
                SurfacePoints(owners[chosen], corners[chosen], rng.dirichlet([1, 1, 1], MARKERS)),
                metric=metric,
            )
            seconds = time.process_time() - start
            error = _errors(found.to_points, found.positions, points)
            peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20
            print(
                f"| {len(points):,} | {metric} | {seconds:.2f} | {100 * error.mean():.1f} % | "
                f"{100 * error.max():.0f} % | {peak:.1f} GB |",
                flush=True,
            )
            del found
    print("\nWanted: under 5 s for 26,719 points from 102 markers; 500,000 points within 8 GB.")


def _errors(to_points: np.ndarray, positions: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Return relative errors of a sample of the distances above 10 mm."""
    some = np.linspace(0, len(points) - 1, 5000).astype(int)
    unit = positions / np.linalg.norm(positions, axis=1, keepdims=True)
    exact = RADIUS * np.arccos(np.clip(unit @ points[some].T / RADIUS, -1, 1))
    far = exact > 10
    return np.abs(to_points[:, some] / np.maximum(exact, 1e-9) - 1)[far]
