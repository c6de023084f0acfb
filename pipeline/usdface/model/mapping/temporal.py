"""Weights that move as faces do: smoothed over time, as a whole take or as frames arrive.

A mapping looks at one frame at a time. Smoothing its weights takes out what no face does, at a
cut-off that leaves blinks standing; frames that the mapping is less sure of are told by their
neighbours. Ranges are part of the problem, not cut off afterwards.
"""

import math
from dataclasses import dataclass
from functools import partial
from typing import Literal

import numpy as np

from usdface.core.arrays import FloatArray
from usdface.core.errors import InputError
from usdface.numerics.array_namespace import CPU, ArrayDevice
from usdface.numerics.solve.banded_smoothing import (
    SLOWEST,
    FixedLagSmoother,
    cutoff_penalty,
    smooth_within_bounds,
)
from usdface.numerics.solve.filter_bank import apply_filter_bank, filter_reach
from usdface.numerics.solve.projected_gradient_smoothing import (
    MOST_STEPS,
    smooth_on_device,
    steps_needed,
)

CUTOFF_HZ = 20.0
"""Motion of this frequency is halved. Blinks lose less than .005 at it; at 12 Hz they lose .01."""

CUTOFF_SHARE = 0.4
"""Most of the rate that the cut-off is unless asked for: at half of it little would be smoothed,
and beyond there is no such motion."""

LAG_FRAMES = 2
"""How far the causal mode is behind: with two frames nearly as good as the whole take."""

BANDS = 1
"""Octaves left out by the paper's filter bank: at 60 frames per second one costs blinks .02 of
their peaks, two .06, three .15."""

MARGIN_FRAMES = 64
"""Fewest frames around a window beyond which nothing that is heard in it happens."""

_LEAST_TRUST = 0.25  # a blink may be the frame that references know least
_UNHEARD = 1e-10  # share of a change that is rounding

Mode = Literal["none", "whole", "causal", "bands"]


@dataclass(frozen=True)
class TemporalSolve:
    """How weights are smoothed.

    Attributes
    ----------
    mode : {'none', 'whole', 'causal', 'bands'}
        Not at all; every frame by those before and after it; by those before it and `lag` frames
        after; or as published, by a filter bank that knows no confidence and is limited last.
    cutoff_hz : float or None
        None for `CUTOFF_HZ`, or `CUTOFF_SHARE` of the rate where that is less.
    lag : int
        Frames of latency of the causal mode.
    bands : int
        Finest octaves that the filter bank leaves out.
    """

    mode: Mode = "none"
    cutoff_hz: float | None = None
    lag: int = LAG_FRAMES
    bands: int = BANDS

    def cutoff_at(self, rate: float) -> float:
        """Return the cut-off for frames of a rate [Hz]."""
        return min(CUTOFF_HZ, CUTOFF_SHARE * rate) if self.cutoff_hz is None else self.cutoff_hz

    def margin_at(self, rate: float) -> int:
        """Return how many frames to solve on either side of those asked for.

        A change fades by exp(-(trust / penalty)^(1/4) / sqrt(2)) a frame: the lower the cut-off,
        the further it is heard.
        """
        if self.mode == "none":
            return 0
        if self.mode == "bands":
            return max(MARGIN_FRAMES, filter_reach(self.bands))
        # What is out of bounds is refused where it is smoothed.
        cutoff = min(max(self.cutoff_at(rate), SLOWEST * rate), rate / 2)
        penalty = cutoff_penalty(cutoff, rate)
        reach = -math.log(_UNHEARD) * math.sqrt(2.0 * math.sqrt(penalty / _LEAST_TRUST))
        return max(MARGIN_FRAMES, math.ceil(reach))


def smooth_weights(
    weights: FloatArray,
    *,
    confidence: FloatArray,
    ranges: FloatArray,
    rate: float,
    solve: TemporalSolve,
    device: ArrayDevice = CPU,
) -> FloatArray:
    """Smooth consecutive frames of a performance.

    Time grows with the frames. A long take may be smoothed in windows: with `solve.margin_at` more
    frames on either side, what comes out between them is the same to rounding.

    Parameters
    ----------
    weights : (frames, shapes) float array
    confidence : (frames,) float array
        [0-1]
    ranges : (shapes, 2) float array
    rate : float
        Frames per second.
    solve : TemporalSolve
    device : ArrayDevice
        Where whole takes are smoothed; the other modes go from frame to frame, on the processor.

    Returns
    -------
    (frames, shapes) float array
        Within the ranges.

    Raises
    ------
    InputError
        If the cut-off does not fit the rate or a value is not finite.
    """
    lower, upper = ranges[:, 0], ranges[:, 1]
    trust = np.clip(confidence, _LEAST_TRUST, 1.0)
    if solve.mode == "none":
        return weights
    try:
        if solve.mode == "bands":
            banded = apply_filter_bank(weights, gains=[0.0] * solve.bands)
            return np.clip(banded, lower, upper, out=banded)
        penalty = cutoff_penalty(solve.cutoff_at(rate), rate)
        if solve.mode == "whole":
            quick = len(trust) > 0 and steps_needed(penalty, trust) <= MOST_STEPS
            here = device is CPU or not quick
            smooth = smooth_within_bounds if here else partial(smooth_on_device, device=device)
            return smooth(weights, penalty=penalty, trust=trust, lower=lower, upper=upper)
        smoother = FixedLagSmoother(weights.shape[1], penalty=penalty, lag=solve.lag)
    except ValueError as error:
        raise InputError(f"weights cannot be smoothed: {error}") from error
    given = [smoother.push(row, float(each)) for row, each in zip(weights, trust, strict=True)]
    known = [row for row in given if row is not None] + smoother.finish()
    limited: FloatArray = np.clip(np.array(known).reshape(weights.shape), lower, upper)
    return limited
