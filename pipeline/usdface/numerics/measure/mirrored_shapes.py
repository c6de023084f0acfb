"""Which shapes are each other's mirror image, by name, and which of them stay on their side."""

import re
from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike
from scipy import sparse

from usdface.core.arrays import BoolArray, FloatArray, IntArray, index_of

# A side as names carry it: a word, or a letter set off from the rest. Each match is replaced by
# itself, so that a name with two of them finds its partner among the names there are.
_WORD = re.compile(r"left|right", re.IGNORECASE)
_LETTER = re.compile(
    r"(?<=[_.\-])[lrLR](?=$|[_.\-\d])"  # brow_L, brow_l_01
    r"|^[lrLR](?=[_.\-])"  # L_brow
    r"|^[lr](?=[A-Z])"  # lBrow
    r"|(?<=[a-z0-9])[LR](?=$|[_.\-\d])"  # browL
)
_OTHER = {"left": "right", "right": "left", "l": "r", "r": "l"}

_ONE_SIDE_SHARE = 0.8
"""[of a shape's squared motion] Must lie on one side for the shape to be that side's."""


def mirrored_shapes(names: Sequence[str]) -> IntArray:
    """Return the index of each shape's mirror image; its own where it has none.

    Parameters
    ----------
    names : sequence of str
        ``browDown_L`` and ``browDown_R``, ``mouthSmileLeft`` and ``mouthSmileRight``,
        ``l_brow_down`` and ``r_brow_down``.

    Returns
    -------
    (shapes,) int array
        An involution: ``partner[partner] == arange(shapes)``.
    """
    place = index_of(names)
    partner = np.arange(len(names))
    for index, name in enumerate(names):
        for match in (*_WORD.finditer(name), *_LETTER.finditer(name)):
            found = place.get(_swapped(name, match), index)
            if found != index and partner[index] == index and partner[found] == found:
                partner[index], partner[found] = found, index
                break
    return partner


def sided_shapes(offsets: sparse.csr_array, points: ArrayLike) -> BoolArray:
    """Return which shapes move one half of the face: only these are worth moving together.

    ``jawLeft`` and ``jawRight`` mirror each other, and yet both move the whole jaw: set to one
    weight they cancel.

    Parameters
    ----------
    offsets : (shapes, 3 * points) sparse array
        What each shape at 1 does.
    points : (points, 3) array
        The neutral face, symmetric about x = its middle.

    Returns
    -------
    (shapes,) bool array
    """
    x = np.asarray(points, np.float64)[:, 0]
    squared = sparse.csr_array(offsets.power(2))
    sides = np.repeat(np.column_stack([x > _middle(x), x <= _middle(x)]), 3, axis=0)
    shares = np.asarray(squared @ sides.astype(np.float64))
    total = shares.sum(axis=1)
    return np.asarray((total > 0) & (shares.max(axis=1) >= _ONE_SIDE_SHARE * total))


def _middle(x: FloatArray) -> float:
    return float((x.min() + x.max()) / 2) if len(x) else 0.0


def _swapped(name: str, match: re.Match[str]) -> str:
    """Put the other side in, in the same case."""
    found = match.group()
    other = _OTHER[found.lower()]
    if found.isupper():
        other = other.upper()
    elif found[0].isupper():
        other = other.capitalize()
    return name[: match.start()] + other + name[match.end() :]
