"""Video without markers: a film of the demo's actor, tracked and mapped to the character.

All steps run through specs and files, as a user would run them. The truth is an animator's keys on
the character, and for gaze the rotation of the actor's eyeballs in the film. Errors exclude frames
that are references and, in a second row, those within a quarter of a second of one; the number of
remaining frames is given.
"""

import json
import tempfile
import time
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from tests.conftest import SHARED_DATA
from usdface.capture.face_gaze import FULL_LOOK_DEGREES, LOOK_SHAPES
from usdface.capture.face_landmarker import FaceLandmarker
from usdface.core.arrays import BoolArray, FloatArray, columns_by_name
from usdface.core.assets import Performance, Rig, WeightsClip
from usdface.core.deformer import Deformer
from usdface.core.errors import InputError
from usdface.demo.acting import performance
from usdface.demo.build import (
    CAMERA,
    CLIP_SIZE,
    FOCAL_LENGTH,
    OFFSET_SECONDS,
    DemoInputs,
    drawing_processes,
    weights_on_video,
    write_clip,
    write_demo_inputs,
    write_weights,
)
from usdface.demo.capture import ActorFace, head_poses
from usdface.demo.head import HeadPart
from usdface.demo.rig import make_head
from usdface.demo.script import NEUTRAL_TIME
from usdface.demo.sculpt import ACTOR
from usdface.media.face.camera import Camera
from usdface.media.film.video import VideoReader
from usdface.model.mapping.uncertainty import LIMIT_DEVIATIONS
from usdface.numerics.measure.face_regions import gaze_shapes
from usdface.numerics.rigid.rigid_alignment import align_rigid
from usdface.runner.execute import execute
from usdface.specs.capture import CleanSpec, IngestSpec, TrackSpec
from usdface.specs.performance import MapSpec, TrainSpec
from usdface.specs.references import ReferencesAddSpec, ReferencesImportSpec, SelectSpec
from usdface.usdio.performance.read import read_performance
from usdface.usdio.references.read import read_references
from usdface.usdio.rig.read import read_rig
from usdface.usdio.take.read import read_take

MODEL = SHARED_DATA / "models" / "face_landmarker.task"
COUNT = 50
LARGE = (648, 720)
APART_SECONDS = 0.25
SIDE = replace(
    CAMERA,
    eye=tuple(
        (
            Rotation.from_euler("y", -25, degrees=True).apply(
                np.subtract(CAMERA.eye, CAMERA.target)
            )
            + CAMERA.target
        ).tolist()
    ),
)
"""Second camera: the first one, rotated about the face."""
_MOUTH = ("mouth", "jaw", "tongue")
_BLINKING = 0.7
"""Weight of a closed eye."""


@dataclass(frozen=True)
class _Shot:
    """The character, what an animator would key, and the tracked take."""

    folder: Path
    rig: Rig
    keys: WeightsClip
    truth: FloatArray
    """(frames, shapes): in the rig's order."""


@dataclass(frozen=True)
class _Errors:
    """Errors of some frames of a solve."""

    face_mm: float
    mouth_mm: float
    jitter: float


def run(*, quick: bool = False) -> None:
    """Print errors of the solve, of the model's scores and of gaze, and the speed.

    `quick` tracks the demo's small clip; otherwise a film of 720 lines is rendered.
    """
    if not MODEL.is_file():
        print(f"skipped: no model at {MODEL}")
        return
    try:
        with FaceLandmarker(MODEL):
            pass
    except InputError as error:
        print(f"skipped: {error}")
        return
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        inputs = write_demo_inputs(folder)
        video, size = inputs.video, CLIP_SIZE
        if not quick:
            video, size = folder / "large.mp4", LARGE
            _film(video, size=size)
        rig = read_rig(inputs.rig)
        keys = weights_on_video(inputs.truth)
        write_weights(folder / "keys.csv", keys, rig.shapes)
        truth = columns_by_name(keys.values, keys.names, rig.shapes).astype(np.float64)
        shot = _Shot(folder, rig, keys, truth)
        print(f"the demo's actor at {size[0]} × {size[1]} pixels, 24 frames per second\n")
        _print_speed(video)
        _track(shot, video)
        _print_pose(shot)
        one = _print_errors(shot)
        gaze = _print_gaze(shot)
        _print_both(shot, inputs, video)
        side = folder / "side.mp4"
        _film(side, size=size, camera=SIDE)
        _print_claims(one, _print_two_cameras(shot, video, side, size), gaze)


