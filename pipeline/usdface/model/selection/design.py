"""Selection of frames to tune, by the experimental design with the smallest error.

Frames are compared in a feature space in which every region of the face has equal variance: over
all markers the jaw, which moves centimetres, would outweigh the lids, which move millimetres. Each
region is represented by the markers that its shapes move. Features of all regions are concatenated,
so that combinations, such as a blink with a lowered brow, are distinct points.

The paper's selection is a frame for each viseme and emotion, and the extremes of each emotion.
Deng et al. (2006), section 4: the middle frame of one segment for every viseme and expression,
picked by hand there and by typicality here, and ten extreme poses an expression.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np

from usdface.core.arrays import BoolArray, Float32Array, FloatArray, IntArray
from usdface.core.assets import MotionSpace
from usdface.numerics.measure.face_regions import shapes_by_region
from usdface.numerics.regression.cross_validation import surface_rms_mm
from usdface.numerics.regression.reference_design import (
    Design,
    DesignKernel,
    design_d_optimal,
    design_gp_variance,
    design_k_centre,
    predict_from,
    whiten,
)
from usdface.numerics.regression.regional_process import marker_relevance, regional_features

Features = Float32Array | FloatArray
"""Stored in single precision for long takes; computed with in double."""

REGION_DIMENSIONS = 10
"""Principal axes of each region; further ones are noise."""

WHITENING_POWER = 0.5
"""0 leaves variances unchanged, so that the largest motion dominates; 1 makes all equal, including
noise."""

WHOLE_FACE = "face"


@dataclass(frozen=True)
class SelectionSpace:
    """Features of frames from coordinates in the motion space."""

    projection: FloatArray
    """(dimensions, features)"""
    offset: FloatArray
    """(features,): features of the mean face, subtracted."""
    regions: tuple[str, ...]
    columns: tuple[tuple[int, int], ...]
    """Columns of the features of each region, first and one past the last."""

    def features(self, coordinates: FloatArray) -> FloatArray:
        """Return features of frames: (frames, dimensions) to (frames, features)."""
        return np.asarray(coordinates @ self.projection - self.offset)


def features_at(features: Features, rows: IntArray) -> FloatArray:
    """Return features of some frames in double precision."""
    return np.asarray(features[rows], dtype=np.float64)


def selection_space(
    motion: MotionSpace, weights: FloatArray, shape_names: tuple[str, ...]
) -> SelectionSpace:
    """Return the feature space, its regions learnt from weights of the motion space's sample.

    Parameters
    ----------
    weights : (sample frames, shapes) float array
        Of `motion.sample`, from the rig's geometry or any mapping: they only relate markers to
        shapes.
    shape_names : tuple of str
        Names from which regions are read; otherwise the whole face is one.
    """
    mean = motion.sample.mean(axis=0)
    covariance = np.cov(motion.sample.T) if len(motion.sample) > 1 else np.diag(motion.variances)
    covariance = np.atleast_2d(covariance)
    markers = motion.components.shape[1] // 3
    found = shapes_by_region(shape_names)
    moving = np.ptp(weights, axis=0) > 0
    found = {region: columns[moving[columns]] for region, columns in found.items()}
    regions = tuple(region for region, columns in found.items() if len(columns))
    if len(regions) < 2:
        regions, relevance = (WHOLE_FACE,), np.ones((1, markers))
    else:
        each = marker_relevance(motion.sample, weights, motion.components)
        relevance = np.stack([each[found[region]].max(axis=0) for region in regions])
    kept = min(REGION_DIMENSIONS if len(regions) > 1 else 32, len(motion.variances))
    parts = []
    for row in relevance:
        axes = regional_features(motion.components, covariance, row)
        scaled = whiten(axes.projection[:, :kept], axes.variances[:kept], power=WHITENING_POWER)
        size = np.sqrt(np.mean(np.sum(((motion.sample - mean) @ scaled) ** 2, axis=1)))
        parts.append(scaled / max(float(size), 1e-300))
    projection = np.concatenate(parts, axis=1)
    columns = tuple((start, start + kept) for start in range(0, kept * len(regions), kept))
    return SelectionSpace(projection, mean @ projection, regions, columns)


@dataclass(frozen=True)
class Segment:
    """One spoken phone."""

    row: int
    """Its middle frame."""
    frames: int
    """Its duration."""
    viseme: str
    emotion: str


def viseme_frames(
    features: Features, segments: Sequence[Segment], *, candidates: BoolArray
) -> dict[tuple[str, str], int]:
    """Return the frame of the most typical segment for each emotion and spoken viseme.

    That is the segment of at least median length whose middle frame is nearest to the median of all
    of its kind; short ones are coarticulated with their neighbours. Frames are distinct. Returns
    the frame of each (emotion, viseme).

    Parameters
    ----------
    features : (frames, d) float array
    candidates : (frames,) bool array
        Frames that may be chosen.
    """
    kinds: dict[tuple[str, str], list[Segment]] = {}
    for segment in segments:
        if candidates[segment.row]:
            kinds.setdefault((segment.emotion, segment.viseme), []).append(segment)
    found: dict[tuple[str, str], int] = {}
    for kind, spoken in kinds.items():
        rows = np.array([segment.row for segment in spoken])
        lengths = np.array([segment.frames for segment in spoken])
        away = np.linalg.norm(features[rows] - np.median(features[rows], axis=0), axis=1)
        away[lengths < np.median(lengths)] += away.max() + 1.0
        taken = set(found.values())
        order = [int(rows[i]) for i in np.argsort(away, kind="stable")]
        free = [row for row in order if row not in taken]
        if free:
            found[kind] = free[0]
    return found


def extreme_frames(
    features: Features,
    emotion_of: Sequence[str],
    count: int,
    *,
    candidates: BoolArray,
    already: IntArray,
) -> dict[str, list[int]]:
    """Return frames of each emotion far from its chosen ones and from each other.

    Parameters
    ----------
    features : (frames, d) float array
    emotion_of : sequence of str
        Of each frame.
    count : int
        Frames of each emotion; fewer if it has fewer candidates.
    candidates : (frames,) bool array
    already : (n,) int array
        Frames chosen before.
    """
    emotions = np.array(emotion_of, dtype=object)
    taken = np.zeros(len(features), dtype=bool)
    taken[already] = True
    found: dict[str, list[int]] = {}
    for emotion in dict.fromkeys(emotions.tolist()):
        free = np.flatnonzero((emotions == emotion) & candidates & ~taken)
        before = np.flatnonzero((emotions == emotion) & taken)
        pool = np.concatenate([before, free])
        wanted = min(count, len(free))
        found[emotion] = []
        if wanted > 0:
            known = np.arange(len(before), dtype=np.int64)
            chosen = design_k_centre(features_at(features, pool), wanted, already=known).chosen
            found[emotion] = [int(row) for row in pool[chosen]]
    return found


DESIGNS: dict[str, Callable[..., Design]] = {
    "largest variance": design_gp_variance,
    "k-centre": design_k_centre,
    "D-optimal": design_d_optimal,
}

MAX_CANDIDATES = 24_000
"""Most candidates; of longer recordings the most extreme frame of each interval."""


@dataclass(frozen=True)
class WeightProposals:
    """Weights from the rig's geometry, which replace tuned ones while frames are chosen."""

    features: FloatArray
    """(sample, d): of evenly spaced frames of the takes."""
    weights: FloatArray
    """(sample, shapes)"""
    of_rows: Callable[[IntArray], FloatArray]
    """Weights of any frames, by their rows."""
    gram: FloatArray
    """(shapes, shapes): makes errors millimetres on the rig."""


