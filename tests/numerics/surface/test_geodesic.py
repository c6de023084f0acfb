"""Distances over surfaces whose distances are known."""

import numpy as np
import pytest

from usdface.numerics.surface.geodesic import Geodesics, euclidean_distances, geodesic_distances
from usdface.numerics.surface.surface_graph import join_parts
from usdface.numerics.surface.surface_places import SurfacePoints
from usdface.numerics.surface.triangulation import triangulate

METRICS = ("dijkstra", "dijkstra-diagonals")


def quad_grid(rows: int, columns: int, *, step: float = 1.0) -> tuple[np.ndarray, ...]:
    x, y = np.meshgrid(step * np.arange(columns), step * np.arange(rows))
    points = np.stack([x.ravel(), y.ravel(), np.zeros(x.size)], axis=1)
    first = (np.arange(rows - 1)[:, None] * columns + np.arange(columns - 1)).ravel()
    quads = np.stack([first, first + 1, first + columns + 1, first + columns], axis=1)
    return points, np.full(len(quads), 4), quads.ravel()


def sphere(rows: int, columns: int, radius: float) -> tuple[np.ndarray, ...]:
    theta = np.linspace(0.05, np.pi - 0.05, rows)
    phi = np.linspace(0, 2 * np.pi, columns, endpoint=False)
    t, p = np.meshgrid(theta, phi, indexing="ij")
    points = np.stack([np.sin(t) * np.cos(p), np.cos(t), np.sin(t) * np.sin(p)], axis=-1)
    i, j = np.meshgrid(np.arange(rows - 1), np.arange(columns), indexing="ij")
    near, far = i * columns + j, i * columns + (j + 1) % columns
    quads = np.stack([near, far, far + columns, near + columns], axis=-1).reshape(-1, 4)
    return radius * points.reshape(-1, 3), np.full(len(quads), 4), quads.ravel()


def measure(
    mesh: tuple[np.ndarray, ...], triangles: list[int], weights: np.ndarray, metric: str
) -> Geodesics:
    points, counts, indices = mesh
    corners, owners = triangulate(counts, indices)
    return geodesic_distances(
        points,
        counts,
        indices,
        SurfacePoints(owners[triangles], corners[triangles], np.asarray(weights, float)),
        metric=metric,  # type: ignore[arg-type]
    )


def places(rng: np.random.Generator, mesh: tuple[np.ndarray, ...], count: int) -> tuple:  # type: ignore[type-arg]
    triangles = triangulate(mesh[1], mesh[2])[0]
    return rng.choice(len(triangles), count).tolist(), rng.dirichlet([1, 1, 1], count)


def test_along_edges_a_flat_grid_measures_as_a_city_does_beyond_the_first_block() -> None:
    mesh = quad_grid(7, 9)
    found = measure(mesh, [0], [[1.0, 0.0, 0.0]], "dijkstra")
    x, y = mesh[0][:, 0], mesh[0][:, 1]
    across = np.where((x > 0) & (y > 0), 2 - 2**0.5, 0.0)  # the place's own face is open ground
    assert np.allclose(found.to_points[0], x + y - across, atol=1e-5)


def test_over_diagonals_a_flat_grid_measures_as_a_king_moves() -> None:
    mesh = quad_grid(7, 9)
    found = measure(mesh, [0], [[1.0, 0.0, 0.0]], "dijkstra-diagonals")
    long, short = mesh[0][:, :2].max(axis=1), mesh[0][:, :2].min(axis=1)
    assert np.allclose(found.to_points[0], long - short + 2**0.5 * short, atol=1e-5)


def test_on_a_sphere_distances_over_diagonals_are_nearly_those_of_great_circles() -> None:
    rng = np.random.default_rng(0)
    mesh = sphere(60, 120, 50.0)
    found = measure(mesh, *places(rng, mesh, 6), "dijkstra-diagonals")
    unit = found.positions / np.linalg.norm(found.positions, axis=1, keepdims=True)
    exact = 50.0 * np.arccos(np.clip(unit @ mesh[0].T / 50.0, -1, 1))
    far = exact > 10
    assert np.abs(found.to_points / np.maximum(exact, 1e-9) - 1)[far].mean() < 0.08


@pytest.mark.parametrize("metric", METRICS)
def test_no_way_is_shorter_than_the_straight_line(metric: str) -> None:
    rng = np.random.default_rng(0)
    mesh = sphere(30, 60, 50.0)
    found = measure(mesh, *places(rng, mesh, 5), metric)
    straight = euclidean_distances(found.positions, mesh[0])
    assert (found.to_points > straight - 1e-3).all()
    assert np.allclose(found.between, found.between.T)
    assert np.array_equal(np.diag(found.between), np.zeros(5))


