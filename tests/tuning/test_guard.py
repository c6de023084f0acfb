"""Ways in, each tried: other pages, other hosts, stolen links, requests without a right."""

import asyncio
import json
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import httpx
import pytest

from tests.tuning.small_asset import write_asset
from usdface.tuning.application import Scene, build_application
from usdface.tuning.guard import LARGEST_BODY, Guard
from usdface.tuning.pictures import PairPictures
from usdface.tuning.session import TuningSession
from usdface.usdio.references.read import PairNotes
from usdface.usdio.rig.read import read_rig

PORT = 50123
HOME = f"http://127.0.0.1:{PORT}"
RIGHTS = {
    "origin": HOME,
    "x-usdface-tune": "1",
    "content-type": "application/json",
    "sec-fetch-site": "same-origin",
}


class Browser:
    """An HTTP client of the application, without a network."""

    def __init__(self, app: Any) -> None:
        self._client = httpx.AsyncClient(transport=httpx.ASGITransport(app), base_url=HOME)
        self.cookies = self._client.cookies

    def request(self, method: str, url: str, **more: Any) -> httpx.Response:
        return asyncio.run(self._client.request(method, url, **more))

    def get(self, url: str, **more: Any) -> httpx.Response:
        return self.request("GET", url, **more)

    def post(self, url: str, **more: Any) -> httpx.Response:
        return self.request("POST", url, **more)


class Server:
    def __init__(self, session: TuningSession) -> None:
        self.session = session
        self.links: list[str] = []
        rig = read_rig(session.references.rig_file)
        notes = [PairNotes()] * 5
        scene = Scene(session, rig, notes, PairPictures(session.references, notes, ()))
        self.guard = Guard(build_application(scene), port=PORT, announce=self.links.append)

    def browser(self, *, entered: bool = True) -> Browser:
        client = Browser(self.guard)
        if entered:
            assert client.get(self.guard.link).status_code == 303
        return client

    def change(self, value: float = 0.5) -> bytes:
        one = {"pair": 1, "take": "kitchen", "frame": 107, "weights": {"jawOpen": value}}
        return json.dumps({"revision": self.session.revision, "changes": [one]}).encode()


