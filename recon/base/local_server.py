"""Serve one page to a browser on this machine only.

The server listens on the loopback address and a free port. Its address has a secret token, so that no other user and no
other page can guess it. The server answers only requests that name the server as host, and takes data only from its own
page. Its headers forbid the browser to fetch anything from elsewhere.
"""

from __future__ import annotations

import json
import secrets
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer

WASM = "application/wasm"
"""Media type of WebAssembly, which browsers accept only without a charset."""
MAX_BYTES = 4_000_000
"""Maximum size of a request, in bytes, enough for thousands of corrections."""
_POLICY = (
    "default-src 'none'; script-src 'unsafe-inline'; style-src 'unsafe-inline'; img-src 'self' data: blob:; "
    "connect-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
)


@dataclass(frozen=True)
class Reply:
    """Reply of the server to a request."""

    content: bytes
    kind: str = "application/json"
    status: HTTPStatus = HTTPStatus.OK


Handler = Callable[[str, object], Reply]
"""Function that answers a request.

Its arguments are the rest of the path after the handler's name, and the request's JSON data or None.
"""


def json_reply(value: object, status: HTTPStatus = HTTPStatus.OK) -> Reply:
    """Return a reply whose content is a value in JSON."""
    return Reply(json.dumps(value).encode(), status=status)


def number_in(rest: str) -> int | None:
    """Return the rest of a path as a number, or None if it is not a number of at most nine digits."""
    return int(rest) if rest.isdecimal() and len(rest) < 10 else None


class LocalServer(ThreadingHTTPServer):
    """Server of one page, with a handler for each first part of a request's path.

    Parameters
    ----------
    pages
        Handlers of GET requests, keyed by the first part of the request's path, which is "" for the page itself.
    posts
        Handlers of POST requests, keyed by the first part of the request's path.
    policy
        The page's Content-Security-Policy.
    """

    daemon_threads = True

    def __init__(
        self, pages: Mapping[str, Handler], posts: Mapping[str, Handler] | None = None, policy: str = _POLICY
    ) -> None:
        super().__init__(("127.0.0.1", 0), _RequestHandler)
        posts, self.policy = posts or {}, policy
        self.pages, self.posts, self.token = pages, posts, secrets.token_urlsafe(24)

    @property
    def hosts(self) -> tuple[str, ...]:
        """Return the host names by which a browser on this machine may call the server."""
        return tuple(f"{name}:{self.server_port}" for name in ("127.0.0.1", "localhost"))

    @property
    def address(self) -> str:
        """Return the address of the page."""
        return f"http://{self.hosts[0]}/{self.token}/"


class _RequestHandler(BaseHTTPRequestHandler):
    server: LocalServer  # pyright: ignore[reportIncompatibleVariableOverride]
    protocol_version = "HTTP/1.1"
    timeout = 60

    def do_GET(self) -> None:
        self._answer(self.server.pages, lambda: None)

    def do_POST(self) -> None:
        self._answer(self.server.posts, self._data)

    def _answer(self, handlers: Mapping[str, Handler], read_data: Callable[[], object]) -> None:
        try:
            name, rest = self._target(handlers)
            reply = handlers[name](rest, read_data())
        except _RefusedError as refusal:
            reply = json_reply({"problem": refusal.args[1]}, refusal.args[0])
            self.close_connection = True
        self.send_response(reply.status)
        headers = {
            "Content-Type": reply.kind + "; charset=utf-8" * (reply.kind != WASM),
            "Content-Length": str(len(reply.content)),
            "Content-Security-Policy": self.server.policy,
            "X-Content-Type-Options": "nosniff",
            "Referrer-Policy": "no-referrer",
            "Cross-Origin-Resource-Policy": "same-origin",
            "Cache-Control": "no-store",
        }
        for header, value in headers.items():
            self.send_header(header, value)
        with suppress(ConnectionError):  # the browser closed the connection
            self.end_headers()
            self.wfile.write(reply.content)

    def _target(self, handlers: Mapping[str, Handler]) -> tuple[str, str]:
        """Return the handler's name and the rest of a request's path, or raise _RefusedError for another page."""
        if self.headers.get("Host") not in self.server.hosts:
            raise _RefusedError(HTTPStatus.FORBIDDEN, "another host")
        _, token, *parts = [*self.path.split("?")[0].split("/", 3), ""]
        name, rest = parts[0], parts[1] if len(parts) > 1 else ""
        if not secrets.compare_digest(token.encode(), self.server.token.encode()) or name not in handlers:
            raise _RefusedError(HTTPStatus.NOT_FOUND, "nothing is here")
        return name, rest

    def _data(self) -> object:
        if self.headers.get("Origin") not in [f"http://{host}" for host in self.server.hosts]:
            raise _RefusedError(HTTPStatus.FORBIDDEN, "another page")
        length = self.headers.get("Content-Length", "")
        if not length.isdecimal() or int(length) > MAX_BYTES:
            raise _RefusedError(HTTPStatus.REQUEST_ENTITY_TOO_LARGE, f"expected at most {MAX_BYTES} bytes")
        try:
            return json.loads(self.rfile.read(int(length)))
        except (ValueError, RecursionError):
            raise _RefusedError(HTTPStatus.BAD_REQUEST, "expected JSON") from None

    def log_message(self, format: str, *args: object) -> None:  # noqa: A002 (the base class names it)
        """Print nothing, so that the terminal is not filled with requests."""


class _RefusedError(Exception):
    """Error that refuses a request, with a status and a reason."""