@pytest.mark.parametrize("metric", METRICS)
def test_a_place_on_a_corner_measures_from_that_point_and_moves_smoothly_off_it(
    metric: str,
) -> None:
    mesh = quad_grid(15, 15)
    on, near = (
        measure(mesh, [196], [[1 - e, e / 2, e / 2]], metric).to_points[0] for e in (0.0, 1e-3)
    )
    corner = triangulate(mesh[1], mesh[2])[0][196, 0]
    assert on[corner] < 1e-6
    assert np.abs(on - near).max() < 5e-3


@pytest.mark.parametrize("metric", METRICS)
def test_turning_and_moving_a_mesh_changes_no_distance(metric: str) -> None:
    rng = np.random.default_rng(0)
    points, counts, indices = sphere(20, 40, 50.0)
    turn = np.linalg.qr(rng.standard_normal((3, 3)))[0]
    chosen = places(rng, (points, counts, indices), 4)
    here = measure((points, counts, indices), *chosen, metric)
    there = measure((points @ turn.T + [100, -30, 5], counts, indices), *chosen, metric)
    assert np.allclose(here.to_points, there.to_points, rtol=1e-3, atol=1e-2)


@pytest.mark.parametrize("metric", METRICS)
def test_lips_that_touch_are_two_places(metric: str) -> None:
    """A slit across a sheet: its two rims are the same points in space, and far apart."""
    points, counts, indices = quad_grid(21, 21)
    slit = [10 * 21 + column for column in range(3, 18)]
    twin = {point: len(points) + k for k, point in enumerate(slit)}
    quads = indices.reshape(-1, 4).copy()
    below = points[quads].mean(axis=1)[:, 1] < 10
    for point, other in twin.items():
        quads[below] = np.where(quads[below] == point, other, quads[below])
    mesh = np.concatenate([points, points[slit]]), counts, quads.ravel()
    triangles = triangulate(counts, quads.ravel())[0]
    upper = int(np.flatnonzero((triangles == slit[7]).any(axis=1))[0])
    weights = (triangles[upper] == slit[7]).astype(float)
    found = measure(mesh, [upper], weights[None], metric)
    assert found.to_points[0, slit[7]] < 1e-6
    assert found.to_points[0, twin[slit[7]]] > 12


@pytest.mark.parametrize("metric", METRICS)
def test_a_texture_seam_does_not_cut_the_surface(metric: str) -> None:
    """Exporters duplicate the points along a seam, which makes two parts that touch."""
    points, counts, indices = quad_grid(9, 9)
    seam = np.arange(4 * 9, 5 * 9)
    copy = np.arange(len(points))
    copy[seam] = len(points) + np.arange(9)
    quads = indices.reshape(-1, 4)
    below = points[quads].mean(axis=1)[:, 1] < 4
    cut = np.where(below[:, None], copy[quads], quads)
    whole = measure((points, counts, indices), [0], [[0.2, 0.3, 0.5]], metric)
    found = measure(
        (np.concatenate([points, points[seam]]), counts, cut.ravel()),
        [0],
        [[0.2, 0.3, 0.5]],
        metric,
    )
    assert np.allclose(found.to_points[:, : len(points)], whole.to_points, atol=1e-5)
    assert np.array_equal(found.to_points[:, seam], found.to_points[:, len(points) :])
    assert not found.islands.any()
    assert found.faults == whole.faults


@pytest.mark.parametrize("metric", METRICS)
def test_a_corner_with_a_copy_of_its_own_is_no_cut_and_two_in_a_row_are(metric: str) -> None:
    points, counts, indices = quad_grid(5, 6)
    whole = measure((points, counts, indices), [0], [[1.0, 0.0, 0.0]], metric)
    middle = 2 * 6 + 2
    faces = indices.reshape(-1, 4).copy()
    above = np.flatnonzero((faces == middle).any(axis=1))[-1]
    faces[above][faces[above] == middle] = len(points)
    copied = np.vstack([points, points[middle]])
    found = measure((copied, counts, faces.ravel()), [0], [[1.0, 0.0, 0.0]], metric)
    np.testing.assert_array_equal(found.to_points[0, :-1], whole.to_points[0])
    assert found.to_points[0, -1] == whole.to_points[0, middle]
    faces = indices.reshape(-1, 4).copy()
    lips = {middle: len(points), middle + 1: len(points) + 1}
    for row in np.flatnonzero((faces[:, :2, None] == list(lips)).any(axis=(1, 2))):
        faces[row] = [lips.get(each, each) for each in faces[row].tolist()]
    slit = np.vstack([points, points[list(lips)]])
    np.testing.assert_array_equal(
        join_parts(slit, counts, faces.ravel()), np.arange(len(slit)), "lips stay apart"
    )


