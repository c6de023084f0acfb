"""What a page unpacks is the rig: read back here by a second route, and by a real browser."""

import json
import zlib
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.browser import evaluate_array
from tests.media.forms import head, sphere
from tests.usdio.driven_rig import driven_rig
from tests.usdio.small_rig import small_rig
from usdface.core.assets import MeshShape, Rig, RigMesh, ShapeKey
from usdface.core.deformer import Deformer
from usdface.core.rig_logic import Combination, order_combinations
from usdface.media.face.camera import Camera, frame_rig
from usdface.media.face.render import FaceRenderer
from usdface.media.face.surface import build_surface
from usdface.media.page.face_payload import FacePayload, pack_face, viewer_source
from usdface.usdio.rig.read import read_rig

ROUNDING_MM = 0.6e-3
RANGES = np.array([[0.0, 1.0], [0.0, 1.0]])


def far_rig() -> Rig:
    """The small rig with a shape that moves a point further than sixteen bits of micrometres."""
    rig = small_rig()
    skin = rig.meshes[0]
    offsets = np.array([[0.0, -41.7, 3.2], [50.0, 0.25, 0.0]])
    far = MeshShape("jawOpen", (ShapeKey(1.0, np.array([0, 11]), offsets),))
    mesh = RigMesh(**(vars(skin) | {"shapes": (far, *skin.shapes[1:])}))
    return Rig(**(vars(rig) | {"meshes": (mesh, *rig.meshes[1:])}))


def unpack(payload: FacePayload) -> dict[str, Any]:
    raw = zlib.decompress(payload.data)
    arrays = {}
    for name, place in payload.header["arrays"].items():
        arrays[name] = np.frombuffer(
            raw, f"<{place['type']}", place["count"], offset=place["start"]
        )
    return arrays


def key_offsets(payload: FacePayload) -> np.ndarray:
    """Every key's offsets, dense: (keys, points, 3) [mm]."""
    arrays, count = unpack(payload), payload.header["points"]
    starts = {"keyPoints": 0, False: 0, True: 0}
    dense = []
    for track in payload.header["tracks"]:
        for moved, wide in zip(track["counts"], track["wide"], strict=True):
            source = arrays["offsets32" if wide else "offsets16"]
            first = starts[wide]
            planes = source[first : first + 3 * moved].reshape(3, moved)
            points = arrays["keyPoints"][starts["keyPoints"] :][:moved].cumsum()
            starts[wide] += 3 * moved
            starts["keyPoints"] += moved
            one = np.zeros((count, 3))
            one[points] = np.cumsum(planes, axis=1, dtype=source.dtype).T * 1e-3
            dense.append(one)
    return np.array(dense)


def drawn(rig: Rig, weights: np.ndarray) -> np.ndarray:
    """Where the renderer puts the drawn points: the second route."""
    surface = build_surface(rig.meshes)
    points = np.asarray(surface.matrix @ Deformer(rig).points(weights[None])[0])
    return points[np.unique(surface.triangles)]


@pytest.mark.parametrize("rig", [small_rig(), far_rig()], ids=["narrow", "wide"])
def test_keys_come_back_within_rounding(rig: Rig) -> None:
    payload = pack_face(rig)
    surface = build_surface(rig.meshes)
    used = np.unique(surface.triangles)
    cage = Deformer(rig).shapes.key_offsets.toarray().reshape(-1, surface.matrix.shape[1], 3)
    expected = np.array([(surface.matrix @ key)[used] for key in cage])
    assert np.abs(key_offsets(payload) - expected).max() <= ROUNDING_MM
    assert any(any(t["wide"]) for t in payload.header["tracks"]) == (np.abs(cage).max() > 32.767)


def test_the_neutral_comes_back_within_rounding() -> None:
    rig = small_rig()
    payload = pack_face(rig)
    planes = unpack(payload)["neutral"].reshape(3, -1)
    neutral = planes.cumsum(axis=1).T * 1e-3
    assert np.abs(neutral - drawn(rig, np.zeros(3))).max() <= ROUNDING_MM


