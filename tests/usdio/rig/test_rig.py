"""Reading rigs, and moving them exactly as UsdSkel does."""

from pathlib import Path

import numpy as np
import pytest
from pxr import Gf, Sdf, Usd, UsdGeom, UsdSkel, Vt

from tests.usdio.small_rig import small_rig
from usdface.core.arrays import FloatArray
from usdface.core.assets import Rig
from usdface.core.deformer import Deformer
from usdface.core.errors import InputError
from usdface.numerics.solve.blendshapes import BlendShapes, ChannelKeys, Key
from usdface.usdio.rig.read import read_rig
from usdface.usdio.rig.write import write_rig
from usdface.usdio.units import column_matrix, stage_to_ours, transform_points


def baked_by_usdskel(rig: Rig, weights: FloatArray) -> FloatArray:
    """Points of all meshes [mm] that UsdSkel itself computes for each row of weights."""
    stage = Usd.Stage.CreateInMemory()
    stage.GetRootLayer().TransferContent(Usd.Stage.Open(str(rig.file)).Flatten())
    root = UsdSkel.Root(stage.GetPrimAtPath(rig.prim))
    animation = UsdSkel.Animation.Define(stage, rig.prim + "/solve")
    shuffled = list(range(len(rig.shapes)))[::-1]
    animation.CreateBlendShapesAttr([rig.shapes[i] for i in shuffled])
    attribute = animation.CreateBlendShapeWeightsAttr()
    for time, row in enumerate(weights):
        attribute.Set(Vt.FloatArray.FromNumpy(row[shuffled].astype(np.float32)), time)
    for prim in stage.Traverse():
        if prim.IsA(UsdSkel.Skeleton):
            binding = UsdSkel.BindingAPI.Apply(prim)
            binding.CreateAnimationSourceRel().SetTargets([animation.GetPath()])
    assert UsdSkel.BakeSkinning(root, Gf.Interval(0, len(weights) - 1))
    frames = []
    for time in range(len(weights)):
        cache = UsdGeom.XformCache(time)
        frames.append(
            np.concatenate(
                [
                    transform_points(
                        column_matrix(cache.GetLocalToWorldTransform(stage.GetPrimAtPath(m.path))),
                        UsdGeom.Mesh(stage.GetPrimAtPath(m.path)).GetPointsAttr().Get(time),
                    )
                    @ stage_to_ours(stage).T
                    for m in rig.meshes
                ]
            )
        )
    return np.array(frames)


def assert_moves_as_usdskel_does(rig: Rig, weights: FloatArray) -> None:
    ours = Deformer(rig).points(weights)
    size = np.ptp(Deformer(rig).neutral, axis=0).max()
    np.testing.assert_allclose(ours, baked_by_usdskel(rig, weights), atol=1e-5 * size)
    assert np.abs(ours[-1] - ours[0]).max() > 1e-3 * size, "the test moves nothing"


def test_written_rig_reads_back_the_same(tmp_path: Path) -> None:
    rig = small_rig()
    write_rig(tmp_path / "rig.usda", rig)
    back = read_rig(tmp_path / "rig.usda")
    assert back.shapes == rig.shapes
    np.testing.assert_array_equal(back.ranges, rig.ranges)
    weights = np.random.default_rng(1).uniform(-0.5, 1.5, (20, 3))
    np.testing.assert_allclose(
        Deformer(back).points(weights), Deformer(rig).points(weights), atol=1e-5
    )
    np.testing.assert_allclose(back.meshes[0].colors, rig.meshes[0].colors, atol=1e-6)


@pytest.mark.parametrize("stated", ["skin", "teeth"])
def test_ranges_of_one_shape_on_several_meshes_are_equal(tmp_path: Path, stated: str) -> None:
    write_rig(tmp_path / "rig.usda", small_rig())
    stage = Usd.Stage.Open(str(tmp_path / "rig.usda"))
    ranges = {}
    for mesh in ("skin", "teeth"):
        binding = UsdSkel.BindingAPI(stage.GetPrimAtPath(f"/Hero/geo/{mesh}"))
        at = list(binding.GetBlendShapesAttr().Get()).index("jawOpen")
        shape = stage.GetPrimAtPath(binding.GetBlendShapeTargetsRel().GetTargets()[at])
        ranges[mesh] = shape.CreateAttribute("face:range", Sdf.ValueTypeNames.Double2)
        ranges[mesh].Clear()
    ranges[stated].Set((0.0, 0.5))
    stage.Save()
    np.testing.assert_array_equal(read_rig(tmp_path / "rig.usda").ranges[0], [0.0, 0.5])
    for each in ranges.values():
        each.Set((0.0, 0.5))
    ranges[stated].Set((0.0, 1.0))
    stage.Save()
    with pytest.raises(InputError, match=r"face:range is 0 to .* on another mesh 0 to .* equal"):
        read_rig(tmp_path / "rig.usda")
    for wrong in ((1.0, -1.0), (0.0, np.inf), (np.nan, 1.0)):
        ranges[stated].Set(wrong)
        stage.Save()
        with pytest.raises(InputError, match=r"face:range is .*; write two finite weights"):
            read_rig(tmp_path / "rig.usda")


