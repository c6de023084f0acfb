"""Frames that are worth a look: the right ones, spread in time, as many as asked for."""

from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from usdface.model.review.moments import ReviewSignals
from usdface.model.review.verdict import SolveEvidence
from usdface.steps.review.scoring import choose_frames


def curves(frames: int = 300, **evidence: Any) -> dict[str, Any]:
    rng = np.random.default_rng(0)
    known = {name: rng.random((frames, 1)) for name in ("uncertainty_mm", "residual_mm")}
    return {
        "strength": rng.random(frames),
        "signals": ReviewSignals(
            SolveEvidence(("face",), **(known | evidence)), rng.random((frames, 1))
        ),
        "rate": 60.0,
    }


@pytest.mark.parametrize("pick", ["review", "residual", "uncertainty", "jump", "expression"])
def test_the_most_extreme_frame_is_always_shown(pick: str) -> None:
    shown = curves()
    signals = shown["signals"]
    curve = {
        "review": signals.score_mm,
        "residual": signals.evidence.residual_mm,
        "uncertainty": signals.evidence.uncertainty_mm,
        "jump": signals.jump_mm,
        "expression": shown["strength"],
    }[pick]
    assert int(np.argmax(curve)) in [frame.row for frame in choose_frames(pick, 7, **shown)]


@pytest.mark.parametrize("count", [2, 4, 12])
def test_the_worst_moment_is_among_the_expressions_of_every_sheet(count: int) -> None:
    shown = curves()
    shown["strength"] = np.arange(300)[::-1].astype(float)
    worst = int(np.argmax(shown["signals"].score_mm))
    rows = [frame.row for frame in choose_frames("expression", count, **shown)]
    assert worst in rows


def test_one_bad_moment_is_one_row() -> None:
    error = np.full((300, 1), 0.1)
    error[100:110] = 9.0  # one long mistake, and a short one far away
    error[250] = 5.0
    rows = [frame.row for frame in choose_frames("review", 2, **curves(error_mm=error))]
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


def test_where_few_errors_are_known_the_worst_are_those_and_no_error_is_made_up() -> None:
    error = np.random.default_rng(1).random((300, 1))
    error[3:] = np.nan
    shown = curves(error_mm=error)
    worst = choose_frames("review", 10, **shown)
    assert [(frame.row, frame.reason) for frame in worst] == [
        (int(np.nanargmax(error)), f"{np.nanmax(error):.2f} mm off the keys")
    ]
    for frame in choose_frames("expression", 60, **shown):
        assert frame.reason == "" or frame.row < 3
