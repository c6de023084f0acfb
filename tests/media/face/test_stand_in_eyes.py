from dataclasses import replace

import numpy as np
import pytest

from tests.media.forms import mesh, sphere
from usdface.core.assets import MeshShape, RigMesh, ShapeKey
from usdface.media.face.camera import frame_rig
from usdface.media.face.render import FaceRenderer
from usdface.media.face.stand_in_eyes import fit_stand_in_eyes

EYES = ((-35.0, 25.0), (35.0, 25.0))


def head_with_holes() -> RigMesh:
    """A ball with two openings, whose upper rims a blink brings down to the lower ones."""
    ball = sphere(100.0, rows=90, columns=180)
    x, y, z = ball.points.T
    open_eye = np.zeros(len(ball.points), bool)
    for cx, cy in EYES:
        open_eye |= (((x - cx) / 16) ** 2 + ((y - cy) / 7) ** 2 < 1) & (z > 0)
    faces = [list(f) for f in np.split(ball.face_indices, np.cumsum(ball.face_counts)[:-1])]
    faces = [face for face in faces if not open_eye[face].any()]
    used = np.unique(np.concatenate(faces))
    at = np.full(len(ball.points), -1)
    at[used] = np.arange(len(used))
    face = mesh(ball.points[used], [[int(at[i]) for i in f] for f in faces])
    shapes = []
    for side, (cx, cy) in zip("RL", EYES, strict=True):
        x, y, z = face.points.T
        lid = (np.abs(x - cx) < 18) & (y > cy) & (y < cy + 14) & (z > 0)
        drop = np.zeros((int(lid.sum()), 3))
        drop[:, 1] = -14 * np.sqrt(np.clip(1 - ((x[lid] - cx) / 18) ** 2, 0, 1))
        posed = face.points[lid] + drop
        # The lid slides over the ball's surface.
        drop[:, 2] = np.sqrt(np.maximum(100.0**2 - posed[:, 0] ** 2 - posed[:, 1] ** 2, 0)) - z[lid]
        shapes.append(MeshShape(f"eyeBlink_{side}", (ShapeKey(1.0, np.flatnonzero(lid), drop),)))
    return replace(face, shapes=tuple(shapes))


def test_balls_fill_the_openings_and_stay_behind_the_lids() -> None:
    face = head_with_holes()
    eyes = fit_stand_in_eyes([face])
    assert eyes is not None
    balls, _ = eyes
    centers = sorted(tuple(ball.points.mean(axis=0)) for ball in balls)
    for (x, y, z), (cx, cy) in zip(centers, EYES, strict=True):
        assert x == pytest.approx(cx, abs=2)
        assert y == pytest.approx(cy, abs=2)
        radius = np.linalg.norm(balls[0].points - balls[0].points.mean(axis=0), axis=1)
        skin = np.sqrt(100.0**2 - x**2 - y**2)
        assert skin - 8 < z + radius.max() < skin + 0.5


def test_balls_follow_the_head_wherever_it_turns() -> None:
    face = head_with_holes()
    eyes = fit_stand_in_eyes([face])
    assert eyes is not None
    balls, attached = eyes
    rest = np.concatenate([ball.points for ball in balls])
    angle = np.radians(40)
    turn = np.array(
        [[np.cos(angle), 0, np.sin(angle)], [0, 1, 0], [-np.sin(angle), 0, np.cos(angle)]]
    )
    moved = face.points @ turn.T + [120.0, -30.0, 700.0]
    np.testing.assert_allclose(attached @ moved, rest @ turn.T + [120.0, -30.0, 700.0], atol=1e-6)


def test_balls_stay_where_they_are_in_a_blink() -> None:
    face = head_with_holes()
    eyes = fit_stand_in_eyes([face])
    assert eyes is not None
    balls, attached = eyes
    blink = face.points.copy()
    for shape in face.shapes:
        blink[shape.keys[0].points] += shape.keys[0].offsets
    rest = np.concatenate([ball.points for ball in balls])
    np.testing.assert_allclose(attached @ blink, rest, atol=1e-6)


def test_renderer_says_that_eyes_were_put_in_and_a_blink_hides_them() -> None:
    face = head_with_holes()
    renderer = FaceRenderer([face])
    assert renderer.has_stand_in_eyes
    camera = frame_rig([face])
    column, row = camera.project(np.array([[35.0, 25.0, 92.0]]), width=200, height=200)[0, :2]
    window = (slice(int(row) - 1, int(row) + 2), slice(int(column) - 1, int(column) + 2))
    blink = face.points.copy()
    for shape in face.shapes:
        blink[shape.keys[0].points] += shape.keys[0].offsets
    shots = [
        renderer.render(points, camera=camera, width=200, height=200)
        for points in (face.points, blink)
    ]
    assert shots[0][window].mean() < 70  # the pupil
    assert shots[1][window].mean() > 90  # skin


def test_ball_without_lids_gets_no_eyes() -> None:
    assert fit_stand_in_eyes([sphere()]) is None
    assert not FaceRenderer([sphere()]).has_stand_in_eyes