def _film(video: Path, *, size: tuple[int, int], camera: Camera = CAMERA) -> None:
    with drawing_processes() as give_work:
        actor = make_head(ACTOR)
        write_clip(video, actor, performance(), size=size, camera=camera, give_work=give_work)


def _print_speed(video: Path) -> None:
    """Print the speed of tracking on one core, and the share of the model."""
    spent = dict.fromkeys(("reading the picture", "the model, once"), 0.0)
    frames = 100
    with VideoReader(video) as reader, FaceLandmarker(MODEL) as landmarker:
        for index in range(frames):
            start = time.process_time()
            picture = reader.frame(index)
            read = time.process_time()
            landmarker.find_faces(picture)
            spent["reading the picture"] += read - start
            spent["the model, once"] += time.process_time() - read
    print("| processor time | ms per frame | frames/s of one core |\n|---|---|---|")
    for what, seconds in spent.items():
        print(f"| {what} | {1e3 * seconds / frames:.1f} | {frames / seconds:.0f} |")
    once = sum(spent.values())
    both = once + spent["the model, once"]
    print(f"| `track --quality draft` | {1e3 * once / frames:.1f} | {frames / once:.0f} |")
    print(f"| `track` | {1e3 * both / frames:.1f} | {frames / both:.0f} |\n", flush=True)


def _track(shot: _Shot, video: Path) -> None:
    _track_with(shot, video, focal_length=FOCAL_LENGTH)


def _track_with(shot: _Shot, video: Path, **cameras: Any) -> None:
    first, count = shot.keys.first_frame, len(shot.keys.values)
    take = shot.folder / "video.take.usda"
    execute(
        TrackSpec(
            video=video,
            out=take,
            model=MODEL,
            face="largest",
            frames=f"{first}-{first + count - 1}",
            neutral=first + int(NEUTRAL_TIME * shot.keys.rate),
            **cameras,
        )
    )
    execute(CleanSpec(take=take, out=shot.folder / "video.clean.take.usda"))


def _solve(
    shot: _Shot,
    name: str,
    *,
    learn: str | None = None,
    solve: str | None = None,
    keys: Path | None = None,
    tuned: bool = True,
) -> tuple[FloatArray, Performance, str]:
    """Train on some frames and solve others; keys are an animator's, or the solve `keys`.

    Without `tuned`, references keep their proposals.

    Returns
    -------
    values : (frames, shapes) float array
        In the rig's order.
    performance : Performance
        With uncertainty.
    verdict : str
    """
    folder, rig = shot.folder, shot.rig.file
    clean = folder / "video.clean.take.usda"
    references, mapping = folder / f"{name}.references.usda", folder / f"{name}.mapping.usdc"
    out = folder / f"{name}.usda"
    execute(SelectSpec(takes=(clean,), rig=rig, out=references, count=COUNT, frames=learn))
    if tuned and keys is None:
        execute(ReferencesImportSpec(references=references, weights=folder / "keys.csv"))
    elif tuned:
        execute(ReferencesImportSpec(references=references, weights=keys, at="video"))
    execute(TrainSpec(references=references, out=mapping))
    result = execute(MapSpec(take=clean, mapping=mapping, rig=rig, out=out, frames=solve))
    solved = read_performance(out)
    clip = solved.weights
    values = columns_by_name(clip.values, clip.names, shot.rig.shapes).astype(np.float64)
    return values, solved, result.summary


def _print_head(what: str) -> None:
    print(f"{what}; mean surface error of the frames that count, gaze left out\n")
    print("| solve | frames | face [mm] | p95 [mm] | mouth [mm] | blink bias | jitter |")
    print("|---|---|---|---|---|---|---|")


def _print_claims(
    one: dict[str, _Errors], two: dict[str, _Errors], gaze_degrees: tuple[float, float]
) -> None:
    apart = one["apart"]
    print("\n| one camera, but for the last | wanted | measured |\n|---|---|---|")
    for claim, wanted, value in (
        ("face, frames without a reference within ¼ s [mm]", "≤ 0.45", apart.face_mm),
        ("mouth, the same frames [mm]", "≤ 0.6", apart.mouth_mm),
        (
            "the model's own scores over the solve, the same",
            "≥ 3",
            one["scores"].face_mm / apart.face_mm,
        ),
        ("jitter over the true", "≤ 1.5", one["all"].jitter),
        ("gaze sideways [degrees]", "≤ 3", gaze_degrees[0]),
        ("gaze up and down [degrees]", "≤ 3", gaze_degrees[1]),
        (
            "face, two cameras over one, the same references",
            "< 1",
            two["two"].face_mm / two["one camera"].face_mm,
        ),
    ):
        print(f"| {claim} | {wanted} | {value:.2f} |", flush=True)


