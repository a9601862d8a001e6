"""The command `recon retarget`: its options, and what it prints."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import typer
from rich.console import Console

from recon.robotics.settings import RetargetSettings
from recon.workflows.cli.common import say, say_verdict, table_of, terminal


def retarget(settings: RetargetSettings, as_json: bool) -> None:
    """The motion of a reconstruction on a four-legged robot, and one stride of it that repeats.

    Example: recon retarget results/clip --robot a1 --out results/robot
    """
    from recon.robotics.robot.retarget_clip import run_retarget
    from recon.show.report import to_json

    done, report = run_retarget(settings)
    if as_json:
        typer.echo(to_json(report), nl=False)
        return
    console = terminal()
    say_verdict(console, done.animal.analysis.motion.verdict)
    _print(console, report, settings.out)


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
    if "samples" in report:
        apart = report["samples"]
        place, angle = (max(apart[name].values()) for name in ("base_sigma_m", "joint_sigma_rad"))
        text = f"{apart['count']} motions that it may have been, in {out / 'samples.npz'}: the base is known to"
        say(console, f"{text} {place:.3f} m, joint angles to {angle:.2f} rad (one standard deviation, the worst)")
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
        say(console, f"{check['slower']:.2f} times slower than the animal, {before['slower']:.2f} before")
    for what, change in advice.items():
        say(console, f"{what}: {change}")
