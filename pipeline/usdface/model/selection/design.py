"""Which frames an animator should tune: designs compared by what they would teach."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np

from usdface.core.arrays import BoolArray, FloatArray, IntArray
from usdface.model.selection.features import Features, features_at
from usdface.model.selection.visemes import Segment, extreme_frames, viseme_frames
from usdface.numerics.regression.design_kernel import KEY_VARIANCE, DesignKernel, predict_from
from usdface.numerics.regression.reference_design import (
    Design,
    design_d_optimal,
    design_gp_variance,
    design_k_centre,
    design_total_variance,
)

DESIGNS: dict[str, Callable[..., Design]] = {
    "largest variance": design_gp_variance,
    "k-centre": design_k_centre,
    "D-optimal": design_d_optimal,
}

POOL_FRAMES = 24_000
"""Frames that are looked at: of a longer recording the most extreme of each short stretch."""

NEXT_FRAMES = 2500
"""Frames among which the next ones to tune are found: memory is quadratic in them."""


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
    missing: tuple[tuple[str, str], ...] = ()
    """Emotion and viseme that nobody speaks."""


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
    measured = {
        name: stand_in_error_mm(features, np.concatenate([already, picks]), stand_ins)
        for name, picks in chosen.items()
    }
    best = min(measured, key=lambda name: measured[name])
    return ReferenceChoice(in_order_of_worth(features, chosen[best], already), best, measured)


def choose_visemes(
    features: Features,
    count: int,
    *,
    segments: Sequence[Segment],
    emotion_of: Sequence[str],
    extremes: int,
    already: IntArray,
    candidates: BoolArray,
) -> ReferenceChoice:
    """Choose as the paper does; of more frames than asked for, the most telling.

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
    visemes = {row: viseme for (_, viseme), row in found.items()}
    emotions = list(dict.fromkeys(emotion_of))
    everything = sorted({segment.viseme for segment in segments})
    missing = tuple((e, v) for e in emotions for v in everything if (e, v) not in found)
    return ReferenceChoice(
        ordered,
        visemes={int(r): visemes[int(r)] for r in ordered if int(r) in visemes},
        missing=missing,
    )


def choose_next(
    features: Features,
    count: int,
    *,
    already: IntArray,
    candidates: BoolArray,
    expected_error: Callable[[IntArray], FloatArray],
) -> ReferenceChoice:
    """Choose the frames whose tuning would help most, where the mapping errs and faces are many.

    Parameters
    ----------
    features, count, already, candidates
        As for `choose_by_design`.
    expected_error : callable
        Of some rows, how far the mapping is from being right there [mm].
    """
    free = candidates.copy()
    free[already] = False
    rows = pool_of(features, free, limit=max(NEXT_FRAMES, count))
    rows_features = features_at(features, rows)
    kernel = DesignKernel.for_rows(rows_features)
    squared = expected_error(rows) ** 2
    importance = squared / max(float(squared.mean()), 1e-300)
    design = design_total_variance(
        rows_features,
        count,
        kernel=kernel,
        known=features_at(features, already),
        importance=importance,
    )
    return ReferenceChoice(rows[design.chosen])


def stand_in_error_mm(features: Features, rows: IntArray, stand_ins: CandidateMarkers) -> float:
    """Return the error of stand-in weights predicted from some frames, over all [mm]."""
    kernel = DesignKernel.for_rows(stand_ins.features)
    predicted = predict_from(
        kernel,
        features_at(features, rows),
        stand_ins.of_rows(rows),
        stand_ins.features,
        noise=KEY_VARIANCE,
    )
    error = predicted - stand_ins.weights
    squared = np.einsum("fs,st,ft->f", error, stand_ins.gram, error)
    return float(np.sqrt(np.maximum(squared, 0.0).mean()))


def in_order_of_worth(features: Features, rows: IntArray, already: IntArray) -> IntArray:
    """Return rows in the order in which each adds most to those before it."""
    if not len(rows):
        return rows
    together = np.concatenate([already, rows])
    known = np.arange(len(already), dtype=np.int64)
    order = design_gp_variance(features_at(features, together), len(rows), already=known).chosen
    return together[order]
