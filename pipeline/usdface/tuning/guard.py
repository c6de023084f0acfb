"""Access control of the tuning page.

Any page open in the browser may send requests to a loopback address, and any process of the machine
may connect. Each rule closes one of these ways; `tests/tuning/test_guard.py` tries them.
"""

import asyncio
import hmac
import secrets
from collections.abc import Callable
from http.cookies import CookieError, SimpleCookie
from typing import ClassVar

from starlette.datastructures import Headers, MutableHeaders
from starlette.requests import Request
from starlette.responses import PlainTextResponse, RedirectResponse, Response
from starlette.types import ASGIApp, Message, Receive, Scope, Send
from uvicorn.protocols.http.h11_impl import H11Protocol

PAGE_HEADER = "x-usdface-tune"
"""Header that scripts of other origins cannot send without a CORS preflight."""

_SINGLE_HEADERS = ("host", "origin", "content-type", "cookie", PAGE_HEADER)

LARGEST_BODY = 4 << 20
"""Bytes; all weights of a pair with thousands of shapes are far below."""

_SECURITY_HEADERS = {
    "Content-Security-Policy": (
        "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' data: blob:; "
        "connect-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
    ),
    "X-Content-Type-Options": "nosniff",
    "X-Frame-Options": "DENY",
    "Referrer-Policy": "no-referrer",
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Cache-Control": "no-store",
}


class Guard:
    """Middleware that refuses requests, and adds security headers to responses.

    `announce`: called with a new link if a used one is tried; a link opens the page once.
    """

    def __init__(self, app: ASGIApp, *, port: int, announce: Callable[[str], None]) -> None:
        self._app = app
        self._hosts = (f"127.0.0.1:{port}", f"localhost:{port}")
        self._cookie_name = f"usdface_tune_{port}"  # cookies are shared by all ports
        self._cookie = secrets.token_urlsafe(32)
        self._announce = announce
        self._token = ""
        self.link = self._new_link()

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass on or refuse a request."""
        if scope["type"] == "lifespan":
            await self._app(scope, receive, send)
            return
        if scope["type"] != "http":  # no web sockets
            await send({"type": "websocket.close", "code": 1008})
            return
        answer = self._answer(Request(scope))

        async def send_hardened(message: Message) -> None:
            if message["type"] == "http.response.start":
                headers = MutableHeaders(scope=message)
                for name, value in _SECURITY_HEADERS.items():
                    headers[name] = value
            await send(message)

        if answer is not None:
            await answer(scope, receive, send_hardened)
            return
        await self._app(scope, _limited(receive), send_hardened)

    def _answer(self, request: Request) -> Response | None:
        """Return the response that refuses a request; None to pass it on."""
        headers = request.headers
        if any(len(headers.getlist(name)) > 1 for name in _SINGLE_HEADERS):
            return _refusal(400, "a header is repeated")
        host, origin = headers.get("host", ""), headers.get("origin")
        if host not in self._hosts:  # DNS rebinding
            return _refusal(403, f"this server is not {host!r}; use the link it printed")
        if origin is not None and origin != f"http://{host}":
            return _refusal(403, "another page may not talk to this server")
        query = request.query_params
        if request.scope["path"] == "/" and request.method == "GET" and "token" in query:
            return self._enter(request)
        if headers.get("sec-fetch-site", "none") not in ("same-origin", "none"):
            return _refusal(403, "another page may not talk to this server")
        if not self._knows(headers):
            return _refusal(403, "open the link that `usdface tune` printed in its terminal")
        if request.method in ("GET", "HEAD"):
            return None
        if request.method != "POST":
            return _refusal(405, "only GET and POST are understood")
        if origin is None or headers.get(PAGE_HEADER) != "1":
            return _refusal(403, "only the tuning page may change weights")
        if headers.get("content-type", "").split(";")[0].strip().lower() != "application/json":
            return _refusal(415, "changes are sent as application/json")
        length = headers.get("content-length", "")
        if not length.isdigit() or int(length) > LARGEST_BODY:
            return _refusal(413, f"a change may have {LARGEST_BODY} bytes, got {length or 'none'}")
        return None

    def _enter(self, request: Request) -> Response:
        """Exchange a token, which is valid once, for the cookie."""
        given = request.query_params["token"]
        if hmac.compare_digest(given.encode(), self._token.encode()):
            self.link = self._new_link()
            response = RedirectResponse("/", status_code=303)
            response.set_cookie(
                self._cookie_name, self._cookie, httponly=True, samesite="strict", path="/"
            )
            return response
        if self._knows(request.headers):  # the same browser, with the link from its history
            return RedirectResponse("/", status_code=303)
        self._announce(self.link)
        return _refusal(403, "this link was used already; a new one is in the terminal")

    def _knows(self, headers: Headers) -> bool:
        try:
            morsel = SimpleCookie(headers.get("cookie", "")).get(self._cookie_name)
        except CookieError:
            return False
        given = morsel.value if morsel is not None else ""
        return hmac.compare_digest(given.encode(), self._cookie.encode())

    def _new_link(self) -> str:
        self._token = secrets.token_urlsafe(24)
        return f"http://{self._hosts[0]}/?token={self._token}"


def _refusal(status: int, reason: str) -> Response:
    return PlainTextResponse(f"{reason}\n", status_code=status, headers={"Connection": "close"})


def _limited(receive: Receive) -> Receive:
    """Disconnect if the body is longer than `LARGEST_BODY`, whatever its content-length."""
    total = 0

    async def wrapped() -> Message:
        nonlocal total
        message = await receive()
        total += len(message.get("body", b""))
        if total > LARGEST_BODY:
            return {"type": "http.disconnect"}
        return message

    return wrapped


REQUEST_SECONDS = 5.0
"""Time from connection to the end of the first request's header."""
MAX_IDLE_CONNECTIONS = 32
"""Most open connections without a request."""


class IdleTimeoutProtocol(H11Protocol):
    """Closes connections without a request, which any process could open."""

    _unasked: ClassVar[dict["IdleTimeoutProtocol", asyncio.TimerHandle]] = {}
    """Oldest first."""

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        """Start the timeout; with too many connections, close the oldest."""
        super().connection_made(transport)
        self._unasked[self] = self.loop.call_later(REQUEST_SECONDS, transport.close)
        if len(self._unasked) > MAX_IDLE_CONNECTIONS:
            oldest = next(iter(self._unasked))
            oldest.transport.close()
            oldest._settle()

    def data_received(self, data: bytes) -> None:
        """Keep a connection that has made a request."""
        super().data_received(data)
        if self.cycle is not None:
            self._settle()

    def connection_lost(self, exc: Exception | None) -> None:
        """Stop the timeout."""
        super().connection_lost(exc)
        self._settle()

    def _settle(self) -> None:
        timer = self._unasked.pop(self, None)
        if timer is not None:
            timer.cancel()
