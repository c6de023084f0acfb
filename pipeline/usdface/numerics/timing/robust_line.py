"""A straight line through points of which many may be wrong."""

from dataclasses import dataclass

import numpy as np

from usdface.core.arrays import MAD_TO_DEVIATION, BoolArray, FloatArray

_SHORTEST_BASE = 0.3
"""[of the points' span] Two points closer than this give no slope to judge others by."""

_MOST_ROUNDS = 6
_AGREEING_DEVIATIONS = 6.0
_PAIRS_AT_ONCE = 2048


@dataclass(frozen=True)
class RobustLine:
    """``y = intercept + slope * x``."""

    intercept: float
    slope: float
    agreeing: BoolArray
    """(n,): the points it was fitted to."""
    deviation: float
    """Root mean square distance of those."""


def fit_robust_line(
    x: FloatArray,
    y: FloatArray,
    *,
    tolerance: float,
    largest_slope: float,
    usual_slope: float,
    noise: float,
) -> RobustLine:
    """Fit the line that most points agree on, then fit it to those by least squares.

    Every pair of points proposes a line, so that the result depends on no random draw
    (Fischler and Bolles 1981, made exhaustive).

    Parameters
    ----------
    x, y : (n,) float array
    tolerance : float
        Distance up to which a point may agree, in the unit of `y`; less where the others lie
        closer to the line.
    largest_slope : float
        Steeper lines are not considered.
    usual_slope : float
        Standard deviation of slopes expected beforehand: a few points close together should not
        make up a steep line.
    noise : float
        Standard deviation that a point has at least, in the unit of `y`.

    Raises
    ------
    ValueError
        If there is no point.
    """
    if not len(x):
        raise ValueError("a line needs at least one point, got none")
    distance = _distances_to_best(x, y, tolerance, largest_slope)
    agreeing = np.zeros(len(x), bool)
    intercept, slope = 0.0, 0.0
    for _ in range(_MOST_ROUNDS):
        scale = max(noise, MAD_TO_DEVIATION * float(np.median(distance[distance < tolerance])))
        within = distance < min(tolerance, _AGREEING_DEVIATIONS * scale)
        if np.array_equal(within, agreeing):
            break
        agreeing = within
        intercept, slope = _least_squares(x[agreeing], y[agreeing], usual_slope, scale)
        distance = np.abs(y - intercept - slope * x)
    deviation = float(np.sqrt(np.mean(distance[agreeing] ** 2)))
    return RobustLine(intercept, slope, agreeing, deviation)


def _distances_to_best(
    x: FloatArray, y: FloatArray, tolerance: float, largest_slope: float
) -> FloatArray:
    """Return how far each point is from the line through two of them that most support."""
    first, second = np.triu_indices(len(x), k=1)
    far = np.abs(x[second] - x[first]) >= _SHORTEST_BASE * np.ptp(x)
    first, second = first[far], second[far]
    with np.errstate(divide="ignore", invalid="ignore"):
        slopes = (y[second] - y[first]) / (x[second] - x[first])
    possible = np.abs(slopes) <= largest_slope  # NaN is not
    # Level lines through each point, for few points that are far from any line.
    through = np.concatenate([np.arange(len(x)), first[possible]])
    slopes = np.concatenate([np.zeros(len(x)), slopes[possible]])
    best = -1.0
    nearest = np.zeros(len(x))
    for start in range(0, len(through), _PAIRS_AT_ONCE):
        point = through[start : start + _PAIRS_AT_ONCE, None]
        slope = slopes[start : start + _PAIRS_AT_ONCE, None]
        distance = np.abs(y - y[point] - slope * (x - x[point]))
        # Near points count more (Torr and Zisserman 2000): or a tilt that catches one point more
        # would win over the line on which the others lie.
        support = np.maximum(1 - distance / tolerance, 0).sum(axis=1)
        index = int(np.argmax(support))
        if support[index] > best:
            best, nearest = float(support[index]), distance[index]
    return nearest


def _least_squares(
    x: FloatArray, y: FloatArray, usual_slope: float, noise: float
) -> tuple[float, float]:
    middle, level = float(x.mean()), float(y.mean())
    slope = float(((x - middle) * (y - level)).sum()) / float(
        ((x - middle) ** 2).sum() + (noise / usual_slope) ** 2
    )
    return level - slope * middle, slope
