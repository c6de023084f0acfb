"""Sequences that begin or end inside of a blink, of their own or of the motion."""

import numpy as np
import pytest

from usdface.numerics.motion.blink_cuts import blink_frames, keep_blinks
from usdface.numerics.motion.laplacian_warp import Insertion, ease_weights, warp_motion

FRAMES, RATE = 200, 60.0
START, STOP, BLEND = 60, 140, 12
LIDS = np.array([0])


def blink(peak: int, frames: int = FRAMES) -> np.ndarray:
    """A blink that closes in 4 frames and opens in 8."""
    return np.interp(np.arange(frames), [peak - 4, peak, peak + 2, peak + 10], [0.0, 1, 1, 0])


def warped(motion: np.ndarray, keys: np.ndarray, weight: float = 20) -> np.ndarray:
    insertion = Insertion(START, keys, ease_weights(len(keys), weight, ease=BLEND))
    (kept,) = keep_blinks(motion, [insertion], LIDS, rate=RATE, blend=BLEND)
    return warp_motion(motion, [kept], blend=BLEND)


@pytest.mark.parametrize("weight", [20, 1000])
@pytest.mark.parametrize("peak", [START - 4, START, START + 3, STOP - 3, STOP, STOP + 3])
def test_a_blink_that_an_end_of_a_sequence_cuts_is_played_whole(peak: int, weight: float) -> None:
    motion = np.column_stack([blink(peak), np.full(FRAMES, 0.2)])
    keys = np.tile([0.1, 0.8], (STOP - START, 1))
    lids, mouth = warped(motion, keys, weight).T
    np.testing.assert_allclose(
        lids[peak - 4 : peak + 11], blink(peak)[peak - 4 : peak + 11], atol=0.11
    )
    assert np.abs(np.diff(lids)).max() < 0.27  # 0.25 in the motion
    assert lids[100] == pytest.approx(0.1, abs=1e-3)
    assert mouth[100] == pytest.approx(0.8, abs=1e-3)
    assert mouth[START + BLEND] > 0.75, "only the lids wait"


@pytest.mark.parametrize("peak", [0, 2, 77, 79])
def test_half_a_blink_of_a_sequence_is_not_played(peak: int) -> None:
    keys = np.column_stack([blink(peak, STOP - START), np.zeros(STOP - START)])
    assert np.abs(warped(np.zeros((FRAMES, 2)), keys)).max() < 0.02


def test_sequences_whose_ends_are_in_no_blink_stay_as_they_are() -> None:
    """A blink amidst either, eyes held closed, and blinks without a frame outside of them."""
    keys = np.column_stack([blink(40, STOP - START) + 0.3, np.zeros(STOP - START)])
    held = np.column_stack([np.interp(np.arange(FRAMES), [50, 60, 180, 190], [0, 1, 1, 0])] * 2)
    fluttering = np.column_stack([0.5 - 0.5 * np.cos(np.arange(FRAMES) / 2)] * 2)
    for motion in (np.column_stack([blink(90)] * 2), held, fluttering):
        insertion = Insertion(START, keys, np.ones(len(keys)))
        (kept,) = keep_blinks(motion, [insertion], LIDS, rate=RATE, blend=BLEND)
        assert np.array_equal(kept.keys, keys)
    assert not blink_frames(held, RATE).any()
    assert blink_frames(held, RATE / 60).shape == (FRAMES,)
    (kept,) = keep_blinks(motion, [insertion], LIDS[:0], rate=RATE, blend=BLEND)
    assert np.array_equal(kept.keys, keys)
