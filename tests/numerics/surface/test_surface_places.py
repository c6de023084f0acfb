"""Places on polygon meshes: where they are, and how a person writes them down."""

import numpy as np
import pytest

from usdface.numerics.surface.surface_places import (
    nearest_places,
    place_on_polygon,
    places_at_points,
    places_of_corners,
    polygon_weights,
)

COUNTS = np.array([4, 3])
INDICES = np.array([0, 1, 2, 3, 1, 4, 2])


def bent_sheet() -> np.ndarray:
    """A quad that is not flat, and a triangle beside it."""
    return np.array([[0, 0, 0], [10, 0, 0], [10, 10, 4], [0, 10, 0], [18, 3, 0]], float)


def test_the_nearest_place_is_as_near_as_any_of_many_samples() -> None:
    rng = np.random.default_rng(0)
    points = bent_sheet()
    wanted = rng.uniform(-5, 25, (40, 3))
    found = nearest_places(points, COUNTS, INDICES, wanted).positions(points)
    triangles = points[[[0, 1, 2], [0, 2, 3], [1, 4, 2]]]
    weights = rng.dirichlet(np.ones(3), 4000)
    samples = np.einsum("sk,tkc->tsc", weights, triangles).reshape(-1, 3)
    away = np.linalg.norm(found - wanted, axis=1)
    nearest_sample = np.linalg.norm(samples[:, None] - wanted, axis=2).min(axis=0)
    assert (away <= nearest_sample + 1e-9).all()
    assert np.abs(away - nearest_sample).max() < 0.5


def test_a_place_on_the_surface_is_its_own_nearest() -> None:
    points = bent_sheet()
    wanted = np.array([[0.25, 0.5, 0.25]]) @ points[[1, 4, 2]]
    found = nearest_places(points, COUNTS, INDICES, wanted)
    assert found.faces.tolist() == [1]
    np.testing.assert_allclose(found.positions(points), wanted, atol=1e-12)


def test_places_written_as_weights_of_a_polygon_are_read_back_where_they_were() -> None:
    rng = np.random.default_rng(0)
    points = bent_sheet()
    places = nearest_places(points, COUNTS, INDICES, rng.uniform(0, 18, (30, 3)))
    before = places.positions(points)
    for index, weights in enumerate(polygon_weights(places, COUNTS, INDICES)):
        again = place_on_polygon(
            points, COUNTS, INDICES, face=int(places.faces[index]), weights=weights
        )
        np.testing.assert_allclose(again.positions(points)[0], before[index], atol=1e-9)


def test_weights_over_all_corners_of_a_quad_come_onto_its_surface() -> None:
    points = bent_sheet()
    place = place_on_polygon(points, COUNTS, INDICES, face=0, weights=np.full(4, 0.25))
    assert place.faces.tolist() == [0]
    assert np.linalg.norm(place.positions(points)[0] - points[:4].mean(axis=0)) < 1.0


def test_places_move_with_the_surface() -> None:
    rng = np.random.default_rng(0)
    points = bent_sheet()
    places = nearest_places(points, COUNTS, INDICES, rng.uniform(0, 18, (12, 3)))
    turn, shift = np.linalg.qr(rng.normal(size=(3, 3)))[0], rng.normal(size=3)
    np.testing.assert_allclose(
        places.positions(points @ turn.T + shift), places.positions(points) @ turn.T + shift
    )


def test_points_and_corners_name_the_same_places() -> None:
    points = bent_sheet()
    at = places_at_points(COUNTS, INDICES, np.array([4, 2]))
    np.testing.assert_array_equal(at.positions(points), points[[4, 2]])
    corners = np.array([[2, 0, 1], [3, 3, 3]])
    weights = np.array([[0.2, 0.3, 0.5], [1.0, 0.0, 0.0]])
    found = places_of_corners(COUNTS, INDICES, corners, weights)
    np.testing.assert_allclose(
        found.positions(points), np.einsum("pk,pkc->pc", weights, points[corners])
    )
    assert found.faces.tolist() == [0, 0]


@pytest.mark.parametrize(
    ("face", "weights", "message"),
    [
        (7, [0.5, 0.5, 0.0], "there is no face 7; the mesh has 2"),
        (0, [0.5, 0.25, 0.25], "face 0 has 4 corners and 3 weights are given"),
        (1, [0.9, 0.9, 0.9], "not 0 or more with sum 1"),
        (1, [1.5, -0.5, 0.0], "not 0 or more with sum 1"),
        (1, [np.nan, 0.5, 0.5], "not 0 or more with sum 1"),
    ],
)
def test_places_off_the_mesh_are_refused(face: int, weights: list[float], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        place_on_polygon(bent_sheet(), COUNTS, INDICES, face=face, weights=np.array(weights))


def test_a_point_of_no_face_is_refused() -> None:
    with pytest.raises(ValueError, match="point 9 belongs to no face"):
        places_at_points(COUNTS, INDICES, np.array([9]))
    with pytest.raises(ValueError, match="share no face"):
        places_of_corners(COUNTS, INDICES, np.array([[0, 3, 4]]), np.full((1, 3), 1 / 3))
