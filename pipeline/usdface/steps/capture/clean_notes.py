"""Notes, summary and figures of the repairs of a cleaned take."""

import numpy as np

from usdface.core.arrays import runs
from usdface.core.assets import Markers, Take
from usdface.core.text import first_few, frame_ranges, pluralize
from usdface.numerics.motion.noise import still_range_mm
from usdface.numerics.repair.cleaning import CleanedMarkers
from usdface.numerics.repair.slips import MOST_SLIP_MM

_LISTED_SWAPS = 20
"""Repairs listed; further ones are counted."""


def cleaning_notes(cleaned: CleanedMarkers, markers: Markers, take: Take) -> list[str]:
    """Return notes on the repairs and what was left."""
    slips = [
        f"{markers.names[slip.marker]} slipped on the skin by {slip.distance_mm:.1f} mm near frame "
        f"{take.first_frame + slip.row}: "
        + (
            "corrected to its position in the neutral frame"
            if slip.distance_mm <= MOST_SLIP_MM
            else "too far to be corrected; check it, and leave it out unless its skin moved so far"
        )
        for slip in cleaned.slips
    ]
    return _still_notes(cleaned) + slips + _repairs(cleaned, markers, take)


def _still_notes(cleaned: CleanedMarkers) -> list[str]:
    """Return a note if no marker moves on the head, as the take is static or frozen."""
    still = still_range_mm([cleaned.positions], cleaned.noise_mm)
    if still is None:
        return []
    return [
        f"no marker moves on the head (at most {still:.2f} mm along an axis, at "
        f"{cleaned.noise_mm:.2f} mm of noise): the take shows one expression, and references "
        "cannot be selected from it alone; if the face did move, the export lost its motion (a "
        "static pose, a frozen stream): export and ingest it again"
    ]


def _repairs(cleaned: CleanedMarkers, markers: Markers, take: Take) -> list[str]:
    notes = []
    names, first = markers.names, take.first_frame
    for swap in cleaned.swaps[:_LISTED_SWAPS]:
        frames = frame_ranges([(first + swap.start, first + swap.stop - 1)])
        notes.append(f"{frames}: labels {names[swap.first]} and {names[swap.second]} were swapped")
    if len(cleaned.swaps) > _LISTED_SWAPS:
        notes.append(f"and {len(cleaned.swaps) - _LISTED_SWAPS} more swaps")
    left = [
        f"{name} ({frame_ranges((first + a, first + b - 1) for a, b in runs(track))})"
        for name, track in zip(names, cleaned.lost.T, strict=True)
        if track.any()
    ]
    missing = ~cleaned.visible
    if left:
        unfilled = int((missing & cleaned.lost).sum())
        gaps = f", {pluralize(unfilled, 'sample')} too long to fill, with confidence 0"
        notes.append(
            f"left the face: {first_few(left)}; treated as gaps{gaps if unfilled else ''}. "
            "Export later takes without a marker that fell off"
        )
    if cleaned.outliers.any():
        counts = cleaned.outliers.sum(axis=0)
        whose = "of" if np.count_nonzero(counts) == 1 else "most of them of"
        outliers = pluralize(int(counts.sum()), "outlier")
        notes.append(f"replaced {outliers}, {whose} {names[int(counts.argmax())]}")
    missing &= ~cleaned.lost
    if missing.any():
        whose = first_few([names[i] for i in np.flatnonzero(missing.any(axis=0))])
        notes.append(
            f"{pluralize(int(missing.sum()), 'sample')} in gaps too long to fill, with confidence "
            f"0 ({whose}): weights may jump where they begin and end; raise --max-gap to fill them"
        )
    no_pose = np.flatnonzero(cleaned.pose_confidence < 1.0)
    if len(no_pose):
        notes.append(
            f"too few rigid markers off a line in {pluralize(len(no_pose), 'frame')}, the first "
            f"{take.first_frame + int(no_pose[0])}; there the head's pose follows the other "
            "markers, or is interpolated where few are seen"
        )
    return notes


def cleaning_summary(cleaned: CleanedMarkers, take: Take) -> str:
    """Return the repairs in one sentence."""
    return (
        f"{take.name}: head motion removed, {pluralize(len(cleaned.swaps), 'swap')} relabelled, "
        f"{pluralize(int(cleaned.outliers.sum()), 'outlier')} replaced, "
        f"{pluralize(int(cleaned.filled.sum()), 'missing sample')} filled, noise "
        f"{cleaned.noise_mm:.2f} mm"
    )


def cleaning_figures(cleaned: CleanedMarkers, rigid: tuple[str, ...]) -> dict[str, object]:
    """Return the same as plain data."""
    return {
        "swaps": len(cleaned.swaps),
        "outliers": int(cleaned.outliers.sum()),
        "lost": int(cleaned.lost.sum()),
        "filled": int(cleaned.filled.sum()),
        "left": int((~cleaned.visible).sum()),
        "noise_mm": cleaned.noise_mm,
        "rigid": list(rigid),
    }