def test_deformation_equals_usdskel_with_inbetweens_and_beyond_the_range(tmp_path: Path) -> None:
    write_rig(tmp_path / "rig.usda", small_rig())
    weights = np.random.default_rng(2).uniform(-0.7, 1.7, (40, 3))
    weights[:6, 1] = [0.0, 0.3, 0.6, 1.0, -0.4, 1.3]
    assert_moves_as_usdskel_does(read_rig(tmp_path / "rig.usda"), weights)


def test_normals_of_corners_are_not_those_of_points(tmp_path: Path) -> None:
    write_rig(tmp_path / "rig.usda", small_rig())
    stage = Usd.Stage.Open(str(tmp_path / "rig.usda"))
    skin = UsdGeom.Mesh(stage.GetPrimAtPath("/Hero/geo/skin"))
    count = len(skin.GetPointsAttr().Get())  # as many corners as points, in another order
    skin.GetFaceVertexCountsAttr().Set([count])
    skin.GetFaceVertexIndicesAttr().Set(list(range(count))[::-1])
    skin.CreateNormalsAttr([Gf.Vec3f(0, 0, 1)] * count)
    for interpolation, known in (("vertex", True), ("faceVarying", False)):
        skin.SetNormalsInterpolation(interpolation)
        stage.Save()
        mesh = next(
            mesh for mesh in read_rig(tmp_path / "rig.usda").meshes if mesh.path == "/Hero/geo/skin"
        )
        assert (mesh.normals is not None) == known


def test_units_up_axis_and_transforms_are_converted_once(tmp_path: Path) -> None:
    path = tmp_path / "rig.usda"
    write_rig(path, small_rig())
    before = Deformer(read_rig(path))
    stage = Usd.Stage.Open(str(path))
    UsdGeom.SetStageMetersPerUnit(stage, 1.0)
    UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.z)
    hero = UsdGeom.Xformable(stage.GetPrimAtPath("/Hero"))
    # The same face in metres, Z up: scaled by 1/100 and turned a quarter about X.
    hero.AddRotateXOp().Set(90)
    hero.AddScaleOp().Set(Gf.Vec3f(0.01))
    stage.Save()
    rig = read_rig(path)
    weights = np.random.default_rng(3).uniform(0, 1, (5, 3))
    np.testing.assert_allclose(Deformer(rig).points(weights), before.points(weights), atol=1e-4)
    assert_moves_as_usdskel_does(rig, weights)


def test_rest_pose_of_a_bent_skeleton_carries_the_shapes_along(tmp_path: Path) -> None:
    path = tmp_path / "rig.usda"
    write_rig(path, small_rig())
    stage = Usd.Stage.Open(str(path))
    skeleton = UsdSkel.Skeleton(stage.GetPrimAtPath("/Hero/rig/skeleton"))
    turned = Gf.Matrix4d().SetRotate(Gf.Rotation(Gf.Vec3d(0, 0, 1), 30))
    skeleton.GetRestTransformsAttr().Set([turned])
    stage.Save()
    rig = read_rig(path)
    assert not np.allclose(rig.meshes[0].points, small_rig().meshes[0].points, atol=1)
    assert_moves_as_usdskel_does(rig, np.random.default_rng(4).uniform(0, 1, (5, 3)))


@pytest.mark.parametrize(
    "name",
    [
        "rigs/facecap_head.usdc",
        "rigs/ict_face.usdc",
        "usdskel/OpenUSD/usd/usdSkel/testenv/testUsdSkelBakeSkinning/blendshapes.usda",
        "usdskel/maya-usd/test/lib/usd/translators/UsdImportSkeleton/morpher_box.usd",
        "usdskel/tinyusdz/models/blendshape.usda",
    ],
)
def test_rigs_by_other_writers_move_as_usdskel_moves_them(shared_data: Path, name: str) -> None:
    rig = read_rig(shared_data / name)
    weights = np.random.default_rng(5).uniform(-0.2, 1.2, (4, len(rig.shapes)))
    assert_moves_as_usdskel_does(rig, weights)


def edit_without_shapes(stage: Usd.Stage) -> None:
    for prim in stage.Traverse():
        if prim.IsA(UsdGeom.Mesh):
            prim.RemoveProperty("skel:blendShapes")


def edit_unpaired(stage: Usd.Stage) -> None:
    binding = UsdSkel.BindingAPI(stage.GetPrimAtPath("/Hero/geo/skin"))
    binding.GetBlendShapesAttr().Set(["jawOpen"])


def edit_point_beyond(stage: Usd.Stage) -> None:
    shape = UsdSkel.BlendShape(stage.GetPrimAtPath("/Hero/geo/skin/smile"))
    shape.GetPointIndicesAttr().Set([8, 9, 10, 99])


