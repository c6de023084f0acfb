"""Faces have the colours their materials give them, to the edge of each polygon."""

from dataclasses import replace

import numpy as np

from tests.media.forms import mesh, sphere
from usdface.core.assets import RigMesh
from usdface.media.face import shading
from usdface.media.face.camera import Camera
from usdface.media.face.complexion import is_plain_eye, tone
from usdface.media.face.parts import FacePart
from usdface.media.face.render import FaceRenderer
from usdface.media.face.surface import build_surface

FAR = Camera(eye=(0.0, 0.0, 3000.0), target=(0.0, 0.0, 0.0), fov_degrees=4.0)
RED, BLUE = (0.7, 0.02, 0.02, 1.0), (0.02, 0.02, 0.7, 1.0)


def two_halves(**fields) -> RigMesh:
    """Two squares that share an edge, so that no colour of points could part them."""
    points = np.array([[x, y, 0.0] for y in (-90, 90) for x in (-90, 0, 90)])
    return mesh(points, [[0, 1, 4, 3], [1, 2, 5, 4]], **fields)


def draw(form: RigMesh, **options) -> np.ndarray:
    return FaceRenderer([form]).render(
        form.points, camera=FAR, width=120, height=120, quality="draft", **options
    )


def test_two_materials_meet_at_the_edge_of_their_faces() -> None:
    form = two_halves(face_colors=np.array([RED, BLUE]))
    row = draw(form)[60].astype(int)
    assert (row[20:59, 0] > 2 * row[20:59, 2]).all()
    assert (row[61:100, 2] > 2 * row[61:100, 0]).all()


def test_materials_do_not_colour_a_heat_map() -> None:
    values = np.arange(6.0)
    plain, painted = two_halves(), two_halves(face_colors=np.array([RED, BLUE]))
    np.testing.assert_array_equal(
        draw(painted, values=values, value_range=(0, 5)),
        draw(plain, values=values, value_range=(0, 5)),
    )


def test_a_clear_face_hides_nothing() -> None:
    ball = sphere(40.0, colors=np.full((4514, 3), 0.4))
    glass = two_halves(path="/Glass")
    glass = replace(
        glass, points=glass.points + np.array([0, 0, 100.0]), face_colors=np.array([BLUE] * 2)
    )
    clear = replace(glass, face_colors=np.array([(*BLUE[:3], 0.1)] * 2))
    shown = [
        FaceRenderer([ball, pane]).render(
            np.concatenate([ball.points, pane.points]),
            camera=FAR,
            width=90,
            height=90,
            quality="draft",
        )
        for pane in (glass, clear)
    ]
    alone = FaceRenderer([ball]).render(
        ball.points, camera=FAR, width=90, height=90, quality="draft"
    )
    assert np.abs(shown[0][45, 45].astype(int) - alone[45, 45]).max() > 60
    assert np.abs(shown[1].astype(int) - alone).mean() < 3


def test_faces_keep_their_material_when_a_cage_is_subdivided() -> None:
    ball = sphere(60.0, rows=8, columns=16)
    left = ball.points[ball.face_indices[np.cumsum(ball.face_counts) - 2], 0] < 0
    colors = np.where(left[:, None], RED, BLUE)
    form = replace(ball, subdivision="catmullClark", face_colors=colors)
    surface = build_surface([form])
    middle = surface.rest[surface.triangles].mean(axis=1)
    far = np.abs(middle[:, 0]) > 25
    assert ((surface.painted[far, 0] > 0.5) == (middle[far, 0] < 0)).all()


def head_with_eyes(**fields) -> RigMesh:
    parts = [sphere(100.0)]
    for side in (-35.0, 35.0):
        eye = sphere(14.0, rows=24, columns=48)
        parts.append(replace(eye, points=eye.points + np.array([side, 30.0, 92.0])))
    first = np.cumsum([0, *(len(part.points) for part in parts)])
    return RigMesh(
        path="/Head",
        points=np.concatenate([part.points for part in parts]),
        face_counts=np.concatenate([part.face_counts for part in parts]),
        face_indices=np.concatenate(
            [part.face_indices + start for part, start in zip(parts, first, strict=False)]
        ),
        **fields,
    )


def test_one_material_over_a_whole_head_is_its_skin_and_not_its_eyes() -> None:
    bare = head_with_eyes()
    green = np.tile([0.1, 0.4, 0.1, 1.0], (len(bare.face_counts), 1))
    toned = replace(bare, face_colors=green)
    assert tone(toned) is not None
    surface = build_surface([toned])
    point_parts = np.zeros(len(surface.rest), int)
    point_parts[surface.triangles] = surface.parts[:, None]
    eyes = point_parts == FacePart.EYE
    assert eyes.any()
    assert np.abs(surface.albedo[eyes] - shading.SCLERA).max() < 1e-3
    np.testing.assert_allclose(np.median(surface.albedo[~eyes], axis=0), [0.1, 0.4, 0.1], atol=1e-3)
    assert (surface.eyes >= 0).any(), "the iris is painted"


def test_eyes_that_are_one_white_get_an_iris_and_eyes_with_one_keep_theirs() -> None:
    bare = head_with_eyes()
    skin = len(sphere(100.0).points)
    colors = np.full((len(bare.points), 3), 0.5)
    white = build_surface([replace(bare, colors=colors)])
    assert (white.eyes >= 0).any()
    colors[skin::2] = 0.05  # somebody painted them
    own = build_surface([replace(bare, colors=colors)])
    assert (own.eyes < 0).all()
    assert not is_plain_eye(np.full((5, 3), 0.02)), "an animal's black eye stays black"
