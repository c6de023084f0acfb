"""Moving meshes on disk: one file or clips, timing, normals that are not stale, crashes."""

from contextlib import AbstractContextManager
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
from pxr import Sdf, Usd, UsdGeom

from tests.small_scan import small_scan, write_scan
from usdface.core.errors import InputError
from usdface.core.provenance import Provenance
from usdface.core.sidecars import points_path
from usdface.usdio.rig.mesh import FaceMesh, read_face_mesh
from usdface.usdio.surface.point_cache import (
    PointsFormat,
    PointsHeader,
    PointsWriter,
    writing_points,
)
from usdface.usdio.validation import validate

FIRST, LAST = 11, 40
CLIPS = PointsFormat(uncertainty=True, clip_bytes=100_000)
WHOLE = PointsFormat(uncertainty=True)


@pytest.fixture
def face(tmp_path: Path) -> FaceMesh:
    return read_face_mesh(write_scan(tmp_path / "scan.usdc", small_scan()))


def writing(
    path: Path, face: FaceMesh, format_: PointsFormat, *, seed: int = 0, last: int = LAST
) -> AbstractContextManager[PointsWriter]:
    return writing_points(
        path,
        face,
        PointsHeader(Fraction(24000, 1001), FIRST, last, method="test"),
        format_,
        provenance=Provenance(step="deform", spec=str(seed)),
    )


def write(
    path: Path, face: FaceMesh, format_: PointsFormat, *, seed: int = 0, last: int = LAST
) -> np.ndarray:
    rng = np.random.default_rng(seed)
    moved = face.local + rng.normal(0, 1, (last - FIRST + 1, *face.local.shape))
    with writing(path, face, format_, seed=seed, last=last) as writer:
        for start in range(0, len(moved), 7):
            part = moved[start : start + 7]
            writer.append(part, uncertainty_mm=np.full(part.shape[:2], 0.5))
    return moved


def mesh_of(path: Path) -> tuple[Usd.Stage, UsdGeom.Mesh]:
    stage = Usd.Stage.Open(str(path))
    return stage, UsdGeom.Mesh(stage.GetPrimAtPath("/Scan/head"))


def test_clips_play_what_one_file_plays_between_frames_too(tmp_path: Path, face: FaceMesh) -> None:
    moved = write(tmp_path / "whole.usda", face, WHOLE)
    write(tmp_path / "clips.usda", face, CLIPS)
    assert len(list(tmp_path.glob("clips.points.*.0*.usdc"))) > 3
    assert len(list(tmp_path.glob("clips.points.*.manifest.usda"))) == 1
    assert not list(tmp_path.glob("whole.points.*.usdc"))
    one, whole = mesh_of(tmp_path / "whole.usda")
    many, clips = mesh_of(tmp_path / "clips.usda")
    assert one.GetEndTimeCode() == many.GetEndTimeCode()
    for time in (*np.arange(FIRST, LAST + 0.01, 0.25), FIRST - 3, LAST + 3):
        for get in (UsdGeom.Mesh.GetPointsAttr, UsdGeom.Mesh.GetExtentAttr):
            np.testing.assert_array_equal(get(clips).Get(time), get(whole).Get(time), str(time))
    np.testing.assert_allclose(np.array(clips.GetPointsAttr().Get(20)), moved[9], atol=1e-5)
    sure = UsdGeom.PrimvarsAPI(clips).GetPrimvar("face:uncertainty")
    assert sure.GetInterpolation() == "vertex"
    assert sure.Get(20)[3] == 0.5


@pytest.mark.parametrize("format_", [WHOLE, CLIPS], ids=["whole", "clips"])
def test_timing_units_and_default_prim_are_said_in_every_layer(
    tmp_path: Path, face: FaceMesh, format_: PointsFormat
) -> None:
    write(tmp_path / "out.usda", face, format_)
    for file in [*tmp_path.glob("out*.usda"), *tmp_path.glob("out*.usdc")]:
        stage = Usd.Stage.Open(str(file))
        assert stage.GetDefaultPrim().GetName() == "Scan", file
        assert stage.GetTimeCodesPerSecond() == pytest.approx(24000 / 1001)
        assert stage.GetFramesPerSecond() == pytest.approx(24000 / 1001)
        assert stage.HasAuthoredTimeCodeRange()
        assert UsdGeom.GetStageMetersPerUnit(stage) == 0.01
    stage, _ = mesh_of(tmp_path / "out.usda")
    assert (stage.GetStartTimeCode(), stage.GetEndTimeCode()) == (FIRST, LAST)
    assert not validate(tmp_path / "out.usda")


def test_normals_of_the_face_at_rest_are_not_left_on_the_moving_one(tmp_path: Path) -> None:
    path = write_scan(tmp_path / "scan.usdc", small_scan(), normals="vertex")
    face = read_face_mesh(path)
    write(tmp_path / "without.usda", face, WHOLE)
    _, mesh = mesh_of(tmp_path / "without.usda")
    assert not mesh.GetNormalsAttr().HasAuthoredValue()
    turned = np.random.default_rng(1).normal(size=(1, len(face.local), 3))
    with writing_points(
        tmp_path / "with.usda",
        face,
        PointsHeader(Fraction(24), 1, 1),
        PointsFormat(normals=True),
        provenance=Provenance(),
    ) as writer:
        writer.append(face.local[None], normals=turned)
    _, mesh = mesh_of(tmp_path / "with.usda")
    np.testing.assert_allclose(np.array(mesh.GetNormalsAttr().Get(1)), turned[0], atol=1e-6)
    assert mesh.GetNormalsInterpolation() == "vertex"