def test_shapes_carry_names_and_ranges() -> None:
    payload = pack_face(small_rig())
    smile = payload.header["shapes"][2]
    assert smile == {"name": "smile", "region": "mouth", "low": -0.5, "high": 1.5}


def test_arrays_are_aligned_so_that_a_browser_may_view_them() -> None:
    for place in pack_face(far_rig()).header["arrays"].values():
        assert place["start"] % int(place["type"][1:]) == 0


def test_a_header_cannot_end_the_script_it_stands_in() -> None:
    payload = FacePayload({"shapes": [{"name": "</script><script>alert(1)//"}]}, b"")
    assert "</script" not in payload.header_json()
    assert json.loads(payload.header_json()) == payload.header


def test_the_viewer_as_one_module_imports_nothing() -> None:
    source = viewer_source()
    assert "import " not in "\n".join(
        line for line in source.splitlines() if not line.lstrip().startswith(("//", "*"))
    )
    assert source.count("class FaceViewer") == 1


def embed(folder: Path, rig: Rig, *, camera: Camera | None = None) -> Path:
    """A page that carries everything inside, as a report does."""
    payload = pack_face(rig, camera=camera)
    page = folder / "face.html"
    page.write_text(
        "<!doctype html><meta charset='utf-8'>"
        "<style>canvas{width:300px;height:300px;background:#222}</style>"
        "<canvas tabindex='0'></canvas>"
        f"<script id='header' type='application/json'>{payload.header_json()}</script>"
        f"<script id='data' type='text/plain'>{payload.data_base64()}</script>"
        f"<script type='module'>{viewer_source()}\n"
        "const text = (id) => document.getElementById(id).textContent;"
        "const face = await unpackFace(JSON.parse(text('header')), bytesFromBase64(text('data')));"
        "window.viewer = new FaceViewer(document.querySelector('canvas'), face);"
        "</script>",
        encoding="utf-8",
    )
    return page


def test_a_browser_poses_the_face_as_the_deformer_does(
    tmp_path: Path, shared_rig: Rig, browser: Any
) -> None:
    rig = shared_rig
    weights = np.random.default_rng(0).uniform(-0.2, 1.1, len(rig.shapes)).astype(np.float32)
    page = browser.new_page()
    faults: list[str] = []
    page.on("pageerror", lambda error: faults.append(str(error)))
    page.goto(embed(tmp_path, rig).as_uri())
    page.wait_for_function("window.viewer")
    posed = evaluate_array(
        page,
        "w => { viewer.setWeights(Float32Array.from(w)); viewer.draw();"
        " return viewer.face.positions; }",
        weights.tolist(),
    )
    shown = page.evaluate("viewer.thumbnail(viewer.weights, 64, 64).data.some((v) => v > 60)")
    page.evaluate("window.lose = viewer.gl.getExtension('WEBGL_lose_context'); lose.loseContext()")
    page.wait_for_function("viewer.gl.isContextLost()")
    page.evaluate("lose.restoreContext()")
    page.wait_for_function("!viewer.gl.isContextLost()")
    again = page.evaluate("viewer.thumbnail(viewer.weights, 64, 64).data.some((v) => v > 60)")
    away = np.reshape(posed, (-1, 3)) - drawn(rig, weights.astype(np.float64))
    assert not faults
    assert np.abs(away).max() < 0.02  # rounding of every key in play, and single precision
    assert shown
    assert again


