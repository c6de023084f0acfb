"""Head and eyes onto the character: a take's rotations drive joints and Xforms that are named."""

import shlex
from dataclasses import replace
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pxr import Gf, Sdf, Usd, UsdGeom, UsdSkel
from scipy.spatial.transform import Rotation

from tests.edited_weights import read_weights
from tests.regenerate import REPOSITORY
from tests.steps.review.test_report import visit
from tests.steps.small_shot import Shot
from tests.test_docs import commands
from tests.usdio.posed_points import PosedRig
from tests.usdio.small_creature import (
    creature_acts,
    human_moves,
    write_creature,
    write_creature_performance,
)
from tests.usdio.small_rig import small_rig
from usdface.cli import main
from usdface.core.assets import Markers, Rig, Take, WeightsClip
from usdface.core.provenance import Provenance
from usdface.core.sidecars import head_path
from usdface.media.face.surface import build_surface
from usdface.model.placement.rig_orientation import face_axes, face_centre
from usdface.publish import collect_performances, extract_performance
from usdface.steps.inputs.head_drive import take_head_source
from usdface.steps.inputs.weight_tables import read_weight_table
from usdface.steps.review.pictures import ShotPictures
from usdface.steps.review.shot import open_shot
from usdface.usdio.performance.driving_layers import head_layer_xforms
from usdface.usdio.performance.read import PerformanceReader
from usdface.usdio.retarget.controls import read_control_clip
from usdface.usdio.rig.read import read_rig
from usdface.usdio.rig.rig_motion import RigMotion
from usdface.usdio.rig.write import write_rig
from usdface.usdio.take.read import TakeReader, read_take
from usdface.usdio.take.write import write_take
from usdface.usdio.validation import validate

FRAMES = 40
RATE = Fraction(30)
JOINTS = ("spine", "spine/neck", "spine/neck/eye_L", "spine/neck/eye_R")
REST = np.array([[0, 1, 0], [0, 2, 0], [1, 0.5, 0.5], [-1, 0.5, 0.5]], float)
"""Local translations of `JOINTS` [cm]."""


def usdface(*arguments: object) -> int:
    with pytest.raises(SystemExit) as stopped:
        main([str(each) for each in arguments])
    return int(stopped.value.code or 0)


def write_character(path: Path, *, z_up: bool = False, neck: str = "neck") -> Rig:
    """A rig whose skin follows spine and neck, and whose eye is an Xform that was placed."""
    write_rig(path, small_rig("/Hero"))
    stage = Usd.Stage.Open(str(path))
    if z_up:
        UsdGeom.SetStageUpAxis(stage, "Z")
    skeleton = UsdSkel.Skeleton.Get(stage, "/Hero/rig/skeleton")
    turn = Gf.Rotation(Gf.Vec3d(0, 0, 1), 20)
    rest = [Gf.Matrix4d(1).SetTranslate(Gf.Vec3d(*each.tolist())) for each in REST]
    rest[1].SetTransform(turn, Gf.Vec3d(*REST[1].tolist()))
    world: list[Gf.Matrix4d] = []
    for joint, local in zip(JOINTS, rest, strict=True):
        above = joint.rpartition("/")[0]
        world.append(local * world[JOINTS.index(above)] if above else local)
    skeleton.GetJointsAttr().Set([each.replace("neck", neck) for each in JOINTS])
    skeleton.GetBindTransformsAttr().Set(world)
    skeleton.GetRestTransformsAttr().Set(rest)
    skin = stage.GetPrimAtPath("/Hero/geo/skin")
    binding = UsdSkel.BindingAPI(skin)
    for primvar in (binding.GetJointIndicesPrimvar(), binding.GetJointWeightsPrimvar()):
        primvar.GetAttr().Clear()
    share = np.linspace(0, 1, 12)
    binding.CreateJointIndicesPrimvar(False, 2).Set(np.tile([0, 1], (12, 1)).ravel().tolist())
    binding.CreateJointWeightsPrimvar(False, 2).Set(
        np.stack([1 - share, share], 1).ravel().tolist()
    )
    eye = UsdGeom.Xform.Define(stage, "/Hero/props/eyeball")
    eye.AddTranslateOp().Set(Gf.Vec3d(3, 4, 5))
    eye.AddRotateXYZOp().Set(Gf.Vec3f(0, 90, 0))
    UsdGeom.Xform.Define(stage, "/Hero/props/other/eyeball")
    stage.GetRootLayer().Save()
    return read_rig(path)


def angles() -> np.ndarray:
    """Pitch, yaw and roll of the head, then of the left eye [rad]."""
    time = np.arange(FRAMES) / 10
    return np.stack([np.sin(time * rate) * size for rate, size in RATES], axis=1)


RATES = ((1.0, 0.3), (0.7, 0.5), (1.3, 0.2), (1.9, 0.1), (0.4, 0.2), (1.0, 0.0))


