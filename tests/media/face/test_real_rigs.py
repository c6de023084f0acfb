import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from usdface.media.face.camera import frame_rig
from usdface.media.face.parts import FacePart
from usdface.media.face.render import FaceRenderer
from usdface.media.face.surface import build_surface
from usdface.usdio.rig.read import read_rig


@pytest.mark.parametrize(
    ("name", "eyes_put_in", "has_teeth"),
    [("facecap_head", True, True), ("ict_face", True, False), ("ict_head", False, True)],
)
def test_heads_without_colours_are_read_as_faces(
    shared_data: Path, name: str, eyes_put_in: bool, has_teeth: bool
) -> None:
    rig = read_rig(shared_data / "rigs" / f"{name}.usdc")
    renderer = FaceRenderer(rig.meshes)
    surface = renderer.surface
    assert surface.eyes_put_in is eyes_put_in
    assert len(surface.eye_centers) == 2
    left, right = surface.eye_centers
    np.testing.assert_allclose(left * [-1, 1, 1], right, atol=0.5)
    assert np.any(surface.parts == FacePart.TEETH) is np.bool_(has_teeth)
    picture = renderer.render(
        [mesh.points for mesh in rig.meshes],
        camera=frame_rig(rig.meshes),
        width=128,
        height=128,
        quality="draft",
    )
    assert 60 < picture[40:90, 40:90].mean() < 200


@pytest.mark.parametrize(("name", "has_brows"), [("facecap_head", False), ("ict_face", True)])
def test_lips_and_brows_are_where_a_person_sees_them(
    shared_data: Path, name: str, has_brows: bool
) -> None:
    known = json.loads((shared_data / "rigs" / "landmarks.json").read_text("utf-8"))[name]
    rig = read_rig(shared_data / "rigs" / f"{name}.usdc")
    bare = tuple(
        replace(mesh, shapes=tuple(each for each in mesh.shapes if "blink" in each.name.lower()))
        for mesh in rig.meshes
    )
    plain, surface = build_surface(bare), build_surface(rig.meshes)
    skin = np.zeros(len(surface.rest), bool)
    skin[surface.triangles[surface.parts == FacePart.SKIN].ravel()] = True
    painted = skin & (np.abs(surface.albedo - plain.albedo).max(axis=1) > 0.02)
    x, y, z = surface.rest.T
    mouth, brows = painted & (y < known["nose"][1]), painted & (y > known["nose"][1])
    corner, level = known["mouth_L"]
    np.testing.assert_allclose([x[mouth].min(), x[mouth].max()], [-corner, corner], atol=4.0)
    assert np.abs(y[mouth] - level).max() < 0.5 * corner
    assert brows.any() == has_brows, "too few points would make blots"
    for sign in (-1, 1) if has_brows else ():
        side = brows & (sign * x > 0)
        assert 5 < y[side].min() - known["lidup_L"][1] < 20
        assert np.abs(x[side]).min() > known["eyein_L"][0] - 8
        assert np.abs(x[side]).max() < known["eyeout_L"][0] + 12
        assert z[side].min() > np.median(z), "before the head's middle"


def test_a_face_of_its_own_colour_is_not_painted(shared_data: Path) -> None:
    rig = read_rig(shared_data / "rigs" / "facecap_head.usdc")
    own = np.full((len(rig.meshes[0].points), 3), 0.4)
    surface = build_surface((replace(rig.meshes[0], colors=own), *rig.meshes[1:]))
    np.testing.assert_allclose(surface.albedo[: len(own)], 0.4, atol=1e-6)
