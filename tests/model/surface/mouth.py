"""A sheet with a slit for a mouth, whose true motion is known."""

from dataclasses import dataclass

import numpy as np

from tests.numerics.surface.test_geodesic import quad_grid
from usdface.model.surface.distance import SurfaceDistances, surface_distances
from usdface.numerics.surface.surface_places import SurfacePoints, places_at_points

ROWS, COLUMNS, STEP = 31, 31, 4.0
SLIT = 15


@dataclass(frozen=True)
class Mouth:
    points: np.ndarray
    counts: np.ndarray
    indices: np.ndarray
    places: SurfacePoints
    chosen: np.ndarray
    motion: np.ndarray
    """(frames, points, 3): what every point does."""
    upper: np.ndarray
    lower: np.ndarray

    def distances(self, **options: str) -> SurfaceDistances:
        return surface_distances(
            self.points,
            self.counts,
            self.indices,
            self.places,
            **options,  # type: ignore[arg-type]
        )

    def markers(self, noise: float = 0.0) -> np.ndarray:
        rng = np.random.default_rng(5)
        clean = self.motion[:, self.chosen]
        return clean + noise * rng.standard_normal(clean.shape)


def make_mouth() -> Mouth:
    """Build the sheet; its markers lie on a grid and along the lips."""
    points, counts, indices = quad_grid(ROWS, COLUMNS, step=STEP)
    points = points - points.mean(axis=0)
    upper = SLIT * COLUMNS + np.arange(6, 25)
    lower = len(points) + np.arange(len(upper))
    quads = indices.reshape(-1, 4).copy()
    below = points[quads].mean(axis=1)[:, 1] < points[upper[0], 1]
    for old, new in zip(upper, lower, strict=True):
        quads[below] = np.where(quads[below] == old, new, quads[below])
    whole = np.concatenate([points, points[upper]])
    y, x = whole[:, 1] - points[upper[0], 1], whole[:, 0]
    under = y < 0
    under[lower] = True
    jaw = under * np.maximum(0, 1 - (x / 42) ** 2) * np.exp(-0.5 * (np.minimum(y, 0) / 45) ** 2)
    smile = np.exp(-0.5 * (((np.abs(x) - 40) / 18) ** 2 + (y / 18) ** 2))
    brow = np.exp(-0.5 * (((x - 10) / 25) ** 2 + ((y - 45) / 14) ** 2))
    shapes = np.zeros((3, len(whole), 3))
    shapes[0, :, 1], shapes[0, :, 2] = -14 * jaw, -3 * jaw
    shapes[1, :, 0], shapes[1, :, 1] = 5 * smile * np.sign(x), 5 * smile
    shapes[2, :, 1] = 6 * brow
    weights = np.clip(np.random.default_rng(2).uniform(-0.3, 1, (30, 3)), 0, 1)
    motion = np.einsum("fs,spc->fpc", weights, shapes)
    grid = np.arange(ROWS * COLUMNS).reshape(ROWS, COLUMNS)
    chosen = grid[1::4, 1::4].ravel()
    lips = np.concatenate([grid[SLIT + 1, 7:25:4], grid[SLIT - 1, 7:25:4]])
    chosen = np.unique(np.concatenate([chosen, lips]))
    places = places_at_points(counts, quads.ravel(), chosen)
    return Mouth(whole, counts, quads.ravel(), places, chosen, motion, upper, lower)


def rms(mouth: Mouth, mean: np.ndarray) -> float:
    unseen = np.setdiff1d(np.arange(len(mouth.points)), mouth.chosen)
    return float(np.sqrt(((mean - mouth.motion)[:, unseen] ** 2).mean()))


def opening(mouth: Mouth, motion: np.ndarray) -> float:
    middle = slice(5, 14)
    parted = motion[:, mouth.upper[middle], 1] - motion[:, mouth.lower[middle], 1]
    return float(parted.mean())
