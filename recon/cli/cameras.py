"""Define the commands for cameras: lens calibration, poses from clips, camera motion, and camera placement."""

from __future__ import annotations

import json
import math
import shlex
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from pydantic import Field
from rich.console import Console
from rich.table import Table
from rich.text import Text

from recon.api.camera_settings import CalibrationSettings, CameraAdviceSettings, CameraMotionSettings
from recon.api.settings import FitSettings
from recon.base.numbers import counted, length_text, quantity
from recon.base.outputs import Output, output_file
from recon.base.progress import Progress, silent
from recon.base.settings import Number, OneOrMore, Option, Settings, input_paths
from recon.check.codes import names_text
from recon.cli.answers import Answer, say, table_of
from recon.cli.commands import OptionsOf
from recon.geometry.camera import Camera


def calibrate(settings: CalibrationSettings, progress: Progress) -> Answer:
    """Calibrate a camera from pictures or a video of a board, and write a camera file and a picture of the coverage.

    Example: recon calibrate board/ --board chessboard:9x6:25mm --model radtan --out camera.toml

    Exit code 0: written. 1: not written, because a check failed. 2: the input cannot be used.
    """
    from recon.api.calibrate import run_calibration

    report = run_calibration(settings, progress)
    errors = []
    if report["written"] is None:
        errors = [f"refused: {check['text']}" for check in report["checks"] if check["verdict"] == "refused"]
        advice = f"correct this, or use --force. Picture: {report['picture']}"
        errors.append(f"{settings.out} was not written: {advice}")
    data = json.dumps(report, indent=1) + "\n"  # print the camera with full precision
    return Answer(data, _calibration_lines(report), errors)


def _calibration_lines(report: dict[str, Any]) -> Iterator[str | Text | Table]:
    pictures, written = report["pictures"], report["written"]
    rows = (
        (
            *(view["name"], str(view["corners"]), f"{view['rms_px']:.2f}", f"{view['max_px']:.2f}"),
            *(quantity(math.degrees(view["tilt_rad"]), 0, "°"), f"{view['distance_m']:.2f}"),
            "" if view["used"] else Text("left out", style="red"),
        )
        for view in pictures
    )
    yield table_of("picture", numbers=("corners", "error px", "worst px", "tilt", "distance m", ""), rows=rows)
    examined = f"{report['board']}: found in {report['found']} of {report['examined']} pictures"
    if report["found"] > len(pictures):
        examined += f", of which the {len(pictures)} sharpest and most varied were used"
    yield examined
    if report["without_board"]:
        yield f"Not found in: {names_text(report['without_board'])}"
    yield ""
    for row in report["parameters"]:
        digits, unit = (1, " px") if row["name"] in ("fx", "fy", "cx", "cy") else (4, "")
        sigma = math.inf if row["sigma"] is None else row["sigma"]
        yield f"{row['name']}  {row['value']:.{digits}f} ± {sigma:.{digits}f}{unit}"
    yield f"reprojection error {quantity(report['rms_px'], 3, 'px')} (root mean square)"
    for check in report["checks"]:
        if check["verdict"] == "warning" or (check["verdict"] == "refused" and written is not None):
            yield Text.assemble(("warning: ", "yellow"), check["text"])
    if written is not None:
        yield f"Written: {written}, and a picture of the board's coverage: {report['picture']}"


_SETTINGS = (
    *("camera", "camera_name", "camera_unit", "image_size_px", "tilt_deg", "refine_cameras", "offset_s"),
    *("find_offsets", "fps"),
    *("skeleton", "subject", "detector", "prior", "individual", "rename", "frames", "likelihood_min", "sigma_px"),
    "keypoint_sigma_m",
)
"""Settings of a fit that `recon calibrate extrinsics` reads."""
_OfClips = Annotated[dict[str, Any], OptionsOf(FitSettings, _SETTINGS)]


class _ExtrinsicsSettings(Settings):
    """Settings of `recon calibrate extrinsics` in addition to the settings of the clips."""

    inputs: Annotated[OneOrMore[str], Option(argument="INPUT")]
    """Keypoint files, quoted patterns, folders, or manifests, as for recon batch."""
    out: Path
    """Camera file to write, such as cameras.toml."""
    cameras_by: Annotated[str, Option(metavar="auto|PATTERN")] = "auto"
    """How to join the files of one clip, as for recon batch."""
    level_deg: Annotated[Number, Field(ge=0.01, le=90)] | None = None
    """Expected deviation of each camera from level, or from --tilt-deg, in degrees. Give 1 for cameras that were set
    up with a bubble level. (default: 5)
    """
    overwrite: bool = False
    """Replace the file."""