def write_source(path: Path, *, mirrored: bool = True, scale: float = 1.0) -> Path:
    """Weights that say where the left eye looks, and angles as a recorder counts them."""
    turned = angles()
    look = 1.0 / np.radians(30)
    weights = {
        "jawOpen": 0.5 + 0.3 * np.sin(np.arange(FRAMES)),
        "eyeBlink": np.zeros(FRAMES),
        "smile": np.zeros(FRAMES),
        "eyeLookDownLeft": np.maximum(turned[:, 3], 0) * look,
        "eyeLookUpLeft": np.maximum(-turned[:, 3], 0) * look,
        "eyeLookOutLeft": np.maximum(turned[:, 4], 0) * look,
        "eyeLookInLeft": np.maximum(-turned[:, 4], 0) * look,
    }
    signs = (1, -1, -1) if mirrored else (1, 1, 1)
    for part, first in (("Head", 0), ("LeftEye", 3)):
        for axis, sign, name in zip(range(3), signs, ("Pitch", "Yaw", "Roll"), strict=True):
            weights[part + name] = sign * scale * turned[:, first + axis]
    lines = [",".join(("frame", *weights))]
    rows = zip(*weights.values(), strict=True)
    lines += [
        ",".join((str(frame), *(f"{each:.9f}" for each in row)))
        for frame, row in enumerate(rows, 1)
    ]
    path.write_text("\n".join(lines), encoding="utf-8")
    return path


def turns(columns: slice) -> np.ndarray:
    pitch, yaw, roll = angles()[:, columns].T
    return Rotation.from_euler("YXZ", np.stack([yaw, pitch, roll], axis=1)).as_matrix()


@pytest.mark.parametrize("mirrored", [True, False])
def test_a_joint_turns_as_the_head_does(tmp_path: Path, mirrored: bool) -> None:
    rig = write_character(tmp_path / "hero.usda")
    source = write_source(tmp_path / "shot.csv", mirrored=mirrored)
    out = tmp_path / "shot.hero.usda"
    assert usdface(
        "retarget", source, "--rate", 30, "--rig", rig.file, "--drive", "head=neck",
        "--drive", "left_eye=eye_L", "--out", out,
    ) == 0  # fmt: skip
    stage = Usd.Stage.Open(str(out))
    cache = UsdSkel.Cache()
    root = UsdSkel.Root(stage.GetPrimAtPath("/Hero"))
    cache.Populate(root, Usd.TraverseInstanceProxies())
    query = cache.GetSkelQuery(UsdSkel.Skeleton.Get(stage, "/Hero/rig/skeleton"))
    for frame in (1, 17, FRAMES):
        placed = [np.array(each).T for each in query.ComputeJointSkelTransforms(frame)]
        rest = [np.array(each).T for each in query.ComputeJointSkelTransforms(frame, True)]
        moved = [(a @ np.linalg.inv(b))[:3, :3] for a, b in zip(placed, rest, strict=True)]
        head, eye = turns(slice(0, 3))[frame - 1], turns(slice(3, 6))[frame - 1]
        np.testing.assert_allclose(moved[0], np.eye(3), atol=1e-6)
        np.testing.assert_allclose(moved[1], head, atol=1e-5)
        np.testing.assert_allclose(moved[2], head @ eye, atol=1e-5)
        np.testing.assert_allclose(moved[3], head, atol=1e-5)
        np.testing.assert_allclose(placed[1][:3, 3], rest[1][:3, 3], atol=1e-6)
    assert not [each for each in validate(out) if each.severity == "error"]


def test_the_how_to_page(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    page = REPOSITORY / "docs" / "howto" / "head_and_eyes.md"
    write_character(tmp_path / "hero.usda", neck="neck_02")
    Usd.Stage.Open(str(tmp_path / "hero.usda")).Export(str(tmp_path / "hero.usd"))
    source = write_source(tmp_path / "still.csv").read_text(encoding="utf-8").splitlines()
    lines = [
        f"{source[0]},RightEyeYaw,time",
        *(f"{row},0.1,{i / 30:.5f}" for i, row in enumerate(source[1:])),
    ]
    (tmp_path / "phone.csv").write_text("\n".join(lines), encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    (line,) = commands(page)
    assert usdface(*shlex.split(line)[1:]) == 0
    layer = Sdf.Layer.FindOrOpen("phone.hero.head.usdc")
    joints = layer.GetAttributeAtPath("/Hero/FaceSolve.joints").default
    assert list(joints) == [f"spine/neck_02{end}" for end in ("", "/eye_L", "/eye_R")]


def test_an_xform_turns_about_where_it_was_placed(tmp_path: Path) -> None:
    rig = write_character(tmp_path / "hero.usda", z_up=True)
    out = tmp_path / "shot.hero.usda"
    source = write_source(tmp_path / "shot.csv")
    assert usdface(
        "retarget", source, "--rate", 30, "--rig", rig.file, "--out", out,
        "--drive", "left_eye=/Hero/props/eyeball", "--prim", "/Shot/Hero",
    ) == 0  # fmt: skip
    assert head_layer_xforms(PerformanceReader(out)) == ("/Shot/Hero/props/eyeball",)
    stage, rest = Usd.Stage.Open(str(out)), Usd.Stage.Open(str(rig.file))
    up = np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]])  # from Z up to Y up
    for frame in (1, 23):
        placed, still = (
            np.array(
                UsdGeom.Xformable(where.GetPrimAtPath(prim)).ComputeLocalToWorldTransform(frame)
            )
            for where, prim in ((stage, "/Shot/Hero/props/eyeball"), (rest, "/Hero/props/eyeball"))
        )
        np.testing.assert_allclose(placed[3], still[3], atol=1e-6)
        turn = up.T @ turns(slice(3, 6))[frame - 1] @ up
        np.testing.assert_allclose(placed[:3, :3].T, turn @ still[:3, :3].T, atol=1e-6)


