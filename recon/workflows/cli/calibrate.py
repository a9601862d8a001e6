"""`recon calibrate`."""

from __future__ import annotations

import json
import math
from typing import Any

import typer
from rich.console import Console
from rich.text import Text

from recon.workflows.calibrate import CalibrationSettings, run_calibration
from recon.workflows.cli.common import error_text, progress_bar, say, table_of, terminal

EXIT_REFUSED = 1


def calibrate(settings: CalibrationSettings, as_json: bool) -> None:
    """Calibrate a camera: pictures or a video of a board in, a camera file and a picture of the coverage out.

    Example: recon calibrate board/ --board chessboard:9x6:25mm --model radtan --out camera.toml

    Exit code 0: written. 1: refused, because a check failed. 2: the input cannot be used.
    """
    errors = terminal(stderr=True, soft_wrap=True)
    with progress_bar(errors) as progress:
        report = run_calibration(settings, progress)
    if as_json:
        typer.echo(json.dumps(report, indent=1))
    else:
        _print(report, terminal())
    if report["written"] is None:
        for failed in report["checks"]:
            if failed["verdict"] == "refused":
                errors.print(error_text(f"refused: {failed['text']}"))
        what = f"mend that, or say --force. What there is: {report['picture']}"
        errors.print(Text(f"{settings.out} was not written: {what}"))
        raise typer.Exit(EXIT_REFUSED)


def _print(report: dict[str, Any], console: Console) -> None:
    pictures, written = report["pictures"], report["written"]
    table = table_of("picture", numbers=("corners", "error px", "worst px", "tilt", "distance m", ""))
    for view in pictures:
        table.add_row(
            Text(view["name"]),
            str(view["corners"]),
            f"{view['rms_px']:.2f}",
            f"{view['max_px']:.2f}",
            f"{math.degrees(view['tilt_rad']):.0f}°",
            f"{view['distance_m']:.2f}",
            "" if view["used"] else Text("left out", style="red"),
        )
    console.print(table)
    looked = f"{report['board']}: found in {report['found']} of {report['examined']} pictures"
    if report["found"] > len(pictures):
        looked += f", the {len(pictures)} sharpest and most different were taken"
    say(console, looked)
    if names := report["without_board"]:
        more = f" and {len(names) - 10} more" if len(names) > 10 else ""
        say(console, f"Not found in: {', '.join(names[:10])}{more}")
    console.print()
    for row in report["parameters"]:
        digits = 1 if row["name"] in ("fx", "fy", "cx", "cy") else 4
        sigma = math.inf if row["sigma"] is None else row["sigma"]
        console.print(f"{row['name']}  {row['value']:.{digits}f} ± {sigma:.{digits}f}", highlight=False)
    console.print(f"reprojection error {report['rms_px']:.3f} px (root mean square)", highlight=False)
    for check in report["checks"]:
        if check["verdict"] == "warning" or (check["verdict"] == "refused" and written is not None):
            say(console, Text.assemble(("warning: ", "yellow"), check["text"]))
    if written is not None:
        say(console, f"Written: {written}, and what it rests on: {report['picture']}")
