"""The options of `recon overlay`, `recon report` and `recon view`."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Annotated

from pydantic import Field

from recon.api.options import ANYWAY, FIRST_FRAME
from recon.base.errors import Problem
from recon.base.settings import Integer, Number, Option, Settings


class ResultSettings(Settings):
    """Settings that name a results folder and the video of one camera."""

    folder: Annotated[Path, Option(argument="DIR")]
    """Results folder, such as results/clip."""
    video: Path | None = None
    """Video of the keypoints, such as clip.mp4."""
    camera_name: str | None = None
    """Name of the video's camera, such as cam2, if there are several. (default: the camera in the video's name, or the
    first)
    """
    first_frame: Annotated[Integer, FIRST_FRAME] = 0


class OverlaySettings(ResultSettings):
    """Settings of `recon overlay`."""

    video: Path = Field()
    """Video of the keypoints, such as clip.mp4."""
    out: Path
    """The new video, .mp4 (MPEG-4), .webm (VP8, for browsers) or .avi (Motion JPEG), such as overlay.mp4."""
    anyway: Annotated[bool, ANYWAY] = False
    speed: Annotated[Number, Field(gt=0, le=10)] | None = None
    """Speed of the playback, 1 for real time. (default: 30 frames are shown per second)"""
    overwrite: bool = False
    """Replace existing files."""


class PageSettings(ResultSettings):
    """Settings of `recon report`."""

    folder: Annotated[Path, Option(argument="DIR")]
    """Results folder, such as results/clip, or a batch's folder."""


class ViewSettings(ResultSettings):
    """Settings of `recon view`."""

    video: Path | None = None
    """Show the frames of this video in the playback, such as clip.mp4."""
    out: Path | None = None
    """Write the playback to a recording, such as clip.rrd, and open no viewer."""
    web: bool = False
    """Serve the viewer to a browser until Ctrl-C, for a machine without a display."""
    overwrite: bool = False
    """Replace an existing recording."""

    def problems(self) -> Iterator[Problem]:
        """Yield problems with options that need a video."""
        for name in ("first_frame", "camera_name"):
            if getattr(self, name) and self.video is None:
                yield Problem("settings", name, "no --video", "both options or neither")
        if self.web and self.out is not None:
            yield Problem("--web", "viewer", f"--out {self.out} as well", "only one of the two options")