@dataclass(frozen=True)
class ReferenceChoice:
    """Frames to tune, the most informative first."""

    rows: IntArray
    """(count,): distinct, not tuned before."""
    design: str = ""
    """Name of the design; empty without one."""
    measured_mm: dict[str, float] = field(default_factory=dict)
    """Error of the proposals on all other frames, by design [mm]."""
    visemes: dict[int, str] = field(default_factory=dict)
    """Viseme of each frame chosen for one."""
    extremes: tuple[int, ...] = ()
    """Rows chosen as extremes of an emotion."""
    missing: tuple[tuple[str, str], ...] = ()
    """Pairs of emotion and viseme that do not occur."""


def limit_candidates(
    features: Features, candidates: BoolArray, *, limit: int = MAX_CANDIDATES
) -> IntArray:
    """Return candidate rows: of each interval the frame farthest from the mean face.

    Neighbouring frames are nearly equal; peaks are the most informative.
    """
    rows = np.flatnonzero(candidates)
    if len(rows) <= limit:
        return rows
    size = np.einsum("ij,ij->i", features, features)[rows]
    starts = np.linspace(0, len(rows), limit, endpoint=False).astype(np.int64)
    order = np.lexsort((-size, np.searchsorted(starts, np.arange(len(rows)), side="right")))
    stretch = np.searchsorted(starts, order, side="right")
    return np.sort(rows[order[np.flatnonzero(np.diff(stretch, prepend=0))]])


