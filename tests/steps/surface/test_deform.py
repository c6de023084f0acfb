"""A scan without a rig: bound, moved, given shapes, and sent down the pipeline."""

import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from pxr import Sdf, Usd, UsdGeom, UsdSkel

from tests.model.placement.conftest import search_from_few_starts
from tests.model.surface.mouth import make_mouth
from tests.small_scan import (
    FIRST,
    FRAMES,
    Scan,
    landmarks,
    small_scan,
    small_scan_take,
    write_scan,
)
from tests.usdio.small_rig import small_rig
from usdface.core.errors import InputError
from usdface.core.provenance import Provenance
from usdface.core.sidecars import corrected_path
from usdface.model.surface.distance import surface_distances
from usdface.numerics.registration.marker_binding import MarkerBinding
from usdface.numerics.surface.surface_places import places_at_points
from usdface.runner.execute import execute
from usdface.runner.result import StepResult
from usdface.specs.base import Spec
from usdface.specs.references import SelectSpec
from usdface.specs.surface import BindSpec, DeformSpec, MakeShapesSpec
from usdface.steps.surface import picture, plan
from usdface.usdio.authoring import define_reference_prim
from usdface.usdio.rig.mesh import read_face_mesh
from usdface.usdio.rig.read import read_rig
from usdface.usdio.rig.write import write_rig
from usdface.usdio.surface.binding import read_binding
from usdface.usdio.take.write import write_take
from usdface.usdio.validation import validate


@pytest.fixture(scope="module")
def scan() -> Scan:
    return small_scan()


@pytest.fixture(scope="module")
def moved(tmp_path_factory: pytest.TempPathFactory, scan: Scan) -> Path:
    """A folder with a take, a scan in metres with Z up, its binding and what moves; read only."""
    made = tmp_path_factory.mktemp("scan")
    write_take(made / "talk.take.usda", small_scan_take(scan), provenance=Provenance())
    write_scan(made / "scan.usdc", scan, z_up=True)
    run(bind(made, scan))
    run(deform(made))
    return made


@pytest.fixture
def folder(moved: Path, tmp_path: Path) -> Path:
    """A copy that a test may change."""
    shutil.copytree(moved, tmp_path / "scan")
    return tmp_path / "scan"


def run(spec: Spec) -> StepResult:
    return execute(spec, overwrite=True)


def read_spread(folder: Path) -> np.ndarray:
    """Standard deviations in the middle of the take [mm]."""
    stage = Usd.Stage.Open(str(folder / "talk.scan.usda"))
    mesh = next(each for each in stage.Traverse() if each.HasAttribute("primvars:face:uncertainty"))
    return np.array(mesh.GetAttribute("primvars:face:uncertainty").Get(FIRST + 20))


def bind(folder: Path, scan: Scan, **more: object) -> BindSpec:
    return BindSpec(
        take=folder / "talk.take.usda",
        mesh=folder / "scan.usdc",
        out=folder / "scan.binding.usda",
        landmarks=landmarks(scan),
        **more,
    )


def deform(folder: Path, **more: object) -> DeformSpec:
    given: dict[str, object] = {
        "take": folder / "talk.take.usda",
        "mesh": folder / "scan.usdc",
        "binding": folder / "scan.binding.usda",
        "out": folder / "talk.scan.usda",
    }
    return DeformSpec(**(given | more))


def make_shapes(folder: Path, **more: object) -> MakeShapesSpec:
    given: dict[str, object] = {
        "take": folder / "talk.take.usda",
        "mesh": folder / "scan.usdc",
        "binding": folder / "scan.binding.usda",
        "out": folder / "scan.rig.usda",
    }
    return MakeShapesSpec(**(given | more))


@pytest.mark.parametrize("point", [pytest.param(50, marks=pytest.mark.slow), 310, -1])
def test_a_landmark_on_the_wrong_point_is_suspected(folder: Path, scan: Scan, point: int) -> None:
    right = bind(folder, scan)
    assert not any("landmarks" in note for note in run(right).notes)
    name = right.landmarks[0].partition("=")[0]
    wrong = (f"{name}={np.arange(len(scan.points))[point]}", *right.landmarks[1:])
    other = folder / "other.binding.usda"
    report = run(right.model_copy(update={"landmarks": wrong, "out": other}))
    assert any(f"{name} the farthest" in note for note in report.notes), report


