"""Performances: the rig is referenced, the weights lie beneath, edits stay."""

from dataclasses import replace
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
from pxr import Gf, Sdf, Usd, UsdGeom, UsdSkel

from tests.usdio.posed_points import PosedRig
from tests.usdio.small_rig import small_rig
from usdface.core.assets import SolveBasis
from usdface.core.deformer import Deformer
from usdface.core.errors import InputError
from usdface.core.provenance import Provenance
from usdface.core.sidecars import weights_path
from usdface.runner.execute import execute
from usdface.specs.edits import BakeSpec, EditSpec, PackageSpec
from usdface.usdio.layers import relative_path
from usdface.usdio.performance import weights_layer
from usdface.usdio.performance.read import PerformanceReader, read_performance
from usdface.usdio.performance.weights_layer import SolveFigures, make_header
from usdface.usdio.performance.write import writing_performance
from usdface.usdio.rig.read import read_rig
from usdface.usdio.rig.reference import moved_rig, replaced_motion_notes
from usdface.usdio.rig.write import write_rig
from usdface.usdio.validation import validate

BASIS = SolveBasis(
    30,
    12,
    ("brows", "lids"),
    regions_without_markers=("jaw",),
    changed_shapes=("jawOpen",),
    regions_without_shapes=("mouth",),
    motion_scale=1.25,
)
NAMES = ("smile", "jawOpen", "eyeBlink")  # another order than the rig's
WEIGHTS = np.random.default_rng(0).random((20, 3)).astype(np.float32)


def write(folder: Path, *, place: str | None = None, weights=WEIGHTS, first: int = 1001) -> Path:
    if not (folder / "rig.usda").exists():
        write_rig(folder / "rig.usda", small_rig())
    path = folder / "shot.hero.usda"
    with writing_performance(
        path,
        replace(
            make_header(
                read_rig(folder / "rig.usda"),
                shape_names=NAMES,
                rate=Fraction(30000, 1001),
                first_frame=first,
                last_frame=first + len(weights) - 1,
                rig_path=place,
                regions=("face",),
                timecode_start="00:01:00;02",
            ),
            basis=BASIS,
        ),
        read_rig(folder / "rig.usda"),
        provenance=Provenance("map", "{}", {}),
    ) as writer:
        for start in range(0, len(weights), 7):
            part = weights[start : start + 7]
            figures = SolveFigures(
                np.linspace(0, 1, len(weights))[start : start + 7, None],
                np.full((len(part), 1), 0.75),
                np.full((len(part), 1), 0.5),
            )
            writer.append(part, figures)
    return path


def write_with_another_rig(path: Path) -> None:
    """Map again, onto the rig's next version."""
    write_rig(path.with_name("v002.usda"), small_rig())
    other = read_rig(path.with_name("v002.usda"))
    with writing_performance(
        path,
        make_header(
            other,
            shape_names=NAMES,
            rate=Fraction(24),
            first_frame=1,
            last_frame=len(WEIGHTS),
        ),
        other,
    ) as writer:
        writer.append(WEIGHTS)


def test_performance_reads_back_the_same(tmp_path: Path) -> None:
    back = read_performance(write(tmp_path))
    assert back.weights.names == NAMES
    np.testing.assert_array_equal(back.weights.values, WEIGHTS)
    assert (back.weights.first_frame, back.weights.rate) == (1001, Fraction(30000, 1001))
    assert back.rig_file.resolve() == (tmp_path / "rig.usda").resolve()
    assert (back.rig_prim, back.regions) == ("/Hero", ("face",))
    np.testing.assert_allclose(back.uncertainty_mm[:, 0], np.linspace(0, 1, 20), atol=1e-6)
    np.testing.assert_allclose(back.coverage, 0.75)
    np.testing.assert_allclose(back.residual_mm, 0.5)
    assert back.basis == BASIS
    assert back.timecode_start == "00:01:00;02"


def test_a_timecode_that_the_rate_cannot_have_is_refused_with_the_file_named(
    tmp_path: Path,
) -> None:
    path = write(tmp_path)
    assert PerformanceReader(path).timecode_at(1002) == "00:01:00;03"
    for each in (path, tmp_path / "shot.hero.weights.usdc"):
        layer = Sdf.Layer.FindOrOpen(str(each))
        layer.timeCodesPerSecond = layer.framesPerSecond = 7
        layer.Save()
    with pytest.raises(InputError, match=r"shot\.hero\.usda: face:timecode:start: .*not at 7"):
        PerformanceReader(path).timecode_at(1002)


