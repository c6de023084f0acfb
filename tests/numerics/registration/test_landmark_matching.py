"""Which markers may sit at landmarks, against the closed form and a cloud laid by hand."""

import numpy as np
import pytest

from usdface.numerics.registration.cloud_alignment import Alignment
from usdface.numerics.registration.landmark_matching import (
    FaceLandmarks,
    match_landmarks,
    refine_fit,
)
from usdface.numerics.registration.plane_fit import fit_in_plane, pitch_rotation

PLACES = np.array(
    [
        [0.0, 0.0, 30.0],
        [0.0, -60.0, 10.0],
        [26.0, -35.0, 8.0],
        [-26.0, -35.0, 8.0],
        [30.0, 45.0, 5.0],
        [-30.0, 45.0, 5.0],
        [50.0, 40.0, -10.0],
        [-50.0, 40.0, -10.0],
    ]
)


def face(places: np.ndarray = PLACES, area: float = 20_000.0) -> FaceLandmarks:
    names = tuple(f"landmark_{i}" for i in range(len(places)))
    return FaceLandmarks(names, places, np.full(len(places), 6.0), area)


def test_one_marker_on_a_landmark_has_the_probability_of_the_mixture() -> None:
    match = match_landmarks(PLACES[:1], face(PLACES[:1]), proportion_mm=8.0)
    ratio = 0.7 / (2 * np.pi * (6.0**2 + 8.0**2)) * 20_000.0
    assert match.probability[0] == pytest.approx(ratio / (1 + ratio))
    assert match.score == pytest.approx(np.log(1 + ratio))


def test_the_denser_the_cloud_the_less_a_pair_says() -> None:
    crowd = np.concatenate([PLACES, PLACES + np.array([200.0, 0.0, 0.0])])
    alone, among = match_landmarks(PLACES, face()), match_landmarks(crowd, face())
    np.testing.assert_array_equal(alone.markers, among.markers)
    assert (among.probability < alone.probability).all()


def test_pairs_are_those_of_the_markers_wherever_they_stand_in_the_list() -> None:
    order = np.random.default_rng(0).permutation(len(PLACES))
    match = match_landmarks(PLACES[order] + 2.0, face())
    np.testing.assert_array_equal(order[match.markers], match.landmarks)


def test_a_face_without_landmarks_matches_nothing() -> None:
    match = match_landmarks(PLACES, face(np.zeros((0, 3))))
    assert len(match.markers) == 0
    assert match.score == 0.0


def test_a_cloud_of_other_size_and_pitch_finds_its_landmarks() -> None:
    target = PLACES + np.array([3.0, 0.0, 0.0])
    cloud = (PLACES * [1.1, 1.15, 1.0]) @ pitch_rotation(0.1).T
    away = Alignment(np.ones(3), np.eye(3), np.array([3.0, 6.0, 2.0]))
    found = refine_fit(cloud, face(target), away, centre_x=3.0)
    np.testing.assert_allclose(found.apply(cloud), target, atol=2.5)


def test_targets_on_the_wrong_side_do_not_mirror_the_cloud() -> None:
    rng = np.random.default_rng(0)
    cloud = rng.normal(0, 40, (12, 3))
    fit = fit_in_plane(cloud, cloud * [-1, 1, 1], np.full(12, 5.0), centre_x=0.0)
    assert (fit.scale > 0).all()
