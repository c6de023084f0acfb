"""The pictures that sheets and movies are made of: video, markers and faces of one shot."""

from contextlib import ExitStack
from dataclasses import dataclass
from types import TracebackType
from typing import Literal, Self

import numpy as np

from usdface.core.arrays import ByteImage, FloatArray
from usdface.core.assets import Take
from usdface.core.errors import InputError
from usdface.media.face.markers_view import draw_markers, frame_markers
from usdface.media.face.render import FaceRenderer
from usdface.media.face.sculpted_normals import SculptedNormals
from usdface.media.film.image_sequence import ImageSequence, open_video
from usdface.media.film.video import VideoReader
from usdface.media.picture.display_view import DisplayView
from usdface.media.picture.sheet import Tile
from usdface.steps.review.shot import Shot, ShotCamera

RESIDUAL_SCALE = 4.0
"""Lines from markers to where the weights put them are so many times as long: they are short."""

UNDRAWN_TOLD = 3

FRAMED_BY = 2000
"""Frames of a take that its markers are framed by."""


def _spread(take: Take) -> FloatArray:
    """Return markers of frames all over a take: a part of it is framed as the whole is."""
    if take.markers is None:
        raise InputError(f"{take.name}: has no markers")
    step = max(take.frame_count // FRAMED_BY, 1)
    return take.markers.positions[::step].astype(np.float64)


@dataclass(frozen=True)
class Painted:
    """A face painted with distances, and the largest of them [mm]."""

    picture: ByteImage
    largest_mm: float


class ShotPictures:
    """Draws single frames of a shot; holds what all frames share. A context: it opens the video.

    Parameters
    ----------
    height : int
        Of every picture [pixels].
    quality : {'draft', 'final'}
    display : callable, optional
        How rendered light is shown, see `display_view`.
    camera : ShotCamera, optional
        What faces are drawn by; framed on the face by default.
    """

    def __init__(
        self,
        shot: Shot,
        *,
        height: int,
        quality: Literal["draft", "final"],
        display: DisplayView | None = None,
        camera: ShotCamera | None = None,
    ) -> None:
        self._shot = shot
        self._height = height
        self._quality: Literal["draft", "final"] = quality
        self._renderer = FaceRenderer(shot.rig.meshes, display=display)
        self._normals = SculptedNormals(shot.rig, shot.deformer)
        self._camera = camera or shot.camera()
        self._width = self._camera.width(height, int(shot.frames[0]))
        self._cloud = frame_markers(_spread(shot.take))
        self._open = ExitStack()
        self._video: VideoReader | ImageSequence | None = None

    @property
    def stand_in_eyes(self) -> bool:
        """Whether the rig has no eyes and some were put in: a sheet should say so."""
        return self._renderer.eyes_put_in

    @property
    def face_width(self) -> int:
        """Width of pictures of the face [pixels]."""
        return self._width

    @property
    def video_aspect(self) -> float:
        """Width over height of the video's pictures; 16 to 9 where none can be decoded."""
        try:
            picture = None if self._video is None else self._video.frame_at(0.0)
        except InputError:
            picture = None
        return 16 / 9 if picture is None else picture.shape[1] / picture.shape[0]

    def __enter__(self) -> Self:
        video = self._shot.take.video
        if video is not None:
            self._video = open_video(video.file, video.rate)
            self._open.enter_context(self._video)
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._open.close()

    def video(self, frame: int) -> Tile:
        """Find the video's picture at a frame of the take, by the clock that aligns the two."""
        take = self._shot.take
        if take.video is None or self._video is None:
            return Tile(None, caption="no video")
        seconds = (frame - take.first_frame) / float(take.rate)
        at = take.video.video_time(seconds)
        try:
            picture = self._video.frame_at(at)
        except InputError:
            return Tile(None, caption="cannot be decoded")
        return Tile(picture, caption="" if picture is not None else "no video here")

    def markers(self, row: int, *, explained: FloatArray | None = None) -> ByteImage:
        """Draw the markers of a row, with lines to where the weights put them."""
        markers = self._shot.take.markers
        if markers is None:
            raise InputError(f"{self._shot.take.name}: has no markers")
        at = int(self._shot.frames[row]) - self._shot.take.first_frame
        return draw_markers(
            markers.positions[at].astype(np.float64),
            width=self._height,
            height=self._height,
            frame=self._cloud,
            visible=markers.visible[at],
            explained=explained,
            exaggeration=RESIDUAL_SCALE,
        )

    def face(self, row: int, weights: FloatArray) -> ByteImage:
        """Draw the rig at one set of weights, (shapes,), as a row's frame sees it."""
        return self._renderer.render(
            self._shot.deformer.points(weights[None])[0],
            camera=self._camera.at(int(self._shot.frames[row])),
            width=self._width,
            height=self._height,
            quality=self._quality,
            sculpted=self._normals.at(weights),
        )

    def difference(
        self, row: int, weights: FloatArray, other: FloatArray, *, high_mm: float
    ) -> Painted:
        """Paint on the rig how far its surface lies from where other weights put it."""
        ours = self._shot.deformer.points(weights[None])[0]
        theirs = self._shot.deformer.points(other[None])[0]
        away = np.linalg.norm(np.asarray(ours) - np.asarray(theirs), axis=-1)
        picture = self._renderer.render(
            ours,
            camera=self._camera.at(int(self._shot.frames[row])),
            width=self._width,
            height=self._height,
            quality="draft",
            values=away,
            value_range=(0.0, high_mm),
        )
        return Painted(picture, float(away.max(initial=0.0)))
