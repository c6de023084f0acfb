"""Draw performances of several characters side by side."""

from dataclasses import replace
from pathlib import Path

import numpy as np

from usdface.core.arrays import FloatArray, IntArray, columns_by_name
from usdface.core.deformer import Deformer
from usdface.core.errors import InputError
from usdface.core.progress import Progress
from usdface.core.provenance import Provenance
from usdface.core.text import pluralize
from usdface.media.face.camera import frame_rig
from usdface.media.face.render import FaceRenderer
from usdface.media.picture.image import write_image
from usdface.media.picture.sheet import SheetPage, SheetRow, Tile, compose_sheet
from usdface.model.placement.rig_orientation import facing_degrees
from usdface.runner.origin import pair_with_files
from usdface.runner.result import StepResult
from usdface.specs.paths import frame_range
from usdface.specs.review import FacesSpec
from usdface.usdio.performance.read import PerformanceReader
from usdface.usdio.rig.reference import moved_rig, read_rig_of_stage
from usdface.usdio.rig.rig_motion import RigMotion

MOVES_MM, MOVES_SHARE = 2.0, 0.2
"""Displacement [mm], and share of the largest displacement, above which points must be within the
picture; both exclude a neck that an open jaw pulls."""

_MARGIN_FACTOR = 1.06
"""Size of the picture relative to the moving points."""

MOST_POSES = 4000
"""Frames among which the most different are chosen."""


def run(spec: FacesSpec, *, provenance: Provenance, progress: Progress) -> StepResult:
    """Choose frames, draw every face at each of them, and write the sheet."""
    actors = []
    for path, rig in pair_with_files(spec.performances, spec.rig, "rig"):
        with moved_rig(rig):
            actors.append(Actor(path))
    frames = _shared(spec, actors)
    chosen = _most_different(actors[0], frames, spec.rows)
    rows = []
    columns = [_Column(actor, chosen, spec) for actor in actors]
    factor = max(column.distance_factor() for column in columns)
    for column in columns:  # a common factor, so that faces have the same size
        column.scale_distance(factor)
    first = actors[0].reader
    for number, frame in enumerate(chosen.tolist()):
        rows.append(
            SheetRow(
                frame, first.timecode_at(frame), tuple(column.tile(frame) for column in columns)
            )
        )
        progress((number + 1) / len(chosen), f"drew frame {frame}")
    page = SheetPage(
        title=" · ".join(dict.fromkeys(actor.rig.file.stem for actor in actors)),
        facts=(f"frames {frames[0]}-{frames[-1]}", "the frames that differ most"),
        columns=tuple(path.stem for path in spec.performances),
        rows=tuple(rows),
        first_frame=int(frames[0]),
        tile_height=spec.tile,
    )
    write_image(spec.out, compose_sheet(page), metadata=provenance.metadata)
    return StepResult(
        (spec.out,),
        f"{pluralize(len(actors), 'face')} at {pluralize(len(chosen), 'frame')}",
        (),
        {"frames": chosen.tolist(), "performances": [str(path) for path in spec.performances]},
    )


class Actor:
    """A character in its performance."""

    def __init__(self, path: Path) -> None:
        self.path, self.reader = path, PerformanceReader(path)
        self.rig = read_rig_of_stage(self.reader.stage, self.reader.animation)
        self._deformer, self._motion = Deformer(self.rig), RigMotion(path, self.rig)

    def points(self, frame: int) -> FloatArray:
        """Return the points of all meshes at a frame, (points, 3) [mm]."""
        edited = self.reader.edited(frame, frame)
        weights = columns_by_name(edited, self.reader.names, self.rig.shapes)
        return self._motion.apply(self._deformer.points(weights)[0], frame)


