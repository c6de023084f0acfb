"""Interface of the regressions: candidate settings, a fit, and a prediction from its arrays.

A mapping predicts weights from coordinates of markers, a retargeting a control vector from the
source's weights. Some regressions are trained on bent weights (`bend`), as the displacement of
skin saturates with the weight.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from usdface.core.arrays import Arrays, FloatArray, IntArray
from usdface.core.assets import MotionSpace
from usdface.core.rig_logic import RigLogic
from usdface.model.regressions.bent_weights import bend
from usdface.model.regressions.forward_model import ForwardModel
from usdface.model.regressions.shape_sides import ShapeSides

Settings = dict[str, float | int | str | bool]

Predictor = Callable[[FloatArray], FloatArray]
"""Function from inputs (frames, d) to outputs (frames, k)."""

ProcessPredictor = Callable[[FloatArray], tuple[FloatArray, FloatArray]]
"""Function from displacements of the markers (frames, 3 markers) [mm] to bent weights and their
standard deviation, (frames, shapes) each."""

PriorPredictor = Callable[[FloatArray, FloatArray], tuple[FloatArray, FloatArray | None]]
"""Function from coordinates (frames, d) and displacements (frames, markers, 3) [mm] to the prior
mean of `frame_solve` and its standard deviation, None if the method has none; (frames, shapes)."""

WHITENING_POWERS = (0.0, 0.125, 0.25)
"""Candidates: coordinates are divided by this power of their variance. 0 leaves them as captured;
.5, full whitening, would amplify noise to the size of the jaw's motion."""

_MIN_VARIANCE_SHARE = 1e-6
"""Smallest variance in the divisor, relative to the largest."""


@dataclass(frozen=True)
class RestPlaces:
    """Positions on the rig's neutral face."""

    points: FloatArray
    """(points, 3): the points of `Face.skin` [mm]."""
    markers: FloatArray | None = None
    """(markers, 3): NaN where unknown [mm]."""
    motion_scale: float | None = None
    """The rig's motion over the performer's, by the placement."""


@dataclass(frozen=True)
class DrivenSkin:
    """Combination shapes of the rig, whose weights follow from those of the pairs' shapes."""

    logic: RigLogic
    """Its first shapes are those of the references."""
    skin: FloatArray
    """(combinations, points, 3): displacement of the points of `Face.skin` by each at 1 [mm]."""


@dataclass(frozen=True)
class Face:
    """Data of a mapping's face other than its pairs: rig, motion space and neutral."""

    sides: ShapeSides
    """Columns of the pairs' outputs, which are called shapes here."""
    gram: FloatArray
    """(shapes, shapes): mean over the rig's points of the dot products of the shapes' displacements
    [mm^2]; the identity without a rig."""
    motion: MotionSpace
    """Principal components of the takes, with the coordinates of a sample of frames."""
    skin: FloatArray | None = None
    """(shapes, points, 3): displacement by each shape at 1 of points spread over the rig's surface
    [mm]."""
    rest: RestPlaces | None = None
    """Positions of those points, and of the markers, on the rig's neutral."""
    neutral: FloatArray | None = None
    """(markers, 3): the performer's neutral face [mm]."""
    lids: IntArray | None = None
    """Shapes of the lids."""
    driven: DrivenSkin | None = None
    """None if the rig has no combinations, or without `skin`."""

    @cached_property
    def ranges(self) -> FloatArray:
        """Lowest and highest weight: (shapes, 2)."""
        return self.sides.ranges

    def normalise(self, weights: FloatArray) -> FloatArray:
        """Return weights scaled from their ranges to [0-1], and limited to it."""
        low, high = self.ranges.T
        return np.asarray(np.clip((weights - low) / (high - low), 0.0, 1.0))


@dataclass(frozen=True)
class Pairs:
    """Training data of a regression."""

    inputs: FloatArray
    """(pairs, d): coordinates of the reference markers in the motion space [mm], or source weights
    as differences from rest."""
    outputs: FloatArray
    """(pairs, k): keys, or control vectors as differences from rest."""
    known_face: Face | None = None
    """None in retargeting."""
    markers: FloatArray | None = None
    """(pairs, markers, 3): marker positions of the references [mm]; None in retargeting."""
    forward: ForwardModel | None = None
    """Posterior given these pairs; None in retargeting."""
    authors: tuple[str, ...] = ()
    """Who keyed each pair, ``''`` if unknown; empty if nobody is known."""

    @property
    def displacements(self) -> FloatArray:
        """Displacements of the markers from the neutral: (pairs, markers, 3) [mm].

        Raises
        ------
        ValueError
            If there are no markers or no neutral.
        """
        if self.markers is None or self.face.neutral is None:
            raise ValueError("a mapping's pairs need markers and a neutral")
        return self.markers - self.face.neutral

    @property
    def face(self) -> Face:
        """The face of a mapping.

        Raises
        ------
        ValueError
            If the pairs are of a retargeting.
        """
        if self.known_face is None:
            raise ValueError("this regression needs a face; pairs of a retargeting have none")
        return self.known_face

    def rows(self, chosen: IntArray) -> "Pairs":
        """Return some of the pairs, without the forward model, which was fitted to all."""
        return replace(
            self,
            inputs=self.inputs[chosen],
            outputs=self.outputs[chosen],
            markers=None if self.markers is None else self.markers[chosen],
            forward=None,
            authors=tuple(np.array(self.authors)[chosen].tolist()) if self.authors else (),
        )


