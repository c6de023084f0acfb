"""Evidence for blinks in the markers of a take.

Blinks are small, brief and seen by one or two markers. A marker in the fold above the lid follows
the brow; explained by the lid's shape it would close an open eye. So the evidence for blinks is
measured, and they are scaled to full closure or held at 0.
"""

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy import sparse

from usdface.core.arrays import FloatArray
from usdface.model.retarget.shape_names import read_meanings
from usdface.numerics.solve.peak_matching import (
    FULL_SHARE,
    ShapeEvidence,
    effective_size,
    shape_evidence,
)

_BLINK, _GAZE = "eyeblink", "eyelook"
"""Meanings of shape names. Every performer closes the eyes fully, so the motion of lid markers is
scaled to full closure; lids follow the eyes, so their markers show gaze."""


@dataclass(frozen=True)
class LidEvidence:
    """Evidence for blinks in the markers of a take."""

    shapes: tuple[int, ...]
    """Columns of the shapes that close the eyes."""
    seen: ShapeEvidence
    """Evidence for these shapes."""
    gaze: tuple[int, ...] = ()
    """Columns of the shapes that turn the eyes."""

    @property
    def closing(self) -> tuple[int, ...]:
        """Shapes with a marker on the lid, of a take that shows blinks."""
        if not self.seen.shown:
            return ()
        return tuple(np.array(self.shapes, np.int64)[self.seen.marked].tolist())

    @property
    def shows_no_blinks(self) -> bool:
        """Whether the markers on the lids follow other motion and show no blinks."""
        return bool(self.seen.marked.any()) and not self.seen.shown

    @property
    def fixed(self) -> tuple[int, ...]:
        """Shapes held at 0: blinks and gaze, if markers on the lids show no blinks.

        Without such markers only gaze is held: eyes close with the cheeks, which markers show.
        """
        if self.shows_no_blinks:
            return self.shapes + self.gaze
        return () if self.seen.shown or not self.shapes else self.gaze

    @property
    def tied(self) -> tuple[tuple[int, ...], ...]:
        """Shapes that share a weight: both blinks, if a lid has no marker."""
        together = len(self.shapes) == 2 and not self.seen.marked.all() and not self.shows_no_blinks
        return (self.shapes,) if together else ()

    def note(self, names: tuple[str, ...]) -> str:
        """Return a note on blinks for the animator; empty if the markers show them."""
        shapes, marked = [names[shape] for shape in self.shapes], self.seen.marked
        if not shapes or (marked.all() and self.seen.shown):
            return ""
        if not marked.any():
            alike = ", both eyes alike" if self.tied else ""
            return (
                f"no marker sits on an upper lid: {' and '.join(shapes)} are guessed from the "
                f"markers around the eyes{alike}; check blinks by the video"
            )
        gaze = ", and so does gaze" if self.gaze else ""
        if self.shows_no_blinks:
            own = max(int(100 * self.seen.mean_peak), 0)  # never the limit itself
            return (
                f"the markers show no blinks: of a full blink, {own}% is in the lids' "
                f"markers beyond what goes with brows and cheeks (from {FULL_SHARE:.0%} on it "
                f"would count). {' and '.join(shapes)} start at 0{gaze}: key them by the video"
            )
        bare = [name for name, there in zip(shapes, marked, strict=True) if not there]
        return f"no marker sits on the lid of {' and '.join(bare)}: it starts as the other eye's"


def find_lid_evidence(
    names: tuple[str, ...],
    offsets: sparse.csr_array,
    deltas: FloatArray,
    motion: Sequence[FloatArray],
    trust: FloatArray,
    *,
    lid_sides: Collection[str] = (),
) -> LidEvidence:
    """Measure the evidence for the shapes that close the eyes.

    Parameters
    ----------
    names : tuple of str
        Of the rig's shapes.
    offsets : (shapes, 3 * points) sparse array
        Displacements of the surface [mm].
    deltas : (shapes, markers, 3) float array
        Displacements of the markers [mm].
    motion : sequence of (frames, markers, 3) float array
        Of each take, in the character's space [mm]; differences between takes are no motion.
    trust : (markers,) float array
        0 for markers that are not used.
    lid_sides : collection of str
        Sides, ``'L'`` or ``'R'``, with a marker whose label names the upper lid.
    """
    blinks, gaze = _eye_shapes(names)
    full = list(blinks)
    surface = effective_size(offsets[full].toarray().reshape(len(full), offsets.shape[1] // 3, 3))
    labelled = np.array([side in lid_sides for side in blinks.values()], np.bool_)
    takes = [
        replace(
            shape_evidence(deltas, take, full, surface_mm=surface, marker_trust=trust),
            labelled=labelled,
        )
        for take in motion
        if len(take)
    ]
    seen = max(takes, key=lambda take: (take.shown, take.independent_peaks.sum()))
    return LidEvidence(tuple(full), seen, tuple(gaze))


def _eye_shapes(names: tuple[str, ...]) -> tuple[dict[int, str], list[int]]:
    """Return the columns of blinks with their sides, one for each, and those of gaze shapes."""
    meanings = read_meanings(names)
    blinks: dict[str, int] = {}
    for shape in sorted(range(len(names)), key=lambda shape: meanings[names[shape]].rank):
        if meanings[names[shape]].motion == _BLINK:
            blinks.setdefault(meanings[names[shape]].side, shape)
    gaze = [i for i, name in enumerate(names) if meanings[name].motion.startswith(_GAZE)]
    sides = [side for side in blinks if side] or list(blinks)
    return dict(sorted((blinks[side], side) for side in sides)), gaze
