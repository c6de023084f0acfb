"""Where the page is served from."""

import asyncio
import errno
import json
import signal
import socket
import subprocess
import sys
import threading
from contextlib import ExitStack
from http.client import HTTPConnection
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import httpx
import numpy as np
import pytest
import uvicorn
from starlette.responses import PlainTextResponse

from tests.tuning.small_asset import change, write_asset
from usdface.specs.commands import TuneSpec
from usdface.tuning import guard, serve
from usdface.tuning.serve import _listen
from usdface.tuning.session import StaleRevisionError, TuningSession
from usdface.usdio.references.read import read_references


def test_it_listens_on_this_machine_alone_and_answers_without_delay(tmp_path: Path) -> None:
    with _listen(TuneSpec(references=tmp_path / "a.usda")) as listener:
        assert listener.getsockname()[0] == "127.0.0.1"
        # asyncio sets TCP_NODELAY only on such sockets; 40 ms an answer otherwise
        assert listener.proto == socket.IPPROTO_TCP


def test_an_asset_keeps_its_port_and_shares_it_with_nobody(tmp_path: Path) -> None:
    spec = TuneSpec(references=tmp_path / "a.usda")
    with _listen(spec) as first:
        port = first.getsockname()[1]
        with _listen(spec) as second:  # taken: any other port will do
            assert second.getsockname()[1] != port
    with _listen(spec) as again:
        assert again.getsockname()[1] == port


def test_of_two_takes_with_a_frame_the_pair_that_was_added_is_shown() -> None:
    references = SimpleNamespace(frames=np.array([50, 12, 50]))
    session: Any = SimpleNamespace(references=references)
    assert serve._first_pair(TuneSpec(references=Path("a.usda"), frame=50), session) == 2


def test_a_page_left_open_over_a_restart_is_told_to_read_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    shown: list[int] = []

    def restarted(session: TuningSession, *_: object) -> None:
        if shown:
            with pytest.raises(StaleRevisionError):
                session.apply([change(session, 1, jawOpen=0.5)], revision=shown[0])
        shown.append(session.revision)

    monkeypatch.setattr(serve, "_run", restarted)
    spec = TuneSpec(references=write_asset(tmp_path))
    for _ in range(3):
        serve.serve(spec, announce=print)
    assert len(set(shown)) == 3
    assert max(shown) < 2**53, "a browser's numbers"


def test_a_file_server_that_fails_for_a_moment_ends_neither_saving_nor_the_lock(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    asset = write_asset(tmp_path)
    session = TuningSession(asset)
    session.apply([change(session, 1, jawOpen=0.5)], revision=session.revision)
    save, faults = session.save, [OSError(errno.ESTALE, "Stale file handle")]
    renewed = threading.Event()
    monkeypatch.setattr(session, "save", lambda: save() if not faults else _raise(faults.pop()))
    monkeypatch.setattr(session.lock, "renew", renewed.set)
    monkeypatch.setattr(serve, "IDLE_SECONDS", 0.01)
    monkeypatch.setattr(serve, "RENEW_SECONDS", 0.1)

    async def work() -> None:
        saving = asyncio.create_task(serve._save_when_idle(session))
        while not (saving.done() or (session.is_saved and renewed.is_set())):
            await asyncio.sleep(0.01)
        assert not saving.done(), saving.exception()
        saving.cancel()

    asyncio.run(asyncio.wait_for(work(), 20))
    assert read_references(asset).weights[1, 0] == 0.5
    session.close()


def _raise(error: OSError) -> None:
    raise error


def test_ctrl_c_does_not_wait_for_markers_that_are_being_placed(tmp_path: Path) -> None:
    asset = write_asset(tmp_path)
    program = """
import sys, time
from usdface.cli import main
from usdface.tuning import application
def place(*given):
    print("placing", flush=True)
    time.sleep(600)
application.targets_or_reason = place
sys.argv = ["usdface", "tune", sys.argv[1], "--no-browser", "--json"]
main()
"""
    command = [sys.executable, "-c", program, str(asset)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE) as process:
        assert process.stdout is not None
        link = json.loads(process.stdout.readline())["link"]
        with httpx.Client(base_url=link.split("/?")[0], timeout=60) as client:
            client.get(link)
            asked: list[int] = []

            def ask() -> None:
                asked.append(client.get("/markers.json").status_code)

            thread = threading.Thread(target=ask)
            thread.start()
            assert process.stdout.readline() == b"placing\n"
            rights = {"origin": link.split("/?")[0], "x-usdface-tune": "1"}
            state = client.get("/state.json").json()
            change = {"pair": 1, "take": "kitchen", "frame": 107, "weights": {"jawOpen": 0.5}}
            sent = {"revision": state["revision"], "changes": [change]}
            assert client.post("/changes", json=sent, headers=rights).status_code == 200
            process.send_signal(signal.SIGINT)
            out, err = process.communicate(timeout=60)
            thread.join()
    assert process.returncode == 0
    assert json.loads(out)["figures"]["tuned"] == 1
    assert err == b""
    assert asked == [503]
    assert read_references(asset).weights[1, 0] == 0.5
    assert not list(tmp_path.glob("*.lock")) + list(tmp_path.glob("*.journal"))


def test_requests_that_are_never_made_hold_nobody_off(monkeypatch: pytest.MonkeyPatch) -> None:
    """Any process of the machine may connect, and say nothing more."""
    monkeypatch.setattr(guard, "REQUEST_SECONDS", 1.0)
    app = PlainTextResponse("here")
    config = uvicorn.Config(app, http=guard.IdleTimeoutProtocol, lifespan="off", log_level="error")
    server = uvicorn.Server(config)
    with socket.create_server(("127.0.0.1", 0), backlog=128) as listener, ExitStack() as sockets:
        thread = threading.Thread(target=server.run, kwargs={"sockets": [listener]})
        thread.start()
        try:
            address = listener.getsockname()
            half_open = [
                sockets.enter_context(socket.create_connection(address)) for _ in range(70)
            ]
            for each in half_open:
                each.sendall(b"GET / HTTP/1.1\r\nHost: 127.0.0.1\r\n")
            page = HTTPConnection(*address, timeout=10)
            for _ in range(3):
                page.request("GET", "/")
                assert page.getresponse().read() == b"here"
            page.close()
            half_open[-1].settimeout(10)
            assert half_open[-1].recv(1) == b""  # closed, as it said nothing more
            assert not guard.IdleTimeoutProtocol._unasked
        finally:
            server.should_exit = True
            thread.join()
