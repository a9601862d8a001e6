"""Settings of the commands that make skeletons, subjects and priors.

They are separate from the work, whose libraries the command line needs only when a command runs.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Annotated

from recon.api.options import ANYWAY, INDIVIDUAL
from recon.api.settings import Unit
from recon.base.errors import Problem
from recon.base.numbers import counted
from recon.base.settings import Count, File, NotNegative, OneOrMore, Option, Positive, Settings


class SkeletonDraftSettings(Settings):
    """Settings of `recon skeleton from-keypoints`."""

    keypoints: Annotated[OneOrMore[Path], Option(argument="KEYPOINTS")]
    """Keypoint file, or DeepLabCut project. With --camera, one file per camera."""
    out: Path
    """Skeleton file to write, such as my-animal.toml."""
    individual: Annotated[str | None, Option(INDIVIDUAL)] = None
    camera: OneOrMore[File] | None = None
    """Calibration of several cameras, with which the draft is made from distances that stay constant. (default: from
    names)
    """
    fps: Positive | None = None
    """With --camera: frame rate in Hz. (default: as stated in the file)"""
    up: str | None = None
    """With --camera: upward axis of the calibration's world, such as z or -y, or first-camera if the first camera is
    level. (default: as stated in the file)
    """
    camera_name: OneOrMore[str] | None = None
    """With --camera: name of the camera in the file, such as cam2 or 2, once per keypoint file. (default: the camera
    whose name the keypoint file's name contains)
    """
    camera_unit: Unit = "m"
    """With --camera: unit of the cameras' positions in the file, which is often mm for Anipose."""
    overwrite: bool = False
    """Replace the file."""


class SubjectFitSettings(Settings):
    """Settings of `recon subject fit`."""

    clips: Annotated[OneOrMore[Path], Option(argument="CLIPS")]
    """Results of clips from several cameras, or their config.toml files."""
    out: Path
    """File to write the subject to, such as my-cat.toml."""
    lengths: bool = True
    """Measure the lengths of the segments, assuming that left equals right."""
    offsets: bool = False
    """Measure the offsets of the detector's keypoints from the markers."""
    poses: tuple[Path, ...] = ()
    """3D poses from another method, one file per clip, relative to which offsets are measured."""
    title: str | None = None
    """Title of the animal. (default: made from the clips)"""
    overwrite: bool = False
    """Replace the file."""

    def problems(self) -> Iterator[Problem]:
        """Yield problems if there is nothing to measure, or if poses are not given for every clip."""
        if not self.lengths and not self.offsets:
            yield Problem("--no-lengths", "unknowns", "nothing to fit", "--offsets as well, or no option --no-lengths")
        if self.poses and (self.lengths or not self.offsets):
            yield Problem("--poses", "unknowns", "lengths to fit, or no offsets", "--no-lengths --offsets as well")
        if self.poses and len(self.poses) != len(self.clips):
            yield Problem(
                "--poses",
                "files",
                f"{counted(len(self.poses), 'file')} for {counted(len(self.clips), 'clip')}",
                "a file for each clip",
            )


class PriorFitSettings(Settings):
    """Settings of `recon prior fit`."""

    poses: Annotated[OneOrMore[Path], Option(argument="POSES")]
    """Results of recon fit, or 3D poses such as pose3d.csv: metres, z up."""
    out: Path
    """File to write the prior to, such as my-dog.npz."""
    skeleton: str | None = None
    """Skeleton of 3D poses, such as cheetah-24. (default: the results' skeleton)"""
    fps: str | None = None
    """Frame rate of 3D poses in Hz, or a JSON file with {"fps": [...]}, one rate per segment."""
    subject: str | None = None
    """Measured animal, given by its name, such as phantom, or by a TOML file."""
    estimate_size: bool = False
    """Scale the skeleton to the animal in each file."""
    components: Count = 16
    """Number of Gaussians in the mixture of poses, each of which needs 20 frames."""
    min_speed_m_s: NotNegative = 0.0
    """Leave out segments that are slower than this speed in m/s, such as 8.5."""
    apart: tuple[str, ...] = ()
    """Body segment that moves independently of the others, such as tail_1."""
    name: str | None = None
    """Name of the prior. (default: the name of the file)"""
    source: str = ""
    """Origin of the poses, stored with the prior."""
    check: bool = False
    """Score each segment under a prior fitted to the others."""
    anyway: Annotated[bool, ANYWAY] = False
    overwrite: bool = False
    """Replace the file."""
