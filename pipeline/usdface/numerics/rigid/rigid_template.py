"""Alignment of the frames of a stabilised take by other rigid markers than those of its cleaning.

Where no markers are rigid, each set follows the skin in its own way, and takes whose head motion
was removed by different sets differ in more than a constant. Detected sets differ between takes.
"""

from dataclasses import dataclass, replace

import numpy as np

from usdface.core.arrays import BoolArray, Float32Array, FloatArray, IntArray, median_places
from usdface.numerics.rigid.rigid_alignment import align_rigid, align_rigid_robust, remove_motion

_OUTLIER_WEIGHT = 0.25
"""Geman-McClure weight of a residual as large as their scale."""


@dataclass(frozen=True)
class RigidTemplate:
    """Median places of rigid markers in a take without head motion."""

    columns: IntArray
    """(n,): of the markers."""
    places: FloatArray
    """(n, 3) [mm]"""

    @classmethod
    def from_sample(
        cls, positions: Float32Array, visible: BoolArray, columns: IntArray
    ) -> "RigidTemplate | None":
        """Take medians over a sample of frames, without markers that are loose in the take.

        None if fewer than three are left, or these are collinear.
        """
        columns = columns[visible[:, columns].any(axis=0)]
        seen, body = visible[:, columns], positions[:, columns]
        places = median_places(body, seen)
        weights = align_rigid_robust(body, places, visible=seen).weights
        kept = weights.sum(axis=0) >= _OUTLIER_WEIGHT * seen.sum(axis=0)
        template = cls(columns[kept], places[kept])
        is_determined = align_rigid(template.places[None], template.places).determined[0]
        return template if is_determined else None

    def align(self, positions: Float32Array, visible: BoolArray) -> Float32Array:
        """Return frames aligned with the template, those of fewer than three markers as they are.

        Shapes are (frames, markers, 3) and (frames, markers).
        """
        body, seen = positions[:, self.columns], visible[:, self.columns]
        alignment = align_rigid(body, self.places, weights=seen)
        still = np.where(alignment.determined[:, None], alignment.translations, 0.0)
        moved = remove_motion(positions, replace(alignment, translations=still))
        return np.asarray(moved, np.float32)
