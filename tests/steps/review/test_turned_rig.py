"""A rig that does not face Z is drawn from where it faces."""

from types import SimpleNamespace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tests.model.placement.test_rig_orientation import transformed
from tests.steps.small_shot import Shot
from usdface.demo.rig import demo_rig
from usdface.runner.execute import execute
from usdface.specs.references import PlaceSpec
from usdface.steps.inputs import placed_takes
from usdface.steps.review.shot import ShotCamera
from usdface.usdio.rig.read import read_rig
from usdface.usdio.rig.write import write_rig

TURN = Rotation.from_euler("y", 135, degrees=True).as_matrix()


@pytest.mark.parametrize("name", ["auto", "front"])
def test_the_camera_stands_before_the_face(name: str) -> None:
    rig = demo_rig()
    straight, turned = (
        ShotCamera(SimpleNamespace(rig=each, motion=None, performance=None), name).at(1)  # type: ignore[arg-type]
        for each in (rig, transformed(rig, TURN))
    )
    views = [np.subtract(each.target, each.eye) for each in (straight, turned)]
    across = views[1] @ (TURN @ views[0]) / np.prod([np.linalg.norm(each) for each in views])
    assert np.degrees(np.arccos(min(across, 1.0))) < 3


def test_a_placement_is_drawn_from_the_front_and_says_where_that_is(
    shot: Shot, monkeypatch: pytest.MonkeyPatch
) -> None:
    write_rig(shot / "turned.usdc", transformed(read_rig(shot / "hero.usdc"), TURN))
    drawn: dict[str, object] = {}

    def record(*_: object, **options: object) -> np.ndarray:
        drawn.update(options)
        return np.zeros((8, 8, 3), np.uint8)

    monkeypatch.setattr(placed_takes, "draw_binding", record)
    execute(
        PlaceSpec(
            takes=(shot / "shot.clean.take.usda",),
            rig=shot / "turned.usdc",
            out=shot / "turned.placement.usda",
            picture=shot / "turned.jpg",
        )
    )
    assert drawn["yaw_degrees"] == pytest.approx(135, abs=3)
    assert "the rig faces 135 degrees from Z, about Y" in drawn["facts"]  # type: ignore[operator]
