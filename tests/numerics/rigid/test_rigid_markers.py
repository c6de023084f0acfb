"""The skull's markers among many on skin, some of which moves as one."""

import json

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from usdface.numerics.rigid.rigid_markers import find_rigid_markers
from usdface.numerics.rigid.stabilization import stabilize


def test_skin_that_moves_as_one_is_not_taken_for_the_skull():
    """Most markers sit on skin, and most of that keeps its form, nearly."""
    rng = np.random.default_rng(0)
    t = np.arange(400) / 60
    skull = rng.uniform(-70, 70, (5, 3))
    cheeks, chin = rng.uniform(-40, 40, (30, 3)), rng.uniform(-30, 30, (10, 3))
    swing = np.sin(t * [[1.0], [2.1], [0.6]]).T[:, None]
    soft = 0.3 * rng.standard_normal((1, 30, 3)) * swing
    face = np.concatenate(
        [
            np.broadcast_to(skull, (400, 5, 3)),
            cheeks + 4 * swing + soft,
            chin - 15 * swing * rng.standard_normal((10, 3)),
        ],
        axis=1,
    )
    turns = Rotation.from_rotvec(np.outer(np.sin(t), [0.2, 0.4, 0.1])).as_matrix()
    captured = np.einsum("fij,fkj->fki", turns, face) + 0.15 * rng.standard_normal(face.shape)
    found = find_rigid_markers(captured, np.ones(captured.shape[:2], bool))
    assert found.indices == (0, 1, 2, 3, 4)


@pytest.mark.parametrize("start", [900, 1800, 6300, 7200])
def test_quarter_minutes_of_a_take_tell_the_heads_rotation(shared_data, start):
    """Taking out one by one alone left 0.9 to 2.9 degrees in these."""
    from usdface.capture.sniff import read_capture

    markers = read_capture(shared_data / "crosstake/take.c3d").take.markers
    named = json.loads((shared_data / "crosstake/take.json").read_text())["rigid"]
    skull = [markers.names.index(name) for name in named]
    positions = markers.positions[start : start + 900]
    seen = markers.visible[start : start + 900]
    found = find_rigid_markers(positions, seen)
    assert set(found.indices) <= set(skull)
    together = seen[:, skull].all(axis=1)
    neutral = int(np.flatnonzero(together)[0])
    turns = [
        stabilize(positions, seen, rigid=rigid, neutral=neutral).head_motion[:, :3, :3]
        for rigid in (skull, found.indices)
    ]
    off = Rotation.from_matrix(np.swapaxes(turns[0], 1, 2) @ turns[1]).magnitude()
    assert np.rad2deg(np.sqrt((off**2).mean())) < 0.2
