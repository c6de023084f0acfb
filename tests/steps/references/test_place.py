"""Placing as a user does: landmarks, corrections, what they change, and what is refused."""

import json
from pathlib import Path

import numpy as np
import pytest
from pxr import Gf, Sdf, Usd, UsdGeom

from tests.steps.small_shot import Shot
from usdface.core.assets import Rig
from usdface.core.deformer import Deformer
from usdface.core.errors import InputError
from usdface.core.provenance import Provenance
from usdface.core.sidecars import corrected_path
from usdface.model.selection.baseline import PerformerMarkers
from usdface.runner.execute import execute
from usdface.specs.references import PlaceSpec, SelectSpec
from usdface.steps.inputs.cleaned_takes import (
    CleanedTakes,
    read_cleaned_takes,
    spread_frames,
)
from usdface.steps.inputs.placed_takes import PlacementScene
from usdface.steps.inputs.placement import (
    placed_equation,
    read_performer_markers,
    stored_placement,
    virtual_markers,
)
from usdface.steps.surface.plan import PLAN_FRAMES
from usdface.usdio.layers import read_provenance
from usdface.usdio.references.read import read_references
from usdface.usdio.rig.mesh import rig_surfaces
from usdface.usdio.rig.read import read_rig
from usdface.usdio.surface.binding import correct_binding
from usdface.usdio.surface.placement import read_placement
from usdface.usdio.take.read import TakeReader
from usdface.usdio.validation import validate


def spec(shot: Shot, **changed: object) -> PlaceSpec:
    given: dict[str, object] = {
        "takes": (shot / "shot.clean.take.usda",),
        "rig": shot / "hero.usdc",
        "out": shot / "hero.placement.usda",
    }
    return PlaceSpec(**(given | changed))  # type: ignore[arg-type]


def places(path: Path, rig: Rig) -> dict[str, np.ndarray]:
    binding = read_placement(path, rig).binding
    at = binding.places.positions(rig_surfaces(rig)[0].mesh.points)
    return dict(zip(binding.names, at, strict=True))


@pytest.mark.slow
def test_a_correction_is_kept_pulls_nobody_else_and_gives_way_when_taken_back(shot: Shot) -> None:
    out, rig = shot / "hero.placement.usda", read_rig(shot / "hero.usdc", prim=None)
    execute(spec(shot, picture=shot / "hero.placement.jpg", quality="draft"))
    before = places(out, rig)
    moved = "nose_tip" if "nose_tip" in before else next(iter(before))
    points = rig_surfaces(rig)[0].mesh.points
    near = np.linalg.norm(points - before[moved], axis=1)
    target = points[int(np.argmin(np.abs(near - 6.0)))]
    made = Provenance(step="tune", spec="{}", inputs={})
    correct_binding(out, {moved: target}, made, author="kim")
    stored = read_provenance(corrected_path(out))
    assert stored is not None
    assert stored.step == "tune"
    after = places(out, rig)
    np.testing.assert_allclose(after[moved], target, atol=0.05)
    assert all(np.allclose(after[name], before[name]) for name in before if name != moved)
    report = execute(spec(shot), overwrite=True)
    np.testing.assert_allclose(places(out, rig)[moved], target, atol=0.05)
    assert report.figures["placed_by_a_person"] == 1
    assert report.figures["corrected_by"] == {moved: "kim"}
    assert f"corrected by kim: 1 marker, {moved}" in report.notes
    correct_binding(out, {moved: None}, made)
    execute(spec(shot), overwrite=True)
    np.testing.assert_allclose(places(out, rig)[moved], before[moved], atol=0.05)
    assert not read_placement(out, rig).authors
    for file in shot.folder.glob("hero.placement*.usda"):
        assert not [each for each in validate(file) if each.severity == "error"], file


