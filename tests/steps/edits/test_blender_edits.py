"""Curves that were changed in Blender come back as edits and as tuned pairs.

The layers here say what Blender 5.0's exporter was seen to write: a channel for every mesh that
has a shape, numbered; identifiers for names; an animation per mesh where there is no armature.
"""

from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
from pxr import Sdf, Usd, UsdGeom, UsdSkel, Vt

from tests.usdio.references.test_references import small_references, write
from tests.usdio.small_rig import small_rig
from usdface.core.errors import InputError
from usdface.runner.execute import execute
from usdface.runner.result import StepResult
from usdface.specs.edits import EditsImportSpec, EditSpec
from usdface.specs.references import ReferencesImportSpec
from usdface.steps.inputs.source_motion import read_source_motion
from usdface.steps.inputs.weight_tables import read_weight_table
from usdface.usdio.performance.exported_weights import blender_names
from usdface.usdio.performance.read import PerformanceReader
from usdface.usdio.performance.weights_layer import append_rig_shapes, make_header
from usdface.usdio.performance.write import writing_performance
from usdface.usdio.references.read import read_references
from usdface.usdio.rig.read import channels_per_mesh, read_rig
from usdface.usdio.rig.write import write_rig

FIRST, LAST = 101, 110
SOLVED = np.random.default_rng(0).uniform(0.2, 0.8, (10, 3)).astype(np.float32)
SKIN, TEETH = ("jawOpen", "eyeBlink", "smile"), ("jawOpen",)


def perform(folder: Path, names: tuple[str, ...] = SKIN) -> Path:
    write_rig(folder / "rig.usda", small_rig())
    path = folder / "shot.hero.usda"
    with writing_performance(
        path,
        make_header(
            read_rig(folder / "rig.usda"),
            shape_names=append_rig_shapes(names, read_rig(folder / "rig.usda")),
            rate=Fraction(24),
            first_frame=FIRST,
            last_frame=LAST,
        ),
        read_rig(folder / "rig.usda"),
    ) as writer:
        writer.append(SOLVED[:, : len(names)])
    return path


def exported(
    folder: Path,
    meshes: dict[str, dict[str, np.ndarray]],
    *,
    armature: bool = True,
    faces: str = "Hero",
    documentation: str = "Blender v5.0.1",
    channel: str = "",
) -> Path:
    """A file as Blender writes it: curves by the shape key's name, by mesh.

    As Maya writes it with `channel`: ``_{mesh}_Deformer_{shape}``.
    """

    def made_of(key: str) -> str:
        return blender_names(key)[documentation < "Blender v5"]

    path = folder / "back.usda"
    stage = Usd.Stage.CreateNew(str(path))
    stage.GetRootLayer().documentation = documentation
    stage.SetTimeCodesPerSecond(24)
    above = f"/root/{faces}" if faces else "/root"
    curves: dict[str, dict[str, np.ndarray]] = {}
    used: set[str] = set()
    for mesh, keys in meshes.items():
        prim = stage.DefinePrim(f"{above}/{mesh}/{mesh}", "Mesh")
        binding = UsdSkel.BindingAPI.Apply(prim)
        place = f"{above}/skel/skel" if armature else f"{above}/{mesh}/Skel"
        skeleton = UsdSkel.Skeleton.Define(stage, place)
        binding.CreateSkeletonRel().SetTargets([skeleton.GetPath()])
        channels = []
        for key, curve in keys.items():
            shape = UsdSkel.BlendShape.Define(stage, f"{prim.GetPath()}/{made_of(key)}")
            binding.CreateBlendShapeTargetsRel().AddTarget(shape.GetPath())
            name, number = made_of(key), 1
            if channel:
                name = channel.format(mesh=mesh, shape=name)
            while armature and name in used:
                number += 1
                name = f"{made_of(key)}{number}"
            used.add(name)
            channels.append(name)
            curves.setdefault(place, {})[name] = curve
        binding.CreateBlendShapesAttr(channels)
    for place, by_name in curves.items():
        animation = UsdSkel.Animation.Define(stage, f"{place}/Action")
        animation.CreateBlendShapesAttr(list(by_name))
        rows = np.stack(list(by_name.values()), axis=1)
        for frame, row in enumerate(rows, start=FIRST):
            animation.CreateBlendShapeWeightsAttr().Set(Vt.FloatArray.FromNumpy(row), frame)
        skeleton = UsdSkel.BindingAPI.Apply(stage.GetPrimAtPath(place))
        skeleton.CreateAnimationSourceRel().SetTargets([Sdf.Path(f"{place}/Action")])
    stage.GetRootLayer().Save()
    return path


