"""Web application of the tuning page: its files, data, pictures, and the requests it sends."""

import base64
import contextlib
import json
import threading
from collections.abc import Awaitable, Callable
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, StrictFloat, ValidationError
from starlette.applications import Starlette
from starlette.concurrency import run_in_threadpool
from starlette.requests import ClientDisconnect, Request
from starlette.responses import JSONResponse, Response
from starlette.routing import Route

from usdface.core.assets import Rig
from usdface.core.deformer import Deformer
from usdface.core.errors import InputError
from usdface.core.sidecars import corrected_path, poses_path
from usdface.media.face.camera import frame_rig
from usdface.media.page.face_payload import FacePayload, pack_face, read_web_file
from usdface.model.placement.rig_orientation import facing_degrees
from usdface.model.placement.shape_parts import shape_parts
from usdface.numerics.measure.face_regions import mirrored_shapes, sided_shapes
from usdface.specs.notes import ReviewNotes
from usdface.tuning.journal import Change
from usdface.tuning.pictures import PairPictures
from usdface.tuning.poses import PoseName, PoseWeights, read_poses, save_pose
from usdface.tuning.session import StaleRevisionError, TuningSession
from usdface.tuning.targets import MarkerTargets, correct_place, solve_shapes, targets_or_reason
from usdface.tuning.waits import StoppedError, Waits
from usdface.usdio.references.read import PairNotes

_FARTHEST_SECONDS = 1.0
"""Largest time from a pair's frame to a shown video frame."""

_FILES = {
    ".js": "text/javascript; charset=utf-8",
    ".css": "text/css; charset=utf-8",
    ".svg": "image/svg+xml",
}


class _Message(BaseModel):
    """A message of the page; unknown fields and infinite numbers are refused."""

    model_config = ConfigDict(extra="forbid", allow_inf_nan=False)


class SentChanges(_Message):
    """The changes of one request."""

    revision: int
    changes: list[Change] = Field(max_length=10_000)


class SentPlace(_Message):
    """A corrected marker position, `at`, on the rig at rest [mm]; None removes the correction."""

    marker: str = Field(max_length=1000)
    at: tuple[float, float, float] | None = None


class SentSolve(_Message):
    """A request to solve for the weights of some shapes (`free`), starting from `weights`."""

    pair: int = Field(ge=0)
    weights: dict[str, StrictFloat] = Field(max_length=10_000)
    free: list[str] = Field(min_length=1, max_length=10_000)


class SentPose(_Message):
    """A named pose to save; without weights it is removed."""

    name: PoseName
    weights: PoseWeights | None = None


_Sent = TypeVar("_Sent", SentChanges, SentPlace, SentSolve, SentPose)
_Answer = Awaitable[dict[str, Any]]
_Refuser = Callable[[Request, Exception], Awaitable[Response]]


