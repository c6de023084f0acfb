"""Weights that move as faces do: smoothed over time, as a whole take or as frames arrive.

A mapping looks at one frame at a time. Smoothing its weights takes out what no face does, at a
cut-off that keeps blinks; uncertain frames are interpolated from their neighbours. Ranges
are constraints of the problem, not cut off afterwards.
"""

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np

from usdface.core.arrays import FloatArray
from usdface.core.errors import InputError
from usdface.numerics.solve.banded_smoothing import (
    LEAST_CUTOFF_SHARE,
    FixedLagSmoother,
    apply_filter_bank,
    cutoff_penalty,
    filter_reach,
    smooth_within_bounds,
)

CUTOFF_HZ = 20.0
"""Motion of this frequency is halved. Blinks lose less than .005 of their peak; at 12 Hz, .01."""

CUTOFF_SHARE = 0.4
"""[of the rate] Largest default cut-off: at half of the rate little would be smoothed, and frames
hold no motion beyond it."""

LAG_FRAMES = 2
"""Latency of the causal mode; with two frames it is nearly as good as the whole take."""

BAND_COUNT = 1
"""Octaves left out by the paper's filter bank: at 60 frames per second one costs blinks .02 of
their peaks, two .06, three .15."""

MARGIN_FRAMES = 64
"""Least margin of a window: what happens farther away does not change its frames."""

_HALF_TRUST_MM = 1.0  # uncertainty at which a frame counts half: what is seen
_LEAST_TRUST = 0.25  # a blink may be the frame that references know least
_ROUNDING_SHARE = 1e-10  # of a change

Mode = Literal["none", "whole", "causal", "bands"]


@dataclass(frozen=True)
class TemporalSolve:
    """How weights are smoothed."""

    mode: Mode = "none"
    """Not at all; every frame by those before and after it; by those before it and `lag` frames
    after; or as published, by a filter bank that ignores uncertainty and is limited last."""
    cutoff_hz: float | None = None
    """None for `CUTOFF_HZ`, or `CUTOFF_SHARE` of the rate where that is less."""
    lag: int = LAG_FRAMES
    """Frames of latency of the causal mode."""
    bands: int = BAND_COUNT
    """Finest octaves that the filter bank leaves out."""

    def cutoff_at(self, rate: float) -> float:
        """Return the cut-off for frames of a rate [Hz]."""
        return min(CUTOFF_HZ, CUTOFF_SHARE * rate) if self.cutoff_hz is None else self.cutoff_hz

    def margin_at(self, rate: float) -> int:
        """Return how many frames to solve on either side of those wanted.

        A change fades by exp(-(trust / penalty)^(1/4) / sqrt(2)) a frame: the lower the cut-off,
        the farther it reaches.
        """
        if self.mode == "none":
            return 0
        if self.mode == "bands":
            return max(MARGIN_FRAMES, filter_reach(self.bands))
        # A cut-off out of bounds is refused where it is smoothed.
        cutoff = min(max(self.cutoff_at(rate), LEAST_CUTOFF_SHARE * rate), rate / 2)
        penalty = cutoff_penalty(cutoff, rate)
        reach = -math.log(_ROUNDING_SHARE) * math.sqrt(2.0 * math.sqrt(penalty / _LEAST_TRUST))
        return max(MARGIN_FRAMES, math.ceil(reach))


def smooth_weights(
    weights: FloatArray,
    *,
    uncertainty_mm: FloatArray,
    ranges: FloatArray,
    rate: float,
    solve: TemporalSolve,
) -> FloatArray:
    """Smooth consecutive frames of a performance.

    Time grows with the frames. A long take may be smoothed in windows: with `solve.margin_at` more
    frames on either side, what comes out between them is the same to rounding.

    Parameters
    ----------
    weights : (frames, shapes) float array
    uncertainty_mm : (frames,) float array
        Of the face [mm].
    ranges : (shapes, 2) float array
    rate : float
        Frames per second.

    Returns
    -------
    (frames, shapes) float array
        Within the ranges.
    """
    lower, upper = ranges[:, 0], ranges[:, 1]
    trust = np.maximum(1 / (1 + (uncertainty_mm / _HALF_TRUST_MM) ** 2), _LEAST_TRUST)
    if solve.mode == "none":
        return weights
    try:
        if solve.mode == "bands":
            banded = apply_filter_bank(weights, gains=[0.0] * solve.bands)
            return np.clip(banded, lower, upper, out=banded)
        penalty = cutoff_penalty(solve.cutoff_at(rate), rate)
        if solve.mode == "whole":
            return smooth_within_bounds(
                weights, penalty=penalty, trust=trust, lower=lower, upper=upper
            )
        smoother = FixedLagSmoother(weights.shape[1], penalty=penalty, lag=solve.lag)
    except ValueError as error:
        raise InputError(f"weights cannot be smoothed: {error}") from error
    given = [smoother.push(row, float(each)) for row, each in zip(weights, trust, strict=True)]
    known = [row for row in given if row is not None] + smoother.finish()
    limited: FloatArray = np.clip(np.array(known).reshape(weights.shape), lower, upper)
    return limited
