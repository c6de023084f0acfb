"""Server of the tuning page on the loopback interface; saves when changes pause and at the end."""

import asyncio
import contextlib
import hashlib
import logging
import os
import secrets
import socket
from collections.abc import Callable

import numpy as np
import uvicorn

from usdface.core.confinement import check_confined
from usdface.core.errors import CancelledError, InputError
from usdface.core.text import shell_word
from usdface.specs.commands import TuneSpec
from usdface.specs.notes import read_notes
from usdface.tuning.application import Scene, build_application
from usdface.tuning.guard import Guard, IdleTimeoutProtocol
from usdface.tuning.pictures import PairPictures
from usdface.tuning.session import TuningSession
from usdface.tuning.waits import Waits
from usdface.usdio.references.read import read_pair_notes, read_rig_of, take_files
from usdface.usdio.rig.reference import moved_rig

log = logging.getLogger(__name__)

IDLE_SECONDS = 0.5
"""Interval of looks at the revision; if two in a row find the same one, the layer is written."""

RENEW_SECONDS = 5.0

REVISION_RANGE = 1 << 40
"""Far below the limit of exact integers in JavaScript."""

_FIRST_PORT, _PORTS = 49152, 16384


def serve(spec: TuneSpec, *, announce: Callable[[str], None]) -> TuningSession:
    """Serve the page until interrupted, then save; return the closed session, with its final state.

    `announce`: called with the link to the page, and with a new one if a used one is tried.
    """
    with moved_rig(spec.rig):
        session = TuningSession(
            spec.references,
            author=spec.author,
            take_over=spec.take_over,
            first_revision=secrets.randbelow(REVISION_RANGE),
        )
        try:
            with contextlib.closing(_listen(spec)) as listener:
                _run(session, spec, listener, announce)
        finally:
            session.close()
    return session


def _run(
    session: TuningSession, spec: TuneSpec, listener: socket.socket, announce: Callable[[str], None]
) -> None:
    references = session.references
    rig = read_rig_of(references, spec.references)
    notes = read_pair_notes(spec.references)
    takes = spec.takes or take_files(spec.references)
    check_confined([("tune", take) for take in takes])  # the asset may name them
    pictures = PairPictures(references, notes, takes)
    scene = Scene(
        session,
        rig,
        notes,
        pictures,
        review=None if spec.notes is None else read_notes(spec.notes),
        first_pair=_first_pair(spec, session),
    )
    guard = Guard(build_application(scene), port=listener.getsockname()[1], announce=announce)
    config = uvicorn.Config(
        guard,
        log_level="warning",
        access_log=False,
        server_header=False,
        http=IdleTimeoutProtocol,
        timeout_graceful_shutdown=1,
        lifespan="off",
    )
    try:
        asyncio.run(_serve_and_save(_Server(config, scene.waits), scene, guard, listener, announce))
    except (KeyboardInterrupt, CancelledError):
        log.info("interrupted; saving")
    finally:
        pictures.close()


class _Server(uvicorn.Server):
    """Stops without waiting for requests in `Waits`."""

    def __init__(self, config: uvicorn.Config, waits: Waits) -> None:
        super().__init__(config)
        self._waits = waits

    async def shutdown(self, sockets: list[socket.socket] | None = None) -> None:
        """Answer waiting requests, then shut down."""
        self._waits.stop()
        await super().shutdown(sockets)


def _first_pair(spec: TuneSpec, session: TuningSession) -> int:
    """Return the index of the first pair to show: of the frame, that which was added last."""
    frames = session.references.frames
    if spec.frame is None:
        return 0
    if spec.frame not in frames:
        raise InputError(
            f"{spec.references}: no pair is of frame {spec.frame}; add it with `usdface references "
            f"add PERFORMANCE --references {shell_word(spec.references)} --frames {spec.frame}`"
        )
    return int(np.flatnonzero(frames == spec.frame)[-1])


async def _serve_and_save(
    server: uvicorn.Server,
    scene: Scene,
    guard: Guard,
    listener: socket.socket,
    announce: Callable[[str], None],
) -> None:
    saving = asyncio.create_task(_save_when_idle(scene.session))
    # The face is packed while the browser starts; an error is told by the request for it.
    packing = asyncio.create_task(scene.waits.result_of(lambda: scene.payload))
    announce(guard.link)  # the socket is listening already
    try:
        await server.serve(sockets=[listener])
    finally:
        saving.cancel()
        packing.cancel()
        await asyncio.gather(packing, return_exceptions=True)
        with contextlib.suppress(asyncio.CancelledError):
            await saving


async def _save_when_idle(session: TuningSession) -> None:
    """Write the layer when changes pause, and renew the lock."""
    revision, warned, since_renewal = -1, "", 0.0
    while True:
        await asyncio.sleep(IDLE_SECONDS)
        since_renewal += IDLE_SECONDS
        if since_renewal >= RENEW_SECONDS:
            since_renewal = 0.0
            await asyncio.to_thread(session.lock.renew)
        newest = session.revision
        if session.is_saved or newest != revision:
            revision = newest
            continue
        try:
            await asyncio.to_thread(session.save)
            warned = ""
        # The journal has the changes; the page is told with the next. OSError is of a file server
        # that fails for a moment; the lock must be renewed all the same.
        except (InputError, OSError) as error:
            if str(error) != warned:
                log.warning("%s", error)
            warned = str(error)


def _listen(spec: TuneSpec) -> socket.socket:
    """Listen on loopback: on the requested port, or else on a port derived from the asset's path.

    The same port is the same origin, so that a page of an earlier server finds its unsent changes.
    """
    if spec.port:
        return _bound(spec.port)
    digest = hashlib.sha256(str(spec.references.resolve()).encode("utf-8")).digest()
    with contextlib.suppress(InputError):  # another server has it
        return _bound(_FIRST_PORT + int.from_bytes(digest[:4], "big") % _PORTS)
    return _bound(0)


def _bound(port: int) -> socket.socket:
    # Explicit protocol: with protocol 0, asyncio does not set TCP_NODELAY, a delay of 40 ms.
    listener = socket.socket(socket.AF_INET, socket.SOCK_STREAM, socket.IPPROTO_TCP)
    try:
        if os.name == "posix":  # on Windows, two programs could share a port
            listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        listener.bind(("127.0.0.1", port))
        listener.listen(64)
    except OSError as error:
        listener.close()
        raise InputError(
            f"port {port} of this machine cannot be used ({error.strerror}); give another --port, "
            "or none"
        ) from error
    return listener