def test_pictures_are_posed_as_usdskel_poses(tmp_path: Path) -> None:
    rig = write_character(tmp_path / "hero.usda")
    out = tmp_path / "shot.hero.usda"
    source = write_source(tmp_path / "shot.csv")
    drive = ("--drive", "head=neck")
    usdface("retarget", source, "--rate", 30, "--rig", rig.file, *drive, "--out", out)
    shot = open_shot(out)  # the table itself is the take
    posed = PosedRig(out)
    still = 0.0
    for row in (0, 13, 30):
        seen = shot.pose(row, shot.weights[row])
        np.testing.assert_allclose(seen, posed.points(row + 1), atol=2e-3)
        still = max(still, np.abs(seen - shot.pose(row, shot.weights[row], still=True)).max())
    assert still > 5


@pytest.mark.parametrize("driven", ["/Hero", "/Hero/root"])
def test_a_stages_camera_sees_a_driven_character_where_usd_does(
    tmp_path: Path, driven: str
) -> None:
    write_rig(tmp_path / "hero.usda", small_rig("/Hero/root"))
    layer = Sdf.Layer.FindOrOpen(str(tmp_path / "hero.usda"))
    layer.GetPrimAtPath("/Hero").typeName = "Xform"
    layer.Save()
    out, source = tmp_path / "shot.hero.usda", write_source(tmp_path / "shot.csv")
    drive = ("--drive", f"head={driven}", "--rig", tmp_path / "hero.usda")
    assert usdface("retarget", source, "--rate", 30, *drive, "--out", out) == 0
    scene = Usd.Stage.CreateNew(str(tmp_path / "scene.usda"))
    scene.SetTimeCodesPerSecond(30)
    walk = UsdGeom.Xform.Define(scene, "/World").AddTranslateOp()
    walk.Set(Gf.Vec3d(0, 0, 0), 1)
    walk.Set(Gf.Vec3d(0, 8, 3), FRAMES)
    hero = UsdGeom.Xform.Define(scene, "/World/hero").GetPrim()
    hero.GetReferences().AddReference("./shot.hero.usda")
    lens = UsdGeom.Camera.Define(scene, "/cam")
    lens.AddTranslateOp().Set(Gf.Vec3d(15, 10, 200))
    lens.CreateHorizontalApertureAttr(lens.GetVerticalApertureAttr().Get())
    scene.Save()
    shot = open_shot(out)
    camera = shot.camera("/cam", tmp_path / "scene.usda")
    root = scene.GetPrimAtPath(driven.replace("/Hero", "/World/hero"))
    for row in (0, 30):
        weights, world = shot.weights[row], UsdGeom.XformCache(row + 1)
        frustum = lens.GetCamera(row + 1).frustum
        seen = world.GetLocalToWorldTransform(root)
        seen *= frustum.ComputeViewMatrix() * frustum.ComputeProjectionMatrix()
        at_rest = shot.pose(row, weights, still=True) / 10
        flat = np.array([seen.Transform(Gf.Vec3d(*each.tolist()))[:2] for each in at_rest])
        drawn = camera.at(row + 1).project(shot.pose(row, weights), width=100, height=100)
        np.testing.assert_allclose(drawn[:, :2], 50 + 50 * flat * [1, -1], atol=0.01)


def test_joints_that_an_animator_keyed_are_drawn_without_a_take(tmp_path: Path) -> None:
    rig = write_creature(tmp_path / "beast.usda")
    out = tmp_path / "p.usda"
    write_creature_performance(out, rig, creature_acts(human_moves(12)))
    shot, posed = open_shot(out), PosedRig(out)
    assert shot.take.source is not None
    for row in (0, 7):
        seen = shot.pose(row, shot.weights[row])
        np.testing.assert_allclose(seen, posed.points(row + 1), atol=2e-3)
    assert usdface("sheet", out, "--tile", 64, "--rows", 2, "--out", tmp_path / "s.png") == 0