class Scene:
    """Data of the page."""

    def __init__(
        self,
        session: TuningSession,
        rig: Rig,
        notes: list[PairNotes],
        pictures: PairPictures,
        *,
        review: ReviewNotes | None = None,
        first_pair: int = 0,
    ) -> None:
        self.session = session
        self.rig = rig
        self.notes = notes
        self.pictures = pictures
        self.review = review
        self.first_pair = first_pair
        self.waits = Waits()
        self._writing = threading.Lock()
        self._packing = threading.Lock()
        self._packed: FacePayload | None = None
        self._measuring, self._corrections = threading.Lock(), 0
        self._measured: tuple[int, MarkerTargets | str] | None = None

    @property
    def payload(self) -> FacePayload:
        """The face, packed for the first of its callers; the others wait."""
        with self._packing:
            if self._packed is None:
                camera = frame_rig(self.rig.meshes, yaw_degrees=facing_degrees(self.rig), hair=True)
                parts = shape_parts(self.rig, Deformer(self.rig))
                self._packed = pack_face(self.rig, camera=camera, parts=parts)
            return self._packed

    @property
    def targets(self) -> MarkerTargets | str:
        """Target positions of the markers, or the reason why there are none."""
        with self._measuring:
            while self._measured is None or self._measured[0] != self._corrections:
                number = self._corrections  # while they are measured, more may be made
                self._measured = number, targets_or_reason(self.session.references, self.rig)
            return self._measured[1]

    def change(self, sent: SentChanges) -> dict[str, Any]:
        """Apply changes; return the new revision."""
        return {"revision": self.session.apply(sent.changes, revision=sent.revision)}

    def place(self, sent: SentPlace) -> None:
        """Correct the position of a marker, or remove the correction; invalidates `targets`."""
        with self._writing:
            correct_place(self.session, self.rig, sent.marker, sent.at)
            self._corrections += 1

    async def place_and_measure(self, sent: SentPlace) -> dict[str, Any]:
        """Correct the position of a marker; return the new markers."""
        await run_in_threadpool(self.place, sent)
        return await self.waits.result_of(self.markers)

    def poses(self) -> dict[str, Any]:
        """Return the saved poses."""
        return read_poses(poses_path(self.session.path)).model_dump()

    def save_pose(self, sent: SentPose) -> dict[str, Any]:
        """Save or remove a pose; return all."""
        self.rig.check_has(sent.weights or (), source="the page", remedy="reload it")
        with self._writing:
            self.session.lock.check()
            path = poses_path(self.session.path)
            return save_pose(path, sent.name, sent.weights).model_dump()

    def solve(self, sent: SentSolve) -> dict[str, Any]:
        """Return solved weights of the requested shapes; the others are held."""
        references, targets = self.session.references, self.targets
        if isinstance(targets, str):
            raise InputError(targets)
        if sent.pair >= len(references.frames):
            raise InputError(f"there are {len(references.frames)} pairs; reload the page")
        self.rig.check_has({*sent.weights, *sent.free}, source="the page", remedy="reload it")
        held = np.array([sent.weights.get(name, 0.0) for name in self.rig.shapes])
        free = np.isin(self.rig.shapes, sent.free)
        solved = solve_shapes(references, targets, sent.pair, held, free)
        weights = dict(zip(self.rig.shapes, solved.tolist(), strict=True))
        return {"weights": {name: weights[name] for name in sent.free}}

    def face(self) -> dict[str, Any]:
        """Return the face's header and a description of the pairs."""
        references = self.session.references
        heads = self.pictures.head_degrees()
        deformer = Deformer(self.rig)
        sided = sided_shapes(deformer.shapes.target_offsets(), deformer.neutral)
        pairs = [
            {
                "take": references.takes[pair],
                "frame": int(references.frames[pair]),
                "viseme": note.viseme,
                "emotion": note.emotion,
                "noPicture": self.pictures.reason_without(pair),
                "head": heads[pair],
                "notes": self._review_notes(pair),
            }
            for pair, note in enumerate(self.notes)
        ]
        return {
            "name": self.session.path.name,
            "rig": self.rig.file.name,
            "face": self.payload.header,
            "columns": [self.rig.shapes.index(name) for name in references.shape_names],
            "mirror": mirrored_shapes(references.shape_names).tolist(),
            "sided": [bool(sided[self.rig.shapes.index(n)]) for n in references.shape_names],
            "pairs": pairs,
            "first": self.first_pair,
        }

    def _review_notes(self, pair: int) -> list[str]:
        """Return the open notes on a pair's frame."""
        references, review = self.session.references, self.review
        if review is None or review.take not in ("", references.takes[pair]):
            return []
        frame = int(references.frames[pair])
        return [
            note.sentence()
            for note in review.notes
            if not note.done and note.span[0] <= frame <= note.span[1]
        ]

    def markers(self) -> dict[str, Any]:
        """Return marker targets for the live residual."""
        targets, placement = self.targets, self.session.references.placement
        if isinstance(targets, str):
            return {"reason": targets}
        return {
            "names": list(targets.names),
            "regions": list(targets.regions),
            "rest": _floats(targets.rest),
            "keyDeltas": _floats(targets.key_deltas),
            "targets": _floats(targets.targets),
            "corrected": list(targets.corrected),
            "lines": targets.lines.ravel().tolist(),
            "placement": "" if placement is None else corrected_path(placement).name,
        }

    def state(self) -> dict[str, Any]:
        """Return the current weights."""
        state = self.session.state()
        return {
            "revision": state.revision,
            "weights": _floats(state.weights),
            "proposals": _floats(state.proposals),
            "done": state.done.tolist(),
        }


async def _home(request: Request) -> Response:
    return Response(read_web_file("tune.html"), media_type="text/html; charset=utf-8")