@pytest.mark.slow
def test_select_and_what_follows_use_one_placement(shot: Shot) -> None:
    """Its own by default, and the one that is given as it stands."""
    execute(spec(shot))
    given = {
        "takes": (shot / "shot.clean.take.usda",),
        "rig": shot / "hero.usdc",
        "count": 8,
        "method": "design",
    }
    execute(SelectSpec(**given, out=shot / "own.references.usda"))  # type: ignore[arg-type]
    placement = shot / "hero.placement.usda"
    execute(
        SelectSpec(**given, out=shot / "same.references.usda", placement=placement)  # type: ignore[arg-type]
    )
    own, same = (read_references(shot / f"{name}.references.usda") for name in ("own", "same"))
    assert own.placement == shot / "own.references.placement.usda"
    assert same.placement is not None
    assert same.placement.resolve() == placement.resolve()
    assert not (shot / "same.references.placement.usda").exists()
    np.testing.assert_allclose(own.weights, same.weights, atol=1e-5)
    rig = read_rig(shot / "hero.usdc", prim=None)
    equation = placed_equation(
        stored_placement(own, rig),
        rig,
        Deformer(rig),
        PerformerMarkers(
            labels=own.marker_names,
            neutral=own.neutral,
            positions=own.markers,
            visible=np.ones(own.markers.shape[:2], np.bool_),
            rigid=(),
        ),
    )
    at = equation.virtual.places(rig_surfaces(rig)[0].mesh.points)
    wanted = places(placement, rig)
    np.testing.assert_allclose(at, [wanted[name] for name in own.marker_names], atol=0.05)


def test_a_take_in_another_head_space_is_turned_into_the_placements(shot: Shot) -> None:
    execute(spec(shot))
    rig = read_rig(shot / "hero.usdc", prim=None)
    placement = read_placement(shot / "hero.placement.usda", rig)
    takes = read_cleaned_takes((shot / "shot.clean.take.usda",))
    c, s = np.cos(0.3), np.sin(0.3)
    turn = np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]])
    here = virtual_markers(placement, takes.marker_names, takes.neutral)
    there = virtual_markers(
        placement, takes.marker_names, takes.neutral @ turn.T + [5.0, -3.0, 8.0]
    )
    moved = np.random.default_rng(0).normal(size=(7, 3))
    np.testing.assert_allclose(
        moved @ turn.T @ there.rotation.T, moved @ here.rotation.T, atol=1e-6
    )


@pytest.mark.slow
def test_a_marker_that_is_deactivated_counts_in_no_solve(shot: Shot) -> None:
    out, rig = shot / "hero.placement.usda", read_rig(shot / "hero.usdc", prim=None)
    execute(spec(shot))
    reader = TakeReader(shot / "shot.clean.take.usda")
    take = read_performer_markers(reader, spread_frames(reader, PLAN_FRAMES))
    name = next(each for i, each in enumerate(take.labels) if i not in take.rigid)
    stage = Usd.Stage.Open(str(corrected_path(out)))
    stage.OverridePrim(f"/Binding/Markers/{name}").SetActive(False)
    stage.Save()
    placement = read_placement(out, rig)
    assert placement.left_out == (name,)
    equation = placed_equation(
        placement,
        rig,
        Deformer(rig),
        take,
    )
    row = take.labels.index(name)
    shaken = take.positions.copy()
    shaken[:, row] += 30.0
    np.testing.assert_allclose(equation.propose(take.positions), equation.propose(shaken))
    report = execute(spec(shot), overwrite=True)
    assert any("left out" in note and name in note for note in report.notes)


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("marker,point\nnobody,3\n", "no marker 'nobody'"),
        ("marker,x,y,z\n{name},0,0,9000\n", "mm from its surface"),
        ("marker,point\n{name},-3\n", "no point -3|must be MESH:INDEX"),
        ("marker,point\n", "names no landmark"),
        ("frame,point\n1,3\n", "has no `marker` column"),
        ('{{"{name}": [1, 2]}}', "neither a point nor x, y, z"),
        ("[1, 2]", "names no marker"),
        ("{{", "is no valid JSON"),
    ],
)
def test_landmarks_that_name_nothing_are_refused_and_nothing_is_written(
    shot: Shot, text: str, reason: str
) -> None:
    name = read_cleaned_takes((shot / "shot.clean.take.usda",)).marker_names[0]
    suffix = "json" if text[0] in "[{" else "csv"
    file = shot / f"places.{suffix}"
    file.write_text(text.format(name=name), encoding="utf-8")
    with pytest.raises(InputError, match=reason):
        execute(spec(shot, landmarks=file))
    assert not list(shot.folder.glob("hero.placement*"))


