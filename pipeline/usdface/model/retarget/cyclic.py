"""Cyclic evaluation: source to target to source, in millimetres per frame (S11, section 6.3)."""

from dataclasses import dataclass

import numpy as np

from usdface.core.arrays import FloatArray, IntArray, columns_by_name, coordinates_of, frame_blocks
from usdface.core.assets import Rig
from usdface.core.controls import ExpressionPairs
from usdface.core.deformer import Deformer
from usdface.core.progress import Progress, part, silent
from usdface.model.retarget.face_correspondence import correspond, match_positions
from usdface.model.retarget.train import make_examples, retarget, round_trip, train_retargeting

MOST_POINTS = 4000
"""Maximum number of points of the source's surface for errors, evenly spread."""

TRAINING_POINTS = 600
"""The same for the comparison of candidates in training."""

KEYED_HYBRID = "hybrid, keyed"
"""Name of the hybrid whose share of the multiquadric is keyed over time."""

POSITION_MATCHING = "positions"
"""Name of position matching, which is not a regression and needs no training."""

_BLOCK_FRAMES = 256


@dataclass(frozen=True)
class CyclicError:
    """Errors of a method."""

    method: str
    settings: str
    mean_vertex_mm: FloatArray
    """(frames,): mean distance between the source's points before and after the round trip [mm]."""
    returned: FloatArray
    """(frames, shapes of the source's rig): weights after the round trip."""
    direct_mm: FloatArray | None = None
    """(frames,): mean distance of the target's points from their true positions [mm]; None if
    unknown."""


@dataclass(frozen=True)
class CyclicVariant:
    """Options of the comparison."""

    truth: FloatArray | None = None
    """(frames, target shapes): true weights of the target, if known."""
    alpha: FloatArray | None = None
    """(frames,): share of the multiquadric in ``hybrid, keyed`` [0-1]."""
    published: bool = False
    """Whether kernel CCA uses its published lines."""


class SurfaceMetric:
    """Distance between a rig's surfaces under two sets of weights."""

    def __init__(self, rig: Rig) -> None:
        shapes = Deformer(rig).shapes
        columns = _columns(shapes.point_count, MOST_POINTS)
        self._shapes = shapes
        self._offsets = shapes.key_offsets[:, columns].toarray()

    def mean_vertex_mm(self, first: FloatArray, second: FloatArray) -> FloatArray:
        """Return the mean distance over points for each frame [mm]; weights in the rig's order."""
        out = np.empty(len(first))
        for rows in frame_blocks(len(first), frames=_BLOCK_FRAMES):
            difference = self._shapes.key_weights(first[rows]) - self._shapes.key_weights(
                second[rows]
            )
            moved = (difference @ self._offsets).reshape(len(difference), -1, 3)
            out[rows] = np.sqrt(np.einsum("fpc,fpc->fp", moved, moved)).mean(axis=1)
        return out


def sampled_displacements(rig: Rig, names: tuple[str, ...]) -> FloatArray:
    """Return displacements of points spread over a rig at weight 1: (names, points, 3) [mm]."""
    shapes = Deformer(rig).shapes
    columns = _columns(shapes.point_count, TRAINING_POINTS)
    chosen = [rig.shapes.index(name) for name in names]
    moved = shapes.target_offsets()[:, columns].toarray()[chosen]
    return np.asarray(moved).reshape(len(names), -1, 3)


def _columns(point_count: int, most: int) -> IntArray:
    """Return the columns x, y, z of evenly spread points, at most `most` of them."""
    return coordinates_of(np.arange(0, point_count, -(-point_count // most)))


def evaluate_cyclic(
    pairs: ExpressionPairs,
    performance: FloatArray,
    *,
    methods: tuple[str, ...],
    rig: Rig,
    target_rig: Rig,
    shape_ranges: FloatArray | None = None,
    variant: CyclicVariant,
    progress: Progress = silent,
) -> tuple[CyclicError, ...]:
    """Retarget a performance to the target and back by several methods.

    Settings of each method are those with the smallest error on this performance.

    Parameters
    ----------
    performance : (frames, source shapes) float array
        In the order of ``pairs.source_shapes``.
    methods : tuple of str
        Names of methods; ``auto`` for the method that training chooses, ``positions`` for
        non-negative least squares on the two surfaces, ``hybrid, keyed`` for a hybrid with the
        variant's alpha.
    rig, target_rig : Rig
        Of the source, with all of ``pairs.source_shapes``, and of the target.
    shape_ranges : (target shapes, 2) float array, optional
    """
    surface = sampled_displacements(rig, pairs.source_shapes)
    source_meter = SurfaceMetric(rig)
    truth = variant.truth
    target_meter = None if truth is None else SurfaceMetric(target_rig)
    source_weights = columns_by_name(performance, pairs.source_shapes, rig.shapes)
    errors = []
    for number, method in enumerate(methods):
        share = part(progress, number / len(methods), (number + 1) / len(methods))
        share(0.0, method)
        if method == POSITION_MATCHING:
            label, settings = method, ""
            matched = match_positions(correspond(rig, target_rig), source_weights)
            returned = match_positions(correspond(target_rig, rig), matched)
            forward = columns_by_name(matched, target_rig.shapes, pairs.target.shapes)
            back = columns_by_name(returned, rig.shapes, pairs.source_shapes)
        else:
            trained = train_retargeting(
                pairs,
                method="hybrid" if method == KEYED_HYBRID else method,
                shape_ranges=shape_ranges,
                surface=surface,
                performance=performance,
                published=variant.published,
                progress=share,
            )
            label = f"default ({trained.method})" if method == "auto" else method
            settings = trained.scores[0].settings
            examples = make_examples(pairs, shape_ranges=shape_ranges)
            alpha = variant.alpha if method == KEYED_HYBRID else None
            forward = retarget(trained, performance, alpha=alpha).weights
            back = round_trip(examples, trained.method, trained.settings, performance, alpha=alpha)
        returned = columns_by_name(back, pairs.source_shapes, rig.shapes)
        direct = None
        if target_meter is not None and truth is not None:
            direct = target_meter.mean_vertex_mm(
                columns_by_name(forward, pairs.target.shapes, target_rig.shapes),
                columns_by_name(truth, pairs.target.shapes, target_rig.shapes),
            )
        cyclic = source_meter.mean_vertex_mm(returned, source_weights)
        errors.append(CyclicError(label, settings, cyclic, returned, direct))
    return tuple(errors)