@pytest.mark.parametrize("format_", [WHOLE, CLIPS], ids=["whole", "clips"])
def test_a_crash_leaves_what_was_there(
    tmp_path: Path, face: FaceMesh, format_: PointsFormat
) -> None:
    before = write(tmp_path / "out.usda", face, format_)
    files = sorted(path.name for path in tmp_path.iterdir())
    broken = np.tile(face.local, (20, 1, 1))
    broken[19] = np.inf
    with (
        pytest.raises(InputError, match="NaN or infinity"),
        writing_points(
            tmp_path / "out.usda",
            face,
            PointsHeader(Fraction(24), 1, 90),
            format_,
            provenance=Provenance(spec="other"),
        ) as writer,
    ):
        writer.append(broken)
    assert sorted(path.name for path in tmp_path.iterdir()) == files
    _, mesh = mesh_of(tmp_path / "out.usda")
    np.testing.assert_allclose(np.array(mesh.GetPointsAttr().Get(20)), before[9], atol=1e-5)


def test_the_same_again_when_interrupted_leaves_the_clips_that_the_asset_plays(
    tmp_path: Path, face: FaceMesh
) -> None:
    before = write(tmp_path / "out.usda", face, CLIPS)
    files = sorted(path.name for path in tmp_path.iterdir())

    def interrupted() -> None:
        with writing(tmp_path / "out.usda", face, CLIPS) as writer:
            writer.append(before[:20], uncertainty_mm=np.full(before[:20].shape[:2], 0.5))
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        interrupted()
    assert sorted(path.name for path in tmp_path.iterdir()) == files
    _, mesh = mesh_of(tmp_path / "out.usda")
    for frame, points in enumerate(before, start=FIRST):
        np.testing.assert_allclose(np.array(mesh.GetPointsAttr().Get(frame)), points, atol=1e-5)


def test_clips_that_nothing_plays_any_more_are_removed(tmp_path: Path, face: FaceMesh) -> None:
    write(tmp_path / "out.usda", face, CLIPS)
    old = set(tmp_path.glob("out.points.*.0*.usdc"))
    after = write(tmp_path / "out.usda", face, CLIPS, seed=1)
    new = set(tmp_path.glob("out.points.*.0*.usdc"))
    assert new
    assert not old & new
    _, mesh = mesh_of(tmp_path / "out.usda")
    np.testing.assert_allclose(np.array(mesh.GetPointsAttr().Get(20)), after[9], atol=1e-5)
    write(tmp_path / "out.usda", face, WHOLE)
    assert not list(tmp_path.glob("out.points.*.*"))
    assert points_path(tmp_path / "out.usda").is_file()


def test_a_face_that_moves_to_another_prim_leaves_nothing(tmp_path: Path, face: FaceMesh) -> None:
    write(tmp_path / "out.usda", face, CLIPS)
    header = PointsHeader(Fraction(24), 1, 1, rig_path="/Shot/face")
    out, made = tmp_path / "out.usda", Provenance(spec="elsewhere")
    with writing_points(out, face, header, WHOLE, provenance=made) as writer:
        writer.append(face.local[None])
    assert not list(tmp_path.glob("out.points.*.*"))
    stage = Usd.Stage.Open(str(out))
    meshes = [prim.GetPath() for prim in stage.Traverse() if prim.IsA(UsdGeom.Mesh)]
    assert meshes == ["/Shot/face/head"]
    assert [prim.GetName() for prim in stage.GetPseudoRoot().GetChildren()] == ["Shot"]


def test_what_others_put_into_the_layer_to_open_stays(tmp_path: Path, face: FaceMesh) -> None:
    write(tmp_path / "out.usda", face, WHOLE)
    stage = Usd.Stage.Open(str(tmp_path / "out.usda"))
    UsdGeom.Sphere.Define(stage, "/Scan/locator")
    layer = stage.GetRootLayer()
    layer.subLayerPaths = ["out.points.usdc"]  # as another tool writes it
    layer.subLayerOffsets[0] = Sdf.LayerOffset(100)
    stage.Save()
    write(tmp_path / "out.usda", face, WHOLE)
    assert Usd.Stage.Open(str(tmp_path / "out.usda")).GetPrimAtPath("/Scan/locator")
    assert list(layer.subLayerPaths) == ["out.points.usdc"]


def test_nan_is_never_written(tmp_path: Path, face: FaceMesh) -> None:
    with (
        pytest.raises(InputError, match="NaN or infinity"),
        writing_points(
            tmp_path / "out.usda",
            face,
            PointsHeader(Fraction(24), 1, 1),
            WHOLE,
            provenance=Provenance(),
        ) as writer,
    ):
        writer.append(np.full((1, len(face.local), 3), np.nan))
    assert not (tmp_path / "out.usda").exists()
    assert not points_path(tmp_path / "out.usda").exists()
