"""The dog that the demo of retargeting drives."""

from pathlib import Path

import numpy as np
from pxr import Usd, UsdSkel

from usdface.demo.dog import DOG_ATTRIBUTES, DOG_SHAPES, JOINTS, act, expressions, write_dog
from usdface.demo.dog_job import dog_job
from usdface.specs.paths import Reads
from usdface.usdio.validation import validate


def test_the_dog_has_shapes_joints_and_floats_and_stands_as_it_is_bound(tmp_path: Path) -> None:
    file = tmp_path / "dog.usda"
    rig = write_dog(file)
    assert (len(rig.shapes), len(JOINTS), len(DOG_ATTRIBUTES)) == (28, 8, 36)
    stage = Usd.Stage.Open(str(file))
    skeleton = UsdSkel.Skeleton(stage.GetPrimAtPath("/dog/rig/skeleton"))
    query = UsdSkel.Cache().GetSkelQuery(skeleton)
    at_rest = np.array(query.ComputeJointSkelTransforms(Usd.TimeCode.Default(), True))
    np.testing.assert_allclose(at_rest, query.GetJointWorldBindTransforms(), atol=1e-9)
    skin = UsdSkel.BindingAPI(stage.GetPrimAtPath("/dog/geometry/skin"))
    shares = np.array(skin.GetJointWeightsPrimvar().Get()).reshape(-1, 3)
    np.testing.assert_allclose(shares.sum(axis=1), 1.0, atol=1e-6)
    assert (shares[:, 1:] > 0.5).any()  # ears
    prim = stage.GetPrimAtPath("/dog/rig/lattice")
    assert all(prim.GetAttribute(name.partition(".")[2]) for name in DOG_ATTRIBUTES)
    assert not [fault for fault in validate(file) if fault.severity == "error"]


def test_34_pairs_show_every_shape_of_the_dog() -> None:
    names = ("jawOpen", *DOG_SHAPES.values(), "cheekSquintLeft", "eyeLookDownLeft")
    labels, poses = expressions(tuple(dict.fromkeys(names)))
    assert len(labels) == len(poses) == 34
    acted = act(tuple(dict.fromkeys(names)), poses)
    assert not acted.weights[0].any()
    assert (acted.weights.max(axis=0) > 0.9).all()


def test_the_job_reads_what_the_demo_writes_or_what_it_makes_itself() -> None:
    made = {"human.usdc", "dog.usdc", "talk.human.usda"}
    made |= {"human_poses.usda", "dog_poses.usda", "dog_smile.usda"}
    for step in dog_job().steps:
        assert {path.name for path in step.paths(Reads)} <= made
        made |= {path.name for path in step.outputs()}
