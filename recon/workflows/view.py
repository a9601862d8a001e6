"""`recon view`: the playback of a result with all that goes with it, in the viewer."""

from __future__ import annotations

import shlex
from collections.abc import Iterator
from pathlib import Path
from tempfile import TemporaryDirectory

import typer

from recon.base.errors import InputError, Problem
from recon.base.files import require_free_file, staged_file
from recon.base.manifest import read_manifest
from recon.gait.clip import analyse
from recon.show import view as viewer
from recon.workflows.analyse import FOLDER, PLAYBACK, SUMMARY
from recon.workflows.overlay import result_and_video
from recon.workflows.settings import ResultSettings


class _ViewSettings(ResultSettings):
    """The settings of `recon view`."""

    video: Path | None = None
    """Show the frames of this video with it, as in clip.mp4."""
    out: Path | None = None
    """Write one recording of it, as in clip.rrd, and open nothing."""
    overwrite: bool = False
    """Replace the recording of --out."""

    def problems(self) -> Iterator[Problem]:
        for name in ("first_frame", "camera_name"):
            if getattr(self, name) and self.video is None:
                yield Problem("settings", name, "no --video", "one beside the other")


def view(settings: _ViewSettings) -> None:
    """Open the playback of a reconstruction in the rerun viewer, with the plots of its analysis.

    Example: recon view results/clip --video clip.mp4
    """
    folder, out = settings.folder, settings.out
    playback = folder / PLAYBACK
    if not playback.is_file():
        raise InputError(Problem(playback, "file", "no such file", "a recording (.rrd) that `recon fit` has written"))
    read_manifest(folder).require(PLAYBACK)
    if out is not None:
        require_free_file(out, settings.overwrite)
    analysed = (folder / FOLDER / SUMMARY).is_file()
    with TemporaryDirectory() as temporary:
        if out is not None or settings.video is not None or analysed:
            motion, number, _ = result_and_video(settings)
            found = analyse(motion, lean=True) if analysed else None
            playback = Path(temporary) / PLAYBACK if out is None else out
            with staged_file(playback) as staged:
                viewer.write(motion, staged, found, settings.video, settings.first_frame, number)
        if out is None:
            viewer.open_viewer(playback)
    if out is not None:
        typer.echo(f"The recording is in {out}. Watch it with: rerun {shlex.quote(str(out))}")
