"""Temporal smoothing of weights, over a whole take or causally.

A mapping predicts each frame independently. Smoothing removes noise above a cut-off frequency that
preserves blinks; frames are weighted by their uncertainty. Over a whole take, ranges are
constraints of the minimisation.
"""

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np

from usdface.core.arrays import FloatArray
from usdface.core.errors import as_input_error
from usdface.numerics.solve.banded_smoothing import (
    LEAST_CUTOFF_SHARE,
    FixedLagSmoother,
    apply_filter_bank,
    cutoff_penalty,
    filter_reach,
    smooth_within_bounds,
)

CUTOFF_HZ = 20.0
"""Frequency whose amplitude is halved. Blinks lose less than .005 of their peak; at 12 Hz, .01."""

CUTOFF_SHARE = 0.4
"""Largest default cut-off, relative to the rate; near the Nyquist frequency, .5, little changes."""

LAG_FRAMES = 2
"""Default latency of the causal mode, with nearly the accuracy of the whole take."""

BAND_COUNT = 1
"""Default number of octaves that the published filter bank removes: at 60 frames per second, peaks
of blinks decrease by .02 with one, .06 with two, .15 with three."""

MARGIN_FRAMES = 64
"""Smallest margin of a window of frames."""

_HALF_WEIGHT_MM = 1.0
"""Uncertainty of a frame of weight .5: about the smallest visible error."""

_MIN_WEIGHT = 0.25
"""Smallest weight of a frame: a blink may be the most uncertain frame."""

_ROUNDING_SHARE = 1e-10
"""Effect of a frame, relative to its change, that is neglected beyond the margin."""

Mode = Literal["none", "whole", "causal", "bands"]


@dataclass(frozen=True)
class TemporalSolve:
    """Settings of the smoothing."""

    mode: Mode = "none"
    """``none``: no smoothing. ``whole``: non-causal. ``causal``: with a latency of `lag` frames.
    ``bands``: the published filter bank, which ignores uncertainty, clipped to the ranges."""
    cutoff_hz: float | None = None
    """None for the smaller of `CUTOFF_HZ` and `CUTOFF_SHARE` of the rate."""
    lag: int = LAG_FRAMES
    """Frames of latency of the causal mode."""
    bands: int = BAND_COUNT
    """Number of highest octaves that the filter bank removes."""

    def cutoff_at(self, rate: float) -> float:
        """Return the cut-off at a frame rate [Hz]."""
        return min(CUTOFF_HZ, CUTOFF_SHARE * rate) if self.cutoff_hz is None else self.cutoff_hz

    def margin_at(self, rate: float) -> int:
        """Return the number of frames that affect those of a window, on either side.

        The effect of a frame decays by ``exp(-(weight / penalty)^(1/4) / sqrt(2))`` per frame.
        """
        if self.mode == "none":
            return 0
        if self.mode == "bands":
            return max(MARGIN_FRAMES, filter_reach(self.bands))
        # `smooth_weights` refuses cut-offs out of bounds.
        cutoff = min(max(self.cutoff_at(rate), LEAST_CUTOFF_SHARE * rate), rate / 2)
        penalty = cutoff_penalty(cutoff, rate)
        reach = -math.log(_ROUNDING_SHARE) * math.sqrt(2.0 * math.sqrt(penalty / _MIN_WEIGHT))
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

    Run time is linear in the frames. Smoothing a long take in windows, with `solve.margin_at` more
    frames on either side, gives the same result to rounding. Returns (frames, shapes), within the
    ranges.

    Parameters
    ----------
    weights : (frames, shapes) float array
    uncertainty_mm : (frames,) float array
        Uncertainty of the whole face [mm].
    ranges : (shapes, 2) float array
    rate : float
        Frames per second.
    """
    lower, upper = ranges[:, 0], ranges[:, 1]
    trust = np.maximum(1 / (1 + (uncertainty_mm / _HALF_WEIGHT_MM) ** 2), _MIN_WEIGHT)
    if solve.mode == "none":
        return weights
    with as_input_error("weights cannot be smoothed"):
        if solve.mode == "bands":
            banded = apply_filter_bank(weights, gains=[0.0] * solve.bands)
            return np.clip(banded, lower, upper, out=banded)
        penalty = cutoff_penalty(solve.cutoff_at(rate), rate)
        if solve.mode == "whole":
            return smooth_within_bounds(
                weights, penalty=penalty, trust=trust, lower=lower, upper=upper
            )
        smoother = FixedLagSmoother(weights.shape[1], penalty=penalty, lag=solve.lag)
    pushed = [smoother.push(row, float(each)) for row, each in zip(weights, trust, strict=True)]
    smoothed = [row for row in pushed if row is not None] + smoother.finish()
    return np.asarray(np.clip(np.array(smoothed).reshape(weights.shape), lower, upper))
