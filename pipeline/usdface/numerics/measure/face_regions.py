"""Regions and sides of the face: of shapes by their names, of points by the shapes' offsets."""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from usdface.core.arrays import BoolArray, FloatArray, IntArray, coordinates_of, index_of

if TYPE_CHECKING:
    from scipy import sparse


# Sides in names: a word, or a separate letter. Matches are replaced one at a time, so that a name
# with two of them finds its partner; a syllable that is no side leads to no name of the rig.
_SIDES = (
    "left right, lft rgt, lf rt, l r, izquierda derecha, izq der, links rechts, li re, "
    "gauche droite, sinistra destra, sx dx, 左 右, 좌 우"
)
_PAIRS = [pair.split() for pair in _SIDES.split(", ")]
_OTHER = {one: other for pair in _PAIRS for one, other in (pair, pair[::-1])}
_WORD = re.compile("|".join(side for side in _OTHER if side not in ("l", "r")), re.IGNORECASE)
_LETTER = re.compile(
    r"(?<=[_.\-])[lrLR](?=$|[_.\-\d])"  # brow_L, brow_l_01
    r"|^[lrLR](?=[_.\-])"  # L_brow
    r"|^[lr](?=[A-Z])"  # lBrow
    r"|(?<=[a-z0-9])[LR](?=$|[_.\-\d])"  # browL
)

_ONE_SIDE_SHARE = 0.8
"""[of a shape's squared displacement] Least share on one side of a one-sided shape."""


def mirrored_shapes(names: Sequence[str]) -> IntArray:
    """Return the index of each shape's mirror image, or its own index if there is none.

    Returns (shapes,), an involution: ``partner[partner] == arange(shapes)``.

    Parameters
    ----------
    names : sequence of str
        ``browDown_L`` and ``browDown_R``, ``mouthSmileLeft`` and ``mouthSmileRight``,
        ``l_brow_down`` and ``r_brow_down``.
    """
    place = index_of(names)
    partner = np.arange(len(names))
    for index, name in enumerate(names):
        for match in (*_WORD.finditer(name), *_LETTER.finditer(name)):
            other = place.get(swap_side(name, match), index)
            if other != index and partner[index] == index and partner[other] == other:
                partner[index], partner[other] = other, index
                break
    return partner


def sided_shapes(offsets: sparse.csr_array, points: ArrayLike) -> BoolArray:
    """Return which shapes move one half of the face alone: (shapes,).

    Mirrored shapes such as ``jawLeft`` and ``jawRight``, which move the whole jaw, cancel when they
    are set together.

    Parameters
    ----------
    offsets : (shapes, 3 * points) sparse array
        Displacements by each shape at 1.
    points : (points, 3) array
        The neutral face, symmetric about the middle of its range in x.
    """
    x = np.asarray(points, np.float64)[:, 0]
    squared = offsets.power(2)
    middle = (x.min() + x.max()) / 2 if len(x) else 0.0
    sides = np.repeat(np.column_stack([x > middle, x <= middle]), 3, axis=0)
    shares = np.asarray(squared @ sides.astype(np.float64))
    total = shares.sum(axis=1)
    return np.asarray((total > 0) & (shares.max(axis=1) >= _ONE_SIDE_SHARE * total))


def swap_side(name: str, match: re.Match[str], group: str | int = 0) -> str:
    """Return the name with the matched side replaced by the other, in the same case."""
    side = match.group(group)
    other = _OTHER[side.lower()]
    if side.isupper():
        other = other.upper()
    elif side[0].isupper():
        other = other.capitalize()
    return name[: match.start(group)] + other + name[match.end(group) :]


REGIONS = ("brows", "lids", "cheeks and nose", "mouth", "jaw")

_GAZE = ("look", "gaze", "pupil", "eyeball")
_TONGUE = "tongue"

# Tested in this order: "cheekSquint" is not the lids', "lipChin" not the chin's, "eyeLook" no lid.
_WORDS: tuple[tuple[str, tuple[str, ...]], ...] = (
    ("", (*_GAZE, _TONGUE)),
    ("brows", ("brow",)),
    ("cheeks and nose", ("cheek", "nose", "nostril", "sneer")),
    ("lids", ("blink", "lid", "squint", "eyewide", "eye_wide", "eyeopen", "eyeclose")),
    ("mouth", ("mouth", "lip", "smile", "frown", "pucker", "funnel", "dimple", "viseme")),
    ("jaw", ("jaw", "chin")),
)

_NO_PARTS = re.compile("slide|flip")
"""Words that contain a lid and a lip."""

_LEAST_MOTION = 0.1
"""[of a shape's largest displacement] Least for a point to belong to the shape's region."""

_CARRIED = {"jaw": 0.85}
"""Weight of a region's displacements: those of the jaw include the lower lip."""


def region_of_shape(name: str) -> str:
    """Return the region of the face in a shape's name, or an empty string."""
    lowered = _NO_PARTS.sub("", name.lower())
    for region, words in _WORDS:
        if any(word in lowered for word in words):
            return region
    return ""


def shapes_by_region(names: Sequence[str]) -> dict[str, IntArray]:
    """Return the columns of the shapes of each region that has any."""
    of_shapes = np.array([region_of_shape(name) for name in names], dtype=object)
    columns = {region: np.flatnonzero(of_shapes == region) for region in REGIONS}
    return {region: shapes for region, shapes in columns.items() if len(shapes)}


def gaze_shapes(names: Sequence[str]) -> IntArray:
    """Return the columns of the shapes that turn the eyes, which markers do not observe."""
    return _with_word(names, _GAZE)


def tongue_shapes(names: Sequence[str]) -> IntArray:
    """Return the columns of the shapes of the tongue, which markers do not observe."""
    return _with_word(names, (_TONGUE,))


def gaze_and_tongue_shapes(names: Sequence[str]) -> IntArray:
    """Return the columns of the shapes of gaze and tongue, which markers do not show."""
    return np.concatenate([gaze_shapes(names), tongue_shapes(names)]).astype(np.int64)


def blinks(names: Sequence[str]) -> IntArray:
    """Return the columns of the shapes that close an eye."""
    return _with_word(names, ("blink", "eyeclose", "eye_close", "lidclose", "lid_close"))


def _with_word(names: Sequence[str], words: Sequence[str]) -> IntArray:
    return np.flatnonzero([any(word in name.lower() for word in words) for name in names])


def jaw_opener(names: Sequence[str]) -> int | None:
    """Return the column of the shape that opens the jaw, by its name, or None."""
    for column, name in enumerate(names):
        lowered = name.lower()
        if region_of_shape(name) == "jaw" and ("open" in lowered or "drop" in lowered):
            return column
    return None


def points_by_region(offsets: sparse.csr_array, names: Sequence[str]) -> dict[str, IntArray]:
    """Return the points of each region: those that its shapes move most.

    Displacements are relative to the largest of their shape, so that the jaw, which moves points by
    centimetres, does not take the lips from the mouth. The tongue, which the jaw moves and markers
    do not observe, and points that hardly move are in no region. Returns the points of each region
    that has any.

    Parameters
    ----------
    offsets : (shapes, 3 * points) sparse array
        Displacements by each shape at 1.
    names : sequence of str
        Of the shapes; see `region_of_shape`.
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
    """Return the quadratic form of the mean squared displacement of some points by errors of keys.

    Key offsets are (keys, 3 * points). Returns (keys, keys) ``G`` such that ``sqrt(e @ G @ e)`` is
    the root mean square distance of those points.
    """
    part = key_offsets[:, coordinates_of(points)]
    return np.asarray((part @ part.T).toarray()) / max(len(points), 1)
