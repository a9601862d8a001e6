"""`recon calibrate extrinsics`."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated, Any

import typer

from recon.cli.common import progress_bar, say, terminal
from recon.cli.settings import takes_settings

_SETTINGS = (
    *("keypoints", "camera", "camera_name", "offset_s", "fps", "skeleton", "subject", "detector", "prior"),
    *("individual", "rename", "frames", "likelihood_min", "sigma_px", "keypoint_sigma_m"),
)
"""Those of a fit that are read."""


@takes_settings(_SETTINGS)
def extrinsics(
    *,
    out: Annotated[Path, typer.Option(help="The file of all cameras, as in cameras.toml.")],
    given: dict[str, Any],
    overwrite: Annotated[bool, typer.Option("--overwrite", help="Replace the file.")] = False,
    as_json: Annotated[bool, typer.Option("--json", help="Print everything as JSON.")] = False,
) -> None:
    """Find where cameras stand, from a clip of the animal that all of them filmed, and their lenses.

    Example: recon calibrate extrinsics run_cam1.csv run_cam2.csv --camera lenses.toml --fps 90 --out cameras.toml

    Exit code 0: written. 2: the input cannot be used.
    """
    from recon.app.extrinsics import run_extrinsics
    from recon.settings import read_settings

    with progress_bar(terminal(stderr=True), "solving: ") as progress:
        run = run_extrinsics(read_settings(None, given), out, overwrite, progress)
    if as_json:
        typer.echo(json.dumps(run.to_dict(), indent=1))
        return
    console = terminal()
    for line in run.lines():
        say(console, line)
    say(console, f"Written: {out}. Fit clips with: recon fit ... --camera {out}")
