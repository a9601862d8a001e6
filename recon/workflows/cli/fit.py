"""`recon fit`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from recon.base.errors import InputError, Problem
from recon.workflows.cli.common import finish, leave_pandas_out, progress_bar, say, terminal
from recon.workflows.cli.settings import OPTIONS, takes_settings


@takes_settings(OPTIONS)
def fit(
    *,
    out: Annotated[Path | None, typer.Option(help="Folder for the results, as in results/clip1.")] = None,
    given: dict[str, Any],
    config: Annotated[
        Path | None, typer.Option(help="config.toml of an earlier run; options given here overrule it.")
    ] = None,
    camera_motion: Annotated[
        Path | None,
        typer.Option(help="A camera that turns: its video, in which the track is found first, as in clip.mp4."),
    ] = None,
    overwrite: Annotated[bool, typer.Option("--overwrite", help="Replace results in the folder.")] = False,
    as_json: Annotated[bool, typer.Option("--json", help="Print the report's summary as JSON.")] = False,
    quiet: Annotated[bool, typer.Option("--quiet", "-q", help="Print errors only.")] = False,
) -> None:
    """Reconstruct one clip: keypoints and a camera in, 3D poses, angles, report and playback out.

    Example: recon fit clip.csv --camera scene.json --camera-name cam2 --fps 90 --out results/clip

    Exit code 0: done. 1: no frame could be solved. 2: the input cannot be used.
    """
    from recon.workflows.clip import keypoint_problems, run_clip
    from recon.workflows.made_from import read_config, replaced_files
    from recon.workflows.settings import read_settings

    no_out = [Problem("--out", "folder", "nothing", "a folder for the results, as in results/clip1")]
    try:
        settings = read_settings(None, given) if config is None else read_config(config, given)
    except InputError as error:
        files = keypoint_problems(given["keypoints"] or (), given["individual"])
        raise InputError((*files, *error.problems, *([] if out else no_out))) from None
    if out is None:
        raise InputError(no_out)
    console = terminal(quiet=quiet, stderr=as_json)
    for path in [] if config is None else replaced_files(config, given, settings):
        say(console, f"note: {path} is not the file that {config} was written for: its content is another")
    leave_pandas_out()
    with progress_bar(console, "fitting: ") as progress:
        report = run_clip(settings, out, overwrite, progress, camera_motion)
    finish(console, report, out, as_json)
