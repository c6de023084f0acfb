"""Moments to review first: the frames of a take with the largest error, known or expected.

With keys, frames are ranked by the error against them. Otherwise the score is an expected error,
root mean square over the surface [mm]::

    score^2 = uncertainty^2 + jump^2 + lips (gap / 2)^2

jump: distance of the surface from the mean of the frames before and after.
gap: opening of lips that are closed in the capture; each lip is off by half of it.
lips: share of the rig's points that are on the lips.
"""

from dataclasses import dataclass

import numpy as np

from usdface.core.arrays import FloatArray, spaced_rows
from usdface.model.review.verdict import SolveEvidence
from usdface.numerics.regression.cross_validation import surface_errors_mm

MOMENT_SECONDS = 0.25
"""Minimum distance of two moments: about the duration of a blink or a plosive."""

LEAST_JUMP_MM = 0.05
"""Smallest visible jump; without uncertainty, only the largest jump below it is listed."""


@dataclass(frozen=True)
class Moment:
    """A moment to review."""

    row: int
    """Row of the frame with the largest score."""
    region: str
    """Region of the face with the largest error; empty if unknown."""
    reason: str


@dataclass(frozen=True)
class ReviewSignals:
    """Quantities from which the score is computed."""

    evidence: SolveEvidence
    jump_mm: FloatArray
    """(frames, regions): see `surface_jumps`."""
    gap_mm: FloatArray | None = None
    """(frames,): opening of lips that should be closed, else 0."""
    lip_share: float = 1.0
    """Share of the rig's points that are on the lips."""
    jump_regions: tuple[str, ...] = ()
    """Regions of the jumps, if they differ from those of the evidence."""

    @property
    def score_mm(self) -> FloatArray:
        """Return the score of each frame: (frames,) [mm]; with keys, NaN for frames without."""
        if self.evidence.error_mm is not None:
            return self.evidence.error_mm[:, 0]
        squared = self.expected_mm[:, 0] ** 2 + self.jump_mm[:, 0] ** 2
        if self.gap_mm is not None:
            squared += self.lip_share * (self.gap_mm / 2) ** 2
        return np.asarray(np.sqrt(squared))

    @property
    def expected_mm(self) -> FloatArray:
        """Return the uncertainty, 0 if it is not known: (frames, regions) [mm]."""
        uncertainty_mm = self.evidence.uncertainty_mm
        return np.zeros_like(self.jump_mm) if uncertainty_mm is None else uncertainty_mm

    def moment(self, row: int) -> Moment:
        """Return the moment at a row, with its region and reason: figures are the region's."""
        evidence = self.evidence
        if evidence.error_mm is not None:
            region, error = _largest_region(evidence.regions, evidence.error_mm[row])
            return Moment(row, region, f"{error:.2f} mm off the keys")
        gap = 0.0 if self.gap_mm is None else float(self.gap_mm[row])
        jump, expected = float(self.jump_mm[row, 0]), float(self.expected_mm[row, 0])
        lips = f"lips {gap:.1f} mm open, the performer's closed" if gap > LEAST_JUMP_MM else ""
        if gap / 2 * self.lip_share**0.5 > max(jump, expected):
            return Moment(row, "mouth", lips)
        if jump > expected:
            region, most = _largest_region(self.jump_regions or evidence.regions, self.jump_mm[row])
            reason = f"jumps by {most:.2f} mm"
        else:
            region, _ = _largest_region(evidence.regions, self.expected_mm[row])
            reason = "" if evidence.uncertainty_mm is None else _expected(evidence, row, region)
        return Moment(row, region, ", ".join(filter(None, [reason, lips])))


def _expected(evidence: SolveEvidence, row: int, region: str) -> str:
    column = evidence.regions.index(region) if region in evidence.regions else 0
    words = []
    if evidence.uncertainty_mm is not None:
        column = min(column, evidence.uncertainty_mm.shape[1] - 1)
        words.append(f"uncertainty {evidence.uncertainty_mm[row, column]:.2f} mm")
    if evidence.coverage is not None:
        words.append(f"coverage {evidence.coverage[row, column]:.0%}")
    return ", ".join(words)


def _largest_region(regions: tuple[str, ...], values: FloatArray) -> tuple[str, float]:
    """Return the region with the largest value, and the value.

    If there is only the whole face, or no region has a value: no name, and the face's.
    """
    named = np.nan_to_num(values[1 : len(regions)])
    if not named.any():
        return "", float(values[0])
    most = int(named.argmax())
    return regions[1 + most], float(named[most])


def review_moments(signals: ReviewSignals, count: int, *, rate: float) -> list[Moment]:
    """Return the moments to review first, the worst first.

    Parameters
    ----------
    count : int
        Maximum number of moments.
    rate : float
        Frames per second; two moments are at least `MOMENT_SECONDS` apart.
    """
    score = np.nan_to_num(signals.score_mm, nan=-1.0)
    distance = max(round(MOMENT_SECONDS * rate), 1)
    evidence, rows = signals.evidence, list[int]()
    jumps_alone = evidence.error_mm is None and evidence.uncertainty_mm is None
    order = np.argsort(-score, kind="stable")
    for row in spaced_rows(order[score[order] >= 0], distance):
        if len(rows) >= count or (rows and jumps_alone and score[row] < LEAST_JUMP_MM):
            break
        rows.append(row)
    return [signals.moment(row) for row in rows]


def surface_jumps(weights: FloatArray, grams: FloatArray) -> FloatArray:
    """Return the distance of the surface from the mean of the frames before and after.

    Returns (frames, regions), the root mean square over each region's points [mm]; 0 at the ends.

    Parameters
    ----------
    weights : (frames, shapes) float array
    grams : (regions, shapes, shapes) float array
        [mm^2]
    """
    off = np.zeros_like(weights)
    off[1:-1] = weights[1:-1] - (weights[:-2] + weights[2:]) / 2
    return region_distances(off, grams)


def region_distances(off: FloatArray, grams: FloatArray) -> FloatArray:
    """Return the displacement of each region by differences of weights: (frames, regions) [mm].

    Parameters
    ----------
    off : (frames, shapes) float array
        Differences of weights; NaN if unknown.
    grams : (regions, shapes, shapes) float array
        [mm^2]
    """
    return np.stack([surface_errors_mm(off, gram) for gram in grams], axis=1)
