from dataclasses import replace

import numpy as np
import pytest
from scipy import ndimage

from tests.media.forms import head, mesh, plate, sphere
from usdface.core.errors import InputError
from usdface.media.face import raycast, shading
from usdface.media.face.camera import Camera, frame_face, frame_rig, motion_weights
from usdface.media.face.render import FaceRenderer
from usdface.media.face.tracing import Tracer, sky_seen, traced_triangles

FAR = Camera(eye=(0.0, 0.0, 5000.0), target=(0.0, 0.0, 0.0), fov_degrees=2.0)
WHITE = np.ones((4, 3)) * 0.8


def wall(height: int, width: int) -> np.ndarray:
    """What is drawn behind the face: a speck out of view leaves nothing else."""
    speck = plate(0.1, 0.0)
    away = Camera(eye=(0.0, 1000.0, 500.0), target=(0.0, 1000.0, 0.0))
    return FaceRenderer([speck]).render(
        speck.points, camera=away, width=width, height=height, quality="draft"
    )


def draw(meshes, camera=FAR, size=200, **options) -> np.ndarray:
    points = np.concatenate([m.points for m in meshes])
    return FaceRenderer(meshes).render(points, camera=camera, width=size, height=size, **options)


def test_silhouette_of_a_sphere_has_the_area_of_its_disc() -> None:
    ball = sphere(50.0, rows=96, columns=192)
    size, distance = 240, 400.0
    camera = Camera(eye=(0.0, 0.0, distance), target=(0.0, 0.0, 0.0), fov_degrees=20.0)
    picture = draw([ball], camera, size, quality="draft")
    covered = np.any(picture != wall(size, size), axis=2).sum()
    # The cone that touches the sphere meets the picture plane in a disc of tan(asin(r / d)).
    radius = np.tan(np.arcsin(50.0 / distance)) / np.tan(np.radians(10)) * size / 2
    assert covered == pytest.approx(np.pi * radius**2, rel=0.025)  # its edge pixels count whole


def test_on_paper_the_background_is_white_up_to_the_edge() -> None:
    ball = sphere(50.0, rows=96, columns=192)
    camera = Camera(eye=(0.0, 0.0, 400.0), target=(0.0, 0.0, 0.0), fov_degrees=20.0)
    paper, screen = (
        FaceRenderer([ball], paper=each).render(
            ball.points, camera=camera, width=120, height=120, quality="draft"
        )
        for each in (True, False)
    )
    behind = (screen == wall(120, 120)).all(axis=2)
    assert (paper[behind] == 255).all()
    inside = ndimage.binary_erosion(~behind, iterations=2)
    np.testing.assert_array_equal(paper[inside], screen[inside])
    assert (paper[~behind] >= screen[~behind]).all()


def test_projection_meets_the_ray_through_the_same_pixel() -> None:
    camera = Camera(eye=(30.0, 40.0, 500.0), target=(5.0, 0.0, 0.0), fov_degrees=25.0)
    pixels = np.random.default_rng(0).uniform(0, 300, (50, 2))
    points = camera.eye + 470.0 * camera.directions(pixels, width=320, height=300)
    np.testing.assert_allclose(
        camera.project(points, width=320, height=300)[:, :2], pixels, atol=1e-2
    )


def test_shadow_falls_where_the_light_is_hidden() -> None:
    shade = plate(60.0, 120.0, path="/Shade")
    floor = plate(600.0, 0.0, path="/Floor", colors=WHITE)
    grid = [[i, i + 1, i + 2, i + 3] for i in (0, 4)]
    both = mesh(np.concatenate([floor.points, shade.points]), grid)
    # The key light comes from the upper left: the shadow lies to the lower right of the plate.
    renderer = FaceRenderer([both])
    camera = Camera(eye=(0.0, 0.0, 2000.0), target=(0.0, 0.0, 0.0), fov_degrees=16.0)
    lit = renderer.render(both.points, camera=camera, width=200, height=200)
    key = shading.KEY_DIRECTION
    moved = -key / key[2] * 120.0
    middle = camera.project(moved[None], width=200, height=200)[0, :2].astype(int)
    mirrored = 199 - middle
    assert moved[0] > 0 > moved[1]
    assert lit[middle[1], middle[0]].mean() < 0.75 * lit[mirrored[1], mirrored[0]].mean()


