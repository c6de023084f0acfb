"""Long takes are cleaned a block of frames at a time: that must not show, and must save memory."""

import tracemalloc

import numpy as np
import pytest

from tests.numerics.simulated_face import SimulatedFace, simulate_face
from usdface.numerics.repair.cleaning import CleanedMarkers, clean_markers
from usdface.numerics.repair.smoothing import DETAIL_REACH, significant_detail

LAST_PLACE_MM = 8 * float(np.spacing(np.float32(1600)))
"""Of single precision, as far from the origin as the head is; sums differ by it between BLAS."""


def clean(face: SimulatedFace) -> CleanedMarkers:
    neutral = int(np.argmax(face.visible[:, list(face.rigid)].sum(axis=1)))
    captured = face.captured.astype(np.float32)
    return clean_markers(captured, face.visible, rigid=face.rigid, neutral=neutral, max_gap=60)


def set_blocks(monkeypatch: pytest.MonkeyPatch, frames: int) -> None:
    monkeypatch.setattr("usdface.core.arrays._BLOCK_FRAMES", frames)
    monkeypatch.setattr("usdface.numerics.repair.gap_filling._FILL_FRAMES", frames)


@pytest.fixture(scope="module")
def damaged() -> tuple[SimulatedFace, CleanedMarkers]:
    face = simulate_face(
        frames=900, markers=40, swapped_share=0.1, dropout_share=0.05, stray_count=18
    )
    face.visible[300:450, 20] = False  # a gap that is left, across borders of blocks
    face.visible[590:610, 5:9] = False
    return face, clean(face)


@pytest.mark.parametrize("frames", [64, 300])
def test_a_clean_take_does_not_depend_on_the_size_of_blocks(damaged, monkeypatch, frames):
    face, whole = damaged
    set_blocks(monkeypatch, frames)
    in_blocks = clean(face)
    np.testing.assert_allclose(in_blocks.positions, whole.positions, rtol=0, atol=LAST_PLACE_MM)
    np.testing.assert_allclose(in_blocks.head_motion, whole.head_motion, rtol=0, atol=LAST_PLACE_MM)
    for name in ("visible", "confidence", "outliers", "filled"):
        np.testing.assert_array_equal(getattr(in_blocks, name), getattr(whole, name))
    assert in_blocks.swaps == whole.swaps
    assert whole.swaps
    assert whole.outliers.any()
    assert not whole.visible[300:450, 20].any()


def test_a_gap_of_any_length_may_be_filled_whatever_the_size_of_blocks(damaged, monkeypatch):
    face, _ = damaged
    neutral = int(np.argmax(face.visible[:, list(face.rigid)].sum(axis=1)))
    results = []
    for frames, max_gap in ((64, 400), (2048, 10**6)):
        set_blocks(monkeypatch, frames)
        cleaned = clean_markers(
            face.captured, face.visible, rigid=face.rigid, neutral=neutral, max_gap=max_gap
        )
        assert cleaned.visible.all()
        results.append(cleaned.positions)
    np.testing.assert_allclose(results[0], results[1], rtol=0, atol=LAST_PLACE_MM)


def test_detail_farther_away_than_its_reach_does_not_count():
    rest = np.random.default_rng(0).standard_normal((1000, 3, 3))
    rest[480:500] += 3.0
    noise = np.ones(3)
    whole = significant_detail(rest, noise=noise)
    part = significant_detail(rest[400 - DETAIL_REACH : 600 + DETAIL_REACH], noise=noise)
    np.testing.assert_allclose(part[DETAIL_REACH:-DETAIL_REACH], whole[400:600], atol=1e-12)
    assert whole[400:600].any()


def test_a_captured_take_is_not_changed(damaged):
    face, _ = damaged
    captured, visible = face.captured.astype(np.float32), face.visible.copy()
    before = captured.copy()
    clean_markers(captured, visible, rigid=face.rigid, neutral=0)
    np.testing.assert_array_equal(captured, before)
    np.testing.assert_array_equal(visible, face.visible)


@pytest.mark.slow
def test_memory_grows_by_little_more_than_the_clean_take_itself():
    def peak(times: int) -> tuple[int, int]:
        positions, visible = np.tile(captured, (times, 1, 1)), np.tile(face.visible, (times, 1))
        tracemalloc.start()
        clean_markers(positions, visible, rigid=face.rigid, neutral=0)
        most = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
        return most, positions.nbytes

    face = simulate_face(frames=2_000, markers=40, dropout_share=0.01)
    captured = face.captured.astype(np.float32)
    (few, small), (many, large) = peak(10), peak(20)  # beyond what models are learned from
    assert (many - few) / (large - small) < 3  # its masks, confidence and scores are one of them
