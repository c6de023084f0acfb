"""Speed of mappings relative to lower bounds of the same run: matrix products, one decomposition.

Times are processor times, which depend less on other work on the machine. The training of a rig of
946 shapes, most of them correctives, is timed as well.
"""

import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from usdface.core.assets import References
from usdface.model.mapping.motion_space import fit_motion_space
from usdface.model.mapping.temporal import TemporalSolve, smooth_weights
from usdface.model.mapping.train import train_mapping
from usdface.numerics.regression.rbf_ridge import (
    choose_ridge,
    fit_rbf_ridge,
    gaussian_design,
    predict_rbf_ridge,
    rotate,
    shared_widths,
)

FRAMES = 20_000
BLOCK = 4096
DIMENSIONS = 16
BASE_SHAPES = 100
CORRECTIVES = 846
PAIRS = 200


def run(*, quick: bool = False) -> None:
    """Print ratios to the lower bounds, and times."""
    print("| measure | value | wanted |")
    print("|---|---|---|")
    small = _mapping_ratio(pairs=100, shapes=46, with_exp=True)
    print(f"| mapping, 100 pairs, 46 shapes, against products + exp | {small:.2f}× | ≥ 0.65× |")
    large = _mapping_ratio(pairs=1000, shapes=946, with_exp=False)
    print(f"| mapping, 1,000 pairs, 946 shapes, against products alone | {large:.2f}× | ≥ 0.8× |")
    print(f"| ridge of 946 outputs, 1,000 pairs, against one SVD | {_ridge():.2f}× | ≤ 1.2× |")
    for mode in ("whole", "causal"):
        once, twice = (_smoothing(mode, frames) for frames in (4000, 8000))
        print(f"| {mode} smoothing, time for twice the frames | {twice / once:.2f}× | linear |")
    if not quick:
        seconds = _train_large()
        print(f"| training 946 shapes on {PAIRS} references | {seconds:.0f} s | < 60 s |")


def _fastest(work: Callable[[], object], times: int = 5) -> float:
    """Return the shortest time of several runs [s]."""
    taken = []
    for _ in range(times):
        start = time.process_time()
        work()
        taken.append(time.process_time() - start)
    return min(taken)


def _mapping_ratio(*, pairs: int, shapes: int, with_exp: bool) -> float:
    rng = np.random.default_rng(0)
    centres = rng.normal(size=(pairs, DIMENSIONS))
    model = fit_rbf_ridge(
        centres, rng.uniform(size=(pairs, shapes)), widths=shared_widths(centres), ridge=1.0
    )
    frames = FRAMES if with_exp else FRAMES // 4
    points = rng.normal(size=(frames, DIMENSIONS))
    out = np.empty((frames, shapes))

    def floor() -> None:
        for start in range(0, frames, BLOCK):
            part = slice(start, start + BLOCK)
            near = points[part] @ centres.T
            if with_exp:
                np.exp(near, out=near)
            np.matmul(near, model.coefficients, out=out[part])

    least = _fastest(floor)
    fitted = model.centres, model.widths, model.coefficients
    return least / _fastest(lambda: predict_rbf_ridge(points, *fitted))


def _ridge() -> float:
    rng = np.random.default_rng(0)
    centres = rng.normal(size=(1000, DIMENSIONS))
    design = gaussian_design(centres, centres, shared_widths(centres))
    outputs = rng.uniform(size=(1000, 946))
    one = _fastest(lambda: np.linalg.svd(design, full_matrices=False), 2)
    return _fastest(lambda: choose_ridge(rotate(design, outputs)), 2) / one


def _smoothing(mode: str, frames: int) -> float:
    weights = np.random.default_rng(0).uniform(-0.1, 1.1, size=(frames, 51))
    solve = TemporalSolve(mode)  # type: ignore[arg-type]
    ranges = np.tile([0.0, 1.0], (51, 1))
    sure = np.zeros(frames)
    return _fastest(
        lambda: smooth_weights(weights, uncertainty_mm=sure, ranges=ranges, rate=60.0, solve=solve),
        2,
    )


@dataclass(frozen=True)
class _Large:
    """A rig of base shapes and correctives, and a performance on it."""

    skin: np.ndarray
    weights: np.ndarray
    positions: np.ndarray


def _large_rig() -> _Large:
    """Make shapes that move patches of a face, and correctives driven by two of them."""
    rng = np.random.default_rng(0)
    points = rng.uniform(-70, 70, size=(900, 3))
    centres = points[rng.choice(len(points), BASE_SHAPES, replace=False)]
    reach = np.linalg.norm(points[None] - centres[:, None], axis=2)
    bumps = np.exp(-0.5 * (reach / 15.0) ** 2)
    base = bumps[:, :, None] * rng.normal(size=(BASE_SHAPES, 1, 3)) * 4.0
    pairs = rng.integers(BASE_SHAPES, size=(CORRECTIVES, 2))
    both = bumps[pairs[:, 0]] * bumps[pairs[:, 1]]
    correct = both[:, :, None] * rng.normal(size=(CORRECTIVES, 1, 3)) * 2.0
    frames = np.arange(3000)[:, None] / 60.0
    waves = np.sin(frames * rng.uniform(0.5, 6.0, BASE_SHAPES) + rng.uniform(0, 6, BASE_SHAPES))
    acted = np.clip(1.5 * waves - 0.7, 0.0, 1.0)
    weights = np.hstack([acted, acted[:, pairs[:, 0]] * acted[:, pairs[:, 1]]])
    skin = np.concatenate([base, correct])
    markers = rng.choice(len(points), 100, replace=False)
    moved = (weights @ skin[:, markers].reshape(len(skin), -1)).reshape(len(weights), -1, 3)
    moved += points[markers] + 0.1 * rng.standard_normal(moved.shape)
    return _Large(skin, weights, moved)


def _train_large() -> float:
    rig = _large_rig()
    chosen = np.linspace(0, len(rig.weights) - 1, PAIRS).astype(np.int64)
    flat = rig.skin.reshape(len(rig.skin), -1)
    references = References(
        marker_names=tuple(f"m{i}" for i in range(rig.positions.shape[1])),
        shape_names=tuple(f"s{i}" for i in range(len(rig.skin))),
        markers=rig.positions[chosen],
        weights=rig.weights[chosen],
        frames=chosen,
        takes=("take",) * PAIRS,
        tuned=np.ones(PAIRS, dtype=bool),
        rigid=(),
        neutral=rig.positions[0],
        rig_file=Path("large.usd"),
        rig_prim="/",
        motion=fit_motion_space([rig.positions.astype(np.float32)]),
    )
    start = time.process_time()
    train_mapping(
        references,
        ranges=np.tile([0.0, 1.0], (len(rig.skin), 1)),
        gram=flat @ flat.T / rig.skin.shape[1],
        skin=rig.skin,
        progress=lambda share, what: print(
            f"  {time.process_time() - start:5.0f} s {what}", file=sys.stderr
        ),
    )
    return time.process_time() - start
