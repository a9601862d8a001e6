"""`recon retarget`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer
from rich.console import Console

from recon.workflows.cli.common import STRIDE, number_option, say, stride_times, terminal


def retarget(
    folder: Annotated[Path, typer.Argument(metavar="DIR", help="Folder of results, as in results/clip.")],
    robot: Annotated[str, typer.Option(help="a1, aibo, or a file .urdf or .toml.", show_default=False)],
    out: Annotated[Path, typer.Option(help="Folder for tables, report and playback.", show_default=False)],
    scale: Annotated[
        float | None,
        number_option(
            "Factor on the animal's lengths. (default: the largest within reach and limits)", "a number above 0"
        ),
    ] = None,
    slower: Annotated[
        float | None,
        number_option(
            "Factor on the animal's times. (default: what the joints' rates ask for, at least 1)", "a number above 0"
        ),
    ] = None,
    lag: Annotated[
        float,
        number_option(
            "Of a chain, of which one side is measured: by how much of a stride the other side follows it; 0 is a "
            "bound, some 0.1 a gallop, 0.5 a trot.",
            "a share of a stride, as in 0.5",
        ),
    ] = 0.0,
    stride: Annotated[str | None, STRIDE] = None,
    overwrite: Annotated[bool, typer.Option("--overwrite", help="Replace earlier ones.")] = False,
    as_json: Annotated[bool, typer.Option("--json", help="Print the report as JSON.")] = False,
) -> None:
    """The motion of a reconstruction on a four-legged robot, and one stride of it that repeats.

    Example: recon retarget results/clip --robot a1 --out results/robot
    """
    from recon.robotics.robot.retarget_clip import run_retarget
    from recon.show.report import to_json

    solved = run_retarget(folder, robot, out, scale, slower, lag, overwrite, stride_times(stride))
    if as_json:
        typer.echo(to_json(solved.report), nl=False)
        return
    _print(terminal(), solved.report, out)


def _print(console: Console, report: dict[str, Any], out: Path) -> None:
    title = report["robot"]["title"]
    say(console, f"{title}: {report['scale']:.3f} of the animal's size, {report['slower']:.2f} times slower")
    for name in ("clip", "stride"):
        part = report[name]
        slip, margin = 1000 * max(part["slip_m"].values()), min(part["least_margin_rad"].values())
        rate = 100 * max(part["rate_share"].values())
        text = (
            f"{name}: {part['duration_s']:.2f} s, {part['speed_m_s']:.2f} m/s; feet slip by {slip:.2f} mm at most in "
            f"stance; joints stay {margin:.2f} rad within their limits, at {rate:.0f} % of the fastest rate"
        )
        if name == "stride":
            text += f"; its ends meet to {max(part['closing_percent'], 0.1):.1g} %"
        say(console, text)
    for note in report["notes"]:
        say(console, f"note: {note}")
    say(
        console,
        f"Joint angles: {out / 'joints.csv'}, of one stride stride_joints.csv; the playback is motion.rrd.",
    )
