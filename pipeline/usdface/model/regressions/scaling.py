"""Coordinates scaled for methods that measure distances.

The jaw moves markers by centimetres, the lids by millimetres: in plain coordinates a distance
between faces is a distance between jaws. Dividing by a power of each component's variance lets
the small motions be heard; the full power would make noise as loud as the jaw.
"""

import numpy as np

from usdface.core.arrays import FloatArray
from usdface.model.regressions.base import Pairs, Settings

POWERS = (0.0, 0.125, 0.25)
"""Of the variance: as captured, up to half way to components of equal size."""

_LEAST_SHARE = 1e-6
"""Of the largest variance: a component that does not move is not divided by nothing."""


def coordinate_scale(pairs: Pairs, settings: Settings) -> FloatArray:
    """Return what to multiply the first ``dimensions`` coordinates by, for ``whitening``."""
    variances = pairs.motion.variances[: int(settings["dimensions"])]
    floor = max(_LEAST_SHARE * float(variances[0]), np.finfo(float).tiny)
    scale: FloatArray = np.maximum(variances, floor) ** -float(settings["whitening"])
    return scale


def scaled(coordinates: FloatArray, scale: FloatArray) -> FloatArray:
    """Return the coordinates that a scale is for, scaled."""
    features: FloatArray = coordinates[:, : len(scale)] * scale
    return features
