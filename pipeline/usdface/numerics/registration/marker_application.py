"""Offsets of markers between two recordings of one face.

Markers that are applied again sit elsewhere on the skin, and head spaces agree to a millimetre.
Both shift a marker by nearly the same vector in all frames, each by its own; expressions move
neighbours alike.

References
----------
Haghverdi, Lun, Morgan and Marioni (2018), Batch effects in single-cell RNA-sequencing data are
corrected by matching mutual nearest neighbors, Nature Biotechnology 36, 421-427: `find_offset`.
"""

from dataclasses import dataclass

import numpy as np

from usdface.core.arrays import BoolArray, FloatArray, IntArray
from usdface.numerics.rigid.rigid_alignment import rigid_displacements

SAMPLE_FRAMES = 800
"""Frames of each recording: most expressions in common are in both samples."""

_MUTUAL_NEIGHBOURS = 3
"""With a third of the frames, each expression still has a partner."""

_CLOSEST_PAIRS = 40
"""The others may be expressions that only one recording has."""

_MOST_ROUNDS = 8

_SETTLED_MM = 1e-3
"""Largest change of an offset in the last round of matching."""

_FEWEST_FRAMES = 64
"""A second of a take: fewer frames share expressions only by chance."""

NEAR_MM = 45.0
"""Largest distance of markers on the same part of the face; longer ones depend on the jaw."""

_NOISE_MM = 0.1
"""Deviation of a marker at rest."""

_STILL_MM = 0.2
"""Deviation of a coordinate of a marker that expressions do not move."""

_GAP_MM = 0.5
"""Smallest gap between ranges that is reported."""

_RANGE_TAIL = 0.002
"""Share of the frames left out at either end of a distance's range, as outliers."""

_OFFSET_DEVIATIONS_MM = np.array([0.1, 0.2, 0.4, 0.8, 1.6, 3.2, 6.4])
"""Candidates of the standard deviation of a marker's offset on an axis: from errors of head spaces
to markers that were applied by eye."""

_POSE_DEGREES, _POSE_MM = 0.5, 0.5
"""Standard deviation of the error of a head space, about and along each axis: medians of rigid
markers that sit on skin depend on the expressions."""

_EXPRESSION_SHARES = np.array([0.01, 0.03, 0.1, 0.3, 1.0, 2.0])
"""Candidates of the difference of expression, relative to the performer's motion."""

_UNSEEN_SHARE = 0.03
"""Variance of a marker in an expression that the performer's frames do not show, relative to that
in those which they show."""


def find_offset(
    frames: FloatArray,
    usable: BoolArray,
    others: FloatArray,
    others_usable: BoolArray,
    *,
    neutral: FloatArray,
    others_neutral: FloatArray,
) -> tuple[FloatArray, float]:
    """Estimate each marker's constant shift o between two recordings of one face.

    Two differences show it: the mean over mutual nearest neighbours, which are frames of nearly the
    same expression, and that of the neutral faces. Either has a difference of expression as well::

        y_i = o + e_i    o = R q + u    q ~ N(0, 1)    u ~ N(0, s^2)    e_i ~ N(0, t_i^2 C + noise)

    with the covariance C of the performer's expressions, so that the neutral faces count little if
    they differ by a smile, and matched frames if the recordings have few expressions in common. R q
    is the error of the head space, a rigid displacement, and u each marker's own offset.
    s, t_1 and t_2 maximise the likelihood. Matching starts at zero, which favours small shifts.

    Returns the posterior mean, (markers, 3), to be subtracted from the other recording [mm]; 0
    where it cannot be estimated. And the gain of log-likelihood by an offset, per coordinate.

    Parameters
    ----------
    frames : (frames, markers, 3) float array
        The performer's [mm].
    usable : (frames, markers) bool array
    others : (frames, markers, 3) float array
        The other recording, in the same head space [mm].
    others_usable : (frames, markers) bool array
    neutral : (markers, 3) float array
        The performer's neutral face, used as one more frame [mm].
    others_neutral : (markers, 3) float array
        That of the other recording, if it has one; NaN where it is not known [mm].
    """
    known = np.concatenate([np.ones((1, usable.shape[1]), bool), usable])
    ours = np.concatenate([neutral[None], frames])
    offset = np.zeros_like(neutral)
    if min(len(frames), len(others)) < _FEWEST_FRAMES:
        return offset, 0.0
    covariance = expression_covariance(frames, usable, neutral)
    covariance += _UNSEEN_SHARE * np.diag(np.diag(covariance))
    # Rigid markers, as of a band that was put on again, tell nothing of the offsets on the skin.
    still = np.diag(covariance).reshape(-1, 3).mean(axis=1) < _STILL_MM**2
    moving = np.repeat(~still, 3)
    variance, axes = np.linalg.eigh(covariance[np.ix_(moving, moving)])
    neutrals = others_neutral - neutral
    pose_deviations = np.repeat([np.deg2rad(_POSE_DEGREES), _POSE_MM], 3)
    rigid = pose_deviations[:, None] * rigid_displacements(neutral).reshape(6, -1)
    for _ in range(_MOST_ROUNDS):
        before = offset
        squared = _squared_distances(ours + offset, known, others, others_usable)
        rows, other_rows = _mutual_pairs(squared)
        near = squared[rows, other_rows]
        # Weights are capped at a quarter of the median distance, or one pair would dominate.
        weight = 1 / np.maximum(near, max(float(np.median(near)) / 4, 1e-6))
        both = known[rows] & others_usable[other_rows]
        share = weight[:, None] * both
        share /= np.maximum(share.sum(axis=0), 1e-12)
        difference = np.where(both[..., None], others[other_rows] - ours[rows], 0.0)
        matched = np.einsum("pm,pmc->mc", share, difference)
        # A marker that one of the two lacks has the difference of the other.
        second = np.where(np.isnan(neutrals), matched, neutrals)
        first = np.where(share.sum(axis=0)[:, None] > 0, matched, second)
        shown = np.stack([first.ravel(), second.ravel()])
        mean, gain = _most_probable_offset(
            shown[:, moving] @ axes, np.maximum(variance, 0.0), rigid[:, moving] @ axes
        )
        offset = shown.mean(axis=0)
        offset[moving] = axes @ mean
        offset = offset.reshape(-1, 3)
        if np.abs(offset - before).max() < _SETTLED_MM:
            break
    offset[~others_usable.any(axis=0)] = 0.0
    return offset, gain


