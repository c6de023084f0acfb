"""The search against brute force, and on motions in which sequences were planted."""

import numpy as np
import pytest

from usdface.numerics.motion.sequence_search import (
    best_match,
    find_sequence,
    mean_face_distance,
    merge_starts,
    sequence_distances,
    starts_within,
)

CHANNELS = 12


def acted(rng: np.random.Generator, frames: int) -> np.ndarray:
    """Weights that rise and fall as those of a face do."""
    smooth = np.cumsum(rng.normal(0, 1, (frames + 40, CHANNELS)), axis=0)
    smooth = np.apply_along_axis(np.convolve, 0, smooth, np.ones(20) / 20, "valid")[:frames]
    return 0.5 + 0.5 * np.sin(smooth / 6)


def gesture(frames: int = 50) -> np.ndarray:
    time = np.linspace(0, 1, frames)[:, None]
    return np.clip(np.sin(np.pi * time) * np.linspace(-0.3, 1.0, CHANNELS), 0, None)


def brute(motion: np.ndarray, sequence: np.ndarray) -> np.ndarray:
    """Eq. 10 as it is printed, then normalised."""
    count = len(motion) - len(sequence) + 1
    sums = [
        np.sqrt(((motion[k : k + len(sequence)] - sequence) ** 2).sum(1)).sum()
        for k in range(count)
    ]
    return np.array(sums) / len(sequence) / np.sqrt(CHANNELS)


@pytest.mark.parametrize("threshold", [0.0, 0.1, 0.25, 0.3, 5.0])
def test_the_search_finds_what_brute_force_finds(threshold: float):
    rng = np.random.default_rng(0)
    motion = acted(rng, 3000)
    sequence = motion[700:760] + rng.normal(0, 0.02, (60, CHANNELS))
    distances = brute(motion, sequence)
    found = starts_within(motion, sequence, threshold=threshold)
    np.testing.assert_array_equal(found.starts, np.flatnonzero(distances <= threshold))
    np.testing.assert_allclose(found.distances, distances[found.starts], rtol=1e-12)


def test_an_exact_copy_is_found_at_threshold_zero():
    motion = acted(np.random.default_rng(0), 1000)
    assert starts_within(motion, motion[300:380], threshold=0.0).starts.tolist() == [300]


def test_planted_gestures_are_found_without_a_threshold():
    rng = np.random.default_rng(0)
    motion = 0.1 * acted(rng, 4000)
    planted = [400, 1234, 2500, 3900]
    for start in planted:
        motion[start : start + 50] += gesture() * rng.uniform(0.85, 1.15)
    found = find_sequence(motion, gesture())
    assert len(found.starts) == 4
    assert np.abs(found.starts - planted).max() <= 2
    assert (found.distances <= found.threshold).all()


@pytest.mark.parametrize("start", [0, 1, 137, 939, 940])
def test_a_copy_is_found_where_it_is_also_at_the_ends_of_a_take(start: int):
    motion = acted(np.random.default_rng(0), 1000)
    found = find_sequence(motion, motion[start : start + 60])
    assert start in found.starts


def test_a_motion_without_the_gesture_holds_none():
    found = find_sequence(0.1 * acted(np.random.default_rng(0), 4000), gesture())
    assert not len(found.starts)


def test_scale_of_length_and_channels_leaves_the_distance_as_it_is():
    rng = np.random.default_rng(0)
    motion = acted(rng, 400)
    sequence = gesture()
    one = brute(motion, sequence)[10]
    twice = np.concatenate([motion[10:60], motion[10:60]])
    longer = sequence_distances(twice, np.concatenate([sequence, sequence]), np.array([0]))[0]
    wider = sequence_distances(np.c_[motion, motion], np.c_[sequence, sequence], np.array([10]))[0]
    assert longer == pytest.approx(one)
    assert wider == pytest.approx(one)


def test_starts_within_one_interval_become_their_average():
    starts = np.array([100, 101, 102, 103, 300, 310, 500])
    assert merge_starts(starts, 50).tolist() == [102, 305, 500]
    assert merge_starts(np.array([], dtype=np.int64), 50).tolist() == []


def test_no_two_finds_overlap():
    rng = np.random.default_rng(0)
    motion = acted(rng, 3000)
    found = find_sequence(motion, motion[100:140], threshold=0.42)
    assert len(found.starts) > 3
    assert (np.diff(found.starts) >= 40).all()
    assert (found.distances <= 0.42).all()


def test_the_best_match_is_that_of_brute_force():
    rng = np.random.default_rng(0)
    motion, sequence = acted(rng, 2000), gesture()
    distances = brute(motion, sequence)
    found = best_match(motion, sequence)
    assert found.starts.tolist() == [int(distances.argmin())]
    assert found.distances[0] == pytest.approx(distances.min())


def test_held_distance_is_that_of_the_best_still_face_in_the_mean():
    sequence = gesture()
    still = np.repeat(sequence.mean(0)[None], 50, axis=0)
    assert mean_face_distance(sequence) == pytest.approx(
        sequence_distances(still, sequence, np.array([0]))[0]
    )


@pytest.mark.parametrize("weight", [1.0, 0.1, 0.3])  # means of 0.1 are rounded
def test_a_sequence_that_stands_still_is_like_any_face_at_rest(weight: float):
    with pytest.raises(ValueError, match="stands still"):
        find_sequence(np.zeros((100, CHANNELS)), np.full((11, CHANNELS), weight))
