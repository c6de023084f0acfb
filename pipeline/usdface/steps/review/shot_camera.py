"""Where the pictures of a shot are taken from: framed on the face, or by a camera of its stage."""

from pathlib import Path

import numpy as np

from usdface.core.arrays import FloatArray
from usdface.core.assets import Performance, Rig
from usdface.media.face.camera import Camera, frame_rig, motion_weights
from usdface.specs.review import AUTO
from usdface.usdio.rig.stage_camera import StageCamera, StageView

_YAW_DEGREES = 12.0
"""A little from the side, where lips and lids show their depth."""

WIDEST = 3.0
"""Width over height at which a picture is cut: wider film would leave a face of few pixels."""

SMALL_SHARE = 0.2
"""Of the picture's height; a face that is lower cannot be judged by lips and lids."""


class ShotCamera:
    """One camera for all pictures of a shot.

    Parameters
    ----------
    performance_file : Path
    performance : Performance
    rig : Rig
    name : str
        ``'auto'``, or the path of a camera.
    stage : Path, optional
        The stage that holds it; the performance by default.
    """

    def __init__(
        self,
        performance_file: Path,
        performance: Performance,
        rig: Rig,
        *,
        name: str = AUTO,
        stage: Path | None = None,
    ) -> None:
        self._rig = rig
        self._framed = frame_rig(rig.meshes, yaw_degrees=_YAW_DEGREES)
        self._name = name
        self._stage: StageCamera | None = None
        if name != AUTO:
            self._stage = StageCamera(
                stage or performance_file,
                name,
                rig_file=performance.rig_file,
                rig_prim=performance.rig_prim,
                rate=performance.weights.rate,
            )

    def at(self, frame: int) -> Camera:
        """Return the camera at a frame."""
        if self._stage is None:
            return self._framed
        return _as_camera(self._stage.at(frame), self._framed)

    def width(self, height: int, frame: int) -> int:
        """Return how wide pictures of a height are: square, or as the camera's film at a frame."""
        if self._stage is None:
            return height
        return max(round(height * min(self._stage.at(frame).aspect, WIDEST)), 1)

    def notes(self, frame: int) -> tuple[str, ...]:
        """Return what to know of the camera, by how it sees the face at a frame."""
        if self._stage is None:
            return ()
        found = []
        if not self._stage.holds_character:
            found.append(
                f"{self._rig.file.name} is not in the camera's stage: it is drawn at its origin"
            )
        height = 1000
        width = self.width(height, frame)
        seen = self.at(frame).project(_face_points(self._rig), width=width, height=height)
        inside = (seen[:, 2] > 0) & np.all((seen[:, :2] > 0) & (seen[:, :2] < (width, height)), 1)
        if not inside.any():
            found.append(f"{self._name} does not see the face at frame {frame}")
        elif np.ptp(seen[:, 1]) < SMALL_SHARE * height:
            share = 100 * np.ptp(seen[:, 1]) / height
            found.append(
                f"the face is {share:.0f} % of the height of what {self._name} sees at frame "
                f"{frame}: judge lips and lids with --camera auto"
            )
        return tuple(found)


def _as_camera(view: StageView, framed: Camera) -> Camera:
    """Turn a stage's view into a camera that aims at the depth of the face."""
    reach = float(np.subtract(framed.target, view.eye) @ view.forward)
    aim = view.eye + (reach if reach > 0 else 1000.0) * view.forward
    return Camera(
        eye=_triple(view.eye),
        target=_triple(aim),
        fov_degrees=view.fov_degrees,
        up=_triple(view.up),
        shift=view.shift,
        span_mm=view.span_mm,
    )


def _face_points(rig: Rig) -> FloatArray:
    points = np.concatenate([mesh.points for mesh in rig.meshes])
    reach = motion_weights(rig.meshes)
    return points[reach > 0] if np.any(reach > 0) else points


def _triple(vector: FloatArray) -> tuple[float, float, float]:
    x, y, z = (float(each) for each in vector)
    return x, y, z
