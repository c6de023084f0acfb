"""Penalised smoothing of tracks and poses, with penalties chosen by cross-validation.

References
----------
Eilers (2003), A perfect smoother, Analytical Chemistry 75(14), 3631-3636.
Garcia (2010), Robust smoothing of gridded data in one and higher dimensions with missing values,
Computational Statistics and Data Analysis 54(4), 1167-1178: the cosine domain, and generalised
cross-validation (GCV) in it.
"""

from itertools import combinations_with_replacement

import numpy as np
from numpy.typing import ArrayLike
from scipy.fft import dct, idct
from scipy.linalg import solveh_banded
from scipy.ndimage import uniform_filter1d
from scipy.spatial.transform import Rotation

from usdface.core.arrays import FloatArray, RealArray, extend_block, frame_blocks, sample_frames
from usdface.core.processes import map_threads
from usdface.numerics.rigid.rigid_alignment import pose_matrices

_DIFFERENCE_ORDER = 3
"""Third differences are penalised: position, velocity and acceleration pass."""
_FREQUENCY_BINS = 4096
"""Frequencies are binned to score a penalty; the scores do not change."""
_PENALTIES = 10.0 ** np.arange(-3.0, 9.01, 0.1)
_COLUMNS_AT_ONCE = 8
_DETAIL_PENALTY = 3.0
"""Of the light smoother: halves periods of about eight frames, shorter than the fastest blink."""
_DETAIL_FRAMES = 9
"""Over which the energy of detail is averaged."""
_DETAIL_ENERGY_RATIO = 4.0
"""99.99th percentile of the energy of nine frames of smoothed noise, over its mean."""
DETAIL_REACH = 96
"""[frames] Reach of the light smoother, whose impulse response decays as 0.64 per frame."""
_AXES_FRAMES = 20_000
"""Frames of a take that determine the principal axes."""


def smooth_tracks(values: ArrayLike, *, noise: ArrayLike = 0.0) -> FloatArray:
    """Minimise ``|x - y|² + penalty |third differences of x|²`` for every series (frames, series).

    Each with the penalty of least GCV score, in the cosine domain, in which third differences of
    series that are mirrored at their ends are diagonal. The minimum is that of the series alone, by
    its seven diagonals: mirrored, a head that turns at the end of a take would stop there.

    `noise`: standard deviation of the noise of each series, if it is known. Series are then shrunk
    to their mean by the positive-part James-Stein factor, to nothing where they hold no more than
    the noise that smoothing leaves.
    """
    y = np.asarray(values)
    frames, count = y.shape
    if frames <= _DIFFERENCE_ORDER:
        return np.array(y, np.float64)
    smooth, bands = np.empty(y.shape), _squared_differences(frames)
    eigenvalues = difference_eigenvalues(_FREQUENCY_BINS)
    variances = np.broadcast_to(np.square(noise), count)
    for columns in frame_blocks(count, frames=_COLUMNS_AT_ONCE):
        spectrum = dct(y[:, columns].astype(np.float64), axis=0, norm="ortho")
        penalties = gcv_penalties(spectrum).tolist()
        for column, penalty in enumerate(penalties, start=columns.start):
            matrix = penalty * bands
            matrix[-1] += 1.0
            track = solveh_banded(matrix, y[:, column], overwrite_ab=True)
            left = variances[column] * np.mean((1.0 + penalty * eigenvalues) ** -2.0)
            share = max(0.0, 1.0 - left / max(track.var(), 1e-12))
            smooth[:, column] = share * track + (1.0 - share) * track.mean()
    return smooth


def _squared_differences(frames: int) -> FloatArray:
    """Return the diagonals of ``D'D``, D the third differences, as of `solveh_banded`."""
    stencil = (-1.0, 3.0, -3.0, 1.0)
    bands = np.zeros((len(stencil), frames))
    for row, column in combinations_with_replacement(range(len(stencil)), 2):
        part = slice(column, column + frames - _DIFFERENCE_ORDER)
        bands[_DIFFERENCE_ORDER + row - column, part] += stencil[row] * stencil[column]
    return bands


def smooth_take(positions: RealArray, *, noise: FloatArray) -> None:
    """Smooth whole frames along the principal axes of their motion, in place.

    Blinks, which are below the noise of single coordinates, are above it along few axes. Each axis
    has a penalty of its own, so that weak expressions stay. Residuals of the axes are added back
    where they are significant.

    Parameters
    ----------
    positions : (frames, markers, 3) float array
        [mm] Complete, without head motion; changed.
    noise : (markers,) float array
        Standard deviation of the measurement noise per coordinate [mm].
    """
    count, kind = len(positions), positions.dtype
    flat = positions.reshape(count, -1)
    sample = flat[sample_frames(count, _AXES_FRAMES)].astype(np.float64)
    middle = sample.mean(axis=0)
    sample -= middle
    mean, components = middle.astype(kind), np.linalg.eigh(sample.T @ sample)[1].T.astype(kind)
    scores = np.empty_like(flat)
    for block in frame_blocks(count):
        scores[block] = (flat[block] - mean) @ components.T
    deviations = np.sqrt(components**2 @ np.repeat(np.square(noise), 3))
    for columns in frame_blocks(len(components), frames=_COLUMNS_AT_ONCE):
        scores[:, columns] = smooth_tracks(scores[:, columns], noise=deviations[columns])
    # As other blocks are smoothed in place meanwhile, the frames around a block are copied first.
    parts = [
        (block, wide, flat[wide.start : block.start].copy(), flat[block.stop : wide.stop].copy())
        for block in frame_blocks(count)
        for wide in [extend_block(block, DETAIL_REACH, count)]
    ]

    def smooth_part(part: tuple[slice, slice, RealArray, RealArray]) -> None:
        block, wide, before, after = part
        tracks = scores[wide] @ components + mean
        rest = np.concatenate([before, flat[block], after]) - tracks
        detail = significant_detail(rest.reshape(-1, *positions.shape[1:]), noise=noise)
        inner = slice(block.start - wide.start, block.stop - wide.start)
        positions[block] = tracks[inner].reshape(positions[block].shape) + detail[inner]

    map_threads(smooth_part, parts)