def edit_nan(stage: Usd.Stage) -> None:
    mesh = UsdGeom.Mesh(stage.GetPrimAtPath("/Hero/geo/skin"))
    mesh.GetPointsAttr().Set([Gf.Vec3f(float("nan"))] * 12)


def edit_unbound(stage: Usd.Stage) -> None:
    for prim in stage.Traverse():
        if prim.IsA(UsdGeom.Mesh):
            prim.RemoveProperty("skel:skeleton")


def edit_group_without_type(stage: Usd.Stage) -> None:
    stage.GetPrimAtPath("/Hero/geo").SetTypeName("")


def edit_no_root(stage: Usd.Stage) -> None:
    stage.GetPrimAtPath("/Hero").SetTypeName("Xform")


def edit_faces(stage: Usd.Stage) -> None:
    mesh = UsdGeom.Mesh(stage.GetPrimAtPath("/Hero/geo/skin"))
    mesh.GetFaceVertexIndicesAttr().Set([0, 1, 2])


def edit_skeleton_beside(stage: Usd.Stage) -> None:
    Sdf.CopySpec(stage.GetRootLayer(), "/Hero/rig/skeleton", stage.GetRootLayer(), "/skeleton")
    for prim in stage.Traverse():
        if prim.IsA(UsdGeom.Mesh):
            UsdSkel.BindingAPI(prim).GetSkeletonRel().SetTargets(["/skeleton"])


def edit_shape_beside(stage: Usd.Stage) -> None:
    Sdf.CopySpec(stage.GetRootLayer(), "/Hero/geo/skin/smile", stage.GetRootLayer(), "/smile")
    targets = UsdSkel.BindingAPI(stage.GetPrimAtPath("/Hero/geo/skin")).GetBlendShapeTargetsRel()
    targets.SetTargets([*targets.GetTargets()[:2], "/smile"])


@pytest.mark.parametrize(
    ("edit", "message"),
    [
        (edit_without_shapes, "no mesh with BlendShapes under its SkelRoot"),
        (edit_unpaired, r"</Hero/geo/skin>: 1 skel:blendShapes but 3 skel:blendShapeTargets"),
        (edit_point_beyond, r"</Hero/geo/skin/smile>: pointIndices name a point beyond"),
        (edit_nan, r"</Hero/geo/skin>: points hold NaN"),
        (edit_unbound, r"no skel:skeleton; UsdSkel animates them only through a Skeleton"),
        (edit_skeleton_beside, r"</skeleton>: moves </Hero> and lies outside </Hero>"),
        (edit_shape_beside, r"</smile>: moves </Hero> and lies outside </Hero>"),
        (edit_group_without_type, r"geo/\w+>: USD does not animate it, as </Hero/geo> .* no type"),
        (edit_no_root, r"has BlendShapes but no SkelRoot above it"),
        (edit_faces, r"</Hero/geo/skin>: its faces name points that are not there"),
    ],
    ids=lambda value: getattr(value, "__name__", None),
)
def test_broken_rig_is_refused_with_the_prim_named(tmp_path, edit, message) -> None:
    path = tmp_path / "rig.usda"
    write_rig(path, small_rig())
    stage = Usd.Stage.Open(str(path))
    edit(stage)
    stage.Save()
    del stage
    with pytest.raises(InputError, match=message):
        read_rig(path)


def test_two_faces_in_a_file_must_be_told_apart(tmp_path: Path) -> None:
    write_rig(tmp_path / "a.usda", small_rig("/A"))
    both = Sdf.Layer.CreateNew(str(tmp_path / "both.usda"))
    stage = Usd.Stage.Open(both)
    for name in "AB":
        stage.DefinePrim(f"/{name}").GetReferences().AddReference("./a.usda", "/A")
    stage.Save()
    with pytest.raises(InputError, match=r"2 faces, </A>, </B>; name one with --prim .*--rig-prim"):
        read_rig(tmp_path / "both.usda")
    assert read_rig(tmp_path / "both.usda", prim="/B").prim == "/B"


def test_gram_is_what_an_error_does_to_the_surface() -> None:
    deformer = Deformer(small_rig())
    error = np.random.default_rng(6).normal(0, 0.1, 3)
    moved = (error @ deformer.shapes.target_offsets()).reshape(-1, 3)
    expected = np.sqrt((moved**2).sum() / len(deformer.neutral))
    assert np.sqrt(error @ deformer.shapes.gram() @ error) == pytest.approx(expected)


def test_a_body_does_not_make_an_error_of_the_face_small() -> None:
    head, body = 40, 2000
    offsets = np.random.default_rng(7).normal(0, 5, (2, head // 2, 3))
    points = np.arange(head // 2)
    tracks = [ChannelKeys(channel, [Key(1.0, points, offsets[channel])]) for channel in range(2)]
    alone = BlendShapes(head, 2, tracks)
    whole = BlendShapes(head + body, 2, tracks)
    assert len(alone.face_points) == len(whole.face_points) == head
    np.testing.assert_allclose(whole.gram(), alone.gram())
    np.testing.assert_allclose(whole.gram()[0, 0], (offsets[0] ** 2).sum() / head)
