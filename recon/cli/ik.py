"""The command `recon ik`: inverse kinematics of a fitted clip."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import partial
from math import degrees, isnan
from pathlib import Path
from typing import Any

from rich.table import Table

from recon.base.numbers import percent, quantity
from recon.cli.answers import Answer, table_of, verdict_texts
from recon.ik.settings import IkSettings

WIDE_GAP_PERCENT = 25
CLOSES_PERCENT = 90
"""Minimum closure over a stride, in percent, that every joint's angle needs for the outcome "closes"."""
MIN_CLOSURE = "least_closure_angle_percent"
OFF_PATH_M = 0.02
"""Distance of the foot from the stride's path, in metres, above which a method counts as failed."""


def ik(settings: IkSettings) -> Answer:
    """Solve the inverse kinematics of the chain from trunk to foot, for a target or along a stride.

    Example: recon ik results/clip --compare
    """
    from recon.ik.clip import run_ik

    done = run_ik(settings)
    lines = _ik_lines(done.summary, settings.out_folder)
    return Answer(done.summary, [*verdict_texts(done.motion.verdict), *lines])


def _ik_lines(summary: dict[str, Any], out: Path) -> Iterator[str | Table]:
    from recon.gait.gait import STRIDE_WORDS

    stride = summary["stride"]
    origin = STRIDE_WORDS[stride["how"]].ends
    size = f"{len(summary['joints'])} joints, {summary['dimensions']}D"
    yield f"chain from {summary['base_at']} to {summary['foot']}: {size}"
    if summary["misfit_m"]:
        yield (
            f"the chain's end lies {quantity(1000 * summary['misfit_m'], 0, 'mm')} from the foot's projection (median)"
        )
    gap = f"gap {quantity(1000 * stride['gap_m'], 0, 'mm')} ({stride['gap_percent']:.1f} % of its extent), closed"
    yield f"stride: {stride['start_s']:.3f} to {quantity(stride['end_s'], 3, 's')}, {origin}; {gap}"
    yield from (f"note: {note}" for note in stride["notes"])
    if stride["gap_percent"] > WIDE_GAP_PERCENT:
        yield "note: the gap is too wide for one stride: a touch-down was missed, or the clip is too short"
    driven, along = summary["to_target"], summary["along_stride"]
    if driven:
        yield from _target_lines(driven, summary)
    if along:
        yield from _stride_lines(along, summary)
    if driven or along:
        yield "limits: the first joint that reached its limit; +n: n further joints reached theirs"
    if summary["costs"]:
        yield from _cost_lines(summary["costs"])
    parameters = summary["parameters"]
    explained = ", ".join(f"{name} {percent(fit['explained'])}" for name, fit in parameters["fitted"].items())
    yield f"parameters: {parameters['used']}. Fraction of the joint rates explained by fitted parameters: {explained}"
    yield f"Tables and figures are in {out}."


def _table(rows: dict[str, Any], title: str, columns: dict[str, Callable[[Any], str]], head: str = "method") -> Table:
    cells = ([name, *(cell(row) for cell in columns.values())] for name, row in rows.items())
    return table_of(head, numbers=columns, title=title, rows=cells)


def _short(joint: str) -> str:
    return joint.replace("theta_", "th").replace("phi_", "ph")


def _limits(row: dict[str, Any]) -> str:
    first, *more_joints = row["limits_hit"] or ["-"]
    return _short(first) + (f" +{len(more_joints)}" if more_joints else "")


def _step_time(row: dict[str, Any]) -> str:
    return "-" if row["us_per_step"] is None else f"{row['us_per_step']:.0f}"


def _target_lines(driven: dict[str, Any], summary: dict[str, Any]) -> Iterator[str | Table]:
    columns: dict[str, Callable[[Any], str]] = {
        "reached": lambda row: "yes" if row["reached"] else "failed",
        "steps": lambda row: str(row["iterations"]),
        "left mm": lambda row: f"{1000 * row['left_m']:.1f}",
        "µs each": _step_time,
        "path m": lambda row: f"{row['length_m']:.2f}",
        "limits": _limits,
    }
    target = ", ".join(f"{x:.3f}" for x in summary["target_m"])
    axes = ", ".join(summary["base_frame"].split(", ")[: summary["dimensions"]])
    yield _table(driven, f"to the target ({target}) m from {summary['base_at']} ({axes})", columns)
    yield from (f"{name} failed: {row['reason']}" for name, row in driven.items() if not row["reached"])


def _result(row: dict[str, Any]) -> str:
    """Return a short description of the outcome of a method along the stride."""
    if row["worst_error_m"] > OFF_PATH_M:
        return "off-path"
    if row["note"].startswith("singular"):
        return "singular"
    if row[MIN_CLOSURE] >= CLOSES_PERCENT:
        return "closes"
    return "limited" if row["limits_hit"] else "drifts"


def _stride_lines(along: dict[str, Any], summary: dict[str, Any]) -> Iterator[str | Table]:
    columns: dict[str, Callable[[Any], str]] = {
        "result": _result,
        "worst mm": lambda row: f"{1000 * row['worst_error_m']:.1f}",
        "µs each": _step_time,
        "off °": lambda row: f"{degrees(row['joints_off_rad']):.0f}",
        "limits": _limits,
        "closure %": lambda row: f"{row[MIN_CLOSURE]:.1f}",
    }
    yield _table(along, f"along the stride, turns: {summary['turns']}", columns)
    yield from (f"{name}: {row['note']}" for name, row in along.items() if row["note"])
    for name, row in along.items():
        if row["limits_hit"] and row[MIN_CLOSURE] < CLOSES_PERCENT:
            later = f"; then {', '.join(row['limits_hit'][1:])}" if row["limits_hit"][1:] else ""
            yield f"{name} does not close, stopped by {row['first_limit']}{later}"
    if any(row["limits_hit"] for row in along.values()):
        yield "To run a method without the limits of the joints: --no-limits."
    yield (
        f"result: closes: {CLOSES_PERCENT} % or more for every joint; off-path: more than "
        f"{quantity(1000 * OFF_PATH_M, 0, 'mm')} from the path; limited: "
        "does not close, and a joint is at its limit. "
        "closure: the smallest among the joints' angles; off: distance of the joint angles from the animal's"
    )
    sources = {"animal": summary["animal"]} | along
    joints = {_short(joint): partial(_closure_cell, joint=joint) for joint in summary["joints"]}
    yield _table(sources, "degree of closure by joint, angle and rate, %", joints)


def _closure_cell(row: dict[str, Any], joint: str) -> str:
    value = row["closure_plane_percent"][joint]
    return "-" if value is None or isnan(value) else f"{value:.0f}"


def _cost_lines(costs: dict[str, Any]) -> Iterator[str | Table]:
    from recon.ik.cost_study import CHAOTIC_GROWTH, TURNS

    columns: dict[str, Callable[[Any], str]] = {
        "result": lambda row: row["outcome"],
        "starts at": lambda row: row["stationary"].split(":")[0],
        "drift °": lambda row: f"{degrees(row['drift_rad']):.1f}",
        "growth": lambda row: f"{row['growth']:.1g}",
        "singular": lambda row: str(row["singular_steps"]),
        "limits": _limits,
    }
    yield _table(costs, f"extended Jacobian by cost, {TURNS} turns of the stride", columns, "cost")
    yield (
        "growth: factor by which the distance between two starts, a millionth of a radian apart, grows; chaotic: "
        f"{CHAOTIC_GROWTH:g} or more. singular: number of steps at which the extended matrix has no inverse."
    )
