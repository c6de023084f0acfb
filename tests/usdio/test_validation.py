"""What `validate` finds: each fault by the check that looks for it, with the way out."""

import os
import re
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
from pxr import Sdf, Usd, UsdShade, Vt

from tests.usdio.small_rig import small_rig
from usdface.core.assets import MeshShape, ShapeKey
from usdface.core.errors import InputError
from usdface.core.plugin_path import plugin_folders
from usdface.core.provenance import Provenance
from usdface.core.sidecars import weights_path
from usdface.steps.inputs.edit_ranges import performance_notes
from usdface.usdio.authoring import author_gaps, define_reference_prim
from usdface.usdio.performance.read import PerformanceReader
from usdface.usdio.performance.weights_layer import make_header
from usdface.usdio.performance.write import writing_performance
from usdface.usdio.rig.read import read_rig
from usdface.usdio.rig.write import write_rig
from usdface.usdio.validation import Finding, validate

NAMES = ("smile", "jawOpen", "eyeBlink")
FRAMES = 1400
SECONDS = np.arange(FRAMES) / 120
WEIGHTS = 0.5 + 0.4 * np.sin(SECONDS[:, None] * [3.0, 5.0, 7.0])
PRIM = "/Hero/FaceSolve"
ATTRIBUTE = f"{PRIM}.blendShapeWeights"


def write(folder: Path, weights: np.ndarray = WEIGHTS) -> Path:
    write_rig(folder / "rig.usda", small_rig())
    path = folder / "shot.hero.usda"
    with writing_performance(
        path,
        make_header(
            read_rig(folder / "rig.usda"),
            shape_names=NAMES,
            rate=Fraction(120),
            first_frame=1,
            last_frame=len(weights),
        ),
        read_rig(folder / "rig.usda"),
        provenance=Provenance("map", "{}", {}),
    ) as writer:
        writer.append(weights)
    return path


def change(path: Path, how: Callable[[Sdf.Layer], None]) -> Path:
    layer = Sdf.Layer.FindOrOpen(str(path))
    how(layer)
    layer.Save()
    return path


def only(path: Path, check: str) -> Finding:
    found = [each for each in validate(path) if each.check == f"usdface:{check}"]
    assert len(found) == 1, found
    return found[0]


def test_a_sound_performance_passes_every_check(tmp_path: Path) -> None:
    assert validate(write(tmp_path)) == []


def test_a_sample_of_the_wrong_length_is_named(tmp_path: Path) -> None:
    path = write(tmp_path)
    change(weights_path(path), lambda layer: layer.SetTimeSample(ATTRIBUTE, 1004, [0.5]))
    found = only(path, "Weights")
    assert found.message.startswith("time code 1004: 1 weights for 3 shapes")
    assert found.where == f"{path} <{ATTRIBUTE}>"
    assert found.severity == "error"


@pytest.mark.parametrize(
    ("sample", "told"),
    [
        ([0.1, float("nan"), 0.2], "time code 7: jawOpen is not finite"),
        ([0.1, 0.2, 55.0], "time code 7: eyeBlink is 55; .* percent"),
    ],
)
def test_values_that_are_no_weights_are_named(tmp_path: Path, sample: list, told: str) -> None:
    path = write(tmp_path)
    change(weights_path(path), lambda layer: layer.SetTimeSample(ATTRIBUTE, 7, sample))
    assert re.search(told, only(path, "Weights").message)


@pytest.mark.parametrize(
    ("held", "told"),
    [([0.5, 0.5], "2 weights for 3 shapes"), ([0.5, np.nan, 0.5], "jawOpen is not finite")],
)
@pytest.mark.parametrize("animated", [True, False])
def test_weights_that_are_held_without_samples_are_looked_at(
    tmp_path: Path, held: list, told: str, animated: bool
) -> None:
    path = write(tmp_path, WEIGHTS[:4])

    def hold(layer: Sdf.Layer) -> None:
        if not animated:
            for time in layer.ListTimeSamplesForPath(ATTRIBUTE):
                layer.EraseTimeSample(ATTRIBUTE, time)
        layer.GetAttributeAtPath(ATTRIBUTE).default = Vt.FloatArray(held)

    change(weights_path(path), hold)
    found = only(path, "Weights")
    assert found.severity == "error"
    assert found.message.startswith(f"its default: {told}")


