"""Serve the page of a command to a browser on this machine, and save the data that the page sends."""

from __future__ import annotations

import threading
import webbrowser
from collections.abc import Callable
from http import HTTPStatus
from pathlib import Path

from rich.console import Console

from recon.base.errors import InputError, Problem
from recon.base.local_server import Handler, LocalServer, Reply, json_reply
from recon.cli.answers import say, wait_for_ctrl_c


def serve_until_ctrl_c(console: Console, server: LocalServer, note: str, browser: bool) -> None:
    """Serve a page, print its address and a note, and open it in the browser if requested."""
    threading.Thread(target=server.serve_forever, daemon=True).start()
    say(console, f"The page is at {server.address}")
    say(console, note)
    if browser:
        webbrowser.open(server.address)
    wait_for_ctrl_c()
    server.shutdown()


def saving(save: Callable[[object], int], path: Path) -> Handler:
    """Return a handler that saves a page's data to a path, and answers with the number of saved items or a problem."""

    def reply(_rest: str, data: object) -> Reply:
        try:
            return json_reply({"saved": save(data)})
        except InputError as error:
            problem = error
        except OSError as error:
            problem = InputError(Problem(path, "file", error.strerror or str(error), "a disk that can be written to"))
        return json_reply({"problem": str(problem)}, HTTPStatus.CONFLICT)

    return reply
