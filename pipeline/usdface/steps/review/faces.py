"""Performances of several characters in, one sheet with all of their faces out."""

from dataclasses import replace

import numpy as np

from usdface.core.arrays import FloatArray, IntArray
from usdface.core.errors import InputError
from usdface.core.progress import Progress, silent
from usdface.core.provenance import Provenance
from usdface.core.text import pluralize
from usdface.media.face.camera import frame_rig
from usdface.media.face.render import FaceRenderer
from usdface.media.picture.image import write_image
from usdface.media.picture.sheet import SheetPage, SheetRow, Tile, compose_sheet
from usdface.model.placement.rig_orientation import facing_degrees
from usdface.runner.origin import provenance_metadata, with_moved
from usdface.runner.result import StepResult
from usdface.specs.paths import frame_range
from usdface.specs.review import FacesSpec
from usdface.usdio.rig.posed_points import PosedRig
from usdface.usdio.rig.reference import moved_rig

MOVES_MM, MOVES_SHARE = 2.0, 0.2
"""Points that go further than both between the frames belong in the picture, [mm] and of the
furthest: an open jaw pulls the neck after it."""

_MARGIN_FACTOR = 1.06
"""Between what moves and the picture's edge."""

MOST_POSES = 4000
"""Frames among which those that differ most are looked for."""


def run(spec: FacesSpec, *, provenance: Provenance, progress: Progress = silent) -> StepResult:
    """Choose frames, draw every face at each of them, and write the sheet."""
    actors = _actors(spec)
    frames = _shared(spec, actors)
    chosen = _most_different(actors[0], frames, spec.rows)
    rows = []
    columns = [_Column(actor, chosen, spec) for actor in actors]
    further = max(column.needed_share() for column in columns)
    for column in columns:  # all alike, so that the faces keep one size
        column.step_back(further)
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
        facts=(f"frames {frames[0]}-{frames[-1]}", "the frames that differ most from each other"),
        columns=tuple(path.stem for path in spec.performances),
        rows=tuple(rows),
        first_frame=int(frames[0]),
        tile_height=spec.tile,
    )
    made = provenance_metadata(provenance)
    write_image(spec.out, compose_sheet(page), metadata=made)
    return StepResult(
        (spec.out,),
        f"{pluralize(len(actors), 'face')} at {pluralize(len(chosen), 'frame')}",
        (),
        {"frames": chosen.tolist(), "performances": [str(path) for path in spec.performances]},
    )


def _actors(spec: FacesSpec) -> list[PosedRig]:
    """Open every performance, with its rig from where that is now."""
    actors = []
    for path, rig in with_moved(spec.performances, spec.rig, "rig"):
        with moved_rig(rig):
            actors.append(PosedRig(path))
    return actors


class _Column:
    """One character's pictures: its camera and renderer are set up once."""

    def __init__(self, actor: PosedRig, frames: IntArray, spec: FacesSpec) -> None:
        self._spec = spec
        self._posed = {frame: actor.points(frame) for frame in frames.tolist()}
        self._renderer = FaceRenderer(actor.rig.meshes)
        yaw = spec.yaw + facing_degrees(actor.rig)
        face = frame_rig(actor.rig.meshes, yaw_degrees=yaw)
        self._with_hair = frame_rig(actor.rig.meshes, yaw_degrees=yaw, hair=True)
        # As far away as fits the face, so that faces are of one size; aimed at face and hair.
        away = np.subtract(face.eye, face.target)
        x, y, z = (self._with_hair.target + away).tolist()
        self._camera = replace(face, eye=(x, y, z), target=self._with_hair.target)

    def needed_share(self) -> float:
        """Return how many times further away hair and all that moves are in the picture.

        Ears turn by joints, which no frame of the rig at rest shows.
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
        away = shown - np.array(camera.target)
        across = np.maximum(np.abs(away @ right), np.abs(away @ up))
        # Distance from which each point is just inside.
        needed = _MARGIN_FACTOR * across / wide + away @ back
        distance = float(np.linalg.norm(np.subtract(camera.eye, camera.target)))
        return max(float(needed.max()) / distance, 1.0)

    def step_back(self, share: float) -> None:
        """Move the camera so many times as far away."""
        target = np.array(self._camera.target)
        x, y, z = (target + share * np.subtract(self._camera.eye, target)).tolist()
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


def _shared(spec: FacesSpec, actors: list[PosedRig]) -> IntArray:
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
        raise InputError(f"the performances share no frame{within}: {ranges}")
    return np.arange(first, last + 1, dtype=np.int64)


def _most_different(actor: PosedRig, frames: IntArray, count: int) -> IntArray:
    """Return frames spread over what the face does: each the furthest from those before."""
    picks = frames[:: -(-len(frames) // MOST_POSES)]
    weights: FloatArray = actor.reader.edited(int(frames[0]), int(frames[-1])).astype(np.float64)
    poses = weights[picks - frames[0]]
    chosen = [int(np.linalg.norm(poses, axis=1).argmax())]
    nearest = np.linalg.norm(poses - poses[chosen[0]], axis=1)
    while len(chosen) < min(count, len(poses)) and nearest.max() > 0:
        chosen.append(int(nearest.argmax()))
        nearest = np.minimum(nearest, np.linalg.norm(poses - poses[chosen[-1]], axis=1))
    return np.sort(picks[chosen])
