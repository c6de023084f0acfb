import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from usdface.numerics.regression.cross_validation import (
    FEWEST_TRAINING_ROWS,
    blocked_folds,
    surface_rms_mm,
    weight_rmse,
)


@given(
    frames=st.lists(st.integers(0, 4000), min_size=2, max_size=60),
    takes=st.integers(1, 4),
    folds=st.integers(2, 8),
    margin=st.integers(0, 100),
)
def test_every_row_is_tested_once_and_never_trained_on_in_its_own_fold(
    frames: list[int], takes: int, folds: int, margin: int
) -> None:
    names = [f"take{i % takes}" for i in range(len(frames))]
    made = blocked_folds(frames, names, folds=folds, margin=margin)
    tested = np.concatenate([fold.test for fold in made])
    assert sorted(tested) == list(range(len(frames)))
    for fold in made:
        assert len(fold.train) >= min(FEWEST_TRAINING_ROWS, len(frames) - len(fold.test))
        assert not set(fold.train) & set(fold.test)


def test_neighbours_in_time_never_face_each_other() -> None:
    rng = np.random.default_rng(0)
    frames = rng.choice(5000, 60, replace=False)
    takes = [f"take{i % 3}" for i in range(60)]
    for fold in blocked_folds(frames, takes, folds=5, margin=30):
        for test in fold.test:
            same = [i for i in fold.train if takes[i] == takes[test]]
            assert all(abs(int(frames[i] - frames[test])) > 30 for i in same)


def test_the_same_frame_number_of_another_take_is_no_neighbour() -> None:
    folds = blocked_folds([10, 10, 10, 10], ["a", "b", "c", "d"], folds=4, margin=100)
    assert all(len(fold.train) == 3 for fold in folds)


def test_a_dense_run_is_cut_into_blocks_with_a_gap() -> None:
    frames = np.arange(100)
    for fold in blocked_folds(frames, ["a"] * 100, folds=4, margin=5):
        assert np.abs(frames[fold.train][:, None] - frames[fold.test]).min() > 5


def test_where_nearly_all_are_neighbours_all_that_are_not_tested_teach() -> None:
    for fold in blocked_folds(np.arange(8) * 10, ["a"] * 8, folds=5, margin=30):
        assert len(fold.train) >= FEWEST_TRAINING_ROWS


def test_folds_are_nearly_equal_in_size() -> None:
    frames = np.arange(50) * 100
    sizes = [len(fold.test) for fold in blocked_folds(frames, ["a"] * 50, folds=5)]
    assert sizes == [10] * 5


def test_surface_error_equals_moving_every_point() -> None:
    rng = np.random.default_rng(0)
    displacement = rng.normal(size=(6, 40, 3))
    errors = rng.normal(size=(9, 6))
    gram = np.einsum("spc,tpc->st", displacement, displacement) / 40
    moved = np.einsum("fs,spc->fpc", errors, displacement)
    expected = np.sqrt((moved**2).sum(axis=2).mean())
    assert surface_rms_mm(errors, gram) == pytest.approx(expected, rel=1e-12)
    assert weight_rmse(errors) == pytest.approx(np.sqrt((errors**2).mean()))
    assert np.isnan(weight_rmse(errors[:, :0]))


def test_too_few_pairs_or_folds_are_refused() -> None:
    with pytest.raises(ValueError, match="cannot make 5 folds of 1 pairs"):
        blocked_folds([1], ["a"])


def test_pairs_exactly_a_margin_apart_are_neighbours_and_stay_together() -> None:
    frames = np.concatenate([[start, start + 30] for start in range(0, 2000, 200)])
    for fold in blocked_folds(frames, ["a"] * 20, folds=5, margin=30):
        assert set(fold.test // 2) & set(fold.train // 2) == set()
        assert len(fold.train) == 16  # none had to be left out
