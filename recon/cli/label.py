"""The command `recon label`: label frames of a video in a browser, from nothing."""

from __future__ import annotations

from http import HTTPStatus
from pathlib import Path
from typing import Annotated

from pydantic import Field
from rich.console import Console

from recon.animal.skeleton_file import load_skeleton
from recon.api.label_frames import LabelSession
from recon.base.local_server import LocalServer, Reply, json_reply
from recon.base.locks import sole_editor
from recon.base.numbers import counted
from recon.base.settings import Count, NameOrFile, Option, Settings
from recon.cli.answers import Answer
from recon.cli.serving import saving, serve_until_ctrl_c
from recon.io.deeplabcut_project import find_project
from recon.io.label_files import LABELED_DATA, require_label_names
from recon.io.video import probe
from recon.show.page.pages import rendered
from recon.show.page.scripts import script, style

SCORER = "recon"


class LabelSettings(Settings):
    """Settings of `recon label`."""

    video: Annotated[Path, Option(argument="VIDEO")]
    """The video, as in run.mp4."""
    out: Path
    """Folder for the labels; that of a DeepLabCut project has its scorer and bodyparts."""
    skeleton: NameOrFile | None = None
    """The skeleton whose markers are labelled, as in cheetah-24. (default: cheetah-24, or the project's bodyparts)"""
    names: str | None = None
    """Names of the keypoints in place of a skeleton's, as in nose,tail,paw."""
    frames: Count = 40
    """Number of frames, chosen so that they differ."""
    scorer: str | None = None
    """Name of the labeller. (default: the project's, or recon)"""
    browser: Annotated[bool, Field()] = True
    """Open the page in the browser."""


def label(settings: LabelSettings, console: Console) -> Answer:
    """Label frames of a video in a browser, for recon train and DeepLabCut.

    The frames are chosen so that they differ. The page is served on this machine only and ends with Ctrl-C; labels are
    saved with every click, and the same command goes on with them.

    Example: recon label run.mp4 --skeleton cheetah-24 --out project
    """
    video, project = settings.video, find_project(settings.out) if settings.out.is_dir() else None
    scorer = settings.scorer or (project.scorer if project else "") or SCORER
    require_label_names(video.stem, scorer)
    probe(video)
    skeleton = settings.skeleton
    if settings.names is not None:
        names = tuple(name.strip() for name in settings.names.split(","))
    elif skeleton is None and project is not None and project.bodyparts:
        names = project.bodyparts
    else:
        skeleton = skeleton or "cheetah-24"
        names = tuple(dict.fromkeys(name for pair in load_skeleton(skeleton).keypoints for name in pair))
    folder = settings.out / LABELED_DATA / video.stem
    with sole_editor(folder / f"CollectedData_{scorer}.csv"):
        session = LabelSession.open(video, settings.out, names, scorer, settings.frames, skeleton)
        server = label_server(session)
        serve_until_ctrl_c(
            console, server, f"Labels are saved in {session.output.folder}. Ctrl-C ends the page.", settings.browser
        )
    done = len({frame for frame, _ in session.points_px})
    lines = [f"{counted(len(session.points_px), 'label')} in {counted(done, 'frame')} are in {session.output.folder}."]
    if done:
        lines.append(f"Train a network with them: recon train {settings.out} --out models/{video.stem}")
    return Answer({"labels": len(session.points_px), "frames": done, "folder": session.output.folder}, lines)


def label_server(session: LabelSession) -> LocalServer:
    """Return the server of the page of a session."""

    def page(_rest: str, _data: object) -> Reply:
        html = rendered(
            "label.html",
            title=f"Label {session.video.name}",
            state=session.state(),
            player_style=style("player"),
            editor_script=script("label"),
        )
        return Reply(html.encode(), "text/html")

    def picture(rest: str, _data: object) -> Reply:
        path = session.picture(int(rest)) if rest.isdecimal() and len(rest) < 10 else None
        return json_reply(None, HTTPStatus.NOT_FOUND) if path is None else Reply(path.read_bytes(), "image/png")

    return LocalServer({"": page, "picture": picture}, {"labels": saving(session.save, session.output.folder)})
