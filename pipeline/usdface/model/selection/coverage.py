"""How well references span what a performer does: where the holes are, where pairs conflict.

Pairs also contradict each other: alike markers, unlike weights. No mapping can follow both; it will
meet them half-way and be wrong twice. Most are slips: a pair tuned by another frame, a slider left
behind from the pair before.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from usdface.core.arrays import BoolArray, FloatArray, IntArray, sample_frames
from usdface.core.assets import References
from usdface.model.mapping.coverage import UNCOVERED_SHARE, CoverageModel
from usdface.model.mapping.motion_space import motion_from_pca
from usdface.model.selection.design import Features, features_at, selection_space
from usdface.numerics.measure.face_regions import shapes_by_region
from usdface.numerics.regression.design_kernel import KEY_VARIANCE
from usdface.numerics.regression.linear_ridge import fit_linear_ridge
from usdface.numerics.regression.pca import fit_pca
from usdface.numerics.regression.reference_design import design_gp_variance

_FEWEST_PAIRS = 6
"""With fewer nothing tells how far weights usually go with markers."""

_NEAR_MARKERS_SHARE = 0.2
"""Share of the usual distance between pairs below which markers of a region are alike."""

LEAST_STEP = 0.35
"""Least difference of any one weight: below it two animators would differ as much."""

FAR_WEIGHTS_SHARE = 0.6
"""Share of the usual distance between pairs above which weights of a region are unlike."""

_ROUNDING_SHARE = 1e-6
"""Of the largest distance: one below it is rounding."""


@dataclass(frozen=True)
class ReferenceConflict:
    """Two pairs that contradict each other."""

    first: int
    second: int
    """`first`, `second`: Indices of the pairs."""
    region: str
    """Where on the face; empty for the face as a whole."""
    shape: str
    """The shape that differs most."""
    weights: tuple[float, float]
    """Its weight in the one and in the other."""
    times: float
    """How many times further apart the weights are than the markers, each against the usual."""


def find_reference_conflicts(references: References) -> list[ReferenceConflict]:
    """Find pairs whose weights differ far more than their markers do, the worst first.

    Each part of the face is compared by itself, so that a lid is not excused by a jaw. Alike and
    unlike are measured against the usual distance between pairs.
    """
    pairs, shapes = references.weights.shape
    if pairs < _FEWEST_PAIRS:
        return []
    packed = references.markers.reshape(pairs, -1)
    motion = references.motion or motion_from_pca(fit_pca(packed), packed)
    coordinates = (packed - motion.mean) @ motion.components.T
    line = fit_linear_ridge(coordinates, references.weights)
    sample = (motion.sample - line.mean) @ line.coefficients + line.intercept
    space = selection_space(motion, np.clip(sample, 0, 1), references.shape_names)
    features = space.features(coordinates)
    by_region = shapes_by_region(references.shape_names)
    worst: dict[tuple[int, int], ReferenceConflict] = {}
    for region, (a, b) in zip(space.regions, space.columns, strict=True):
        columns = by_region.get(region, np.arange(shapes))
        near = _distances(features[:, a:b])
        far = _distances(references.weights[:, columns])
        conflicting = (near < _NEAR_MARKERS_SHARE) & (far > FAR_WEIGHTS_SHARE)
        for i, j in np.argwhere(np.triu(conflicting, 1)).tolist():
            difference = np.abs(references.weights[i, columns] - references.weights[j, columns])
            times = float(far[i, j] / max(near[i, j], 1e-3))
            known = worst.get((i, j))
            if difference.max() < LEAST_STEP or (known is not None and known.times >= times):
                continue
            shape = int(columns[difference.argmax()])
            worst[i, j] = ReferenceConflict(
                i,
                j,
                region if region in by_region else "",
                references.shape_names[shape],
                (float(references.weights[i, shape]), float(references.weights[j, shape])),
                times,
            )
    return sorted(worst.values(), key=lambda conflict: -conflict.times)


def conflict_text(references: References, conflict: ReferenceConflict) -> str:
    """Say which pairs contradict each other, and in what."""
    first, second = (
        f"pair {pair + 1} ({references.takes[pair]} {references.frames[pair]})"
        for pair in (conflict.first, conflict.second)
    )
    low, high = conflict.weights
    where = f" at the {conflict.region}" if conflict.region else ""
    return (
        f"{first} and {second} have nearly the same markers{where} and unlike weights: "
        f"{conflict.shape} {low:.2f} and {high:.2f}"
    )


def _distances(rows: FloatArray) -> FloatArray:
    """Return distances between all rows, over the usual one.

    The usual one is the median between rows that differ: few pairs may use a region at all.
    """
    product = rows @ rows.T
    squares = np.diag(product)
    away = np.sqrt(np.maximum(squares[:, None] + squares - 2 * product, 0.0))
    between = away[np.triu_indices(len(rows), 1)]
    positive = between[between > _ROUNDING_SHARE * away.max()]
    return np.asarray(away / (np.median(positive) if len(positive) else 1.0))


_BLOCK_FRAMES = 4096

COVERED_FRAMES = 24_000
"""Frames that are measured one by one; of longer takes every second, third ... stands for all."""

CURVE_FRAMES = 1500
"""Frames spread over the takes on which coverage is averaged."""


@dataclass(frozen=True)
class Coverage:
    """How far pairs show what every frame does; see `model.mapping.coverage`."""

    covered: FloatArray
    """(frames,): of the whole face [0-1]."""
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


Displacements = Callable[[IntArray], FloatArray]
"""Markers' displacements from the neutral at rows of all takes: (rows, markers, 3) [mm]."""


