"""`recon calibrate extrinsics`."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Annotated, Any

import typer

from recon.workflows.cli.common import progress_bar, say, terminal
from recon.workflows.cli.settings import takes_settings

_SETTINGS = (
    *("camera", "camera_name", "camera_unit", "image_size_px", "tilt_deg", "refine_cameras", "offset_s"),
    *("find_offsets", "fps"),
    *("skeleton", "subject", "detector", "prior", "individual", "rename", "frames", "likelihood_min", "sigma_px"),
    "keypoint_sigma_m",
)
"""Those of a fit that are read."""


@takes_settings(_SETTINGS)
def extrinsics(
    *,
    inputs: Annotated[
        list[str],
        typer.Argument(
            metavar="INPUT...",
            help="Keypoint files, quoted patterns, folders, or manifests, as for recon batch. Files whose names are "
            "the same but for the camera's are one clip.",
        ),
    ],
    out: Annotated[Path, typer.Option(help="The file of all cameras, as in cameras.toml.")],
    given: dict[str, Any],
    cameras_by: Annotated[
        str,
        typer.Option(metavar="auto|PATTERN", help="Which files are one clip, as for recon batch."),
    ] = "auto",
    level_deg: Annotated[
        float | None,
        typer.Option(
            min=0.01,
            max=90,
            help="How far each camera is from level, or from its tilt, about each axis; 1 with a bubble. (default: 5)",
        ),
    ] = None,
    overwrite: Annotated[bool, typer.Option("--overwrite", help="Replace the file.")] = False,
    as_json: Annotated[bool, typer.Option("--json", help="Print everything as JSON.")] = False,
) -> None:
    """Find where cameras stand, from their lenses and clips of the animal: one tells it roughly, several well.

    With --refine-cameras, the poses in the camera file are taken for as good as 2 degrees and 5 cm, and refined.

    Example: recon calibrate extrinsics run*_cam*.csv --camera lenses.toml --fps 90 --out cameras.toml

    Exit code 0: written. 2: the input cannot be used.
    """
    from recon.workflows.extrinsics import clips_of, run_extrinsics

    clips, notes = clips_of(inputs, given, cameras_by)
    for note in notes:
        say(terminal(stderr=True), note, "yellow")
    with progress_bar(terminal(stderr=True), "solving: ") as progress:
        level_rad = None if level_deg is None else math.radians(level_deg)
        run = run_extrinsics(clips, out, overwrite, level_rad, progress)
    if as_json:
        typer.echo(json.dumps(run.to_dict(), indent=1))
        return
    console = terminal()
    for line in run.lines():
        say(console, line)
    say(console, f"Written: {out}. Fit clips with: recon fit ... --camera {out}")
