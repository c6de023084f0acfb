"""Camera calibrations, as written by caliscope, anipose and other programs that use OpenCV."""

import tomllib
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from usdface.core.arrays import FloatArray
from usdface.core.errors import InputError
from usdface.core.text import first_few, read_json, read_text, repeated
from usdface.numerics.rigid.camera_views import CameraPose
from usdface.numerics.rigid.perspective import PinholeCamera

_LARGEST_BYTES = 4 << 20
_ROTATION_TOLERANCE = 1e-3
_TERM_COUNT = 5
"""k1, k2, p1, p2, k3; further terms belong to other distortion models."""


@dataclass(frozen=True)
class CalibratedCamera:
    """A camera of a calibration file."""

    camera: PinholeCamera
    size: tuple[int, int] | None
    """Width and height of the calibration pictures [pixels]."""
    pose: CameraPose | None
    """None if the file states intrinsics only."""


def read_calibration(path: Path) -> dict[str, CalibratedCamera]:
    """Read cameras by name: every table of a TOML or JSON file that has a ``matrix``.

    ``matrix`` is OpenCV's 3 × 3 camera matrix [pixels], ``distortions`` k1, k2, p1, p2, k3,
    ``size`` width and height; ``rotation`` (3 × 3, or an axis times an angle in radians) and
    ``translation`` map world to camera space, x to the right, y down, z along the view. A camera's
    name is its ``name`` or else its table's.
    """
    try:
        if path.suffix.lower() == ".json":
            data = read_json(path, _LARGEST_BYTES)
        else:
            data = tomllib.loads(read_text(path, _LARGEST_BYTES))
    except (tomllib.TOMLDecodeError, RecursionError) as error:
        raise InputError(f"{path}: is neither TOML nor named .json: {error}") from error
    tables = data if isinstance(data, dict) else {}
    if isinstance(tables.get("cameras"), dict):
        tables = tables["cameras"]
    named = [
        (str(table.get("name", key)), table)
        for key, table in tables.items()
        if isinstance(table, dict) and "matrix" in table and table.get("ignore") is not True
    ]
    if twice := repeated(name for name, _ in named):
        raise InputError(f"{path}: {len(named)} cameras, of which several are named {twice[0]}")
    cameras = {name: _camera(table, f"{path}: camera {name}") for name, table in named}
    if not cameras:
        raise InputError(
            f"{path}: holds no camera, a table with matrix, distortions, rotation and translation "
            f"(found: {first_few(list(tables)) or 'nothing'}); calibrate with caliscope or anipose"
        )
    return cameras


def _camera(table: dict[str, Any], where: str) -> CalibratedCamera:
    matrix = _numbers(table["matrix"], (3, 3), f"{where}: matrix")
    terms = _numbers(table.get("distortions", [0.0]), (-1,), f"{where}: distortions")
    if table.get("fisheye") is True or np.any(terms[_TERM_COUNT:]):
        raise InputError(
            f"{where}: fisheye distortion, or more terms than k1, k2, p1, p2, k3; calibrate with "
            "these, or undistort the pictures before"
        )
    if not (matrix[0, 0] > 0 and matrix[1, 1] > 0):
        raise InputError(f"{where}: matrix has no focal length in its diagonal; calibrate again")
    camera = PinholeCamera(
        float(matrix[0, 0]),
        (float(matrix[0, 2]), float(matrix[1, 2])),
        tuple(map(float, terms[:_TERM_COUNT])),
        float(matrix[1, 1] / matrix[0, 0]),
    )
    size = None
    if "size" in table:
        width, height = _numbers(table["size"], (2,), f"{where}: size")
        size = (round(width), round(height))
        if min(size) < 1:
            raise InputError(f"{where}: size is {size[0]} x {size[1]} pixels; calibrate again")
    if "rotation" not in table or "translation" not in table:
        return CalibratedCamera(camera, size, None)
    rotation = np.array(table["rotation"], dtype=object)
    shape = (3, 3) if rotation.size == 9 else (3,)
    turn = _numbers(table["rotation"], shape, f"{where}: rotation")
    if shape == (3,):
        turn = Rotation.from_rotvec(turn).as_matrix()
    if np.abs(turn @ turn.T - np.eye(3)).max() > _ROTATION_TOLERANCE or np.linalg.det(turn) < 0:
        raise InputError(f"{where}: rotation is not a rotation matrix; calibrate again")
    shift = _numbers(table["translation"], (3,), f"{where}: translation")
    return CalibratedCamera(camera, size, CameraPose(turn, shift))


def _numbers(value: object, shape: tuple[int, ...], where: str) -> FloatArray:
    try:
        numbers = np.array(value, np.float64).reshape(shape)
    except (TypeError, ValueError) as error:
        raise InputError(f"{where} is {str(value)[:60]}, not numbers {shape}") from error
    if not np.isfinite(numbers).all():
        raise InputError(f"{where} holds NaN or infinity; calibrate again")
    return numbers
