"""Settings of the commands for robots, which the command line reads without the libraries of the work."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

from pydantic import BeforeValidator, Field

from recon.api.options import ANYWAY, STRIDE, StrideTimes
from recon.base.settings import Integer, Number, Option, Positive, Settings

MAX_SAMPLES = 10_000
"""Largest number of motions that --samples draws."""
RATE_HZ = 50.0
"""Default frame rate of files for programs that train policies, frames per second."""
_split = BeforeValidator(lambda value: tuple(value.split(",")) if isinstance(value, str) else value)
_Three = Annotated[tuple[Number, Number, Number], _split]
_THREE = Option(expected="3 numbers with commas, such as 0.1,-20,3", metavar="X,Y,Z")


class RetargetSettings(Settings):
    """Settings of `recon retarget`."""

    folder: Annotated[Path, Option(argument="DIR")]
    """Results folder of a fit, such as results/clip."""
    robot: str
    """a1, go2, aibo, or a .toml, .urdf or .xml (MJCF) file."""
    out: Path
    """Folder for tables, report and playback."""
    scale: Annotated[Positive | None, Option(expected="a number above 0")] = None
    """Factor on the animal's lengths. (default: the largest within reach and joint limits)"""
    slower: Annotated[Positive | None, Option(expected="a number above 0")] = None
    """Factor on the animal's times. (default: as large as the joints' rates require, at least 1)"""
    stride: Annotated[StrideTimes | None, STRIDE] = None
    format: Literal["amp", "isaaclab", "mjlab", "mjlab-csv"] | None = None
    """Also write files for programs that train policies, with velocities: amp, isaaclab, mjlab or mjlab-csv."""
    rate: Annotated[Positive, Option(expected="a number above 0")] = RATE_HZ
    """Frame rate of the files of --format, frames per second."""
    samples: Annotated[
        Annotated[Integer, Field(ge=2, le=MAX_SAMPLES)] | None, Option(expected=f"a number from 2 to {MAX_SAMPLES}")
    ] = None
    """Number of further motions to draw from the fit's posterior, such as 32."""
    check: bool = False
    """Check limits, torques, ground forces and colliding legs frame by frame with MuJoCo (the extra robots); write a
    table, a figure and advice.
    """
    fit_limits: bool = False
    """Change stride, duration and base path of the motion, and of the motions of --samples, as little as needed for
    the robot to perform them, and check before and after. Needs MuJoCo (the extra robots).
    """
    anyway: Annotated[bool, ANYWAY] = False
    overwrite: bool = False
    """Replace earlier files."""


class PoseSettings(Settings):
    """Settings of `recon robot pose`."""

    robot: Annotated[str, Option(argument="ROBOT")]
    """a1, go2, aibo, or a .toml, .urdf or .xml (MJCF) file."""
    move: Annotated[_Three | None, _THREE] = None
    """Shift of the body forwards, left and up from standing, metres, as in 0,0,-0.02. (default: 0,0,0)"""
    roll: Annotated[Number, Option(expected="degrees, such as 10")] = 0.0
    """Roll in degrees, right side down."""
    pitch: Annotated[Number, Option(expected="degrees, such as 10")] = 0.0
    """Pitch in degrees, nose down."""
    yaw: Annotated[Number, Option(expected="degrees, such as 10")] = 0.0
    """Yaw in degrees, to the left."""


class TableSettings(Settings):
    """Settings of `recon robot dh`."""

    source: Annotated[str, Option(argument="SOURCE")]
    """Table of Denavit-Hartenberg parameters (.toml), robot (a1, go2, aibo or a file), or .urdf or .xml file."""
    tip: str | None = None
    """Leg (LF, RF, LH or RH), or the link at the end for a .urdf or .xml file. (default: the only leaf)"""
    angles: Annotated[str | None, Option(metavar="NUMBERS")] = None
    """Show the position of the end for these angles, in degrees (metres for sliding joints), as in 0,45,-90."""
    place: Annotated[_Three | None, _THREE] = None
    """Show all angles that put the end at this position, in metres in base or body axes, such as 0.4,0.1,0.2."""
    turned: Annotated[_Three | None, _THREE] = None
    """Roll, pitch and yaw of the end for --place, degrees, as in 0,90,0. (default: any)"""


class ClimbSettings(Settings):
    """Settings of `recon climb`."""

    recipe: Annotated[str, Option(argument="RECIPE")] = "found-50"
    """found-50, published-50, highest-spatial or a .toml file."""
    out: Path
    """Folder for tables, figures and playback."""
    height: Annotated[Annotated[Number, Field(gt=0, le=10)] | None, Option(expected="metres, such as 0.045")] = None
    """Height of the step, metres; the footfalls' heights are scaled in proportion. (default: the recipe's)"""
    figures: bool = True
    """Also write figures as PNG and SVG."""
    overwrite: bool = False
    """Replace earlier files."""