def test_a_browser_draws_lips_and_brows_where_pictures_have_them(
    tmp_path: Path, shared_data: Path, browser: Any
) -> None:
    rig = read_rig(shared_data / "rigs" / "facecap_head.usdc")
    weights = np.zeros((1, len(rig.shapes)))
    weights[0, rig.shapes.index("browInnerUp")] = 1.0
    renderer, camera, size = FaceRenderer(rig.meshes), frame_rig(rig.meshes), 160
    points, whole = Deformer(rig).points(weights)[0], renderer._surface
    pictures = []
    for bands in (whole.bands, ()):
        renderer._surface = replace(whole, bands=bands)
        pictures.append(renderer.render(points, camera=camera, width=size, height=size))
    expected = np.abs(np.subtract(*pictures, dtype=float)).max(axis=2) > 25
    page = browser.new_page()
    page.goto(embed(tmp_path, rig, camera=camera).as_uri())
    page.wait_for_function("window.viewer")
    draw = f"w => viewer.thumbnail(Float32Array.from(w), {size}, {size}).data"
    shown = [evaluate_array(page, draw, weights[0].tolist()).reshape(size, size, 4)]
    page.evaluate("viewer.face.bands = []")
    shown.append(evaluate_array(page, draw, weights[0].tolist()).reshape(size, size, 4))
    drawn_there = np.abs(np.subtract(*shown, dtype=float)).max(axis=2) > 25
    assert expected[:60].sum() > 50, "brows"
    assert expected[60:].sum() > 50, "lips"
    for half in (slice(0, 60), slice(60, None)):
        both = (drawn_there & expected)[half].sum()
        assert both > 0.8 * (drawn_there | expected)[half].sum()


def test_a_browser_evaluates_combinations_as_the_rig_does(tmp_path: Path, browser: Any) -> None:
    rng = np.random.default_rng(2)
    names = [("half", "smooth", (0.5, 1.0)), ("lip", "minimum", (1.0, 0.3)), ("both", "smooth", ())]
    parts = [("jawOpen", "smile"), ("smile", "eyeBlink"), ("half", "jaw_smile")]
    more = tuple(
        Combination(name, driving, mode, weights)
        for (name, mode, weights), driving in zip(names, parts, strict=True)
    )
    rig = driven_rig()
    skin = rig.meshes[0]
    keys = [
        MeshShape(each.shape, (ShapeKey(1.0, np.arange(5), rng.normal(0, 4, (5, 3))),))
        for each in more
    ]
    meshes = (replace(skin, shapes=(*skin.shapes, *keys)), *rig.meshes[1:])
    every = order_combinations(
        (*rig.combinations, *more), [each.name for each in meshes[0].shapes], source="test"
    )
    rig = replace(rig, meshes=meshes, combinations=every)
    corners = np.stack(np.meshgrid(*[[-0.3, 0.0, 0.25, 0.5, 1.0, 1.3]] * 3), -1).reshape(-1, 3)
    poses = np.concatenate([corners, rng.uniform(-0.2, 1.2, (100, 3))])
    page = browser.new_page()
    page.goto(embed(tmp_path, rig).as_uri())
    page.wait_for_function("window.viewer")
    posed = page.evaluate(
        "rows => rows.map(w => (viewer.face.pose(w), Array.from(viewer.face.positions)))",
        poses.tolist(),
    )
    expected = np.array([drawn(rig, pose) for pose in poses])
    np.testing.assert_allclose(np.reshape(posed, expected.shape), expected, atol=0.02)
    assert rig.logic.evaluate(poses)[:, len(rig.shapes) :].max(axis=0).min() > 0.2


def test_a_page_first_sees_the_face_from_where_the_camera_stands(
    tmp_path: Path, browser: Any
) -> None:
    camera = Camera(eye=(90.0, 60.0, 200.0), target=(15.0, 10.0, 0.0), fov_degrees=30.0)
    flat = Camera(eye=(0.0, 0.0, 100.0), target=(0.0, 0.0, 0.0), span_mm=80.0)
    home = pack_face(small_rig(), camera=flat).header["camera"]
    assert 2 * home["distance"] * np.tan(np.radians(home["fov"] / 2)) == pytest.approx(80.0)
    page = browser.new_page()
    page.goto(embed(tmp_path, small_rig(), camera=camera).as_uri())
    page.wait_for_function("window.viewer")
    view = np.reshape(page.evaluate("[...viewer.camera.view()]"), (4, 4)).T
    page.evaluate("viewer.draw()")
    column, row, away = page.evaluate("viewer.project(15, 10, 0)")
    eye = -view[:3, :3].T @ view[:3, 3]
    np.testing.assert_allclose(eye, camera.eye, atol=0.05)
    assert (column, row) == pytest.approx((150, 150), abs=0.1)
    assert away == pytest.approx(np.linalg.norm(np.subtract(camera.eye, camera.target)), abs=0.05)