def test_names_without_weights_are_empty(tmp_path: Path) -> None:
    path = write(tmp_path)

    def empty(layer: Sdf.Layer) -> None:
        prim = layer.GetPrimAtPath(PRIM)
        prim.RemoveProperty(prim.attributes["blendShapeWeights"])

    change(weights_path(path), empty)
    assert "3 shapes are named and there is no weight" in only(path, "Weights").message


def test_shapes_that_no_mesh_has_are_named(tmp_path: Path) -> None:
    path = write(tmp_path)

    def rename(layer: Sdf.Layer) -> None:
        layer.GetAttributeAtPath(f"{PRIM}.blendShapes").default = ["smile", "jaw", "blink"]

    change(weights_path(path), rename)
    assert "2 shapes are on no mesh: blink, jaw" in only(path, "Names").message


def test_shapes_that_only_another_character_has_are_on_no_mesh(tmp_path: Path) -> None:
    path = write(tmp_path, WEIGHTS[:4])
    shot = Sdf.Layer.CreateNew(str(tmp_path / "shot.usda"))
    for name in ("anna", "bert"):
        define_reference_prim(shot, Sdf.Path(f"/{name}"), f"./{path.name}", "/Hero")
    skin = Sdf.CreatePrimInLayer(shot, "/bert/geo/skin")
    renamed = Sdf.AttributeSpec(skin, "skel:blendShapes", Sdf.ValueTypeNames.TokenArray)
    renamed.default = Vt.TokenArray(["jawOpen", "eyeBlink", "grin"])
    shot.Save()
    found = only(Path(shot.realPath), "Names")
    assert found.where == f"{shot.realPath} </bert/FaceSolve>"
    assert found.message.startswith("1 shapes are on no mesh: smile")


def test_a_mesh_below_a_group_without_a_type_does_not_move(tmp_path: Path) -> None:
    path = write(tmp_path)

    def regroup(layer: Sdf.Layer) -> None:
        group = Sdf.PrimSpec(layer.GetPrimAtPath("/Hero"), "more", Sdf.SpecifierDef)
        Sdf.CopySpec(layer, "/Hero/geo/skin", layer, group.path.AppendChild("skin"))

    change(tmp_path / "rig.usda", regroup)
    found = only(path, "Names")
    assert (found.severity, found.where.split()[-1]) == ("error", "</Hero/more/skin>")
    assert "as </Hero/more> above it has no type; make that prim an Xform" in found.message


def test_an_animation_that_nobody_follows_is_orphaned(tmp_path: Path) -> None:
    path = write(tmp_path)

    def unfollow(layer: Sdf.Layer) -> None:
        for prim in list(layer.GetPrimAtPath("/Hero").nameChildren):
            if prim.name != "FaceSolve":
                del layer.GetPrimAtPath("/Hero").nameChildren[prim.name]

    change(weights_path(path), unfollow)
    found = only(path, "Names")
    assert (found.severity, "no skeleton follows" in found.message) == ("warning", True)


def test_a_deactivated_animation_is_an_error_and_not_read(tmp_path: Path) -> None:
    """In the shot the face rests; reviewed, it would move."""
    path = write(tmp_path)
    shot = Usd.Stage.CreateNew(str(tmp_path / "shot.usda"))
    shot.GetRootLayer().subLayerPaths = [path.name]
    shot.OverridePrim(PRIM).SetActive(False)
    shot.Save()
    found = only(tmp_path / "shot.usda", "Targets")
    assert (found.severity, "is not active" in found.message) == ("error", True)
    with pytest.raises(InputError, match="no active SkelAnimation"):
        PerformanceReader(tmp_path / "shot.usda")


