"""A shot that selects a variant of its rig is drawn and measured with it."""

import numpy as np
from pxr import Sdf, Usd, UsdGeom

from tests.steps.small_shot import Shot
from usdface.steps.review.shot import open_shot
from usdface.usdio.rig.posed_points import PosedRig


def test_the_variant_that_a_shot_selects_is_drawn(shot: Shot) -> None:
    rig = Usd.Stage.Open(str(shot / "hero.usdc"))
    ages = rig.GetDefaultPrim().GetVariantSets().AddVariantSet("age")
    meshes = [UsdGeom.Mesh(each) for each in rig.Traverse() if each.IsA(UsdGeom.Mesh)]
    points = [np.array(mesh.GetPointsAttr().Get()) for mesh in meshes]
    for mesh in meshes:  # which would be stronger than the variants
        mesh.GetPrim().RemoveProperty("points")
    for age, scale in (("young", 1.0), ("old", 1.1)):
        ages.AddVariant(age)
        ages.SetVariantSelection(age)
        with ages.GetVariantEditContext():
            for mesh, at in zip(meshes, points, strict=True):
                mesh.CreatePointsAttr().Set((scale * at).astype(np.float32))
    ages.SetVariantSelection("young")
    rig.Save()
    young = open_shot(shot / "shot.hero.usda")
    performance = Sdf.Layer.FindOrOpen(str(shot / "shot.hero.usda"))
    performance.rootPrims[0].variantSelections["age"] = "old"
    performance.Save()
    old = open_shot(shot / "shot.hero.usda")
    at_rest = np.zeros(len(old.rig.shapes))
    np.testing.assert_allclose(
        old.pose(0, at_rest, still=True), 1.1 * young.pose(0, at_rest, still=True), atol=1e-3
    )
    posed = PosedRig(shot / "shot.hero.usda").points(int(old.frames[9]))
    np.testing.assert_allclose(old.pose(9, old.weights[9]), posed, atol=1e-2)
