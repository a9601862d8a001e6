"""The command `recon fix`: correct wrong keypoints of a result in a browser."""

from __future__ import annotations

import threading
import webbrowser
from contextlib import suppress
from http import HTTPStatus
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Annotated

import cv2
from pydantic import Field
from rich.console import Console

from recon.api.clip_results import CONFIG, read_config
from recon.api.corrections import CORRECTIONS, CorrectionSession
from recon.base.errors import InputError, Problem
from recon.base.interrupts import installed
from recon.base.local_server import LocalServer, Reply, json_reply
from recon.base.locks import sole_editor
from recon.base.numbers import counted
from recon.base.outputs import require_suffix
from recon.cli.answers import Answer, say
from recon.cli.look import ResultSettings, first_in_clip, result_and_video
from recon.io.video import Image
from recon.show.overlay import clip_frames
from recon.show.page.pages import rendered
from recon.show.page.scripts import script, style

JPEG_QUALITY = 90


class FixSettings(ResultSettings):
    """Settings of `recon fix`."""

    video: Path | None = None
    """The video that the keypoints came from, as in clip.mp4. (default: points on a plain background)"""
    out: Path | None = None
    """File of the corrections, which are added to those that it has. (default: the fit's own, or corrections.csv in the
    folder)"""
    browser: Annotated[bool, Field()] = True
    """Open the page in the browser."""


def fix(settings: FixSettings, console: Console) -> Answer:
    """Correct wrong keypoints in a browser, while the animal is fitted again.

    The page is served on this machine only. It ends with Ctrl-C. Corrections are saved with every change; the results
    stay as they are.

    Example: recon fix results/clip --video clip.mp4
    """
    motion, number = result_and_video(settings)
    out = settings.out or read_config(settings.folder / CONFIG, {}).corrections or settings.folder / CORRECTIONS
    require_suffix(out, (".csv",))
    if not out.parent.is_dir():
        raise InputError(Problem("--out", "folder", f"{out.parent}, no such folder", "a folder that there is"))
    if out.is_symlink():
        raise InputError(Problem("--out", "file", f"{out}, a link", "a file that is no link"))
    with sole_editor(out), TemporaryDirectory() as folder:
        session = CorrectionSession.open(settings.folder, out, number)
        pictures = Path(folder)
        if settings.video is not None:
            start = first_in_clip(motion, number, settings)
            frames = motion.frames, settings.video, start
            threading.Thread(target=_decode, args=(*frames, pictures), daemon=True).start()
        server = _server(session, pictures, settings.video is not None)
        threading.Thread(target=server.serve_forever, daemon=True).start()
        say(console, f"The page is at {server.address}")
        say(console, f"Corrections are saved in {out}. Ctrl-C ends the editor.")
        if settings.browser:
            webbrowser.open(server.address)
        _wait()
        server.shutdown()
    lines = [f"{counted(len(session.corrections), 'correction')} in {out}."]
    if session.corrections:
        lines.append(f"Fit with them: recon fit --config {settings.folder / CONFIG} --corrections {out} --out again")
    return Answer({"out": out, "corrections": len(session.corrections)}, lines)


def _wait() -> None:
    """Wait for Ctrl-C, which ends the editor and is no error."""
    with suppress(KeyboardInterrupt):
        threading.Event().wait()
    interrupts = installed()
    if interrupts is not None:
        interrupts.said = True


def _decode(frames: object, video: Path, start: int, folder: Path) -> None:
    """Write every frame of the clip as a picture, called by its row."""
    for _, row, _, picture in clip_frames(frames, video, start):  # type: ignore[arg-type]
        if row is not None:
            _write_picture(folder / f"{row}.jpg", picture)


def _write_picture(path: Path, picture: Image) -> None:
    content = cv2.imencode(".jpg", picture, [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY])[1].tobytes()
    part = path.with_suffix(".part")
    part.write_bytes(content)
    part.replace(path)


def _server(session: CorrectionSession, pictures: Path, has_video: bool) -> LocalServer:
    def page(_rest: str, _data: object) -> Reply:
        html = rendered(
            "fix.html",
            title=f"Correct {session.folder.name}",
            state=session.state() | {"video": has_video},
            player_style=style("player"),
            editor_script=script("fix"),
        )
        return Reply(html.encode(), "text/html")

    def state(rest: str, _data: object) -> Reply:
        version = int(rest) if rest.isdecimal() else -1
        is_new = session.changed(version)
        return json_reply(session.state() if is_new else None)

    def picture(rest: str, _data: object) -> Reply:
        path = pictures / f"{int(rest)}.jpg" if rest.isdecimal() else None
        if path is None or not path.is_file():
            return json_reply(None, HTTPStatus.NOT_FOUND)
        return Reply(path.read_bytes(), "image/jpeg")

    def save(_rest: str, data: object) -> Reply:
        try:
            return json_reply({"saved": session.save(data)})
        except InputError as error:
            return json_reply({"problem": str(error)}, HTTPStatus.CONFLICT)

    return LocalServer({"": page, "state": state, "picture": picture}, {"corrections": save})