def test_an_animation_of_the_rig_that_a_solve_replaces_is_no_orphan(tmp_path: Path) -> None:
    path = write(tmp_path)

    def pose(layer: Sdf.Layer) -> None:
        anim = Sdf.PrimSpec(layer.GetPrimAtPath("/Hero"), "Rest", Sdf.SpecifierDef, "SkelAnimation")
        names = Sdf.AttributeSpec(anim, "blendShapes", Sdf.ValueTypeNames.TokenArray)
        names.default = Vt.TokenArray(NAMES)
        values = Sdf.AttributeSpec(anim, "blendShapeWeights", Sdf.ValueTypeNames.FloatArray)
        values.default = Vt.FloatArray(len(NAMES))

    change(tmp_path / "rig.usda", pose)
    assert not [each for each in validate(path) if "usdface:" in each.check]


def test_an_instanceable_rig_in_a_shot_is_explained(tmp_path: Path) -> None:
    path = write(tmp_path)
    stage = Usd.Stage.CreateNew(str(tmp_path / "shot.usda"))
    hero = stage.DefinePrim("/Hero")
    hero.GetReferences().AddReference("./rig.usda", "/Hero")
    hero.SetInstanceable(True)
    layer = stage.GetRootLayer()
    layer.subLayerPaths.append(f"./{weights_path(path).name}")
    layer.timeCodesPerSecond = layer.framesPerSecond = 120
    layer.startTimeCode, layer.endTimeCode = 1, FRAMES
    stage.Save()
    found = only(tmp_path / "shot.usda", "Instances")
    assert found.where.endswith("</Hero>")
    assert f"ignores what {weights_path(path).name} says below it" in found.message
    assert "instanceable = false" in found.message
    hero.SetInstanceable(False)
    stage.Save()
    assert not [each for each in validate(tmp_path / "shot.usda") if "usdface:" in each.check]


def curves(**edits: tuple[slice, object]) -> np.ndarray:
    weights = WEIGHTS.copy()
    for name, (part, value) in edits.items():
        weights[part, NAMES.index(name)] = value
    return weights


@pytest.mark.parametrize(
    ("weights", "told"),
    [
        (curves(jawOpen=(slice(50, 60), 1.2)), "jawOpen is 1.20, its range is 0 to 1"),
        (curves(jawOpen=(slice(700, 701), 1.0)), "time code 70[12]: jawOpen jumps by"),
        (curves(eyeBlink=(slice(None), 1.0)), "1 shape without any motion: eyeBlink"),
        (
            np.concatenate([WEIGHTS[:300], np.tile(WEIGHTS[300], (100, 1)), WEIGHTS[300:]]),
            "time codes 301 to 401: the face is frozen for 0.8 s",
        ),
        (
            curves(jawOpen=(slice(300, 600), 0.37)),
            "time codes 301 to 600: jawOpen stays at 0.37 for 2.5 s while the face moves",
        ),
    ],
    ids=["range", "jump", "dead", "frozen", "stuck"],
)
def test_curves_that_no_face_makes_are_named(
    tmp_path: Path, weights: np.ndarray, told: str
) -> None:
    path = write(tmp_path, weights)
    findings = [each for each in validate(path) if each.check == "usdface:Curves"]
    assert any(re.search(told, each.message) for each in findings), findings
    assert {each.severity for each in findings} == {"warning"}


def test_curves_between_captured_frames_are_one_finding(tmp_path: Path) -> None:
    held = np.concatenate([WEIGHTS[:300], np.tile(WEIGHTS[300], (400, 1)), WEIGHTS[300:]])
    held[500:600, NAMES.index("smile")] += 0.1  # another shape moves
    path = write(tmp_path, held)
    assert {each.check for each in validate(path)} >= {"usdface:Curves"}
    change(
        weights_path(path),
        lambda layer: author_gaps(layer.GetPrimAtPath(PRIM), [(301, 701)]),
    )
    assert "nothing was captured in frames 301-701" in " ".join(
        each.message for each in validate(path)
    )
    assert not [each for each in validate(path) if each.check == "usdface:Curves"]


