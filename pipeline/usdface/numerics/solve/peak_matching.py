"""Scale a performer's motion region by region, by what every performer does in full.

A blink closes the eye, on the performer and on the character. Lids that travel six millimetres
on one face and ten on the other need a scale of their own: one for the whole head leaves the
character's eyes half open.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from usdface.core.arrays import FloatArray
from usdface.numerics.solve.blendshape_equation import solve_weights

_PEAK_QUANTILE = 0.99  # of the weights over time: a peak that lasts, not a single frame
_SHOWN_SHARE = 0.3  # [of the range] below, the take does not show the shape
_GAINS = (0.5, 2.5)
_MOST_ROUNDS = 3
_CLOSE_SHARE = 0.02  # [of the range] of the top that counts as reached
_CARRIED_SHARE = 0.2  # [of a shape's largest displacement] markers below get no gain from it


def match_peaks(
    deltas: ArrayLike,
    motion: ArrayLike,
    shapes: Sequence[int],
    *,
    ranges: ArrayLike | None = None,
    visible: ArrayLike | None = None,
    marker_trust: ArrayLike | None = None,
    ridge: float = 10.0,
) -> FloatArray:
    """Return one gain per marker, so that given shapes reach the top of their range in a take.

    A marker takes the gain in proportion to how much of what it can do is that shape's: a lid
    marker wholly, a brow marker hardly.

    Parameters
    ----------
    deltas : (shapes, markers, 3) array
        At the virtual markers [mm].
    motion : (frames, markers, 3) array
        A take that shows each shape in full several times, in the character's space [mm].
    shapes : sequence of int
        Such as both blinks. One that the take does not show changes nothing.
    ranges, visible, marker_trust, ridge
        As in `solve_weights`.

    Returns
    -------
    (markers,) float array
        Multiply the motion by it, before `solve_weights`.

    Raises
    ------
    ValueError
        If arrays do not fit together or a shape does not exist.
    """
    D, m = np.asarray(deltas, float), np.asarray(motion, float)
    wrong = [shape for shape in shapes if not 0 <= shape < len(D)]
    if wrong:
        raise ValueError(f"there is no shape {wrong[0]}; there are {len(D)}")
    limits = np.tile([0.0, 1.0], (len(D), 1)) if ranges is None else np.asarray(ranges, float)
    reach = np.linalg.norm(D, axis=2)
    share = (reach / np.maximum(reach.max(axis=0), 1e-9)) ** 2
    share[reach < _CARRIED_SHARE * reach.max(axis=1, keepdims=True)] = 0
    gain = np.ones(D.shape[1])
    for _ in range(_MOST_ROUNDS):
        weights = solve_weights(
            D,
            m * gain[:, None],
            method="bounded",
            ranges=limits,
            visible=visible,
            marker_trust=marker_trust,
            ridge=ridge,
        ).weights
        reached = np.quantile(weights, _PEAK_QUANTILE, axis=0)
        top = limits[:, 1]
        low, high = _SHOWN_SHARE * top, (1 - _CLOSE_SHARE) * top
        short = [shape for shape in shapes if low[shape] < reached[shape] < high[shape]]
        if not short:
            break
        for shape in short:
            gain *= 1 + (top[shape] / reached[shape] - 1) * share[shape]
        gain = np.clip(gain, *_GAINS)
    return gain