@pytest.mark.slow
def test_sheet_movie_and_report_show_the_head_turn(tmp_path: Path, browser: Any) -> None:
    rig = write_character(tmp_path / "hero.usda")
    out, source = tmp_path / "shot.hero.usda", write_source(tmp_path / "shot.csv")
    drive = ("--drive", "head=neck")
    usdface("retarget", source, "--rate", 30, "--rig", rig.file, *drive, "--out", out)
    small = ("--quality", "draft", "--out")
    assert usdface("sheet", out, "--tile", 64, "--rows", 2, *small, tmp_path / "s.png") == 0
    assert usdface("movie", out, "--height", 64, *small, tmp_path / "m.mp4") == 0
    assert usdface("report", out, "--out", tmp_path / "r.html") == 0
    shot = open_shot(out)
    with ShotPictures(shot, height=96, quality="draft") as pictures:
        turned = pictures.face(16, shot.weights[16]).astype(int)
    with ShotPictures(replace(shot, motion=None), height=96, quality="draft") as pictures:
        still = pictures.face(16, shot.weights[16]).astype(int)
    assert np.abs(turned - still).max(axis=2).mean() > 2
    surface = build_surface(rig.meshes)
    used, posed = np.unique(surface.triangles), PosedRig(out)
    faults: list[str] = []
    page = visit(browser.new_page(), tmp_path / "r.html", faults)
    for row in (5, 16):
        seen = page.evaluate(
            f"(report.show({row}), report.viewer.draw(), [...report.viewer.face.positions])"
        )
        expected = (surface.matrix @ posed.points(row + 1))[used]
        np.testing.assert_allclose(np.reshape(seen, (-1, 3)), expected, atol=0.05)
    page.keyboard.press("e")
    page.evaluate("report.viewer.draw()")
    held = np.reshape(page.evaluate("[...report.viewer.face.positions]"), (-1, 3))
    assert np.abs(held - expected).max() > 5
    page.close()
    assert not faults


def test_a_neutral_frame_without_markers_has_the_head_where_it_was(tmp_path: Path) -> None:
    rig = write_character(tmp_path / "hero.usda")
    count, rng = 10, np.random.default_rng(0)
    motion = np.tile(np.eye(4), (count, 1, 1))
    turned = Rotation.from_euler("y", np.linspace(0, 0.3, count)[:, None])
    motion[:, :3, :3] = turned.as_matrix()
    visible = np.ones((count, 5), bool)
    visible[3] = False
    places = np.tile(rng.normal(size=(5, 3)), (count, 1, 1)).astype(np.float32)
    markers = Markers(
        names=("a", "b", "c", "d", "e"),
        positions=places,
        visible=visible,
        confidence=visible.astype(np.float32),
        neutral_frame=4,
    )
    weights = WeightsClip(("jawOpen", "smile"), np.full((count, 2), 0.5, np.float32), 1, RATE)
    take = Take("t", RATE, 1, markers=markers, source=weights, head_motion=motion)
    write_take(tmp_path / "t.take.usda", take, provenance=Provenance())
    out = tmp_path / "o.usda"
    line = ("retarget", tmp_path / "t.take.usda", "--rig", rig.file, "--drive", "head=spine")
    assert usdface(*line, "--out", out) == 0
    layer = Sdf.Layer.FindOrOpen(str(head_path(out)))
    rest = layer.QueryTimeSample("/Hero/FaceSolve.translations", 4)
    np.testing.assert_allclose(np.array(rest), [REST[0]], atol=1e-6)
    away = take_head_source(TakeReader(tmp_path / "t.take.usda"), 1, count).centre
    np.testing.assert_allclose(away, places[0].mean(axis=0), atol=1e-4)


def test_without_the_option_it_is_taken_back(tmp_path: Path) -> None:
    rig = write_character(tmp_path / "hero.usda")
    out, source = tmp_path / "shot.hero.usda", write_source(tmp_path / "shot.csv")
    common = ("retarget", source, "--rate", 30, "--rig", rig.file, "--out", out)
    assert usdface(*common, "--drive", "head=neck") == 0
    assert RigMotion(out, rig).shares.nnz
    assert usdface(*common, "--overwrite") == 0
    assert not RigMotion(out, rig).shares.nnz


