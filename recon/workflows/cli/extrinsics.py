"""`recon calibrate extrinsics`."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Annotated, Any

from pydantic import Field

from recon.base.settings import Number, OneOrMore, Option, Settings
from recon.workflows.cli.command import OptionsOf
from recon.workflows.cli.common import progress_bar, say, terminal
from recon.workflows.settings import FitSettings

_SETTINGS = (
    *("camera", "camera_name", "camera_unit", "image_size_px", "tilt_deg", "refine_cameras", "offset_s"),
    *("find_offsets", "fps"),
    *("skeleton", "subject", "detector", "prior", "individual", "rename", "frames", "likelihood_min", "sigma_px"),
    "keypoint_sigma_m",
)
"""Those of a fit that are read."""


class _ExtrinsicsSettings(Settings):
    """What `recon calibrate extrinsics` is told besides the settings of the clips."""

    inputs: Annotated[
        OneOrMore[str],
        Option(
            "Keypoint files, quoted patterns, folders, or manifests, as for recon batch. Files whose names are the "
            "same but for the camera's are one clip.",
            argument="INPUT",
        ),
    ]
    out: Annotated[Path, Option("The file of all cameras, as in cameras.toml.")]
    cameras_by: Annotated[str, Option("Which files are one clip, as for recon batch.", metavar="auto|PATTERN")] = "auto"
    level_deg: Annotated[
        Annotated[Number, Field(ge=0.01, le=90)] | None,
        Option(
            "How far each camera is from level, or from its tilt, about each axis; 1 with a bubble. (default: 5)",
            "degrees from 0.01 to 90",
        ),
    ] = None
    overwrite: Annotated[bool, Option("Replace the file.")] = False


def extrinsics(
    settings: _ExtrinsicsSettings, given: Annotated[dict[str, Any], OptionsOf(FitSettings, _SETTINGS)], as_json: bool
) -> Any:
    """Find where cameras stand, from their lenses and clips of the animal: one tells it roughly, several well.

    With --set refine-cameras=true, the poses in the camera file are taken for as good as 2 degrees and 5 cm, and are
    refined.

    Example: recon calibrate extrinsics run*_cam*.csv --camera lenses.toml --fps 90 --out cameras.toml

    Exit code 0: written. 2: the input cannot be used.
    """
    from recon.workflows.extrinsics import clips_of, run_extrinsics

    clips, notes = clips_of(settings.inputs, given, settings.cameras_by)
    for note in notes:
        say(terminal(stderr=True), note, "yellow")
    with progress_bar(terminal(stderr=True), "solving: ") as progress:
        level_rad = None if settings.level_deg is None else math.radians(settings.level_deg)
        run = run_extrinsics(clips, settings.out, settings.overwrite, level_rad, progress)
    if as_json:
        return run.to_dict()
    console = terminal()
    for line in run.lines():
        say(console, line)
    say(console, f"Written: {settings.out}. Fit clips with: recon fit ... --camera {settings.out}")
