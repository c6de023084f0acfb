"""Rows of long quads over a bend are lit as the bend, not as a comb."""

from inspect import unwrap

import numpy as np

from tests.media.forms import mesh, plate, sphere
from usdface.core.assets import RigMesh
from usdface.core.deformer import Deformer
from usdface.demo.rig import demo_rig
from usdface.media.face.camera import Camera
from usdface.media.face.mesh_topology import cut_polygons
from usdface.media.face.render import FaceRenderer
from usdface.media.face.surface import build_surface


def elbow(rows: int, columns: int) -> RigMesh:
    """A plane that becomes a tube within few rows, as a jaw becomes a neck."""
    along, across = np.meshgrid(np.linspace(-1, 1, rows + 1), np.linspace(-1, 1, columns + 1))
    y = 60 * along
    x = 60 * across + 15 * along  # columns lean
    z = -0.01 * x**2 * (1 + np.tanh(3 * along))
    points = np.stack([x, y, z], axis=-1).transpose(1, 0, 2).reshape(-1, 3)
    corner = np.arange(rows * (columns + 1)).reshape(rows, -1)[:, :-1].ravel()
    faces = np.stack([corner, corner + 1, corner + columns + 2, corner + columns + 1], axis=1)
    return mesh(points, faces.tolist(), colors=np.full((len(points), 3), 0.5))


def comb(picture: np.ndarray) -> float:
    """How much light goes up and down again within few pixels of a row [steps of a byte]."""
    rows = picture.astype(float).mean(axis=2)
    ripple = np.diff(rows, n=2, axis=1)
    return float(np.percentile(np.abs(ripple), 90))


def test_there_is_no_comb_between_jaw_and_neck(monkeypatch) -> None:
    rig = demo_rig()
    weights = np.zeros((1, len(rig.shapes)))
    weights[0, rig.shapes.index("jawOpen")] = 0.6
    posed = Deformer(rig).points(weights)[0]
    target = np.array([10.0, -115.0, 10.0])
    toward = np.array([-0.49, -0.64, 0.59])
    eye = target + 400.0 * toward
    camera = Camera(eye=tuple(eye), target=tuple(target), fov_degrees=10.0)

    def draw() -> np.ndarray:
        picture = FaceRenderer(rig.meshes).render(posed, camera=camera, width=300, height=300)
        return picture[110:170, 80:160]

    mended = comb(draw())
    monkeypatch.setattr("usdface.media.face.render.build_surface", unwrap(build_surface))
    monkeypatch.setattr("usdface.media.face.surface.LONG_EDGE", np.inf)
    assert mended < 0.6 * comb(draw())


def test_flat_and_short_quads_are_left_as_they_are() -> None:
    flat, ball = plate(100.0, 0.0), sphere(50.0)
    for form in (flat, ball):
        cut = cut_polygons(form.points, form.face_counts, form.face_indices, least_edge=10.0)
        assert not len(cut.corners)
        assert len(cut.triangles) == (form.face_counts - 2).sum()


def test_cutting_covers_every_polygon_once() -> None:
    form = elbow(6, 40)
    cut = cut_polygons(form.points, form.face_counts, form.face_indices, least_edge=1.0)
    assert len(cut.corners) > 50
    every = np.concatenate([form.points, cut.middles @ form.points])
    np.testing.assert_allclose(
        every[len(form.points) :], form.points[cut.corners].mean(axis=1), atol=1e-9
    )
    assert np.array_equal(np.unique(cut.faces), np.arange(len(form.face_counts)))
    # Flattened onto the picture, areas add up to those of the polygons: nothing twice, no hole.
    a, b, c = (every[cut.triangles[:, k], :2] for k in range(3))
    twice = (b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0]
    quads = form.points[form.face_indices.reshape(-1, 4), :2]
    one, other = quads[:, 2] - quads[:, 0], quads[:, 3] - quads[:, 1]
    areas = one[:, 0] * other[:, 1] - one[:, 1] * other[:, 0]
    np.testing.assert_allclose(np.bincount(cut.faces, twice), areas, rtol=1e-9)


def test_a_middle_is_turned_as_the_mean_of_its_corners() -> None:
    surface = build_surface([elbow(6, 40)])
    normals = surface.normals_at(surface.rest.astype(np.float64))
    summed = normals[surface.middles.corners].sum(axis=1)
    expected = summed / np.linalg.norm(summed, axis=1, keepdims=True)
    np.testing.assert_allclose(normals[surface.middles.points], expected, atol=1e-12)