@pytest.mark.parametrize(
    ("other", "said"),
    [
        ("left_eye=eye_L", "drives spine/neck/eye_L where"),
        ("left_eye=/Hero/props/eyeball", "drives /Hero/props/eyeball.xformOp:transform:head where"),
        ("", "drives nothing where"),
    ],
)
def test_parts_that_drive_different_things_are_not_joined(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], other: str, said: str
) -> None:
    """The joint of the second part would be written as the first part's."""
    rig, source = write_character(tmp_path / "hero.usda"), write_source(tmp_path / "shot.csv")
    parts = []
    for frames, drive in (("1-20", "head=neck"), ("21-40", other)):
        common = ("retarget", source, "--rate", 30, "--rig", rig.file, "--frames", frames)
        driven = ("--drive", drive) if drive else ()
        parts.append(tmp_path / f"{frames}.usda")
        assert usdface(*common, *driven, "--out", parts[-1]) == 0
    out = tmp_path / "whole.usda"
    assert usdface("join", *parts, "--out", out) == 2
    message = " ".join(capsys.readouterr().err.replace("│", " ").split())
    assert said in message
    assert "1-20.usda drives spine/neck; make it again with the same options" in message
    assert not out.exists()


@pytest.mark.parametrize(("clips", "above"), [("never", ""), ("never", "/a/b"), ("always", "")])
def test_joined_parts_keep_joints_and_attributes(tmp_path: Path, clips: str, above: str) -> None:
    rig, acts = write_creature(tmp_path / "beast.usda"), creature_acts(human_moves(12))
    parts = []
    for first in (1, 7):
        rows = {
            name: getattr(acts, name)[first - 1 : first + 5]
            for name in ("weights", "translations", "rotations", "scales", "values")
        }
        parts.append(tmp_path / f"{first}.usda")
        write_creature_performance(parts[-1], rig, replace(acts, **rows), first=first)
        if above:  # shots that reference the parts
            layer = Sdf.Layer.CreateNew(str(tmp_path / f"shot{first}.usda"))
            placed = Sdf.CreatePrimInLayer(layer, above)
            placed.specifier = placed.nameParent.specifier = Sdf.SpecifierDef
            placed.referenceList.prependedItems = [Sdf.Reference(f"./{first}.usda", "/Beast")]
            layer.timeCodesPerSecond = 24
            layer.Save()
            parts[-1] = Path(layer.realPath)
    whole = tmp_path / "whole.usda"
    assert usdface("join", *parts, "--clips", clips, "--out", whole) == 0
    joined = read_control_clip(whole).controls
    assert (joined.joints, joined.attributes) == (acts.joints, acts.attributes)
    for name in ("weights", "translations", "rotations", "values"):
        np.testing.assert_allclose(getattr(joined, name), getattr(acts, name), atol=1e-6)


def test_a_package_has_the_head_where_it_was_moved_to(tmp_path: Path) -> None:
    rig, source = write_character(tmp_path / "hero.usda"), write_source(tmp_path / "shot.csv")
    out, package = tmp_path / "shot.hero.usda", tmp_path / "shot.usdz"
    drive = ("--drive", "head=neck", "--drive", "left_eye=/Hero/props/eyeball")
    assert usdface("retarget", source, "--rate", 30, "--rig", rig.file, *drive, "--out", out) == 0
    layer = Sdf.Layer.FindOrOpen(str(out))
    for at in range(len(layer.subLayerPaths)):
        layer.subLayerOffsets[at] = Sdf.LayerOffset(100)
    layer.startTimeCode, layer.endTimeCode = 101, 100 + FRAMES
    layer.Save()
    assert usdface("package", out, "--out", package) == 0
    ours, packed = (Usd.Stage.Open(str(each)) for each in (out, package))
    for name in (
        "FaceSolve.blendShapeWeights",
        "FaceSolve.rotations",
        "props/eyeball.xformOp:transform:head",
    ):
        one, other = (each.GetAttributeAtPath(f"/Hero/{name}") for each in (ours, packed))
        assert other.GetTimeSamples() == one.GetTimeSamples() == list(range(101, 101 + FRAMES))
        assert other.Get(117) == one.Get(117)


