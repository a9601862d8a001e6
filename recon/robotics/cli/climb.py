"""The command `recon climb`: its options, and what it prints."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import typer

from recon.robotics.settings import ClimbSettings
from recon.workflows.cli.common import EXIT_UNSOLVED, say, table_of, terminal


def climb(settings: ClimbSettings, as_json: bool) -> None:
    """A four-legged robot climbs a step by potential fields.

    Example: recon climb published-50 --height 0.045 --out results/climb

    Exit code 0: valid in every frame. 1: it is not, and all is written. 2: the input cannot be used.
    """
    from math import degrees

    from recon.robotics.climb.run import run_climb
    from recon.show.report import to_json

    report = run_climb(settings)
    if as_json:
        typer.echo(to_json(report), nl=False)
        _end(report)
        return
    console = terminal()
    pitch, rate = degrees(report["largest_pitch_rad"]), 100 * report["rate_share"]
    say(
        console,
        f"{report['robot']} climbs {1000 * report['step_m']:.0f} mm in {report['duration_s']:.1f} s, "
        f"{report['frames']} frames; pitch up to {pitch:.0f}°; joints at {rate:.0f} % of the fastest rate at most",
    )
    table = table_of("least margin", numbers=("", "", "at s"))
    for row in report["least_margins"].values():
        table.add_row(row["what"], f"{row['value']:.1f}", row["unit"], f"{row['at_s']:.2f}")
    console.print(table)
    say(console, "valid in every frame" if report["valid"] else f"not valid: {'; '.join(report['problems'])}")
    if report["settled_share"] < 1:
        say(console, f"note: in equilibrium in {100 * report['settled_share']:.0f} % of the frames only")
    say(console, f"The playback is {settings.out / 'climb.rrd'}.")
    _end(report)


def _end(report: Mapping[str, Any]) -> None:
    """So that a script can tell."""
    if not report["valid"]:
        raise typer.Exit(EXIT_UNSOLVED)
