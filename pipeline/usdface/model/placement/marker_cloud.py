"""A performer's markers before they are placed: their rest, their motion, their symmetry."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from usdface.core.arrays import BoolArray, FloatArray, RealArray
from usdface.core.text import first_few
from usdface.model.placement.label_hints import label_hint, mirror_partners, side_of_label
from usdface.numerics.registration.marker_binding import FEWEST_MARKERS
from usdface.numerics.registration.sagittal_plane import (
    FEWEST_PAIRS,
    SagittalPlane,
    plane_by_reflection,
    plane_of_pairs,
)
from usdface.numerics.regression.reference_design import design_k_centre

_PICKED_FRAMES = 150
"""Frames used by a placement: those that differ most from each other."""

_POOL_FRAMES = 3000
"""Evenly spaced frames of the take from which these are picked."""

_FEWEST_OF_A_SIDE = 4
"""Fewest markers labelled on one side, and none on the other, that are not symmetric."""

_MIDDLE_REGIONS = ("forehead", "brow", "bridge", "nose", "mouth", "chin")


@dataclass(frozen=True)
class MarkerCloud:
    """A performer's markers before placement: labels, neutral positions and motion."""

    labels: tuple[str, ...]
    neutral: FloatArray
    """(markers, 3): neutral positions, Y roughly up, any yaw [mm]."""
    motion: FloatArray
    """(frames, markers, 3): displacements from `neutral`, of frames that differ, perhaps none [mm].
    """
    still: BoolArray
    """(markers,): markers whose motion is not used: rigid ones, and those without any."""

    def levelled(self) -> tuple[FloatArray, FloatArray]:
        """Return the rotation that levels the cloud, and the cloud with its plane at x = 0."""
        plane = _plane(self.neutral, self.labels)
        frame = plane.levelled_frame()
        return frame, self.neutral @ frame.T - [plane.offset, 0.0, 0.0]


def marker_cloud(
    labels: tuple[str, ...],
    neutral: FloatArray,
    positions: RealArray,
    *,
    visible: BoolArray | None = None,
    rigid: Sequence[int] = (),
) -> MarkerCloud:
    """Return the marker cloud of a stabilised take.

    Parameters
    ----------
    neutral : (markers, 3) float array
        [mm]
    positions : (frames, markers, 3) float array
        Stabilised, in the space of `neutral` [mm]; frames that differ are picked.
    visible : (frames, markers) bool array, optional
        Frames that miss markers are avoided.
    rigid : sequence of int
        Markers that move with the skull alone.
    """
    count = len(neutral)
    if count < FEWEST_MARKERS:
        raise ValueError(f"registration needs at least {FEWEST_MARKERS} markers, got {count}")
    still = np.zeros(count, np.bool_)
    still[list(rigid)] = True
    return MarkerCloud(labels, neutral, _pick_frames(neutral, positions, visible, still), still)


def _pick_frames(
    neutral: FloatArray, positions: RealArray, visible: BoolArray | None, still: BoolArray
) -> FloatArray:
    """Return the displacements of frames that differ most from each other."""
    rows = np.arange(len(positions))
    if not len(rows):
        return np.zeros((0, *neutral.shape))
    if visible is not None:
        seen = np.asarray(visible, bool).mean(axis=1)
        rows = np.flatnonzero(seen >= min(0.999, float(np.quantile(seen, 0.5))))
    moved = positions[rows[:: max(1, len(rows) // _POOL_FRAMES)]] - neutral
    moved[:, still] = 0
    flat = moved.reshape(len(moved), -1)
    count = min(_PICKED_FRAMES, len(flat))
    return np.asarray(moved[design_k_centre(flat, count).chosen], float)


def _plane(neutral: FloatArray, labels: tuple[str, ...]) -> SagittalPlane:
    row_of = {label: row for row, label in enumerate(labels)}
    pairs = [
        (row_of[label], row_of[partner])
        for label, partner in mirror_partners(labels).items()
        if side_of_label(label) == "L"
    ]
    if len(pairs) >= FEWEST_PAIRS:
        return plane_of_pairs(neutral, np.array(pairs), np.array(middle_markers(labels), np.int64))
    left, right = (_rows_by_region(labels, side) for side in "LR")
    if not (left and right) and sum(map(len, (left | right).values())) >= _FEWEST_OF_A_SIDE:
        # A reflection would pair the markers of one cheek.
        named = [labels[row] for rows in (left or right).values() for row in rows]
        raise ValueError(
            f"labels name markers of the {'left' if left else 'right'} side only "
            f"({first_few(named)}), which have no plane of symmetry; label the other side's "
            "markers, or give landmarks"
        )
    try:
        return plane_by_reflection(neutral)
    except ValueError:  # few markers, none opposite another
        both = sorted(left.keys() & right.keys())
        if len(both) < FEWEST_PAIRS:
            raise
        centres = [neutral[rows[region]].mean(axis=0) for region in both for rows in (left, right)]
        opposite = np.arange(len(centres)).reshape(-1, 2)
        return plane_of_pairs(np.array(centres), opposite, np.zeros(0, np.int64))


def _rows_by_region(labels: tuple[str, ...], side: str) -> dict[str, list[int]]:
    """Return the rows of the markers of a side, by the region that their labels name."""
    rows: dict[str, list[int]] = {}
    for row, hint in enumerate(map(label_hint, labels)):
        if hint.region and hint.side == side:
            rows.setdefault(hint.region, []).append(row)
    return rows


def middle_markers(labels: tuple[str, ...]) -> list[int]:
    """Return the columns of markers on the midline: of a middle region, without a side."""
    return [
        row
        for row, label in enumerate(labels)
        if not side_of_label(label) and label_hint(label).region in _MIDDLE_REGIONS
    ]
