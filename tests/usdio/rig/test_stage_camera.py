"""A shot's camera sees in the rig's own space what it sees in the shot."""

from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
from pxr import Gf, Sdf, Usd, UsdGeom

from tests.usdio.small_rig import small_rig
from usdface.core.errors import InputError
from usdface.media.face.camera import Camera
from usdface.steps.review.shot import _as_camera
from usdface.usdio.rig.read import read_rig
from usdface.usdio.rig.stage_camera import StageCamera
from usdface.usdio.rig.write import write_rig

SIZE = 400


@pytest.fixture
def hero(tmp_path: Path) -> Path:
    write_rig(tmp_path / "hero.usda", small_rig())
    return tmp_path / "hero.usda"


def make_shot(folder: Path, *, projection: str = "perspective", characters: int = 1) -> Path:
    """Write a shot: metres, Z up, 24 per second; characters that walk and are scaled."""
    stage = Usd.Stage.CreateNew(str(folder / "shot.usda"))
    UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.z)
    UsdGeom.SetStageMetersPerUnit(stage, 1.0)
    stage.SetTimeCodesPerSecond(24)
    for number in range(characters):
        place = UsdGeom.Xform.Define(stage, f"/World/hero{number}")
        walk = place.AddTranslateOp()
        walk.Set(Gf.Vec3d(0, 0, 1.5), 0)
        walk.Set(Gf.Vec3d(2, 1, 1.5), 24)
        place.AddRotateXYZOp().Set(Gf.Vec3f(90, 0, 35))
        place.AddScaleOp().Set(Gf.Vec3f(0.01))  # a rig in centimetres
        rig = stage.DefinePrim(f"/World/hero{number}/rig")
        rig.GetReferences().AddReference("./hero.usda")
    UsdGeom.Xform.Define(stage, "/World/rail").AddTranslateOp().Set(Gf.Vec3d(0.2, -1, 1.6))
    camera = UsdGeom.Camera.Define(stage, "/World/rail/cam")
    turn = camera.AddRotateXYZOp()
    turn.Set(Gf.Vec3f(85, 3, 0), 0)
    turn.Set(Gf.Vec3f(95, 8, -40), 24)
    camera.CreateProjectionAttr(projection)
    camera.CreateFocalLengthAttr(35)
    camera.CreateHorizontalApertureAttr(24)
    camera.CreateVerticalApertureAttr(18)
    camera.CreateHorizontalApertureOffsetAttr(2.5)
    camera.CreateVerticalApertureOffsetAttr(-1.5)
    stage.Save()
    return folder / "shot.usda"


def camera_of(shot: Path, hero: Path, name: str = "/World/rail/cam") -> StageCamera:
    return StageCamera(shot, name, read_rig(hero), rate=Fraction(48))


def as_usd_sees(shot: Path, points: np.ndarray, time: float) -> np.ndarray:
    """Project points of the rig's root through USD's own matrices to columns and rows."""
    stage = Usd.Stage.Open(str(shot))
    world = UsdGeom.XformCache(time).GetLocalToWorldTransform(
        stage.GetPrimAtPath("/World/hero0/rig")
    )
    frustum = UsdGeom.Camera(stage.GetPrimAtPath("/World/rail/cam")).GetCamera(time).frustum
    seen = world * frustum.ComputeViewMatrix() * frustum.ComputeProjectionMatrix()
    flat = np.array([seen.Transform(Gf.Vec3d(*map(float, point)))[:2] for point in points])
    width = SIZE * 24 / 18
    return np.stack([(flat[:, 0] + 1) / 2 * width, (1 - flat[:, 1]) / 2 * SIZE], axis=1)


def as_we_see(camera: StageCamera, points_mm: np.ndarray, frame: int) -> np.ndarray:
    view = camera.at(frame)
    assert view.aspect == pytest.approx(24 / 18)
    drawn = _as_camera(view, Camera(eye=(0.0, 0.0, 1.0), target=(0.0, 0.0, 0.0)))
    return drawn.project(points_mm, width=round(SIZE * 24 / 18), height=SIZE)[:, :2]


@pytest.mark.parametrize("projection", ["perspective", "orthographic"])
@pytest.mark.parametrize("frame", [0, 17, 48])
def test_a_point_of_the_face_is_where_usd_projects_it(
    hero: Path, tmp_path: Path, projection: str, frame: int
) -> None:
    shot = make_shot(tmp_path, projection=projection)
    camera = camera_of(shot, hero)
    assert camera.holds_character
    mm = np.random.default_rng(0).normal(0, 60, (30, 3))
    # Half as many time codes as frames: the shot counts 24 a second, the performance 48. The rig
    # is in centimetres and its root lies at its stage's origin.
    expected = as_usd_sees(shot, mm / 10, frame / 2)
    width = round(SIZE * 24 / 18)
    tolerance = 1e-3 * np.abs(expected).max() + abs(width - SIZE * 24 / 18)
    np.testing.assert_allclose(as_we_see(camera, mm, frame), expected, atol=tolerance)


