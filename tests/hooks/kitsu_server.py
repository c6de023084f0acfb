"""A server that answers as Kitsu's zou does, as far as our hook asks, and remembers."""

import json
import re
import threading
from functools import partial
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any
from urllib.parse import parse_qs, urlparse

NAMED = {
    "projects": ("name", "Kitchen"),
    "sequences": ("name", "SQ01"),
    "shots/all": ("name", "SH010"),
    "task-types": ("name", "Facial"),
    "task-status": ("short_name", "wfa"),
}


class Kitsu:
    """What the server knows; `url` is where it listens."""

    def __init__(self) -> None:
        self.comments: list[dict[str, Any]] = []
        self.previews: list[dict[str, Any]] = []
        self.uploads: dict[str, bytes] = {}
        self.main = ""
        self.refused = ""  # what is in the name of a file whose upload fails
        self.tokens: set[str | None] = set()
        kitsu = self

        class Handler(BaseHTTPRequestHandler):
            def log_message(self, *arguments: object) -> None:
                pass

            def do_GET(self) -> None:
                self.answer(kitsu.get(self.path))

            def do_PUT(self) -> None:
                self.rest()
                kitsu.main = self.path.split("/")[-2]
                self.answer({"id": kitsu.main})

            def do_POST(self) -> None:
                self.answer(kitsu.post(urlparse(self.path).path, self.rest()))

            def rest(self) -> bytes:
                kitsu.tokens.add(self.headers.get("Authorization"))
                if self.headers.get("Transfer-Encoding") != "chunked":
                    return self.rfile.read(int(self.headers.get("Content-Length", 0)))
                parts = []
                while size := int(self.rfile.readline(), 16):
                    parts.append(self.rfile.read(size))
                    self.rfile.readline()
                return b"".join(parts)

            def answer(self, data: object) -> None:
                body = json.dumps(data).encode()
                self.send_response(404 if data is None else 200)
                self.send_header("Content-Type", "application/json")
                self.send_header("Content-Length", str(len(body)))
                self.end_headers()
                self.wfile.write(body)

        self.server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
        self.url = f"http://127.0.0.1:{self.server.server_port}/api"
        self.thread = threading.Thread(target=partial(self.server.serve_forever, 0.02), daemon=True)
        self.thread.start()

    def close(self) -> None:
        self.server.shutdown()
        self.server.server_close()
        self.thread.join()

    def get(self, path: str) -> Any:
        parsed = urlparse(path)
        place = parsed.path.removeprefix("/api/data/")
        asked = {key: values[0] for key, values in parse_qs(parsed.query).items()}
        if place in NAMED:
            key, name = NAMED[place]
            return [{"id": place, key: name}] if asked.get(key) == name else []
        if place == "tasks":
            wanted = {"task_type_id": "task-types", "entity_id": "shots/all"}
            return [{"id": "task"}] if wanted.items() <= asked.items() else []
        if place == "tasks/task/previews":
            return self.previews
        if place == "tasks/task/comments":
            return self.comments
        return None

    def post(self, path: str, body: bytes) -> Any:
        place = path.removeprefix("/api/")
        if place == "auth/login":
            return {"login": True, "access_token": "t", "refresh_token": "r", "user": {}}
        if place == "actions/tasks/task/comment":
            said = json.loads(body)
            added = {"id": f"comment{len(self.comments)}", "text": said["comment"], "previews": []}
            self.comments.append(said | added)
            return self.comments[-1]
        if first := re.fullmatch(r"actions/tasks/task/comments/(\w+)/add-preview", place):
            return self._preview(first[1], json.loads(body)["revision"])
        if extra := re.fullmatch(r"actions/tasks/task/comments/(\w+)/preview-files/(\w+)", place):
            (shared,) = [each for each in self.previews if each["id"] == extra[2]]
            return self._preview(extra[1], shared["revision"])
        if place.startswith("pictures/preview-files/"):
            return self._upload(place.split("/")[-1], body)
        return None

    def _upload(self, preview: str, body: bytes) -> Any:
        name = re.search(rb'filename="([^"]+)\.\w+"', body)
        if name is None or (self.refused and self.refused.encode() in name[1]):
            return None
        self.uploads[preview] = body
        (known,) = [each for each in self.previews if each["id"] == preview]
        known["original_name"] = name[1].decode()
        return known

    def _preview(self, comment: str, revision: int) -> dict[str, Any]:
        made = {"id": f"preview{len(self.previews)}", "revision": revision, "original_name": None}
        self.previews.append(made)
        (known,) = [each for each in self.comments if each["id"] == comment]
        known["previews"].append({"id": made["id"]})
        return made