def measure_coverage(
    model: CoverageModel, regions: tuple[str, ...], displacements: Displacements, count: int
) -> Coverage:
    """Measure how far pairs show what each of `count` frames does.

    Parameters
    ----------
    regions : tuple of str
        Those of the model, the whole face first.
    """
    step = -(-count // COVERED_FRAMES)  # neighbours of a long recording are one face
    rows = np.arange(0, count, step, dtype=np.int64)
    found = np.concatenate(
        [
            model.measure(displacements(rows[start : start + _BLOCK_FRAMES]))
            for start in range(0, len(rows), _BLOCK_FRAMES)
        ]
    )
    every = np.repeat(found, step, axis=0)[:count]
    return Coverage(every[:, 0], regions[1:], every[:, 1:])


def choose_further(
    features: Features, pair_features: FloatArray, *, count: int, candidates: BoolArray
) -> IntArray:
    """Return rows of the frames that would be chosen next.

    Parameters
    ----------
    features : (frames, d) float array
        Of all frames of the takes, in which every region counts alike.
    pair_features : (pairs, d) float array
    candidates : (frames,) bool array
        Frames that could be tuned.
    """
    open_rows = np.flatnonzero(candidates)
    rows = open_rows[sample_frames(len(open_rows), 20 * CURVE_FRAMES)]
    together = np.concatenate([pair_features, features_at(features, rows)])
    known = np.arange(len(pair_features), dtype=np.int64)
    design = design_gp_variance(together, min(count, len(rows)), already=known, noise=KEY_VARIANCE)
    return np.asarray(rows[design.chosen - len(known)])


def measure_growth(
    model: CoverageModel, further_rows: IntArray, displacements: Displacements, count: int
) -> Growth:
    """Measure coverage pair by pair, and with the frames that would be chosen next.

    Parameters
    ----------
    further_rows : (n,) int array
        See `choose_further`.
    count : int
        Frames of the takes; some spread over them are looked at.
    """
    sample = displacements(sample_frames(count, CURVE_FRAMES))
    share = model.growth(displacements(further_rows), sample)
    pairs = len(share) - len(further_rows)
    return Growth(share[:pairs], further_rows, share[pairs:])