@pytest.mark.parametrize("span", [None, 300.0])
def test_a_ray_meets_the_point_that_is_projected_to_its_pixel(span: float | None) -> None:
    camera = Camera(
        eye=(30.0, 40.0, 500.0),
        target=(5.0, 0.0, 0.0),
        fov_degrees=25.0,
        up=(0.3, 1.0, 0.0),
        shift=(0.4, -0.2),
        span_mm=span,
    )
    pixels = np.random.default_rng(0).uniform(0, 300, (50, 2))
    origins = camera.origins(pixels, width=320, height=300)
    points = origins + 470.0 * camera.directions(pixels, width=320, height=300)
    np.testing.assert_allclose(
        camera.project(points, width=320, height=300)[:, :2], pixels, atol=1e-2
    )


def test_a_stage_without_the_character_is_taken_as_it_stands(hero: Path, tmp_path: Path) -> None:
    make_shot(tmp_path, characters=0)
    camera = camera_of(tmp_path / "shot.usda", hero)
    assert not camera.holds_character
    np.testing.assert_allclose(camera.at(0).eye, [200, 1600, 1000], atol=1e-3)  # metres, Z up


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("/World/rail/none", r"there is no prim </World/rail/none>; its cameras are </World/rail"),
        ("/World/rail", r"</World/rail> is a Xform, no camera; its cameras are"),
    ],
)
def test_a_camera_that_is_not_there_is_told_with_those_that_are(
    hero: Path, tmp_path: Path, name: str, message: str
) -> None:
    with pytest.raises(InputError, match=message):
        camera_of(make_shot(tmp_path), hero, name)


def test_a_stage_without_cameras_says_where_to_look(hero: Path) -> None:
    with pytest.raises(InputError, match=r"it has no camera: name the shot with --camera-stage"):
        camera_of(hero, hero, "/cam")


def test_two_of_one_character_are_refused(hero: Path, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"there 2 times, </World/hero0/rig>, </World/hero1/rig>"):
        camera_of(make_shot(tmp_path, characters=2), hero)


def test_characters_of_one_base_are_told_apart(hero: Path, tmp_path: Path) -> None:
    for name in ("young", "old"):
        stage = Usd.Stage.CreateNew(str(tmp_path / f"{name}.usda"))
        stage.SetDefaultPrim(stage.DefinePrim(f"/{name}"))
        stage.GetDefaultPrim().GetReferences().AddReference("./hero.usda")
        stage.Save()
    shot = make_shot(tmp_path, characters=2)
    layer = Sdf.Layer.FindOrOpen(str(shot))
    for number, name in enumerate(("young", "old")):
        references = layer.GetPrimAtPath(f"/World/hero{number}/rig").referenceList
        references.prependedItems = [Sdf.Reference(f"./{name}.usda")]
    layer.GetAttributeAtPath("/World/hero1.xformOp:scale").default = Gf.Vec3f(0.02)
    layer.Save()
    young, old = (camera_of(shot, tmp_path / f"{name}.usda").at(3).eye for name in ("young", "old"))
    np.testing.assert_allclose(young, 2 * old, rtol=1e-6)


@pytest.mark.parametrize(
    ("attribute", "value", "message"),
    [
        ("focalLength", 0.0, "focal length of 0 see nothing"),
        ("verticalAperture", 0.0, "aperture of 24 × 0"),
    ],
)
def test_a_camera_that_sees_nothing_is_refused(
    hero: Path, tmp_path: Path, attribute: str, value: float, message: str
) -> None:
    shot = make_shot(tmp_path)
    layer = Sdf.Layer.FindOrOpen(str(shot))
    layer.GetAttributeAtPath(f"/World/rail/cam.{attribute}").default = value
    layer.Save()
    with pytest.raises(InputError, match=message):
        camera_of(shot, hero).at(3)


def test_a_flattened_character_is_refused(hero: Path, tmp_path: Path) -> None:
    shot = make_shot(tmp_path)
    layer = Sdf.Layer.FindOrOpen(str(shot))
    layer.GetAttributeAtPath("/World/hero0.xformOp:scale").default = Gf.Vec3f(1, 0, 1)
    layer.Save()
    with pytest.raises(InputError, match="repair the character's place"):
        camera_of(shot, hero).at(3)
