"""Show a recording in rerun's web viewer, for machines without a display or behind a tunnel.

The rerun package contains its web viewer. If rerun's own server were used, the viewer would ask rerun's servers for
fonts, examples and new versions, and every user of this machine could read the recording. Therefore rerun's server runs
without a recording, and only until `LocalServer` has the viewer's files. `LocalServer` then serves these files and the
recording under an address that nobody can guess, with a policy that allows connections to itself only.
"""

from __future__ import annotations

import re
import socket
import subprocess
import sys
import threading
import time
import urllib.error
import urllib.request
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from functools import partial
from pathlib import Path
from urllib.parse import quote

from recon.base.errors import InputError, Problem
from recon.base.local_server import WASM, Handler, LocalServer, Reply

LOOPBACK = "127.0.0.1"
FILES = {
    "": "text/html",
    "re_viewer.js": "text/javascript",
    "re_viewer_bg.wasm": WASM,
    "favicon.ico": "image/x-icon",
}
"""Files of the web viewer, with their media types."""
OPTIONAL = "favicon.ico"
"""File that some versions of the viewer lack."""
_POLICY = (
    "default-src 'none'; script-src 'self' 'unsafe-inline' 'wasm-unsafe-eval' blob:; style-src 'unsafe-inline'; "
    "img-src 'self' data: blob:; worker-src 'self' blob:; base-uri 'none'; form-action 'none'; frame-ancestors 'none'; "
    "connect-src 'self' data: blob:"
)
_LINK = re.compile(rb"<link[^>]*https?://[^>]*>")
RECORDING = "recording.rrd"
"""Name of the recording in the page's address. The viewer recognises the format by the suffix."""
VIEWER_OPTIONS = "theme=dark&persist=0"
"""Options in the page's address, which make the viewer dark and keep it from storing settings in the browser."""
START_S = 30.0
"""Longest time that rerun's server may take to start, seconds."""
TICK_S = 0.05
"""Time between two checks whether rerun's server has started, in seconds."""


@contextmanager
def served(path: Path) -> Iterator[str]:
    """Serve a recording, and yield the address of its page.

    Raises
    ------
    InputError
        If rerun's server cannot run.
    """
    pages: dict[str, Handler] = {name: partial(_kept, reply) for name, reply in _viewer_files().items()}
    server = LocalServer(pages | {RECORDING: partial(_recording, path)}, policy=_POLICY)
    threading.Thread(target=server.serve_forever, daemon=True).start()
    try:
        yield f"{server.address}?url={quote(server.address + RECORDING, safe='')}&{VIEWER_OPTIONS}"
    finally:
        server.shutdown()
        server.server_close()


def _kept(reply: Reply, _rest: str, _data: object) -> Reply:
    return reply


def _recording(path: Path, _rest: str, _data: object) -> Reply:
    return Reply(path.read_bytes(), "application/octet-stream")


def _viewer_files() -> dict[str, Reply]:
    """Return the files of the web viewer, keyed by their names, from rerun's server, which is stopped afterwards."""
    data_port, viewer_port = _free_ports(2)
    command = [str(_program()), "--serve-web", "--bind", LOOPBACK, "--port", str(data_port)]
    command += ["--web-viewer-port", str(viewer_port)]
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    try:
        _wait_for(process, (viewer_port,))
        files = dict[str, Reply]()
        for name, kind in FILES.items():
            try:
                files[name] = _file(f"http://{LOOPBACK}:{viewer_port}/{name}", kind)
            except urllib.error.HTTPError:
                if name != OPTIONAL:
                    raise
        return files
    finally:
        process.terminate()
        process.wait()


def _program() -> Path:
    """Return the path of rerun's program, since `python -m rerun` starts a child that outlives its parent."""
    import rerun_cli

    folder = Path(rerun_cli.__file__).parent
    bundled = folder / "Rerun.app" / "Contents" / "MacOS" / "Rerun"
    return bundled if bundled.exists() else folder / ("rerun.exe" if sys.platform == "win32" else "rerun")


def _file(address: str, kind: str) -> Reply:
    """Return a file of rerun's server without its links to other servers, to which browsers would preconnect."""
    content = _content(address)
    return Reply(_LINK.sub(b"", content) if kind == "text/html" else content, kind)


def _content(address: str) -> bytes:
    # Proxies are bypassed, because they cannot reach this machine.
    opener = urllib.request.build_opener(urllib.request.ProxyHandler({}))
    with opener.open(address) as response:
        return response.read()


def _free_ports(count: int) -> list[int]:
    sockets = [socket.socket() for _ in range(count)]
    try:
        for each_socket in sockets:
            each_socket.bind((LOOPBACK, 0))
        return [each_socket.getsockname()[1] for each_socket in sockets]
    finally:
        for each_socket in sockets:
            each_socket.close()


def _wait_for(process: subprocess.Popen[bytes], ports: tuple[int, ...]) -> None:
    """Wait until a process listens on all ports.

    Raises
    ------
    InputError
        If the process ends or takes too long.
    """
    until_s = time.monotonic() + START_S
    for port in ports:
        while not _listens(port):
            if process.poll() is not None or time.monotonic() > until_s:
                ending = "no answer" if process.poll() is None else f"exit code {process.returncode}"
                expected = "an answer; otherwise make a page (recon report DIR) or a recording (--out FILE.rrd)"
                raise InputError(Problem("recon view --web", "rerun's server", ending, expected))
            time.sleep(TICK_S)


def _listens(port: int) -> bool:
    with suppress(OSError), socket.create_connection((LOOPBACK, port), timeout=1.0):
        return True
    return False
