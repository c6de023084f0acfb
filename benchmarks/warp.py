"""Speed of warping and search in an hour of motion, relative to a copy and to brute force."""

import time
from collections.abc import Callable

import numpy as np

from usdface.numerics.motion.laplacian_warp import Insertion, warp_motion
from usdface.numerics.motion.sequence_search import (
    find_sequence,
    mean_face_distance,
    starts_within,
)

FRAMES, CONTROLS = 432_000, 46
SEQUENCE = 120
EVERY = 6_000
"""Frames between planted sequences: 100 s at 60 frames per second."""


def run() -> None:
    """Print both ratios, and whether search and brute force agree."""
    rng = np.random.default_rng(0)
    motion = _motion(rng)
    time_line = np.linspace(0, 1, SEQUENCE)[:, None]
    sequence = np.sin(np.pi * time_line) * rng.random(CONTROLS)
    starts = np.arange(3000, FRAMES - SEQUENCE, EVERY)
    for at in starts.tolist():
        motion[at : at + SEQUENCE] = sequence * rng.uniform(0.9, 1.1)
    keys = [Insertion(int(s), 1.2 * sequence, np.full(SEQUENCE, 20.0)) for s in starts]
    copied = _seconds(motion.copy)
    warped = _seconds(lambda: warp_motion(motion, keys))
    published = _seconds(lambda: warp_motion(motion, keys, keep=1.0))
    threshold = 0.5 * mean_face_distance(sequence)
    start = time.perf_counter()
    distances = _brute(motion, sequence)
    brute = time.perf_counter() - start
    searched = _seconds(lambda: starts_within(motion, sequence, threshold=threshold))
    found = starts_within(motion, sequence, threshold=threshold).starts
    same = np.array_equal(found, np.flatnonzero(distances <= threshold))
    places = find_sequence(motion, sequence).starts
    print(f"{FRAMES:,} frames of {CONTROLS} controls, {len(starts)} sequences of {SEQUENCE}\n")
    print("| measure | value | wanted |")
    print("|---|---|---|")
    print(f"| copy | {copied:.2f} s | |")
    print(f"| warp, outside held | {warped / copied:.2f}× a copy | ≤ 2× |")
    print(f"| warp, as published | {published / copied:.2f}× a copy | ≤ 2× |")
    print(f"| brute force search | {brute:.2f} s | |")
    print(f"| search | {searched / brute:.2f}× brute force | ≤ 2× |")
    print(f"| it finds the same {len(found)} starts | {'yes' if same else 'NO'} | yes |")
    print(
        f"| planted sequences found | {np.isin(starts, places).sum()} of {len(starts)}, "
        f"{len(places) - np.isin(places, starts).sum()} beside | all |"
    )


def _motion(rng: np.random.Generator) -> np.ndarray:
    """Return a minute of smooth random weights, repeated."""
    minute = np.cumsum(rng.normal(0, 0.02, (3600, CONTROLS)), axis=0)
    return np.tile(0.25 + 0.25 * np.sin(minute), (FRAMES // 3600, 1))


def _brute(motion: np.ndarray, sequence: np.ndarray) -> np.ndarray:
    """Evaluate eq. 10 for every start in plain numpy."""
    count = len(motion) - len(sequence) + 1
    total = np.zeros(count)
    for offset, wanted in enumerate(sequence):
        difference = motion[offset : offset + count] - wanted
        total += np.sqrt(np.einsum("nc,nc->n", difference, difference))
    return total / (len(sequence) * np.sqrt(sequence.shape[1]))


def _seconds(work: Callable[[], object]) -> float:
    times = []
    for _ in range(5):
        start = time.perf_counter()
        work()
        times.append(time.perf_counter() - start)
    return float(np.median(times))
