"""Which frames an animator should tune: designs compared by what they would teach.

Faces are compared in a space where every region counts alike. Over all markers the jaw, which moves
centimetres, drowns the lids, which move millimetres; a selection that looks at the whole face
leaves blinks to chance. Here each part of the face is seen through the markers that its shapes
move, and brought to the size of the others. The parts stand side by side, so that a combination, a
blink under a lowered brow, is a place of its own.

The paper's own selection is a frame for each viseme and emotion, and the extremes of each emotion.
Deng et al. (2006), section 4: the middle frame of one segment for every viseme and expression,
picked by hand there and by typicality here, and ten extreme poses an expression.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np

from usdface.core.arrays import BoolArray, Float32Array, FloatArray, IntArray
from usdface.core.assets import MotionSpace
from usdface.numerics.measure.face_regions import shapes_by_region
from usdface.numerics.regression.design_kernel import KEY_VARIANCE, DesignKernel, predict_from
from usdface.numerics.regression.reference_design import (
    Design,
    design_d_optimal,
    design_gp_variance,
    design_k_centre,
    whiten,
)
from usdface.numerics.regression.regional_process import marker_relevance, regional_features

Features = Float32Array | FloatArray
"""Of an hour they are kept in single precision; what is reckoned with is double."""

REGION_DIMENSIONS = 10
"""Principal axes of each region: beyond these a region differs by noise."""

WHITENING_POWER = 0.5
"""0 leaves axes as they are, which see only the largest motion; 1 makes all equal, noise too."""

WHOLE_FACE = "face"


@dataclass(frozen=True)
class SelectionSpace:
    """Features of frames from coordinates in the motion space."""

    projection: FloatArray
    """(dimensions, features)"""
    offset: FloatArray
    """(features,): so that the mean face lies at 0."""
    regions: tuple[str, ...]
    columns: tuple[tuple[int, int], ...]
    """Columns of the features of each region, first and one past the last."""

    def features(self, coordinates: FloatArray) -> FloatArray:
        """Return features of frames: (frames, dimensions) to (frames, features)."""
        return np.asarray(coordinates @ self.projection - self.offset)


def features_at(features: Features, rows: IntArray) -> FloatArray:
    """Return features of some frames, to reckon with."""
    return np.asarray(features[rows], dtype=np.float64)


def selection_space(
    motion: MotionSpace, weights: FloatArray, shape_names: tuple[str, ...]
) -> SelectionSpace:
    """Learn what each region is from weights of the motion space's sample.

    Parameters
    ----------
    weights : (sample frames, shapes) float array
        Of `motion.sample`, from the rig's geometry or any mapping: they need only tell which
        markers move with which shapes.
    shape_names : tuple of str
        Names tell the regions; where they do not, the whole face is one.
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
    """One phone as it was spoken."""

    row: int
    """Its middle frame."""
    frames: int
    """How long it lasts."""
    viseme: str
    emotion: str


def viseme_frames(
    features: Features, segments: Sequence[Segment], *, candidates: BoolArray
) -> dict[tuple[str, str], int]:
    """Return the frame of the most typical segment for each emotion and viseme that is spoken.

    Typical is a segment at least as long as most, whose middle frame is nearest the median of all
    middle frames of its kind: the one a person would pick, for short ones are slurred into their
    neighbours. No frame serves twice.

    Parameters
    ----------
    features : (frames, d) float array
    candidates : (frames,) bool array
        Frames that may be chosen.

    Returns
    -------
    dict of (emotion, viseme) to int
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
    """Return frames of each emotion far from its ordinary faces, and from one another.

    Parameters
    ----------
    features : (frames, d) float array
    emotion_of : sequence of str
        Of each frame.
    count : int
        Frames an emotion; fewer, or none, where the emotion has no more that may be chosen.
    candidates : (frames,) bool array
    already : (n,) int array
        Frames chosen before, which are not chosen again.
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

POOL_FRAMES = 24_000
"""Frames that are looked at: of a longer recording the most extreme of each short stretch."""


@dataclass(frozen=True)
class CandidateMarkers:
    """Weights that stand in for tuning while frames are chosen, from the rig's geometry."""

    features: FloatArray
    """(sample, d): of frames spread over the takes."""
    weights: FloatArray
    """(sample, shapes)"""
    of_rows: Callable[[IntArray], FloatArray]
    """Weights of any frames, by their rows."""
    gram: FloatArray
    """(shapes, shapes): makes errors millimetres on the rig."""