def test_islands_are_told_apart_and_have_no_way_between_them() -> None:
    points, counts, indices = quad_grid(4, 4)
    two = np.concatenate([points, points + np.array([10, 0, 0])])
    mesh = two, np.tile(counts, 2), np.concatenate([indices, indices + 16])
    for metric in METRICS:
        found = measure(mesh, [0], [[1.0, 0.0, 0.0]], metric)
        assert np.isinf(found.to_points[0, 16:]).all()
        assert np.isfinite(found.to_points[0, :16]).all()
        assert len(np.unique(found.islands)) == 2


@pytest.mark.parametrize("metric", METRICS)
def test_a_fin_of_three_faces_on_an_edge_is_counted_and_crossed(metric: str) -> None:
    points = np.array([[0, 0, 0], [0, 1, 0], [1, 0, 0], [-1, 0, 0], [0, 0, 1.0]])
    indices = np.array([0, 1, 2, 0, 1, 3, 0, 1, 4])
    found = measure((points, np.full(3, 3), indices), [0], [[0.2, 0.2, 0.6]], metric)
    assert found.faults.nonmanifold_edges == 1
    assert np.isfinite(found.to_points).all()


def test_faces_of_no_area_are_counted_and_loose_points_not_reached() -> None:
    points = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [5, 5, 5.0]])
    found = measure(
        (points, np.array([3, 3]), np.array([0, 1, 2, 0, 0, 1])), [0], [[1, 0, 0]], "dijkstra"
    )
    assert found.faults.degenerate_faces == 1
    assert np.isinf(found.to_points[0, 3])


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"face_counts": np.zeros(0, int), "face_indices": np.zeros(0, int)}, "no face"),
        ({"points": np.full((16, 3), np.nan)}, "16 of 16 points are not finite"),
        ({"points": np.zeros((2, 16, 3))}, "one rest pose, not many"),
        ({"face_indices": np.full(36, 99)}, "faces use points 99 to 99 of 16"),
        ({"face_counts": np.full(8, 4)}, "add up to 32 corners and 36 are given"),
        ({"faces": np.array([99])}, "marker 0 sits on face 99 and the mesh has 9"),
        ({"weights": np.array([[2.0, -1.0, 0.0]])}, "marker 0 is not on its face"),
        ({"weights": np.array([[np.nan, 1.0, 0.0]])}, "marker 0 is not on its face"),
        ({"corners": np.array([[0, 1, 15]])}, "are not corners of face 0"),
        ({"metric": "crow"}, "no metric 'crow'; there are dijkstra, dijkstra-diagonals"),
    ],
)
def test_what_is_no_mesh_and_what_is_not_on_it_is_refused(
    change: dict[str, object], message: str
) -> None:
    points, counts, indices = quad_grid(4, 4)
    given = {
        "points": points,
        "face_counts": counts,
        "face_indices": indices,
        "faces": np.array([0]),
        "corners": np.array([[0, 1, 5]]),
        "weights": np.array([[1.0, 0, 0]]),
    } | change
    with pytest.raises(ValueError, match=message):
        geodesic_distances(
            given["points"],
            given["face_counts"],
            given["face_indices"],
            SurfacePoints(given["faces"], given["corners"], given["weights"]),
            metric=given.get("metric", "dijkstra"),
        )


@pytest.mark.parametrize("metric", METRICS)
def test_between_places_on_one_face_the_way_is_the_straight_line(metric: str) -> None:
    inside = [[0.6, 0.3, 0.1], [0.1, 0.3, 0.6], [0.3, 0.6, 0.1]]
    found = measure(quad_grid(5, 5), [4, 4, 5], np.array(inside), metric)
    straight = np.linalg.norm(found.positions[:, None] - found.positions, axis=2)
    np.testing.assert_allclose(found.between, straight, atol=1e-12)


def test_edges_of_two_faces_are_no_fault() -> None:
    found = measure(sphere(6, 8, 1.0), [0], [[1.0, 0.0, 0.0]], "dijkstra")
    assert found.faults.nonmanifold_edges == 0
