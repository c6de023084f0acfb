"""Cameras of tracked videos: from a calibration, from options, or from the file's metadata."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from usdface.capture.camera_calibration import CalibratedCamera, read_calibration
from usdface.core.errors import InputError
from usdface.core.text import first_few, pluralize
from usdface.media.film.take_video import OpenVideo
from usdface.media.film.video import VideoReader
from usdface.numerics.rigid.perspective import PinholeCamera
from usdface.specs.capture import TrackSpec

DEFAULT_FOCAL_LENGTH = 28.0
"""35 mm equivalent [mm]: phones film with 23 to 31 mm, more with stabilised pictures."""
_FILM_DIAGONAL = float(np.hypot(36.0, 24.0))
"""[mm]"""


_SAME_SHAPE = 0.01
"""Relative difference of the aspect ratio above which a picture was cropped."""


def resolve_cameras(
    spec: TrackSpec, videos: Sequence[OpenVideo]
) -> tuple[list[CalibratedCamera], list[str]]:
    """Return the camera of each video, and notes on its source."""
    if spec.calibration is None:
        camera, note = _lens(spec, videos[0])
        return [CalibratedCamera(camera, None, None)], [note]
    known = read_calibration(spec.calibration)
    names = spec.cameras or tuple(known)
    if len(names) != len(videos):
        raise InputError(
            f"{spec.calibration}: {pluralize(len(names), 'camera')}, {first_few(list(names))}, for "
            f"{pluralize(len(videos), 'video')}; name the camera of each with --cameras, in order"
        )
    if unknown := [name for name in names if name not in known]:
        raise InputError(
            f"{spec.calibration}: has no camera {unknown[0]!r}; there are {first_few(list(known))}"
        )
    cameras = []
    for name, video in zip(names, videos, strict=True):
        where = f"{spec.calibration}: camera {name}"
        if len(videos) > 1 and known[name].pose is None:
            raise InputError(
                f"{where} has no rotation and translation; calibrate the cameras together"
            )
        cameras.append(_at_size(known[name], video, where))
    pairs = [
        f"{Path(video.path).name} by {name}" for video, name in zip(videos, names, strict=True)
    ]
    return cameras, [f"cameras of {spec.calibration.name}: {', '.join(pairs)}"]


def _at_size(found: CalibratedCamera, video: OpenVideo, where: str) -> CalibratedCamera:
    """Return a calibrated camera scaled to the size of a video's pictures."""
    width, height = _picture_size(video)
    camera = found.camera
    if found.size is not None and found.size != (width, height):
        across, down = width / found.size[0], height / found.size[1]
        if abs(across / down - 1) > _SAME_SHAPE:
            raise InputError(
                f"{video.path}: is {width} × {height}, and {where} was calibrated at "
                f"{found.size[0]} × {found.size[1]}; give the original video, neither cropped nor "
                "rotated, or name its camera with --cameras"
            )
        center = (camera.center[0] * across, camera.center[1] * down)
        camera = replace(camera, focal_pixels=camera.focal_pixels * across, center=center)
    _check_unfolded(where, camera, width, height)
    return replace(found, camera=camera)


def _picture_size(video: OpenVideo) -> tuple[int, int]:
    """Return width and height."""
    picture = video.frame_at(float(video.times[0]))
    assert picture is not None
    return picture.shape[1], picture.shape[0]


def _lens(spec: TrackSpec, video: OpenVideo) -> tuple[PinholeCamera, str]:
    """Return the camera of options or the file's metadata, and a note on its focal length."""
    width, height = _picture_size(video)
    focal = spec.focal_length
    if focal is None and isinstance(video, VideoReader):
        focal = video.focal_length
    if focal is None:
        focal = DEFAULT_FOCAL_LENGTH
        note = (
            f"the file states no focal length; {focal:g} mm (35 mm equivalent) is assumed for "
            "undoing perspective: give it with --focal-length"
        )
    else:
        note = f"perspective undone for a 35 mm equivalent focal length of {focal:g} mm"
    pixels = focal / _FILM_DIAGONAL * float(np.hypot(width, height))
    camera = PinholeCamera(pixels, (width / 2, height / 2), spec.distortion)
    terms = ",".join(f"{term:g}" for term in spec.distortion)
    _check_unfolded(f"{spec.video}: --distortion {terms}", camera, width, height)
    return camera, note


def _check_unfolded(where: str, camera: PinholeCamera, width: int, height: int) -> None:
    """Refuse a distortion that is not invertible within the picture."""
    across, down = np.meshgrid(np.linspace(0, width, 33), np.linspace(0, height, 33))
    grid = np.stack([across.ravel(), down.ravel()], axis=1)
    folded = np.isnan(camera.undistort(grid)).any(axis=1)
    if folded.any():
        nearest = grid[folded][np.linalg.norm(grid[folded] - camera.center, axis=1).argmin()]
        raise InputError(
            f"{where} with a focal length of {camera.focal_pixels:.0f} pixels cannot be inverted "
            f"at {nearest[0]:.0f}, {nearest[1]:.0f}, where it folds the picture; give the terms in "
            "OpenCV's order, k1,k2,p1,p2,k3, with the focal length of the same calibration"
        )
