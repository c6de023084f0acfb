"""Exponents of power laws fitted to costs."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class PowerLaw:
    """``seconds = factor * size ** exponent``.

    Attributes
    ----------
    exponent, factor : float
    spread : float
        Standard error of the exponent; NaN for two sizes.
    last : float
        Exponent between the two largest sizes, with the smallest influence of fixed costs.
    """

    exponent: float
    factor: float
    spread: float
    last: float

    def seconds(self, size: float) -> float:
        """Return the predicted seconds of a size."""
        return float(self.factor * size**self.exponent)


def fit_power_law(sizes: Sequence[float], seconds: Sequence[float]) -> PowerLaw:
    """Fit a straight line to logarithms, by least squares.

    Raises
    ------
    ValueError
        If there are fewer than two sizes, or anything is not positive.
    """
    if len(sizes) < 2 or min(*sizes, *seconds) <= 0:
        raise ValueError(f"two or more positive sizes and times, got {sizes} and {seconds}")
    x, y = np.log(sizes), np.log(seconds)
    across = x - x.mean()
    exponent = float(across @ y / (across @ across))
    middle = float(y.mean() - exponent * x.mean())
    left = y - middle - exponent * x
    free = len(x) - 2
    spread = float(np.sqrt(left @ left / free / (across @ across))) if free else float("nan")
    last = float((y[-1] - y[-2]) / (x[-1] - x[-2]))
    return PowerLaw(exponent, float(np.exp(middle)), spread, last)
