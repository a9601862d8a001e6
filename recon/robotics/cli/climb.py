"""`recon climb`."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any

import typer

from recon.workflows.cli.common import EXIT_UNSOLVED, number_option, say, table_of, terminal


def climb(
    out: Annotated[Path, typer.Option(help="Folder for tables, figures and playback.", show_default=False)],
    recipe: Annotated[
        str,
        typer.Argument(
            help="found-50, published-50, published-35, spatial-50, highest, highest-spatial, or a file .toml."
        ),
    ] = "found-50",
    height: Annotated[
        float | None, number_option("Of the step, metres. (default: the recipe's)", "metres, as in 0.045")
    ] = None,
    robot: Annotated[
        str | None,
        typer.Option(
            help="aibo, or a file .toml of a robot with its kind of legs; lengths are in proportion to its legs. "
            "(default: the recipe's)"
        ),
    ] = None,
    method: Annotated[
        str, typer.Option(help="How the torso finds its equilibrium: solve, or ride, as published.")
    ] = "solve",
    at: Annotated[
        float | None,
        number_option("When its field is drawn, seconds. (default: where a margin is least)", "seconds, as in 3.5"),
    ] = None,
    after: Annotated[
        Path | None,
        typer.Option(metavar="DIR", help="Folder of results, whose animal's motion the robot follows up to the step."),
    ] = None,
    figures: Annotated[bool, typer.Option("--figures/--no-figures", help="PNG and SVG beside the tables.")] = True,
    overwrite: Annotated[bool, typer.Option("--overwrite", help="Replace earlier ones.")] = False,
    as_json: Annotated[bool, typer.Option("--json", help="Print the report as JSON.")] = False,
) -> None:
    """A four-legged robot climbs a step by potential fields.

    Example: recon climb published-50 --height 0.045 --out results/climb

    Exit code 0: valid in every frame. 1: it is not, and all is written. 2: the input cannot be used.
    """
    from math import degrees, isfinite

    from recon.robotics.climb.run import run_climb
    from recon.show.report import to_json

    report = run_climb(recipe, out, robot, height, method, at, after, figures, overwrite).report
    if as_json:
        typer.echo(to_json(report), nl=False)
        _end(report)
        return
    console = terminal()
    pitch, share = degrees(report["largest_pitch_rad"]), report["rate_share"]
    rate = f"at {100 * share:.0f} % of the fastest rate at most" if isfinite(share) else "out of their reach"
    say(
        console,
        f"{report['robot']} climbs {1000 * report['step_m']:.0f} mm in {report['duration_s']:.1f} s, "
        f"{report['frames']} frames; pitch up to {pitch:.0f}°; joints {rate}",
    )
    if "after" in report:
        before = report["after"]
        say(
            console,
            f"before it, for {before['climb_starts_s']:.1f} s, the animal's motion, {before['scale']:.3f} of its size "
            f"and {before['slower']:.2f} times slower, and steps into the climb's stance",
        )
        if before["out_of_reach_share"]:
            say(console, f"note: a foot out of reach in {100 * before['out_of_reach_share']:.0f} % of that, drawn in")
    table = table_of("least margin", numbers=("", "", "at s"))
    for row in report["least_margins"].values():
        table.add_row(row["what"], f"{row['value']:.1f}", row["unit"], f"{row['at_s']:.2f}")
    console.print(table)
    say(console, "valid in every frame" if report["valid"] else f"not valid: {'; '.join(report['problems'])}")
    if report["settled_share"] < 1:
        say(console, f"note: in equilibrium in {100 * report['settled_share']:.0f} % of the frames only")
    drawn = f"; the field is drawn at {report['field_drawn_at_s']:.2f} s" if figures else ""
    say(console, f"The playback is {out / 'climb.rrd'}{drawn}.")
    _end(report)


def _end(report: Mapping[str, Any]) -> None:
    """So that a script can tell."""
    if not report["valid"]:
        raise typer.Exit(EXIT_UNSOLVED)
