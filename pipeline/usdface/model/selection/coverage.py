"""How well references span what a performer does: where the holes are, what would fill them."""

from dataclasses import dataclass

import numpy as np

from usdface.core.arrays import BoolArray, FloatArray, IntArray
from usdface.model.mapping.coverage import UNCOVERED_SHARE
from usdface.model.selection.design import Features, SelectionSpace, features_at
from usdface.numerics.regression.design_kernel import KEY_VARIANCE, DesignKernel, left_over
from usdface.numerics.regression.reference_design import design_gp_variance

_BLOCK_FRAMES = 4096

COVERED_FRAMES = 24_000
"""Frames that are measured one by one; of longer takes every second, third ... stands for all."""

CURVE_FRAMES = 1500
"""Frames spread over the takes on which coverage is averaged."""


@dataclass(frozen=True)
class Coverage:
    """How well pairs determine every frame."""

    covered: FloatArray
    """(frames,): share of each frame's motion that the pairs determine: one less the standard
    deviation that they leave of what there was [0-1]."""
    regions: tuple[str, ...]
    region_covered: FloatArray
    """(frames, regions): the same, of each part of the face alone."""

    @property
    def share(self) -> float:
        """Coverage of the takes: the mean over all frames [0-1]."""
        return float(self.covered.mean())

    @property
    def hole_share(self) -> float:
        """Share of the frames that are holes [0-1]."""
        return float((self.covered < 1 - UNCOVERED_SHARE).mean())


@dataclass(frozen=True)
class Growth:
    """What each pair brought, and what further ones would."""

    share: FloatArray
    """(pairs + 1,): coverage with none, one, two ... of the pairs, in their order [0-1]."""
    further_rows: IntArray
    """(count,): frames that would be chosen next: the deepest holes, each once those before are
    filled."""
    further_share: FloatArray
    """(count,): coverage with one, two ... of them as well."""


def measure_coverage(
    space: SelectionSpace, features: Features, pair_features: FloatArray
) -> Coverage:
    """Measure how far pairs determine every frame.

    Parameters
    ----------
    features : (frames, d) float array
        Of all frames of the takes.
    pair_features : (pairs, d) float array
    """
    count = len(features)
    step = -(-count // COVERED_FRAMES)  # neighbours of a long recording are one face
    thinned = np.asarray(features[::step], dtype=np.float64)
    some = _spread(len(thinned))
    covered = np.empty(len(thinned))
    regions = np.empty((len(thinned), len(space.regions)))
    whole = DesignKernel.for_rows(thinned[some])
    parts = [DesignKernel.for_rows(thinned[some, a:b]) for a, b in space.columns]
    for start in range(0, len(thinned), _BLOCK_FRAMES):
        rows = slice(start, start + _BLOCK_FRAMES)
        left = left_over(whole, pair_features, thinned[rows], noise=KEY_VARIANCE)
        covered[rows] = 1 - np.sqrt(left)
        for index, ((a, b), kernel) in enumerate(zip(space.columns, parts, strict=True)):
            left = left_over(kernel, pair_features[:, a:b], thinned[rows, a:b], noise=KEY_VARIANCE)
            regions[rows, index] = 1 - np.sqrt(left)
    return Coverage(
        np.repeat(covered, step)[:count], space.regions, np.repeat(regions, step, axis=0)[:count]
    )


def measure_growth(
    features: Features,
    pair_features: FloatArray,
    *,
    further: int = 10,
    candidates: BoolArray | None = None,
) -> Growth:
    """Measure coverage pair by pair, and with the frames that would be chosen next.

    Parameters
    ----------
    further : int
        How many frames to look ahead.
    candidates : (frames,) bool array, optional
        Frames that could be tuned.
    """
    open_rows = np.flatnonzero(np.ones(len(features), bool) if candidates is None else candidates)
    rows = open_rows[_spread(len(open_rows), 20 * CURVE_FRAMES)]
    together = np.concatenate([pair_features, features_at(features, rows)])
    known = np.arange(len(pair_features), dtype=np.int64)
    count = min(further, len(rows))
    design = design_gp_variance(together, count, already=known, noise=KEY_VARIANCE)
    chosen = design.chosen - len(known)
    sample = features_at(features, _spread(len(features)))
    kernel = DesignKernel.for_rows(sample)
    share = _shares(
        kernel, np.concatenate([pair_features, features_at(features, rows[chosen])]), sample
    )
    return Growth(share[: len(known) + 1], rows[chosen], share[len(known) + 1 :])


def _shares(kernel: DesignKernel, pairs: FloatArray, sample: FloatArray) -> FloatArray:
    """Return the mean coverage with the first 0, 1, 2 ... pairs: one factorisation for all."""
    if not len(pairs):
        return np.zeros(1)
    factor = np.linalg.cholesky(kernel(pairs, pairs) + KEY_VARIANCE * np.eye(len(pairs)))
    rows = np.linalg.solve(factor, kernel(pairs, sample))
    left = np.maximum(1 - np.cumsum(rows**2, axis=0) / kernel.diagonal(sample), 0.0)
    return np.concatenate([[0.0], 1 - np.sqrt(left).mean(axis=1)])


def _spread(count: int, wanted: int = CURVE_FRAMES) -> IntArray:
    return np.unique(np.linspace(0, count - 1, min(count, wanted)).astype(np.int64))
