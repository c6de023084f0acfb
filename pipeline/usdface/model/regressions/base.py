"""What a regression method offers: candidates to try, a fit, and a prediction from its arrays."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

from usdface.core.arrays import FloatArray, IntArray
from usdface.core.assets import MotionSpace
from usdface.core.errors import InputError
from usdface.numerics.array_namespace import CPU, ArrayDevice

Settings = dict[str, float | int | str | bool]

Predictor = Callable[[Any], Any]
"""Coordinates (frames, dimensions) to weights (frames, shapes), both on a device."""


@dataclass(frozen=True)
class Pairs:
    """What a method learns from.

    Attributes
    ----------
    coordinates : (pairs, dimensions) float array
        Of the reference markers in the motion space [mm].
    weights : (pairs, shapes) float array
        What the animator set, within `ranges`.
    ranges : (shapes, 2) float array
    gram : (shapes, shapes) float array
        Mean over the rig's points of the dot products of the shapes' displacements [mm^2]; the
        identity when no rig is known.
    motion : MotionSpace
        With coordinates of frames that nobody tuned.
    skin : (shapes, points, 3) float array or None
        What each shape at 1 does to points spread over the rig's surface [mm].
    """

    coordinates: FloatArray
    weights: FloatArray
    ranges: FloatArray
    gram: FloatArray
    motion: MotionSpace
    skin: FloatArray | None = None

    def rows(self, chosen: IntArray) -> "Pairs":
        """Keep some of the pairs, all else equal."""
        return replace(self, coordinates=self.coordinates[chosen], weights=self.weights[chosen])


@dataclass(frozen=True)
class Fitted:
    """What a fit learned: all that its prediction reads.

    Attributes
    ----------
    arrays : dict of str to float array
        float64, so that a mapping reopened from disk predicts the same to the last bit.
    settings : dict
        Hyper-parameters, given and chosen.
    """

    arrays: dict[str, FloatArray]
    settings: Settings


@dataclass(frozen=True)
class Method:
    """One way from coordinates to weights.

    Attributes
    ----------
    name : str
        Key in the registry and in mappings.
    summary : str
        One line for people who choose.
    candidates : callable
        ``(pairs, dimensions or None) -> settings to try``; dimensions fixes that setting.
    fit : callable
        ``(pairs, settings) -> Fitted``
    predict : callable
        ``(arrays, settings, coordinates (frames, dimensions)) -> weights (frames, shapes)``, not
        yet limited to ranges. In double precision: what a method is judged and chosen by.
    prepare : callable, optional
        ``(arrays, settings, device) -> Predictor``, where there is work to do once for many frames;
        agrees with `predict` to 1e-6. Without it a method runs on the processor alone.
    quicken : callable, optional
        ``(pairs, Fitted) -> Fitted``: what can be done once, for the fit that was chosen, so that
        many frames take less time.
    """

    name: str
    summary: str
    candidates: Callable[[Pairs, int | None], tuple[Settings, ...]]
    fit: Callable[[Pairs, Settings], Fitted]
    predict: Callable[[dict[str, FloatArray], Settings, FloatArray], FloatArray]
    prepare: Callable[[dict[str, FloatArray], Settings, ArrayDevice], Predictor] | None = None
    quicken: Callable[[Pairs, Fitted], Fitted] | None = None

    def predictor(
        self, arrays: dict[str, FloatArray], settings: Settings, device: ArrayDevice
    ) -> Predictor:
        """Make a fit ready to predict many frames on a device.

        Raises
        ------
        InputError
            If the method runs on the processor alone, and that is not the device.
        """
        if self.prepare is not None:
            return self.prepare(arrays, settings, device)
        if device is not CPU:
            raise InputError(
                f"a mapping by {self.name} runs on the processor alone, not on {device.name!r}; "
                "leave the device out, or train by another method"
            )
        return partial(self.predict, arrays, settings)


def in_double_precision(
    prepare: Callable[..., Predictor],
) -> Callable[[dict[str, FloatArray], Settings, FloatArray], FloatArray]:
    """Return a method's `predict` from its `prepare`, which takes ``single``."""

    def predict(
        arrays: dict[str, FloatArray], settings: Settings, coordinates: FloatArray
    ) -> FloatArray:
        predicted: FloatArray = prepare(arrays, settings, single=False)(coordinates)
        return predicted

    return predict


def dimension_choices(pairs: Pairs, fixed: int | None, usual: tuple[int, ...]) -> tuple[int, ...]:
    """Dimensions worth trying: the usual ones that the pairs and the motion space can carry."""
    if fixed is not None:
        return (fixed,)
    most = min(len(pairs.coordinates) - 1, pairs.coordinates.shape[1])
    return tuple(sorted({min(d, most) for d in usual}))
