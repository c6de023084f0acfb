"""Where the page is served from."""

import socket
import threading
from contextlib import ExitStack
from http.client import HTTPConnection
from pathlib import Path

import pytest
import uvicorn
from starlette.responses import PlainTextResponse

from tests.tuning.small_asset import change, write_asset
from usdface.specs.commands import TuneSpec
from usdface.tuning import guard, serve
from usdface.tuning.serve import _listen
from usdface.tuning.session import StaleRevisionError, TuningSession


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


def test_requests_that_are_never_made_hold_nobody_off(monkeypatch: pytest.MonkeyPatch) -> None:
    """Any process of the machine may connect, and say nothing more."""
    monkeypatch.setattr(guard, "REQUEST_SECONDS", 1.0)
    app = PlainTextResponse("here")
    config = uvicorn.Config(app, http=guard.PromptProtocol, lifespan="off", log_level="error")
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
            assert not guard.PromptProtocol._unasked
        finally:
            server.should_exit = True
            thread.join()