def _print_two_cameras(
    shot: _Shot, front: Path, side: Path, size: tuple[int, int]
) -> dict[str, _Errors]:
    """Print the same errors with two calibrated cameras."""
    folder = shot.folder / "pair"
    folder.mkdir()
    cameras = {"front": CAMERA, "side": SIDE}
    focal = size[1] / 2 / np.tan(np.radians(CAMERA.fov_degrees / 2))
    lens = [[focal, 0, size[0] / 2], [0, focal, size[1] / 2], [0, 0, 1]]
    tables = {}
    for name, camera in cameras.items():
        turn = camera.axes() * [[1], [-1], [-1]]  # OpenCV's axes: right, down, along the view
        shift = -turn @ np.array(camera.eye)
        tables[name] = {"matrix": lens, "size": size} | {
            "rotation": turn.tolist(),
            "translation": shift.tolist(),
        }
    calibration = folder / "cameras.json"
    calibration.write_text(json.dumps(tables), encoding="utf-8")
    (folder / "keys.csv").write_bytes((shot.folder / "keys.csv").read_bytes())
    pair = replace(shot, folder=folder)
    _track_with(pair, front, views=(side,), calibration=calibration)
    print("\nTwo cameras, 25 degrees from each other, joined by `track --views`:\n")
    _print_pose(pair)
    found = _print_errors(pair)
    _print_gaze(pair)
    both = np.concatenate(
        [read_references(each.folder / "whole.references.usda").frames for each in (shot, pair)]
    )
    _print_head("\nReferences at the frames of both selections")
    for each, label in ((shot, "one camera"), (pair, "two")):
        values = _solve_with_more(each, np.unique(both).tolist())
        found[label] = _print_unkeyed(each, label, "more", values)
    return found


def _solve_with_more(shot: _Shot, frames: list[int]) -> FloatArray:
    """Add frames to the references of the whole take; solve it again."""
    folder, names = shot.folder, ("references.usda", "mapping.usdc", "usda")
    references, mapping, out = (folder / f"more.{name}" for name in names)
    execute(
        ReferencesAddSpec(
            performance=folder / "whole.usda",
            references=folder / "whole.references.usda",
            out=references,
            frames=",".join(map(str, frames)),
        )
    )
    execute(ReferencesImportSpec(references=references, weights=folder / "keys.csv"))
    execute(TrainSpec(references=references, out=mapping))
    clean = folder / "video.clean.take.usda"
    execute(MapSpec(take=clean, mapping=mapping, rig=shot.rig.file, out=out))
    clip = read_performance(out).weights
    return columns_by_name(clip.values, clip.names, shot.rig.shapes).astype(np.float64)


def _print_both(shot: _Shot, inputs: DemoInputs, video: Path) -> None:
    """Print errors with references keyed by the solve of the other marker set."""
    folder = shot.folder / "optical"
    folder.mkdir()
    raw, clean = folder / "raw.take.usda", folder / "video.clean.take.usda"
    ingest = IngestSpec(
        sources=(inputs.capture,),
        out=raw,
        video=video,
        video_offset=OFFSET_SECONDS,
        rigid=inputs.rigid_markers,
        neutral=inputs.neutral_frame,
    )
    execute(ingest)
    execute(CleanSpec(take=raw, out=clean))
    truth = columns_by_name(inputs.truth.values, inputs.truth.names, shot.rig.shapes)
    optical = _Shot(folder, shot.rig, inputs.truth, truth.astype(np.float64))
    (folder / "keys.csv").write_bytes(inputs.animator_weights.read_bytes())
    _print_head(f"\nOne actor, optical markers and video; {COUNT} references of each")
    solved, _, _ = _solve(optical, "whole")
    _print_unkeyed(optical, "optical markers, an animator's keys", "whole", solved)
    filmed = read_performance(shot.folder / "whole.usda").weights
    values = columns_by_name(filmed.values, filmed.names, shot.rig.shapes).astype(np.float64)
    _print_unkeyed(shot, "video, an animator's keys", "whole", values)
    for learner, teacher, label in (
        (shot, optical, "video, keys are the solve of the optical markers"),
        (optical, shot, "optical markers, keys are the solve of the video"),
    ):
        values, _, _ = _solve(learner, "other", keys=teacher.folder / "whole.usda")
        _print_unkeyed(learner, label, "other", values)
    refused = MapSpec(
        take=shot.folder / "video.clean.take.usda",
        mapping=folder / "whole.mapping.usdc",
        rig=shot.rig.file,
        out=folder / "never.usda",
    )
    try:
        execute(refused)
        print("\nThe mapping of the optical markers maps the video's landmarks: it should not.\n")
    except InputError as error:
        words = str(error).removeprefix(f"{refused.take}: ")
        print(f"\nThe mapping of the optical markers on the video's take: «{words}»\n", flush=True)