@pytest.mark.parametrize(
    ("rate", "offset", "place"),
    [(30, 100, "/Hero"), (15, 0, "/Hero"), (15, 100, "/cast/actor")],
)
def test_a_layer_above_a_performance_is_packed_and_published_with_the_head(
    tmp_path: Path, rate: int, offset: int, place: str, capsys: pytest.CaptureFixture[str]
) -> None:
    rig, source = write_character(tmp_path / "hero.usda"), write_source(tmp_path / "shot.csv")
    out, above = tmp_path / "shot.hero.usda", tmp_path / "animator.usda"
    drive = ("--drive", "head=neck", "--drive", "left_eye=/Hero/props/eyeball")
    assert usdface("retarget", source, "--rate", 30, "--rig", rig.file, *drive, "--out", out) == 0
    layer = Sdf.Layer.CreateNew(str(above))
    layer.timeCodesPerSecond, moved = rate, Sdf.LayerOffset(offset)
    if place == "/Hero":
        layer.subLayerPaths = [f"./{out.name}"]
        layer.subLayerOffsets[0] = moved
    else:
        reference = Sdf.Reference(f"./{out.name}", "/Hero", moved)
        actor = Sdf.CreatePrimInLayer(layer, place)
        actor.specifier = actor.nameParent.specifier = Sdf.SpecifierDef
        actor.referenceList.prependedItems = [reference]
    layer.Save()
    capsys.readouterr()
    assert usdface("bake", above, "--out", tmp_path / "baked.usdc") == 0
    assert "only weights are baked: shot.hero.head.usdc" in capsys.readouterr().out
    assert usdface("package", above, "--out", tmp_path / "shot.usdz") == 0
    (item,) = collect_performances([above])
    published = extract_performance(item, tmp_path / "publish").path("performance")
    assert published is not None
    frame = offset + 17 * rate // 30
    ours = Usd.Stage.Open(str(above))
    for each in (published, tmp_path / "shot.usdz"):
        stage = Usd.Stage.Open(str(each))
        for name in ("FaceSolve.rotations", "props/eyeball.xformOp:transform:head"):
            one, other = (at.GetAttributeAtPath(f"{place}/{name}") for at in (ours, stage))
            assert other.GetNumTimeSamples() == FRAMES
            assert other.Get(frame) == one.Get(frame)


@pytest.mark.parametrize("absolute", [False, True])
def test_layers_whose_paths_another_tool_wrote_are_known(tmp_path: Path, absolute: bool) -> None:
    rig, source = write_character(tmp_path / "hero.usda"), write_source(tmp_path / "shot.csv")
    out = tmp_path / "shot.hero.usda"
    retarget = ("retarget", source, "--rate", 30, "--rig", rig.file, "--drive", "head=neck")
    assert usdface(*retarget, "--out", out) == 0
    layer = Sdf.Layer.FindOrOpen(str(out))
    names = ["shot.hero.head.usdc", "shot.hero.weights.usdc"]
    written = [str(tmp_path / each) if absolute else each for each in names]
    layer.subLayerPaths = written
    layer.Save()
    assert usdface("package", out, "--out", tmp_path / "shot.usdz") == 0
    packed = Usd.Stage.Open(str(tmp_path / "shot.usdz"))
    assert packed.GetAttributeAtPath("/Hero/FaceSolve.rotations").GetNumTimeSamples() == FRAMES
    assert usdface(*retarget, "--out", out, "--overwrite") == 0
    assert usdface("edit", out, "--shape", "jawOpen", "--add", 0.1) == 0
    layer.Reload()
    assert list(layer.subLayerPaths) == ["./shot.hero.edits.usda", *written]


@pytest.mark.parametrize(
    ("drive", "said"),
    [
        ("head=nose", ("no joint and no Xform is called 'nose'", "spine/neck/eye_L", "eyeball")),
        ("left_eye=eyeball", ("2 Xforms are called 'eyeball'", "/Hero/props/other/eyeball")),
        ("right_eye=eye_R", ("has no motion of the right_eye", "eyeLook")),
        ("nose=neck", ("'nose=neck' is not PART=NAME", "head, left_eye, right_eye")),
        ("head=", ("'head=' is not PART=NAME",)),
    ],
)
def test_wrong_names_are_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], drive: str, said: tuple[str, ...]
) -> None:
    rig = write_character(tmp_path / "hero.usda")
    out, source = tmp_path / "shot.hero.usda", write_source(tmp_path / "shot.csv")
    assert (
        usdface("retarget", source, "--rate", 30, "--rig", rig.file, "--drive", drive, "--out", out)
        == 2
    )
    message = " ".join(capsys.readouterr().err.replace("│", " ").split())
    assert not [each for each in said if each not in message], message
    assert not out.exists()
    assert not head_path(out).exists()


