"""The playback of a result with all that goes with it, in the viewer."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Annotated

from recon.base.errors import InputError, Problem
from recon.base.files import require_free_file, staged_file
from recon.base.manifest import read_manifest
from recon.base.settings import Option
from recon.fit.motion import Motion
from recon.show.view import open_viewer
from recon.show.view.together import put_together
from recon.show.view.video import write_video
from recon.workflows.analyse import FOLDER, PLAYBACK, PLOTS
from recon.workflows.settings import ResultSettings

VIDEO = "video.rrd"


class ViewSettings(ResultSettings):
    """What `recon view` is told."""

    video: Annotated[Path | None, Option("Show the frames of this video with it from now on, as in clip.mp4.")] = None
    analysis: Annotated[Path | None, Option("Folder of recon analyse. (default: analysis in DIR, if there is one)")] = (
        None
    )
    out: Annotated[
        Path | None, Option("Write all that is shown as one recording, and open nothing, as in clip.rrd.")
    ] = None
    overwrite: Annotated[bool, Option("Replace the recording of --out.")] = False

    def problems(self) -> Iterator[Problem]:
        for name in ("first_frame", "camera_name"):
            if getattr(self, name) and self.video is None:
                yield Problem("settings", name, "no --video", "one beside the other")


def run_view(settings: ViewSettings, say: Callable[[str], None] = lambda note: None) -> None:
    """`recon view`: open the playback, with the plots of `recon analyse` and the frames of a video.

    analysis: the folder of the analysis, by default the one in `folder`, if there is one. video: its frames are kept in
    `folder`, for the next time, where that can be written to. camera: whose video it is, where the clip has several.
    out: one recording of it all, which is written and not opened. Returns when the viewer is closed. Raises InputError.
    """
    playback = settings.folder / PLAYBACK
    if not playback.is_file():
        raise InputError(Problem(playback, "file", "no such file", "a recording (.rrd) that `recon fit` has written"))
    read_manifest(settings.folder).require(PLAYBACK)
    plots = (settings.folder / FOLDER if settings.analysis is None else settings.analysis) / PLOTS
    if settings.analysis is not None and not plots.is_file():
        raise InputError(Problem(plots, "file", "no such file", "the plots that `recon analyse` has written"))
    if settings.out is not None:
        require_free_file(settings.out, settings.overwrite)
    with TemporaryDirectory() as temporary:
        place = settings.folder if os.access(settings.folder, os.W_OK | os.X_OK) else Path(temporary)
        pictures = (place if settings.video is not None else settings.folder) / VIDEO
        if settings.video is not None:
            with staged_file(pictures) as staged:
                motion = Motion.load(settings.folder)
                write_video(staged, playback, motion, settings.video, settings.first_frame, settings.camera_name)
        present = [path if path.is_file() else None for path in (plots, pictures)]
        if any(present) or settings.out is not None:
            together = Path(temporary) / PLAYBACK if settings.out is None else settings.out
            with staged_file(together) as staged:
                for left_out in put_together(staged, playback, *present):
                    say(f"Left out, because it is of another fit: {left_out}")
            playback = together
        if settings.out is None:
            open_viewer(playback)
