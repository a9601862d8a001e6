"""`recon ik`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, Literal

import typer
from rich.console import Console

from recon.base.errors import InputError, Problem
from recon.workflows.cli.common import STRIDE, say, stride_times, table_of, terminal

WIDE_GAP_PERCENT = 25


def ik(
    folder: Annotated[Path, typer.Argument(metavar="DIR", help="Folder of results, as in results/clip.")],
    method: Annotated[
        str,
        typer.Option(
            help="least-norm, transpose, gradient-projection, weighted, damped, selectively-damped, "
            "extended-differences, extended-energy, extended-harmonic, or extended with --cost."
        ),
    ] = "damped",
    target: Annotated[
        str | None,
        typer.Option(
            help="Drive the foot there: stride-max, its foremost place in the stride, from its rearmost; or x,y,z in "
            "metres from the chain's base, as in 0.8,0.1,-0.5."
        ),
    ] = None,
    follow: Annotated[
        str | None, typer.Option(help="Follow a path with the foot: stride, one of its own, closed.")
    ] = None,
    compare: Annotated[
        bool, typer.Option("--compare", help="All methods in one table; both jobs unless one is asked for.")
    ] = False,
    foot: Annotated[
        str | None, typer.Option(help="LF, RF, LH, RH, or the joint's name. (default: the first fore foot)")
    ] = None,
    stride: Annotated[str | None, STRIDE] = None,
    dim: Annotated[int, typer.Option(help="2: in the vertical plane of travel; 3: in space.", min=2, max=3)] = 3,
    turns: Annotated[int, typer.Option(help="How often to follow the stride.", min=1)] = 1,
    limits: Annotated[bool, typer.Option("--limits/--no-limits", help="Limits of the joints.")] = True,
    fitted: Annotated[
        bool,
        typer.Option(
            "--fitted",
            help="With the methods' parameters fitted to this clip; also fits them to each frame of the stride.",
        ),
    ] = False,
    cost: Annotated[
        str | None,
        typer.Option(
            help="Of the method extended, and of gradient-projection: differences, energy, harmonic, pose (distance "
            "from the clip's mean pose), or a sum with weights, as in energy,differences=0.1.",
        ),
    ] = None,
    alpha: Annotated[
        str | None,
        typer.Option(
            help="Factor on the joints' rates of every method: a number, or step, at every step the one with which the "
            "foot moves nearest to what is asked for. (default: none)",
            show_default=False,
        ),
    ] = None,
    out: Annotated[
        Path | None, typer.Option(help="Folder for tables and figures. (default: ik in DIR)", show_default=False)
    ] = None,
    figures: Annotated[bool, typer.Option("--figures/--no-figures", help="PNG and SVG beside the tables.")] = True,
    overwrite: Annotated[bool, typer.Option("--overwrite", help="Replace earlier ones.")] = False,
    as_json: Annotated[bool, typer.Option("--json", help="Print the summary as JSON.")] = False,
) -> None:
    """Inverse kinematics of the chain from the trunk to a foot: to a target, or along a stride.

    Example: recon ik results/clip --compare
    """
    from recon.robotics.ik.clip import EXTENDED, METHODS, STRIDE_MAX, run_ik
    from recon.show.report import to_json

    problems = []
    if follow not in (None, "stride"):
        problems.append(Problem("--follow", "path", repr(follow), "stride"))
    if target is None and follow is None and not compare:
        problems.append(Problem("options", "job", "none", "--target, --follow stride or --compare"))
    factor: float | Literal["step"] | None = None
    try:
        factor = "step" if alpha == "step" else None if alpha is None else float(alpha)
    except ValueError:
        problems.append(Problem("--alpha", "factor", repr(alpha), "step, or a number other than 0"))
    if problems:
        raise InputError(problems)
    both = target is None and follow is None
    solved = run_ik(
        folder,
        (*METHODS, *([] if cost is None else [EXTENDED])) if compare else (method,),
        STRIDE_MAX if both else target,
        both or follow is not None,
        foot,
        2 if dim == 2 else 3,
        turns,
        limits,
        fitted,
        out,
        figures,
        overwrite,
        stride_times(stride),
        cost,
        factor,
    )
    if as_json:
        typer.echo(to_json(solved.summary), nl=False)
        return
    _print(terminal(), solved.summary, folder / "ik" if out is None else out)


def _print(console: Console, summary: dict[str, Any], out: Path) -> None:
    stride = summary["stride"]
    how = {
        "given": "as given",
        "ground": "from touchdown to touchdown",
        "body": "from one foremost place of the foot to the next: the ground shows none that counts",
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
        columns = ("worst mm", "µs each", "path m", "limits", "closure %")
        title = f"along the stride, turns: {summary['turns']}"
        table = table_of("method", numbers=columns, title=title)
        for name, row in summary["along_stride"].items():
            closed = f"{row['least_closure_angle_percent']:.1f}/{row['least_closure_plane_percent']:.1f}"
            table.add_row(name, f"{1000 * row['worst_error_m']:.1f}", *_shared(row), closed)
        console.print(table)
        for name, row in summary["along_stride"].items():
            if row["note"]:
                say(console, f"{name}: {row['note']}")
    if summary["along_stride"]:
        say(
            console,
            "closure: the least of any joint, of its angle/of angle and rate; limits: joints that reached one",
        )
    parameters = summary["parameters"]
    explained = ", ".join(f"{name} {fit['explained']:.0%}" for name, fit in parameters["fitted"].items())
    say(console, f"parameters: {parameters['used']}. Fitted to the clip, they explain of its joint rates: {explained}")
    say(console, f"Tables and figures are in {out}.")


def _shared(row: dict[str, Any]) -> tuple[str, ...]:
    us = row["us_per_step"]
    return (
        "-" if us is None else f"{us:.0f}",
        f"{row['length_m']:.2f}",
        str(len(row["limits_hit"])),
    )
