"""`recon camera-advice`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from recon.workflows.cli.common import number_option, progress_bar, say, terminal


def camera_advice(
    skeleton: Annotated[str, typer.Option(help="A built-in skeleton or a TOML file, as in cheetah-24.")],
    out: Annotated[Path, typer.Option(help="Folder for the figure, the table and the report.")],
    prior: Annotated[
        str | None,
        typer.Option(
            help="What motions are like: a built-in name, a file of recon prior fit, or none. (default: as for a fit)",
            show_default=False,
        ),
    ] = None,
    angle: Annotated[str | None, typer.Option(help="The angle to be seen, as in front_trunk_yaw.")] = None,
    joint: Annotated[str | None, typer.Option(help="The joint to be seen. (default: all)", show_default=False)] = None,
    cameras: Annotated[int, typer.Option(help="1, or 2: the best second one beside the best first one.")] = 1,
    hfov_deg: Annotated[float, number_option("Horizontal field of view, degrees.", "degrees, as in 60")] = 60.0,
    distance_m: Annotated[
        float | None,
        number_option("From the animal's middle, metres. (default: 4 of its lengths)", "metres, as in 8"),
    ] = None,
    subject: Annotated[str | None, typer.Option(help="A measured animal: built-in name or TOML file.")] = None,
    overwrite: Annotated[bool, typer.Option("--overwrite", help="Replace earlier advice.")] = False,
    as_json: Annotated[bool, typer.Option("--json", help="Print the report as JSON.")] = False,
) -> None:
    """Where to put a camera, or two, so that an angle or a joint is seen and not guessed.

    Example: recon camera-advice --skeleton cheetah-24 --angle front_trunk_yaw --out advice
    """
    from recon.show.report import to_json
    from recon.workflows.camera_advice import run_camera_advice

    with progress_bar(terminal(stderr=True)) as progress:
        advice = run_camera_advice(
            skeleton, out, prior, angle, joint, cameras, hfov_deg, distance_m, subject, overwrite, progress
        )
    if as_json:
        typer.echo(to_json(advice.report), nl=False)
        return
    for line in advice.lines:
        say(terminal(), line)
    say(terminal(), f"The figure and the table are in {out}.")
