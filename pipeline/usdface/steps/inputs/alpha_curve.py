"""The share of the multiquadric in a hybrid, keyed over time: eq. 9 of Song et al. (2011)."""

import csv
import math
from pathlib import Path

import numpy as np

from usdface.core.arrays import FloatArray, IntArray
from usdface.core.errors import InputError
from usdface.core.sidecars import LAYER_SUFFIXES
from usdface.usdio.mapping import read_alpha_keys


def read_alpha(path: Path, frames: IntArray) -> FloatArray:
    """Return alpha at frames: straight between its keys, held before the first and after the last.

    Parameters
    ----------
    path : Path
        .csv with the columns ``frame`` and ``alpha``, or USD; see `read_alpha_keys`.
    frames : (n,) int array

    Raises
    ------
    InputError
        If there are no keys, or one lies outside 0 to 1.
    """
    keys = read_alpha_keys(path) if path.suffix in LAYER_SUFFIXES else _read_table(path)
    for frame, alpha in keys:
        if not 0.0 <= alpha <= 1.0:
            raise InputError(f"{path} frame {frame:g}: alpha is {alpha:g}; it must lie in 0 to 1")
    times, values = np.array(sorted(keys)).T
    if (np.diff(times) == 0).any():
        twice = times[1:][np.diff(times) == 0][0]
        raise InputError(f"{path}: frame {twice:g} is keyed twice; keep one")
    return np.asarray(np.interp(frames, times, values))


def _read_table(path: Path) -> list[tuple[float, float]]:
    try:
        rows = list(csv.DictReader(path.read_text(encoding="utf-8-sig").splitlines()))
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise InputError(f"{path}: cannot be read as CSV: {error}") from error
    keys = []
    for line, row in enumerate(rows, start=2):
        try:
            key = float(str(row.get("frame"))), float(str(row.get("alpha")))
        except ValueError:
            key = math.nan, math.nan
        if not all(map(math.isfinite, key)):
            raise InputError(
                f"{path} line {line}: needs numbers in the columns `frame` and `alpha`, got {row}"
            )
        keys.append(key)
    if not keys:
        raise InputError(f"{path}: holds no keys; write a line `frame,alpha` and one for each key")
    return keys