class _Column:
    """Draws one character, with its camera and renderer."""

    def __init__(self, actor: Actor, frames: IntArray, spec: FacesSpec) -> None:
        self._spec = spec
        self._posed = {frame: actor.points(frame) for frame in frames.tolist()}
        self._renderer = FaceRenderer(actor.rig.meshes)
        yaw = spec.yaw + facing_degrees(actor.rig)
        face = frame_rig(actor.rig.meshes, yaw_degrees=yaw)
        self._with_hair = frame_rig(actor.rig.meshes, yaw_degrees=yaw, hair=True)
        # The distance fits the face, for faces of equal size; the target is face and hair.
        offset = np.subtract(face.eye, face.target)
        x, y, z = (self._with_hair.target + offset).tolist()
        self._camera = replace(face, eye=(x, y, z), target=self._with_hair.target)

    def distance_factor(self) -> float:
        """Return the factor on the camera's distance for hair and moving points to be visible.

        Joints may move points out of the picture, such as ears.
        """
        posed = np.stack(list(self._posed.values()))
        moved = np.ptp(posed, axis=0).max(axis=1)
        moving = moved > max(MOVES_MM, MOVES_SHARE * float(moved.max(initial=0.0)))
        camera = self._camera
        right, up, back = camera.axes()
        wide = np.tan(np.deg2rad(camera.fov_degrees / 2))
        target = np.array(self._with_hair.target)
        half_height = wide * np.linalg.norm(np.subtract(self._with_hair.eye, target))
        shown = np.vstack(
            [posed[:, moving].reshape(-1, 3), target + half_height / _MARGIN_FACTOR * up]
        )
        offset = shown - np.array(camera.target)
        across = np.maximum(np.abs(offset @ right), np.abs(offset @ up))
        # Smallest distance at which each point is visible.
        needed = _MARGIN_FACTOR * across / wide + offset @ back
        distance = float(np.linalg.norm(np.subtract(camera.eye, camera.target)))
        return max(float(needed.max()) / distance, 1.0)

    def scale_distance(self, factor: float) -> None:
        """Scale the camera's distance."""
        target = np.array(self._camera.target)
        x, y, z = (target + factor * np.subtract(self._camera.eye, target)).tolist()
        self._camera = replace(self._camera, eye=(x, y, z))

    def tile(self, frame: int) -> Tile:
        size = self._spec.tile
        pixels = self._renderer.render(
            self._posed[frame],
            camera=self._camera,
            width=size,
            height=size,
            quality=self._spec.quality,
        )
        return Tile(pixels)


def _shared(spec: FacesSpec, actors: list[Actor]) -> IntArray:
    first = max(actor.reader.first_frame for actor in actors)
    last = min(actor.reader.last_frame for actor in actors)
    limits = frame_range(spec.frames)
    if limits is not None:
        first, last = max(first, limits[0]), min(last, limits[1])
    if last < first:
        ranges = ", ".join(
            f"{actor.path.name} {actor.reader.first_frame}-{actor.reader.last_frame}"
            for actor in actors
        )
        within = f" in {spec.frames}" if spec.frames else ""
        raise InputError(
            f"the performances have no common frame{within}: {ranges}; widen --frames, or leave "
            "one of them out"
        )
    return np.arange(first, last + 1, dtype=np.int64)


def _most_different(actor: Actor, frames: IntArray, count: int) -> IntArray:
    """Return the most different frames, by farthest-point selection of weights."""
    picks = frames[:: -(-len(frames) // MOST_POSES)]
    weights: FloatArray = actor.reader.edited(int(frames[0]), int(frames[-1])).astype(np.float64)
    poses = weights[picks - frames[0]]
    chosen = [int(np.linalg.norm(poses, axis=1).argmax())]
    nearest = np.linalg.norm(poses - poses[chosen[0]], axis=1)
    while len(chosen) < min(count, len(poses)) and nearest.max() > 0:
        chosen.append(int(nearest.argmax()))
        nearest = np.minimum(nearest, np.linalg.norm(poses - poses[chosen[-1]], axis=1))
    return np.sort(picks[chosen])
