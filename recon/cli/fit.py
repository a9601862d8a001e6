"""`recon fit`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console

from recon.cli.common import finish, progress_bar
from recon.errors import InputError, Problem

_TRAJECTORY, _FRAME = "Trajectory method", "Frame method"


def fit(
    keypoints: Annotated[
        Path | None,
        typer.Argument(
            metavar="KEYPOINTS",
            help="Keypoint file, as in clip.csv: DeepLabCut, SLEAP, movement, NWB, COCO or a plain table.",
            show_default=False,
        ),
    ] = None,
    camera: Annotated[
        Path | None,
        typer.Option(help="Calibration: OpenCV yaml/json/xml, AcinoSet scene.json, Anipose or recon toml."),
    ] = None,
    camera_name: Annotated[
        str | None, typer.Option(help="Which camera of the file, by name or number, as in cam2 or 2.")
    ] = None,
    fps: Annotated[
        float | None,
        typer.Option(help="Frame rate of the video in Hz, as in 120. (default: what the file says, if it does)"),
    ] = None,
    out: Annotated[Path | None, typer.Option(help="Folder for the results, as in results/clip1.")] = None,
    method: Annotated[
        str | None,
        typer.Option(
            help="trajectory: the whole animal over the whole clip; frame: one side, one frame after the other. "
            "(default: trajectory)"
        ),
    ] = None,
    skeleton: Annotated[
        str | None,
        typer.Option(
            help="Name of a built-in skeleton or a TOML file. (default: cheetah-24; cheetah-8u for the frame method)"
        ),
    ] = None,
    frames: Annotated[
        str | None, typer.Option(help="Only these frame numbers, from A up to but without B, as in 100:160.")
    ] = None,
    individual: Annotated[str | None, typer.Option(help="Which animal of a multi-animal file, as in animal1.")] = None,
    likelihood_min: Annotated[
        float | None, typer.Option(help="Leave out points less likely than this, 0 to 1. (default: 0.5)")
    ] = None,
    side: Annotated[
        str | None,
        typer.Option(help="With a skeleton of one side, which to fit: auto, left or right. (default: auto)"),
    ] = None,
    hfov_deg: Annotated[
        float | None,
        typer.Option(help="Without a calibration: horizontal field of view in degrees, as in 64."),
    ] = None,
    image_size: Annotated[
        str | None, typer.Option(help="Size of the video in pixels, if the camera file lacks it, as in 1920x1080.")
    ] = None,
    tilt_deg: Annotated[
        float | None,
        typer.Option(help="Without extrinsics: how far the camera looks down, in degrees, as in 5. (default: level)"),
    ] = None,
    sigma_px: Annotated[
        float | None, typer.Option(help="Noise of the detector in pixels, one standard deviation. (default: 3)")
    ] = None,
    keypoint_sigma_m: Annotated[
        float | None,
        typer.Option(help="How far keypoints lie from the joints, metres, as in 0.05. (default: the skeleton's)"),
    ] = None,
    subject: Annotated[
        str | None,
        typer.Option(
            help="Lengths measured on one animal: built-in name or TOML file, as in jules. (default: the skeleton's)",
            rich_help_panel=_TRAJECTORY,
        ),
    ] = None,
    prior: Annotated[
        str | None,
        typer.Option(
            help="What motions are like: a built-in name, a file of `recon prior fit`, or none. "
            "(default: the built-in one for this skeleton, if any)",
            rich_help_panel=_TRAJECTORY,
        ),
    ] = None,
    ground: Annotated[
        str | None,
        typer.Option(
            help="auto: feet that stand are still and on one plane; none: nothing is said about them. (default: auto)",
            rich_help_panel=_TRAJECTORY,
        ),
    ] = None,
    size_sigma: Annotated[
        float | None,
        typer.Option(
            help="Standard deviation of the animal's size, relative, as in 0.1. (default: the skeleton's)",
            rich_help_panel=_TRAJECTORY,
        ),
    ] = None,
    fast: Annotated[
        bool | None,
        typer.Option("--fast/--no-fast", help="Quicker: fewer directions to start from.", rich_help_panel=_TRAJECTORY),
    ] = None,
    form: Annotated[
        str | None,
        typer.Option(
            help="Ranges and rates: deadband (beyond the limit) or printed (two-sided). (default: deadband)",
            rich_help_panel=_FRAME,
        ),
    ] = None,
    angle_prior: Annotated[
        str | None,
        typer.Option(
            help="Gaussian priors on angles and heading: gaussian or none. (default: gaussian)",
            rich_help_panel=_FRAME,
        ),
    ] = None,
    camera_rotation: Annotated[
        str | None,
        typer.Option(
            help="The body's rotation: free, or fixed to the first frame's. (default: free)", rich_help_panel=_FRAME
        ),
    ] = None,
    base_length_m: Annotated[
        float | None,
        typer.Option(
            help="Base length of the chain in metres, as in 0.203. (default: the skeleton's)", rich_help_panel=_FRAME
        ),
    ] = None,
    base_sigma_m: Annotated[
        float | None,
        typer.Option(
            help="Standard deviation of the base length in metres, as in 0.001. (default: the skeleton's)",
            rich_help_panel=_FRAME,
        ),
    ] = None,
    config: Annotated[
        Path | None, typer.Option(help="config.toml of an earlier run; options given here overrule it.")
    ] = None,
    overwrite: Annotated[bool, typer.Option("--overwrite", help="Replace results in the folder.")] = False,
    as_json: Annotated[bool, typer.Option("--json", help="Print the report's summary as JSON.")] = False,
    quiet: Annotated[bool, typer.Option("--quiet", "-q", help="Print errors only.")] = False,
) -> None:
    """Reconstruct one clip: keypoints and a camera in, 3D poses, angles, report and playback out.

    Example: recon fit clip.csv --camera scene.json --camera-name cam2 --fps 90 --out results/clip

    Exit code 0: done. 1: no frame could be solved. 2: the input cannot be used.
    """
    from recon.pipelines.clip import run_clip
    from recon.settings import read_settings

    given = {
        "keypoints": keypoints,
        "camera": camera,
        "camera_name": camera_name,
        "fps": fps,
        "method": method,
        "skeleton": skeleton,
        "subject": subject,
        "prior": prior,
        "frames": frames,
        "individual": individual,
        "likelihood_min": likelihood_min,
        "side": side,
        "hfov_deg": hfov_deg,
        "image_size_px": image_size,
        "tilt_deg": tilt_deg,
        "ground": ground,
        "size_sigma": size_sigma,
        "fast": fast,
        "form": form,
        "angle_prior": angle_prior,
        "camera_rotation": camera_rotation,
        "base_length_m": base_length_m,
        "base_sigma_m": base_sigma_m,
        "sigma_px": sigma_px,
        "keypoint_sigma_m": keypoint_sigma_m,
    }
    no_out = Problem("--out", "folder", "nothing", "a folder for the results, as in results/clip1")
    try:
        settings = read_settings(config, given)
    except InputError as error:
        raise InputError(error.problems if out else (*error.problems, no_out)) from None
    if out is None:
        raise InputError(no_out)
    console = Console(quiet=quiet, stderr=as_json)
    with progress_bar(console) as progress:
        report = run_clip(settings, out, overwrite, progress)
    finish(console, report, out, as_json)