def extrinsics(settings: _ExtrinsicsSettings, options: _OfClips, progress: Progress, console: Console) -> Answer:
    """Find the poses of cameras from their lenses and clips of the animal.

    More clips give better poses.

    With --set refine-cameras=true, the poses in the camera file are refined, assuming errors of 2 degrees and 5 cm.

    Example: recon calibrate extrinsics run*_cam*.csv --camera lenses.toml --fps 90 --out cameras.toml

    Exit code 0: written. 2: the input cannot be used.
    """
    from recon.api.extrinsics import clips_of, run_extrinsics

    clips, notes = clips_of(settings.inputs, options, settings.cameras_by)
    for note in notes:
        say(console, note, "yellow")
    level_rad = math.radians(settings.level_deg or 0.0)
    cameras, report = run_extrinsics(clips, settings.out, settings.overwrite, level_rad, progress)
    written = f"Written: {settings.out}. Fit clips with: recon fit ... --camera {shlex.quote(str(settings.out))}"
    return Answer(report, [*lines_of(cameras, report), written])


def lines_of(cameras: Sequence[Camera], report: Mapping[str, Any]) -> Iterator[str]:
    """Yield lines on the positions of the cameras, and on how well the clips determine them."""
    from recon.api.extrinsics import MAX_CHI_SQUARED

    first = cameras[0].centre_world
    for camera, camera_report in zip(cameras, report["cameras"], strict=True):
        turn, shift = (float(np.linalg.norm(camera_report[name])) for name in ("turn_sigma_rad", "shift_sigma_m"))
        uncertainty = (
            f", known to {quantity(math.degrees(turn), 1, '°')} and {length_text(shift)}" if turn or shift else ""
        )
        height = length_text(camera.centre_world[2], camera_report["height_sigma_m"])
        distance = length_text(math.dist(camera.centre_world, first))
        yield f"{camera.name}: {height} high, {distance} from the first camera{uncertainty}"
    for clip in report["clips"]:
        if clip["found_offsets"]:
            names, offsets = [Path(path).name for path in clip["keypoints"]], clip["offset_s"]
            offset_texts = ", ".join(f"{name} {s:+.4f} s" for name, s in zip(names[1:], offsets[1:], strict=True))
            yield f"Time offsets from {names[0]}: {offset_texts}"
    disagreements = [clip["disagreement"] for clip in report["clips"]]
    largest = {camera.name: max(by_camera[camera.name] for by_camera in disagreements) for camera in cameras}
    if len(disagreements) > 1 and max(largest.values()) > MAX_CHI_SQUARED:
        name = max(largest, key=largest.__getitem__)
        yield (
            f"The clips disagree on the cameras' positions, most of all on {name}: was a camera moved between the "
            "clips?"
        )
    if not report["converged"]:
        yield "The search stopped before it had converged: add clips in which the animal crosses the view elsewhere."


def camera_motion(settings: CameraMotionSettings, progress: Progress = silent) -> Answer:
    """Find how a camera turned (and zoomed) from the background of its video, and write a camera track.

    Example: recon camera-motion clip.mp4 --camera camera.toml --keypoints clip.csv --out track.csv
    """
    output = output_file(settings.out, "camera-motion", settings.overwrite, input_paths(settings))
    return camera_motion_answer(settings, output, progress)


def camera_motion_answer(settings: CameraMotionSettings, output: Output, progress: Progress = silent) -> Answer:
    """Find how a camera turned, write its files to an output, and return the answer."""
    from recon.api.camera_motion import NOTES, motion_files, run_camera_motion

    report = run_camera_motion(settings, output, progress)
    paths = [settings.out.with_name(name) for name in motion_files(settings.out)]
    lost_count, keyframes = len(report["frames_without_background"]), counted(len(report["keyframes"]), "keyframe")
    lines = [f"{report['frames'] - lost_count} of {report['frames']} frames have a pose, {keyframes}."]
    lines += [f"No pose, because of too little background: {counted(lost_count, 'frame')}."] if lost_count else []
    residual, sigma = quantity(report["residual_px"], 2, "px"), quantity(report["sigma_deg"], 3, "°")
    lines.append(f"Residual of the background: {residual}. Uncertainty of the camera's direction: ±{sigma}.")
    notes = report["notes"][len(NOTES) :]
    lines += [f"Note: {note}." for note in notes]
    lines.append(f"Level: {report['level']}. A rolling shutter is not modelled.")
    return Answer(report, [*lines, "Written: " + ", ".join(map(str, paths))], files=paths, notes=notes)


def camera_advice(settings: CameraAdviceSettings, progress: Progress) -> Answer:
    """Advise where to place one or two cameras to measure an angle or a joint.

    Example: recon camera-advice --skeleton cheetah-24 --angle front_trunk_yaw --out advice
    """
    from recon.api.camera_advice import run_camera_advice

    report = run_camera_advice(settings, progress)
    return Answer(report, [*report["words"], f"The figure and the table are in {settings.out}."])
