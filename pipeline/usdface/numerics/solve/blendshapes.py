"""Deform points by weighted shapes with in-betweens, as UsdSkel does."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy import sparse

from usdface.core.arrays import FloatArray, IntArray, coordinates_of, sample_frames
from usdface.core.rig_logic import RigLogic

_LEAST_SHARE = 0.02
"""[of the largest displacement] Points that all shapes move less are not part of the face."""

_LARGEST_PEAK = 10.0
"""[of the upper quartile of the shapes' largest displacements] Larger ones hide a part far away."""


@dataclass(frozen=True)
class Key:
    """A target or in-between."""

    weight: float
    """The channel's weight at which this key is reached in full."""
    points: IntArray
    """(n,): indices of moved points."""
    offsets: FloatArray
    """(n, 3)"""


@dataclass(frozen=True)
class ChannelKeys:
    """Keys of one channel on one mesh; several meshes may follow the same channel."""

    channel: int
    """Column of the weights that drives it; beyond them, a combination's."""
    keys: Sequence[Key]
    """The full target and any in-betweens."""


class BlendShapes:
    """Shapes over a set of points.

    Points are interpolated linearly between neighbouring keys of a track, of which the neutral is
    one at 0, and extrapolated linearly outside, as in UsdSkel.

    Parameters
    ----------
    channel_count : int
        Number of channels, with those that move no point.
    logic : RigLogic, optional
        Drives the channels beyond `channel_count`.
    """

    def __init__(
        self,
        point_count: int,
        channel_count: int,
        tracks: Sequence[ChannelKeys],
        *,
        logic: RigLogic | None = None,
    ) -> None:
        self.point_count = point_count
        self.logic = logic
        self.channel_count = channel_count
        self._knots: list[tuple[int, list[tuple[float, int]]]] = []
        """Channel of each track, and weight and row of each of its keys."""
        keys: list[Key] = []
        for track in tracks:
            ordered = sorted(track.keys, key=lambda key: key.weight)
            knots = [(key.weight, len(keys) + row) for row, key in enumerate(ordered)]
            self._knots.append((track.channel, knots))
            keys.extend(ordered)
        single = [(channel, *knots[0]) for channel, knots in self._knots if len(knots) == 1]
        channels, at, rows = np.array(single, np.float64).reshape(-1, 3).T
        self._single_keys = (rows.astype(np.int64), channels.astype(np.int64), at)
        columns = [coordinates_of(key.points) for key in keys]
        row_starts = np.concatenate([[0], np.cumsum([len(column) for column in columns])])
        self.key_offsets: sparse.csr_array = sparse.csr_array(
            (
                np.concatenate([key.offsets.ravel() for key in keys] or [np.zeros(0)]),
                np.concatenate(columns or [np.zeros(0, dtype=np.int64)]),
                row_starts.astype(np.int64),
            ),
            shape=(len(keys), 3 * point_count),
        )

    @property
    def key_channels(self) -> IntArray:
        """The channel of each key, -1 for a combination's: (keys,) int array."""
        channels = np.array([channel for channel, knots in self._knots for _ in knots], np.int64)
        return np.where(channels < self.channel_count, channels, -1)

    @property
    def is_linear(self) -> bool:
        """Whether displacements are linear in the weights: without in-betweens and combinations."""
        return self.logic is None and len(self._single_keys[0]) == self.key_offsets.shape[0]

    def key_weights(self, weights: ArrayLike) -> FloatArray:
        """Return key weights (frames, keys) of channel weights (frames, channels)."""
        weights = np.atleast_2d(np.asarray(weights, dtype=np.float64))
        if weights.shape[1] != self.channel_count:
            raise ValueError(f"{weights.shape[1]} weights for {self.channel_count} channels")
        return self._key_shares(weights if self.logic is None else self.logic.evaluate(weights))

    def _key_shares(self, weights: FloatArray) -> FloatArray:
        """Return key weights of the weights of channels and combinations."""
        shares = np.zeros((len(weights), self.key_offsets.shape[0]))
        rows, channels, at = self._single_keys
        shares[:, rows] = weights[:, channels] / at
        for channel, knots in self._knots:
            if len(knots) > 1:
                _share_between(weights[:, channel], knots, shares)
        return shares

    @cached_property
    def face_points(self) -> IntArray:
        """Points over which an error of the face is averaged: (n,) int array.

        The points that shapes move, and at most as many others: about half of a head's points move,
        and those of a body would reduce all errors.
        """
        moving = moving_points(self.key_offsets)
        still = np.setdiff1d(np.arange(self.point_count), moving)
        return np.union1d(moving, still[sample_frames(len(still), len(moving))])

    def offsets(self, weights: ArrayLike) -> FloatArray:
        """Return displacements of the points: (frames, points, 3) float array."""
        moved = self.key_weights(weights) @ self.key_offsets
        return np.asarray(moved).reshape(-1, self.point_count, 3)

    def target_offsets(self) -> sparse.csr_array:
        """Return displacements by each channel at 1: (channels, 3 * points) sparse array."""
        return self._targets

    @cached_property
    def _targets(self) -> sparse.csr_array:
        full = sparse.csr_array(self.key_weights(np.eye(self.channel_count)))
        return sparse.csr_array(full @ self.key_offsets)

    def separate_offsets(self, weights: FloatArray) -> sparse.csr_array:
        """Return displacements without those by the combinations that channels drive.

        Returns (rows, 3 * points), of the weights of channels and combinations, (rows, channels +
        combinations).
        """
        return sparse.csr_array(sparse.csr_array(self._key_shares(weights)) @ self.key_offsets)

    def gram(self, poses: FloatArray | None = None) -> FloatArray:
        """Return the quadratic form of the surface error of small errors of the weights.

        Returns (channels, channels) ``G`` such that ``sqrt(e @ G @ e)`` is the root mean square
        distance of `face_points`.

        Parameters
        ----------
        poses : (frames, channels) float array, optional
            Weights at which combinations are linearised; the mean over them is returned. By default
            at rest.
        """
        if self.logic is None or poses is None:
            return self._gram_at_rest
        columns = coordinates_of(self.face_points)
        targets = sparse.csr_array(self._targets[:, columns])
        each = np.eye(self.channel_count + len(self.logic.combinations))[self.channel_count :]
        driven = sparse.csr_array(self.separate_offsets(each)[:, columns])
        slopes = self.logic.slopes(poses)  # a combination that one shape drives is in `targets`
        slopes -= self.logic.evaluate(np.eye(self.channel_count))[:, self.channel_count :].T
        every = sparse.vstack([targets, driven], format="csr")
        whole = np.asarray((every @ every.T).toarray()) / max(len(self.face_points), 1)
        count = self.channel_count
        mean = whole[:count, count:] @ slopes.mean(axis=0)
        quadratic = np.einsum(
            "fcs,cd,fdt->st", slopes, whole[count:, count:], slopes, optimize=True
        ) / len(slopes)
        return np.asarray(whole[:count, :count] + mean + mean.T + quadratic)

    @cached_property
    def _gram_at_rest(self) -> FloatArray:
        targets = self._targets[:, coordinates_of(self.face_points)]
        return np.asarray((targets @ targets.T).toarray()) / max(len(self.face_points), 1)


def moving_points(offsets: FloatArray | sparse.sparray) -> IntArray:
    """Return the points that some row of offsets, (rows, 3 * points), moves: (n,) int array."""
    columns: Any = sparse.csc_array(offsets)
    energy = np.asarray(columns.power(2).sum(axis=0)).reshape(-1, 3).sum(axis=1)
    reach = np.sqrt(energy)
    peaks = np.asarray(abs(columns).max(axis=1).toarray()).ravel()
    usual = np.quantile(peaks[peaks > 0], 0.75) if peaks.any() else 0.0
    return np.flatnonzero(reach > _LEAST_SHARE * min(reach.max(initial=0.0), _LARGEST_PEAK * usual))


def _share_between(weights: FloatArray, knots: list[tuple[float, int]], shares: FloatArray) -> None:
    """Write the linear interpolation weights of one track's keys, with the neutral at 0."""
    stops = sorted([*knots, (0.0, -1)])
    at = np.array([stop[0] for stop in stops])
    upper = np.clip(np.searchsorted(at, weights, side="right"), 1, len(at) - 1)
    toward = (weights - at[upper - 1]) / (at[upper] - at[upper - 1])
    for index, (_, row) in enumerate(stops):
        if row >= 0:
            shares[:, row] = np.where(upper == index, toward, 0.0)
            shares[:, row] += np.where(upper == index + 1, 1.0 - toward, 0.0)
