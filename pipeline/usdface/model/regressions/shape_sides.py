"""Shapes with negative weights: two shapes, each from rest to one end of the range.

Displacements saturate away from rest, on either side, and a performer's jaw may move farther to the
left than to the right. The model of a mapping therefore has a column for each side of such a shape,
with weights from 0 to the distance of the end from rest; their difference is the shape's weight.
"""

from dataclasses import dataclass, replace

import numpy as np

from usdface.core.arrays import Arrays, FloatArray, IntArray
from usdface.core.assets import References

JOINED_OUTPUTS = "joined_outputs"
"""Array of mappings whose method predicts weights of shapes; without it, those of columns, as in
earlier versions. Both are the same without weights below 0."""


@dataclass(frozen=True)
class ShapeSides:
    """Columns of a model: one of each shape in order, then the negative sides of those with two."""

    limits: FloatArray
    """(shapes, 2): lowest and highest weight of each shape."""
    shapes: IntArray
    """(columns,): shape of each column."""
    signs: FloatArray
    """(columns,): -1 for weights below 0, else 1."""

    @classmethod
    def undivided(cls, limits: FloatArray) -> "ShapeSides":
        """Return one column for each shape."""
        return cls(limits, np.arange(len(limits)), np.ones(len(limits)))

    @classmethod
    def divided(cls, limits: FloatArray) -> "ShapeSides":
        """Return a column for each side of rest."""
        low, high = limits.T
        both = np.flatnonzero((low < 0) & (high > 0))
        return cls(
            limits,
            np.concatenate([np.arange(len(limits)), both]),
            np.concatenate([np.where(high > 0, 1.0, -1.0), -np.ones(len(both))]),
        )

    @classmethod
    def from_arrays(cls, arrays: Arrays, limits: FloatArray) -> "ShapeSides":
        """Rebuild the sides from the arrays of a mapping; earlier versions divided no shape."""
        if "shape_sides" not in arrays:
            return cls.undivided(limits)
        shapes, signs = arrays["shape_sides"].T
        return cls(limits, shapes.astype(np.int64), signs)

    def to_arrays(self) -> Arrays:
        """Return the sides as arrays of a mapping, the input of `from_arrays`."""
        return {"shape_sides": np.stack([self.shapes.astype(float), self.signs], axis=1)}

    @property
    def ranges(self) -> FloatArray:
        """Lowest and highest weight of each column: (columns, 2)."""
        low, high = self.limits[self.shapes].T
        divided = np.isin(self.shapes, self.shapes[self.signs < 0])
        return np.stack([np.where(divided, 0.0, low), np.where(self.signs < 0, -low, high)], axis=1)

    def split(self, weights: FloatArray) -> FloatArray:
        """Return the weights of the columns within their ranges: (frames, columns)."""
        return np.asarray(np.clip(self.signs * weights[:, self.shapes], *self.ranges.T))

    def join(self, columns: FloatArray) -> FloatArray:
        """Return the weights of the shapes: (frames, shapes)."""
        count = len(self.limits)
        weights = self.signs[:count] * columns[:, :count]
        weights[:, self.shapes[count:]] -= columns[:, count:]
        return np.asarray(np.clip(weights, *self.limits.T))

    def motion(self, skin: FloatArray) -> FloatArray:
        """Return displacements by each column at 1, from those by each shape, (shapes, ...)."""
        signs = self.signs.reshape(-1, *(1,) * (skin.ndim - 1))
        return np.asarray(signs * skin[self.shapes])

    def gram(self, gram: FloatArray) -> FloatArray:
        """Return the Gram matrix of the columns, from that of the shapes."""
        return np.asarray(np.outer(self.signs, self.signs) * gram[np.ix_(self.shapes, self.shapes)])

    def references(self, references: References) -> References:
        """Return references with the weights of the columns, whose second sides have other names.

        Sides of a shape are in the same part of the face.
        """
        if (self.signs > 0).all():
            return references
        names, parts = references.shape_names, references.parts or references.shape_names
        second = tuple(f"{names[shape]} below 0" for shape in self.shapes[len(names) :])
        return replace(
            references,
            weights=self.split(references.weights),
            shape_names=(*names, *second),
            parts=tuple(parts[shape] for shape in self.shapes),
        )
