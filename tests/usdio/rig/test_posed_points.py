"""A performance posed frame by frame, against USD's own baking."""

from pathlib import Path

import numpy as np
import pytest
from pxr import Gf, Usd, UsdGeom, UsdSkel

from tests.usdio.posed_points import PosedRig
from tests.usdio.small_creature import (
    creature_acts,
    human_moves,
    write_creature,
    write_creature_performance,
    write_human,
    write_human_performance,
)
from usdface.core.deformer import Deformer
from usdface.core.errors import InputError
from usdface.usdio.rig.read import read_rig


@pytest.mark.parametrize("own_order", [False, True])
def test_it_is_what_usd_bakes(tmp_path: Path, *, own_order: bool) -> None:
    rig = write_creature(tmp_path / "beast.usda")
    stage = Usd.Stage.Open(str(tmp_path / "beast.usda"))
    for mesh in rig.meshes:  # let every point follow two joints
        binding = UsdSkel.BindingAPI(stage.GetPrimAtPath(mesh.path))
        count = len(mesh.points)
        for primvar in (binding.GetJointIndicesPrimvar(), binding.GetJointWeightsPrimvar()):
            primvar.GetAttr().Clear()
        owners = np.tile([0, 1], (count, 1))
        owners[::2, 1] = 2
        share = np.linspace(0, 1, count)
        binding.CreateJointIndicesPrimvar(False, 2).Set(owners.ravel().tolist())
        binding.CreateJointWeightsPrimvar(False, 2).Set(
            np.stack([1 - share, share], 1).ravel().tolist()
        )
        if own_order:  # the mesh numbers its joints in another order than the skeleton
            skeleton = UsdSkel.Skeleton(binding.GetInheritedSkeleton())
            binding.CreateJointsAttr(skeleton.GetJointsAttr().Get()[::-1])
            binds = skeleton.GetBindTransformsAttr().Get()  # some are not those of the rest pose
            moved = [Gf.Matrix4d().SetTranslate((0.0, each, 0.0)) for each in range(len(binds))]
            skeleton.GetBindTransformsAttr().Set([a * b for a, b in zip(binds, moved, strict=True)])
    stage.GetRootLayer().Save()
    rig = read_rig(tmp_path / "beast.usda")
    controls = creature_acts(human_moves(12))
    write_creature_performance(tmp_path / "p.usda", rig, controls)
    posed = PosedRig(tmp_path / "p.usda")
    baked = Usd.Stage.Open(Usd.Stage.Open(str(tmp_path / "p.usda")).Flatten())
    UsdSkel.BakeSkinning(UsdSkel.Root(baked.GetPrimAtPath("/Beast")), Gf.Interval(1, 12))
    for frame in (1, 5, 12):
        expected = np.concatenate(
            [
                10 * np.array(UsdGeom.Mesh.Get(baked, mesh.path).GetPointsAttr().Get(frame))
                for mesh in rig.meshes
            ]
        )
        np.testing.assert_allclose(posed.points(frame), expected, atol=2e-3)
    assert np.abs(posed.points(5) - posed.points(1)).max() > 5


def test_without_joints_it_is_the_deformer(tmp_path: Path) -> None:
    rig = write_human(tmp_path / "human.usda")
    weights = human_moves(10)
    write_human_performance(tmp_path / "p.usda", rig, weights, first=1)
    posed = PosedRig(tmp_path / "p.usda")
    for frame in (1, 7):
        expected = Deformer(rig).points(weights[[frame - 1]])[0]
        np.testing.assert_allclose(posed.points(frame), expected, atol=1e-3)


def test_what_is_no_performance_is_refused(tmp_path: Path) -> None:
    write_human(tmp_path / "human.usda")
    with pytest.raises(InputError, match="no active SkelAnimation with blendShapeWeights"):
        PosedRig(tmp_path / "human.usda")
