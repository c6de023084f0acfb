"""Markers that move on the skin are found, and put back; skin that moves is not."""

import numpy as np
import pytest

from usdface.core.arrays import FloatArray
from usdface.numerics.repair.cleaning import CleanedMarkers, clean_markers

MARKERS, FRAMES, RATE = 24, 1500, 60.0
RIGID = (0, 1, 2, 3)


def performance(seed: int = 0) -> FloatArray:
    """Six expressions that come and go, no head motion, noise of 0.1 mm."""
    rng = np.random.default_rng(3)
    neutral = rng.uniform([-60, -70, 0], [60, 70, 60], size=(MARKERS, 3))
    shapes = rng.normal(size=(6, MARKERS, 3)) * 3.0
    shapes[:, RIGID] = 0.0
    rng = np.random.default_rng(seed)
    waves = np.sin(np.arange(FRAMES)[:, None] / RATE * rng.uniform(1.5, 6.0, 6) + rng.uniform(0, 6))
    moved = neutral + np.einsum("fs,smc->fmc", np.clip(waves, 0, 1), shapes)
    return np.asarray(moved + 0.1 * rng.normal(size=moved.shape))


def cleaned(positions: FloatArray, neutral: int = 0) -> CleanedMarkers:
    seen = np.ones(positions.shape[:2], bool)
    seen[300:330, 10] = False
    return clean_markers(positions, seen, rigid=RIGID, neutral=neutral, rate=RATE)


@pytest.mark.parametrize("neutral", [0, FRAMES - 1])
@pytest.mark.parametrize(("marker", "row"), [(10, 400), (17, 1200)])
def test_a_marker_that_slips_is_put_back_where_it_sat_in_the_neutral(
    marker: int, row: int, neutral: int
) -> None:
    positions, offset = performance(), np.array([2.0, -1.5, 0.5])
    truth = positions.copy()
    positions[row:, marker] += offset
    if neutral > row:
        truth[:, marker] += offset
    found = cleaned(positions, neutral)
    (slip,) = found.slips
    assert slip.marker == marker
    assert abs(slip.row - row) <= RATE / 2
    np.testing.assert_allclose(slip.offset, offset, atol=0.4)
    away = np.linalg.norm(found.positions[:, marker] - truth[:, marker], axis=1)
    assert np.delete(away, np.arange(row - 40, row + 40)).mean() < 0.5


@pytest.mark.parametrize("held", [240, 600])
def test_a_lid_that_shuts_is_not_opened(held: int) -> None:
    """Shut for the last four seconds it is an expression, for the last ten it is named."""
    positions = performance()
    truth = positions.copy()
    positions[-held:, 12, 1] -= 9.0
    found = cleaned(positions)
    assert [slip.marker for slip in found.slips] == ([12] if held == 600 else [])
    away = np.linalg.norm(found.positions[-held + 30 :, 12] - truth[-held + 30 :, 12], axis=1)
    assert away.mean() > 8.0


@pytest.mark.parametrize("seed", range(4))
def test_a_face_that_moves_has_no_slips(seed: int) -> None:
    positions = performance(seed)
    bump = np.exp(-(((np.arange(FRAMES) - 700) / 90) ** 2))
    positions[:, 15, 0] += 5.0 * bump  # an expression of one marker that comes and goes
    assert not cleaned(positions).slips
