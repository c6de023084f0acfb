"""A performance posed frame by frame, against USD's own baking."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from pxr import Gf, Sdf, Usd, UsdGeom, UsdSkel

from tests.usdio.posed_points import PosedRig
from tests.usdio.small_creature import (
    creature_acts,
    human_moves,
    write_creature,
    write_creature_performance,
    write_human,
    write_human_performance,
)
from usdface.core.arrays import columns_by_name
from usdface.core.assets import Rig
from usdface.core.deformer import Deformer
from usdface.core.errors import InputError
from usdface.usdio.performance.read import PerformanceReader
from usdface.usdio.rig.read import read_rig
from usdface.usdio.rig.rig_motion import RigMotion


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


@pytest.mark.parametrize("walks", [False, True])
def test_a_shot_that_places_the_character_does_not_tear_its_face(
    tmp_path: Path, *, walks: bool
) -> None:
    rig = write_creature(tmp_path / "beast.usda")
    stage = Usd.Stage.Open(str(tmp_path / "beast.usda"))
    for mesh in rig.meshes:  # every other point follows an ear
        binding = UsdSkel.BindingAPI(stage.GetPrimAtPath(mesh.path))
        for primvar in (binding.GetJointIndicesPrimvar(), binding.GetJointWeightsPrimvar()):
            primvar.GetAttr().Clear()
        count = len(mesh.points)
        binding.CreateJointIndicesPrimvar(False, 1).Set((np.arange(count) % 2).tolist())
        binding.CreateJointWeightsPrimvar(False, 1).Set([1.0] * count)
    stage.GetRootLayer().Save()
    rig, acted = read_rig(tmp_path / "beast.usda"), creature_acts(human_moves(4))
    ear = {name: getattr(acted, name)[:, 1:2] for name in ("translations", "rotations", "scales")}
    performance = tmp_path / "p.usda"
    write_creature_performance(performance, rig, replace(acted, joints=acted.joints[1:2], **ear))
    shot = Usd.Stage.CreateNew(str(tmp_path / "shot.usda"))
    shot.SetTimeCodesPerSecond(24)
    shot.DefinePrim("/cast/beast").GetReferences().AddReference("./p.usda")
    UsdGeom.Xformable(shot.GetPrimAtPath("/cast/beast")).AddTranslateOp().Set(Gf.Vec3d(9, 8, 7))
    turn = UsdGeom.Xform.Define(shot, "/cast").AddRotateYOp()
    turn.Set(90.0)
    if walks:
        turn.Set(0.0, 4)
        turn.Set(80.0, 1)
    shot.Save()
    points = Deformer(rig).points(reader_weights(performance, rig))[2]
    wanted = PosedRig(performance).points(3)
    assert np.abs(wanted - points).max() > 3
    for file in (performance, tmp_path / "shot.usda"):
        np.testing.assert_allclose(RigMotion(file, rig).apply(points, 3), wanted, atol=1e-3)
    controls = Sdf.Layer.FindOrOpen(str(tmp_path / "p.controls.usdc"))  # held, without samples
    for name in ("translations", "rotations", "scales"):
        held = controls.GetAttributeAtPath(f"/Beast/FaceSolve.{name}")
        value = controls.QueryTimeSample(held.path, 3)
        held.ClearInfo("timeSamples")
        held.default = value
    controls.Save()
    np.testing.assert_allclose(RigMotion(performance, rig).apply(points, 3), wanted, atol=1e-3)


def reader_weights(performance: Path, rig: Rig) -> np.ndarray:
    reader = PerformanceReader(performance)
    return columns_by_name(reader.edited(), reader.names, rig.shapes)
