"""The page of `recon label`, on which frames of a video are labelled."""

from __future__ import annotations

import shlex
from http import HTTPStatus

from rich.console import Console

from recon.animal.skeleton_file import load_skeleton
from recon.api.label_frames import LabelSession, frames_by_gain
from recon.api.settings import DEFAULT_SKELETONS
from recon.base.local_server import LocalServer, Reply, json_reply, number_in
from recon.base.locks import sole_editor
from recon.base.numbers import counted
from recon.cli.answers import Answer
from recon.cli.look import camera_number
from recon.cli.serving import saving, serve_until_ctrl_c
from recon.cli.video_options import LabelSettings
from recon.fit.motion import Motion
from recon.io.common import SCORER
from recon.io.deeplabcut_project import find_project
from recon.io.label_files import LABELED_DATA, require_label_names
from recon.io.video import probe
from recon.show.page.pages import rendered
from recon.show.page.scripts import script, style


def label_video(settings: LabelSettings, console: Console) -> Answer:
    """Serve the page until Ctrl-C, and return the answer."""
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
        skeleton = skeleton or DEFAULT_SKELETONS["trajectory"]
        names = tuple(dict.fromkeys(name for pair in load_skeleton(skeleton).keypoints for name in pair))
    folder, preferred = settings.out / LABELED_DATA / video.stem, _preferred(settings)
    with sole_editor(folder / f"CollectedData_{scorer}.csv"):
        session = LabelSession.open(video, settings.out, names, scorer, settings.frames, skeleton, preferred)
        server = label_server(session)
        serve_until_ctrl_c(
            console, server, f"Labels are saved in {session.output.folder}. Ctrl-C ends the page.", settings.browser
        )
    done = len({frame for frame, _ in session.points_px})
    lines = [f"{counted(len(session.points_px), 'label')} in {counted(done, 'frame')} are in {session.output.folder}."]
    if done:
        data, network = (shlex.quote(str(path)) for path in (settings.out, f"models/{video.stem}"))
        lines.append(f"Train a network with them: recon train {data} --out {network}")
    return Answer({"labels": len(session.points_px), "frames": done, "folder": session.output.folder}, lines)


def _preferred(settings: LabelSettings) -> list[int]:
    """Return the frames of the video whose labels would lower the expected error of the result most."""
    if settings.result is None:
        return []
    motion, frame_count = Motion.load(settings.result), probe(settings.video).stated_frames
    camera = camera_number(motion, settings.camera_name, settings.video)
    numbers = frames_by_gain(motion, camera, settings.frames)
    frames = [number - settings.first_frame for number in numbers]
    return [frame for frame in frames if frame >= 0 and (not frame_count or frame < frame_count)]


def label_server(session: LabelSession) -> LocalServer:
    """Return a local web server for the labelling page of a session."""

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
        number = number_in(rest)
        path = None if number is None else session.picture(number)
        return json_reply(None, HTTPStatus.NOT_FOUND) if path is None else Reply(path.read_bytes(), "image/png")

    return LocalServer({"": page, "picture": picture}, {"labels": saving(session.save, session.output.folder)})
