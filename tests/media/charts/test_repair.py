"""The picture of what cleaning repaired."""

import numpy as np
import pytest

from usdface.core.errors import InputError
from usdface.media.charts.repair import (
    HEAD_HEIGHT,
    MARKER_LABEL_WIDTH,
    MOST_LANES,
    REPAIR_MARGIN,
    RepairKind,
    draw_repairs,
)


def kind(label: str, color: tuple[int, int, int], *cells: tuple[int, int]) -> RepairKind:
    where = np.zeros((5000, 3), dtype=np.bool_)
    for frame, marker in cells:
        where[frame, marker] = True
    return RepairKind(label, color, where)


def draw(*kinds: RepairKind, **more) -> np.ndarray:
    return draw_repairs(
        ["a", "b", "c"],
        kinds,
        title="t",
        verdict=("good", "v"),
        facts=("f",),
        first_frame=1,
        **more,
    )


def test_a_single_repaired_sample_of_a_long_take_shows() -> None:
    picture = draw(kind("outlier", (255, 0, 255), (4321, 1)))
    lanes = picture[HEAD_HEIGHT:, REPAIR_MARGIN + MARKER_LABEL_WIDTH :]
    columns = np.flatnonzero((lanes == (255, 0, 255)).all(axis=2).any(axis=0))
    assert len(columns) == 1
    assert columns[0] / lanes[:, :-REPAIR_MARGIN].shape[1] == pytest.approx(4321 / 5000, abs=0.002)


def test_only_repaired_markers_have_a_lane_and_the_worst_comes_first() -> None:
    few = draw(kind("x", (1, 2, 3), (0, 0)))
    more = draw(kind("x", (1, 2, 3), (0, 0), (5, 2), (9, 2)))
    assert more.shape[0] > few.shape[0]
    rows = np.flatnonzero((more[HEAD_HEIGHT:] == (1, 2, 3)).all(axis=2).any(axis=1))
    first_lane = (more[HEAD_HEIGHT + rows[0]] == (1, 2, 3)).all(axis=1).sum()
    last_lane = (more[HEAD_HEIGHT + rows[-1]] == (1, 2, 3)).all(axis=1).sum()
    assert first_lane == 2
    assert last_lane == 1


def test_nothing_repaired_is_said() -> None:
    assert draw(kind("x", (1, 2, 3))).shape[0] == HEAD_HEIGHT  # and there is no empty axis


def test_markers_of_short_repairs_share_a_lane() -> None:
    cells = [(0, 0), (5, 2), *((frame, 1) for frame in range(20, 30))]
    apart = draw(kind("x", (1, 2, 3), *cells))
    together = draw(kind("x", (1, 2, 3), *cells), least_frames=5)
    lanes = [
        (each[HEAD_HEIGHT:] == (1, 2, 3)).all(axis=2).any(axis=1) for each in (apart, together)
    ]
    assert [np.count_nonzero(np.diff(each.astype(int)) == 1) for each in lanes] == [3, 2]


def test_a_picture_of_many_markers_stays_a_picture() -> None:
    where = np.ones((50, 400), dtype=np.bool_)
    picture = draw_repairs(
        [f"m{k}" for k in range(400)],
        [RepairKind("x", (1, 2, 3), where)],
        title="t",
        verdict=("bad", "v"),
        facts=(),
        first_frame=1,
    )
    assert picture.shape[0] < HEAD_HEIGHT + (MOST_LANES + 4) * 20


def test_kinds_that_do_not_fit_are_refused() -> None:
    with pytest.raises(InputError, match=r"must be \(frames, 2\) arrays"):
        draw_repairs(
            ["a", "b"],
            [kind("x", (1, 2, 3))],
            title="",
            verdict=("good", ""),
            facts=(),
            first_frame=1,
        )