def expression_covariance(frames: FloatArray, usable: BoolArray, neutral: FloatArray) -> FloatArray:
    """Return the second moment of the motion from the neutral [mm^2].

    (3 markers, 3 markers), of `frames`, (frames, markers, 3) [mm], where `usable`.
    """
    moved = np.where(usable[..., None], frames - neutral, 0.0).reshape(len(frames), -1)
    return np.asarray(moved.T @ moved / max(len(moved), 1))


def _most_probable_offset(
    shown: FloatArray, variance: FloatArray, rigid: FloatArray
) -> tuple[FloatArray, float]:
    """Return the posterior mean of an offset, and the gain of log-likelihood per coordinate.

    Parameters
    ----------
    shown : (2, coordinates) float array
        The differences that show it, along the principal axes of the expressions [mm].
    variance : (coordinates,) float array
        Of the expressions [mm^2].
    rigid : (6, coordinates) float array
        R, along these axes [mm].
    """
    noise = np.multiply.outer(_EXPRESSION_SHARES**2, variance) + _NOISE_MM**2
    first, second = 1 / noise[:, None], 1 / noise
    information = first + second
    score = first * shown[0] + second * shown[1]
    constant = np.log(first * second) - first * shown[0] ** 2 - second * shown[1] ** 2
    best = -np.inf, shown[0]
    for prior in _OFFSET_DEVIATIONS_MM**2:
        posterior = information + 1 / prior
        # What both differences tell of q, with u integrated out.
        share = 1 / (1 + prior * information)
        normal = (share * information)[..., None, :] * rigid @ rigid.T + np.eye(len(rigid))
        right = (share * score) @ rigid.T
        q = np.linalg.solve(normal, right[..., None])[..., 0]
        twice_density = constant + score**2 / posterior - np.log(posterior * prior)
        total = twice_density.sum(axis=2) + (right * q).sum(axis=2)
        total -= np.linalg.slogdet(normal)[1]
        at = np.unravel_index(int(total.argmax()), total.shape)
        if total[at] > best[0]:
            pose_error = q[at] @ rigid
            own = (score[at] - information[at] * pose_error) / posterior[at]
            best = float(total[at]), pose_error + own
    return best[1], (best[0] - float(constant.sum(axis=2).max())) / (2 * max(len(variance), 1))


def measure_distances(positions: FloatArray, usable: BoolArray, at: FloatArray) -> FloatArray:
    """Return the root mean square distance over markers of frames from a face: (frames,) [mm].

    Infinite for a frame whose visible markers have less than half of the motion's variance.

    Parameters
    ----------
    positions : (frames, markers, 3) float array
        [mm]
    usable : (frames, markers) bool array
    at : (markers, 3) float array
        [mm]
    """
    known = np.ones((1, usable.shape[1]), bool)
    return np.sqrt(_squared_distances(at[None], known, positions, usable)[0])


def _mutual_pairs(squared: FloatArray) -> tuple[IntArray, IntArray]:
    """Return the closest mutual nearest neighbours, and the neutral with its nearest frame."""
    near = min(_MUTUAL_NEIGHBOURS, *squared.shape) - 1
    by_row = np.partition(squared, near, axis=1)[:, near : near + 1]
    by_column = np.partition(squared, near, axis=0)[near : near + 1]
    rows, columns = np.nonzero((squared <= by_row) & (squared <= by_column))
    best = np.argsort(squared[rows, columns], kind="stable")[:_CLOSEST_PAIRS]
    return np.append(rows[best], 0), np.append(columns[best], squared[0].argmin())