@pytest.mark.slow
def test_landmarks_by_position_by_point_and_by_a_corrected_asset_agree(shot: Shot) -> None:
    rig = read_rig(shot / "hero.usdc", prim=None)
    name = read_cleaned_takes((shot / "shot.clean.take.usda",)).marker_names[0]
    mesh = rig.meshes[0]
    point = int(mesh.points[:, 2].argmax())
    stage_at = mesh.points[point] / 10.0  # the demo's rig is in centimetres, Y up
    file = shot / "places.json"
    file.write_text(json.dumps({name: stage_at.tolist()}), encoding="utf-8")
    execute(spec(shot, landmarks=file))
    by_position = places(shot / "hero.placement.usda", rig)[name]
    np.testing.assert_allclose(by_position, mesh.points[point], atol=0.05)
    file.write_text(json.dumps({name: f"{mesh.path}:{point}"}), encoding="utf-8")
    execute(spec(shot, landmarks=file, out=shot / "point.placement.usda"))
    by_point = places(shot / "point.placement.usda", rig)[name]
    np.testing.assert_allclose(by_point, by_position, atol=0.05)
    execute(spec(shot, landmarks=shot / "point.placement.usda", out=shot / "again.placement.usda"))
    np.testing.assert_allclose(
        places(shot / "again.placement.usda", rig)[name], by_point, atol=0.05
    )


def test_a_ball_far_off_the_rig_is_refused(shot: Shot) -> None:
    out, rig = shot / "hero.placement.usda", read_rig(shot / "hero.usdc", prim=None)
    execute(spec(shot))
    stage = Usd.Stage.Open(str(corrected_path(out)))
    name = read_placement(out, rig).binding.names[0]
    prim = stage.OverridePrim(f"/Binding/Markers/{name}")
    prim.CreateAttribute("xformOp:translate", Sdf.ValueTypeNames.Double3).Set(Gf.Vec3d(0, 0, 90))
    stage.Save()
    before = out.read_bytes()
    with pytest.raises(InputError, match=r"its ball is .* mm off it"):
        execute(spec(shot), overwrite=True)
    assert out.read_bytes() == before


def test_a_rig_that_stands_on_its_head_is_refused_and_nothing_is_written(shot: Shot) -> None:
    stage = Usd.Stage.Open(str(shot / "hero.usdc"))
    stage.SetEditTarget(stage.GetSessionLayer())
    xform = UsdGeom.Xformable(stage.GetDefaultPrim())
    xform.ClearXformOpOrder()
    xform.AddRotateZOp().Set(180.0)
    stage.Export(str(shot / "fallen.usdc"))
    with pytest.raises(InputError, match="the head lies"):
        execute(spec(shot, rig=shot / "fallen.usdc", out=shot / "fallen.placement.usda"))
    assert not (shot / "fallen.placement.usda").exists()


def scene_of(takes: CleanedTakes, rig: Rig) -> PlacementScene:
    markers = takes.markers_at(np.arange(len(takes.frames)))
    return PlacementScene(PerformerMarkers.of_take(markers, takes.neutral), rig)


@pytest.mark.slow
def test_takes_stabilised_by_skin_are_aligned_by_markers_that_the_rig_moves_less(
    shot: Shot,
) -> None:
    execute(spec(shot))
    rig = read_rig(shot / "hero.usdc", prim=None)
    placement = read_placement(shot / "hero.placement.usda", rig)
    takes = read_cleaned_takes((shot / "shot.clean.take.usda",))
    assert scene_of(takes, rig).find_steadier(placement) == ((), "")
    at = np.array([places(shot / "hero.placement.usda", rig)[n] for n in takes.marker_names])
    lowest = np.argsort(at[:, 1])[:8]
    by_jaw = takes.aligned_by(tuple(takes.marker_names[marker] for marker in lowest))
    steadier, note = scene_of(by_jaw, rig).find_steadier(placement)
    skull = [takes.marker_names.index(name) for name in takes.rigid]
    wrong, right = (
        (each.positions[0] - takes.positions[0])[:, skull].std()
        for each in (by_jaw, by_jaw.aligned_by(steadier))
    )
    assert right < 0.2 * wrong
    assert "are on skin" in note


def test_place_and_select_say_that_they_aligned_the_takes(
    shot: Shot, monkeypatch: pytest.MonkeyPatch
) -> None:
    execute(spec(shot))
    takes = read_cleaned_takes((shot / "shot.clean.take.usda",))
    found = iter([(takes.marker_names[:6], "aligned by others"), ((), "")])
    monkeypatch.setattr(PlacementScene, "find_steadier", lambda *_: next(found))
    report = execute(
        SelectSpec(
            takes=(shot / "shot.clean.take.usda",),
            rig=shot / "hero.usdc",
            count=8,
            out=shot / "aligned.references.usda",
            placement=shot / "hero.placement.usda",
        )
    )
    assert "aligned by others" in report.notes
    references = read_references(shot / "aligned.references.usda")
    assert references.rigid == takes.marker_names[:6]
