"""The stand-in for the witness camera: the actor filmed while speaking, with sound."""

from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from fractions import Fraction
from pathlib import Path

import numpy as np

from usdface.core.arrays import ByteImage, FloatArray, IntArray
from usdface.core.progress import Progress, silent
from usdface.demo.acting import ActedPerformance
from usdface.demo.capture import ActorFace, head_poses
from usdface.demo.head import DemoHead, HeadPart
from usdface.demo.rig import mesh_points, rig_from_head
from usdface.demo.script import DURATION_SECONDS
from usdface.demo.voice import speak
from usdface.media.face.camera import Camera
from usdface.media.face.render import FaceRenderer
from usdface.media.film.movie import write_movie

VIDEO_RATE = Fraction(24)
SIZE = (216, 240)
"""Width and height of the clip [pixels]."""

OFFSET_SECONDS = -0.4
"""Take time of the clip's first frame: the camera ran before the capture did."""

TAIL_SECONDS = 0.25
"""How long the camera went on after the capture."""

_SAMPLE_RATE = 48000
_CAMERA = Camera(eye=(190.0, 1512.0, 1290.0), target=(60.0, 1503.0, 150.0), fov_degrees=14.2)


class Studio:
    """The actor in front of the camera; kept by each process that draws."""

    def __init__(self, head: DemoHead) -> None:
        kept, light = _lighter(head)
        self._face = ActorFace(head, kept)
        self._renderer = FaceRenderer(rig_from_head(light).meshes)
        self._order = np.concatenate(list(mesh_points(light).values()))

    def film(self, pose: FloatArray, weights: FloatArray) -> ByteImage:
        """Draw one picture: (4, 4) pose in the room, weights in `ActorFace`'s order."""
        points = self._face.pose(weights)[self._order] @ pose[:3, :3].T + pose[:3, 3]
        return self._renderer.render(
            points, camera=_CAMERA, width=SIZE[0], height=SIZE[1], quality="draft"
        )


def _lighter(head: DemoHead) -> tuple[IntArray, DemoHead]:
    """Leave out the skin's last refinement, too fine for a small picture.

    Returns the points that are kept, which lie where they lay, and the head made of them.
    """
    skin = np.all(head.parts[head.faces] == HeadPart.SKIN, axis=1)
    # Refining cuts a quad into four, one at each corner, and each begins with that corner.
    coarse = np.concatenate([head.faces[skin][:, 0].reshape(-1, 4), head.faces[~skin]])
    kept, faces = np.unique(coarse, return_inverse=True)
    own = np.arange(len(kept))
    light = replace(
        head,
        points=head.points[kept],
        faces=faces.reshape(-1, 4),
        parts=head.parts[kept],
        marks=head.marks[kept],
        colors=head.colors[kept],
        mirror=own,
        anchors=own,
        shapes={},
    )
    return kept, light


def write_clip(
    path: Path,
    head: DemoHead,
    acted: ActedPerformance,
    *,
    workers: int = 1,
    progress: Progress = silent,
) -> None:
    """Film the actor's performance.

    Parameters
    ----------
    path : Path
        ``.mp4`` or another movie that `usdface.media.film.movie` writes.
    head : DemoHead
        Of the actor.
    workers : int
        Processes that draw.
    """
    rate = float(acted.weights.rate)
    count = int((DURATION_SECONDS + TAIL_SECONDS - OFFSET_SECONDS) * VIDEO_RATE)
    take_time = np.arange(count) / float(VIDEO_RATE) + OFFSET_SECONDS
    frames = np.clip(np.round(take_time * rate), 0, len(acted.weights.values) - 1).astype(int)
    ordered = ActorFace(head, np.zeros(1, np.int64)).ordered(
        acted.weights.names, acted.weights.values[frames].astype(np.float64)
    )
    poses = head_poses(acted)[frames]
    lead = np.zeros(round(-OFFSET_SECONDS * _SAMPLE_RATE), np.float32)
    voice = speak(_SAMPLE_RATE)
    tail = np.zeros(round(TAIL_SECONDS * _SAMPLE_RATE), np.float32)
    room = np.random.default_rng(7).standard_normal(len(lead) + len(voice) + len(tail))
    sound = np.concatenate([lead, voice, tail]) + 6e-4 * room.astype(np.float32)
    write_movie(
        path,
        _drawn(head, poses, ordered, workers=workers, progress=progress),
        rate=VIDEO_RATE,
        audio=sound.astype(np.float32),
        sample_rate=_SAMPLE_RATE,
    )


def _drawn(
    head: DemoHead, poses: FloatArray, weights: FloatArray, *, workers: int, progress: Progress
) -> Iterator[ByteImage]:
    """Draw all pictures in order."""
    if workers > 1:
        with ProcessPoolExecutor(workers, initializer=_open_studio, initargs=(head,)) as pool:
            yield from _track(pool.map(_film, poses, weights, chunksize=8), len(poses), progress)
    else:
        yield from _track(map(Studio(head).film, poses, weights), len(poses), progress)


def _track(pictures: Iterator[ByteImage], count: int, progress: Progress) -> Iterator[ByteImage]:
    for number, picture in enumerate(pictures, start=1):
        yield picture
        if number % 8 == 0 or number == count:
            progress(number / count, "filming the actor")


_studio: Studio | None = None  # of this process, where it is one of several that draw


def _open_studio(head: DemoHead) -> None:
    global _studio
    _studio = Studio(head)


def _film(pose: FloatArray, weights: FloatArray) -> ByteImage:
    if _studio is None:
        raise RuntimeError("this process was started without an actor to film")
    return _studio.film(pose, weights)
