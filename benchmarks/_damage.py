"""Damage to a capture: noise, swapped labels, missing samples."""

import numpy as np

OWN_NOISE_MM = 0.15
"""Noise of the fixture."""

SWAPPED_SHARE = 0.2
LOST_SHARE = 0.05
NEIGHBOURS = 3

DAMAGES = ("as recorded", "noise 0.5 mm", "noise 1 mm", "20 % swapped", "5 % lost")


def damage(
    kind: str, positions: np.ndarray, visible: np.ndarray, rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray]:
    """Return positions and visibility of a capture with one of `DAMAGES`."""
    if kind.startswith("noise"):
        wanted = float(kind.split()[1])
        more = np.sqrt(wanted**2 - OWN_NOISE_MM**2)
        return positions + more * rng.standard_normal(positions.shape), visible
    if "swapped" in kind:
        return _swap(positions, visible, rng)
    if "lost" in kind:
        return positions, visible & (rng.random(visible.shape) >= LOST_SHARE)
    return positions, visible


def _swap(
    positions: np.ndarray, visible: np.ndarray, rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray]:
    """Swap neighbours for ranges of one frame to a second, until enough frames have a swap."""
    positions, visible = positions.copy(), visible.copy()
    frames, markers = visible.shape
    rest = np.median(positions, axis=0)
    apart = np.linalg.norm(rest[:, None] - rest, axis=2)
    nearest = apart.argsort(axis=1)[:, 1 : 1 + NEIGHBOURS]
    spoiled = np.zeros(frames, dtype=bool)
    while spoiled.mean() < SWAPPED_SHARE:
        first = int(rng.integers(markers))
        pair = [first, int(nearest[first, rng.integers(NEIGHBOURS)])]
        length = int(rng.integers(1, 61))
        start = int(rng.integers(frames - length))
        part = slice(start, start + length)
        positions[part, pair] = positions[part, pair[::-1]]
        visible[part, pair] = visible[part, pair[::-1]]
        spoiled[part] = True
    return positions, visible