def exported(path: Path, names: list[str], samples: list[object]) -> Path:
    """Write an animation as a tool without usdface does."""
    stage = Usd.Stage.CreateNew(str(path))
    animation = UsdSkel.Animation.Define(stage, "/face")
    animation.CreateBlendShapesAttr(names)
    for time, weights in enumerate(samples, start=7):
        animation.CreateBlendShapeWeightsAttr().Set(weights, time)
    stage.Save()
    return path


@pytest.mark.parametrize(
    ("sample", "fault"),
    [
        (Sdf.ValueBlock(), "no value for 2 names"),
        ([0.5], "1 value for 2 names"),
        ([0.5, np.nan], "smile is nan, not finite"),
    ],
)
def test_a_sample_that_no_one_can_use_is_told_with_its_fault(tmp_path, sample, fault) -> None:
    path = exported(tmp_path / "dcc.usda", ["jaw", "smile"], [[0.1, 0.2], sample])
    match = rf"dcc\.usda </face\.blend.*> time code 8: {fault}.*; export the file again"
    with pytest.raises(InputError, match=match):
        PerformanceReader(path).solved()


def test_a_shape_named_twice_is_refused_as_either_weight_may_be_meant(tmp_path: Path) -> None:
    path = exported(tmp_path / "dcc.usda", ["jaw", "smile", "jaw"], [[0.1, 0.2, 0.9]])
    with pytest.raises(InputError, match=r"dcc\.usda </face>: blendShapes names jaw twice"):
        PerformanceReader(path)


@pytest.mark.parametrize("scale", [np.nan, np.inf, 0.0, -1.0])
def test_a_motion_scale_that_would_lift_all_limits_is_refused(tmp_path: Path, scale: float) -> None:
    path = write(tmp_path)
    stage = Usd.Stage.Open(str(path))
    animation = next(each for each in stage.Traverse() if each.IsA(UsdSkel.Animation))
    animation.GetAttribute("face:solve:motionScale").Set(scale)
    stage.Save()
    with pytest.raises(
        InputError, match=r"shot\.hero\.usda: face:solve:motionScale is .*map again"
    ):
        read_performance(path)


@pytest.mark.parametrize("place", [None, "/shot/cast/hero_01"])
def test_what_usdskel_bakes_from_the_layer_is_what_we_deform(tmp_path: Path, place) -> None:
    stage = Usd.Stage.Open(str(write(tmp_path, place=place)))
    flat = Usd.Stage.Open(stage.Flatten())
    root = UsdSkel.Root(flat.GetPrimAtPath(place or "/Hero"))
    assert UsdSkel.BakeSkinning(root, Gf.Interval(1001, 1020))
    rig = read_rig(tmp_path / "rig.usda")
    order = [NAMES.index(name) for name in rig.shapes]
    ours = Deformer(rig).points(WEIGHTS[:, order])
    skin = UsdGeom.Mesh(flat.GetPrimAtPath(f"{place or '/Hero'}/geo/skin"))
    for index in (0, 7, 19):
        baked = 10 * np.array(skin.GetPointsAttr().Get(1001 + index))
        np.testing.assert_allclose(ours[index, :12], baked, atol=1e-3)


@pytest.mark.parametrize("place", [None, "/shot/cast/hero_01"])
def test_the_rig_is_the_file_that_is_referenced_not_one_that_it_is_built_from(
    tmp_path: Path, place: str | None
) -> None:
    write_rig(tmp_path / "geo.usda", small_rig())
    Sdf.Layer.CreateNew(str(tmp_path / "shapes.usda")).Save()
    rig = Sdf.Layer.CreateNew(str(tmp_path / "rig.usda"))
    rig.subLayerPaths = ["./shapes.usda", "./geo.usda"]
    rig.defaultPrim = "Hero"
    below = Sdf.CreatePrimInLayer(rig, "/Hero")
    Sdf.AttributeSpec(below, "userProperties:show", Sdf.ValueTypeNames.String).default = "ours"
    rig.pseudoRoot.SetInfo("metersPerUnit", 0.01)
    rig.pseudoRoot.SetInfo("upAxis", "Y")
    rig.Save()
    path = write(tmp_path, place=place)
    assert PerformanceReader(path).rig() == (tmp_path / "rig.usda", "/Hero")
    assert read_rig(tmp_path / "rig.usda", prim="/Hero").shapes == read_performance_rig(path)
    shot = Sdf.Layer.CreateNew(str(tmp_path / "shot.usda"))  # a shot references the performance
    prim = Sdf.CreatePrimInLayer(shot, "/World")
    top = Sdf.Path(place or "/Hero").GetPrefixes()[0]
    prim.referenceList.prependedItems = [Sdf.Reference(f"./{path.name}", top)]
    shot.timeCodesPerSecond = shot.framesPerSecond = 30000 / 1001
    shot.Save()
    assert PerformanceReader(tmp_path / "shot.usda").rig() == (tmp_path / "rig.usda", "/Hero")


