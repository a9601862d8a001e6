"""Test which requests the server of one page on this machine answers."""

from __future__ import annotations

import http.client
import json
import threading
from collections.abc import Iterator

import pytest

from recon.base.local_server import MAX_BYTES, LocalServer, Reply, json_reply


@pytest.fixture
def server() -> Iterator[LocalServer]:
    pages = {"": lambda _rest, _data: Reply(b"<p>", "text/html"), "echo": lambda rest, _data: json_reply(rest)}
    server = LocalServer(pages, {"save": lambda _rest, data: json_reply({"got": data})})
    threading.Thread(target=server.serve_forever, args=(0.01,), daemon=True).start()
    yield server
    server.shutdown()
    server.server_close()


def ask(server: LocalServer, path: str, method: str = "GET", body: str | None = None, **headers: str):
    connection = http.client.HTTPConnection("127.0.0.1", server.server_port, timeout=10)
    connection.request(method, path, body, headers)
    response = connection.getresponse()
    content = response.read()
    connection.close()
    return response, content


def test_the_page_is_served_at_its_secret_address_only(server: LocalServer):
    response, content = ask(server, f"/{server.token}/")
    assert (response.status, content) == (200, b"<p>")
    assert "default-src 'none'" in str(response.headers["Content-Security-Policy"])
    assert ask(server, f"/{server.token}/echo/a/b")[1] == b'"a/b"'
    for path in ("/", "/other/", f"/{server.token}/else", f"/{server.token}x/", "//", "/%2e%2e/etc/passwd"):
        assert ask(server, path)[0].status == 404
    assert server.server_address[0] == "127.0.0.1"


def test_another_host_or_page_is_refused(server: LocalServer):
    """Requests by another host name, and from a page of another origin, are refused."""
    assert ask(server, f"/{server.token}/", Host="evil.example")[0].status == 403
    origin = f"http://127.0.0.1:{server.server_port}"
    path = f"/{server.token}/save"
    response, content = ask(server, path, "POST", "[1]", Origin=origin)
    assert (response.status, json.loads(content)) == (200, {"got": [1]})
    for headers in ({}, {"Origin": "http://evil.example"}, {"Origin": "null"}):
        assert ask(server, path, "POST", "[1]", **headers)[0].status == 403


@pytest.mark.parametrize(("body", "status"), [("{", 400), ("[" * 100_000, 400), ("", 400)])
def test_data_that_is_not_json_is_refused(server: LocalServer, body: str, status: int):
    origin = f"http://localhost:{server.server_port}"
    assert ask(server, f"/{server.token}/save", "POST", body, Origin=origin)[0].status == status


def test_a_request_that_is_too_large_is_not_read(server: LocalServer):
    headers = {"Origin": f"http://127.0.0.1:{server.server_port}", "Content-Length": str(MAX_BYTES + 1)}
    assert ask(server, f"/{server.token}/save", "POST", None, **headers)[0].status == 413
