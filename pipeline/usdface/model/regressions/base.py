"""What every regression offers: candidates to try, a fit, and a prediction from its arrays.

A mapping learns weights from coordinates of markers, a retargeting a control vector from the
source's weights. To a regression both are pairs of inputs and outputs. Several of them bend the
weights they train on, as skin moves more at first than at last.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from usdface.core.arrays import FloatArray, IntArray
from usdface.core.assets import MotionSpace
from usdface.core.rig_logic import RigLogic

if TYPE_CHECKING:
    from usdface.model.regressions.forward_model import ForwardModel

Settings = dict[str, float | int | str | bool]
Arrays = dict[str, FloatArray]

Predictor = Callable[[FloatArray], FloatArray]
"""Inputs (frames, d) to outputs (frames, k)."""

WHITENING_POWERS = (0.0, 0.125, 0.25)
"""Powers of the variance that coordinates are divided by: 0 leaves them as captured, 0.5 would make
all components equal, and noise as loud as the jaw."""

_LEAST_VARIANCE_SHARE = 1e-6
"""Of the largest variance: a component that does not move is not divided by nothing."""


@dataclass(frozen=True)
class RestPlaces:
    """Where things are on the rig's neutral face."""

    points: FloatArray
    """(points, 3): those of the skin whose displacements are known [mm]."""
    markers: FloatArray | None = None
    """(markers, 3): NaN where a marker's place is not known [mm]."""


@dataclass(frozen=True)
class DrivenSkin:
    """Combinations of the rig: shapes that are evaluated, not learnt."""

    logic: RigLogic
    """Its first shapes are those of the pairs."""
    skin: FloatArray
    """(combinations, points, 3): what each at 1 does to the points of `Face.skin` [mm]."""


@dataclass(frozen=True)
class Face:
    """What is known of the face beside the pairs, where markers are mapped."""

    ranges: FloatArray
    """(shapes, 2): lowest and highest weight."""
    gram: FloatArray
    """(shapes, shapes): mean over the rig's points of the dot products of the shapes' displacements
    [mm^2]; the identity when no rig is known."""
    motion: MotionSpace
    """With coordinates of frames that nobody tuned."""
    skin: FloatArray | None = None
    """(shapes, points, 3): what each shape at 1 does to points spread over the rig's surface
    [mm]."""
    rest: RestPlaces | None = None
    """Where those points, and markers, are on the rig's neutral."""
    neutral: FloatArray | None = None
    """(markers, 3): the performer's neutral face [mm]."""
    driven: DrivenSkin | None = None
    """None where the rig has no combinations, or `skin` is not known."""

    def normalise(self, weights: FloatArray) -> FloatArray:
        """Return weights as shares of their ranges, in [0-1]."""
        low, high = self.ranges.T
        return np.asarray(np.clip((weights - low) / (high - low), 0.0, 1.0))


@dataclass(frozen=True)
class Pairs:
    """What a regression learns from."""

    inputs: FloatArray
    """(pairs, d): coordinates of the reference markers in the motion space [mm], or source weights
    as differences from rest."""
    outputs: FloatArray
    """(pairs, k): weights that the animator set, or control vectors as differences from rest."""
    known_face: Face | None = None
    """None in retargeting."""
    markers: FloatArray | None = None
    """(pairs, markers, 3): of the references [mm]; None in retargeting."""
    forward: "ForwardModel | None" = None
    """Conditioned on these pairs; None in retargeting."""

    @property
    def face(self) -> Face:
        """The face; a regression that needs one serves mappings alone."""
        if self.known_face is None:
            raise ValueError("this regression needs a face's motion, and retargeting has none")
        return self.known_face

    def rows(self, chosen: IntArray) -> "Pairs":
        """Keep some of the pairs; the forward model, which knows them all, is left out."""
        return replace(
            self,
            inputs=self.inputs[chosen],
            outputs=self.outputs[chosen],
            markers=None if self.markers is None else self.markers[chosen],
            forward=None,
        )


@dataclass(frozen=True)
class Choices:
    """Settings that a person wants compared in place of a regression's own."""

    dimensions: tuple[int, ...] = ()
    """Numbers of principal components."""
    widths: tuple[float, ...] = ()
    """Of kernels, as multiples of the distance that the regression measures."""


DEFAULT_CHOICES = Choices()


@dataclass(frozen=True)
class Fitted:
    """What a fit learned: all that its prediction reads."""

    arrays: Arrays
    """float64, so that a mapping reopened from disk predicts the same to the last bit."""
    settings: Settings
    """Hyper-parameters, given and chosen."""