@dataclass(frozen=True)
class Choices:
    """Settings of the user to compare in place of a regression's candidates."""

    dimensions: tuple[int, ...] = ()
    """Numbers of principal components."""
    widths: tuple[float, ...] = ()
    """Kernel widths, as multiples of the regression's unit of distance."""


DEFAULT_CHOICES = Choices()


@dataclass(frozen=True)
class Fitted:
    """Result of a fit: everything that the prediction reads."""

    arrays: Arrays
    """float64, as stored, so that a mapping read from disk gives bitwise equal predictions."""
    settings: Settings
    """Hyper-parameters, given and chosen."""


@dataclass(frozen=True)
class Regression:
    """One regression method."""

    name: str
    """In mappings and on the command line."""
    fit: Callable[[Pairs, Settings], Fitted]
    """``(pairs, settings) -> Fitted``"""
    prepare: Callable[[Arrays, Settings], Predictor] | None = None
    """``(arrays, settings) -> Predictor``, with all work that does not depend on the inputs done.
    Outputs are not limited to ranges. None for a method that solves frames."""
    mapping_candidates: Callable[[Pairs, tuple[int, ...]], tuple[Settings, ...]] | None = None
    """``(pairs, dimensions) -> candidate settings``; dimensions, if any, replace the default ones.
    None if the method is not available for mappings."""
    retarget_candidates: tuple[Settings, ...] = ()
    """Candidate settings; empty if the method is not available for retargeting."""
    retarget_name: str = ""
    """Name in retargetings, if it differs."""
    prepare_process: Callable[[Arrays, Settings], ProcessPredictor] | None = None
    """As `prepare`, for a method that solves frames: it predicts the prior of `frame_solve`."""

    @property
    def solves_frames(self) -> bool:
        """Whether its prediction is the prior of `frame_solve`, in place of the weights."""
        return self.prepare_process is not None

    def candidates(self, pairs: Pairs, choices: Choices = DEFAULT_CHOICES) -> tuple[Settings, ...]:
        """Return the candidate settings for a mapping."""
        if self.mapping_candidates is None:
            return ()
        defaults = self.mapping_candidates(pairs, choices.dimensions)
        if not choices.widths or "width" not in defaults[0]:
            return defaults
        grid = [settings | {"width": width} for width in choices.widths for settings in defaults]
        return tuple(settings for n, settings in enumerate(grid) if settings not in grid[:n])

    def predict(self, arrays: Arrays, settings: Settings, inputs: FloatArray) -> FloatArray:
        """Evaluate a fit: (frames, d) inputs to (frames, k) outputs."""
        return self._prepared(arrays, settings)(inputs)

    def prepare_prior(
        self, arrays: Arrays, settings: Settings, *, sides: ShapeSides, curve: float
    ) -> PriorPredictor:
        """Return the predictor of a mapping.

        Parameters
        ----------
        sides : ShapeSides
            Of the weights that a method predicts which solves no frames.
        curve : float
            As of `bend`.
        """
        if self.prepare_process is not None:
            process = self.prepare_process(arrays, settings)
            return lambda _coordinates, moved: process(moved.reshape(len(moved), -1))
        predict, low = self._prepared(arrays, settings), sides.ranges[:, 0]
        span = np.ptp(sides.ranges, axis=1)

        def prior(coordinates: FloatArray, _moved: FloatArray) -> tuple[FloatArray, None]:
            return bend((sides.split(predict(coordinates)) - low) / span, curve), None

        return prior

    def _prepared(self, arrays: Arrays, settings: Settings) -> Predictor:
        if self.prepare is None:
            raise ValueError(f"{self.name} predicts a prior, not weights; use prepare_prior")
        return self.prepare(arrays, settings)


def dimension_choices(
    pairs: Pairs, fixed: tuple[int, ...], defaults: tuple[int, ...]
) -> tuple[int, ...]:
    """Return `fixed`, or the default dimensions, limited by the pairs and the motion space."""
    if fixed:
        return fixed
    largest = min(len(pairs.inputs) - 1, pairs.inputs.shape[1])
    return tuple(sorted({min(d, largest) for d in defaults}))


def leading_inputs(inputs: FloatArray, settings: Settings) -> FloatArray:
    """Return the first ``dimensions`` columns, or all if the settings have no ``dimensions``."""
    return inputs[:, : int(settings["dimensions"])] if "dimensions" in settings else inputs


def scale_arrays(pairs: Pairs, settings: Settings) -> Arrays:
    """Return ``scale = variance ** -whitening`` of each dimension, for `scaled_inputs`.

    Without whitening, distances between faces are dominated by the jaw, which moves markers by
    centimetres where lids move by millimetres. Empty if the settings have no ``whitening``.
    """
    if "whitening" not in settings:
        return {}
    variances = pairs.face.motion.variances[: int(settings["dimensions"])]
    floor = max(_MIN_VARIANCE_SHARE * float(variances[0]), np.finfo(float).tiny)
    return {"scale": np.maximum(variances, floor) ** -float(settings["whitening"])}


def scaled_inputs(arrays: Arrays, settings: Settings, inputs: FloatArray) -> FloatArray:
    """Return inputs multiplied by the scale of `scale_arrays`."""
    if "whitening" not in settings:
        return inputs
    scale = arrays["scale"]
    features: FloatArray = inputs[:, : len(scale)] * scale
    return features