def smooth_poses(head_motion: ArrayLike, *, center: ArrayLike) -> FloatArray:
    """Smooth rotations and the path of `center`, with penalties by generalised cross-validation.

    Returns (frames, 4, 4).

    Parameters
    ----------
    head_motion : (frames, 4, 4) array_like
        Rigid transforms for column vectors.
    center : (3,) array_like
        Point of the head space about which the noise of rotations and of paths is independent,
        such as the centroid of the rigid markers [mm].
    """
    motion = np.asarray(head_motion, np.float64)
    middle = np.asarray(center, np.float64)
    rotations = Rotation.from_matrix(motion[:, :3, :3])
    mean = rotations.mean()
    # Rotation vectors would jump where a performer turns around; quaternions change their sign.
    quaternions = (mean.inv() * rotations).as_quat()
    turned = (quaternions[1:] * quaternions[:-1]).sum(axis=1) < 0
    quaternions[1:] *= np.cumprod(np.where(turned, -1.0, 1.0))[:, None]
    path = motion[:, :3, :3] @ middle + motion[:, :3, 3]
    smooth = smooth_tracks(np.concatenate([quaternions, path], axis=1))
    turns = (mean * Rotation.from_quat(smooth[:, :4])).as_matrix()
    return pose_matrices(turns, smooth[:, 4:] - turns @ middle)


def significant_detail(rest: ArrayLike, *, noise: ArrayLike) -> RealArray:
    """Return the part of the residuals of smoothing that is significant against the noise.

    The penalty of a direction is that of the whole take. A fast movement that is rare in it would
    be smoothed like noise. Returns (frames, markers, 3), zero nearly everywhere.

    Parameters
    ----------
    rest : (frames, markers, 3) array_like
        Unsmoothed less smoothed [mm].
    noise : (markers,) array_like
        Standard deviation of the measurement noise per coordinate [mm].

    Notes
    -----
    Residuals are smoothed lightly, and shrunk by the positive-part James-Stein factor of their
    energy over nine frames.
    """
    away = np.asarray(rest)
    frames = len(away)
    if frames <= _DETAIL_FRAMES:
        return np.zeros_like(away)
    gain = 1.0 / (1.0 + _DETAIL_PENALTY * difference_eigenvalues(_FREQUENCY_BINS))
    floor = _DETAIL_ENERGY_RATIO * 3.0 * np.asarray(noise, float) ** 2 * float(np.mean(gain**2))
    spectrum = dct(away.reshape(frames, -1), axis=0, norm="ortho")
    spectrum /= (1.0 + _DETAIL_PENALTY * difference_eigenvalues(frames)[:, None]).astype(away.dtype)
    lightly = idct(spectrum, axis=0, norm="ortho", overwrite_x=True).reshape(away.shape)
    energy = uniform_filter1d(np.einsum("fki,fki->fk", lightly, lightly), _DETAIL_FRAMES, axis=0)
    share = np.maximum(0.0, 1.0 - floor / np.maximum(energy, 1e-12))
    detailed = share.any(axis=0)
    lightly[:, ~detailed] = 0.0
    if detailed.any():
        share = uniform_filter1d(share[:, detailed], _DETAIL_FRAMES, axis=0)  # no step at its ends
        lightly[:, detailed] *= share[..., None]
    return np.asarray(lightly, away.dtype)


def difference_eigenvalues(frames: int) -> FloatArray:
    """Return the eigenvalues of the squared third differences of a mirrored series, (frames,)."""
    return (2.0 - 2.0 * np.cos(np.pi * np.arange(frames) / frames)) ** _DIFFERENCE_ORDER


def gcv_penalties(spectrum: FloatArray) -> FloatArray:
    """Return the penalty of least generalised cross-validation score for each series.

    Parameters
    ----------
    spectrum : (frames, series) float array
        Orthonormal cosine transform of the series.
    """
    frames = len(spectrum)
    starts = np.unique(
        np.linspace(0, frames, min(_FREQUENCY_BINS, frames), endpoint=False).astype(np.int64)
    )
    power = np.add.reduceat(spectrum**2, starts, axis=0)
    members = np.diff(np.append(starts, frames))
    eigenvalues = np.add.reduceat(difference_eigenvalues(frames), starts) / members
    scores = np.empty((len(_PENALTIES), spectrum.shape[1]))
    for i, penalty in enumerate(_PENALTIES):
        removed = 1.0 - 1.0 / (1.0 + penalty * eigenvalues)  # I - hat matrix, diagonal here
        scores[i] = (removed**2 @ power) / (removed @ members / frames) ** 2
    return _PENALTIES[scores.argmin(axis=0)]