def test_two_landmarks_exchanged_are_suspected(folder: Path, scan: Scan) -> None:
    right = bind(folder, scan)
    assert not any("landmarks are" in note for note in run(right).notes)
    names, points = zip(*(each.split("=") for each in right.landmarks), strict=True)
    order = [0, 4, 2, 3, 1]  # chin and brow
    wrong = tuple(f"{name}={points[i]}" for name, i in zip(names, order, strict=True))
    report = run(right.model_copy(update={"landmarks": wrong, "out": folder / "other.usda"}))
    assert any("the landmarks are" in note and "% of the face" in note for note in report.notes)


def points_at(path: Path, frame: float) -> np.ndarray:
    """The moving mesh in millimetres, Y up, as any USD reader finds it."""
    stage = Usd.Stage.Open(str(path))
    mesh = UsdGeom.Mesh(stage.GetPrimAtPath("/Scan/head"))
    local = np.array(mesh.GetPointsAttr().Get(frame), np.float64)
    matrix = np.array(UsdGeom.XformCache(frame).GetLocalToWorldTransform(mesh.GetPrim()))
    world = (local @ matrix[:3, :3] + matrix[3, :3]) * 1000
    return np.stack([world[:, 0], world[:, 2], -world[:, 1]], axis=1)


def open_frame() -> int:
    return FIRST + FRAMES // 2


def lips_apart(scan: Scan, points: np.ndarray) -> float:
    return float(np.linalg.norm(points[scan.upper] - points[scan.lower], axis=1).mean())


def test_markers_find_their_places_from_five_landmarks(folder: Path, scan: Scan) -> None:
    binding = binding_of(folder)
    face = read_face_mesh(folder / "scan.usdc")
    at = binding.places.positions(face.mesh.points)
    order = [scan.names.index(name) for name in binding.names]
    wrong = np.linalg.norm(at - face.mesh.points[scan.markers[order]], axis=1)
    assert np.median(wrong) < 1.5
    assert wrong.max() < 6.0


def test_more_landmarks_place_the_others_better(tmp_path: Path, scan: Scan) -> None:
    """On lips of the scan .4 mm apart, whose distance on the performer is noise."""
    write_scan(tmp_path / "scan.usdc", scan)
    write_take(
        tmp_path / "talk.take.usda", small_scan_take(scan, noise=0.5), provenance=Provenance()
    )
    lips = [name for name in scan.names if name.startswith("lip")]
    chosen = [f"{name}={scan.markers[scan.names.index(name)]}" for name in lips]
    spec = bind(tmp_path, scan)
    run(spec.model_copy(update={"landmarks": tuple({*spec.landmarks, *chosen})}))
    face, binding = read_face_mesh(tmp_path / "scan.usdc"), binding_of(tmp_path)
    order = [scan.names.index(name) for name in binding.names]
    away = binding.places.positions(face.mesh.points) - scan.points[scan.markers[order]]
    assert np.linalg.norm(away, axis=1).mean() < 1


def touching(scan: Scan) -> Scan:
    points = scan.points.copy()
    points[scan.lower] = points[scan.upper]
    return replace(scan, points=points)


def test_motion_tells_the_lips_apart_where_they_touch(tmp_path: Path, scan: Scan) -> None:
    closed = touching(scan)
    write_scan(tmp_path / "scan.usdc", closed)
    write_take(
        tmp_path / "talk.take.usda", small_scan_take(closed, noise=0.5), provenance=Provenance()
    )
    spec = bind(tmp_path, closed)
    skin = tuple(each for each in spec.landmarks if not each.startswith("lip"))
    run(spec.model_copy(update={"landmarks": skin}))
    binding, open_lips = binding_of(tmp_path), scan.moved(1)
    for name, point in zip(scan.names, scan.markers, strict=True):
        if name.startswith("lip"):
            place = binding.places.select([binding.names.index(name)])
            away = place.positions(open_lips)[0] - open_lips[point]
            assert np.linalg.norm(away) < 4, name  # the lips are 16 mm apart