def curves_of(shown: np.ndarray = SOLVED) -> dict[str, dict[str, np.ndarray]]:
    """Teeth first, as Blender follows names: the skin's jaw is `jawOpen2` then."""
    by_name = dict(zip(SKIN, shown.astype(np.float32).T, strict=True))
    return {
        "teeth": {name: by_name[name].copy() for name in TEETH},
        "skin": {name: by_name[name].copy() for name in SKIN},
    }


def bring_back(path: Path, changed: Path) -> StepResult:
    return execute(EditsImportSpec(performance=path, changed=changed), overwrite=True)


def shown(path: Path) -> np.ndarray:
    return PerformanceReader(path).edited()


@pytest.mark.parametrize("armature", [True, False], ids=["armature", "no armature"])
def test_a_key_changed_on_the_face_alone_becomes_an_edit(tmp_path: Path, armature: bool) -> None:
    path = perform(tmp_path)
    meshes = curves_of()
    meshes["skin"]["jawOpen"][3:5] += np.float32(0.1)
    report = bring_back(path, exported(tmp_path, meshes, armature=armature))
    assert report.summary == "2 of 10 frames differ from the performance, in 1 shape: jawOpen"
    assert report.notes == ()
    wanted = SOLVED.copy()
    wanted[3:5, 0] += np.float32(0.1)
    np.testing.assert_allclose(shown(path), wanted, atol=1e-6)


def test_an_export_of_the_same_scene_is_imported_again_and_again(tmp_path: Path) -> None:
    """Its other meshes show what was given, which edits have left behind since."""
    path = perform(tmp_path)
    for change in (0.1, 0.1, -0.05):
        meshes = curves_of()
        meshes["skin"]["jawOpen"][3:5] += np.float32(change)
        assert bring_back(path, exported(tmp_path, meshes)).notes == ()
        wanted = SOLVED.copy()
        wanted[3:5, 0] += np.float32(change)
        np.testing.assert_allclose(shown(path), wanted, atol=1e-6)
        (tmp_path / "back.usda").unlink()


def test_keys_between_frames_that_are_left_out_are_told(tmp_path: Path) -> None:
    path = perform(tmp_path)
    changed = exported(tmp_path, curves_of())
    stage = Usd.Stage.Open(str(changed))
    (animation,) = (each for each in stage.TraverseAll() if each.IsA(UsdSkel.Animation))
    weights = UsdSkel.Animation(animation).GetBlendShapeWeightsAttr()
    weights.Set(Vt.FloatArray([1.0] * len(weights.Get(FIRST))), FIRST + 2.5)
    stage.Save()
    report = bring_back(path, changed)
    assert report.summary == "nothing differs from the performance; its edits do not change"
    assert report.notes[0].startswith(f"1 sample of {changed.name} between frames left out")


def test_an_edit_that_was_taken_back_on_the_face_is_gone(tmp_path: Path) -> None:
    path = perform(tmp_path)
    execute(EditSpec(performance=path, shape=("jawOpen",), add=0.1, frames="103-105"))
    meshes = curves_of(shown(path))
    meshes["skin"]["jawOpen"][:] = SOLVED[:, 0]
    bring_back(path, exported(tmp_path, meshes))
    np.testing.assert_allclose(shown(path), SOLVED, atol=1e-6)


def test_an_untouched_export_changes_no_edit(tmp_path: Path) -> None:
    """Overrides and masks stay what they are, so that they mean the same after the next map."""
    path = perform(tmp_path)
    shape = ("jawOpen",)
    execute(EditSpec(performance=path, shape=shape, override=0.7, frames="103-105", fade=2))
    execute(EditSpec(performance=path, shape=shape, add=0.1, frames="107-108"), overwrite=True)
    edits = path.with_name(f"{path.stem}.edits.usda")
    before, now = edits.read_bytes(), shown(path)
    report = bring_back(path, exported(tmp_path, curves_of(now)))
    assert report.outputs == ()
    assert edits.read_bytes() == before
    (tmp_path / "back.usda").unlink()
    meshes = curves_of(now)
    meshes["skin"]["jawOpen"][7] += np.float32(0.1)  # frame 107: where nothing is overridden
    bring_back(path, exported(tmp_path, meshes))
    text = edits.read_text()
    assert "face:override:jawOpen" in text
    assert "face:mask:jawOpen" in text
    wanted = now.copy()
    wanted[7, 0] += np.float32(0.1)
    np.testing.assert_allclose(shown(path), wanted, atol=1e-6)


