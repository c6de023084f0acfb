"""What a performer's markers tell of blinks, and what that means for the weights proposed.

Blinks are small, brief and all-important, and seen by one marker or two. A marker in the fold above
the lid rises and falls with the brow; explained by the lid's shape it closes an eye that was open.
"""

from dataclasses import dataclass

import numpy as np
from scipy import sparse

from usdface.core.arrays import FloatArray
from usdface.numerics.solve.peak_matching import (
    FULL_SHARE,
    ShapeEvidence,
    effective_size,
    shape_evidence,
)

FULL_SHAPES = "eyeblink"
"""Shapes that every performer does in full: their markers' motion is scaled to reach the top."""


@dataclass(frozen=True)
class LidEvidence:
    """What the markers tell of blinks."""

    shapes: tuple[int, ...]
    """Columns of the shapes that close the eyes."""
    seen: ShapeEvidence
    """Of these shapes."""

    @property
    def closing(self) -> tuple[int, ...]:
        """Shapes whose marker shows blinks."""
        if not self.seen.shown:
            return ()
        return tuple(np.array(self.shapes, np.int64)[self.seen.marked].tolist())

    @property
    def fixed(self) -> tuple[int, ...]:
        """Shapes left at rest: the markers on the lids show no blinks, but the motion of others."""
        return self.shapes if self.seen.marked.any() and not self.seen.shown else ()

    @property
    def tied(self) -> tuple[tuple[int, ...], ...]:
        """Shapes that share a weight: a lid without a marker does as the other eye's."""
        together = len(self.shapes) == 2 and not self.seen.marked.all() and not self.fixed
        return (self.shapes,) if together else ()

    def note(self, names: tuple[str, ...]) -> str:
        """Say what an animator should know of blinks; empty where the markers show them."""
        shapes, marked = [names[shape] for shape in self.shapes], self.seen.marked
        if not shapes or (marked.all() and self.seen.shown):
            return ""
        if not marked.any():
            alike = ", both eyes alike" if self.tied else ""
            return (
                f"no marker sits on an upper lid: {' and '.join(shapes)} are guessed from the "
                f"markers around the eyes{alike}; check blinks by the video"
            )
        if self.fixed:
            own = float(self.seen.own_peaks[marked].mean())
            return (
                f"the markers show no blinks: of a full blink, {max(own, 0.0):.0%} is in the lids' "
                f"markers beyond what goes with brows and cheeks (from {FULL_SHARE:.0%} on it "
                f"would count). {' and '.join(shapes)} start at 0: key blinks by the video"
            )
        bare = [name for name, there in zip(shapes, marked, strict=True) if not there]
        return f"no marker sits on the lid of {' and '.join(bare)}: it starts as the other eye's"


def find_lid_evidence(
    names: tuple[str, ...],
    offsets: sparse.csr_array,
    deltas: FloatArray,
    motion: FloatArray,
    trust: FloatArray,
) -> LidEvidence:
    """Measure what markers tell of the shapes that close the eyes.

    Parameters
    ----------
    names : tuple of str
        The rig's shapes.
    offsets : (shapes, 3 * points) sparse array
        What they do to its surface [mm].
    deltas : (shapes, markers, 3) float array
        What they do to the markers [mm].
    motion : (frames, markers, 3) float array
        In the character's space [mm].
    trust : (markers,) float array
        0 for markers that are not looked at.
    """
    full = [i for i, name in enumerate(names) if name.lower().startswith(FULL_SHAPES)]
    surface = effective_size(offsets[full].toarray().reshape(len(full), offsets.shape[1] // 3, 3))
    seen = shape_evidence(deltas, motion, full, surface_mm=surface, marker_trust=trust)
    return LidEvidence(tuple(full), seen)