def test_same_pose_gives_the_same_picture_byte_for_byte() -> None:
    ball = sphere()
    camera = frame_face(ball.points)
    np.testing.assert_array_equal(draw([ball], camera), draw([ball], camera))


def test_mirrored_camera_sees_what_the_light_rig_lights() -> None:
    # Light travels with the camera, so a ball looks alike from every side.
    ball = sphere(rows=64, columns=128)
    front = draw([ball], frame_face(ball.points))
    side = draw([ball], frame_face(ball.points, yaw_degrees=90))
    difference = np.abs(front.astype(int) - side)
    assert np.percentile(difference, 99) <= 4


@pytest.mark.parametrize("quality", ["draft", "final"])
def test_face_fills_the_frame_and_is_neither_black_nor_burnt_out(quality: str) -> None:
    face = head()
    picture = draw([face], frame_rig([face]), 160, quality=quality)
    middle = picture[40:120, 40:120].astype(float)
    assert 60 < middle.mean() < 220
    assert middle.std() > 3
    assert (picture.min(axis=2) > 250).mean() < 0.01


def test_frame_holds_the_open_jaw_and_leaves_out_what_no_shape_moves() -> None:
    face = head()
    shoulders = sphere(400.0, path="/Shoulders")
    meshes = [face, shoulders]
    camera = frame_rig(meshes)
    weights = motion_weights(meshes)
    assert np.all(weights[len(face.points) :] == 0)
    jaw = face.points[face.shapes[0].keys[0].points] + [0, -30.0, 0]
    at = camera.project(jaw, width=100, height=100)
    assert at[:, :2].min() > 0
    assert at[:, :2].max() < 100
    far = camera.project(shoulders.points, width=100, height=100)
    assert far[:, 1].max() > 150


def test_frame_centres_a_turned_face() -> None:
    points = np.random.default_rng(0).normal([300, 1500, -20], 40, (500, 3))
    for yaw in (-60, 0, 35):
        camera = frame_face(points, yaw_degrees=yaw, aspect=0.8)
        at = camera.project(points, width=400, height=500)
        assert at[:, 0].min() > 0
        assert at[:, 0].max() < 400
        assert at[:, 1].min() > 0
        assert at[:, 1].max() < 500


def test_a_renderer_draws_each_pose_as_one_that_drew_no_other() -> None:
    ball, camera = sphere(), Camera(eye=(0.0, 0.0, 900.0), target=(0.0, 0.0, 0.0))
    renderer, values = FaceRenderer([ball]), np.linspace(0, 1, len(ball.points))
    plain = {"width": 64, "camera": camera, "sculpted": None}
    beside = {"camera": replace(camera, eye=(300.0, 0.0, 800.0))}
    uneven = {"sculpted": np.sin(ball.points)}
    for size, other in [(1.0, {}), (0.8, {}), (1.0, {}), (1.2, {}), (1.0, {})] + [
        (1.0, each) for each in (beside, {"width": 48}, uneven, {"quality": "draft"}, {})
    ]:
        for painted in (None, values):
            both = [
                each.render(size * ball.points, height=64, values=painted, **(plain | other))
                for each in (renderer, FaceRenderer([ball]))
            ]
            np.testing.assert_array_equal(*both)


def test_heat_map_shows_where_the_values_are() -> None:
    ball = sphere()
    values = (ball.points[:, 0] > 0).astype(float)
    picture = draw([ball], frame_face(ball.points), 120, values=values, value_range=(0.0, 1.0))
    left, right = picture[60, 35].astype(int), picture[60, 85].astype(int)
    assert left[2] > left[0]  # blue for nothing
    assert right[0] > right[2]  # yellow for much


def test_what_has_no_value_is_grey_and_leaves_its_neighbours_theirs() -> None:
    ball = sphere()
    camera, values = frame_face(ball.points), np.ones(len(ball.points))
    full = draw([ball], camera, 120, values=values, value_range=(0.0, 1.0))
    values[ball.points[:, 0] < 0] = np.nan
    picture = draw([ball], camera, 120, values=values, value_range=(0.0, 1.0)).astype(int)
    assert np.ptp(picture[60, 35]) < 6
    np.testing.assert_array_equal(picture[60, 85], full[60, 85])
    with pytest.raises(InputError, match="values to draw"):
        draw([ball], camera, 120, values=values + np.inf)


