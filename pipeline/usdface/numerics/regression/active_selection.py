"""Which frames to tune next, once some are tuned: those that leave least doubt over the others."""

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from usdface.core.arrays import BoolArray, FloatArray
from usdface.numerics.regression.design_kernel import DesignKernel
from usdface.numerics.regression.reference_design import Design


def design_total_variance(
    rows: FloatArray,
    count: int,
    *,
    kernel: DesignKernel,
    known: FloatArray,
    importance: FloatArray | None = None,
    candidates: BoolArray | None = None,
    noise: float = 1e-2,
) -> Design:
    """Choose frames one by one so that the doubt summed over all frames falls most.

    The largest variance seeks the rarest face; this seeks the face that most of the take learns
    from, where the mapping errs. Tuning frame i lowers the variance of frame j by
    ``cov(i, j)^2 / (var(i) + noise)``.

    Parameters
    ----------
    rows : (frames, d) float array
        Features of the frames that count, some thousands at most: memory is quadratic.
    count : int
    kernel : DesignKernel
    known : (n, d) float array
        Features of the frames already tuned.
    importance : (frames,) float array, optional
        How much the doubt of each frame counts, at least 0: the squared error to expect.
    candidates : (frames,) bool array, optional
        Rows that may be chosen; by default all.
    noise : float
        Variance of a tuned weight around the truth.

    Returns
    -------
    Design
        `gain` is the share of the weighted doubt at the start that each frame removes.

    Raises
    ------
    ValueError
        If fewer rows than `count` may be chosen, or `importance` is negative.

    References
    ----------
    Cohn, Ghahramani and Jordan (1996), JAIR 4, 129-145; the I-optimal design.
    """
    free = np.ones(len(rows), dtype=bool) if candidates is None else candidates.copy()
    weight = np.ones(len(rows)) if importance is None else importance
    if not 0 <= count <= int(free.sum()):
        raise ValueError(f"cannot choose {count} of {int(free.sum())} frames that are free")
    if weight.shape != (len(rows),) or (weight < 0).any() or not np.isfinite(weight).all():
        raise ValueError("importance must have one finite entry of at least 0 per frame")
    doubt = kernel(rows, rows)
    if len(known):
        factor = cho_factor(kernel(known, known) + noise * np.eye(len(known)), lower=True)
        shared = kernel(known, rows)
        doubt -= shared.T @ cho_solve(factor, shared)
    total = max(float(weight @ np.maximum(np.diag(doubt), 0.0)), 1e-300)
    removed = weight @ doubt**2
    chosen, gain = [], []
    for _ in range(count):
        variance = np.maximum(np.diag(doubt), 0.0) + noise
        score = np.where(free, removed / variance, -np.inf)
        pick = int(score.argmax())
        chosen.append(pick)
        gain.append(float(max(score[pick], 0.0)) / total)
        free[pick] = False
        column = doubt[:, pick] / np.sqrt(variance[pick])
        doubt -= np.outer(column, column)
        removed = weight @ doubt**2
    return Design(np.array(chosen, dtype=np.int64), np.array(gain, dtype=np.float64))