@pytest.mark.parametrize("correct", [False, True])
def test_touching_lips_keep_the_markers_that_a_person_gave_them(
    tmp_path: Path, scan: Scan, correct: bool
) -> None:
    closed = touching(scan)
    write_scan(tmp_path / "scan.usdc", closed)
    write_take(tmp_path / "talk.take.usda", small_scan_take(closed), provenance=Provenance())
    lips = {
        name: int(scan.markers[scan.names.index(name)])
        for name in scan.names
        if name.startswith("lip")
    }
    spec = bind(tmp_path, closed)
    if correct:
        run(spec)
        layer = Sdf.Layer.FindOrOpen(str(corrected_path(tmp_path / "scan.binding.usda")))
        stage = Usd.Stage.Open(layer)
        for name, point in lips.items():
            over = stage.OverridePrim(f"/Binding/Markers/{name}")
            over.CreateAttribute("face:binding:point", Sdf.ValueTypeNames.Int).Set(point)
        layer.Save()
    else:
        given = {*spec.landmarks, *(f"{name}={point}" for name, point in lips.items())}
        spec = spec.model_copy(update={"landmarks": tuple(given)})
    run(spec)
    binding = binding_of(tmp_path)
    for name, point in lips.items():
        row = binding.names.index(name)
        assert binding.places.corners[row][binding.places.weights[row].argmax()] == point
    assert not any("at one place" in note for note in run(deform(tmp_path)).notes)
    run(deform(tmp_path, method="rbf", out=tmp_path / "rbf.usda"))


def binding_of(folder: Path) -> MarkerBinding:
    return read_binding(folder / "scan.binding.usda", read_face_mesh(folder / "scan.usdc")).binding


def test_the_mouth_opens_along_the_surface_and_not_through_the_air(
    folder: Path, scan: Scan
) -> None:
    blended = lips_apart(scan, points_at(folder / "talk.scan.usda", open_frame()))
    run(deform(folder, blend=0.0))
    euclidean = lips_apart(scan, points_at(folder / "talk.scan.usda", open_frame()))
    truth = lips_apart(scan, scan.moved(1.0))
    assert blended > 0.8 * truth
    assert euclidean < blended


def test_points_between_the_markers_follow_what_the_face_did(folder: Path, scan: Scan) -> None:
    """Against the surface that the markers were taken from, in whatever unit and turn it is."""
    report = run(deform(folder, reach=1000.0))
    rest, moved = (points_at(folder / "talk.scan.usda", f) for f in (FIRST, open_frame()))
    turn = np.array(
        [
            [np.cos(np.pi / 6), 0, np.sin(np.pi / 6)],
            [0, 1, 0],
            [-np.sin(np.pi / 6), 0, np.cos(np.pi / 6)],
        ]
    )
    acted = (scan.moved(1.0) - scan.points) @ turn.T
    error = np.sqrt(((moved - rest - acted) ** 2).sum(axis=1).mean())
    assert error < 0.25 * np.sqrt((acted**2).sum(axis=1).mean())
    assert report.figures["points"] == len(scan.points)


def test_the_moving_mesh_says_its_timing_and_passes_the_validators(folder: Path) -> None:
    stage = Usd.Stage.Open(str(folder / "talk.scan.usda"))
    assert (stage.GetStartTimeCode(), stage.GetEndTimeCode()) == (FIRST, FIRST + FRAMES - 1)
    assert stage.GetTimeCodesPerSecond() == stage.GetFramesPerSecond() == 60
    assert UsdGeom.GetStageMetersPerUnit(stage) == 1.0
    assert UsdGeom.GetStageUpAxis(stage) == "Z"
    mesh = stage.GetPrimAtPath("/Scan/head")
    assert mesh.HasAPI("FaceDeformAPI")
    assert mesh.GetAttribute("face:timecode:start").Get() == "10:00:00:00"
    sure = UsdGeom.PrimvarsAPI(mesh).GetPrimvar("face:uncertainty")
    assert sure.GetInterpolation() == "vertex"
    assert len(sure.Get(FIRST)) == len(UsdGeom.Mesh(mesh).GetPointsAttr().Get(FIRST))
    assert 0.05 < np.median(sure.Get(FIRST)) < 2.0
    extent = np.array(UsdGeom.Mesh(mesh).GetExtentAttr().Get(FIRST + 5))
    at = np.array(UsdGeom.Mesh(mesh).GetPointsAttr().Get(FIRST + 5))
    np.testing.assert_array_equal(extent, [at.min(axis=0), at.max(axis=0)])
    assert not validate(folder / "talk.scan.usda")