@pytest.fixture(scope="module")
def written(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_asset(tmp_path_factory.mktemp("asset"))


@pytest.fixture
def server(tmp_path: Path, written: Path) -> Iterator[Server]:
    shutil.copytree(written.parent, tmp_path, dirs_exist_ok=True)
    session = TuningSession(tmp_path / written.name)
    yield Server(session)
    session.lock.release()


def test_the_page_itself_may_read_and_change(server: Server) -> None:
    client = server.browser()
    assert client.get("/").status_code == 200
    assert client.get("/state.json").json()["revision"] == 0
    answer = client.post("/changes", content=server.change(), headers=RIGHTS)
    assert answer.json() == {"revision": 1}
    assert server.session.state().weights[1, 0] == 0.5


@pytest.mark.parametrize(
    ("attack", "status"),
    [
        ({"origin": "http://evil.example"}, 403),
        ({"origin": "http://127.0.0.1:9"}, 403),
        ({"origin": "null"}, 403),
        ({"origin": f"https://127.0.0.1:{PORT}"}, 403),
        ({"origin": None}, 403),
        ({"x-usdface-tune": None}, 403),
        ({"x-usdface-tune": "0"}, 403),
        ({"content-type": "text/plain"}, 415),
        ({"content-type": "application/x-www-form-urlencoded"}, 415),
        ({"content-type": None}, 415),
        ({"host": f"evil.example:{PORT}"}, 403),
        ({"host": "127.0.0.1"}, 403),
        ({"host": "127.0.0.1:9"}, 403),
        ({"host": f"localhost.evil.example:{PORT}"}, 403),
        ({"sec-fetch-site": "cross-site"}, 403),
        ({"sec-fetch-site": "same-site"}, 403),
        ({"cookie": None}, 403),
        ({"cookie": f"usdface_tune_{PORT}="}, 403),
        ({"cookie": f"usdface_tune_{PORT}=guessed"}, 403),
    ],
    ids=lambda value: str(value)[:44],
)
def test_a_change_that_lacks_one_right_is_refused(server: Server, attack, status) -> None:
    client = server.browser()
    headers = RIGHTS | {"cookie": f"usdface_tune_{PORT}={client.cookies[f'usdface_tune_{PORT}']}"}
    client.cookies.clear()
    headers = {k: v for k, v in (headers | attack).items() if v is not None}
    answer = client.post("/changes", content=server.change(), headers=headers)
    assert answer.status_code == status
    assert server.session.revision == 0


@pytest.mark.parametrize("path", ["/", "/state.json", "/face.json", "/face.bin", "/picture/0.jpg"])
def test_nothing_is_read_without_the_cookie(server: Server, path: str) -> None:
    answer = server.browser(entered=False).get(path)
    assert answer.status_code == 403
    assert "link" in answer.text


@pytest.mark.parametrize(
    "headers",
    [{"origin": "http://evil.example"}, {"sec-fetch-site": "cross-site"}, {"host": "evil:1"}],
    ids=["origin", "fetch", "host"],
)
def test_another_page_reads_nothing_even_with_the_cookie(server: Server, headers) -> None:
    assert server.browser().get("/state.json", headers=headers).status_code == 403


def test_a_link_opens_the_page_once(server: Server) -> None:
    link = server.guard.link
    assert server.browser(entered=False).get(link).status_code == 303
    thief = server.browser(entered=False)
    answer = thief.get(link)
    assert answer.status_code == 403
    assert not answer.cookies
    assert server.links == [server.guard.link]
    assert server.links[0] != link
    assert thief.get(server.links[0]).status_code == 303


def test_the_browser_that_entered_may_follow_its_old_link_again(server: Server) -> None:
    link = server.guard.link
    client = server.browser()
    assert client.get(link).status_code == 303
    assert not server.links


@pytest.mark.parametrize("token", ["", "x", "ü" * 40, "%00"])
def test_a_guessed_token_opens_nothing(server: Server, token: str) -> None:
    assert server.browser(entered=False).get("/", params={"token": token}).status_code == 403


def test_the_cookie_is_out_of_reach_of_scripts_and_other_sites(server: Server) -> None:
    cookie = server.browser(entered=False).get(server.guard.link).headers["set-cookie"].lower()
    assert "httponly" in cookie
    assert "samesite=strict" in cookie


@pytest.mark.parametrize("path", ["/", "/web/tune.js", "/state.json", "/web/../guard.py", "/none"])
def test_every_answer_carries_the_policy(server: Server, path: str) -> None:
    headers = server.browser().get(path).headers
    policy = headers["content-security-policy"]
    assert policy.startswith("default-src 'none'; script-src 'self';")
    assert "unsafe" not in policy
    assert "frame-ancestors 'none'" in policy
    assert headers["x-content-type-options"] == "nosniff"
    assert headers["cache-control"] == "no-store"
    assert "access-control-allow-origin" not in headers


@pytest.mark.parametrize("method", ["PUT", "DELETE", "PATCH", "OPTIONS", "TRACE"])
def test_only_get_and_post_are_understood(server: Server, method: str) -> None:
    answer = server.browser().request(method, "/changes", headers=RIGHTS)
    assert answer.status_code == 405


def test_a_preflight_of_another_page_gets_no_permission(server: Server) -> None:
    headers = {"origin": "http://evil.example", "access-control-request-headers": "x-usdface-tune"}
    answer = server.browser().request("OPTIONS", "/changes", headers=headers)
    assert answer.status_code == 403
    assert "access-control-allow-origin" not in answer.headers


@pytest.mark.parametrize("length", [None, "-1", "many", str(LARGEST_BODY + 1)])
def test_a_body_without_a_bearable_length_is_refused(server: Server, length: str | None) -> None:
    headers = RIGHTS | ({} if length is None else {"content-length": length})

    async def chunks() -> Any:
        yield b"{}"

    content = chunks() if length is None else b"{}"
    answer = server.browser().post("/changes", content=content, headers=headers)
    assert answer.status_code == 413


def test_a_header_that_is_there_twice_is_refused(server: Server) -> None:
    client = server.browser()
    headers = [*RIGHTS.items(), ("origin", "http://evil.example")]
    answer = client.post("/changes", content=server.change(), headers=headers)
    assert answer.status_code == 400


@pytest.mark.parametrize(
    "name", ["../guard.py", "..%2f..%2fguard.py", "%2e%2e/__init__.py", "tune.html", "nothing.js"]
)
def test_only_the_pages_own_files_are_served(server: Server, name: str) -> None:
    assert server.browser().get(f"/web/{name}").status_code == 404


@pytest.mark.parametrize(
    ("body", "said"),
    [
        (b"", "Invalid JSON"),
        (b"[]", "Input should be"),
        (b'{"revision": 0, "changes": [{"pair": -1, "take": "kitchen", "frame": 1}]}', "pair"),
        (b'{"revision": 0, "changes": [], "more": 1}', "more"),
        (
            b'{"revision":0,"changes":[{"pair":1,"take":"kitchen","frame":107,'
            b'"weights":{"jawOpen":NaN}}]}',
            "jawOpen",
        ),
        (
            b'{"revision":0,"changes":[{"pair":1,"take":"kitchen","frame":107,'
            b'"weights":{"jawOpen":"0.5"}}]}',
            "jawOpen",
        ),
    ],
    ids=["empty", "list", "negative", "extra", "nan", "text"],
)
def test_a_malformed_change_is_named(server: Server, body: bytes, said: str) -> None:
    answer = server.browser().post("/changes", content=body, headers=RIGHTS)
    assert answer.status_code == 400
    assert said in answer.json()["reason"]


def test_a_change_on_an_old_state_is_a_conflict_and_lost_nowhere(server: Server) -> None:
    client = server.browser()
    old = server.change(0.25)
    client.post("/changes", content=server.change(0.5), headers=RIGHTS)
    answer = client.post("/changes", content=old, headers=RIGHTS)
    assert answer.status_code == 409
    assert server.session.state().weights[1, 0] == 0.5


def test_a_change_of_no_pair_is_refused_with_the_reason(server: Server) -> None:
    body = server.change().replace(b'"pair": 1', b'"pair": 77')
    answer = server.browser().post("/changes", content=body, headers=RIGHTS)
    assert answer.status_code == 422
    assert "pair 78, and there are 5" in answer.json()["reason"]


def test_a_pair_without_a_picture_says_why(server: Server) -> None:
    answer = server.browser().get("/picture/0.jpg")
    assert answer.status_code == 422
    assert "kitchen was not found; name its file with --takes" in answer.json()["reason"]
    assert server.browser().get("/picture/99.jpg").status_code == 404
    assert server.browser().get("/sound/0.wav").status_code == 204
    assert server.browser().get("/sound/99.wav").status_code == 404


def test_the_face_and_its_columns_belong_together(server: Server) -> None:
    known = server.browser().get("/face.json").json()
    names = [shape["name"] for shape in known["face"]["shapes"]]
    assert [names[column] for column in known["columns"]] == ["jawOpen", "eyeBlink", "smile"]
    assert len(known["pairs"]) == 5
    assert known["pairs"][1] | {"noPicture": ""} == {
        "take": "kitchen",
        "frame": 107,
        "viseme": "",
        "emotion": "",
        "noPicture": "",
        "head": None,
        "notes": [],
    }


def test_markers_that_fit_no_face_leave_a_reason_in_place_of_a_residual(
    server: Server, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(*given: object, **more: object) -> None:
        raise ValueError("all markers lie on a line")

    monkeypatch.setattr("usdface.model.selection.baseline.place_markers", fail)
    reason = server.browser().get("/markers.json").json()["reason"]
    assert "cannot be placed" in reason
    assert "all markers lie on a line" in reason
    asked = {"pair": 0, "weights": {"smile": 0.5}, "free": ["jawOpen"]}
    answer = server.browser().post("/solve", content=json.dumps(asked), headers=RIGHTS)
    assert answer.status_code == 422
    assert "all markers lie on a line" in answer.json()["reason"]


def test_poses_are_of_the_rigs_shapes_and_have_names(server: Server) -> None:
    client = server.browser()
    for sent, status in (
        ({"name": " ", "weights": {"smile": 1.0}}, 400),
        ({"name": "a" * 81, "weights": {"smile": 1.0}}, 400),
        ({"name": "a", "weights": {"nobody": 1.0}}, 422),
        ({"name": "a", "weights": {"smile": 1e9}}, 400),
        ({"name": "a", "weights": {"smile": 1.0}}, 200),
        ({"name": "b", "weights": {"smile": 0.5, "jawOpen": 0.0}}, 200),
    ):
        assert client.post("/poses", content=json.dumps(sent), headers=RIGHTS).status_code == status
    poses = {"a": {"smile": 1.0}, "b": {"smile": 0.5}}
    assert client.get("/poses.json").json()["poses"] == poses
    server.session.lock.release()
    answer = client.post("/poses", content=b'{"name": "a"}', headers=RIGHTS)
    assert answer.status_code == 422, "another has the right to tune"
    assert client.get("/poses.json").json()["poses"] == poses