def test_in_a_shot_each_character_has_its_own_ranges(tmp_path: Path) -> None:
    shot = Sdf.Layer.CreateNew(str(tmp_path / "shot.usda"))
    shot.timeCodesPerSecond = shot.framesPerSecond = 120
    shot.startTimeCode, shot.endTimeCode = 1, FRAMES
    for name, top in (("wide", 1.4), ("narrow", 0.9)):
        (tmp_path / name).mkdir()
        path = write(tmp_path / name, WEIGHTS * [top / 0.9, 1.0, 1.0])
        rig = Sdf.Layer.FindOrOpen(str(tmp_path / name / "rig.usda"))
        smile = rig.GetAttributeAtPath("/Hero/geo/skin/smile.face:range")
        smile.default = (0.0, top)
        rig.Save()
        define_reference_prim(shot, Sdf.Path(f"/{name}"), f"./{name}/{path.name}", "/Hero")
    shot.Save()
    assert not [each for each in validate(tmp_path / "shot.usda") if "its range" in each.message]


def test_a_shape_held_at_an_end_of_its_range_is_not_stuck(tmp_path: Path) -> None:
    path = write(tmp_path, curves(jawOpen=(slice(300, 600), 0.0), eyeBlink=(slice(0, 300), 1.0)))
    assert not [each for each in validate(path) if "stays at" in each.message]


@pytest.mark.parametrize(("shape", "value"), [("jawOpen", 0.0), ("jawOpen", 0.001), ("smile", 0.0)])
def test_a_shape_that_no_reference_keyed_is_no_finding(
    tmp_path: Path, shape: str, value: float
) -> None:
    """What comes out of a mapping for it is 0, or as good as 0, also inside a range around 0."""
    assert small_rig().ranges[small_rig().shapes.index("smile"), 0] < 0
    path = write(tmp_path, curves(**{shape: (slice(None), value)}))
    assert not [each for each in validate(path) if each.check == "usdface:Curves"]


@pytest.mark.parametrize(
    ("sample", "told"), [([0.5], "1 weights for 3 shapes"), ([0.5, float("nan"), 0], "not finite")]
)
def test_a_weights_layer_alone_is_looked_at_too(
    tmp_path: Path, sample: list[float], told: str
) -> None:
    layer = weights_path(write(tmp_path))
    assert validate(layer) == []
    change(layer, lambda each: each.SetTimeSample(ATTRIBUTE, 700, Vt.FloatArray(sample)))
    assert told in only(layer, "Weights").message


def test_curves_of_a_layer_alone_are_held_to_no_range_but_to_motion(tmp_path: Path) -> None:
    layer = weights_path(write(tmp_path, curves(smile=(slice(300, 600), 1.3))))
    told = [each.message for each in validate(layer) if each.check == "usdface:Curves"]
    assert len(told) == 1
    assert "smile jumps" in told[0]


def test_a_range_that_the_rig_states_is_the_range(tmp_path: Path) -> None:
    path = write(tmp_path, curves(smile=(slice(50, 200), WEIGHTS[50:200, 0] - 0.5)))
    assert not [each for each in validate(path) if "range" in each.message]  # smile: -0.5 to 1.5


def sided(folder: Path, *, flipped: str = "", sides: tuple[str, str] = ("Left", "Right")) -> Path:
    """A performance over a rig whose shapes have sides, one of them perhaps the wrong way round."""
    rig = small_rig()
    skin = rig.meshes[0]
    half = skin.points[:, 0] > skin.points[:, 0].mean()
    shapes = []
    for name in ("brow", "cheek", "mouth", "nose"):
        for side, part in zip(sides, (half, ~half), strict=True):
            moved = np.flatnonzero(~part if name == flipped else part)
            shapes.append(
                MeshShape(f"{name}{side}", (ShapeKey(1.0, moved, np.ones((len(moved), 3))),))
            )
    names = tuple(shape.name for shape in shapes)
    rig = replace(
        rig,
        shapes=names,
        meshes=(replace(skin, shapes=tuple(shapes)),),
        ranges=np.tile([0.0, 1.0], (len(names), 1)),
    )
    write_rig(folder / "sided.usda", rig)
    return folder / "sided.usda"