def choose_by_design(
    features: Features,
    count: int,
    *,
    already: IntArray,
    candidates: BoolArray,
    proposals: WeightProposals,
) -> ReferenceChoice:
    """Choose frames by each design and return those with the smallest error of the proposals.

    Parameters
    ----------
    features : (frames, d) float array
    already : (n,) int array
        Tuned rows.
    candidates : (frames,) bool array
    """
    pool = limit_candidates(features, candidates)
    rows = np.concatenate([already, pool[~np.isin(pool, already)]])
    if len(rows) - len(already) < count:
        rows = np.concatenate([already, np.setdiff1d(np.flatnonzero(candidates), already)])
    known = np.arange(len(already), dtype=np.int64)
    chosen: dict[str, IntArray] = {}
    for name, design in DESIGNS.items():
        chosen[name] = rows[design(features_at(features, rows), count, already=known).chosen]
    known_rows = np.unique(np.concatenate([already, *chosen.values()]))
    weights = proposals.of_rows(known_rows)
    measured = {
        name: proposal_error_mm(
            features_at(features, known_rows[taught]), weights[taught], proposals
        )
        for name, picks in chosen.items()
        for taught in [np.isin(known_rows, [*already, *picks])]
    }
    best = min(measured, key=lambda name: measured[name])
    return ReferenceChoice(rank_by_information(features, chosen[best], already), best, measured)


def choose_visemes(
    features: Features,
    count: int,
    *,
    segments: Sequence[Segment],
    emotion_of: Sequence[str],
    visemes: Sequence[str],
    extremes: int,
    already: IntArray,
    candidates: BoolArray,
) -> ReferenceChoice:
    """Choose as the paper does, and of these the `count` most informative frames.

    Returns fewer than `count` frames if fewer visemes are spoken.

    Parameters
    ----------
    visemes : sequence of str
        Visemes wanted in each emotion, spoken or not.
    extremes : int
        Extreme frames of each emotion.
    """
    free = candidates.copy()
    free[already] = False
    found = viseme_frames(features, segments, candidates=free)
    spoken = np.array(sorted(set(found.values())), dtype=np.int64)
    far = extreme_frames(
        features,
        emotion_of,
        extremes,
        candidates=free,
        already=np.union1d(already, spoken).astype(np.int64),
    )
    rows = np.array([*spoken, *(row for each in far.values() for row in each)], dtype=np.int64)
    ordered = rank_by_information(features, rows, already)[:count]
    viseme_at = {row: viseme for (_, viseme), row in found.items()}
    emotions = list(dict.fromkeys(emotion_of))
    missing = tuple((e, v) for e in emotions for v in visemes if (e, v) not in found)
    return ReferenceChoice(
        ordered,
        visemes={int(r): viseme_at[int(r)] for r in ordered if int(r) in viseme_at},
        extremes=tuple(int(r) for r in ordered if int(r) not in viseme_at),
        missing=missing,
    )


def proposal_error_mm(
    features: FloatArray, weights: FloatArray, proposals: WeightProposals
) -> float:
    """Return the RMS error of proposals predicted from some frames [mm]."""
    kernel = DesignKernel.for_rows(proposals.features)
    predicted = predict_from(kernel, features, weights, proposals.features)
    return surface_rms_mm(predicted - proposals.weights, proposals.gram)


def rank_by_information(features: Features, rows: IntArray, already: IntArray) -> IntArray:
    """Return rows in greedy order of information added to those before."""
    if not len(rows):
        return rows
    together = np.concatenate([already, rows])
    known = np.arange(len(already), dtype=np.int64)
    order = design_gp_variance(features_at(features, together), len(rows), already=known).chosen
    return together[order]
