"""Read keys of alpha, the share of a method in a blend, from tables or USD."""

from fractions import Fraction
from pathlib import Path

import numpy as np

from usdface.capture.text_table import csv_rows
from usdface.capture.weight_samples import read_cell
from usdface.core.arrays import FloatArray, IntArray
from usdface.core.errors import InputError
from usdface.core.sidecars import is_usd_name
from usdface.usdio.mapping import read_alpha_keys


def read_alpha(path: Path, frames: IntArray, *, rate: Fraction, whole: bool) -> FloatArray:
    """Return alpha at frames from .csv (frame, alpha) or USD, interpolated and held at ends.

    `whole`: whether the frames are all of the motion, so that keys outside of them are a mistake.
    """
    keys = read_alpha_keys(path, rate=rate) if is_usd_name(path) else _read_keys(path)
    for frame, alpha in keys:
        if not 0.0 <= alpha <= 1.0:
            raise InputError(f"{path} frame {frame:g}: alpha is {alpha:g}; it must lie in 0 to 1")
    times, values = np.array(sorted(keys)).T
    if (np.diff(times) == 0).any():
        twice = times[1:][np.diff(times) == 0][0]
        raise InputError(f"{path}: frame {twice:g} is keyed twice; keep one")
    inside = (times >= frames[0]) & (times <= frames[-1])
    if whole and len(times) > 1 and not inside.any():
        raise InputError(
            f"{path}: keys frames {times[0]:g} to {times[-1]:g}, all outside of the motion's "
            f"{frames[0]} to {frames[-1]}; key alpha in the motion's frame numbers"
        )
    return np.interp(frames, times, values)


def _read_keys(path: Path) -> list[tuple[float, float]]:
    rows = csv_rows(path, ("frame", "alpha"))
    if not rows:
        raise InputError(f"{path}: holds no keys; write a line `frame,alpha` and one for each key")
    return [
        (
            read_cell(path, where, "frame", row["frame"]),
            read_cell(path, where, "alpha", row["alpha"]),
        )
        for where, row in rows
    ]
