import numpy as np
import pytest

from usdface.media.charts.evaluation import (
    COLUMN_COUNT,
    LIPS_HEIGHT,
    MOST_SHAPES,
    PAGE_WIDTH,
    EvaluationPage,
    ShapeBar,
    draw_evaluation,
)
from usdface.media.picture.color import ORANGE, bytes_from_linear, heat_ramp
from usdface.media.picture.error_strip import ErrorCurve


def page(**changes: object) -> EvaluationPage:
    time = np.linspace(0, 20, 500)
    given: dict[str, object] = {
        "title": "hero against keys",
        "facts": ("0.3 mm RMS",),
        "curves": (ErrorCurve("face", np.abs(np.sin(time))),),
        "verdict": ("good", "Good: 0.04 mm off the keys"),
        "first_frame": 101,
        "worst": (200, 444),
        "lips": (5 + 4 * np.sin(time), 5 + 4 * np.sin(time) + 3),
        "shapes": tuple(ShapeBar(f"shape{i}", 0.1 / (i + 1), 0.01, 0.2) for i in range(7)),
    }
    return EvaluationPage(**(given | changes))  # type: ignore[arg-type]


def lit(picture: np.ndarray, color: tuple[int, int, int]) -> int:
    """Count pixels of a colour; lines are antialiased."""
    return int((np.abs(picture.astype(int) - color).max(axis=2) < 40).sum())


def lips_of(picture: np.ndarray) -> np.ndarray:
    """Return the rows of the plot of the lips, which stands above two or three rows of shapes."""
    return picture[-LIPS_HEIGHT - 240 : -180]


def test_what_is_not_known_takes_no_room() -> None:
    whole = draw_evaluation(page())
    without_lips = draw_evaluation(page(lips=None))
    without_shapes = draw_evaluation(page(shapes=()))
    assert whole.shape[1] == without_lips.shape[1] == without_shapes.shape[1]
    assert without_lips.shape[0] < whole.shape[0]
    assert without_shapes.shape[0] < whole.shape[0]
    assert lit(lips_of(whole), ORANGE) > 1000


def test_frames_that_were_not_compared_leave_gaps() -> None:
    lips = page().lips
    assert lips is not None
    keys, solve = lips
    sparse = np.where(np.arange(500) < 250, solve, np.nan)
    part, whole = (draw_evaluation(page(lips=(keys, each))) for each in (sparse, solve))
    part, whole = lips_of(part), lips_of(whole)
    assert 0.3 < lit(part, ORANGE) / lit(whole, ORANGE) < 0.7


def test_a_longer_bar_is_a_larger_error() -> None:
    bars = tuple(ShapeBar(str(i), rmse, 0.0, 0.2) for i, rmse in enumerate((0.2, 0.1)))
    picture = draw_evaluation(page(shapes=bars))[-80:]
    red, green, blue = (int(value) for value in bytes_from_linear(heat_ramp([1.0]))[0])
    first, second = (
        lit(
            picture[
                :, third * PAGE_WIDTH // COLUMN_COUNT : (third + 1) * PAGE_WIDTH // COLUMN_COUNT
            ],
            (red, green, blue),
        )
        for third in (0, 1)
    )
    assert first == pytest.approx(2 * second, rel=0.1)


def test_a_hundred_shapes_stay_on_one_page() -> None:
    many = tuple(ShapeBar(f"shape{i}", 0.1, 0.0, 0.2) for i in range(400))
    most = tuple(many[:MOST_SHAPES])
    assert draw_evaluation(page(shapes=many)).shape == draw_evaluation(page(shapes=most)).shape
    assert MOST_SHAPES % COLUMN_COUNT == 0


def test_a_performance_without_error_draws() -> None:
    none = np.zeros(500)
    flat = tuple(ShapeBar(f"shape{i}", 0.0, 0.0, 0.0) for i in range(3))
    lips = page().lips
    assert lips is not None
    picture = draw_evaluation(
        page(curves=(ErrorCurve("face", none),), shapes=flat, lips=(lips[0], lips[0]))
    )
    assert picture.dtype == np.uint8
