"""Points in folds follow their own side, all others and all markers stay as they were."""

import numpy as np

from usdface.numerics.manifold.surface_fields import find_folds

# a hairpin: two lips of 30 mm, 2 mm apart, joined at the left end; markers on either lip
UPPER = np.stack([np.linspace(0, 30, 31), np.full(31, 1.0)], axis=1)
LOWER = UPPER * [1, -1]
POINTS = np.concatenate([UPPER, LOWER])
MARKERS = np.array([10, 25, 41, 56])
DETOURS = np.array([[0.0, 0, 0.8, 0.9], [0, 0, 0.9, 0.9], [0.8, 0.9, 0, 0], [0.9, 0.9, 0, 0]])


def hairpin() -> tuple[np.ndarray, np.ndarray]:
    """Distances along it and through the air from the markers to every point."""
    along = np.where(POINTS[:, 1] > 0, -POINTS[:, 0] - 1, POINTS[:, 0] + 1)
    straight = np.linalg.norm(POINTS[MARKERS][:, None] - POINTS, axis=2)
    return np.abs(along[MARKERS][:, None] - along), straight


def test_a_point_deep_in_the_fold_follows_its_own_lip() -> None:
    folds = find_folds(*hairpin(), detours=DETOURS, spread=40.0)
    tip = np.flatnonzero(folds.points == 30)[0]
    assert folds.share[tip] > 0.95
    assert folds.weights[tip, :2].sum() > 0.999
    assert 5.0 <= folds.away[tip] < 5.1
    moved = np.zeros((62, 1))
    folds.apply(moved, np.array([[1.0], [1], [-1], [-1]]))
    assert moved[30] > 0.95
    assert moved[61] < -0.95


def test_markers_keep_what_they_say() -> None:
    values = np.random.default_rng(0).standard_normal((62, 3))
    before = values.copy()
    find_folds(*hairpin(), detours=DETOURS, spread=40.0).apply(values, values[MARKERS])
    assert np.allclose(values[MARKERS], before[MARKERS], atol=1e-6)


def test_a_surface_without_folds_is_left_alone() -> None:
    _, straight = hairpin()
    folds = find_folds(1.4 * straight, straight, detours=DETOURS, spread=40.0)
    assert len(folds.points) == 0
    values = np.ones((62, 2))
    folds.apply(values, np.zeros((4, 2)))
    assert (values == 1).all()


def test_what_is_far_through_the_air_is_no_fold() -> None:
    along, straight = hairpin()
    assert not len(find_folds(10 * along, straight + 50.0, detours=DETOURS, spread=40.0).points)


def test_what_is_farther_than_twice_the_nearest_marker_of_its_side_is_no_fold() -> None:
    along, straight = hairpin()
    far = np.maximum(straight, 2 * along.min(axis=0))
    assert not len(find_folds(10 * along, 10 * far, detours=DETOURS, spread=40.0).points)


def test_folds_do_not_depend_on_the_unit_of_length() -> None:
    along, straight = hairpin()
    ours = find_folds(along, straight, detours=DETOURS, spread=40.0)
    scaled = find_folds(10 * along, 10 * straight, detours=DETOURS, spread=400.0)
    assert np.allclose(ours.share, scaled.share)
    assert np.allclose(ours.weights, scaled.weights, atol=1e-6)


def test_a_lip_follows_the_chin_and_not_the_nearer_corner_of_the_mouth() -> None:
    """Markers at the nose, the corner and the chin; a point on the lower lip."""
    along, straight = np.array([[60.0], [30.0], [35.0]]), np.array([[15.0], [29.0], [34.0]])
    detours = 1 - np.array([[1.0, 1.0, 0.6], [1.0, 1.0, 1.0], [0.6, 1.0, 1.0]])
    folds = find_folds(along, straight, detours=detours, spread=60.0)
    assert folds.weights[0].argmax() == 2
    assert folds.weights[0, 2] > 0.95
    assert folds.away[0] < 36.0
    without = find_folds(along, straight, detours=np.zeros((3, 3)), spread=60.0)
    assert without.weights[0].argmax() == 1
