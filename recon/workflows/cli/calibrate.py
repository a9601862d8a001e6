"""`recon calibrate`."""

from __future__ import annotations

import json
import math

import typer
from rich.console import Console
from rich.text import Text

from recon.workflows.calibrate import CalibrationRun, CalibrationSettings, run_calibration
from recon.workflows.cli.common import error_text, progress_bar, say, table_of, terminal

EXIT_REFUSED = 1


def calibrate(settings: CalibrationSettings, as_json: bool) -> None:
    """Calibrate a camera: pictures or a video of a board in, a camera file and a picture of the coverage out.

    Example: recon calibrate board/ --board chessboard:9x6:25mm --model radtan --out camera.toml

    Exit code 0: written. 1: refused, because a check failed. 2: the input cannot be used.
    """
    errors = terminal(stderr=True, soft_wrap=True)
    with progress_bar(errors) as progress:
        run = run_calibration(settings, progress)
    if as_json:
        typer.echo(json.dumps(run.to_dict(), indent=1))
    else:
        _print(run, terminal())
    if run.written is None:
        for failed in run.refused:
            errors.print(error_text(f"refused: {failed}"))
        errors.print(Text(f"{settings.out} was not written: mend that, or say --force. What there is: {run.picture}"))
        raise typer.Exit(EXIT_REFUSED)


def _print(run: CalibrationRun, console: Console) -> None:
    calibration = run.calibration
    table = table_of("picture", numbers=("corners", "error px", "worst px", "tilt", "distance m", ""))
    for view in calibration.views:
        table.add_row(
            Text(view.name),
            str(len(view.ids)),
            f"{view.rms_px:.2f}",
            f"{view.max_px:.2f}",
            f"{math.degrees(view.tilt_rad):.0f}°",
            f"{math.hypot(*view.translation_m):.2f}",
            "" if view.used else Text("left out", style="red"),
        )
    console.print(table)
    looked = f"{run.views.board}: found in {run.views.found} of {run.views.examined} pictures"
    if run.views.found > len(calibration.views):
        looked += f", the {len(calibration.views)} sharpest and most different were taken"
    say(console, looked)
    if run.views.without_board:
        names = run.views.without_board
        more = f" and {len(names) - 10} more" if len(names) > 10 else ""
        say(console, f"Not found in: {', '.join(names[:10])}{more}")
    console.print()
    for (name, value), sigma in zip(calibration.parameters.items(), calibration.sigma, strict=True):
        digits = 1 if name in ("fx", "fy", "cx", "cy") else 4
        console.print(f"{name}  {value:.{digits}f} ± {sigma:.{digits}f}", highlight=False)
    console.print(f"reprojection error {calibration.rms_px:.3f} px (root mean square)", highlight=False)
    for check in run.checks:
        if check.verdict == "warning" or (check.verdict == "refused" and run.written is not None):
            say(console, Text.assemble(("warning: ", "yellow"), str(check)))
    if run.written is not None:
        say(console, f"Written: {run.written}, and what it rests on: {run.picture}")