@pytest.mark.parametrize("sides", [("Left", "Right"), ("_l_01", "_r_01"), ("L", "R")])
def test_a_pair_of_shapes_with_sides_exchanged_stands_out_from_the_others(
    tmp_path: Path, sides: tuple[str, str]
) -> None:
    assert not [f for f in validate(sided(tmp_path, sides=sides)) if f.check == "usdface:Sides"]
    (tmp_path / "b").mkdir()
    found = only(sided(tmp_path / "b", flipped="cheek", sides=sides), "Sides")
    assert found.message.startswith(
        f"cheek{sides[0]}: left and right are exchanged, compared with the"
    )
    assert "3 pairs" in found.message


def test_names_without_a_target_have_no_side(tmp_path: Path) -> None:
    stage = Usd.Stage.Open(str(sided(tmp_path)))
    for prim in stage.Traverse():
        if targets := prim.GetRelationship("skel:blendShapeTargets"):
            targets.SetTargets(targets.GetTargets()[:1])
    stage.Save()
    assert not [each for each in validate(tmp_path / "sided.usda") if "usdface:" in each.check]


def test_sides_that_exchange_their_weights_at_a_frame_are_named(tmp_path: Path) -> None:
    rig = read_rig(sided(tmp_path))
    weights = np.tile(0.4 + 0.3 * np.sin(SECONDS)[:240, None], (1, 8))
    weights[:, ::2] *= 0.2
    weights[100:110] = weights[100:110].reshape(10, 4, 2)[:, :, ::-1].reshape(10, 8)
    path = tmp_path / "a.usda"
    with writing_performance(
        path,
        make_header(
            rig,
            shape_names=rig.shapes,
            rate=Fraction(24),
            first_frame=1,
            last_frame=240,
        ),
        rig,
    ) as writer:
        writer.append(weights)
    messages = [each.message for each in validate(path)]
    assert any(
        "time code 101: left and right shapes exchange their weights (2 times in all)" in message
        for message in messages
    )


def test_a_rate_that_is_not_authored_is_an_error(tmp_path: Path) -> None:
    path = write(tmp_path)
    change(path, lambda layer: layer.ClearTimeCodesPerSecond())
    assert "timeCodesPerSecond is not authored" in only(path, "Timing").message


def test_layers_of_different_rates_are_named(tmp_path: Path) -> None:
    path = write(tmp_path)

    def film(layer: Sdf.Layer) -> None:
        layer.timeCodesPerSecond = layer.framesPerSecond = 24

    change(path, film)
    messages = [each.message for each in validate(path) if each.check == "usdface:Timing"]
    assert any("has 120 time codes per second, shot.hero.usda 24" in each for each in messages)
    assert any("lie between time codes" in each for each in messages)


def test_samples_outside_the_range_are_named(tmp_path: Path) -> None:
    path = write(tmp_path)
    change(path, lambda layer: setattr(layer, "endTimeCode", 100))
    message = only(path, "Timing").message
    assert "samples from 1 to 1400 lie outside the stage's range, 1 to 100" in message
    assert "author startTimeCode 1 and endTimeCode 1400, and cut in a layer above" in message


@pytest.mark.parametrize(("offset", "first", "last"), [(0, 200, 400), (1000, 1200, 3000)])
def test_a_cut_of_a_performance_has_samples_on_both_sides_and_not_elsewhere(
    tmp_path: Path, offset: int, first: int, last: int
) -> None:
    performance = Sdf.Layer.FindOrOpen(str(write(tmp_path)))
    cut = Sdf.Layer.CreateNew(str(tmp_path / "cut.usda"))
    cut.TransferContent(performance)
    cut.customLayerData = {}
    cut.rootPrims.clear()
    cut.expressionVariables, cut.subLayerPaths = {"SHOT": "shot"}, ['`"./${SHOT}.hero.usda"`']
    cut.subLayerOffsets[0] = Sdf.LayerOffset(offset)
    cut.startTimeCode, cut.endTimeCode = first, last
    cut.Save()
    assert validate(tmp_path / "cut.usda") == []
    cut.startTimeCode, cut.endTimeCode = 4000, 5000
    cut.Save()
    assert (
        "move them into the range by a layer offset" in only(Path(cut.realPath), "Timing").message
    )
    cut.expressionVariables = {}
    cut.Save()
    with pytest.raises(InputError, match=r"sublayer .*SHOT.* cannot be read"):
        validate(tmp_path / "cut.usda")


