"""Generation of the demo's inputs: rig, capture, video and keys."""

import csv
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from fractions import Fraction
from pathlib import Path

import numpy as np

from usdface.capture.c3d_write import write_c3d
from usdface.core.arrays import ByteImage, Float32Array, FloatArray, IntArray, columns_by_name
from usdface.core.assets import RigMesh, WeightsClip
from usdface.core.last_result import cache_last_result
from usdface.core.processes import SubmitWork, process_count, worker_processes
from usdface.core.progress import Progress, part, silent
from usdface.demo.acting import FIRST_FRAME, ActedPerformance, performance
from usdface.demo.capture import ActorFace, demo_markers, head_poses, simulate_capture
from usdface.demo.head import DemoHead, HeadPart
from usdface.demo.rig import demo_rig, make_head, mesh_points, rig_from_head
from usdface.demo.script import DURATION_SECONDS, spoken_phones
from usdface.demo.sculpt import ACTOR
from usdface.demo.voice import speak
from usdface.media.face.camera import Camera
from usdface.media.face.render import FaceRenderer
from usdface.media.film.movie import SAMPLE_RATE, write_movie
from usdface.speech.track_files import write_phone_track
from usdface.usdio.rig.write import write_rig

VIDEO_RATE = Fraction(24)
CLIP_SIZE = (216, 240)
"""Width and height of the clip [pixels]."""

OFFSET_SECONDS = -0.4
"""Take time of the clip's first frame: the camera started before the capture."""

TAIL_SECONDS = 0.25
"""Length of the clip after the end of the capture."""

_MOST_PROCESSES = 4
"""Processes that draw the clip, of 0.3 GB each, including this one."""

_TASK_PICTURES = 4
"""Pictures per task of a drawing process."""

_BACK_MM = -60.0
"""Z up to which the camera does not see the head, behind the ears."""

_FIELD_DEGREES = 14.2
CAMERA = Camera(
    eye=(190.0, 1512.0, 1290.0), target=(60.0, 1503.0, 150.0), fov_degrees=_FIELD_DEGREES
)
"""Camera of the actor's clip."""


FOCAL_LENGTH = float(
    np.hypot(36.0, 24.0)
    / np.hypot(*CLIP_SIZE)
    * CLIP_SIZE[1]
    / 2
    / np.tan(np.radians(_FIELD_DEGREES) / 2)
)
"""Of `CAMERA`, as expected by `track` [mm, 35 mm equivalent]."""


class Studio:
    """The actor in front of a camera."""

    def __init__(self, head: DemoHead) -> None:
        kept, light = _lighter(head)
        self._face = ActorFace(head, kept)
        self._order = np.concatenate(list(mesh_points(light).values()))
        self.meshes = rig_from_head(light).meshes
        """Of the actor at rest."""

    def pose(self, pose: FloatArray, weights: FloatArray) -> Float32Array:
        """Return the meshes' points in the room [mm].

        `pose`: of the head, (4, 4); `weights`: in the order of the shapes.
        """
        points = self._face.pose(weights)[self._order] @ pose[:3, :3].T + pose[:3, 3]
        return np.asarray(points, np.float32)


@cache_last_result
def _renderer(meshes: tuple[RigMesh, ...]) -> FaceRenderer:
    return FaceRenderer(meshes)


def film(
    meshes: tuple[RigMesh, ...],
    poses: Sequence[Float32Array],
    size: tuple[int, int] = CLIP_SIZE,
    camera: Camera = CAMERA,
) -> list[ByteImage]:
    """Draw a picture of each pose of a studio's meshes; `size`: width and height [pixels]."""
    renderer, pictures = _renderer(meshes), []
    for points in poses:
        pictures.append(
            renderer.render(points, camera=camera, width=size[0], height=size[1], quality="draft")
        )
    return pictures


def _lighter(head: DemoHead) -> tuple[IntArray, DemoHead]:
    """Remove the skin's last refinement, which is too fine for a small picture, and the back.

    Returns the indices of the kept points, and the head made of them.
    """
    skin = np.all(head.parts[head.faces] == HeadPart.SKIN, axis=1)
    # Refinement cuts a quad into four, each of which begins with a corner of the quad.
    coarse = np.concatenate([head.faces[skin][:, 0].reshape(-1, 4), head.faces[~skin]])
    coarse = coarse[head.points[coarse, 2].max(axis=1) > _BACK_MM]
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
    size: tuple[int, int] = CLIP_SIZE,
    camera: Camera = CAMERA,
    give_work: SubmitWork | None = None,
    progress: Progress = silent,
) -> None:
    """Write a movie of the actor's performance with sound.

    `size`: width and height [pixels]. `give_work`: of `drawing_processes`, which then draw as well.
    """
    rate = float(acted.weights.rate)
    count = int((DURATION_SECONDS + TAIL_SECONDS - OFFSET_SECONDS) * VIDEO_RATE)
    take_time = np.arange(count) / float(VIDEO_RATE) + OFFSET_SECONDS
    frames = np.clip(np.round(take_time * rate), 0, len(acted.weights.values) - 1).astype(int)
    frames, counts = np.unique(frames, return_counts=True)  # the ends are still
    weights = columns_by_name(acted.weights.values[frames], acted.weights.names, tuple(head.shapes))
    poses = head_poses(acted)[frames]
    lead = np.zeros(round(-OFFSET_SECONDS * SAMPLE_RATE), np.float32)
    voice = speak(SAMPLE_RATE)
    tail = np.zeros(round(TAIL_SECONDS * SAMPLE_RATE), np.float32)
    room = np.random.default_rng(7).standard_normal(len(lead) + len(voice) + len(tail))
    sound = np.concatenate([lead, voice, tail]) + 6e-4 * room.astype(np.float32)
    studio = Studio(head)
    posed = [studio.pose(pose, row) for pose, row in zip(poses, weights, strict=True)]
    pictures = _drawn(studio.meshes, posed, (size, camera), give_work, progress)
    write_movie(
        path,
        (picture for picture, times in zip(pictures, counts, strict=True) for _ in range(times)),
        rate=VIDEO_RATE,
        audio=sound.astype(np.float32),
    )