def read_performance_rig(path: Path) -> tuple[str, ...]:
    file, prim = PerformanceReader(path).rig()
    return read_rig(file, prim=prim).shapes


def test_a_rig_follows_an_animation_that_is_said_above_its_skeletons(tmp_path: Path) -> None:
    path = write(tmp_path)
    weights = Sdf.Layer.FindOrOpen(str(weights_path(path)))

    def no_longer(at: Sdf.Path) -> None:
        if at.IsPrimPath():
            prim = weights.GetPrimAtPath(at)
            if "skel:animationSource" in prim.relationships:
                prim.RemoveProperty(prim.relationships["skel:animationSource"])

    weights.Traverse(Sdf.Path.absoluteRootPath, no_longer)
    root = weights.GetPrimAtPath("/Hero")
    source = Sdf.RelationshipSpec(root, "skel:animationSource", False)
    source.targetPathList.explicitItems = [Sdf.Path("/Hero/FaceSolve")]
    root.SetInfo("apiSchemas", Sdf.TokenListOp.Create(prependedItems=["SkelBindingAPI"]))
    weights.Save()
    assert read_performance(path).rig_file.resolve() == (tmp_path / "rig.usda").resolve()


def test_written_performance_passes_every_validator(tmp_path: Path) -> None:
    path = write(tmp_path)
    assert validate(path) == []
    assert [f for f in validate(weights_path(path)) if f.severity == "error"] == []


def test_timing_units_and_default_prim_are_always_authored(tmp_path: Path) -> None:
    path = write(tmp_path)
    for each in (path, weights_path(path)):
        layer = Sdf.Layer.FindOrOpen(str(each))
        assert (layer.startTimeCode, layer.endTimeCode) == (1001, 1020)
        assert layer.timeCodesPerSecond == layer.framesPerSecond == pytest.approx(29.97, abs=1e-3)
        assert layer.defaultPrim == "Hero"
        assert layer.pseudoRoot.GetInfo("metersPerUnit") == pytest.approx(0.01)


def test_units_and_up_axis_are_those_of_the_rig_which_usd_shows_as_it_is(tmp_path: Path) -> None:
    write_rig(tmp_path / "rig.usda", small_rig())
    stage = Usd.Stage.Open(str(tmp_path / "rig.usda"))
    UsdGeom.SetStageMetersPerUnit(stage, 1.0)
    UsdGeom.SetStageUpAxis(stage, "Z")
    stage.Save()
    path = write(tmp_path)
    for each in (path, weights_path(path)):
        made = Usd.Stage.Open(str(each))
        assert (UsdGeom.GetStageMetersPerUnit(made), UsdGeom.GetStageUpAxis(made)) == (1.0, "Z")


def test_a_rig_that_is_mapped_to_another_place_is_gone_from_the_first(tmp_path: Path) -> None:
    path = write(tmp_path)
    bare = path.read_text()
    write(tmp_path, place="/shot/cast/hero_01")
    stage = Usd.Stage.Open(str(path))
    assert [str(prim.GetPath()) for prim in stage.Traverse() if prim.IsA(UsdSkel.Root)] == [
        "/shot/cast/hero_01"
    ]
    hand = UsdGeom.Xform.Define(stage, "/shot/cast/hero_01/sword")
    stage.Save()
    write(tmp_path, place="/shot/cast/villain")
    layer = Sdf.Layer.FindOrOpen(str(path))
    assert layer.GetPrimAtPath(hand.GetPath())  # somebody's own
    assert not layer.GetPrimAtPath("/shot/cast/hero_01").hasReferences
    del layer.rootPrims["shot"].nameChildren["cast"].nameChildren["hero_01"]
    layer.Save()
    write(tmp_path)
    assert path.read_text() == bare


