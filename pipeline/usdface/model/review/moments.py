"""What to review first: the moments of a take whose error is, or is likely to be, the largest.

Where keys are known, frames are ranked by the error against them. Elsewhere by what may be off, as
a distance that somebody would see [mm]::

    score^2 = (uncertainty / coverage)^2 + jump^2 + (gap / 2)^2 lips

Coverage is the share of the motion that references determine: the error that is expected of that
share grows in proportion with the rest. A jump is how far the surface leaves the line between the
frames before and after; a gap, how far lips are open where the performer's are closed: each lip is
off by half, and ``lips`` is the share of the rig's points that they are, as all distances are root
mean squares over the surface.
"""

from dataclasses import dataclass

import numpy as np

from usdface.core.arrays import FloatArray
from usdface.model.review.verdict import SolveEvidence

MOMENT_SECONDS = 0.25
"""Frames nearer than this are one moment: a blink, or a plosive, takes about as long."""

LEAST_JUMP_MM = 0.05
"""Nobody sees less; where jumps are all that is known, only the largest is listed below it."""

_LEAST_COVERAGE = 0.1
"""The quotient is limited: below, references say nothing at all."""


@dataclass(frozen=True)
class Moment:
    """A moment to look at."""

    row: int
    """Of the frame where it is worst."""
    score_mm: float
    """What it is ranked by."""
    region: str
    """Part of the face; empty where it is not known."""
    reason: str


@dataclass(frozen=True)
class ReviewSignals:
    """What frames are ranked by."""

    evidence: SolveEvidence
    jump_mm: FloatArray
    """(frames, regions): see `surface_jumps`."""
    gap_mm: FloatArray | None = None
    """(frames,): of lips that should be closed; 0 where they need not be."""
    lip_share: float = 1.0
    """Of the rig's points, those of the lips."""
    jump_regions: tuple[str, ...] = ()
    """Of the jumps, where others than the evidence's: weights tell them without a mapping too."""

    @property
    def score_mm(self) -> FloatArray:
        """What frames are ranked by: (frames,) [mm]; NaN without keys, where keys are known."""
        if self.evidence.error_mm is not None:
            return self.evidence.error_mm[:, 0]
        squared = self.expected_mm[:, 0] ** 2 + self.jump_mm[:, 0] ** 2
        if self.gap_mm is not None:
            squared += self.lip_share * (self.gap_mm / 2) ** 2
        return np.asarray(np.sqrt(squared))

    @property
    def expected_mm(self) -> FloatArray:
        """Expected error, coverage taken into account: (frames, regions) [mm]."""
        evidence = self.evidence
        if evidence.uncertainty_mm is None:
            return np.zeros_like(self.jump_mm)
        if evidence.coverage is None:
            return evidence.uncertainty_mm
        return evidence.uncertainty_mm / np.maximum(evidence.coverage, _LEAST_COVERAGE)

    def moment(self, row: int) -> Moment:
        """Return what is to be seen at a row: its region, and why."""
        evidence, score = self.evidence, float(self.score_mm[row])
        if evidence.error_mm is not None:
            region = _largest_region(evidence.regions, evidence.error_mm[row])
            return Moment(row, score, region, f"{score:.2f} mm off the keys")
        gap = 0.0 if self.gap_mm is None else float(self.gap_mm[row])
        jump, expected = float(self.jump_mm[row, 0]), float(self.expected_mm[row, 0])
        lips = f"lips {gap:.1f} mm open, the performer's closed" if gap > LEAST_JUMP_MM else ""
        if gap / 2 * self.lip_share**0.5 > max(jump, expected):
            return Moment(row, score, "mouth", lips)
        if jump > expected:
            region = _largest_region(self.jump_regions or evidence.regions, self.jump_mm[row])
            reason = f"jumps by {jump:.2f} mm"
        else:
            region = _largest_region(evidence.regions, self.expected_mm[row])
            reason = "" if evidence.uncertainty_mm is None else _expected(evidence, row, region)
        return Moment(row, score, region, ", ".join(filter(None, [reason, lips])))


def _expected(evidence: SolveEvidence, row: int, region: str) -> str:
    column = evidence.regions.index(region) if region in evidence.regions else 0
    words = []
    if evidence.uncertainty_mm is not None:
        column = min(column, evidence.uncertainty_mm.shape[1] - 1)
        words.append(f"uncertainty {evidence.uncertainty_mm[row, column]:.2f} mm")
    if evidence.coverage is not None:
        words.append(f"{evidence.coverage[row, column]:.0%} of the motion covered")
    return ", ".join(words)


def _largest_region(regions: tuple[str, ...], values: FloatArray) -> str:
    """Return the part of the face with the largest value; empty where only the whole is known."""
    if len(values) < 2 or len(regions) < 2:
        return ""
    return regions[1 + int(np.nan_to_num(values[1:]).argmax())]


def review_moments(signals: ReviewSignals, count: int, *, rate: float) -> list[Moment]:
    """Return the moments to review first, the worst first.

    Parameters
    ----------
    count : int
        Most moments.
    rate : float
        Frames per second: no two moments are nearer than `MOMENT_SECONDS`.
    """
    score = np.nan_to_num(signals.score_mm, nan=-1.0)
    near = max(round(MOMENT_SECONDS * rate), 1)
    free = score >= 0
    evidence, rows = signals.evidence, list[int]()
    jumps_alone = evidence.error_mm is None and evidence.uncertainty_mm is None
    for row in np.argsort(-score, kind="stable").tolist():
        if len(rows) >= count or (rows and jumps_alone and score[row] < LEAST_JUMP_MM):
            break
        if free[row]:
            rows.append(row)
            free[max(row - near + 1, 0) : row + near] = False
    return [signals.moment(row) for row in rows]


def surface_jumps(weights: FloatArray, grams: FloatArray) -> FloatArray:
    """Return how far the surface leaves the line between the frames around each.

    Parameters
    ----------
    weights : (frames, shapes) float array
    grams : (regions, shapes, shapes) float array
        [mm^2]

    Returns
    -------
    (frames, regions) float array
        Root mean square over each region's points; 0 at the ends [mm].
    """
    off = np.zeros_like(weights)
    off[1:-1] = weights[1:-1] - (weights[:-2] + weights[2:]) / 2
    return region_distances(off, grams)


def region_distances(off: FloatArray, grams: FloatArray) -> FloatArray:
    """Return what differences of weights do to each region: (frames, regions) [mm].

    Parameters
    ----------
    off : (frames, shapes) float array
        NaN where it is not known.
    grams : (regions, shapes, shapes) float array
        [mm^2]
    """
    squared = [np.einsum("fs,fs->f", off @ gram, off) for gram in grams]
    return np.asarray(np.sqrt(np.maximum(np.stack(squared, axis=1), 0.0)))
