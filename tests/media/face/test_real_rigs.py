import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from usdface.core.deformer import Deformer
from usdface.media.face.camera import frame_rig
from usdface.media.face.parts import FacePart
from usdface.media.face.render import FaceRenderer
from usdface.media.face.surface import build_surface
from usdface.usdio.rig.read import read_rig


@pytest.mark.parametrize(
    ("name", "has_stand_in_eyes", "has_teeth"),
    [("facecap_head", True, True), ("ict_face", True, False), ("ict_head", False, True)],
)
def test_heads_without_colours_are_read_as_faces(
    shared_data: Path, name: str, has_stand_in_eyes: bool, has_teeth: bool
) -> None:
    rig = read_rig(shared_data / "rigs" / f"{name}.usdc")
    renderer = FaceRenderer(rig.meshes)
    surface = renderer._surface
    assert surface.has_stand_in_eyes is has_stand_in_eyes
    assert len(surface.eye_centers) == 2
    left, right = surface.eye_centers
    np.testing.assert_allclose(left * [-1, 1, 1], right, atol=0.5)
    assert np.any(surface.parts == FacePart.TEETH) is np.bool_(has_teeth)
    picture = renderer.render(
        np.concatenate([mesh.points for mesh in rig.meshes]),
        camera=frame_rig(rig.meshes),
        width=128,
        height=128,
        quality="draft",
    )
    assert 60 < picture[40:90, 40:90].mean() < 200


@pytest.mark.parametrize("name", ["facecap_head", "ict_face"])
def test_lips_and_brows_are_where_a_person_sees_them(shared_data: Path, name: str) -> None:
    known = json.loads((shared_data / "rigs" / "landmarks.json").read_text("utf-8"))[name]
    surface = build_surface(read_rig(shared_data / "rigs" / f"{name}.usdc").meshes)
    shares = np.random.default_rng(0).dirichlet(np.ones(3), (8, len(surface.triangles)))
    over = np.moveaxis(surface.rest[surface.triangles], 1, 0)
    rest = np.einsum("stk,ktd->std", shares, over).reshape(-1, 3).astype(np.float32)
    bare = np.einsum("stk,tk->st", shares, surface.band_opacity[surface.triangles]).ravel()
    painted = bare * np.max([band.share(rest) for band in surface.bands], axis=0) > 0.1
    assert painted.any()
    x, y, z = rest.T
    mouth, brows = painted & (y < known["nose"][1]), painted & (y > known["nose"][1])
    corner, level = known["mouth_L"]
    np.testing.assert_allclose([x[mouth].min(), x[mouth].max()], [-corner, corner], atol=4.0)
    assert np.abs(y[mouth] - level).max() < 0.5 * corner
    for sign in (-1, 1):
        side = brows & (sign * x > 0)
        assert 5 < y[side].min() - known["lidup_L"][1] < 20
        assert np.ptp(y[side]) < 15
        assert np.abs(x[side]).min() > known["eyein_L"][0] - 8
        assert np.abs(x[side]).max() < known["eyeout_L"][0] + 12
        assert z[side].min() > np.median(surface.rest[:, 2]), "before the head's middle"


def test_brows_move_with_the_skin_of_a_coarse_mesh(shared_data: Path) -> None:
    rig = read_rig(shared_data / "rigs" / "facecap_head.usdc")
    renderer, camera, size = FaceRenderer(rig.meshes), frame_rig(rig.meshes), 200
    whole = renderer._surface
    brow = max(whole.bands, key=lambda band: float(band.rows[:, 0].mean()))
    near = np.flatnonzero(brow.share(whole.rest) * whole.band_opacity > 0.5)
    poses = np.zeros((3, len(rig.shapes)))
    poses[1, rig.shapes.index("browInnerUp")] = 1.0
    poses[2, [rig.shapes.index(f"browDown_{side}") for side in "LR"]] = 1.0
    rows, skin = [], []
    for points in Deformer(rig).points(poses):
        pictures = []
        for bands in (whole.bands, ()):
            renderer._surface = replace(whole, bands=bands)
            picture = renderer.render(
                points, camera=camera, width=size, height=size, quality="draft"
            )
            pictures.append(picture.astype(float).mean(axis=2))
        dark = np.clip(pictures[1] - pictures[0], 0, None)[: size * 2 // 5]
        dark[:, size // 2 :] = 0 if brow.ends[0] < 0 else dark[:, size // 2 :]
        dark[:, : size // 2] = 0 if brow.ends[0] > 0 else dark[:, : size // 2]
        assert dark.max() > 40, "as dark as a brow"
        rows.append(float(dark.sum(axis=1) @ np.arange(len(dark)) / dark.sum()))
        fine = np.asarray(whole.matrix @ points)[near]
        skin.append(float(camera.project(fine, width=size, height=size)[:, 1].mean()))
    np.testing.assert_allclose(np.diff(rows), np.diff(skin), atol=2.0)
    assert rows[1] < rows[0] - 2
    assert rows[2] > rows[0] + 1


def test_a_face_of_its_own_colour_is_not_painted(shared_data: Path) -> None:
    rig = read_rig(shared_data / "rigs" / "facecap_head.usdc")
    own = np.full((len(rig.meshes[0].points), 3), 0.4)
    surface = build_surface((replace(rig.meshes[0], colors=own), *rig.meshes[1:]))
    np.testing.assert_allclose(surface.albedo[: len(own)], 0.4, atol=1e-6)
    assert not surface.bands
