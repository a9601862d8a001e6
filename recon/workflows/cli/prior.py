"""`recon prior`."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated

import typer
from rich.text import Text

from recon.workflows.cli.common import number_option, table_of, terminal


def prior_fit(
    poses: Annotated[
        list[Path],
        typer.Argument(metavar="POSES", help="Results of recon fit, or 3D poses as in pose3d.csv: metres, world z up."),
    ],
    out: Annotated[Path, typer.Option(help="File for the prior, as in my-dog.npz.")],
    skeleton: Annotated[
        str | None, typer.Option(help="Of 3D poses: a whole animal by name or TOML file, as in cheetah-24.")
    ] = None,
    fps: Annotated[
        str | None,
        typer.Option(help='Of 3D poses: frame rate in Hz, or a JSON file with {"fps": [...]}, one per piece.'),
    ] = None,
    subject: Annotated[str | None, typer.Option(help="Measured animal, by name or TOML file, as in phantom.")] = None,
    estimate_size: Annotated[
        bool, typer.Option("--estimate-size", help="Scale the skeleton to the animal of each file.")
    ] = False,
    components: Annotated[
        int, typer.Option(help="Gaussians in the mixture of poses; fewer if there are not 20 frames for each.")
    ] = 16,
    min_speed_m_s: Annotated[
        float, number_option("Leave out slower segments, as in 8.5.", "metres per second, as in 8.5")
    ] = 0.0,
    apart: Annotated[
        list[str] | None, typer.Option(help="Segment whose movement says nothing of the others', as in tail_1.")
    ] = None,
    name: Annotated[str | None, typer.Option(help="Name of the prior. (default: the file's)")] = None,
    source: Annotated[str, typer.Option(help="Where the poses come from, for the record.")] = "",
    check: Annotated[bool, typer.Option("--check", help="Score each segment under a prior from the others.")] = False,
    overwrite: Annotated[bool, typer.Option("--overwrite", help="Replace the file.")] = False,
    as_json: Annotated[
        bool, typer.Option("--json", help="Print the table and what else there is to say as JSON.")
    ] = False,
) -> None:
    """Fit a motion prior to results or 3D poses, and list what it was fitted to.

    Example: recon prior fit results/run1 results/run2 --out my-cat.npz
    """
    from recon.workflows.prior import run_prior_fit

    done = run_prior_fit(
        poses=poses,
        skeleton=skeleton,
        fps=fps,
        out=out,
        subject=subject,
        name=name,
        source=source,
        components=components,
        min_speed_m_s=min_speed_m_s,
        estimate_size=estimate_size,
        apart=apart or (),
        check=check,
        overwrite=overwrite,
    )
    if as_json:
        typer.echo(json.dumps({"out": str(out), **done.to_dict()}, indent=1))
        return
    table = table_of("segment", numbers=("frames", "fps", "speed m/s", "misfit mm", "used"))
    for row, rms_mm in zip(done.prior.segments, done.rms_mm, strict=True):
        numbers = f"{row.frames}", f"{row.fps:g}", f"{row.speed_m_s:.1f}", f"{rms_mm:.1f}".replace("nan", "-")
        table.add_row(Text(row.name), *numbers, "yes" if row.used else "no")
    terminal().print(table)
    for line in done.notes():
        typer.echo(line)
    typer.echo(f"The prior is in {out}.")
