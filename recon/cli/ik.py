"""The command `recon ik`: inverse kinematics of a fitted clip, in words."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from math import degrees
from pathlib import Path
from typing import Any

from rich.table import Table

from recon.base.numbers import percent
from recon.cli.answers import Answer, table_of, verdict_texts
from recon.ik.clip import IkSettings, run_ik

WIDE_GAP_PERCENT = 25
CLOSES_PERCENT = 90
"""Above what the joints' paths of a stride close to of methods that no limit stops."""


def ik(settings: IkSettings) -> Answer:
    """Inverse kinematics of the chain from the trunk to a foot: to a target, or along a stride.

    Example: recon ik results/clip --compare
    """
    done = run_ik(settings)
    lines = _ik_lines(done.summary, settings.out_folder)
    return Answer(done.summary, [*verdict_texts(done.motion.verdict), *lines])


def _ik_lines(summary: dict[str, Any], out: Path) -> Iterator[str | Table]:
    stride, driven, along = (summary[name] for name in ("stride", "to_target", "along_stride"))
    how = {
        "given": "as given",
        "gait": "from touchdown to touchdown",
        "end effector": "from one rearmost point of the foot to the next, as in recon analyse",
        "return": "the clip has no complete one: the nearest return of the foot to the same place",
        "whole clip": "the clip has no complete one: the whole clip",
    }[stride["how"]]
    yield f"{summary['foot']}: {len(summary['joints'])} joints, {summary['dimensions']}D ({summary['base_frame']})"
    if summary["misfit_m"]:
        yield f"the chain's end lies {1000 * summary['misfit_m']:.0f} mm from the foot's projection (median)"
    gap = f"gap {1000 * stride['gap_m']:.0f} mm ({stride['gap_percent']:.1f} % of its extent), closed"
    yield f"stride: {stride['start_s']:.3f} to {stride['end_s']:.3f} s, {how}; {gap}"
    yield from (f"note: {note}" for note in stride["notes"])
    if stride["gap_percent"] > WIDE_GAP_PERCENT:
        yield "note: so wide a gap is not of one stride: a touchdown was missed, or the clip is too short"

    def table(rows: dict[str, Any], title: str, columns: dict[str, Callable[[Any], str]]) -> Table:
        every = ([name, *(cell(row) for cell in columns.values())] for name, row in rows.items())
        return table_of("method", numbers=columns, title=title, rows=every)

    def limits(row: dict[str, Any]) -> str:
        first, *others = row["limits_hit"] or ["-"]
        return first + (f" +{len(others)}" if others else "")

    def each(row: dict[str, Any]) -> str:
        return "-" if row["us_per_step"] is None else f"{row['us_per_step']:.0f}"

    if driven:
        columns = {
            "reached": lambda row: "yes" if row["reached"] else "no",
            "steps": lambda row: str(row["iterations"]),
            "µs each": each,
            "path m": lambda row: f"{row['length_m']:.2f}",
            "limits": limits,
        }
        yield table(driven, f"to ({', '.join(f'{x:.3f}' for x in summary['target_m'])}) m", columns)
        yield from (f"{name}: {row['reason']}" for name, row in driven.items() if not row["reached"])
    if along:
        least = [f"least_closure_{kind}_percent" for kind in ("angle", "plane")]
        columns = {
            "worst mm": lambda row: f"{1000 * row['worst_error_m']:.1f}",
            "µs each": each,
            "off °": lambda row: f"{degrees(row['joints_off_rad']):.0f}",
            "limits": limits,
            "closure %": lambda row: "/".join(f"{row[kind]:.1f}" for kind in least),
        }
        yield table(along, f"along the stride, turns: {summary['turns']}", columns)
        yield from (f"{name}: {row['note']}" for name, row in along.items() if row["note"])
        for name, row in along.items():
            if row["limits_hit"] and row[least[0]] < CLOSES_PERCENT:
                also = f"; then {', '.join(row['limits_hit'][1:])}" if row["limits_hit"][1:] else ""
                yield f"{name} does not close, stopped by {row['first_limit']}{also}"
        if any(row["limits_hit"] for row in along.values()):
            yield "What a method does without the limits of the joints: --no-limits."
        yield "closure: the least of any joint, of its angle/of angle and rate; off: the joints from the animal's"
    if driven or along:
        yield "limits: the first joint that one stopped, and how many more"
    parameters = summary["parameters"]
    explained = ", ".join(f"{name} {percent(fit['explained'])}" for name, fit in parameters["fitted"].items())
    yield f"parameters: {parameters['used']}. Fitted to the clip, they explain of its joint rates: {explained}"
    yield f"Tables and figures are in {out}."