def _drawn(
    meshes: tuple[RigMesh, ...],
    poses: list[Float32Array],
    view: tuple[tuple[int, int], Camera],
    give_work: SubmitWork | None,
    progress: Progress,
) -> Iterator[ByteImage]:
    """Draw all pictures from the first on, while other processes draw from the last on."""
    starts = range(0, len(poses), _TASK_PICTURES)
    tasks = [poses[start : start + _TASK_PICTURES] for start in starts]
    given = [give_work(film, meshes, task, *view) for task in tasks[::-1]] if give_work else []
    for start, task in zip(starts, tasks, strict=True):
        work = given.pop() if given else None
        yield from film(meshes, task, *view) if work is None or work.cancel() else work.result()
        progress((start + len(task)) / len(poses), "filming the actor")


@contextmanager
def drawing_processes() -> Iterator[SubmitWork | None]:
    """Start processes that draw the actor's clip with this one; none on a single core."""
    count = min(process_count(), _MOST_PROCESSES) - 1
    if not count:
        yield None
        return
    with worker_processes(count, _no_set_up) as give_work:
        yield give_work


def _no_set_up(stopped: Callable[[], bool]) -> None:
    """Draw until terminated, as no file is written."""


@dataclass(frozen=True)
class DemoInputs:
    """The files of the demo, and facts that a user would know."""

    rig: Path
    """The character: a UsdSkel asset."""
    capture: Path
    """The actor's markers, C3D at 120 Hz [mm], Y up."""
    video: Path
    """The actor on camera, with sound."""
    animator_weights: Path
    """CSV: `frame` (of the capture), then one column per shape of the rig."""
    phones: Path
    """Phones and moods, on the capture's clock."""
    rigid_markers: tuple[str, ...]
    """Names of the markers that move with the skull only."""
    neutral_frame: int
    """Frame of the capture with the face at rest."""
    truth: WeightsClip
    """The animator's weights on every frame, of the animated shapes."""


def write_demo_inputs(
    folder: Path, *, video_lines: int = CLIP_SIZE[1], progress: Progress = silent
) -> DemoInputs:
    """Generate the demo's inputs in a folder; files of the same names are replaced.

    `video_lines`: height of the clip [pixels], even.
    """
    folder.mkdir(parents=True, exist_ok=True)
    with drawing_processes() as give_work:
        progress(0.0, "sculpting the character and the actor")
        rig_file = folder / "character.usdc"
        character = give_work(_write_character, rig_file) if give_work else None
        actor = make_head(ACTOR)
        acted = performance()
        markers = demo_markers(actor)
        progress(0.15, "capturing the actor")
        positions, visible = simulate_capture(actor, acted, markers)
        capture_file = folder / "actor.c3d"
        write_c3d(
            capture_file,
            positions,
            visible,
            markers.names,
            rate=acted.weights.rate,
            first_frame=FIRST_FRAME,
        )
        phones_file = folder / "actor.phones.json"
        write_phone_track(phones_file, spoken_phones())
        video_file = folder / "actor.mp4"
        size = (2 * round(video_lines * CLIP_SIZE[0] / CLIP_SIZE[1] / 2), video_lines)
        filming = part(progress, 0.2, 1.0)
        write_clip(video_file, actor, acted, size=size, give_work=give_work, progress=filming)
        shapes = character.result() if character else _write_character(rig_file)
        weights_file = folder / "animator_weights.csv"
        write_weights(weights_file, acted.weights, shapes)
    return DemoInputs(
        rig=rig_file,
        capture=capture_file,
        video=video_file,
        animator_weights=weights_file,
        phones=phones_file,
        rigid_markers=markers.rigid,
        neutral_frame=acted.neutral_frame,
        truth=acted.weights,
    )


def _write_character(file: Path) -> tuple[str, ...]:
    """Write the character's rig; return its shapes."""
    character = demo_rig()
    write_rig(file, character)
    return character.shapes


def weights_on_video(truth: WeightsClip) -> WeightsClip:
    """Return the animator's weights at the clip's frames, numbered from 1."""
    times = np.arange(int(np.ceil((DURATION_SECONDS - OFFSET_SECONDS) * VIDEO_RATE))) / float(
        VIDEO_RATE
    )
    rows = (times + OFFSET_SECONDS) * float(truth.rate)
    inside = (rows >= 0) & (rows <= len(truth.values) - 1)
    first = int(np.argmax(inside))
    taken = np.arange(len(truth.values))
    columns = [np.interp(rows[inside], taken, column) for column in truth.values.T]
    values = np.stack(columns, axis=1).astype(np.float32)
    return WeightsClip(truth.names, values, first + 1, VIDEO_RATE)


def write_weights(path: Path, weights: WeightsClip, shapes: tuple[str, ...]) -> None:
    """Write weights of all shapes of the rig as CSV; 0 where not keyed."""
    keyed = columns_by_name(weights.values, weights.names, shapes)
    with path.open("w", newline="", encoding="utf-8") as stream:
        writer = csv.writer(stream)
        writer.writerow(["frame", *shapes])
        for number, row in enumerate(keyed, start=weights.first_frame):
            writer.writerow([number, *(f"{value:.4f}" for value in row)])