@dataclass(frozen=True)
class ReferenceChoice:
    """Frames to tune, the most telling first."""

    rows: IntArray
    """(count,): none twice, none that was tuned before."""
    design: str = ""
    """Which design was taken; empty where none was needed."""
    measured_mm: dict[str, float] = field(default_factory=dict)
    """Error of the stand-ins on all other frames, by design."""
    visemes: dict[int, str] = field(default_factory=dict)
    """Viseme of the frames that were chosen for one."""
    extremes: tuple[int, ...] = ()
    """Rows that were chosen as extremes of an emotion."""
    missing: tuple[tuple[str, str], ...] = ()
    """Emotion and viseme that are not spoken together."""


def pool_of(features: Features, candidates: BoolArray, *, limit: int = POOL_FRAMES) -> IntArray:
    """Return rows to choose among: of every short stretch the face farthest from the mean face.

    Neighbouring frames of a recording are nearly the same face; the peaks are what teaches.
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
    stand_ins: CandidateMarkers,
) -> ReferenceChoice:
    """Choose frames by each design and take the one whose frames teach the stand-ins best.

    Parameters
    ----------
    features : (frames, d) float array
    already : (n,) int array
        Rows that are tuned.
    candidates : (frames,) bool array
    """
    pool = pool_of(features, candidates)
    rows = np.concatenate([already, pool[~np.isin(pool, already)]])
    if len(rows) - len(already) < count:
        rows = np.concatenate([already, np.setdiff1d(np.flatnonzero(candidates), already)])
    known = np.arange(len(already), dtype=np.int64)
    chosen: dict[str, IntArray] = {}
    for name, design in DESIGNS.items():
        chosen[name] = rows[design(features_at(features, rows), count, already=known).chosen]
    known_rows = np.unique(np.concatenate([already, *chosen.values()]))
    weights = stand_ins.of_rows(known_rows)
    measured = {
        name: stand_in_error_mm(
            features_at(features, known_rows[taught]), weights[taught], stand_ins
        )
        for name, picks in chosen.items()
        for taught in [np.isin(known_rows, [*already, *picks])]
    }
    best = min(measured, key=lambda name: measured[name])
    return ReferenceChoice(in_order_of_worth(features, chosen[best], already), best, measured)


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
    """Choose as the paper does; of more frames than asked for, the most telling.

    Parameters
    ----------
    visemes : sequence of str
        Every viseme that is wanted in each emotion, whether somebody speaks it or not.
    extremes : int
        Extreme frames of each emotion.

    Returns
    -------
    Choice
        With fewer frames than asked for where fewer visemes are spoken.
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
    ordered = in_order_of_worth(features, rows, already)[:count]
    viseme_at = {row: viseme for (_, viseme), row in found.items()}
    emotions = list(dict.fromkeys(emotion_of))
    missing = tuple((e, v) for e in emotions for v in visemes if (e, v) not in found)
    return ReferenceChoice(
        ordered,
        visemes={int(r): viseme_at[int(r)] for r in ordered if int(r) in viseme_at},
        extremes=tuple(int(r) for r in ordered if int(r) not in viseme_at),
        missing=missing,
    )


def stand_in_error_mm(
    features: FloatArray, weights: FloatArray, stand_ins: CandidateMarkers
) -> float:
    """Return the error of stand-in weights predicted from those of some frames, over all [mm].

    Parameters
    ----------
    features, weights : (n, d) and (n, shapes) float arrays
    """
    kernel = DesignKernel.for_rows(stand_ins.features)
    predicted = predict_from(kernel, features, weights, stand_ins.features, noise=KEY_VARIANCE)
    error = predicted - stand_ins.weights
    squared = ((error @ stand_ins.gram) * error).sum(axis=1)
    return float(np.sqrt(np.maximum(squared, 0.0).mean()))


def in_order_of_worth(features: Features, rows: IntArray, already: IntArray) -> IntArray:
    """Return rows in the order in which each adds most to those before it."""
    if not len(rows):
        return rows
    together = np.concatenate([already, rows])
    known = np.arange(len(already), dtype=np.int64)
    order = design_gp_variance(features_at(features, together), len(rows), already=known).chosen
    return together[order]
