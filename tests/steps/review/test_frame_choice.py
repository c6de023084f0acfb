"""Frames that are worth a look: the right ones, spread in time, as many as asked for."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from usdface.steps.review.scoring import choose_frames


def curves(frames: int = 300) -> dict[str, np.ndarray]:
    rng = np.random.default_rng(0)
    return {
        "strength": rng.random(frames),
        "error_mm": rng.random(frames),
        "uncertainty_mm": rng.random(frames),
        "jump_mm": rng.random(frames),
    }


@pytest.mark.parametrize(
    ("pick", "curve", "extreme"),
    [
        ("residual", "error_mm", np.argmax),
        ("uncertainty", "uncertainty_mm", np.argmax),
        ("jump", "jump_mm", np.argmax),
        ("expression", "strength", np.argmax),
    ],
)
def test_the_most_extreme_frame_is_always_shown(pick, curve, extreme) -> None:
    given_curves = curves()
    chosen = choose_frames(pick, 7, **given_curves)
    assert int(extreme(given_curves[curve])) in [frame.row for frame in chosen]


def test_one_bad_moment_is_one_row() -> None:
    shown = curves()
    shown["error_mm"][100:110] = 9.0  # one long mistake, and a short one far away
    shown["error_mm"][250] = 5.0
    rows = [frame.row for frame in choose_frames("residual", 2, **shown)]
    assert len([row for row in rows if 100 <= row < 110]) == 1
    assert 250 in rows


@given(
    pick=st.sampled_from(["expression", "residual", "uncertainty", "jump", "even"]),
    count=st.integers(1, 40),
    frames=st.integers(1, 60),
)
def test_as_many_rows_as_asked_for_in_order_and_none_twice(pick, count, frames) -> None:
    rows = [frame.row for frame in choose_frames(pick, count, **curves(frames))]
    assert rows == sorted(set(rows))
    assert len(rows) == min(count, frames)
    assert 0 <= rows[0] <= rows[-1] < frames


def test_frames_whose_error_is_unknown_are_not_the_worst() -> None:
    shown = curves()
    shown["error_mm"][:150] = np.nan
    assert all(frame.row >= 150 for frame in choose_frames("residual", 10, **shown))


def test_where_few_errors_are_known_the_worst_are_those_and_no_error_is_made_up() -> None:
    shown = curves()
    shown["error_mm"][3:] = np.nan
    worst = choose_frames("residual", 10, **shown)
    assert [frame.row for frame in worst] == [0, 1, 2]
    assert all(frame.reason == f"error {shown['error_mm'][frame.row]:.2f} mm" for frame in worst)
    for frame in choose_frames("expression", 60, **shown):
        assert frame.reason == "" or frame.row < 3
    shown["error_mm"][:] = np.nan
    plain = choose_frames("residual", 10, **shown)
    assert [frame.reason for frame in plain] == [""] * 10
