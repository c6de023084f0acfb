"""Frame rates as files write them, rounded, made exact again."""

from fractions import Fraction
from math import isfinite

from usdface.core.errors import InputError

NTSC_BASES = (24, 30, 48, 60, 72, 90, 96, 120, 144, 180, 192, 240, 300, 360, 480)
"""[Hz] Rates that video also has over 1.001."""
_NTSC_TOLERANCE = 0.0051
"""[Hz] 23.976 is also written 23.98."""
_WHOLE_TOLERANCE = 1e-4
"""Relative; single precision and three written decimals are both finer."""
_LARGEST_DENOMINATOR = 1001
_HIGHEST = 100_000
"""[Hz] Beyond any camera: such a number is damage."""


def exact_rate(value: float, *, where: str) -> Fraction:
    """Return the exact rate behind a rounded one.

    Whole numbers stay whole; multiples of 24 and 30 over 1.001 (23.976, 29.97, 59.94, 119.88, …)
    become exact rationals; anything else becomes the nearest fraction with a denominator of at
    most 1001.

    Parameters
    ----------
    value : float
        Frames per second as the file states them.
    where : str
        File and place, for the message.

    Raises
    ------
    InputError
        If the rate is not a number above 0.
    """
    if not (isfinite(value) and 0 < value <= _HIGHEST):
        raise InputError(
            f"{where}: frame rate {value}; it must be above 0 and at most {_HIGHEST}; "
            "export the take again with its rate"
        )
    whole = round(value)
    if whole and abs(value - whole) <= _WHOLE_TOLERANCE * value and value / whole > 1 - 5e-4:
        return Fraction(whole)
    for base in NTSC_BASES:
        ntsc = Fraction(base * 1000, 1001)
        if abs(value - float(ntsc)) <= _NTSC_TOLERANCE:
            return ntsc
    exact = Fraction(value).limit_denominator(_LARGEST_DENOMINATOR)
    return exact if exact > 0 else Fraction(value)
