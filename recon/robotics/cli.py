"""The commands of the wing, `recon ik`, `retarget`, `robot` and `climb`: what they print."""

from __future__ import annotations

from collections.abc import Sequence
from math import degrees, isinf
from pathlib import Path
from typing import Any

import typer
from rich.console import Console

from recon.robotics.settings import ClimbSettings, IkSettings, PoseSettings, RetargetSettings, TableSettings
from recon.workflows.cli.common import EXIT_UNSOLVED, numbers, say, say_verdict, table_of, terminal


def _echo(answer: dict[str, Any]) -> None:
    from recon.show.report import to_json

    typer.echo(to_json(answer), nl=False)


WIDE_GAP_PERCENT = 25
CLOSES_PERCENT = 90
"""Above what the joints' paths of a stride close to of methods that no limit stops."""


def ik(settings: IkSettings, as_json: bool) -> None:
    """Inverse kinematics of the chain from the trunk to a foot: to a target, or along a stride.

    Example: recon ik results/clip --compare
    """
    from recon.robotics.ik.clip import run_ik

    done = run_ik(settings)
    if as_json:
        _echo(done.summary)
        return
    console = terminal()
    say_verdict(console, done.motion.verdict)
    _print_ik(console, done.summary, settings.out_folder)


def _print_ik(console: Console, summary: dict[str, Any], out: Path) -> None:
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


def retarget(settings: RetargetSettings, as_json: bool) -> None:
    """The motion of a reconstruction on a four-legged robot, and one stride of it that repeats.

    Example: recon retarget results/clip --robot a1 --out results/robot
    """
    from recon.robotics.robot.retarget_clip import run_retarget

    done, report = run_retarget(settings)
    if as_json:
        _echo(report)
        return
    console = terminal()
    say_verdict(console, done.animal.analysis.motion.verdict)
    _print_retarget(console, report, settings.out)


def _print_retarget(console: Console, report: dict[str, Any], out: Path) -> None:
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
    if "samples" in report:
        apart = report["samples"]
        place, angle = (max(apart[name].values()) for name in ("base_sigma_m", "joint_sigma_rad"))
        text = f"{apart['count']} motions that it may have been, in {out / 'samples.npz'}: the base is known to"
        say(console, f"{text} {place:.3f} m, joint angles to {angle:.2f} rad (one standard deviation, the worst)")
        if "keep_every_rule" in apart:
            say(console, f"{apart['keep_every_rule']} of these motions keep every rule below in every frame")
    if "check" in report:
        _print_check(console, report["check"])
    for note in report["notes"]:
        say(console, f"note: {note}")
    say(
        console,
        f"Joint angles: {out / 'joints.csv'}, of one stride stride_joints.csv; the playback is motion.rrd.",
    )


def _print_check(console: Console, check: dict[str, Any]) -> None:
    from recon.robotics.robot.physics import RULES

    before = check.get("before")
    numbers = [*(["before, %"] if before else []), "clip, %", "stride, %", "least", ""]
    table, advice = table_of("frames that keep it", numbers=numbers), {}
    for name, rule in RULES.items():
        clip, stride = check["clip"][name], check["stride"][name]
        earlier = [f"{100 * min(before[part][name]['share'] for part in ('clip', 'stride')):.0f}"] if before else []
        shares = [f"{100 * part['share']:.0f}" for part in (clip, stride)]
        table.add_row(rule.what, *earlier, *shares, f"{min(clip['least'], stride['least']):.2f}", rule.unit)
        if min(clip["share"], stride["share"]) < 1:
            advice[rule.what] = rule.advice
    console.print(table)
    if before:
        made = check["changed"]
        say(
            console,
            f"changed: time {made['slower']:.2f} times, stride {made['scale']:.2f} times, standing height "
            f"{made['height']:.2f} times; the base moved by up to {1000 * made['base_moved_m']:.0f} mm and "
            f"{degrees(made['base_turned_rad']):.0f}°",
        )
        if advice:
            say(console, "note: no change that was tried keeps every rule in every frame; this one comes nearest")
    else:
        for what, change in advice.items():
            say(console, f"{what}: {change}")


