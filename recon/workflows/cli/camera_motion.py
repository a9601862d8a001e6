"""`recon camera-motion`."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated

import typer

from recon.workflows.cli.common import FIRST_FRAME, counted, number_option, progress_bar, say, terminal


def camera_motion(
    video: Annotated[Path, typer.Argument(help="The video of a camera that turns, as in clip.mp4.")],
    camera: Annotated[Path, typer.Option(help="The camera's calibration, as in camera.toml; its pose is not read.")],
    out: Annotated[Path, typer.Option(help="The track for --camera-track, as in track.csv.")],
    camera_name: Annotated[str | None, typer.Option(help="Which camera of a file with several.")] = None,
    keypoints: Annotated[
        Path | None, typer.Option(help="Keypoints of the animal, which is then no background, as in clip.csv.")
    ] = None,
    individual: Annotated[str | None, typer.Option(help="Which animal of a keypoint file with several.")] = None,
    first_frame: Annotated[int, FIRST_FRAME] = 0,
    tilt_deg: Annotated[
        float | None,
        number_option(
            "How far the camera looks down in the first frame. (default: level in the mean of all frames)",
            "degrees between -60 and 60",
        ),
    ] = None,
    level_marks: Annotated[
        Path | None,
        typer.Option(help="Instead: a table (kind,frame,x1,y1,x2,y2) of horizons and verticals, as in level.csv."),
    ] = None,
    zoom: Annotated[bool, typer.Option("--zoom", help="The focal length changes; the first frame has the file's.")] = (
        False
    ),
    stabilised: Annotated[
        Path | None, typer.Option(help="A video with the background at rest, .mp4 or .avi, as in still.mp4.")
    ] = None,
    overwrite: Annotated[bool, typer.Option("--overwrite", help="Replace the track and the video.")] = False,
    as_json: Annotated[bool, typer.Option("--json", help="Print the report as JSON.")] = False,
) -> None:
    """Find how a camera turned (and zoomed) from the background of its video: a camera track.

    Example: recon camera-motion clip.mp4 --camera camera.toml --keypoints clip.csv --out track.csv
    """
    from recon.workflows.camera_motion import run_camera_motion

    with progress_bar(terminal(stderr=True)) as progress:
        run = run_camera_motion(
            video,
            camera,
            out,
            camera_name=camera_name,
            keypoints=keypoints,
            individual=individual,
            first_frame=first_frame,
            tilt_deg=tilt_deg,
            level_marks=level_marks,
            zoom=zoom,
            stabilised=stabilised,
            overwrite=overwrite,
            progress=progress,
        )
    if as_json:
        typer.echo(json.dumps(run.report, indent=1))
        return
    console, report = terminal(), run.report
    lost = len(report["frames_without_background"])
    keyframes = counted(len(report["keyframes"]), "keyframe")
    say(console, f"{report['frames'] - lost} of {report['frames']} frames placed, {keyframes}.")
    if lost:
        say(console, f"{lost} frames have too little background: no pose there.")
    say(console, f"Off by {report['residual_px']:.2f} px, turned to {report['sigma_deg']:.3f} degrees.")
    say(console, f"Level: {report['level']}. A rolling shutter is not modelled.")
    say(console, "Written: " + ", ".join(map(str, run.files)))
