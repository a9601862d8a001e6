"""The commands of the wing, `recon ik`, `retarget`, `robot` and `climb`: what they print."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from math import degrees, isinf
from pathlib import Path
from typing import Any

from rich.table import Table

from recon.wings.robotics.settings import ClimbSettings, IkSettings, PoseSettings, RetargetSettings, TableSettings
from recon.workflows.cli import EXIT_UNSOLVED, Answer, numbers, table_of, verdict_texts

WIDE_GAP_PERCENT = 25
CLOSES_PERCENT = 90
"""Above what the joints' paths of a stride close to of methods that no limit stops."""
Lines = Iterator[str | Table]


def ik(settings: IkSettings) -> Answer:
    """Inverse kinematics of the chain from the trunk to a foot: to a target, or along a stride.

    Example: recon ik results/clip --compare
    """
    from recon.wings.robotics.ik.clip import run_ik

    done = run_ik(settings)
    lines = _ik_lines(done.summary, settings.out_folder)
    return Answer(done.summary, [*verdict_texts(done.motion.verdict), *lines])


def _ik_lines(summary: dict[str, Any], out: Path) -> Lines:
    stride, driven, along = (summary[name] for name in ("stride", "to_target", "along_stride"))
    how = {
        "given": "as given",
        "gait": "from touchdown to touchdown",
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
    explained = ", ".join(f"{name} {fit['explained']:.0%}" for name, fit in parameters["fitted"].items())
    yield f"parameters: {parameters['used']}. Fitted to the clip, they explain of its joint rates: {explained}"
    yield f"Tables and figures are in {out}."


def retarget(settings: RetargetSettings) -> Answer:
    """The motion of a reconstruction on a four-legged robot, and one stride of it that repeats.

    Example: recon retarget results/clip --robot a1 --out results/robot
    """
    from recon.wings.robotics.robot.retarget_clip import run_retarget

    done, report = run_retarget(settings)
    verdict = done.animal.analysis.motion.verdict
    return Answer(report, [*verdict_texts(verdict), *_retarget_lines(report, settings.out)])


def _retarget_lines(report: dict[str, Any], out: Path) -> Lines:
    scale = f"{report['scale']:.3f} of the animal's size, {report['slower']:.2f} times slower"
    yield f"{report['robot']['title']}: {scale}"
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
        yield text
    if "samples" in report:
        apart = report["samples"]
        place, angle = (max(apart[name].values()) for name in ("base_sigma_m", "joint_sigma_rad"))
        text = f"{apart['count']} motions that it may have been, in {out / 'samples.npz'}: the base is known to"
        yield f"{text} {place:.3f} m, joint angles to {angle:.2f} rad (one standard deviation, the worst)"
        if "keep_every_rule" in apart:
            yield f"{apart['keep_every_rule']} of these motions keep every rule below in every frame"
    if "check" in report:
        yield from _check_lines(report["check"])
    yield from (f"note: {note}" for note in report["notes"])
    yield f"Joint angles: {out / 'joints.csv'}, of one stride stride_joints.csv; the playback is motion.rrd."


def _check_lines(check: dict[str, Any]) -> Lines:
    from recon.wings.robotics.robot.physics import RULES

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
    yield table
    if before:
        made = check["changed"]
        yield (
            f"changed: time {made['slower']:.2f} times, stride {made['scale']:.2f} times, standing height "
            f"{made['height']:.2f} times; the base moved by up to {1000 * made['base_moved_m']:.0f} mm and "
            f"{degrees(made['base_turned_rad']):.0f}°"
        )
        if advice:
            yield "note: no change that was tried keeps every rule in every frame; this one comes nearest"
    else:
        yield from (f"{what}: {change}" for what, change in advice.items())


def pose(settings: PoseSettings) -> Answer:
    """The legs' angles of a body that is moved and turned, the feet planted.

    Example: recon robot pose aibo --pitch 10 --move 0,0,-0.01
    """
    from recon.wings.robotics.robot.dh import pose_of

    answer = pose_of(settings)
    table = table_of("leg", "joint", numbers=("angle °", "foot x m", "y m", "z m"), title=answer["robot"])
    for label, leg in answer["legs"].items():
        angles = ["-"] * len(leg["joints"]) if leg["angles_rad"] is None else _deg(leg["angles_rad"])
        for k, row in enumerate(zip(leg["joints"], angles, strict=True)):
            table.add_row("" if k else label, *row, *(f"{x:.4f}" for x in leg["foot_m"] if not k))
    why = (f"{label}: {leg['why']}" for label, leg in answer["legs"].items() if leg["why"])
    return Answer(answer, [table, *why])


def dh(settings: TableSettings) -> Answer:
    """The Denavit-Hartenberg table of a chain or a robot's leg, its end at given angles, and all angles of a given end.

    Example: recon robot dh aibo --tip LF --place 0.09,0.07,-0.1
    """
    from recon.wings.robotics.robot.dh import chain_of

    answer = chain_of(settings, None if settings.angles is None else numbers("--angles", settings.angles))
    return Answer(answer, _chain_lines(answer, f"{settings.source} {settings.tip or ''}".strip()))


def _chain_lines(answer: dict[str, Any], title: str) -> Lines:
    slides, columns = answer["slides"], ("a m", "alpha °", "d m", "theta °", "least", "most")
    table = table_of("joint", numbers=columns, title=f"{title}: {answer['dh']['convention']}")
    limits = zip(answer["lower"], answer["upper"], strict=True)
    for name, row, limit, slide in zip(answer["joints"], answer["dh"]["rows"], limits, slides, strict=True):
        values = (row[column] for column in ("a_m", "alpha_rad", "d_m", "theta_rad"))
        table.add_row(name, *_typed([*values, *limit], [True, False, True, False, slide, slide]))
    yield table
    yield from (f"{name}: {_pose_text(answer['dh'][name])}" for name in ("base", "tool") if name in answer["dh"])
    if "forward" in answer:
        beyond = "" if answer["forward"]["within_limits"] else "; beyond a joint's limits"
        yield f"end: {_pose_text(answer['forward'])}{beyond}"
    if "inverse" in answer:
        rows = [
            [str(k), *_typed(one["q"], slides), "yes" if one["within_limits"] else "no"]
            for k, one in enumerate(answer["inverse"]["solutions"], start=1)
        ]
        if rows:
            yield table_of("solution", numbers=(*answer["joints"], "within limits"), rows=rows)
        if answer["inverse"]["note"]:
            yield answer["inverse"]["note"]


def _pose_text(answer: dict[str, Any]) -> str:
    place = ", ".join(f"{x:z.4f}" for x in answer["place_m"])
    return f"at ({place}) m, roll, pitch and yaw ({', '.join(_deg(answer['roll_pitch_yaw_rad']))})°"


def _typed(values: Sequence[float], slides: Sequence[bool]) -> list[str]:
    """As a user types them: degrees, or metres."""
    return [f"{x:z.4f}" if slide else _deg([x])[0] for x, slide in zip(values, slides, strict=True)]


def _deg(angles_rad: Sequence[float]) -> list[str]:
    return ["any" if isinf(x) else f"{degrees(x):z.2f}" for x in angles_rad]


def climb(settings: ClimbSettings) -> Answer:
    """A four-legged robot climbs a step by potential fields.

    Example: recon climb published-50 --height 0.045 --out results/climb

    Exit code 0: valid in every frame. 1: it is not, and all is written. 2: the input cannot be used.
    """
    from recon.wings.robotics.climb.run import run_climb

    report = run_climb(settings)
    return Answer(report, _climb_lines(report, settings.out), code=0 if report["valid"] else EXIT_UNSOLVED)


def _climb_lines(report: dict[str, Any], out: Path) -> Lines:
    pitch, rate = degrees(report["largest_pitch_rad"]), 100 * report["rate_share"]
    yield (
        f"{report['robot']} climbs {1000 * report['step_m']:.0f} mm in {report['duration_s']:.1f} s, "
        f"{report['frames']} frames; pitch up to {pitch:.0f}°; joints at {rate:.0f} % of the fastest rate at most"
    )
    least = report["least_margins"].values()
    rows = ((row["what"], f"{row['value']:.1f}", row["unit"], f"{row['at_s']:.2f}") for row in least)
    yield table_of("least margin", numbers=("", "", "at s"), rows=rows)
    yield "valid in every frame" if report["valid"] else f"not valid: {'; '.join(report['problems'])}"
    if report["settled_share"] < 1:
        yield f"note: in equilibrium in {100 * report['settled_share']:.0f} % of the frames only"
    yield f"The playback is {out / 'climb.rrd'}."
