"""Check of a take's neutral frame by the motion that a rig's shapes explain from it."""

from dataclasses import dataclass

import numpy as np

from usdface.core.arrays import IntArray, sample_frames
from usdface.model.selection.baseline import BlendshapeEquation, Positions
from usdface.numerics.regression.reference_design import design_k_centre

_SOLVED_FRAMES = 30
"""Evenly spaced frames on which each candidate is evaluated: with 60, ratios of residuals are the
same to 3 %."""

_CANDIDATE_FRAMES = 24
_SEARCHED_FRAMES = 800

BETTER_SHARE = 0.75
"""Ratio of residuals, from another frame over the stated one, below which the other is neutral:
between two neutral frames it differs by a tenth."""


@dataclass(frozen=True)
class BetterNeutral:
    """A neutral frame to replace the stated one."""

    row: int
    """Index of the frame."""
    residual_mm: float
    stated_mm: float
    """`residual_mm`, `stated_mm`: RMS residual of the take from that frame and from the stated one
    [mm]."""


def find_better_neutral(
    equation: BlendshapeEquation, positions: Positions, rows: IntArray
) -> BetterNeutral | None:
    """Return a frame from which the rig's shapes explain a take much better; None without one.

    Weights are not negative: from a frame with a smile, frames without it cannot be explained.

    Parameters
    ----------
    positions : (frames, markers, 3) float array
        A stabilised take [mm].
    rows : (n,) int array
        Indices of frames with all markers.
    """
    if len(rows) < _CANDIDATE_FRAMES:
        return None
    searched = rows[sample_frames(len(rows), _SEARCHED_FRAMES)]
    solved = positions[rows[sample_frames(len(rows), _SOLVED_FRAMES)]].astype(np.float64)
    # Frames farthest from the neutral and from each other, and evenly spaced ones.
    together = np.concatenate([equation.neutral[None], positions[searched].astype(np.float64)])
    flat, half = together.reshape(len(together), -1), _CANDIDATE_FRAMES // 2
    farthest = design_k_centre(flat, half, already=np.zeros(1, np.int64)).chosen - 1
    candidates = np.union1d(farthest, sample_frames(len(searched), half))
    neutrals = np.concatenate([equation.neutral[None], positions[searched[candidates]]])
    # The equation uses displacements only, so a change of neutral is a shift of positions.
    shown = ((equation.neutral - neutrals)[:, None] + solved).reshape(-1, *equation.neutral.shape)
    residual = equation.residual_mm(shown, equation.propose(shown)).reshape(len(neutrals), -1)
    stated_mm, *others_mm = np.sqrt((residual**2).mean(axis=1)).tolist()
    best = int(np.argmin(others_mm))
    if not others_mm[best] < BETTER_SHARE * stated_mm:
        return None
    return BetterNeutral(int(searched[candidates[best]]), others_mm[best], stated_mm)