def _squared_distances(
    first: FloatArray, first_usable: BoolArray, second: FloatArray, second_usable: BoolArray
) -> FloatArray:
    """Return mean squared distances over markers, (first, second) [mm²].

    Over the markers visible in both frames, divided by their share of the variance of the second
    recording: a frame without the mouth is no nearer. Infinite where that share is below one half.
    """
    mask_a, mask_b = first_usable.astype(float), second_usable.astype(float)
    times = mask_b.sum(axis=0)
    moved = second - np.einsum("fm,fmc->mc", mask_b / np.maximum(times, 1), second)
    spread = np.einsum("fm,fmc->m", mask_b / np.maximum(times, 1), moved**2)
    motion = np.where(times > 0, spread + _NOISE_MM**2, 0.0)
    motion /= max(motion.sum(), _NOISE_MM**2)
    centre = first.mean(axis=0)  # differences of large squares would lose their digits
    a, b = first - centre, second - centre
    shared = (mask_a * motion) @ mask_b.T
    squared = ((a**2).sum(axis=2) * mask_a) @ mask_b.T + mask_a @ ((b**2).sum(axis=2) * mask_b).T
    flat_a = (a * mask_a[..., None]).reshape(len(a), -1)
    squared -= 2 * flat_a @ (b * mask_b[..., None]).reshape(len(b), -1).T
    squared = np.maximum(squared, 0.0) / np.maximum(shared, 1e-9) / max((times > 0).sum(), 1)
    return np.where(shared >= 0.5, squared, np.inf)


def compare_neighbours(
    frames: FloatArray, usable: BoolArray, others: FloatArray, others_usable: BoolArray
) -> float:
    """Return the share of neighbouring markers whose distances have disjoint ranges [0-1].

    Skin stretches and folds, but over some seconds distances pass through the same values, unless
    a marker was applied elsewhere.

    Parameters
    ----------
    frames, others : (frames, markers, 3) float arrays
        In any head space [mm].
    usable, others_usable : (frames, markers) bool arrays
    """
    middle = np.median(frames, axis=0)
    near = np.linalg.norm(middle[:, None] - middle, axis=2) < NEAR_MM
    seen = usable.mean(axis=0), others_usable.mean(axis=0)
    near &= np.logical_and.outer(np.minimum(*seen) >= 0.5, np.minimum(*seen) >= 0.5)
    pairs = np.argwhere(np.triu(near, 1))
    low, high = _distance_ranges(frames, usable, pairs)
    others_low, others_high = _distance_ranges(others, others_usable, pairs)
    gap = np.maximum(others_low - high, low - others_high)
    return float((gap > _GAP_MM).sum() / max(len(pairs), 1))


def _distance_ranges(
    positions: FloatArray, usable: BoolArray, pairs: IntArray
) -> tuple[FloatArray, FloatArray]:
    both = usable[:, pairs[:, 0]] & usable[:, pairs[:, 1]]
    distance = np.linalg.norm(positions[:, pairs[:, 0]] - positions[:, pairs[:, 1]], axis=2)
    distance[~both] = np.nan
    if not len(pairs):
        return np.zeros(0), np.zeros(0)
    low, high = np.nanquantile(distance, [_RANGE_TAIL, 1 - _RANGE_TAIL], axis=0)
    return np.where(np.isnan(low), -np.inf, low), np.where(np.isnan(high), np.inf, high)


@dataclass(frozen=True)
class CloudStretch:
    """Affine stretch from one face to another."""

    stretch: FloatArray
    """(3,): along the principal axes of the stretch; 1 where the faces are alike."""
    error: FloatArray
    """(3,): standard error of each."""
    chi2: float
    """Of the residual, per degree of freedom."""


def measure_stretch(cloud: FloatArray, other: FloatArray, covariance: FloatArray) -> CloudStretch:
    """Return the stretch of the affine map from one face's markers to another's.

    Generalised least squares; the error grows with a chi2 per degree of freedom above 1.

    Parameters
    ----------
    cloud, other : (markers, 3) float arrays
        The same markers of two neutral faces [mm]; more than four, not in a plane.
    covariance : (3 markers, 3 markers) float array
        Of the differences between neutral faces of one person: expressions that an open jaw or a
        smile leaves in them stretch a face as well, and markers that are applied again [mm^2].
    """
    affine = np.column_stack([cloud - cloud.mean(axis=0), np.ones(len(cloud))])
    root = np.linalg.cholesky(covariance)
    design = np.linalg.solve(root, np.kron(affine, np.eye(3)))
    moved = np.linalg.solve(root, (other - other.mean(axis=0)).ravel())
    spread = np.linalg.inv(design.T @ design)
    fitted = spread @ (design.T @ moved)
    chi2 = ((moved - design @ fitted) ** 2).sum() / max(design.shape[0] - design.shape[1], 1)
    before, stretch, after = np.linalg.svd(fitted[:9].reshape(3, 3))
    axes = np.einsum("ik,kj->kij", before, after).reshape(3, 9)
    error = np.sqrt(np.einsum("ka,ab,kb->k", axes, spread[:9, :9], axes) * max(chi2, 1.0))
    return CloudStretch(stretch, error, float(chi2))
