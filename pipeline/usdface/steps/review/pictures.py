"""Draw single frames of a shot for sheets and movies: video, markers and faces."""

from contextlib import ExitStack, suppress
from copy import copy
from functools import cached_property
from typing import Any, Literal, Self

import numpy as np

from usdface.core.arrays import BoolArray, ByteImage, FloatArray, IntArray
from usdface.core.assets import Markers
from usdface.core.errors import InputError
from usdface.media.face.camera import Camera
from usdface.media.face.markers_view import (
    MarkersFrame,
    draw_marker_lines,
    draw_markers,
    frame_markers,
)
from usdface.media.face.render import FaceRenderer
from usdface.media.face.sculpted_normals import SculptedNormals
from usdface.media.film.timed_frames import OpenVideo
from usdface.media.film.video import open_video, picture_at_frame
from usdface.media.picture.canvas import draw_dot, draw_line
from usdface.media.picture.color import BLUE, BRIGHT, ORANGE
from usdface.media.picture.image import DisplayView
from usdface.media.picture.sheet import Tile
from usdface.model.selection.baseline import BlendshapeEquation
from usdface.steps.inputs.marker_lines import lines_on_rig, marker_lines
from usdface.steps.review.shot import Shot, ShotCamera

_LAST_PICTURES = 2
"""Cached pictures of the face: the solve, which is drawn twice, and the baseline."""

FRAMING_FRAMES = 2000
"""Largest number of frames used to frame the markers of a take."""


def repaired_markers(markers: Markers, at: int) -> BoolArray:
    """Return which markers of a row of their take are filled or corrected."""
    return np.asarray(~markers.visible[at] | (markers.confidence[at] < 1))


class ShotPictures:
    """Draws single frames of a shot; as a context manager, keeps its video open.

    `height`: of every picture [pixels]. `display`: transform of renders, see `display_view`.
    Attributes: `face_width`, of pictures of the face [pixels], and `stand_in_eyes`, whether the rig
    has no eyes and stand-ins are drawn.
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
        self.stand_in_eyes = self._renderer.has_stand_in_eyes
        self._normals = SculptedNormals(shot.rig, shot.deformer)
        self._camera = camera or shot.camera()
        self.face_width = self._camera.width(height, int(shot.frames[0]))
        self._last: dict[tuple[Camera, bytes, int | None], ByteImage] = {}
        self._placed_lines: IntArray | None = None
        self._open = ExitStack()
        self._video: OpenVideo | None = None

    def for_thread(self) -> Self:
        """Return one for another thread, which shares all that does not depend on the row."""
        other = copy(self)
        other._renderer, other._last, other._open = copy(self._renderer), {}, ExitStack()
        return other

    @cached_property
    def _framing(self) -> tuple[MarkersFrame, IntArray]:
        """The frame of the markers of the whole take, and their lines."""
        markers = self._shot.markers
        step = max(len(markers.positions) // FRAMING_FRAMES, 1)
        positions = markers.positions[::step].astype(np.float64)
        return frame_markers(positions), marker_lines(markers.names, positions[0])

    @property
    def video_aspect(self) -> float:
        """Aspect ratio of the video's pictures; 16:9 if the first cannot be decoded."""
        if self._video is not None:
            with suppress(InputError):
                height, width = self._video.frame(0).shape[:2]
                return width / height
        return 16 / 9

    def __enter__(self) -> Self:
        video = self._shot.take.video
        if video is not None:
            self._video = self._open.enter_context(open_video(video.file, video.rate))
        return self

    def __exit__(self, *exception: object) -> None:
        self._open.close()

    def video(self, frame: float) -> Tile:
        """Return the video's picture at a frame of the take, or between two."""
        picture, reason = picture_at_frame(self._shot.take, self._video, frame)
        return Tile(picture, caption=reason)

    def markers(self, row: int) -> ByteImage:
        """Draw the markers of a row."""
        markers, (frame, lines) = self._shot.markers, self._framing
        at = int(self._shot.frames[row]) - self._shot.take.first_frame
        return draw_markers(
            markers.positions[at].astype(np.float64),
            width=self._height,
            height=self._height,
            frame=frame,
            visible=markers.visible[at],
            lines=lines,
        )

    def markers_on_face(self, row: int, equation: BlendshapeEquation) -> ByteImage:
        """Draw the solve of a row with the performer's markers on the character.

        A line leads from a marker's point on the solved surface to the marker, its residual.
        Repaired markers are orange and hollow.
        """
        shot, frame = self._shot, int(self._shot.frames[row])
        repaired = repaired_markers(shot.markers, frame - shot.take.first_frame)
        still = shot.motion is None or not shot.motion.moves_as_one  # markers ignore joints
        picture = self.face(row, shot.weights[row], still=still)
        posed = shot.deformer.points(shot.weights[row][None])[0]
        motion = equation.motion(shot.positions[row][None])[0]
        seen = equation.virtual.places(shot.deformer.neutral) + motion
        both = np.stack([equation.virtual.places(posed), seen])
        if not still and shot.motion is not None:
            (carried,) = shot.motion.transforms(frame)
            both = both @ carried[:3, :3].T + carried[:3, 3]
        view = self._camera.at(frame, still=still)
        size = self._height / 320
        ends = [
            view.project(points, width=self.face_width, height=self._height)[:, :2]
            for points in both
        ]
        if self._placed_lines is None:
            names, shapes = shot.markers.names, shot.rig.shapes
            self._placed_lines = lines_on_rig(names, equation, shot.deformer, shapes)
        draw_marker_lines(picture, ends[1], self._placed_lines, size=size, color=BLUE)
        for solved, captured, hollow in zip(*ends, repaired.tolist(), strict=True):
            if np.isfinite(solved).all() and np.isfinite(captured).all():
                draw_line(picture, solved, captured, BRIGHT, thickness=1.4 * size)
                x, y = float(captured[0]), float(captured[1])
                radius, color = (3.4 * size, ORANGE) if hollow else (2.4 * size, BLUE)
                draw_dot(picture, x, y, radius, color, hollow=hollow)
        return picture

    def face(self, row: int, weights: FloatArray, *, still: bool = False) -> ByteImage:
        """Draw the rig at weights, (shapes,), with a row's camera; `still`: without its joints."""
        shot = self._shot
        still = still or shot.motion is None
        frame = int(shot.frames[row])
        camera = self._camera.at(frame, still=still)
        seen = (camera, weights.tobytes(), None if still else frame)
        if seen not in self._last:  # sheets show the solve twice, and faces may not move
            picture = self._draw(row, weights, still=still)
            self._last = dict([*self._last.items(), (seen, picture)][-_LAST_PICTURES:])
        return self._last[seen].copy()

    def _draw(self, row: int, weights: FloatArray, *, still: bool, **painted: Any) -> ByteImage:
        """Draw the rig; `painted`: values and their range, see `FaceRenderer.render`."""
        sculpted = self._normals.at(weights)
        if sculpted is not None and not still:
            sculpted = self._shot.apply_motion(row, sculpted, vectors=True)
        return self._renderer.render(
            self._shot.pose(row, weights, still=still),
            camera=self._camera.at(int(self._shot.frames[row]), still=still),
            width=self.face_width,
            height=self._height,
            quality=self._quality,
            sculpted=sculpted,
            **painted,
        )

    def painted(
        self, row: int, weights: FloatArray, values: FloatArray, *, high: float
    ) -> ByteImage:
        """Paint values of points, (points,), on the rig at one set of weights; NaN is grey."""
        return self._draw(row, weights, still=False, values=values, value_range=(0.0, high))