def test_an_animation_beside_the_rig_is_read_with_the_place_of_the_rig(tmp_path: Path) -> None:
    path = write(tmp_path, place="/cast/hero")
    weights = Sdf.Layer.FindOrOpen(str(weights_path(path)))
    Sdf.CreatePrimInLayer(weights, "/anims")
    Sdf.CopySpec(weights, "/cast/hero/FaceSolve", weights, "/anims/face")
    del weights.GetPrimAtPath("/cast/hero").nameChildren["FaceSolve"]

    def follow(at: Sdf.Path) -> None:
        if at.IsPrimPropertyPath() and at.name == "skel:animationSource":
            weights.GetPropertyAtPath(at).targetPathList.explicitItems = [Sdf.Path("/anims/face")]

    weights.Traverse(Sdf.Path.absoluteRootPath, follow)
    weights.Save()
    reader = PerformanceReader(path)
    assert str(reader.animation.GetPath()) == "/anims/face"
    assert reader.header.rig_path == "/cast/hero"


def test_a_folder_behind_a_link_finds_the_rig_by_the_name_it_was_given(tmp_path: Path) -> None:
    (tmp_path / "disk" / "scratch" / "sh010").mkdir(parents=True)
    (tmp_path / "show").mkdir()
    work = tmp_path / "show" / "work"
    work.symlink_to(tmp_path / "disk" / "scratch" / "sh010")
    write_rig(tmp_path / "show" / "rig.usda", small_rig())
    path = work / "shot.usda"
    with writing_performance(
        path,
        make_header(
            read_rig(tmp_path / "show" / "rig.usda"),
            shape_names=NAMES,
            rate=Fraction(24),
            first_frame=1,
            last_frame=len(WEIGHTS),
        ),
        read_rig(tmp_path / "show" / "rig.usda"),
    ) as writer:
        writer.append(WEIGHTS)
    assert PerformanceReader(path).rig() == (tmp_path / "show" / "rig.usda", "/Hero")
    assert relative_path(work / "a.usda", path) == "./a.usda"
    both = tmp_path / "all"  # a link above everything changes nothing
    both.symlink_to(tmp_path / "show")
    (tmp_path / "show" / "cut").mkdir()
    assert relative_path(both / "rig.usda", both / "cut" / "a.usda") == "../rig.usda"
    assert relative_path(both / "rig.usda", tmp_path / "show" / "cut" / "a.usda") == "../rig.usda"


def test_two_faces_of_one_file_are_each_moved_by_their_own_weights(tmp_path: Path) -> None:
    write_rig(tmp_path / "hero.usda", small_rig())
    both = Usd.Stage.CreateNew(str(tmp_path / "rig.usda"))
    UsdGeom.SetStageMetersPerUnit(both, 0.01)
    both.SetDefaultPrim(UsdGeom.Xform.Define(both, "/duo").GetPrim())
    for name in ("anna", "bert"):
        both.DefinePrim(f"/duo/{name}").GetReferences().AddReference("./hero.usda")
    both.Save()
    for name, weights in (("anna", WEIGHTS), ("bert", WEIGHTS[::-1])):
        path = tmp_path / f"{name}.usda"
        rig = read_rig(tmp_path / "rig.usda", prim=f"/duo/{name}")
        with writing_performance(
            path,
            make_header(
                rig,
                shape_names=NAMES,
                rate=Fraction(24),
                first_frame=1,
                last_frame=len(WEIGHTS),
            ),
            rig,
        ) as writer:
            writer.append(weights)
        assert PerformanceReader(path).header.animation == f"/duo/FaceSolve_{name}"
        frame = Deformer(rig).points(weights[:1, [NAMES.index(each) for each in rig.shapes]])
        np.testing.assert_allclose(PosedRig(path).points(1), frame[0], atol=1e-3)
    shot = Sdf.Layer.CreateNew(str(tmp_path / "shot.usda"))
    shot.subLayerPaths = ["./anna.usda", "./bert.usda"]
    shot.timeCodesPerSecond = 24
    stage = Usd.Stage.Open(shot)
    for name, weights in (("anna", WEIGHTS), ("bert", WEIGHTS[::-1])):
        skeleton = next(
            prim
            for prim in Usd.PrimRange(stage.GetPrimAtPath(f"/duo/{name}"))
            if prim.IsA(UsdSkel.Skeleton)
        )
        source = UsdSkel.Animation(UsdSkel.BindingAPI(skeleton).GetInheritedAnimationSource())
        np.testing.assert_array_equal(source.GetBlendShapeWeightsAttr().Get(1), weights[0])
    del both, shot, stage, source, skeleton  # which hold the rig's layers open
    (tmp_path / "moved").mkdir()
    for name in ("hero.usda", "rig.usda"):
        (tmp_path / name).rename(tmp_path / "moved" / name)
    moved = tmp_path / "moved" / "rig.usda"
    for name in ("anna", "bert"):  # each performance knows its face
        with moved_rig(moved):
            assert PerformanceReader(tmp_path / f"{name}.usda").rig() == (moved, f"/duo/{name}")
        execute(
            EditSpec(performance=tmp_path / f"{name}.usda", shape=("jawOpen",), add=0.1, rig=moved)
        )
        baked = BakeSpec(performance=tmp_path / f"{name}.usda", out=tmp_path / "b.usdc", rig=moved)
        execute(baked, overwrite=True)