def test_a_shape_at_one_is_the_frame_it_was_made_of(folder: Path) -> None:
    run(deform(folder, reach=12.0))
    run(
        make_shapes(folder, reach=12.0, shape_frames=(f"{open_frame()}=mouth open", f"{FIRST + 5}"))
    )
    rig = read_rig(folder / "scan.rig.usda")
    assert rig.shapes == ("mouth_open", f"frame_{FIRST + 5}")
    mesh = rig.meshes[0]
    key = mesh.shapes[0].keys[-1]
    at_one = mesh.points.copy()
    at_one[key.points] += key.offsets
    wanted = points_at(folder / "talk.scan.usda", open_frame())
    assert np.abs(at_one - wanted).max() < 0.05
    assert len(key.points) < len(mesh.points)


def test_usdskel_itself_moves_the_new_rig_as_deform_moves_the_mesh(folder: Path) -> None:
    run(make_shapes(folder, shape_frames=(f"{open_frame()}=open",)))
    stage = Usd.Stage.Open(str(folder / "scan.rig.usda"))
    animation = UsdSkel.Animation.Define(stage, "/Face/weights")
    animation.CreateBlendShapesAttr(["open"])
    animation.CreateBlendShapeWeightsAttr([1.0])
    UsdSkel.BindingAPI(stage.GetPrimAtPath("/Face/skeleton")).CreateAnimationSourceRel().SetTargets(
        [animation.GetPath()]
    )
    assert UsdSkel.BakeSkinning(UsdSkel.Root(stage.GetPrimAtPath("/Face")))
    mesh = UsdGeom.Mesh(stage.GetPrimAtPath("/Face/asset/head"))
    baked = np.array(mesh.GetPointsAttr().Get(), np.float64)
    moving = Usd.Stage.Open(str(folder / "talk.scan.usda"))
    wanted = np.array(
        UsdGeom.Mesh(moving.GetPrimAtPath("/Scan/head")).GetPointsAttr().Get(open_frame())
    )
    np.testing.assert_allclose(baked, wanted, atol=5e-5)  # metres over a scale of 2


def test_shapes_are_named_from_a_csv(folder: Path) -> None:
    names = folder / "names.csv"
    names.write_text("frame,name\n110,smile\n120,smile\n", encoding="utf-8")
    report = run(make_shapes(folder, names=names))
    assert list(report.figures["shapes"]) == ["smile", "smile_2"]
    assert read_rig(folder / "scan.rig.usda").shapes == ("smile", "smile_2")