@dataclass(frozen=True)
class Regression:
    """One way from inputs to outputs."""

    name: str
    """In mappings and on the command line."""
    summary: str
    """One line for people who choose."""
    fit: Callable[[Pairs, Settings], Fitted]
    """``(pairs, settings) -> Fitted``"""
    prepare: Callable[[Arrays, Settings], Predictor]
    """``(arrays, settings) -> Predictor``: what can be done once for many frames is done here.
    Outputs are not yet limited to ranges."""
    mapping_candidates: Callable[[Pairs, tuple[int, ...]], tuple[Settings, ...]] | None = None
    """``(pairs, dimensions) -> settings to try``; dimensions, if any, replace the regression's own.
    None where it does not serve mappings."""
    retarget_candidates: tuple[Settings, ...] = ()
    """Settings to try; none where the regression does not serve retargeting."""
    retarget_name: str = ""
    """In retargetings, where it is another."""
    solves_frames: bool = False
    """What it predicts is where `frame_solve` starts from, not yet the answer."""

    def candidates(self, pairs: Pairs, choices: Choices = DEFAULT_CHOICES) -> tuple[Settings, ...]:
        """Return the settings worth trying for a mapping."""
        if self.mapping_candidates is None:
            return ()
        tried = self.mapping_candidates(pairs, choices.dimensions)
        if not choices.widths or "width" not in tried[0]:
            return tried
        asked = [settings | {"width": width} for width in choices.widths for settings in tried]
        return tuple(each for n, each in enumerate(asked) if each not in asked[:n])

    def predict(self, arrays: Arrays, settings: Settings, inputs: FloatArray) -> FloatArray:
        """Evaluate a fit: (frames, d) inputs to (frames, k) outputs."""
        return self.prepare(arrays, settings)(inputs)


def dimension_choices(
    pairs: Pairs, fixed: tuple[int, ...], usual: tuple[int, ...]
) -> tuple[int, ...]:
    """Dimensions worth trying: the usual ones that the pairs and the motion space can carry."""
    if fixed:
        return fixed
    most = min(len(pairs.inputs) - 1, pairs.inputs.shape[1])
    return tuple(sorted({min(d, most) for d in usual}))


def leading_inputs(inputs: FloatArray, settings: Settings) -> FloatArray:
    """Return the first ``dimensions`` columns, or all where the settings name no number."""
    return inputs[:, : int(settings["dimensions"])] if "dimensions" in settings else inputs


def scale_arrays(pairs: Pairs, settings: Settings) -> Arrays:
    """Return what `scaled_inputs` reads: ``scale = variance ** -whitening`` of each dimension.

    The jaw moves markers by centimetres, the lids by millimetres: in plain coordinates a distance
    between faces is a distance between jaws. Only settings with ``whitening`` need it.
    """
    if "whitening" not in settings:
        return {}
    variances = pairs.face.motion.variances[: int(settings["dimensions"])]
    floor = max(_LEAST_VARIANCE_SHARE * float(variances[0]), np.finfo(float).tiny)
    return {"scale": np.maximum(variances, floor) ** -float(settings["whitening"])}


def scaled_inputs(arrays: Arrays, settings: Settings, inputs: FloatArray) -> FloatArray:
    """Return inputs as distances between them are measured."""
    if "whitening" not in settings:
        return inputs
    scale = arrays["scale"]
    features: FloatArray = inputs[:, : len(scale)] * scale
    return features


def bend(weights: FloatArray, curve: float) -> FloatArray:
    """Bend weights; beyond [0-1] the curve goes on along its ends.

    A shape at half its weight has often moved the skin by more than half. Trained on
    ``w + curve w (1 - w)``, lines fit better; `unbend` brings the prediction back.

    Parameters
    ----------
    weights : (n, s) float array
        Normalised: [0-1] over each shape's range.
    curve : float
        In [0, 1).
    """
    inside = np.clip(weights, 0.0, 1.0)
    bent: FloatArray = inside + curve * inside * (1 - inside)
    bent += (1 + curve) * np.minimum(weights, 0.0)
    bent += (1 - curve) * np.maximum(weights - 1.0, 0.0)
    return bent


def unbend(bent: FloatArray, curve: float) -> FloatArray:
    """Return the weights that `bend` bent so."""
    inside = np.clip(bent, 0.0, 1.0)
    root = np.sqrt((1 + curve) ** 2 - 4 * curve * inside)
    weights: FloatArray = 2 * inside / (1 + curve + root)
    weights += np.minimum(bent, 0.0) / (1 + curve)
    weights += np.maximum(bent - 1.0, 0.0) / (1 - curve)
    return weights