def pose(settings: PoseSettings, as_json: bool) -> None:
    """The legs' angles of a body that is moved and turned, the feet planted.

    Example: recon robot pose aibo --pitch 10 --move 0,0,-0.01
    """
    from recon.robotics.robot.dh import pose_of

    answer = pose_of(settings)
    if as_json:
        _echo(answer)
        return
    console = terminal()
    table = table_of("leg", "joint", numbers=("angle °", "foot x m", "y m", "z m"), title=answer["robot"])
    for label, leg in answer["legs"].items():
        foot = [f"{x:.4f}" for x in leg["foot_m"]]
        degrees = ["-"] * len(leg["joints"]) if leg["angles_rad"] is None else _deg(leg["angles_rad"])
        for k, (name, angle) in enumerate(zip(leg["joints"], degrees, strict=True)):
            table.add_row(*((label, name, angle, *foot) if k == 0 else ("", name, angle, "", "", "")))
    console.print(table)
    for label, leg in answer["legs"].items():
        if leg["why"]:
            say(console, f"{label}: {leg['why']}")


def dh(settings: TableSettings, as_json: bool) -> None:
    """The Denavit-Hartenberg table of a chain or a robot's leg, its end at given angles, and all angles of a given end.

    Example: recon robot dh aibo --tip LF --place 0.09,0.07,-0.1
    """
    from recon.robotics.robot.dh import chain_of

    answer = chain_of(settings, None if settings.angles is None else numbers("--angles", settings.angles))
    if as_json:
        _echo(answer)
        return
    _print_chain(terminal(), answer, f"{settings.source} {settings.tip or ''}".strip())


def _print_chain(console: Console, answer: dict[str, Any], title: str) -> None:
    slides = answer["slides"]
    table = table_of(
        "joint",
        numbers=("a m", "alpha °", "d m", "theta °", "least", "most"),
        title=f"{title}: {answer['dh']['convention']}",
    )
    limits = zip(answer["lower"], answer["upper"], strict=True)
    for name, row, limit, slide in zip(answer["joints"], answer["dh"]["rows"], limits, slides, strict=True):
        alpha, theta = _deg((row["alpha_rad"], row["theta_rad"]))
        table.add_row(name, f"{row['a_m']:z.4f}", alpha, f"{row['d_m']:z.4f}", theta, *_typed(limit, [slide] * 2))
    console.print(table)
    for name in (name for name in ("base", "tool") if name in answer["dh"]):
        say(console, f"{name}: {_pose_text(answer['dh'][name])}")
    if "forward" in answer:
        beyond = "" if answer["forward"]["within_limits"] else "; beyond a joint's limits"
        say(console, f"end: {_pose_text(answer['forward'])}{beyond}")
    if "inverse" in answer:
        every = answer["inverse"]["solutions"]
        table = table_of("solution", numbers=(*answer["joints"], "within limits"))
        for k, solution in enumerate(every):
            table.add_row(str(k + 1), *_typed(solution["q"], slides), "yes" if solution["within_limits"] else "no")
        if every:
            console.print(table)
        if answer["inverse"]["note"]:
            say(console, answer["inverse"]["note"])


def _pose_text(answer: dict[str, Any]) -> str:
    place = ", ".join(f"{x:z.4f}" for x in answer["place_m"])
    return f"at ({place}) m, roll, pitch and yaw ({', '.join(_deg(answer['roll_pitch_yaw_rad']))})°"


def _typed(values: Sequence[float], slides: Sequence[bool]) -> list[str]:
    """As a user types them: degrees, or metres."""
    return [f"{x:z.4f}" if slide else _deg([x])[0] for x, slide in zip(values, slides, strict=True)]


def _deg(angles_rad: Sequence[float]) -> list[str]:
    return ["any" if isinf(x) else f"{degrees(x):z.2f}" for x in angles_rad]


def climb(settings: ClimbSettings, as_json: bool) -> None:
    """A four-legged robot climbs a step by potential fields.

    Example: recon climb published-50 --height 0.045 --out results/climb

    Exit code 0: valid in every frame. 1: it is not, and all is written. 2: the input cannot be used.
    """
    from recon.robotics.climb.run import run_climb

    report = run_climb(settings)
    if as_json:
        _echo(report)
    else:
        _print_climb(report, settings.out)
    if not report["valid"]:
        raise typer.Exit(EXIT_UNSOLVED)


def _print_climb(report: dict[str, Any], out: Path) -> None:
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
    say(console, f"The playback is {out / 'climb.rrd'}.")