def test_the_rig_file_is_never_written(tmp_path: Path) -> None:
    write_rig(tmp_path / "rig.usda", small_rig())
    before = (tmp_path / "rig.usda").read_bytes()
    write(tmp_path)
    assert (tmp_path / "rig.usda").read_bytes() == before


def test_mapping_again_keeps_what_others_put_into_the_performance(tmp_path: Path) -> None:
    path = write(tmp_path)
    edits = Sdf.Layer.CreateNew(str(tmp_path / "edits.usda"))
    edits.Save()
    layer = Sdf.Layer.FindOrOpen(str(path))
    layer.subLayerPaths.insert(0, "./edits.usda")
    Sdf.CreatePrimInLayer(layer, "/Hero/FaceSolve").comment = "kept"
    layer.Save()
    write(tmp_path, weights=WEIGHTS[::-1], first=901)
    again = Sdf.Layer.FindOrOpen(str(path))
    again.Reload()
    assert list(again.subLayerPaths) == ["./edits.usda", "./shot.hero.weights.usdc"]
    assert again.GetPrimAtPath("/Hero/FaceSolve").comment == "kept"
    np.testing.assert_array_equal(read_performance(path).weights.values, WEIGHTS[::-1])
    assert read_performance(path).weights.first_frame == 901


def test_mapping_again_keeps_weights_that_somebody_moved_in_time(tmp_path: Path) -> None:
    path = write(tmp_path)
    layer = Sdf.Layer.FindOrOpen(str(path))
    layer.subLayerOffsets[0] = Sdf.LayerOffset(-1000, 1)
    layer.Save()
    write(tmp_path, weights=WEIGHTS[::-1])
    stage = Usd.Stage.Open(str(path))
    assert (stage.GetStartTimeCode(), stage.GetEndTimeCode()) == (1, 20)
    reader = PerformanceReader(path)
    assert (reader.first_frame, reader.last_frame) == (1, 20)
    np.testing.assert_array_equal(reader.solved(), WEIGHTS[::-1])


def test_frames_with_a_sample_are_known_in_a_stage_of_another_rate(tmp_path: Path) -> None:
    """USD's products of time codes and rates are not whole."""
    path, rates = write(tmp_path), (24_000 / 1001, 60_000 / 1001)
    for name, rate in zip(("shot.hero.weights.usdc", path.name), rates, strict=True):
        layer = Sdf.Layer.FindOrOpen(str(tmp_path / name))
        layer.timeCodesPerSecond = rate
        layer.Save()
    times = np.arange(1001, 1021) * 2.5
    reader = PerformanceReader(path)
    assert reader.keyed_frames == set(times[times % 1 == 0].astype(int).tolist())
    np.testing.assert_array_equal(reader.between_frames, times % 1 != 0)


