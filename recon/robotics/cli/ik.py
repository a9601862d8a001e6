"""The command `recon ik`: its options, and what it prints."""

from __future__ import annotations

from math import degrees
from pathlib import Path
from typing import Any

import typer
from rich.console import Console

from recon.robotics.settings import IkSettings
from recon.workflows.cli.common import say, say_verdict, table_of, terminal

WIDE_GAP_PERCENT = 25
CLOSES_PERCENT = 90
"""Above what the joints' paths of a stride close to of methods that no limit stops."""


def ik(settings: IkSettings, as_json: bool) -> None:
    """Inverse kinematics of the chain from the trunk to a foot: to a target, or along a stride.

    Example: recon ik results/clip --compare
    """
    from recon.robotics.ik.clip import run_ik
    from recon.show.report import to_json

    done = run_ik(settings)
    summary = done.summary
    if as_json:
        typer.echo(to_json(summary), nl=False)
        return
    console = terminal()
    say_verdict(console, done.motion.verdict)
    _print(console, summary, settings.out_folder)


def _print(console: Console, summary: dict[str, Any], out: Path) -> None:
    stride = summary["stride"]
    how = {
        "given": "as given",
        "gait": "from touchdown to touchdown",
        "return": "the clip has no complete one: the nearest return of the foot to the same place",
        "whole clip": "the clip has no complete one: the whole clip",
    }[stride["how"]]
    joints = summary["joints"]
    say(console, f"{summary['foot']}: {len(joints)} joints, {summary['dimensions']}D ({summary['base_frame']})")
    if summary["misfit_m"]:
        say(console, f"the chain's end lies {1000 * summary['misfit_m']:.0f} mm from the foot's projection (median)")
    say(
        console,
        f"stride: {stride['start_s']:.3f} to {stride['end_s']:.3f} s, {how}; gap {1000 * stride['gap_m']:.0f} mm "
        f"({stride['gap_percent']:.1f} % of its extent), closed",
    )
    for note in stride["notes"]:
        say(console, f"note: {note}")
    if stride["gap_percent"] > WIDE_GAP_PERCENT:
        say(
            console,
            "note: so wide a gap is not of one stride: a touchdown was missed, or the clip is too short",
        )
    if summary["to_target"]:
        place = ", ".join(f"{x:.3f}" for x in summary["target_m"])
        columns = ("reached", "steps", "µs each", "path m", "limits")
        table = table_of("method", numbers=columns, title=f"to ({place}) m")
        for name, row in summary["to_target"].items():
            table.add_row(name, "yes" if row["reached"] else "no", str(row["iterations"]), *_shared(row))
        console.print(table)
        for name, row in summary["to_target"].items():
            if not row["reached"]:
                say(console, f"{name}: {row['reason']}")
    if summary["along_stride"]:
        columns = ("worst mm", "µs each", "off °", "limits", "closure %")
        title = f"along the stride, turns: {summary['turns']}"
        table = table_of("method", numbers=columns, title=title)
        for name, row in summary["along_stride"].items():
            closed = f"{row['least_closure_angle_percent']:.1f}/{row['least_closure_plane_percent']:.1f}"
            us, _, limits = _shared(row)
            off = f"{degrees(row['joints_off_rad']):.0f}"
            table.add_row(name, f"{1000 * row['worst_error_m']:.1f}", us, off, limits, closed)
        console.print(table)
        for name, row in summary["along_stride"].items():
            if row["note"]:
                say(console, f"{name}: {row['note']}")
        for name, row in summary["along_stride"].items():
            if row["limits_hit"] and row["least_closure_angle_percent"] < CLOSES_PERCENT:
                also = "" if len(row["limits_hit"]) == 1 else f"; then {', '.join(row['limits_hit'][1:])}"
                say(console, f"{name} does not close, stopped by {row['first_limit']}{also}")
        if any(row["limits_hit"] for row in summary["along_stride"].values()):
            say(console, "What a method does without the limits of the joints: --no-limits.")
        say(
            console,
            "closure: the least of any joint, of its angle/of angle and rate; off: the joints from the animal's",
        )
    if summary["to_target"] or summary["along_stride"]:
        say(console, "limits: the first joint that one stopped, and how many more")
    parameters = summary["parameters"]
    explained = ", ".join(f"{name} {fit['explained']:.0%}" for name, fit in parameters["fitted"].items())
    say(console, f"parameters: {parameters['used']}. Fitted to the clip, they explain of its joint rates: {explained}")
    say(console, f"Tables and figures are in {out}.")


def _shared(row: dict[str, Any]) -> tuple[str, ...]:
    us, hit = row["us_per_step"], row["limits_hit"]
    return (
        "-" if us is None else f"{us:.0f}",
        f"{row['length_m']:.2f}",
        hit[0] + (f" +{len(hit) - 1}" if len(hit) > 1 else "") if hit else "-",
    )
