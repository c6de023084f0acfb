"""What the parts of the cage are laid into: points, quads and marks of the left half."""

from enum import IntEnum

import numpy as np

from usdface.core.arrays import FloatArray


class Mark(IntEnum):
    """Columns of the attributes that the cage's points carry."""

    SETTLE = 0
    """1 where the point belongs on the sculpted form, 0 where the cage itself is the form."""
    MOUTH_RING = 1
    """0 where the lips meet, 1 fullest lip, 2 border of the red, 4 outermost; below 0 inside."""
    MOUTH_SIDE = 2
    """+1 upper lip, -1 lower lip, 0 corner and elsewhere."""
    EYE_RING = 3
    """0 on the edge of the lid, 1 middle of the lid, 2 crease, 4 outermost; below 0 behind."""
    EYE_SIDE = 4
    """+1 upper lid, -1 lower lid, 0 corners and elsewhere."""
    NOSTRIL = 5
    """1 deep in the nostril."""


FAR = 9.0
"""Ring number of points that belong to no ring."""


class HalfCage:
    """Collects the points and quads of the left half of a cage."""

    def __init__(self) -> None:
        self.points: list[FloatArray] = []
        self.marks: list[FloatArray] = []
        self.faces: list[tuple[int, int, int, int]] = []

    def point(self, position: FloatArray, **marks: float) -> int:
        """Add a point; marks by their lower-case names. Returns its index."""
        values = np.zeros(len(Mark))
        values[Mark.SETTLE] = 1.0
        values[[Mark.MOUTH_RING, Mark.EYE_RING]] = FAR
        for name, value in marks.items():
            values[Mark[name.upper()]] = value
        self.points.append(np.asarray(position, float))
        self.marks.append(values)
        return len(self.points) - 1

    def mark(self, index: int, mark: Mark, value: float) -> None:
        """Change one mark of a point."""
        self.marks[index][mark] = value

    def strip(self, first: list[int], second: list[int]) -> None:
        """Join two rows of the same length by quads that look out if the second lies above."""
        for k in range(len(first) - 1):
            self.faces.append((first[k], first[k + 1], second[k + 1], second[k]))
