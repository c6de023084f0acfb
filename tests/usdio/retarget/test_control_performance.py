"""Every kind of control to disk and back, and as UsdSkel sees it."""

from pathlib import Path

import numpy as np
import pytest
from pxr import Usd, UsdSkel

from tests.usdio.small_creature import (
    ATTRIBUTES,
    JOINTS,
    creature_acts,
    human_moves,
    write_creature,
    write_creature_performance,
)
from usdface.core.errors import InputError
from usdface.core.sidecars import controls_path
from usdface.usdio.retarget.controls import (
    find_control_attributes,
    read_control_clip,
    rest_controls,
)
from usdface.usdio.validation import validate


def test_all_controls_come_back_as_they_were_written(tmp_path: Path) -> None:
    rig = write_creature(tmp_path / "beast.usda")
    controls = creature_acts(human_moves(40))
    write_creature_performance(tmp_path / "p.usda", rig, controls, first=7)
    read = read_control_clip(tmp_path / "p.usda")
    back = read.controls
    assert (read.first_frame, read.last_frame) == (7, 46)
    assert (back.shapes, back.joints, back.attributes) == (
        controls.shapes,
        JOINTS,
        ATTRIBUTES,
    )
    np.testing.assert_allclose(back.weights, controls.weights, atol=1e-6)
    np.testing.assert_allclose(back.translations, controls.translations, atol=1e-6)
    np.testing.assert_allclose(
        np.abs(np.einsum("fji,fji->fj", back.rotations, controls.rotations)), 1.0, atol=1e-6
    )
    np.testing.assert_allclose(back.scales, 1.0)
    np.testing.assert_allclose(back.values, controls.values, atol=1e-6)


def test_usdskel_turns_the_joints_and_the_attributes_move(tmp_path: Path) -> None:
    rig = write_creature(tmp_path / "beast.usda")
    controls = creature_acts(human_moves(20))
    write_creature_performance(tmp_path / "p.usda", rig, controls)
    stage = Usd.Stage.Open(str(tmp_path / "p.usda"))
    cache = UsdSkel.Cache()
    root = UsdSkel.Root(stage.GetPrimAtPath("/Beast"))
    cache.Populate(root, Usd.PrimDefaultPredicate)
    query = cache.GetSkelQuery(UsdSkel.Skeleton.Get(stage, "/Beast/rig/skeleton"))
    for frame in (1, 9, 20):
        local = query.ComputeJointLocalTransforms(frame)
        assert np.allclose(local[1].ExtractTranslation(), controls.translations[frame - 1, 1])
        turn = local[1].ExtractRotationQuat()
        told = np.array([turn.GetReal(), *turn.GetImaginary()])
        assert abs(told @ controls.rotations[frame - 1, 1]) == pytest.approx(1.0, abs=1e-6)
    curl = stage.GetAttributeAtPath("/Beast/rig/lattice.dfm:curl")
    assert curl.Get(9) == pytest.approx(controls.values[8, 1])
    assert not [each for each in validate(tmp_path / "p.usda") if each.severity == "error"]


def test_weights_alone_leave_no_layer_of_other_controls(tmp_path: Path) -> None:
    rig = write_creature(tmp_path / "beast.usda")
    controls = creature_acts(human_moves(5))
    write_creature_performance(tmp_path / "p.usda", rig, controls)
    assert controls_path(tmp_path / "p.usda").is_file()
    bare = type(controls)(**{**vars(controls), "joints": (), "attributes": ()})
    write_creature_performance(tmp_path / "p.usda", rig, bare)
    assert read_control_clip(tmp_path / "p.usda").controls.joints == ()


def test_rest_is_what_the_rig_has(tmp_path: Path) -> None:
    rig = write_creature(tmp_path / "beast.usda")
    rest = rest_controls(rig, attributes=("rig/lattice.dfm:*",))
    assert rest.joints == JOINTS
    np.testing.assert_allclose(rest.translations[0, 1], [3, 2, 0])
    np.testing.assert_allclose(rest.rotations[0], [[1, 0, 0, 0]] * 3)
    assert dict(zip(rest.attributes, rest.values[0].tolist(), strict=True)) == {
        "rig/lattice.dfm:squash": 0.25,
        "rig/lattice.dfm:curl": 0.0,
    }
    assert rest_controls(rig, joints=False).joints == ()


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("rig/lattice.dfm:bend", "has no attribute 'dfm:bend'; it has rig/lattice"),
        ("rig/cage.dfm:squash", "is not there, so neither is its attribute"),
        ("rig/lattice.dfm:name", "is string, and a control must be one float"),
        ("rig/lattice.dfm:axis", "is float3, and a control must be one float"),
        ("squash", "names no attribute"),
        ("/Beast/rig/lattice.dfm:squash", "names no attribute"),
        ("rig/nothing.*", "no float attribute below it is like"),
    ],
)
def test_an_attribute_that_cannot_be_driven_is_named(
    tmp_path: Path, name: str, message: str
) -> None:
    rig = write_creature(tmp_path / "beast.usda")
    with pytest.raises(InputError, match=message):
        find_control_attributes(rig, (name,))
