"""A shot that selects a variant of its rig is drawn, measured and limited with it."""

import numpy as np
from pxr import Gf, Sdf, Usd, UsdGeom, UsdSkel

from tests.steps.small_shot import Shot
from tests.usdio.posed_points import PosedRig
from usdface.core.progress import silent
from usdface.runner.execute import execute
from usdface.specs.edits import BakeSpec, EditSpec
from usdface.specs.review import SheetSpec
from usdface.steps.review.sheet_columns import compare_shots, open_shots
from usdface.steps.review.shot import open_shot
from usdface.usdio.performance.read import PerformanceReader
from usdface.usdio.rig.read import RANGE_ATTRIBUTE


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


def test_bake_limits_weights_to_the_ranges_of_the_variant_that_is_selected(shot: Shot) -> None:
    rig = Usd.Stage.Open(str(shot / "hero.usdc"))
    jaw_open = next(
        each
        for each in rig.Traverse()
        if each.IsA(UsdSkel.BlendShape) and each.GetName() == "jawOpen"
    )
    styles = rig.GetDefaultPrim().GetVariantSets().AddVariantSet("style")
    for style, high in (("free", 1.5), ("stiff", 0.1)):
        styles.AddVariant(style)
        styles.SetVariantSelection(style)
        with styles.GetVariantEditContext():
            limits = jaw_open.CreateAttribute(RANGE_ATTRIBUTE, Sdf.ValueTypeNames.Double2)
            limits.Set(Gf.Vec2d(0, high))
    styles.SetVariantSelection("free")
    rig.Save()
    performance = Sdf.Layer.FindOrOpen(str(shot / "shot.hero.usda"))
    performance.rootPrims[0].variantSelections["style"] = "stiff"
    performance.Save()
    edited = EditSpec(performance=shot / "shot.hero.usda", shape=("jawOpen",), override=0.5)
    execute(edited)
    execute(BakeSpec(performance=edited.performance, out=shot / "stiff.usdc", limit=True))
    baked = PerformanceReader(shot / "stiff.usdc")
    weights = baked.solved()[:, baked.names.index("jawOpen")]
    np.testing.assert_allclose(weights, 0.1, atol=1e-6)


def test_a_version_of_a_variant_with_other_shapes_is_not_measured_by_the_keys(shot: Shot) -> None:
    rig = Usd.Stage.Open(str(shot / "hero.usdc"))
    details = rig.GetDefaultPrim().GetVariantSets().AddVariantSet("detail")
    bound = [UsdSkel.BindingAPI(each) for each in rig.Traverse() if each.IsA(UsdGeom.Mesh)]
    every = [
        (each, list(each.GetBlendShapesAttr().Get()), each.GetBlendShapeTargetsRel().GetTargets())
        for each in bound
        if each.GetBlendShapesAttr().Get()
    ]
    for each, _, _ in every:  # which would be stronger than the variants
        each.GetPrim().RemoveProperty("skel:blendShapes")
        each.GetPrim().RemoveProperty("skel:blendShapeTargets")
    for detail in ("few", "all"):
        details.AddVariant(detail)
        details.SetVariantSelection(detail)
        with details.GetVariantEditContext():
            for each, names, targets in every:
                kept = [i for i, name in enumerate(names) if detail == "all" or name != "cheekPuff"]
                each.CreateBlendShapesAttr([names[i] for i in kept])
                each.CreateBlendShapeTargetsRel().SetTargets([targets[i] for i in kept])
    rig.Save()
    other = Sdf.Layer.CreateAnonymous()
    other.TransferContent(Sdf.Layer.FindOrOpen(str(shot / "shot.hero.usda")))
    other.rootPrims[0].variantSelections["detail"] = "few"
    other.Export(str(shot / "few.hero.usda"))
    spec = SheetSpec(
        performance=shot / "shot.hero.usda",
        also=(shot / "few.hero.usda",),
        against=shot / "keys.csv",
        baseline=False,
        out=shot / "s.png",
    )
    scores = compare_shots(spec, open_shots(spec), silent).scores
    assert [each.against_truth for each in scores] == [True, False]
