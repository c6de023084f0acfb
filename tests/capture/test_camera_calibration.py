"""Calibrations of cameras: as caliscope and anipose write them, and what is wrong with others."""

import json
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from usdface.capture.camera_calibration import read_calibration
from usdface.core.errors import InputError

TURN = Rotation.from_rotvec([0.1, -0.4, 0.2])
LENS = """matrix = [[900.0, 0.0, 630.0], [0.0, 909.0, 350.0], [0.0, 0.0, 1.0]]
distortions = [-0.3, 0.1, 0.001, 0.003, -0.004]
size = [1280, 720]
translation = [-0.6, 0.2, 1.4]
"""
CALISCOPE = f"""[cameras.0]
cam_id = 0
rotation_count = 0
error = 0.2
ignore = false
verified_resolutions = [[640, 480], [1280, 720]]
{LENS}rotation = {TURN.as_matrix().tolist()}

[cameras.1]
ignore = true
{LENS}
"""
ANIPOSE = f"""[cam_0]
name = "front"
fisheye = false
{LENS}rotation = {TURN.as_rotvec().tolist()}

[metadata]
adjusted = false
"""


@pytest.mark.parametrize(("text", "name"), [(CALISCOPE, "0"), (ANIPOSE, "front")])
def test_cameras_are_read_as_tools_write_them(tmp_path: Path, text: str, name: str) -> None:
    path = tmp_path / "camera_array.toml"
    path.write_text(text)
    (found,) = read_calibration(path).items()
    assert found[0] == name
    camera = found[1].camera
    assert (camera.focal_pixels, camera.center, found[1].size) == (900, (630, 350), (1280, 720))
    assert camera.distortion == (-0.3, 0.1, 0.001, 0.003, -0.004)
    assert camera.aspect == pytest.approx(1.01)
    np.testing.assert_allclose(found[1].pose.rotation, TURN.as_matrix(), atol=1e-12)
    np.testing.assert_array_equal(found[1].pose.translation, [-0.6, 0.2, 1.4])


def test_json_says_the_same_and_a_lens_needs_no_place(tmp_path: Path) -> None:
    path = tmp_path / "lens.json"
    path.write_text(json.dumps({"a": {"matrix": [[900, 0, 640], [0, 900, 360], [0, 0, 1]]}}))
    camera = read_calibration(path)["a"]
    assert camera.pose is None
    assert camera.size is None


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("matrix = [[", "matrix = [[[", r"is neither TOML nor named \.json"),
        ("[[900.0, 0.0, 630.0], ", "[", r"camera front: matrix is .*, not numbers \(3, 3\)"),
        ("[[900.0,", "[[nan,", r"camera front: matrix holds NaN"),
        ("[[900.0,", "[[-900.0,", r"matrix has no focal length in its diagonal"),
        ("fisheye = false", "fisheye = true", r"fisheye distortion, or more terms than k1, k2"),
        ("-0.004]", "-0.004, 0.2]", r"fisheye distortion, or more terms than k1, k2, p1, p2, k3"),
        ("rotation = [", "rotation = [1, 0, 0, 0, 1, 0, 0, 0, 2] #", r"is not a rotation matrix"),
        ("matrix", "matricks", r"holds no camera, .*found: cam_0, metadata"),
        ("size = [", "size = [0, 720] # [", r"camera front: size is 0 x 720 pixels"),
    ],
)
def test_what_is_no_calibration_is_said(tmp_path: Path, old: str, new: str, message: str) -> None:
    assert old in ANIPOSE
    path = tmp_path / "calibration.toml"
    path.write_text(ANIPOSE.replace(old, new))
    with pytest.raises(InputError, match=message):
        read_calibration(path)


def test_two_cameras_of_one_name_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "calibration.toml"
    path.write_text(ANIPOSE + ANIPOSE.replace("cam_0", "cam_1").replace("metadata", "more"))
    with pytest.raises(InputError, match="2 cameras, of which several are named front"):
        read_calibration(path)
