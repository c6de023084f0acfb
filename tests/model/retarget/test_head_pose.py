"""A performer laid on a rig by what each shape moves."""

from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from tests.usdio.small_rig import small_rig
from usdface.capture.face_gaze import LOOK_SHAPES, look_weights
from usdface.core.assets import MeshShape, Rig, ShapeKey, TrainedMapping
from usdface.model.retarget.head_pose import EYES, look_angles, performer_onto_rig

SCALE = 1.2


def bumpy_rig(points: np.ndarray, moved: np.ndarray) -> Rig:
    """A rig of one mesh whose shapes move points by (shapes, points, 3)."""
    rig = small_rig()
    shapes = tuple(
        MeshShape(f"s{n}", (ShapeKey(1.0, np.arange(len(points)), each),))
        for n, each in enumerate(moved)
    )
    mesh = replace(rig.meshes[0], points=points, shapes=shapes, colors=None)
    names = tuple(shape.name for shape in shapes)
    return replace(rig, meshes=(mesh,), shapes=names, ranges=np.tile([0.0, 1.0], (len(names), 1)))


def test_looks_turn_eyes_as_far_as_the_gaze_that_they_were_made_from() -> None:
    yaw, pitch = np.array([0.0, 12, -25, 3]), np.array([7.0, -20, 0, 30])
    angles = look_angles(LOOK_SHAPES, look_weights(yaw, pitch).astype(float))
    expected = np.radians(np.stack([-pitch, yaw, np.zeros(4)], axis=1))
    assert angles.keys() == set(EYES)
    for eye in EYES:
        np.testing.assert_allclose(angles[eye], expected, atol=1e-6)


def test_what_is_known_of_a_shape_everywhere_makes_nobody_small() -> None:
    rng = np.random.default_rng(0)
    points = rng.uniform(-80, 80, (300, 3)) * [1.0, 1.0, 0.4]
    centres = points[rng.choice(300, 30, replace=False)]
    near = np.exp(-((points - centres[:, None]) ** 2).sum(axis=2) / (2 * 15.0**2))
    moved = near[:, :, None] * rng.normal(0, 3, (30, 1, 3))
    turn, shift = Rotation.from_rotvec([0.1, -0.3, 0.05]).as_matrix(), np.array([5.0, 90.0, -20.0])
    performer = (points - shift) @ turn / SCALE  # points = SCALE * turn @ performer + shift
    basis = moved @ turn / SCALE + rng.normal(0, 0.05, moved.shape)
    rig = bumpy_rig(points, moved)
    mapping = TrainedMapping(
        method="ridge",
        marker_names=tuple(map(str, range(300))),
        shape_names=rig.shapes,
        rigid=(),
        neutral=performer,
        ranges=rig.ranges,
        arrays={"forward_basis": basis},
    )
    onto = performer_onto_rig(mapping, rig)
    np.testing.assert_allclose(np.cbrt(np.linalg.det(onto[:3, :3])), SCALE, rtol=0.1)
    laid = performer @ onto[:3, :3].T + onto[:3, 3]
    assert np.sqrt(((laid - points) ** 2).sum(axis=1).mean()) < 8.0