def test_a_material_that_the_reference_to_the_rig_does_not_bring_is_named(tmp_path: Path) -> None:
    path = write(tmp_path)
    rig = Usd.Stage.Open(str(tmp_path / "rig.usda"))
    inside = UsdShade.Material.Define(rig, "/Hero/Looks/teeth")
    for name, material in (
        ("skin", UsdShade.Material.Define(rig, "/Looks/skin")),
        ("teeth", inside),
    ):
        mesh = rig.GetPrimAtPath(f"/Hero/geo/{name}")
        UsdShade.MaterialBindingAPI.Apply(mesh).Bind(material)
    rig.Save()
    found = only(path, "Targets")
    assert found.severity == "warning"
    assert found.where.endswith("</Hero/geo/skin.material:binding>")
    wanted = "rig.usda targets </Looks/skin>, which lies outside </Hero>"
    assert wanted in found.message
    (note,) = performance_notes(path)
    assert wanted in note
    assert not [each for each in validate(tmp_path / "rig.usda") if "Targets" in each.check]
    rebound = Sdf.Layer.FindOrOpen(str(path))
    over = Sdf.CreatePrimInLayer(rebound, "/Hero/geo/skin")
    binding = Sdf.RelationshipSpec(over, "material:binding", False)
    binding.targetPathList.explicitItems = ["/Hero/Looks/teeth"]
    rebound.Save()
    assert validate(path) == []


def test_missing_provenance_is_named(tmp_path: Path) -> None:
    path = write(tmp_path)
    change(weights_path(path), lambda layer: setattr(layer, "customLayerData", {}))
    assert "nobody can make it again" in only(path, "Provenance").message


def test_an_absolute_path_is_named(tmp_path: Path) -> None:
    path = write(tmp_path)

    def absolute(layer: Sdf.Layer) -> None:
        layer.subLayerPaths.append(str(weights_path(path)))

    change(path, absolute)
    assert "by an absolute path" in only(path, "AbsolutePaths").message


def test_a_rig_that_was_moved_is_named(tmp_path: Path) -> None:
    path = write(tmp_path)
    (tmp_path / "rig.usda").rename(tmp_path / "moved.usda")
    assert "./rig.usda, which cannot be opened: was it moved?" in only(path, "MissingFiles").message


def test_edits_that_find_no_shape_are_named(tmp_path: Path) -> None:
    path = write(tmp_path)

    def edit(layer: Sdf.Layer) -> None:
        prim = Sdf.CreatePrimInLayer(layer, PRIM)
        Sdf.AttributeSpec(prim, "face:edit:jaw", Sdf.ValueTypeNames.Float).default = 0.2

    change(path, edit)
    assert "edits of jaw find no such shape" in only(path, "Edits").message


def test_other_tools_find_our_validators_through_the_plugin_path(tmp_path: Path) -> None:
    path = write(tmp_path, curves(jawOpen=(slice(50, 60), 1.2)))
    script = f"""
from pxr import Usd, UsdValidation
registry = UsdValidation.ValidationRegistry()
ours = registry.GetValidatorMetadataForKeyword("usdface")
assert len(ours) == 11, [each.name for each in ours]
assert all(each.doc for each in ours)
context = UsdValidation.ValidationContext(registry.GetOrLoadAllValidators())
for error in context.Validate(Usd.Stage.Open({str(path)!r})):
    print(error.GetErrorAsString())
"""
    folders = os.pathsep.join(map(str, plugin_folders()))
    done = subprocess.run(
        [sys.executable, "-c", script],
        env=os.environ | {"PXR_PLUGINPATH_NAME": folders},
        capture_output=True,
        text=True,
        check=True,
    )
    assert "jawOpen is 1.20, its range is 0 to 1" in done.stdout
