"""The options of `recon run`, `recon fix` and `recon label`."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field

from recon.api.options import FIRST_FRAME
from recon.base.errors import Problem
from recon.base.settings import Count, Integer, NameOrFile, Option, Settings
from recon.cli.look_options import ResultSettings

Stage = Literal["detect", "camera-motion", "fit", "analyse", "overlay", "playback", "page"]
_EXPORT = "Export instead of the page"


class RunSettings(Settings):
    """Settings of `recon run` in addition to the settings of the fit."""

    video: Annotated[Path, Option(argument="VIDEO")]
    """The video, such as run.mp4, or a folder of videos."""
    out: Path
    """Folder for all results, with one subfolder per video for a folder of videos."""
    model: Annotated[Path | None, Option(metavar="DIR")] = None
    """Folder of a trained network, such as models/run."""
    keypoints: Path | None = None
    """Keypoint file to use instead of a network, or the folder of the keypoint files of a folder of videos."""
    corrections: Path | None = None
    """Detections that were corrected by hand, for one video. (default: corrections.csv in --out, if there is one)"""
    camera_motion: Literal["turns", "zooms"] | None = None
    """Motion of the camera, to be found from the background: turns or zooms. (default: the camera is static)"""
    start: Annotated[Stage | None, Option(metavar="STAGE", name="--from")] = None
    """Repeat this stage and all later ones."""
    first_frame: Annotated[Integer, FIRST_FRAME] = 0
    jobs: Count | None = None
    """Number of videos to run at the same time. (default: one per core)"""
    config: Path | None = None
    """config.toml of an earlier fit. Options given here override it."""
    overwrite: bool = False
    """Replace files that other commands, such as recon fit, made in --out, but never your own or hand-changed files.
    """

    def problems(self) -> Iterator[Problem]:
        """Yield problems with the source of the keypoints, with corrections, and with the stage of --from."""
        if (self.model is None) == (self.keypoints is None):
            actual = "nothing" if self.model is None else f"{self.keypoints} together with --model"
            yield Problem("--keypoints", "keypoints", actual, "a keypoint file, or --model with a network")
        if self.corrections is not None and self.video.is_dir():
            from recon.io.corrections import CORRECTIONS  # slow to import, and help does not need it

            actual = f"{self.corrections} for a folder of videos"
            expected = f"{CORRECTIONS} in the folder of each video's results"
            yield Problem("--corrections", "corrections", actual, expected)
        if {"detect": self.model, "camera-motion": self.camera_motion}.get(self.start or "", ()) is None:
            yield Problem(
                "--from",
                "stage",
                f"{self.start!r} without --{'model' if self.start == 'detect' else self.start}",
                "a stage of this run",
            )

    @property
    def track(self) -> Path:
        """Return the path to which the run writes the track of a moving camera."""
        return self.out / f"{self.video.stem}_camera.csv"


class FixSettings(ResultSettings):
    """Settings of `recon fix`."""

    video: Path | None = None
    """Video of the keypoints, such as clip.mp4. (default: points on a plain background)"""
    out: Path | None = None
    """Corrections file, to which new corrections are added. (default: the fit's corrections file, or corrections.csv
    in the folder)
    """
    browser: Annotated[bool, Field()] = True
    """Open the page in the browser."""
    export_labels: Annotated[Path | None, Option(panel=_EXPORT, metavar="FOLDER")] = None
    """Write the corrected frames as DeepLabCut label files and COCO, into the labeled-data folder of this folder."""
    with_accepted: Annotated[bool, Option(panel=_EXPORT)] = False
    """Also label the points that were only accepted from the model."""
    scorer: Annotated[str, Option(panel=_EXPORT)] = "recon"
    """Name of the labeller, as in the project's config.yaml."""
    export_table: Annotated[Path | None, Option(panel=_EXPORT, metavar="FILE")] = None
    """Write the keypoints with the corrections as DeepLabCut's table, .csv or .h5."""
    overwrite: Annotated[bool, Option(panel=_EXPORT)] = False
    """Replace existing files."""

    def problems(self) -> Iterator[Problem]:
        """Yield a problem for each option that has no effect or cannot be used without another option."""
        if self.export_labels is not None and self.video is None:
            yield Problem("settings", "video", "nothing", "the video, whose frames are exported with the labels")
        if self.export_labels is None and self.with_accepted:
            yield Problem("settings", "with_accepted", "no --export-labels", "both options or neither")
        if self.export_labels is None and self.export_table is None and self.overwrite:
            yield Problem("settings", "overwrite", "nothing to replace", "--export-labels or --export-table as well")


class LabelSettings(Settings):
    """Settings of `recon label`."""

    video: Annotated[Path, Option(argument="VIDEO")]
    """The video, such as run.mp4."""
    out: Path
    """Folder for the labels. If it is a DeepLabCut project, its scorer and bodyparts are used."""
    skeleton: NameOrFile | None = None
    """The skeleton whose markers are labelled, such as cheetah-24. (default: cheetah-24, or the project's bodyparts)"""
    names: str | None = None
    """Names of the keypoints, instead of a skeleton's, such as nose,tail,paw."""
    frames: Count = 40
    """Number of frames, chosen so that they differ."""
    result: Path | None = None
    """Result of recon fit of this video, such as results/clip, from which the frames are chosen whose labels would
    lower the expected error most.
    """
    camera_name: str | None = None
    """Name of the video's camera in the result, such as cam2, if there are several."""
    first_frame: Annotated[Integer, FIRST_FRAME] = 0
    scorer: str | None = None
    """Name of the labeller. (default: the project's, or recon)"""
    browser: Annotated[bool, Field()] = True
    """Open the page in the browser."""

    def problems(self) -> Iterator[Problem]:
        """Yield a problem if --camera-name or --first-frame is given without --result."""
        if self.result is None and (self.camera_name is not None or self.first_frame):
            yield Problem("settings", "result", "nothing", "a result, which --camera-name and --first-frame need")
