"""Parts and sides of the face: of shapes by their names, of points by what moves them."""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from usdface.core.arrays import BoolArray, FloatArray, IntArray, index_of

if TYPE_CHECKING:
    from scipy import sparse


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
    squared = offsets.power(2)
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


REGIONS = ("brows", "lids", "cheeks and nose", "mouth", "jaw")

_GAZE = ("look", "gaze", "pupil", "eyeball")
_TONGUE = "tongue"

# Tried in this order: a cheek's squint is not the lids', a lip is not the chin's, a gaze no lid.
_WORDS: tuple[tuple[str, tuple[str, ...]], ...] = (
    ("", (*_GAZE, _TONGUE)),
    ("brows", ("brow",)),
    ("cheeks and nose", ("cheek", "nose", "nostril", "sneer")),
    ("lids", ("blink", "lid", "squint", "eyewide", "eye_wide", "eyeopen", "eyeclose")),
    ("mouth", ("mouth", "lip", "smile", "frown", "pucker", "funnel", "dimple", "viseme")),
    ("jaw", ("jaw", "chin")),
)

_LEAST_MOTION = 0.1
"""[of a shape's largest motion] With less it does not claim a point."""

_CARRIED = {"jaw": 0.85}
"""How much a claim counts: what the jaw carries along, the lower lip above all, is not its own."""


def region_of_shape(name: str) -> str:
    """Return the part of the face that a shape's name names; empty where it names none."""
    lowered = name.lower()
    for region, words in _WORDS:
        if any(word in lowered for word in words):
            return region
    return ""


def shapes_by_region(names: Sequence[str]) -> dict[str, IntArray]:
    """Return the columns of the shapes of each part of the face that has any."""
    found = np.array([region_of_shape(name) for name in names], dtype=object)
    columns = {region: np.flatnonzero(found == region) for region in REGIONS}
    return {region: shapes for region, shapes in columns.items() if len(shapes)}


def gaze_shapes(names: Sequence[str]) -> IntArray:
    """Return the columns of the shapes that turn the eyes, which markers do not show."""
    return np.flatnonzero([any(word in name.lower() for word in _GAZE) for name in names])


def tongue_shapes(names: Sequence[str]) -> IntArray:
    """Return the columns of the shapes of the tongue, which markers do not show."""
    return np.flatnonzero([_TONGUE in name.lower() for name in names])


def unseen_shapes(names: Sequence[str]) -> IntArray:
    """Return the columns of the shapes that markers do not show: gaze and tongue."""
    return np.concatenate([gaze_shapes(names), tongue_shapes(names)]).astype(np.int64)


def blinks(names: Sequence[str]) -> IntArray:
    """Return the columns of the shapes that shut an eye."""
    words = ("blink", "eyeclose", "eye_close", "lidclose", "lid_close")
    return np.flatnonzero([any(word in name.lower() for word in words) for name in names])


def jaw_opener(names: Sequence[str]) -> int | None:
    """Return the column of the shape that opens the jaw; None without such a name."""
    for column, name in enumerate(names):
        lowered = name.lower()
        if region_of_shape(name) == "jaw" and ("open" in lowered or "drop" in lowered):
            return column
    return None


def points_by_region(offsets: sparse.csr_array, names: Sequence[str]) -> dict[str, IntArray]:
    """Give each point to the part of the face whose shapes move it most.

    Shapes are compared by the share of their own largest motion, so that the jaw, which moves
    points by centimetres, does not take the lips from the mouth. It carries the tongue, which
    markers do not show: that is in no part, so that what it does by itself is no error of the jaw.

    Parameters
    ----------
    offsets : (shapes, 3 * points) sparse array
        What each shape at 1 does.
    names : sequence of str
        Of the shapes; see `region_of_shape`.

    Returns
    -------
    dict of str to int array
        Points of each part that has any; points that hardly move are in none, nor is the tongue.
    """
    shapes = shapes_by_region(names)
    regions = list(shapes)
    points = offsets.shape[1] // 3
    claims = np.zeros((len(regions) + 1, points))
    claims[-1] = _LEAST_MOTION
    for row, columns in enumerate((*shapes.values(), tongue_shapes(names))):
        carried = _CARRIED.get(regions[row], 1.0) if row < len(regions) else 1.0
        for shape in columns:
            moved = np.linalg.norm(offsets[[shape]].toarray().reshape(points, 3), axis=1)
            if moved.max() > 0:
                np.maximum(claims[row], carried * moved / moved.max(), out=claims[row])
    owner = claims.argmax(axis=0)
    owned = {region: np.flatnonzero(owner == row) for row, region in enumerate(regions)}
    return {region: points for region, points in owned.items() if len(points)}


def region_gram(key_offsets: sparse.csr_array, points: IntArray) -> FloatArray:
    """Return what small errors of keys do to some points.

    Parameters
    ----------
    key_offsets : (keys, 3 * points) sparse array
    points : (n,) int array

    Returns
    -------
    (keys, keys) float array
        ``G`` such that ``sqrt(e @ G @ e)`` is the root mean square distance of those points.
    """
    from scipy import sparse  # only when wanted: it takes half a second

    columns = (3 * points[:, None] + np.arange(3)).ravel()
    part = sparse.csr_array(key_offsets.tocsc()[:, columns])
    return np.asarray((part @ part.T).toarray()) / max(len(points), 1)
