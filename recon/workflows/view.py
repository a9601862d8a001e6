"""The playback of a result with all that goes with it, in the viewer."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path
from tempfile import TemporaryDirectory

from recon.base.errors import InputError, Problem
from recon.base.files import require_free_file, staged_file
from recon.base.manifest import read_manifest
from recon.show.view import open_viewer
from recon.show.view.together import put_together
from recon.show.view.video import write_video
from recon.workflows.analyse import FOLDER, PLAYBACK, PLOTS

VIDEO = "video.rrd"


def run_view(
    folder: Path,
    analysis: Path | None = None,
    video: Path | None = None,
    first_frame: int = 0,
    camera: str | None = None,
    out: Path | None = None,
    overwrite: bool = False,
    say: Callable[[str], None] = lambda note: None,
) -> None:
    """`recon view`: open the playback, with the plots of `recon analyse` and the frames of a video.

    analysis: the folder of the analysis, by default the one in `folder`, if there is one. video: its frames are kept in
    `folder`, for the next time, where that can be written to. camera: whose video it is, where the clip has several.
    out: one recording of it all, which is written and not opened. Returns when the viewer is closed. Raises InputError.
    """
    playback = folder / PLAYBACK
    if not playback.is_file():
        raise InputError(Problem(playback, "file", "no such file", "a recording (.rrd) that `recon fit` has written"))
    read_manifest(folder).require(PLAYBACK)
    plots = (folder / FOLDER if analysis is None else analysis) / PLOTS
    if analysis is not None and not plots.is_file():
        raise InputError(Problem(plots, "file", "no such file", "the plots that `recon analyse` has written"))
    for option, value in (("--first-frame", first_frame), ("--camera-name", camera)):
        if value and video is None:
            raise InputError(Problem(option, "video", "no --video", "one beside the other"))
    if out is not None:
        require_free_file(out, overwrite)
    with TemporaryDirectory() as temporary:
        place = folder if os.access(folder, os.W_OK | os.X_OK) else Path(temporary)
        pictures = (place if video is not None else folder) / VIDEO
        if video is not None:
            with staged_file(pictures) as staged:
                write_video(staged, playback, video, first_frame, camera)
        present = [path if path.is_file() else None for path in (plots, pictures)]
        if any(present) or out is not None:
            together = Path(temporary) / PLAYBACK if out is None else out
            with staged_file(together) as staged:
                for left_out in put_together(staged, playback, *present):
                    say(f"Left out, because it is of another fit: {left_out}")
            playback = together
        if out is None:
            open_viewer(playback)