def _print_unkeyed(shot: _Shot, label: str, name: str, solved: FloatArray) -> _Errors:
    """Print a row on the frames that are not references; return it."""
    keyed = np.zeros(len(shot.truth), bool)
    frames = read_references(shot.folder / f"{name}.references.usda").frames
    keyed[frames - shot.keys.first_frame] = True
    return _print_row(shot, label, solved, ~keyed)


def _print_errors(shot: _Shot) -> dict[str, _Errors]:
    """Print errors by group of frames; return those of the whole take."""
    found = {}
    _print_head(f"{COUNT} references")
    count, first = len(shot.truth), shot.keys.first_frame
    every = np.ones(count, bool)
    solved, _, verdict = _solve(shot, "whole")
    keyed = np.zeros(count, bool)
    keyed[read_references(shot.folder / "whole.references.usda").frames - first] = True
    reach = int(APART_SECONDS * shot.keys.rate)
    near = np.convolve(keyed, np.ones(2 * reach + 1), mode="same") > 0
    found["all"] = _print_row(shot, "frames that are no references", solved, ~keyed)
    found["apart"] = _print_row(shot, "none within ¼ s", solved, ~near)
    verdicts = [f"- references of the whole take: {verdict}"]
    untuned, solve, verdict = _solve(shot, "untuned", tuned=False)
    _print_row(shot, "untuned references", untuned, every)
    verdicts.append(f"- untuned references: {verdict}; {_measure_doubt(shot, untuned, solve)}")
    half = count // 2
    halves = {"first": slice(0, half), "second": slice(half, count)}
    for learnt, judged in (("first", "second"), ("second", "first")):
        part = halves[judged]
        frames = {
            name: f"{first + rows.start}-{first + rows.stop - 1}" for name, rows in halves.items()
        }
        other = replace(shot, truth=shot.truth[part])
        label = f"references of the {learnt} half, frames of the {judged}"
        values, solve, verdict = _solve(shot, learnt, learn=frames[learnt], solve=frames[judged])
        _print_row(other, label, values, every[part])
        _print_row(other, f"a face at rest, the {judged} half", 0 * other.truth, every[part])
        verdicts.append(f"- {label}: {verdict}; {_measure_doubt(other, values, solve)}")
    take = read_take(shot.folder / "video.take.usda")
    assert take.source is not None
    shared = [name for name in take.source.names if name in shot.rig.shapes]
    scores = np.zeros_like(shot.truth)
    for name in shared:
        column = take.source.values[:, take.source.names.index(name)]
        scores[:, shot.rig.shapes.index(name)] = column
    _print_row(shot, f"the model's own scores, {len(shared)} shapes", scores, ~keyed)
    found["scores"] = _print_row(shot, "the same, none within ¼ s", scores, ~near)
    _print_row(shot, "a face at rest", np.zeros_like(shot.truth), ~keyed)
    print("\nWhat `map` says of them:\n\n" + "\n".join(verdicts) + "\n", flush=True)
    return found


def _measure_doubt(shot: _Shot, values: FloatArray, solve: Performance) -> str:
    """Describe the relation of true error and uncertainty."""
    assert solve.uncertainty_mm is not None
    expected = solve.uncertainty_mm[:, 0]
    inside = _surface(shot, values - shot.truth) <= LIMIT_DEVIATIONS * expected
    return f"{inside.mean():.0%} of the frames are within the limit that holds for 90 %"


def _surface(shot: _Shot, difference: FloatArray) -> FloatArray:
    """Return the error of each frame without gaze: (frames,) [mm]."""
    seen = difference.copy()
    seen[:, gaze_shapes(shot.rig.shapes)] = 0
    gram = Deformer(shot.rig).shapes.gram()
    squared = np.einsum("fs,st,ft->f", seen, gram, seen)
    return np.asarray(np.sqrt(np.maximum(squared, 0.0)))


