"""First fill of gaps, from which the fit of the low-rank model starts.

Expectation-maximisation that fills samples, and fits a model to them, converges slowly from its
first fill (Ilin and Raiko 2010): the step from a marker's samples to a constant fill is a
direction of motion, which the fit keeps. Here a marker with long gaps is regressed on the others,
over the frames in which it is seen, and never on values that were filled for it::

    x_m - mean = z a + noise,    z = V_s' (x_s - mean),    a = (Z' Z + penalty I)^-1 Z' X_m

with s the markers seen in the gap, V the principal directions of the take, and the penalty of the
least squared error in stretches of time that are left out.

References
----------
Ilin and Raiko (2010), Practical approaches to principal component analysis in the presence of
missing values, JMLR 11, 1957-2000: slow convergence and overfitting of imputation.
Hoerl and Kennard (1970), Ridge regression, Technometrics 12(1), 55-67.
"""

import numpy as np
from scipy import linalg

from usdface.core.arrays import (
    BoolArray,
    FloatArray,
    RealArray,
    coordinates_of,
    runs,
    sample_frames,
)
from usdface.numerics.regression.pca import fit_pca

STRETCH_COUNT, FOLD_COUNT = 24, 3
"""Stretches of time, and folds of them, of cross-validation: stretches of a take are nearly
independent, neighbouring frames are not."""
_INTERPOLATED_FRAMES = 8
"""[frames] Longest gap that is interpolated in time: a line errs little over less than a blink."""
_LEAST_GAP_SHARE = 0.01
"""[of a take] Long gaps of a marker that are regressed; fewer frames do not form a direction."""
_DIRECTION_COUNT = 60
"""As many as the model of a take has at most."""
_TRAINING_FRAMES = 1024
"""[frames] Seventeen for each direction."""
_PENALTIES = np.geomspace(1e-7, 1e2, 37)
"""Of the largest eigenvalue of Z' Z."""


def first_fill(positions: RealArray, good: BoolArray) -> RealArray:
    """Return positions with all gaps filled, (frames, markers, 3), of the same precision.

    Parameters
    ----------
    positions : (frames, markers, 3) float array
        [mm] Without head motion; anything where not good.
    good : (frames, markers) bool array
        Every marker has a good sample.
    """
    filled = _interpolated(positions, good)
    gaps = _long_gaps(good)
    if not gaps:
        return filled
    absent = np.zeros_like(good)
    for marker, start, stop in gaps:
        absent[start:stop, marker] = True
    flat = filled.reshape(len(filled), -1).astype(np.float64)
    pca = fit_pca(flat, dimensions=min(_DIRECTION_COUNT, flat.shape[1], len(flat) - 1))
    centered, directions = flat - pca.mean, pca.components.T
    scores = centered @ directions
    for marker, start, stop in gaps:
        columns = coordinates_of(np.flatnonzero(absent[start:stop].any(axis=0)))
        seen = np.flatnonzero(good[:, marker])
        training = seen[sample_frames(len(seen), _TRAINING_FRAMES)]
        rows = np.concatenate([training, np.arange(start, stop)])
        others = scores[rows] - centered[np.ix_(rows, columns)] @ directions[columns]
        known = len(training)
        filled[start:stop, marker] = _regress(
            others[:known], positions[training, marker].astype(np.float64), others[known:]
        )
    return filled


def _interpolated(positions: RealArray, good: BoolArray) -> RealArray:
    """Return every gap filled by a line in time, constant at the ends of the take."""
    filled = np.array(positions)
    for marker in np.flatnonzero(~good.all(axis=0)):
        known, gap = np.flatnonzero(good[:, marker]), np.flatnonzero(~good[:, marker])
        for axis in range(3):
            filled[gap, marker, axis] = np.interp(gap, known, positions[known, marker, axis])
    return filled


def _long_gaps(good: BoolArray) -> list[tuple[int, int, int]]:
    """Return (marker, start, stop) of the gaps that are regressed."""
    found = []
    for marker in np.flatnonzero(~good.all(axis=0)):
        gaps = [gap for gap in runs(~good[:, marker]) if gap[1] - gap[0] > _INTERPOLATED_FRAMES]
        if sum(stop - start for start, stop in gaps) >= _LEAST_GAP_SHARE * len(good):
            found += [(int(marker), start, stop) for start, stop in gaps]
    return found


def _regress(scores: FloatArray, targets: FloatArray, wanted: FloatArray) -> FloatArray:
    """Return the ridge regression's targets of other scores, (frames, 3).

    Parameters
    ----------
    scores : (samples, directions) float array
    targets : (samples, 3) float array
    wanted : (frames, directions) float array
    """
    center, mean = scores.mean(axis=0), targets.mean(axis=0)
    Z, Y = scores - center, targets - mean
    gram, cross = Z.T @ Z, Z.T @ Y
    penalties = _PENALTIES * max(float(linalg.norm(gram, 2)), np.finfo(float).eps)
    errors = np.zeros(len(penalties))
    fold = np.arange(len(Z)) * STRETCH_COUNT // len(Z) % FOLD_COUNT
    for left_out in range(FOLD_COUNT):
        test = fold == left_out
        if test.all():  # nothing to learn from
            continue
        values, vectors = linalg.eigh(gram - Z[test].T @ Z[test])
        turned = vectors.T @ (cross - Z[test].T @ Y[test])
        shrunk = turned / (np.maximum(values, 0.0) + penalties[:, None])[..., None]
        errors += ((Z[test] @ vectors @ shrunk - Y[test]) ** 2).sum(axis=(1, 2))
    chosen = penalties[errors.argmin()]
    gain = np.linalg.solve(gram + chosen * np.eye(len(gram)), cross)
    return mean + (wanted - center) @ gain
