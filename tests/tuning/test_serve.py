"""Where the page is served from."""

import socket
from pathlib import Path

from usdface.specs.tune import TuneSpec
from usdface.tuning.serve import _listen


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