async def _file(request: Request) -> Response:
    name = request.path_params["name"]
    kind = _FILES.get(Path(name).suffix)
    with contextlib.suppress(OSError):
        if kind is not None and Path(name).name == name:
            return Response(read_web_file(name), media_type=kind)
    return _refusal(404, f"no file {name}")


def build_application(scene: Scene) -> Starlette:
    """Return the application, to be wrapped in `usdface.tuning.guard.Guard`."""

    async def face_data(request: Request) -> Response:
        payload = await scene.waits.result_of(lambda: scene.payload)
        return Response(payload.data, media_type="application/octet-stream")

    async def picture(request: Request) -> Response:
        pair = request.path_params["pair"]
        if pair >= len(scene.notes):
            return _refusal(404, f"no pair {pair}")
        try:
            after = float(request.query_params.get("after", 0))
        except ValueError:
            after = np.nan
        if not abs(after) <= _FARTHEST_SECONDS:
            return _refusal(400, f"after is not a number of seconds up to {_FARTHEST_SECONDS:g}")
        data = await scene.waits.result_of(lambda: scene.pictures.jpeg(pair, after))
        return Response(data, media_type="image/jpeg")

    async def sound(request: Request) -> Response:
        pair = request.path_params["pair"]
        if pair >= len(scene.notes):
            return _refusal(404, f"no pair {pair}")
        data = await scene.waits.result_of(lambda: scene.pictures.sound(pair))
        return Response(data or b"", 200 if data else 204, media_type="audio/wav")

    def solve(sent: SentSolve) -> _Answer:
        return scene.waits.result_of(lambda: scene.solve(sent))

    def change(sent: SentChanges) -> _Answer:
        return run_in_threadpool(scene.change, sent)

    def save_pose(sent: SentPose) -> _Answer:
        return run_in_threadpool(scene.save_pose, sent)

    routes = [
        Route("/", _home),
        Route("/web/{name}", _file),
        Route("/face.json", _json(scene.face, scene.waits)),
        Route("/face.bin", face_data),
        Route("/markers.json", _json(scene.markers, scene.waits)),
        Route("/state.json", _json(scene.state, scene.waits)),
        Route("/poses.json", _json(scene.poses, scene.waits)),
        Route("/picture/{pair:int}.jpg", picture),
        Route("/sound/{pair:int}.wav", sound),
        Route("/changes", _answer(SentChanges, change), methods=["POST"]),
        Route("/place", _answer(SentPlace, scene.place_and_measure), methods=["POST"]),
        Route("/poses", _answer(SentPose, save_pose), methods=["POST"]),
        Route("/solve", _answer(SentSolve, solve), methods=["POST"]),
    ]
    return Starlette(
        routes=routes,
        exception_handlers={
            StaleRevisionError: _refuser(409),
            InputError: _refuser(422),
            StoppedError: _refuser(503, "`usdface tune` has been stopped"),
        },
    )


def _refusal(status: int, reason: str) -> Response:
    return JSONResponse({"reason": reason}, status_code=status)


def _refuser(status: int, reason: str | None = None) -> _Refuser:
    """Return an error handler that answers with the error's message or `reason`."""

    async def answer(request: Request, error: Exception) -> Response:
        return _refusal(status, str(error) if reason is None else reason)

    return answer


def _answer(
    kind: type[_Sent], make: Callable[[_Sent], _Answer]
) -> Callable[[Request], Awaitable[Response]]:
    """Return the handler of a POST, which answers with the result of its validated body."""

    async def answer(request: Request) -> Response:
        try:
            sent = kind.model_validate_json(await request.body())
        except ClientDisconnect:
            return _refusal(413, "the change is too large")
        except ValidationError as error:
            fault = error.errors()[0]
            where = ".".join(map(str, fault["loc"]))
            return _refusal(400, f"{where}: {fault['msg']}")
        return JSONResponse(await make(sent))

    return answer


def _json(
    make: Callable[[], dict[str, Any]], waits: Waits
) -> Callable[[Request], Awaitable[Response]]:
    async def answer(request: Request) -> Response:
        data = await waits.result_of(lambda: json.dumps(make(), allow_nan=False))
        return Response(data, media_type="application/json")

    return answer


def _floats(values: np.ndarray) -> str:
    return base64.b64encode(np.ascontiguousarray(values, "<f4").tobytes()).decode("ascii")
