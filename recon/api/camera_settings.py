"""Settings of the commands `recon calibrate`, `recon camera-motion` and `recon camera-advice`.

They are separate from the work, whose libraries the command line needs only when a command runs.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Annotated

from pydantic import Field

from recon.api.options import FIRST_FRAME
from recon.base.errors import Problem
from recon.base.settings import Integer, Number, OneOrMore, Option, Settings


class CalibrationSettings(Settings):
    """Settings of `recon calibrate`."""

    inputs: Annotated[OneOrMore[Path], Option(argument="IMAGES|FOLDER|VIDEO")]
    """Pictures of a board, folders of pictures, or one video."""
    board: str
    """The board: chessboard:9x6:25mm (inner corners, side of a square) or charuco:5x7:40mm:30mm:DICT_4X4_50 (squares,
    sides of square and marker, dictionary; append :legacy for the layout of OpenCV before 4.6).
    """
    model: str
    """Lens model: radtan for most lenses, fisheye for lenses wider than 100 degrees, pinhole for undistorted pictures.
    """
    out: Path
    """Camera file to write, such as camera.toml."""
    force: bool = False
    """Write the calibration even if a check refuses it."""
    overwrite: bool = False
    """Replace the camera file."""


class CameraMotionSettings(Settings):
    """Settings of `recon camera-motion`."""

    video: Annotated[Path, Option(argument="VIDEO")]
    """The video of a turning camera, such as clip.mp4."""
    camera: Path
    """The camera's calibration, such as camera.toml. A pose in the file is not used."""
    out: Path
    """The track to write, such as track.csv, for --camera-track."""
    camera_name: str | None = None
    """Name of the camera, if the file has several."""
    keypoints: Path | None = None
    """Keypoints of the animal, which are then excluded from the background."""
    individual: str | None = None
    """Name of the animal, if the keypoint file has several."""
    first_frame: Annotated[Integer, FIRST_FRAME] = 0
    tilt_deg: Annotated[Number, Field(ge=-90, le=90)] | None = None
    """Angle in degrees by which the camera looks down in the first frame. (default: level on average)"""
    level_marks: Path | None = None
    """Table of horizons and verticals (kind,frame,x1,y1,x2,y2), such as level.csv, instead of a tilt."""
    zoom: bool = False
    """The camera zooms. The camera file gives the focal length of the first frame."""
    overwrite: bool = False
    """Replace the track."""

    def problems(self) -> Iterator[Problem]:
        """Yield a problem if both a tilt and level marks are given."""
        if self.tilt_deg is not None and self.level_marks is not None:
            yield Problem("--tilt-deg", "level", f"{self.tilt_deg:g} with {self.level_marks}", "only one of the two")


class CameraAdviceSettings(Settings):
    """Settings of `recon camera-advice`."""

    skeleton: str
    """A built-in skeleton or a TOML file, such as cheetah-24."""
    out: Path
    """Folder for the figure, the table and the report."""
    prior: str | None = None
    """Motion prior: a built-in name, a file, or none. (default: as for a fit)"""
    angle: str | None = None
    """The angle to measure: the flexion of a joint, such as elbow (both sides) or left_elbow, or an angle of the
    skeleton, such as front_trunk_yaw.
    """
    joint: str | None = None
    """The joint to measure. (default: all)"""
    cameras: Annotated[Integer, Field(ge=1, le=2)] = 1
    """Number of cameras: 1, or 2 for the best second camera to add to the best first one."""
    hfov_deg: Annotated[Number, Field(gt=0, lt=180)] = 60.0
    """Horizontal field of view in degrees, such as 60."""
    distance_m: Annotated[Number, Field(gt=0, lt=1e4)] | None = None
    """Distance from the middle of the animal in metres, such as 8. (default: 4 times the animal's length)"""
    subject: str | None = None
    """A measured animal: built-in name or TOML file."""
    overwrite: bool = False
    """Replace earlier advice."""

    def problems(self) -> Iterator[Problem]:
        """Yield a problem if both an angle and a joint are given."""
        if self.angle is not None and self.joint is not None:
            yield Problem("--angle", "value", "--joint as well", "only one of the two, or neither for all joints")
