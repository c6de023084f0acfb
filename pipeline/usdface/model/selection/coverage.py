"""Coverage of takes by references, and conflicts between pairs.

Two pairs conflict if their markers are similar and their weights differ: a mapping averages them.
Most conflicts are mistakes: a pair tuned on another frame, or a slider not reset after the pair
before.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from usdface.core.arrays import (
    BoolArray,
    FloatArray,
    IntArray,
    frame_blocks,
    relative_distances,
    sample_frames,
)
from usdface.core.assets import References
from usdface.model.mapping.coverage import LEAST_COVERAGE, CoverageModel
from usdface.model.mapping.motion_space import marker_coordinates, motion_of_pairs
from usdface.model.selection.design import Features, features_at, selection_space
from usdface.numerics.measure.face_regions import shapes_by_region
from usdface.numerics.regression.linear_ridge import fit_linear_ridge
from usdface.numerics.regression.reference_design import KEY_VARIANCE, design_gp_variance

_FEWEST_PAIRS = 6
"""Fewest pairs from which the usual distances of weights and markers are estimated."""

_NEAR_MARKERS_SHARE = 0.2
"""Share of the usual distance between pairs below which markers of a region are similar."""

LEAST_STEP = 0.35
"""Difference of a weight below which no conflict is reported: two animators differ by as much."""

FAR_WEIGHTS_SHARE = 0.6
"""Share of the usual distance between pairs above which weights of a region differ."""


@dataclass(frozen=True)
class ReferenceConflict:
    """Two pairs that contradict each other."""

    first: int
    second: int
    """`first`, `second`: Indices of the pairs."""
    region: str
    """Region of the face; empty for the whole face."""
    shape: str
    """The shape that differs most."""
    weights: tuple[float, float]
    """Its weights in the first and the second pair."""
    times: float
    """Ratio of the distances of weights and of markers, each relative to the usual one."""


def find_reference_conflicts(references: References) -> list[ReferenceConflict]:
    """Return pairs whose weights differ far more than their markers, in descending order.

    Regions are compared separately. Distances are relative to the median between pairs. Weights
    of a shape that exceed 1 are relative to its largest one.
    """
    pairs, shapes = references.weights.shape
    if pairs < _FEWEST_PAIRS:
        return []
    motion = references.motion or motion_of_pairs(references)
    coordinates = marker_coordinates(motion, references.markers)
    weights = references.weights / np.maximum(np.abs(references.weights).max(axis=0), 1.0)
    line = fit_linear_ridge(coordinates, weights)
    sample = (motion.sample - line.mean) @ line.coefficients + line.intercept
    shown = np.clip(sample, np.minimum(weights.min(axis=0), 0), 1)
    space = selection_space(motion, shown, references.shape_names)
    features = space.features(coordinates)
    by_region = shapes_by_region(references.shape_names)
    worst: dict[tuple[int, int], ReferenceConflict] = {}
    for region, (a, b) in zip(space.regions, space.columns, strict=True):
        columns = by_region.get(region, np.arange(shapes))
        near = relative_distances(features[:, a:b])
        far = relative_distances(weights[:, columns])
        conflicting = (near < _NEAR_MARKERS_SHARE) & (far > FAR_WEIGHTS_SHARE)
        for i, j in np.argwhere(np.triu(conflicting, 1)).tolist():
            difference = np.abs(weights[i, columns] - weights[j, columns])
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
    """Return a sentence that names the pairs, the shape and its weights."""
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


_BLOCK_FRAMES = 4096

COVERED_FRAMES = 24_000
"""Most frames measured; of longer takes every second, third, ... frame is."""

CURVE_FRAMES = 1500
"""Evenly spaced frames of the takes on which coverage is averaged."""


@dataclass(frozen=True)
class Coverage:
    """Coverage of every frame by pairs; see `model.mapping.coverage`."""

    face: FloatArray
    """(frames,): of the whole face [0-1]."""
    regions: tuple[str, ...]
    by_region: FloatArray
    """(frames, regions): the same, of each region alone."""

    @property
    def mean(self) -> float:
        """Mean over all frames, of the whole face [0-1]."""
        return float(self.face.mean())

    @property
    def sufficient_share(self) -> float:
        """Share of the frames with `LEAST_COVERAGE` or more [0-1]."""
        return float((self.face >= LEAST_COVERAGE).mean())


@dataclass(frozen=True)
class Growth:
    """Coverage as a function of the number of pairs, present and further ones."""

    share: FloatArray
    """(pairs + 1,): coverage by the first 0, 1, 2, ... pairs [0-1]."""
    next_rows: IntArray
    """(count,): frames to choose next, in greedy order."""
    next_share: FloatArray
    """(count,): coverage with the first 1, 2, ... of them as well [0-1]."""


Displacements = Callable[[IntArray], FloatArray]
"""Markers' displacements from the neutral at rows of all takes: (rows, markers, 3) [mm]."""


def measure_coverage(
    model: CoverageModel, regions: tuple[str, ...], displacements: Displacements, count: int
) -> Coverage:
    """Measure the coverage of each of `count` frames.

    `regions`: of the model; the first is the whole face.
    """
    step = -(-count // COVERED_FRAMES)  # neighbours of a long recording are one face
    rows = np.arange(0, count, step, dtype=np.int64)
    blocks = frame_blocks(len(rows), frames=_BLOCK_FRAMES)
    found = np.concatenate([model.measure(displacements(rows[block])) for block in blocks])
    every = np.repeat(found, step, axis=0)[:count]
    return Coverage(every[:, 0], regions[1:], every[:, 1:])


def choose_next_frames(
    features: Features, pair_features: FloatArray, *, count: int, candidates: BoolArray
) -> IntArray:
    """Return the rows of the frames to choose next.

    Parameters
    ----------
    features : (frames, d) float array
        Of all frames of the takes, in the space of `selection_space`.
    pair_features : (pairs, d) float array
    candidates : (frames,) bool array
        Frames that may be tuned.
    """
    open_rows = np.flatnonzero(candidates)
    rows = open_rows[sample_frames(len(open_rows), 20 * CURVE_FRAMES)]
    together = np.concatenate([pair_features, features_at(features, rows)])
    known = np.arange(len(pair_features), dtype=np.int64)
    design = design_gp_variance(together, min(count, len(rows)), already=known, noise=KEY_VARIANCE)
    return np.asarray(rows[design.chosen - len(known)])


def measure_growth(
    model: CoverageModel, next_rows: IntArray, displacements: Displacements, count: int
) -> Growth:
    """Measure coverage as pairs, then the frames to choose next, are added one by one.

    Parameters
    ----------
    next_rows : (n,) int array
        See `choose_next_frames`.
    count : int
        Frames of the takes, of which evenly spaced ones are used.
    """
    sample = displacements(sample_frames(count, CURVE_FRAMES))
    share = model.growth(displacements(next_rows), sample)
    pairs = len(share) - len(next_rows)
    return Growth(share[:pairs], next_rows, share[pairs:])