@pytest.mark.usefixtures("placement_not_drawn", "coverage_not_drawn")
def test_shapes_are_made_of_the_references_of_a_take(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    search_from_few_starts(monkeypatch)
    run(make_shapes(folder, count=3))
    chosen = SelectSpec(
        takes=(folder / "talk.take.usda",),
        rig=folder / "scan.rig.usda",
        count=5,
        out=folder / "scan.references.usda",
    )
    run(chosen)
    references = Usd.Stage.Open(str(folder / "scan.references.usda"))
    frame = references.GetAttributeAtPath("/References.face:reference:frame")
    frames = sorted(frame.Get(time) for time in frame.GetTimeSamples())
    out = folder / "more.rig.usda"
    run(make_shapes(folder, references=folder / "scan.references.usda", out=out))
    stage = Usd.Stage.Open(str(out))
    made = stage.GetPrimAtPath("/Face/shapes").GetChildren()
    told = sorted(prim.GetCustomData()["usdface"]["frame"] for prim in made)
    assert told == [frame for frame in frames if frame != FIRST]


def test_corrections_by_hand_outlive_binding_again(folder: Path, scan: Scan) -> None:
    moved, pointed, left = "skin_5_10", "skin_13_6", "skin_17_18"
    layer = Sdf.Layer.FindOrOpen(str(corrected_path(folder / "scan.binding.usda")))
    stage = Usd.Stage.Open(layer)
    over = stage.OverridePrim(f"/Binding/Markers/{pointed}")
    over.CreateAttribute("face:binding:point", Sdf.ValueTypeNames.Int).Set(300)
    ball = stage.OverridePrim(f"/Binding/Markers/{moved}")
    face = read_face_mesh(folder / "scan.usdc")
    wanted = face.mesh.points[310] / 10
    ball.CreateAttribute("xformOp:translate", Sdf.ValueTypeNames.Double3).Set(tuple(wanted))
    stage.OverridePrim(f"/Binding/Markers/{left}").SetActive(False)
    layer.Save()
    before = layer.ExportToString()
    report = run(bind(folder, scan))
    assert Sdf.Layer.FindOrOpen(layer.realPath).ExportToString() == before
    binding = binding_of(folder)
    at = binding.places.positions(face.mesh.points)
    np.testing.assert_allclose(at[binding.names.index(pointed)], face.mesh.points[300], atol=1e-6)
    np.testing.assert_allclose(at[binding.names.index(moved)], face.mesh.points[310], atol=1e-2)
    assert left not in binding.names
    assert report.figures["corrected"] == [moved, pointed]
    assert report.figures["left_out"] == [left]


def test_the_paper_s_choices_are_options_and_the_sampler_says_how_it_did(
    folder: Path,
) -> None:
    given = {"covariance": "published", "folds": False, "samples": 24, "burn_in": 16,
             "length_scale": 30.0, "priors": (4.0, 0.1, 4.0, 1.0), "prior_spread": 2.0}  # fmt: skip
    made = run(deform(folder, frames="101-108", sampler="hmc", **given))
    figures = made.figures
    assert 0 < figures["acceptance"] <= 1
    assert 1 <= figures["effective_samples"] <= 24
    assert figures["rhat"] > 0.9
    assert figures["covariance_clipped"] > 0
    assert any("R-hat" in note for note in made.notes)
    assert any("was not positive definite" in note for note in made.notes)


def test_a_small_face_moves_like_a_large_one(folder: Path, scan: Scan) -> None:
    large = read_spread(folder)
    for file in folder.glob("scan.*"):
        file.unlink()
    write_scan(folder / "scan.usdc", replace(scan, points=0.1 * scan.points), z_up=True)
    run(bind(folder, scan))
    run(deform(folder))
    np.testing.assert_allclose(read_spread(folder), 0.1 * large, rtol=0.02)


def test_a_binding_of_two_markers_to_one_place_is_told(folder: Path, scan: Scan) -> None:
    take = small_scan_take(scan)
    twice = replace(
        take.markers,
        names=(*scan.names, "twin"),
        **{
            name: np.concatenate([getattr(take.markers, name)] * 2, axis=1)[
                :, : len(scan.names) + 1
            ]
            for name in ("positions", "visible", "confidence")
        },
    )
    write_take(folder / "talk.take.usda", replace(take, markers=twice), provenance=Provenance())
    spec = bind(folder, scan)
    run(spec.model_copy(update={"landmarks": (*spec.landmarks, f"twin={scan.markers[0]}")}))
    notes = run(deform(folder)).notes
    words = f"at one place of the mesh: {scan.names[0]} and twin"
    assert any(words in note for note in notes)
    with pytest.raises(InputError, match=words):
        run(deform(folder, method="rbf"))


@pytest.mark.parametrize("frames", [f"{FIRST}-{FIRST}", f"{FIRST + 9}-{FIRST + 11}"])
def test_few_frames_of_a_take_are_drawn(
    folder: Path, frames: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The neutral frame, which is still; and frames between those that a model is fitted to."""
    for module in (picture, plan):
        monkeypatch.setattr(module, "PLAN_FRAMES", 3)
    made = folder / "few.jpg"
    run(deform(folder, method="rbf", frames=frames, picture=made, rows=2, quality="draft"))
    assert made.is_file()


def test_three_markers_are_too_few(folder: Path, scan: Scan) -> None:
    take = small_scan_take(scan)
    assert take.markers is not None
    few = replace(
        take.markers,
        names=take.markers.names[:3],
        positions=take.markers.positions[:, :3],
        visible=take.markers.visible[:, :3],
        confidence=take.markers.confidence[:, :3],
        rigid=(),
    )
    write_take(folder / "few.take.usda", replace(take, markers=few), provenance=Provenance())
    with pytest.raises(InputError, match="the take has 3 markers; at least 4 are needed"):
        run(
            BindSpec(
                take=folder / "few.take.usda", mesh=folder / "scan.usdc", out=folder / "b.usda"
            )
        )
    with pytest.raises(InputError, match=r"3 of its 3 markers are bound .* at least 4 are needed"):
        run(deform(folder, take=folder / "few.take.usda"))


def test_a_mesh_without_shapes_asks_for_landmarks(folder: Path) -> None:
    with pytest.raises(
        InputError, match=r"no shapes from which markers could be placed.*at least 3"
    ):
        run(deform(folder, binding=None))


def test_of_two_characters_in_a_file_the_mesh_has_its_own_shapes(tmp_path: Path) -> None:
    write_rig(tmp_path / "rig.usda", small_rig())
    both = Sdf.Layer.CreateNew(str(tmp_path / "both.usda"))
    for name in ("/A", "/B"):
        define_reference_prim(both, Sdf.Path(name), "./rig.usda", Sdf.Path("/Hero"))
    both.Save()
    face = read_face_mesh(tmp_path / "both.usda", prim="/B/geo/skin")
    assert [shape.name for shape in plan.add_shapes(face).shapes] == [
        "jawOpen",
        "eyeBlink",
        "smile",
    ]


def test_landmarks_that_are_not_there_are_named_all_at_once(folder: Path, scan: Scan) -> None:
    spec = bind(folder, scan).model_copy(update={"landmarks": ("nobody=3", "nose tip=99999")})
    with pytest.raises(InputError, match=r"no marker 'nobody'.*; .*no point 99999 for nose tip"):
        run(spec)


@pytest.mark.parametrize(
    ("given", "message"),
    [
        (("nose tip=5", "chin_L=5", "brow_R=5"), "points on the mesh lie on a line or coincide"),
        (("nose tip=5", "nose tip=6", "brow_R=7"), "nose tip is given twice; correct --landmarks"),
    ],
)
def test_landmarks_that_say_too_little_are_refused(
    folder: Path, scan: Scan, given: tuple[str, ...], message: str
) -> None:
    with pytest.raises(InputError, match=message):
        run(bind(folder, scan).model_copy(update={"landmarks": given}))


def test_a_mirrored_face_is_refused(folder: Path, scan: Scan) -> None:
    wrong = (
        "skin_13_2=" + str(scan.markers[scan.names.index("skin_13_22")]),
        "skin_13_22=" + str(scan.markers[scan.names.index("skin_13_2")]),
        *[mark for mark in landmarks(scan) if mark.startswith(("nose", "chin_L"))],
    )
    with pytest.raises(InputError, match="mirrored"):
        run(bind(folder, scan).model_copy(update={"landmarks": wrong}))


def test_a_marker_off_the_mesh_is_named(folder: Path) -> None:
    stage = Usd.Stage.Open(str(corrected_path(folder / "scan.binding.usda")))
    prim = stage.OverridePrim("/Binding/Markers/skin_5_10")
    prim.CreateAttribute("face:binding:face", Sdf.ValueTypeNames.Int).Set(123456)
    stage.GetRootLayer().Save()
    with pytest.raises(InputError, match="marker skin_5_10 is not on the mesh: there is no face"):
        run(deform(folder))


def test_a_binding_of_another_surface_is_refused(folder: Path, scan: Scan) -> None:
    stage = Usd.Stage.Open(str(folder / "scan.usdc"))
    mesh = UsdGeom.Mesh(stage.GetPrimAtPath("/Scan/head"))
    points = np.array(mesh.GetPointsAttr().Get())
    points[5] += 0.01
    mesh.GetPointsAttr().Set(points)
    stage.Save()
    with pytest.raises(InputError, match="was made on another surface"):
        run(deform(folder))
    stage = Usd.Stage.Open(str(corrected_path(folder / "scan.binding.usda")))
    prim = stage.OverridePrim("/Binding/Markers/skin_5_10")
    prim.CreateAttribute("face:binding:face", Sdf.ValueTypeNames.Int).Set(5)
    stage.GetRootLayer().Save()
    (folder / "scan.binding.usda").unlink()
    with pytest.raises(InputError, match=r"corrects markers of scan\.binding\.usda, which is gone"):
        run(bind(folder, scan))


def test_an_island_without_a_marker_is_told(folder: Path, scan: Scan) -> None:
    stage = Usd.Stage.Open(str(folder / "scan.usdc"))
    mesh = UsdGeom.Mesh(stage.GetPrimAtPath("/Scan/head"))
    points = np.array(mesh.GetPointsAttr().Get())
    tooth = points[scan.upper[:3]] + [0, 0.01, 0]
    mesh.GetPointsAttr().Set(np.concatenate([points, tooth]))
    counts = np.append(np.array(mesh.GetFaceVertexCountsAttr().Get()), 3)
    mesh.GetFaceVertexCountsAttr().Set(counts)
    indices = np.append(np.array(mesh.GetFaceVertexIndicesAttr().Get()), len(points) + np.arange(3))
    mesh.GetFaceVertexIndicesAttr().Set(indices)
    stage.Save()
    (folder / "scan.binding.usda").unlink()
    run(bind(folder, scan))
    report = run(deform(folder))
    assert any("3 of 783 points are on 1 separate part without a marker" in n for n in report.notes)
    assert report.figures["points_without_marker"] == 3


@pytest.mark.parametrize(
    ("more", "message"),
    [
        ({"frames": "1-20"}, "frames 1-20 are not all there; it has 101-140"),
        ({"landmarks": ("a=1",)}, "landmarks has no effect with binding"),
        ({"blend": 1.5}, "less than or equal to 1"),
        ({"device": "cuda"}, "device"),
        ({"method": "rbf", "sampler": "hmc"}, "--method rbf does not use --sampler"),
        ({"method": "rbf", "length_scale": 20.0}, "--method rbf does not use --length-scale"),
        ({"priors": (1.0, 0.0, 1.0, 1.0)}, "greater than 0"),
    ],
)
def test_what_deform_cannot_do_is_said(moved: Path, more: dict[str, object], message: str) -> None:
    with pytest.raises((InputError, ValueError), match=message):
        run(deform(moved, **more))


@pytest.mark.parametrize(
    ("more", "message"),
    [
        ({"shape_frames": ("7",)}, "has no frame 7; give frames within 101-140"),
        ({"shape_frames": ("110=a", "110=b")}, "frame 110 is given for two shapes"),
        ({"shape_frames": ("101",)}, "moves no point"),
        ({"count": 3, "least_mm": 9.0}, "--count is 3, but . of the faces"),
        ({"count": 500}, "faces of the take differ"),
        (
            {"shape_frames": ("110",), "names": Path("x.csv")},
            "shape_frames has no effect with names",
        ),
    ],
)
def test_what_make_shapes_cannot_do_is_said(
    moved: Path, more: dict[str, object], message: str
) -> None:
    with pytest.raises((InputError, ValueError), match=message):
        run(make_shapes(moved, out=moved / "bad.rig.usda", **({"least_mm": 0.6} | more)))


def test_dense_markers_around_the_mouth_do_not_hold_sparse_cheeks_still() -> None:
    mouth = make_mouth()
    corners = 50 * np.array([[-1, -1], [1, -1], [-1, 1], [1, 1]])
    dense = [*mouth.upper[4:15:2], *mouth.lower[4:15:2]]
    sparse = [int(np.abs(mouth.points[:, :2] - at).sum(axis=1).argmin()) for at in corners]
    places = places_at_points(mouth.counts, mouth.indices, np.array(dense + sparse))
    distances = surface_distances(mouth.points, mouth.counts, mouth.indices, places)
    assert plan._fade(distances, None).min() > 0.5