def test_a_joint_is_driven_by_one_part(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    rig = write_character(tmp_path / "hero.usda")
    out, source = tmp_path / "shot.hero.usda", write_source(tmp_path / "shot.csv")
    both = ("--drive", "left_eye=eye_L", "--drive", "right_eye=eye_L")
    assert usdface("retarget", source, "--rate", 30, "--rig", rig.file, *both, "--out", out) == 2
    assert "eye_L for the left_eye and the right_eye" in capsys.readouterr().err
    assert not out.exists()


def add_eyeball(rig: Path, *, of_joint: bool) -> Rig:
    """Give the left eye a ball, a look that turns it, and one that moves the skin alone."""
    stage = Usd.Stage.Open(str(rig))
    place = "/Hero/geo/ball" if of_joint else "/Hero/props/eyeball/ball"
    ball = UsdGeom.Mesh.Define(stage, place)
    corners = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], float)
    ball.CreatePointsAttr([Gf.Vec3f(*each) for each in (corners + REST[2]).tolist()])
    ball.CreateFaceVertexCountsAttr([4, 4])
    ball.CreateFaceVertexIndicesAttr([0, 1, 3, 2, 4, 5, 7, 6])
    binding = UsdSkel.BindingAPI.Apply(ball.GetPrim())
    binding.CreateSkeletonRel().SetTargets(["/Hero/rig/skeleton"])
    if of_joint:
        binding.CreateJointIndicesPrimvar(True, 1).Set([JOINTS.index("spine/neck/eye_L")])
        binding.CreateJointWeightsPrimvar(True, 1).Set([1.0])
    skin = UsdSkel.BindingAPI(stage.GetPrimAtPath("/Hero/geo/skin"))
    turned = Rotation.from_euler("y", 30, degrees=True).apply(corners) - corners
    for mesh, name, offsets in (
        (binding, "eyeLookOut_L", turned),
        (skin, "eyeLookDown_L", np.ones((12, 3))),
    ):
        prim = UsdSkel.BlendShape.Define(stage, mesh.GetPath().AppendChild(name))
        prim.CreateOffsetsAttr([Gf.Vec3f(*each) for each in offsets.tolist()])
        names = list(mesh.GetBlendShapesAttr().Get() or ())
        mesh.CreateBlendShapesAttr().Set([*names, name])
        mesh.CreateBlendShapeTargetsRel().AddTarget(prim.GetPath())
    stage.GetRootLayer().Save()
    return read_rig(rig)


@pytest.mark.parametrize("of_joint", [True, False])
def test_a_look_that_turns_a_driven_eyeball_is_held(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], of_joint: bool
) -> None:
    """Gaze would be doubled. A look that moves lids alone goes on."""
    write_character(tmp_path / "hero.usda")
    rig = add_eyeball(tmp_path / "hero.usda", of_joint=of_joint)
    source, out = write_source(tmp_path / "shot.csv"), tmp_path / "o.usda"
    common = ("retarget", source, "--rate", 30, "--rig", rig.file, "--overwrite", "--out", out)
    eye = "eye_L" if of_joint else "/Hero/props/eyeball"
    moving = {}
    for drive in ((), ("--drive", "head=neck"), ("--drive", f"left_eye={eye}")):
        assert usdface(*common, *drive) == 0
        clip = read_weights(out)
        moving[drive[-1:]] = {n for n, w in zip(clip.names, clip.values.T, strict=True) if w.any()}
        said = capsys.readouterr().out
        assert ("held at 0, as --drive turns the same eyeballs: eyeLookOut_L" in said) == (
            drive[-1:] == (f"left_eye={eye}",)
        )
    looks = {"jawOpen", "eyeLookOut_L", "eyeLookDown_L"}
    assert list(moving.values()) == [looks, looks, looks - {"eyeLookOut_L"}]