def test_a_change_on_a_mesh_that_does_not_count_is_said(tmp_path: Path) -> None:
    path = perform(tmp_path)
    meshes = curves_of()
    meshes["teeth"]["jawOpen"][3] -= np.float32(0.15)
    report = bring_back(path, exported(tmp_path, meshes))
    assert report.summary == "nothing differs from the performance; its edits do not change"
    assert report.notes == (
        "jawOpen differs between teeth and skin; the latter is read, as it has the most shapes; "
        "change it there",
    )


def test_tuned_weights_are_those_of_the_face(tmp_path: Path) -> None:
    path = write(tmp_path, small_references(tmp_path, seed=1))  # frames 100, 107, 114, ...
    meshes = curves_of()
    meshes["skin"]["jawOpen"][107 - FIRST] = 0.95
    back = exported(tmp_path, meshes)
    execute(ReferencesImportSpec(references=path, weights=back))
    references = read_references(path)
    assert references.tuned.tolist() == [False, True, False, False, False]
    weights = dict(zip(references.shape_names, references.weights[1], strict=True))
    row = dict(zip(SKIN, SOLVED[107 - FIRST], strict=True))
    assert weights == pytest.approx(row | {"jawOpen": 0.95})


def test_what_blender_cut_to_its_sliders_is_not_a_change(tmp_path: Path) -> None:
    path = perform(tmp_path)
    execute(EditSpec(performance=path, shape=("jawOpen",), override=1.6, frames="103-105"))
    execute(EditSpec(performance=path, shape=("smile",), override=-0.4, frames="103-105"))
    before = shown(path)
    meshes = curves_of(np.clip(before, 0, 1))
    meshes["skin"]["eyeBlink"][0] += np.float32(0.1)
    bring_back(path, exported(tmp_path, meshes))
    before[0, 1] += np.float32(0.1)
    np.testing.assert_allclose(shown(path), before, atol=1e-6)


def test_what_blender_makes_of_names() -> None:
    assert blender_names("Küche") == ("Küche", "K__che")
    assert blender_names("CTRL:jaw open") == ("CTRL_jaw_open", "CTRL_jaw_open")
    assert blender_names("1jaw") == ("_1jaw", "_1jaw")


@pytest.mark.parametrize("version", ["Blender v5.0.1", "Blender v4.5.15 LTS"])
def test_names_that_became_identifiers_are_found_again(tmp_path: Path, version: str) -> None:
    names = ("CTRL:jaw open", "2.blink", "Lächeln")
    path = perform(tmp_path, names)
    curves = dict(zip(names, SOLVED.T.copy(), strict=True))
    curves["CTRL:jaw open"][0] += np.float32(0.1)
    report = bring_back(path, exported(tmp_path, {"skin": curves}, documentation=version))
    assert report.figures == {"frames": 1, "shapes": ["CTRL:jaw open"]}
    assert report.notes == ()


def test_two_names_that_become_one_identifier_are_not_guessed(tmp_path: Path) -> None:
    known = ("jaw open", "jaw:open", "smile")
    changed = exported(tmp_path, {"skin": dict(zip(known, SOLVED.T, strict=True))})
    assert "jaw_open" in read_weight_table(changed, known=known).names


def test_faces_beside_each_other_are_refused(tmp_path: Path) -> None:
    path = perform(tmp_path)
    changed = exported(tmp_path, curves_of(), armature=False, faces="")
    with pytest.raises(InputError, match=r"2 animations .* export one face at a time"):
        bring_back(path, changed)


def test_channels_of_other_tools_keep_their_names(tmp_path: Path) -> None:
    changed = exported(tmp_path, curves_of(), documentation="")
    assert read_weight_table(changed).names == ("jawOpen", "jawOpen2", "eyeBlink", "smile")


MAYA = {"documentation": "", "channel": "_{mesh}_Deformer_{shape}"}


def test_channels_that_maya_named_come_back_by_the_shapes_they_drive(tmp_path: Path) -> None:
    path = perform(tmp_path)
    curves = curves_of()
    for mesh in curves.values():
        mesh["jawOpen"][3] = 1.25  # Maya cuts nothing
    report = bring_back(path, exported(tmp_path, curves, **MAYA))
    assert report.figures == {"frames": 1, "shapes": ["jawOpen"]}
    reader = PerformanceReader(path)
    expected = SOLVED.copy()
    expected[3, 0] = 1.25
    np.testing.assert_allclose(reader.edited(), expected, atol=1e-6)


def test_a_shape_that_maya_exported_per_mesh_is_one_source(tmp_path: Path) -> None:
    """By name, `_skin_Deformer_jawOpen` and `_teeth_Deformer_jawOpen` could be either of two."""
    changed = exported(tmp_path, curves_of(), **MAYA)
    motion = read_source_motion(changed, (FIRST + 2, FIRST + 4))
    assert set(motion.names) == set(SKIN)
    columns = [motion.names.index(name) for name in SKIN]
    np.testing.assert_allclose(motion.weights[:, columns], SOLVED[2:5], atol=1e-7)
    assert (motion.first_frame, motion.rate) == (FIRST + 2, 24)
    given = read_weight_table(changed, known=("JawOpen", "Smile"))
    np.testing.assert_allclose(given.columns(SKIN), SOLVED, atol=1e-7)


