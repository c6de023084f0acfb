"""Rigs of every kind, made of that of the small shot."""

from dataclasses import replace
from pathlib import Path

import numpy as np
from pxr import Gf, Sdf, Usd, UsdGeom

from tests.matrix.studio import Weights
from tests.steps.small_shot import coarse_rig
from usdface.core.assets import MeshShape, Rig, ShapeKey
from usdface.core.rig_logic import Combination
from usdface.usdio.rig.write import write_rig

FEW = ("eyeBlinkLeft", "eyeBlinkRight", "jawOpen", "mouthSmileLeft", "mouthSmileRight")
DRIVEN = (
    Combination("jaw_smile", ("jawOpen", "mouthSmileLeft")),
    Combination("blink50", ("eyeBlinkLeft",), weights=(0.5,)),
    Combination("deep", ("jaw_smile", "browInnerUp"), "minimum"),
)


def with_combinations() -> Rig:
    bump = ShapeKey(1.0, np.arange(200), np.random.default_rng(0).normal(0, 0.5, (200, 3)))
    rig = _with(*(MeshShape(each.shape, (bump,)) for each in DRIVEN))
    return replace(rig, combinations=DRIVEN)


def _with(*shapes: MeshShape) -> Rig:
    """Add shapes to the skin, not to the controls."""
    rig = coarse_rig()
    skin, *rest = rig.meshes
    return replace(rig, meshes=(replace(skin, shapes=(*skin.shapes, *shapes)), *rest))


def with_inbetweens() -> Rig:
    """Bend the path of every third shape of the skin by a fifth of its length."""
    rig = coarse_rig()
    skin, *rest = rig.meshes

    def bent(shape: MeshShape) -> MeshShape:
        key = shape.keys[-1]
        bow = 0.2 * np.linalg.norm(key.offsets, axis=1)[:, None] * [0, 0, 1]
        return replace(shape, keys=(ShapeKey(0.5, key.points, 0.6 * key.offsets + bow), key))

    shapes = tuple(bent(s) if i % 3 == 0 else s for i, s in enumerate(skin.shapes))
    return replace(rig, meshes=(replace(skin, shapes=shapes), *rest))


def with_signed_ranges() -> Rig:
    rig = coarse_rig()
    ranges = rig.ranges.copy()
    ranges[[name.startswith(("jaw", "mouthLeft")) for name in rig.shapes]] = (-1, 1)
    return replace(rig, ranges=ranges)


def with_five_shapes() -> Rig:
    rig = coarse_rig()
    at = [rig.shapes.index(name) for name in FEW]
    meshes = tuple(
        replace(mesh, shapes=tuple(each for each in mesh.shapes if each.name in FEW))
        for mesh in rig.meshes
    )
    return replace(rig, shapes=FEW, ranges=rig.ranges[at], meshes=meshes)


def with_dead_shapes() -> Rig:
    """Add a shape that moves nothing, and one that moves what another moves."""
    nothing = MeshShape("nothing", (ShapeKey(1.0, np.array([0]), np.zeros((1, 3))),))
    rig = _with(nothing, replace(coarse_rig().meshes[0].shapes[3], name="twin"))
    ranges = np.vstack([rig.ranges, [[0, 1], [0, 1]]])
    return replace(rig, shapes=(*rig.shapes, "nothing", "twin"), ranges=ranges)


def renamed(pattern: str) -> Rig:
    rig = coarse_rig()
    new = {name: pattern.format(name=name, k=k) for k, name in enumerate(rig.shapes)}
    meshes = tuple(
        replace(mesh, shapes=tuple(replace(each, name=new[each.name]) for each in mesh.shapes))
        for mesh in rig.meshes
    )
    return replace(rig, shapes=tuple(new.values()), meshes=meshes)


def assert_driven(weights: Weights) -> None:
    """Check that combinations have the weights that their shapes give."""
    jaw, smile, lid = (weights[s] for s in ("jawOpen", "mouthSmileLeft", "eyeBlinkLeft"))
    assert np.abs(weights["jaw_smile"] - jaw * smile).max() < 1e-5
    assert np.abs(weights["blink50"] - (1 - np.abs(2 * lid - 1))).max() < 1e-5


def write_text(folder: Path) -> None:
    write_rig(folder / "source.usdc", coarse_rig())
    Sdf.Layer.FindOrOpen(str(folder / "source.usdc")).Export(str(folder / "hero.usda"))


def write_stage(folder: Path) -> None:
    """Write a stage that sublayers one in which the rig is referenced, in metres with Z up."""
    write_rig(folder / "source.usdc", coarse_rig())
    stage = _new_stage(folder / "set.usda", 1.0, "Z")
    world = UsdGeom.Xform.Define(stage, "/World")
    stage.SetDefaultPrim(world.GetPrim())
    world.AddRotateXOp().Set(90.0)
    world.AddScaleOp().Set(Gf.Vec3f(0.01))
    stage.DefinePrim("/World/hero", "SkelRoot").GetReferences().AddReference("source.usdc")
    stage.Save()
    top = _new_stage(folder / "hero.usda", 1.0, "Z")
    top.GetRootLayer().subLayerPaths = ["set.usda"]
    top.SetDefaultPrim(top.GetPrimAtPath("/World"))
    top.Save()


def write_two_faces(folder: Path) -> None:
    write_rig(folder / "source.usdc", coarse_rig())
    stage = _new_stage(folder / "hero.usda", 0.01, "Y")
    stage.SetDefaultPrim(UsdGeom.Xform.Define(stage, "/Shot").GetPrim())
    for number, name in enumerate("ab"):
        place = UsdGeom.Xform.Define(stage, f"/Shot/{name}")
        place.AddTranslateOp().Set(Gf.Vec3d(40 * number, 5, 0))
        face = stage.DefinePrim(f"/Shot/{name}/hero", "SkelRoot")
        face.GetReferences().AddReference("source.usdc")
    stage.Save()


def _new_stage(path: Path, metres: float, up: str) -> Usd.Stage:
    stage = Usd.Stage.CreateNew(str(path))
    UsdGeom.SetStageMetersPerUnit(stage, metres)
    UsdGeom.SetStageUpAxis(stage, up)
    return stage