def _print_pose(shot: _Shot) -> None:
    """Print the regression of the estimated head pose on the true one."""
    motion = read_take(shot.folder / "video.clean.take.usda").head_motion
    assert motion is not None
    clip = np.arange(len(motion)) + shot.keys.first_frame - 1
    acted = performance()
    times = clip / float(shot.keys.rate) + OFFSET_SECONDS
    rows = np.clip(np.round(times * float(acted.weights.rate)), 0, len(acted.rotation) - 1)
    poses = head_poses(acted)[rows.astype(int), :3, :3]
    neutral = int(NEUTRAL_TIME * shot.keys.rate)
    view = CAMERA.axes()
    true = view @ poses @ poses[neutral].T @ view.T
    found = motion[:, :3, :3] @ motion[neutral, :3, :3].T
    turns = [Rotation.from_matrix(each).as_rotvec(degrees=True) for each in (found, true)]
    print("| head | share of the true turn | correlation | mean error [degrees] |")
    print("|---|---|---|---|")
    for axis, name in enumerate(("pitch", "yaw", "roll")):
        measured, real = (each[:, axis] - each[:, axis].mean() for each in turns)
        error = np.abs(turns[0][:, axis] - turns[1][:, axis]).mean()
        print(
            f"| {name} | {measured @ real / (real @ real):.2f} | "
            f"{np.corrcoef(measured, real)[0, 1]:.2f} | {error:.1f} |"
        )
    print(flush=True)


def _print_row(shot: _Shot, label: str, solved: FloatArray, counted: BoolArray) -> _Errors:
    """Print a row, and return its figures."""
    shapes = shot.rig.shapes
    error = solved - shot.truth
    whole = _surface(shot, error[counted])
    mouth = np.where([name.startswith(_MOUTH) for name in shapes], error, 0.0)
    blinks = [shapes.index(name) for name in ("eyeBlinkLeft", "eyeBlinkRight")]
    closed = counted & (shot.truth[:, blinks].mean(axis=1) > _BLINKING)
    bias = f"{error[closed][:, blinks].mean():+.2f}" if closed.any() else "–"
    moved = shot.truth.std(axis=0) > 0.02
    moved[gaze_shapes(shapes)] = False
    rough, smooth = (np.diff(each[:, moved], 3, axis=0).std() for each in (solved, shot.truth))
    found = _Errors(
        float(whole.mean()), float(_surface(shot, mouth[counted]).mean()), float(rough / smooth)
    )
    print(
        f"| {label} | {counted.sum()} | {found.face_mm:.2f} | {np.percentile(whole, 95):.2f} | "
        f"{found.mouth_mm:.2f} | {bias} of {closed.sum()} frames | {found.jitter:.2f} |",
        flush=True,
    )
    return found


def _print_gaze(shot: _Shot) -> tuple[float, float]:
    """Print mean errors of gaze, sideways and up and down; return them [degrees]."""
    source = read_take(shot.folder / "video.take.usda").source
    assert source is not None
    looks = source.values[:, [source.names.index(name) for name in LOOK_SHAPES]].astype(np.float64)
    looks = looks.reshape(-1, 2, 4) * FULL_LOOK_DEGREES
    inward, pitch = looks[..., 0] - looks[..., 1], looks[..., 2] - looks[..., 3]
    measured = np.stack([inward * (1, -1), pitch], axis=2)
    true = _eye_turns(shot)
    true -= true[int(NEUTRAL_TIME * shot.keys.rate)]
    error = np.abs(measured - true)
    still = np.abs(true)
    print("| gaze, both eyes | mean error [degrees] | p95 | looking straight ahead instead |")
    print("|---|---|---|---|")
    for axis, name in enumerate(("sideways", "up and down")):
        print(
            f"| {name} | {error[..., axis].mean():.1f} | {np.percentile(error[..., axis], 95):.1f} "
            f"| {still[..., axis].mean():.1f} |",
            flush=True,
        )
    sideways, up = error.mean(axis=(0, 1))
    return float(sideways), float(up)


def _eye_turns(shot: _Shot) -> FloatArray:
    """(frames, eyes, 2): yaw to the performer's left and pitch up, right eye first [degrees]."""
    head = make_head(ACTOR)
    turns = []
    for side in (-1, 1):
        eye = np.flatnonzero((head.parts == HeadPart.EYES) & (side * head.points[:, 0] > 0))
        face = ActorFace(head, eye)
        weights = columns_by_name(shot.keys.values, shot.keys.names, tuple(head.shapes))
        points = np.stack([face.pose(row) for row in weights])
        turn = Rotation.from_matrix(align_rigid(points, head.points[eye]).rotations)
        ahead = turn.apply([0.0, 0.0, 1.0])
        yaw = np.degrees(np.arctan2(ahead[:, 0], ahead[:, 2]))
        turns.append(np.stack([yaw, np.degrees(np.arcsin(ahead[:, 1]))], axis=1))
    return np.stack(turns, axis=1)
