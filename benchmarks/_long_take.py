"""Takes of any length, which play the demo's actor forwards and backwards in a loop."""

from collections.abc import Iterable
from pathlib import Path

import numpy as np

from tests.c3d_write import write_c3d
from usdface.core.arrays import IntArray
from usdface.demo.acting import performance
from usdface.demo.capture import demo_markers, simulate_capture
from usdface.demo.rig import make_head
from usdface.demo.sculpt import ACTOR

NOISE_MM = 0.1
"""Noise of every frame, since USD stores equal samples once."""


def to_and_fro(frames: int, count: int) -> IntArray:
    """Return the frames, of `count`, that play a take forwards and backwards."""
    return np.abs((np.arange(frames) + count - 1) % (2 * count - 2) - (count - 1))


def write_captures(folder: Path, lengths: Iterable[int]) -> None:
    """Write ``LENGTH.c3d`` of each number of frames, with noise."""
    actor, acted = make_head(ACTOR), performance()
    markers = demo_markers(actor)
    positions, visible = simulate_capture(actor, acted, markers)
    count = len(positions)
    for frames in lengths:
        again = to_and_fro(frames, count)
        rng = np.random.default_rng(0)
        moved = positions[again]
        for start in range(0, frames, count):
            part = moved[start : start + count]
            part += np.float32(NOISE_MM) * rng.standard_normal(part.shape, dtype=np.float32)
        write_c3d(
            folder / f"{frames}.c3d",
            moved,
            visible[again],
            markers.names,
            rate=acted.weights.rate,
            first_frame=1,
        )