def test_hidden_meshes_are_not_drawn_and_still_count_points() -> None:
    ball, guide = sphere(), sphere(80.0, path="/Guide", visible=False)
    renderer = FaceRenderer([guide, ball])
    together = np.concatenate([guide.points, ball.points])
    camera = frame_face(ball.points)
    picture = renderer.render(together, camera=camera, width=90, height=90)
    np.testing.assert_array_equal(picture, draw([ball], camera, 90))


def test_loose_eyeballs_are_recognised_and_get_dark_pupils() -> None:
    parts = [sphere(100.0)]
    for side in (-35.0, 35.0):
        eye = sphere(14.0, rows=24, columns=48)
        parts.append(mesh(eye.points + np.array([side, 30.0, 92.0]), _faces(eye)))
    joined = _join(parts)
    picture = draw([joined], frame_face(joined.points), 300)
    camera = frame_face(joined.points)
    for side in (-35.0, 35.0):
        spots = np.array([[side, 30.0, 106.0], [side + 10.5, 30.0, 102.0]])
        (x, y), (u, v) = camera.project(spots, width=300, height=300)[:, :2].astype(int)
        assert picture[y + 1, x + 1].mean() < 60  # pupil
        assert picture[v, u].mean() > 120  # the white beside the iris


def test_sky_above_a_floor_is_open_and_below_a_lid_is_not() -> None:
    lid, floor = plate(400.0, 10.0), plate(400.0, 0.0)
    triangles = np.array([[0, 1, 2], [0, 2, 3]])
    tracer = Tracer(
        np.concatenate([floor.points, lid.points]),
        traced_triangles(np.concatenate([triangles, triangles + 4])),
    )
    up = np.tile(np.array([[0, 0, 1]], np.float32), (2, 1))
    at = np.array([[0, 0, 1], [0, 0, 11]], np.float32)
    seen = sky_seen(tracer, at, up, patterns=np.array([0, 0]), ray_count=64, reach=1e6)
    np.testing.assert_allclose(seen, [0, 1], atol=0.02)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"points": "nan"}, "repair its deformation"),
        ({"width": 10**6, "height": 10**6}, "cannot be drawn"),
    ],
    ids=["nan", "too large"],
)
def test_pose_that_cannot_be_drawn_says_why(change: dict, message: str) -> None:
    ball = sphere()
    if isinstance(change.get("points"), str):
        change["points"] = np.where(np.arange(len(ball.points))[:, None] == 7, np.nan, ball.points)
    arguments = {"points": ball.points, "camera": FAR, "width": 20, "height": 20} | change
    with pytest.raises(InputError, match=message):
        FaceRenderer([ball]).render(arguments.pop("points"), **arguments)


def test_rig_with_nothing_to_see_is_refused() -> None:
    with pytest.raises(InputError, match=r"no visible mesh.*/Form"):
        FaceRenderer([sphere(visible=False)])


def _faces(form) -> list[list[int]]:
    return [list(f) for f in np.split(form.face_indices, np.cumsum(form.face_counts)[:-1])]


def _join(parts):
    faces, first = [], 0
    for part in parts:
        faces += [[first + i for i in face] for face in _faces(part)]
        first += len(part.points)
    return mesh(np.concatenate([part.points for part in parts]), faces)


@pytest.mark.parametrize("span_mm", [None, 150.0], ids=["perspective", "orthographic"])
def test_rays_are_cast_only_where_the_face_may_be(
    monkeypatch: pytest.MonkeyPatch, span_mm: float | None
) -> None:
    ball = sphere(50.0)
    camera = Camera(
        eye=(60.0, 40.0, 400.0), target=(30.0, -20.0, 0.0), fov_degrees=22.0, span_mm=span_mm
    )
    framed = draw([ball], camera, 120)
    counts = []

    def all_pixels(view: raycast.View) -> np.ndarray:
        counts.append(len(_framed_pixels(view)))
        return np.arange(view.height * view.width)

    _framed_pixels = raycast._framed_pixels
    monkeypatch.setattr(raycast, "_framed_pixels", all_pixels)
    np.testing.assert_array_equal(framed, draw([ball], camera, 120))
    assert 0 < counts[0] < 0.8 * 120 * 120


def test_face_around_the_camera_is_drawn() -> None:
    ball = sphere(50.0)
    inside = Camera(eye=(0.0, 0.0, 0.0), target=(0.0, 0.0, -10.0), fov_degrees=30.0)
    assert np.any(draw([ball], inside, 60) != wall(60, 60), axis=2).all()
