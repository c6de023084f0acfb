"""Pairs that contradict each other: alike markers, unlike weights.

No mapping can follow both; it will meet them half-way and be wrong twice. Most are slips: a pair
tuned by another frame, a slider left behind from the pair before.
"""

from dataclasses import dataclass

import numpy as np

from usdface.core.arrays import FloatArray
from usdface.core.assets import References
from usdface.model.mapping.motion_space import motion_from_pca
from usdface.model.selection.design import selection_space
from usdface.numerics.measure.face_regions import shapes_by_region
from usdface.numerics.regression.linear_ridge import fit_linear_ridge
from usdface.numerics.regression.pca import fit_pca

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


def find_reference_conflicts(
    references: References, *, gram: FloatArray | None = None
) -> list[ReferenceConflict]:
    """Find pairs whose weights differ far more than their markers do, the worst first.

    Each part of the face is compared by itself, so that a lid is not excused by a jaw. Alike and
    unlike are measured against the usual distance between pairs.

    Parameters
    ----------
    gram : (shapes, shapes) float array, optional
        Makes differences of weights count as they show on the rig [mm^2].
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
    metric = np.eye(shapes) if gram is None else gram
    by_region = shapes_by_region(references.shape_names)
    worst: dict[tuple[int, int], ReferenceConflict] = {}
    for region, (a, b) in zip(space.regions, space.columns, strict=True):
        columns = by_region.get(region, np.arange(shapes))
        near = _distances(features[:, a:b], np.eye(b - a))
        far = _distances(references.weights[:, columns], metric[np.ix_(columns, columns)])
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


def _distances(rows: FloatArray, metric: FloatArray) -> FloatArray:
    """Return distances between all rows under a metric, over the usual one.

    The usual one is the median between rows that differ: few pairs may use a region at all.
    """
    product = rows @ metric @ rows.T
    squares = np.diag(product)
    away = np.sqrt(np.maximum(squares[:, None] + squares - 2 * product, 0.0))
    between = away[np.triu_indices(len(rows), 1)]
    positive = between[between > _ROUNDING_SHARE * away.max()]
    return np.asarray(away / (np.median(positive) if len(positive) else 1.0))
