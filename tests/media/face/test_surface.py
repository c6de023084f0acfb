from dataclasses import replace

import numpy as np
import pytest

from tests.media.forms import mesh, sphere
from usdface.media.face.parts import FacePart, find_pieces, part_from_name
from usdface.media.face.subdivision import catmull_clark
from usdface.numerics.surface.triangulation import normal_operator, triangulate, vertex_normals

CUBE = mesh(
    np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], float),
    [[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]],
)


def test_normals_of_a_sphere_point_away_from_its_middle() -> None:
    ball = sphere(50.0)
    triangles, _ = triangulate(ball.face_counts, ball.face_indices)
    operator = normal_operator(triangles, point_count=len(ball.points))
    normals = vertex_normals(ball.points, triangles, operator)
    np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1, atol=1e-9)
    assert np.sum(normals * ball.points / 50.0, axis=1).min() > 0.998


def test_subdivided_cube_has_the_points_of_catmull_and_clark() -> None:
    step = catmull_clark(CUBE.face_counts, CUBE.face_indices, point_count=8)
    fine = step.matrix @ CUBE.points
    assert fine.shape == (8 + 12 + 6, 3)
    # By hand, in a corner: Q = 1/3, R = 2/3 and n = 3, so (1/3 + 4/3 + 0) / 3 = 5/9.
    np.testing.assert_allclose(fine[:8], CUBE.points * 5 / 9)
    # Middle of an edge: (2 ends + 2 face points) / 4 = (1 + 1 + 1 + 0) / 4 and so on.
    np.testing.assert_allclose(
        np.sort(np.abs(fine[8:20]), axis=1), np.tile([0, 0.75, 0.75], (12, 1))
    )
    np.testing.assert_allclose(np.sort(np.abs(fine[20:]), axis=1), np.tile([0, 0, 1], (6, 1)))
    assert np.all(step.face_counts == 4)
    np.testing.assert_array_equal(step.parents, np.repeat(np.arange(6), 4))


def test_subdivision_keeps_a_plane_flat_and_its_border_straight() -> None:
    rows, columns = np.mgrid[:4, :5]
    points = np.stack([columns.ravel(), rows.ravel(), np.zeros(20)], axis=1).astype(float)
    faces = [
        [r * 5 + c, r * 5 + c + 1, r * 5 + c + 6, r * 5 + c + 5] for r in range(3) for c in range(4)
    ]
    grid = mesh(points, faces)
    step = catmull_clark(grid.face_counts, grid.face_indices, point_count=20)
    fine = step.matrix @ points
    np.testing.assert_allclose(step.matrix.sum(axis=1), 1)
    np.testing.assert_allclose(fine[:, 2], 0)
    np.testing.assert_allclose(fine.min(axis=0)[:2], [0, 0])
    np.testing.assert_allclose(fine.max(axis=0)[:2], [4, 3])
    np.testing.assert_allclose(fine[0], points[0])  # a corner of one face stays


def test_subdivision_keeps_the_way_polygons_face() -> None:
    step = catmull_clark(CUBE.face_counts, CUBE.face_indices, point_count=8)
    fine = step.matrix @ CUBE.points
    triangles, _ = triangulate(step.face_counts, step.face_indices)

    def volume(points, corners):
        return np.sum(np.linalg.det(points[corners])) / 6

    cage, _ = triangulate(CUBE.face_counts, CUBE.face_indices)
    assert volume(CUBE.points, cage) == pytest.approx(8)
    assert 0.3 * 8 < volume(fine, triangles) < 8


@pytest.mark.parametrize(
    ("name", "part"),
    [
        ("/Hero/geo/eye_L", FacePart.EYE),
        ("/Hero/geo/leftEye", FacePart.EYE),
        ("/Hero/geo/eyeball_R_geo", FacePart.EYE),
        ("/Hero/geo/eyelashes_upper", FacePart.HAIR),
        ("/Hero/geo/Eyebrows", FacePart.HAIR),
        ("/Hero/geo/lowerTeeth", FacePart.TEETH),
        ("/Hero/geo/tongue", FacePart.MOUTH),
        ("/Hero/geo/cornea_L", FacePart.HIDDEN),
        ("/Hero/geo/head", None),
        ("/Hero/geo/eyelid_L", None),
        ("/Hero/geo/l_eyelid_geo", None),
        ("/eyes/face", None),
    ],
)
def test_names_tell_what_a_mesh_is(name: str, part: FacePart | None) -> None:
    assert part_from_name(name) == part


@pytest.mark.parametrize("path", ["/Hero/eye_left", "/Hero/button"])
def test_an_eye_with_a_flat_back_is_an_eyeball_where_its_name_says_so(path: str) -> None:
    head = sphere(100.0, path="/Hero/head")
    ball = sphere(20.0, rows=8, columns=12, path=path)
    middle = np.array([40.0, 30.0, 85.0])
    front = ball.points[:, 2] >= -1
    corners = np.where(front, np.cumsum(front) - 1, front.sum())  # the back is one point
    half = replace(
        ball,
        points=np.concatenate([ball.points[front], np.zeros((1, 3))]) + middle,
        face_indices=corners[ball.face_indices],
    )
    pieces = find_pieces(
        [head, half], exposure=lambda: np.ones(len(head.points) + len(half.points))
    )
    balls = [each for each in pieces.eyeballs.values() if each.radius < 50]
    assert len(balls) == ("eye" in path)
    for each in balls:
        np.testing.assert_allclose(each.center, middle, atol=0.5)
        assert each.radius == pytest.approx(20.0, rel=0.02)
