"""Rows chosen one after the other, each the furthest from what is there already."""

import numpy as np

from usdface.numerics.regression.pivoted_selection import most_different_rows


def test_the_chosen_rows_are_those_of_a_pivoted_qr() -> None:
    from scipy.linalg import qr

    rows = np.random.default_rng(0).normal(size=(40, 12)) * np.linspace(0.2, 3, 40)[:, None]
    _, _, pivots = qr(rows.T, pivoting=True, mode="economic")
    np.testing.assert_array_equal(most_different_rows(rows, 9), pivots[:9])


def test_half_a_smile_is_not_chosen_beside_the_smile() -> None:
    smile, jaw = np.eye(5)[:2] * [[10], [6]]
    rows = np.array([0.5 * smile, smile, 0.9 * smile, jaw, 0.2 * jaw])
    assert most_different_rows(rows, 4).tolist() == [1, 3]


def test_rows_of_nothing_give_nothing() -> None:
    assert most_different_rows(np.zeros((4, 3)), 2).tolist() == []
    assert most_different_rows(np.zeros((0, 3)), 2).tolist() == []


def test_a_row_of_a_thousandth_of_the_largest_is_the_least_that_counts() -> None:
    rows = np.diag([10.0, 0.05, 0.011, 0.009])
    assert most_different_rows(rows, 4).tolist() == [0, 1, 2]