def test_mapping_again_keeps_what_else_the_rig_s_prim_references(tmp_path: Path) -> None:
    path = write(tmp_path)

    def references() -> list[tuple[str, str]]:
        layer = Sdf.Layer.FindOrOpen(str(path))
        items = layer.GetPrimAtPath("/Hero").referenceList.prependedItems
        return [(each.assetPath, str(each.primPath)) for each in items]

    assert references() == [("./rig.usda", "/Hero")]
    layer = Sdf.Layer.FindOrOpen(str(path))
    more = [Sdf.Reference(f"./{name}.usda", "/Hero") for name in ("groom", "look")]
    items = layer.GetPrimAtPath("/Hero").referenceList
    items.prependedItems = [more[0], *items.prependedItems, more[1]]
    layer.Save()
    write(tmp_path)
    names = ["./groom.usda", "./rig.usda", "./look.usda"]
    assert [name for name, _ in references()] == names
    items = layer.GetPrimAtPath("/Hero").referenceList
    items.prependedItems = list(items.prependedItems)[1:]
    layer.Save()
    write_with_another_rig(path)
    assert [name for name, _ in references()] == ["./v002.usda", "./look.usda"]


def test_mapping_into_somebody_s_layer_keeps_what_it_references(tmp_path: Path) -> None:
    path = tmp_path / "shot.hero.usda"
    path.write_text(
        '#usda 1.0\ndef Xform "Hero" (prepend references = @./groom.usda@</Groom>)\n{\n}\n',
        encoding="utf-8",
    )
    write(tmp_path)
    layer = Sdf.Layer.FindOrOpen(str(path))
    hero = layer.GetPrimAtPath("/Hero").referenceList
    assert [each.assetPath for each in hero.prependedItems] == ["./rig.usda", "./groom.usda"]
    hero.prependedItems = list(hero.prependedItems)[::-1]
    layer.Save()
    write_with_another_rig(path)
    hero = layer.GetPrimAtPath("/Hero").referenceList
    assert [each.assetPath for each in hero.prependedItems] == ["./groom.usda", "./v002.usda"]


def test_long_takes_saved_in_lots_equal_short_ones(tmp_path: Path, monkeypatch) -> None:
    monkeypatch.setattr(weights_layer, "FRAMES_IN_MEMORY", 8)
    np.testing.assert_array_equal(read_performance(write(tmp_path)).weights.values, WEIGHTS)


def test_an_interrupted_mapping_leaves_the_old_performance(tmp_path: Path) -> None:
    path = write(tmp_path)
    before = {each.name: each.read_bytes() for each in tmp_path.iterdir()}
    rig = read_rig(tmp_path / "rig.usda")

    def stopped(error: type[BaseException] | None) -> None:
        header = make_header(
            rig, shape_names=NAMES, rate=Fraction(24), first_frame=1, last_frame=100
        )
        with writing_performance(path, header, rig) as writer:
            writer.append(WEIGHTS)
            if error is not None:
                raise error

    with pytest.raises(KeyboardInterrupt):
        stopped(KeyboardInterrupt)
    with pytest.raises(ValueError, match="20 frames were appended where 100 were announced"):
        stopped(None)
    assert {each.name: each.read_bytes() for each in tmp_path.iterdir()} == before


def test_an_animation_of_the_rig_s_joints_is_named_until_it_plays_again(tmp_path: Path) -> None:
    write_rig(tmp_path / "rig.usda", small_rig())
    stage = Usd.Stage.Open(str(tmp_path / "rig.usda"))
    body = UsdSkel.Animation.Define(stage, "/Hero/body")
    skeleton = UsdSkel.Skeleton(stage.GetPrimAtPath("/Hero/rig/skeleton"))
    body.GetJointsAttr().Set(skeleton.GetJointsAttr().Get())
    body.SetTransforms([Gf.Matrix4d(1).SetTranslate((0, 7, 0))], 1010)
    UsdSkel.BindingAPI.Apply(stage.GetPrimAtPath("/Hero"))
    source = UsdSkel.BindingAPI(stage.GetPrimAtPath("/Hero")).CreateAnimationSourceRel()
    source.SetTargets(["/Hero/body"])
    stage.Save()
    path = write(tmp_path, place="/World/Face")
    reader = PerformanceReader(path)
    (note,) = replaced_motion_notes(reader.stage, reader.animation)
    assert "1 joint, </World/Face/body>" in note
    layer = Sdf.Layer.FindOrOpen(str(path))
    solve = Sdf.CreatePrimInLayer(layer, "/World/Face/FaceSolve")
    solve.referenceList.prependedItems = [Sdf.Reference("", "/World/Face/body")]
    layer.Save()
    reader = PerformanceReader(path)
    assert replaced_motion_notes(reader.stage, reader.animation) == []
    played = UsdSkel.Animation(reader.animation).GetTransforms(1010)
    assert played[0].ExtractTranslation() == (0, 7, 0)
    np.testing.assert_array_equal(reader.solved(), WEIGHTS)
    execute(PackageSpec(performance=path, out=tmp_path / "review.usdz"))
    packed = PerformanceReader(tmp_path / "review.usdz")
    played = UsdSkel.Animation(packed.animation).GetTransforms(1010)
    assert played[0].ExtractTranslation() == (0, 7, 0)