def test_small_angles_in_degrees_are_noticed(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """All are below half a turn in radians as well, and look like it."""
    rig = write_character(tmp_path / "hero.usda")
    source, out = write_source(tmp_path / "shot.csv"), tmp_path / "o.usda"
    header, *rows = source.read_text(encoding="utf-8").splitlines()
    names, columns = header.split(","), np.array([row.split(",") for row in rows], float)
    looks = [n for n, name in enumerate(names) if name.startswith("eyeLook")]
    for part in ("Head", "LeftEye"):
        turned = [n for n, name in enumerate(names) if name.startswith(part)]
        degrees = np.degrees(columns[:, turned])
        less = 3 / np.abs(degrees).max()
        columns[:, turned] = less * degrees
    common = ("retarget", source, "--rate", 30, "--weight-unit", "one", "--rig", rig.file)
    common += ("--drive", "head=neck", "--drive", "left_eye=eye_L", "--overwrite", "--out", out)
    columns[:, looks] *= less
    np.savetxt(source, columns, "%.9f", ",", header=header, comments="")
    assert usdface(*common) == 2
    assert "times as large as those of its looks, so they are in degrees" in " ".join(
        capsys.readouterr().err.split()
    )
    columns[:, looks] = 0
    np.savetxt(source, columns, "%.9f", ",", header=header, comments="")
    assert usdface(*common) == 0
    assert "if that is too far, its angles are not in radians" in capsys.readouterr().out


def test_degrees_are_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    rig = write_character(tmp_path / "hero.usda")
    out, source = tmp_path / "o.usda", write_source(tmp_path / "shot.csv", scale=57.3)
    code = usdface(
        *("retarget", source, "--rate", 30, "--weight-unit", "one"),
        *("--rig", rig.file, "--drive", "head=neck", "--out", out),
    )
    assert code == 2
    assert "angles are in radians" in capsys.readouterr().err
    assert not out.exists()


def test_markers_turn_the_head_of_the_character(shot: Shot) -> None:
    """The demo's actor and hero face the same way: the joint has the head's own rotation."""
    joint = str(UsdSkel.Skeleton(_skeleton(shot / "hero.usdc")).GetJointsAttr().Get()[0])
    common = ("map", shot / "shot.clean.take.usda", "--mapping", shot / "hero.mapping.usdc")
    common += ("--rig", shot / "hero.usdc", "--drive", f"head={joint}")
    out = shot / "head.hero.usda"
    assert usdface(*common, "--out", out) == 0
    take = TakeReader(shot / "shot.clean.take.usda")
    motion = take.head_motion_from_neutral(take.first_frame, take.last_frame)
    assert motion is not None
    driven = RigMotion(out, read_rig(shot / "hero.usdc"))
    off = []
    for row in range(0, len(motion), 60):
        turned = driven.transforms(take.first_frame + row)[0][:3, :3]
        off.append(Rotation.from_matrix(turned @ motion[row, :3, :3].T).magnitude())
    assert np.degrees(Rotation.from_matrix(motion[:, :3, :3]).magnitude()).max() > 5
    assert np.degrees(max(off)) < 2
    parts = []
    middle = (take.first_frame + take.last_frame) // 2
    for first, last in ((take.first_frame, middle), (middle + 1, take.last_frame)):
        parts.append(shot / f"part.{first}.usda")
        assert usdface(*common, "--frames", f"{first}-{last}", "--out", parts[-1]) == 0
    whole = shot / "whole.hero.usda"
    assert usdface("join", *parts, "--out", whole) == 0
    joined = RigMotion(whole, read_rig(shot / "hero.usdc"))
    for frame in (take.first_frame, middle, middle + 1, take.last_frame):
        np.testing.assert_allclose(
            joined.transforms(frame), driven.transforms(frame), atol=1e-6, rtol=0
        )


def test_a_stabilised_take_of_weights_carries_the_head_along(shot: Shot) -> None:
    """As tracked videos are retargeted: without a mapping, upright and facing the same way."""
    take = read_take(shot / "shot.clean.take.usda")
    keys = read_weight_table(shot / "keys.csv")
    clip = WeightsClip(keys.names, keys.weights[: take.frame_count], take.first_frame, take.rate)
    write_take(shot / "both.take.usda", replace(take, source=clip), provenance=Provenance())
    joint = str(UsdSkel.Skeleton(_skeleton(shot / "hero.usdc")).GetJointsAttr().Get()[0])
    out = shot / "both.hero.usda"
    line = ("retarget", shot / "both.take.usda", "--rig", shot / "hero.usdc", "--frames", "60-200")
    assert usdface(*line, "--drive", f"head={joint}", "--out", out) == 0
    motion = TakeReader(shot / "both.take.usda").head_motion_from_neutral(60, 200)
    assert motion is not None
    rig = read_rig(shot / "hero.usdc")
    driven, axes, centre = RigMotion(out, rig), face_axes(rig), face_centre(rig)
    assert take.markers is not None
    neutral = take.markers.neutral_frame - take.first_frame
    head = take.markers.positions[neutral][take.markers.visible[neutral]].mean(axis=0)
    for frame in (60, 130, 200):
        moved, captured = driven.transforms(frame)[0], motion[frame - 60]
        turned = axes @ captured[:3, :3] @ axes.T
        np.testing.assert_allclose(moved[:3, :3], turned, atol=1e-5)
        gone = captured[:3, :3] @ head + captured[:3, 3] - head
        placed = moved[:3, :3] @ centre + moved[:3, 3] - centre
        np.testing.assert_allclose(placed, axes @ gone, atol=0.01)
    np.testing.assert_allclose(axes, np.eye(3), atol=0.02)
    assert np.linalg.norm(gone) > 1


def _skeleton(file: Path) -> Usd.Prim:
    stage = Usd.Stage.Open(str(file))
    _kept.append(stage)
    return next(each for each in stage.Traverse() if each.IsA(UsdSkel.Skeleton))


_kept: list[Usd.Stage] = []
"""A prim does not keep its stage."""


def test_a_package_turns_its_head(tmp_path: Path) -> None:
    rig = write_character(tmp_path / "hero.usda")
    out, source = tmp_path / "shot.hero.usda", write_source(tmp_path / "shot.csv")
    drive = ("--drive", "head=neck")
    usdface("retarget", source, "--rate", 30, "--rig", rig.file, *drive, "--out", out)
    assert usdface("package", out, "--out", tmp_path / "shot.usdz") == 0
    stage = Usd.Stage.Open(str(tmp_path / "shot.usdz"))
    animation = UsdSkel.Animation(stage.GetPrimAtPath(Sdf.Path("/Hero/FaceSolve")))
    assert list(animation.GetJointsAttr().Get()) == ["spine/neck"]
    assert animation.GetRotationsAttr().GetNumTimeSamples() == FRAMES
