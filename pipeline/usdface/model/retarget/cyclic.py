"""Cyclic evaluation: source to target to source, in millimetres per frame (S11, section 6.3)."""

from dataclasses import dataclass

import numpy as np

from usdface.core.arrays import FloatArray, IntArray, columns_by_name
from usdface.core.assets import Rig
from usdface.core.controls import ExpressionPairs
from usdface.core.deformer import Deformer
from usdface.core.errors import InputError
from usdface.core.progress import Progress, part, silent
from usdface.model.retarget.shape_matching import correspond, match_positions
from usdface.model.retarget.train import (
    make_examples,
    retarget,
    round_trip,
    train_retargeting,
)

MOST_POINTS = 4000
"""Of the source's surface that are measured, spread evenly over its points."""

TRAINING_POINTS = 600
"""Of them when methods are compared in training; there are many candidates."""

KEYED = "hybrid, keyed"
"""Name of the hybrid whose share of the multiquadric is keyed over time."""

POSITIONS = "positions"
"""Name under which matching positions is compared: no regression, and nothing to be trained."""

_BLOCK_FRAMES = 256


@dataclass(frozen=True)
class CyclicError:
    """One method's errors."""

    method: str
    settings: str
    mean_vertex_mm: FloatArray
    """(frames,): mean distance of the source's points from where they were [mm]."""
    returned: FloatArray
    """(frames, shapes of the source's rig): the weights that came back."""
    direct_mm: FloatArray | None = None
    """(frames,): mean distance of the target's points from where they should be [mm], where that is
    known."""


@dataclass(frozen=True)
class CyclicVariant:
    """What of the methods, or of what is measured, is not as usual."""

    truth: FloatArray | None = None
    """(frames, target shapes): what the target should do, where it is known."""
    alpha: FloatArray | None = None
    """(frames,): share of the multiquadric in ``hybrid, keyed`` [0-1]."""
    published: bool = False
    """Whether kernel CCA is as published."""


PLAIN = CyclicVariant()


class SurfaceMeter:
    """Measures the distance between a rig's surfaces under two sets of weights, by frame."""

    def __init__(self, rig: Rig) -> None:
        shapes = Deformer(rig).shapes
        columns = _columns(shapes.point_count, MOST_POINTS)
        self._shapes = shapes
        self._offsets = shapes.key_offsets[:, columns].toarray()

    def mean_vertex_mm(self, first: FloatArray, second: FloatArray) -> FloatArray:
        """Return the mean distance over points for each frame [mm]; weights in the rig's order."""
        out = np.empty(len(first))
        for start in range(0, len(first), _BLOCK_FRAMES):
            rows = slice(start, start + _BLOCK_FRAMES)
            difference = self._shapes.key_weights(first[rows]) - self._shapes.key_weights(
                second[rows]
            )
            moved = (difference @ self._offsets).reshape(len(difference), -1, 3)
            out[rows] = np.sqrt(np.einsum("fpc,fpc->fp", moved, moved)).mean(axis=1)
        return out


def spread_displacements(rig: Rig, names: tuple[str, ...]) -> FloatArray:
    """Return what shapes at 1 do to points spread over a rig: (names, points, 3) float array."""
    shapes = Deformer(rig).shapes
    columns = _columns(shapes.point_count, TRAINING_POINTS)
    chosen = [rig.shapes.index(name) for name in names]
    moved = shapes.target_offsets()[:, columns].toarray()[chosen]
    return np.asarray(moved).reshape(len(names), -1, 3)


def _columns(point_count: int, most: int) -> IntArray:
    """Return the columns x, y, z of every n-th point, so that at most so many are taken."""
    points = np.arange(0, point_count, -(-point_count // most))
    return np.asarray((3 * points[:, None] + np.arange(3)).ravel(), np.int64)


def evaluate_cyclic(
    pairs: ExpressionPairs,
    performance: FloatArray,
    *,
    methods: tuple[str, ...],
    rig: Rig,
    target_rig: Rig | None = None,
    shape_ranges: FloatArray | None = None,
    variant: CyclicVariant = PLAIN,
    progress: Progress = silent,
) -> tuple[CyclicError, ...]:
    """Send a performance to the target and back by several methods.

    Every method gets the settings that serve it best on this performance, so that none loses for
    want of tuning.

    Parameters
    ----------
    performance : (frames, source shapes) float array
        In the order of ``pairs.source_shapes``.
    methods : tuple of str
        Names of methods; ``auto`` for what training would choose, ``positions`` for non-negative
        least squares on the two surfaces, which reads no pairs, ``hybrid, keyed`` for a hybrid with
        the variant's alpha.
    rig : Rig
        The source's, with all of ``pairs.source_shapes``.
    target_rig : Rig, optional
        Needed for ``positions`` and the variant's truth.
    shape_ranges : (target shapes, 2) float array, optional
    """
    surface = spread_displacements(rig, pairs.source_shapes)
    near = SurfaceMeter(rig)
    truth = variant.truth
    far = None if truth is None or target_rig is None else SurfaceMeter(target_rig)
    asked = columns_by_name(performance, pairs.source_shapes, rig.shapes)
    found = []
    for number, method in enumerate(methods):
        share = part(progress, number / len(methods), (number + 1) / len(methods))
        share(0.0, method)
        if method == POSITIONS:
            label, settings = method, ""
            there, back = _by_positions(pairs, performance, rig, target_rig)
        else:
            trained = train_retargeting(
                pairs,
                method="hybrid" if method == KEYED else method,
                shape_ranges=shape_ranges,
                surface=surface,
                performance=performance,
                published=variant.published,
                progress=share,
            )
            label = f"default ({trained.method})" if method == "auto" else method
            settings = trained.scores[0].settings
            examples = make_examples(pairs, shape_ranges=shape_ranges)
            alpha = variant.alpha if method == KEYED else None
            there = retarget(trained, performance, alpha=alpha).weights
            back = round_trip(examples, trained.method, trained.settings, performance, alpha=alpha)
        returned = columns_by_name(back, pairs.source_shapes, rig.shapes)
        direct = None
        if far is not None and truth is not None and target_rig is not None:
            direct = far.mean_vertex_mm(
                columns_by_name(there, pairs.target.shapes, target_rig.shapes),
                columns_by_name(truth, pairs.target.shapes, target_rig.shapes),
            )
        found.append(
            CyclicError(label, settings, near.mean_vertex_mm(returned, asked), returned, direct)
        )
    return tuple(found)


def _by_positions(
    pairs: ExpressionPairs, performance: FloatArray, rig: Rig, target_rig: Rig | None
) -> tuple[FloatArray, FloatArray]:
    """Match positions both ways: weights of the target's shapes, and of the source's."""
    if target_rig is None:
        raise InputError("matching positions needs the target's rig; put it back")
    asked = columns_by_name(performance, pairs.source_shapes, rig.shapes)
    there = match_positions(correspond(rig, target_rig), asked)
    back = match_positions(correspond(target_rig, rig), there)
    return (
        columns_by_name(there, target_rig.shapes, pairs.target.shapes),
        columns_by_name(back, rig.shapes, pairs.source_shapes),
    )