def test_a_performance_instanced_in_a_shot_is_read_and_not_edited(tmp_path: Path) -> None:
    performance = write(tmp_path)
    shot = Sdf.Layer.CreateNew(str(tmp_path / "shot.usda"))
    shot.TransferContent(Sdf.Layer.FindOrOpen(str(performance)))
    shot.subLayerPaths.clear()
    shot.rootPrims[0].referenceList.prependedItems = [Sdf.Reference("./shot.hero.usda")]
    shot.rootPrims[0].SetInfo("instanceable", True)
    shot.Save()
    reader = PerformanceReader(tmp_path / "shot.usda")
    np.testing.assert_array_equal(reader.edited(), WEIGHTS)
    assert reader.rig()[0].resolve() == (tmp_path / "rig.usda").resolve()
    assert validate(tmp_path / "shot.usda") == []
    with pytest.raises(InputError, match="instanceable = false"):
        execute(EditSpec(performance=reader.path, shape=("smile",), add=0.1))


def test_a_package_is_read_with_the_rig_inside_it(tmp_path: Path) -> None:
    performance, package = write(tmp_path), tmp_path / "review.usdz"
    execute(PackageSpec(performance=performance, out=package))
    shapes = read_rig(tmp_path / "rig.usda").shapes
    (tmp_path / "rig.usda").unlink()
    back = read_performance(package)
    np.testing.assert_allclose(back.weights.values, WEIGHTS, atol=1e-6)
    rig = read_rig(back.rig_file, prim=back.rig_prim)
    assert rig.shapes == shapes
    assert package.name in str(rig.file)
    with pytest.raises(InputError, match="no such file"):
        read_rig(tmp_path / "other.usdz[rig.usda]")


def test_a_rig_inside_an_instance_is_refused_with_the_way_out(tmp_path: Path) -> None:
    write_rig(tmp_path / "inner.usda", small_rig())
    stage = Usd.Stage.CreateNew(str(tmp_path / "rig.usda"))
    hero = stage.DefinePrim("/Set/Hero")
    hero.GetReferences().AddReference("./inner.usda")
    hero.SetInstanceable(True)
    stage.Save()
    with pytest.raises(InputError, match="instanceable = false"):
        write(tmp_path)


@pytest.mark.parametrize("names", [[], ["face", "brows"]], ids=["no_names", "too_few_names"])
def test_figures_of_more_regions_than_are_named_are_refused(
    tmp_path: Path, names: list[str]
) -> None:
    path = write(tmp_path)
    layer = Sdf.Layer.FindOrOpen(str(path))
    animation = Sdf.CreatePrimInLayer(layer, str(PerformanceReader(path).animation.GetPath()))
    types = Sdf.ValueTypeNames
    Sdf.AttributeSpec(animation, "face:residual:regions", types.TokenArray).default = names
    figure = Sdf.AttributeSpec(animation, "face:uncertainty", types.FloatArray)
    layer.SetTimeSample(figure.path, 1001.0, [0.1, 0.2, 0.3])
    layer.Save()
    with pytest.raises(InputError, match=r"face:uncertainty>: 3 values a frame, but \d names"):
        PerformanceReader(path).figures()


def test_regions_that_are_no_names_are_refused_by_the_files_name(tmp_path: Path) -> None:
    path = write(tmp_path)
    layer = Sdf.Layer.FindOrOpen(str(path))
    animation = Sdf.CreatePrimInLayer(layer, str(PerformanceReader(path).animation.GetPath()))
    Sdf.AttributeSpec(animation, "face:residual:regions", Sdf.ValueTypeNames.Int).default = 3
    layer.Save()
    with pytest.raises(InputError, match=r"shot\.hero\.usda: a value is not of the type"):
        read_performance(path)