def test_a_rig_that_maya_exported_moves_a_shape_on_every_mesh(tmp_path: Path) -> None:
    """Its skin's and teeth's `jawOpen` are two channels of one shape."""
    write_rig(tmp_path / "rig.usda", small_rig())
    stage = Usd.Stage.Open(str(tmp_path / "rig.usda"))
    for mesh in ("skin", "teeth"):
        binding = UsdSkel.BindingAPI(stage.GetPrimAtPath(f"/Hero/geo/{mesh}"))
        names = [each.name for each in binding.GetBlendShapeTargetsRel().GetTargets()]
        binding.GetBlendShapesAttr().Set([f"_{mesh}_Deformer_{name}" for name in names])
    stage.Save()
    rig = read_rig(tmp_path / "rig.usda")
    assert rig.shapes == tuple(f"_skin_Deformer_{name}" for name in SKIN)
    path = tmp_path / "shot.hero.usda"
    header = make_header(rig, shape_names=rig.shapes, rate=Fraction(24), first_frame=FIRST,
                         last_frame=LAST)  # fmt: skip
    with writing_performance(path, header, rig) as writer:
        writer.append(SOLVED)
    reader = PerformanceReader(path)
    assert reader.names[-1] == "_teeth_Deformer_jawOpen"
    np.testing.assert_array_equal(reader.edited()[:, -1], SOLVED[:, 0])
    assert set(read_source_motion(path).names) == set(SKIN)
    given = read_weight_table(path, known=rig.shapes)
    np.testing.assert_array_equal(given.columns(rig.shapes).astype(np.float32), SOLVED)
    curves = curves_of()
    for mesh in curves.values():
        mesh["jawOpen"][3] = 0.9
    assert bring_back(path, exported(tmp_path, curves, **MAYA)).figures["frames"] == 1


def test_targets_that_are_named_after_their_mesh_are_one_shape() -> None:
    stage, bindings = Usd.Stage.CreateInMemory(), []
    for mesh in ("head_GEO", "teeth_GEO"):
        binding = UsdSkel.BindingAPI.Apply(UsdGeom.Mesh.Define(stage, f"/{mesh}").GetPrim())
        binding.CreateBlendShapesAttr([f"{mesh}.jawOpen"])
        binding.CreateBlendShapeTargetsRel().SetTargets([f"/{mesh}/{mesh}_jawOpen"])
        bindings.append(binding)
    channels = ["head_GEO.jawOpen", "teeth_GEO.jawOpen"]
    assert channels_per_mesh(bindings) == {"jawOpen": channels}


def test_channels_of_a_single_mesh_keep_their_names(tmp_path: Path) -> None:
    changed = exported(tmp_path, {"skin": curves_of()["skin"]}, **MAYA)
    assert read_source_motion(changed).names[0] == "_skin_Deformer_jawOpen"


def maya_reads(animation: Usd.Prim, mesh: Usd.Prim) -> dict[str, np.ndarray]:
    """What maya-usd's translatorBlendShape does: shapes that it has, paired by order."""
    skel = UsdSkel.Animation(animation)
    names = list(map(str, skel.GetBlendShapesAttr().Get()))
    shapes = list(map(str, UsdSkel.BindingAPI(mesh).GetBlendShapesAttr().Get()))
    columns = [names.index(each) for each in shapes if each in names]
    frames = skel.GetBlendShapeWeightsAttr().GetTimeSamples()
    rows = np.array([skel.GetBlendShapeWeightsAttr().Get(frame) for frame in frames])
    return {shapes[place]: rows[:, column] for place, column in enumerate(columns)}


def test_an_importer_that_pairs_by_order_gets_every_shape_right(tmp_path: Path) -> None:
    """A mapping of two of the rig's three shapes: the first of the mesh is not among them."""
    path = perform(tmp_path, ("eyeBlink", "smile"))
    stage = Usd.Stage.Open(str(path))
    skin = stage.GetPrimAtPath("/Hero/geo/skin")
    reader = PerformanceReader(path)
    found = maya_reads(reader.animation, skin)
    assert set(found) == set(SKIN)
    np.testing.assert_allclose(found["eyeBlink"], SOLVED[:, 0])
    np.testing.assert_allclose(found["smile"], SOLVED[:, 1])
    assert not found["jawOpen"].any()
