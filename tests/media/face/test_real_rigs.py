from pathlib import Path

import numpy as np
import pytest

from usdface.media.face.camera import frame_rig
from usdface.media.face.parts import FacePart
from usdface.media.face.render import FaceRenderer
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
