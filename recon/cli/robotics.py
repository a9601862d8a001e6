"""The commands `recon retarget` and `recon climb`, which move a robot."""

from __future__ import annotations

from collections.abc import Iterator
from math import degrees
from pathlib import Path
from typing import Any

from rich.table import Table

from recon.base.numbers import quantity, rounded
from recon.cli.answers import EXIT_UNSOLVED, Answer, table_of, verdict_texts
from recon.robotics.settings import ClimbSettings, RetargetSettings


def retarget_command(settings: RetargetSettings) -> Answer:
    """Transfer the motion of a reconstruction, and one repeated stride, to a four-legged robot.

    Example: recon retarget results/clip --robot a1 --out results/robot
    """
    from recon.robotics.retarget_clip import run_retarget

    done, report = run_retarget(settings)
    verdict = done.animal.analysis.motion.verdict
    return Answer(report, [*verdict_texts(verdict), *_retarget_lines(report, settings.out)])


def _retarget_lines(report: dict[str, Any], out: Path) -> Iterator[str | Table]:
    scale = f"moves {report['scale']:.3f} times as far as the animal, in {report['slower']:.2f} times the time"
    yield f"{report['robot']['title']}: {scale}"
    for name in ("clip", "stride"):
        part = report[name]
        slip, margin = 1000 * max(part["slip_m"].values()), min(part["least_margin_rad"].values())
        rate = 100 * max(part["rate_share"].values())
        text = (
            f"{name}: {quantity(part['duration_s'], 2, 's')}, {quantity(part['speed_m_s'], 2, 'm/s')}; feet "
            f"slip by {quantity(slip, 2, 'mm')} at most in "
            f"stance; joints stay {margin:.2f} rad within their limits, at {rate:.0f} % of the fastest rate"
        )
        if name == "stride":
            text += f"; its ends meet within {max(part['closing_percent'], 0.1):.1g} %"
        yield text
    if "samples" in report:
        samples = report["samples"]
        position_sigma, angle = (max(samples[name].values()) for name in ("base_sigma_m", "joint_sigma_rad"))
        text = (
            f"{samples['count']} motions drawn from the uncertainty are in {out / 'samples.npz'}: the base is known to "
            "within"
        )
        yield (
            f"{text} {quantity(position_sigma, 3, 'm')}, joint angles to {angle:.2f} rad (one standard "
            "deviation, the worst)"
        )
        if "keep_every_rule" in samples:
            yield f"{samples['keep_every_rule']} of these motions keep every rule below in every frame"
    if "check" in report:
        yield from _check_lines(report["check"])
    yield from (f"note: {note}" for note in report["notes"])
    yield f"Joint angles are in {out / 'joints.csv'}, those of one stride in stride_joints.csv. Playback: motion.rrd"


def _check_lines(check: dict[str, Any]) -> Iterator[str | Table]:
    from recon.robotics.physics import RULES

    earlier_check = check.get("before")
    numbers = [*(["before"] if earlier_check else []), "clip", "stride", "least", ""]
    table, advice = table_of("rule, kept in % of frames", numbers=numbers), {}
    for name, rule in RULES.items():
        clip, stride = check["clip"][name], check["stride"][name]
        earlier_cells = (
            [f"{100 * min(earlier_check[part][name]['share'] for part in ('clip', 'stride')):.0f}"]
            if earlier_check
            else []
        )
        shares = [f"{100 * part['share']:.0f}" for part in (clip, stride)]
        table.add_row(rule.title, *earlier_cells, *shares, rounded(min(clip["least"], stride["least"]), 2), rule.unit)
        if min(clip["share"], stride["share"]) < 1:
            advice[rule.title] = rule.advice
    yield table
    if earlier_check:
        changes = check["changed"]
        yield (
            f"changed: time {changes['slower']:.2f} times, stride {changes['scale']:.2f} times, standing height "
            f"{changes['height']:.2f} times; the base moved by up to "
            f"{quantity(1000 * changes['base_moved_m'], 0, 'mm')} and "
            f"{quantity(degrees(changes['base_turned_rad']), 0, '°')}"
        )
        if advice:
            yield "note: no change that was tried keeps every rule in every frame; this one violates them least"
    else:
        yield from (f"{rule_text}: {change}" for rule_text, change in advice.items())


def climb(settings: ClimbSettings) -> Answer:
    """Climb a step with a four-legged robot, guided by potential fields.

    Example: recon climb published-50 --height 0.045 --out results/climb

    Exit code 0: valid in every frame. 1: not valid in every frame; all files are written. 2: the input cannot be used.
    """
    from recon.robotics.climb.plan import run_climb

    report = run_climb(settings)
    return Answer(report, _climb_lines(report, settings.out), code=0 if report["valid"] else EXIT_UNSOLVED)


def _climb_lines(report: dict[str, Any], out: Path) -> Iterator[str | Table]:
    from recon.robotics.climb.plan import PLAYBACK

    pitch, rate = degrees(report["largest_pitch_rad"]), 100 * report["rate_share"]
    yield (
        f"{report['robot']} climbs {quantity(1000 * report['step_m'], 0, 'mm')} in "
        f"{quantity(report['duration_s'], 1, 's')}, "
        f"{report['frames']} frames; pitch up to {quantity(pitch, 0, '°')}; joints at {rate:.0f} % of the "
        "fastest rate at most"
    )
    least = report["least_margins"].values()
    rows = ((row["what"], f"{row['value']:.1f}", row["unit"], f"{row['at_s']:.2f}") for row in least)
    yield table_of("least margin", numbers=("", "", "at s"), rows=rows)
    yield "valid in every frame" if report["valid"] else f"not valid: {'; '.join(report['problems'])}"
    if report["settled_share"] < 1:
        yield f"note: in equilibrium in only {100 * report['settled_share']:.0f} % of the frames"
    yield f"The playback is {out / PLAYBACK}."