def test_a_page_of_any_form_first_shows_the_whole_head(tmp_path: Path, browser: Any) -> None:
    face = head()
    hair = sphere(60.0, path="/Hair")
    hair = replace(hair, points=hair.points + np.array([0.0, 80.0, -30.0]))
    rig = replace(small_rig(), meshes=(face, hair), shapes=("jawOpen", "browUp"), ranges=RANGES)
    corners = np.concatenate([face.points, hair.points])
    heights = []
    page = browser.new_page()
    page.goto(embed(tmp_path, rig).as_uri())
    page.wait_for_function("window.viewer")
    page.evaluate("(text) => { window.corners = JSON.parse(text); }", json.dumps(corners.tolist()))
    for width, height in ((200, 500), (300, 375), (500, 300)):
        shown = evaluate_array(
            page,
            "([width, height]) => {"
            " viewer.canvas.style.cssText = `width: ${width}px; height: ${height}px`;"
            " viewer.draw();"
            " return Float32Array.from(corners.flatMap((each) => viewer.project(...each))); }",
            [width, height],
        )
        columns, rows, _ = shown.reshape(-1, 3).T
        assert 0 < columns.min() < columns.max() < width
        assert 0 < rows.min()
        heights.append((np.ptp(columns), np.ptp(rows), width, height))
    narrow, tall, wide = heights
    assert narrow[0] > 0.8 * narrow[2], "as near as its width allows"
    assert tall[1] / tall[3] == pytest.approx(wide[1] / wide[3], rel=0.01), "by its height"


@pytest.mark.slow
def test_what_lies_behind_the_skin_does_not_show_through_as_specks(
    tmp_path: Path, browser: Any
) -> None:
    # Triangles at the rim of a ball are seen edge on: their depth changes by millimetres within
    # a pixel, and where it is taken beyond a triangle's edge it may come out before the skin.
    rig = small_rig()
    skin = replace(rig.meshes[0], points=3 * rig.meshes[0].points, colors=np.ones((12, 3)))
    balls = []
    for x in (32.0, 45.0, 58.0):
        for y in (17.0, 30.0, 43.0):
            ball = sphere(6.0, rows=24, path=f"/Hero/ball_{len(balls)}")
            points = ball.points[:, [0, 2, 1]] * [1, -1, 1] + [x, y, -9.0]  # a pole looks at us
            balls.append(replace(ball, points=points, colors=np.zeros_like(points)))
    camera = Camera(eye=(45.0, 30.0, 300.0), target=(45.0, 30.0, 0.0), fov_degrees=9.0)
    page = browser.new_page(device_scale_factor=1)
    page.goto(embed(tmp_path, replace(rig, meshes=(skin, *balls)), camera=camera).as_uri())
    page.wait_for_function("window.viewer")
    levels = evaluate_array(
        page,
        "() => { viewer.draw(); const { gl, canvas } = viewer;"
        " const levels = new Uint8Array(4 * canvas.width * canvas.height);"
        " gl.readPixels(0, 0, canvas.width, canvas.height, gl.RGBA, 5121, levels);"
        " return levels; }",
    ).reshape(300, 300, 4)
    assert np.all(levels[..., 3] == 255), "the skin does not fill the picture"
    around = np.median(levels[..., 1])
    assert np.abs(levels[..., 1] - around).max() < 12


@pytest.fixture(params=["small", "recorded"])
def shared_rig(request: pytest.FixtureRequest) -> Rig:
    if request.param == "small":
        return small_rig()
    data: Path = request.getfixturevalue("shared_data")
    return read_rig(data / "rigs" / "facecap_head.usdc")
