"""A reconstruction on a quadruped robot: joint angles, base, footholds, report and playback."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import RigidTransform

from recon.base.arrays import Array
from recon.base.errors import InputError, Problem, all_of
from recon.base.files import name_seen_from, require_free_folder, seen_from, sole_writer, staged_results
from recon.check import usable, verdict_fields
from recon.fit.motion import Motion
from recon.gait.gait import doubt_text
from recon.io.table import write_rows
from recon.robotics.control import control_columns
from recon.robotics.robot.quadruped import LEGS, Quadruped
from recon.robotics.robot.reference import (
    Animal,
    Reference,
    StrideWindow,
    closed_stride,
    reference_of,
    stride_window,
    with_other_side,
)
from recon.robotics.robot.retarget import LEGS_APART, Retargeted, RobotMotion, retarget
from recon.robotics.robot.robot_file import load_robot
from recon.robotics.robot.trainers import write_for_trainer
from recon.robotics.settings import RetargetSettings
from recon.show.report import to_json

REPORT = "report.json"
REPEATS = 3
"""Of the stride in its playback."""
SLIP_M, CLOSING_PERCENT = 0.002, 1.0
"""What a robot's stance and stride are allowed without a note."""


@dataclass(frozen=True, eq=False)
class RetargetRun:
    """What was made of what."""

    animal: Animal
    window: StrideWindow
    clip: Reference
    """The animal's reference as the robot follows it."""
    motion: Retargeted
    report: dict[str, Any]
    """What report.json holds."""


def run_retarget(settings: RetargetSettings) -> RetargetRun:
    """`recon retarget`: tables, report and playback into a folder. Raises InputError."""
    out, folder, lag = settings.out, settings.folder, settings.lag
    results, machine, _ = all_of(
        lambda: usable(Motion.load(folder), folder, settings.anyway),
        lambda: load_robot(settings.robot),
        lambda: require_free_folder(out, (REPORT,), settings.overwrite),
    )
    animal = reference_of(results, settings.stride)
    if lag and len(animal.reference.feet) == len(LEGS):
        found = f"{lag:g}, for an animal of which both sides are measured"
        raise InputError(Problem("--lag", "share of a stride", found, "none, or a chain of one side"))
    with sole_writer(out):
        require_free_folder(out, (REPORT,), settings.overwrite)
        solved = solve(animal, machine, settings.scale, settings.slower, lag)
        solved.report["animal"]["results"] = seen_from(out, folder)
        solved.report["robot"]["source"] = name_seen_from(out, machine.source)
        said = {k: solved.report[k] for k in ("verdict", "robot", "animal", "scale", "slower")}
        with staged_results(out) as staging:
            if settings.samples is not None:
                from recon.robotics.robot.ensemble import drawn, write_ensemble

                given = machine, solved.motion.clip.scale, solved.motion.clip.slower, lag, solved.window
                motions = [
                    solve(reference_of(one, settings.stride), *given).motion.clip
                    for one in drawn(animal.analysis.motion, folder, settings.samples)
                ]
                solved.report["samples"] = write_ensemble(motions, staging, said, settings.format, settings.rate)
            write(solved, staging)
            if settings.format is not None:
                for motion, prefix in ((solved.motion.clip, ""), (solved.motion.stride, "stride_")):
                    write_for_trainer(motion, settings.format, settings.rate, staging, prefix, said)
    return solved


def solve(
    animal: Animal,
    robot: Quadruped,
    scale: float | None = None,
    slower: float | None = None,
    lag: float = 0.0,
    window: StrideWindow | None = None,
) -> RetargetRun:
    """window: of the stride, by default the one that is found."""
    window = window or stride_window(animal)
    stride = closed_stride(animal, window)
    period = float(stride.time_s[-1])
    clip, stride = (with_other_side(reference, lag, period) for reference in (animal.reference, stride))
    motion = retarget(clip, stride, robot, scale, slower)
    report = _report(animal, window, clip, motion, lag, slower is None)
    return RetargetRun(animal, window, clip, motion, report)


# -- the report ------------------------------------------------------------------------------------------------------


def _report(
    animal: Animal, window: StrideWindow, clip: Reference, motion: Retargeted, lag: float, timed: bool
) -> dict[str, Any]:
    fitted, robot = animal.analysis.motion, motion.clip.robot
    mirrored = [foot for foot in LEGS if foot not in animal.reference.feet]
    doubts = [doubt_text(doubt) for doubt in (animal.analysis.gait.doubtful if animal.analysis.gait else ())]
    notes = _notes(window, motion, mirrored, lag, doubts)
    return {
        "schema": {"name": "recon.retarget", "version": 1},
        "verdict": verdict_fields(fitted),
        "robot": {
            "name": robot.name,
            "title": robot.title,
            "source": robot.source,
            "stand_m": robot.stand_m,
            "joints": {
                name: {"lower_rad": low, "upper_rad": high, "max_rate_rad_s": rate}
                for leg in robot.legs.values()
                for name, low, high, rate in zip(
                    leg.joints, leg.lower_rad, leg.upper_rad, leg.max_rate_rad_s, strict=True
                )
            },
        },
        "animal": {
            "results": fitted.file,
            "title": fitted.title,
            "leg_m": animal.reference.leg_m,
            "mirrored_feet": mirrored,
            "lag": lag if mirrored else None,
        },
        "scale": motion.clip.scale,
        "scale_found": motion.found,
        "hind_feet_out_m": motion.spread_m,
        "slower": motion.clip.slower,
        "slower_found": timed,
        "clip": _figures(motion.clip) | {"start_s": float(clip.time_s[0])},
        "stride": _figures(motion.stride)
        | {
            "how": window.how,
            "gap_percent": window.gap_percent,
            "closing_percent": motion.stride.closing_percent,
            "start_s": float(animal.reference.time_s[window.first]),
            "end_s": float(animal.reference.time_s[window.last]),
        },
        "notes": notes,
    }


def _figures(motion: RobotMotion) -> dict[str, Any]:
    way = motion.pose.translation[-1, :2] - motion.pose.translation[0, :2]
    duration = float(motion.time_s[-1])
    return {
        "duration_s": duration,
        "length_m": float(np.hypot(*way)),
        "speed_m_s": float(np.hypot(*way)) / duration,
        "slip_m": dict(zip(LEGS, motion.slip_m.tolist(), strict=True)),
        "standing_share": dict(zip(LEGS, motion.standing.mean(axis=0).tolist(), strict=True)),
        "out_of_reach_share": dict(zip(LEGS, motion.short.mean(axis=0).tolist(), strict=True)),
        "lowest_m": motion.lowest_m,
        "legs_apart_m": motion.apart_m,
        "least_margin_rad": dict(zip(motion.robot.joints, motion.margin_rad.tolist(), strict=True)),
        "rate_share": dict(zip(motion.robot.joints, motion.rate_share.tolist(), strict=True)),
    }


def _notes(window: StrideWindow, motion: Retargeted, mirrored: list[str], lag: float, doubts: list[str]) -> list[str]:
    notes = []
    if mirrored:
        how = "at the same time" if lag == 0 else f"{abs(lag):.2f} of a stride {'later' if lag > 0 else 'earlier'}"
        notes.append(f"{' and '.join(mirrored)} are not measured: they do what the other side does, {how}")
    notes += doubts
    if window.how == "return":
        notes.append(
            "the clip holds no complete stride: the one that repeats is made of the nearest return of all feet, "
            f"whose ends are {window.gap_percent:.0f} % of the feet's paths apart, closed"
        )
    for name, part in (("clip", motion.clip), ("stride", motion.stride)):
        if part.short.any():
            feet = ", ".join(label for label, short in zip(LEGS, part.short.T, strict=True) if short.any())
            share = 100 * part.short.any(axis=1).mean()
            notes.append(f"{name}: {feet} out of reach in {share:.0f} % of the time, drawn in")
        fast = [joint for joint, share in zip(part.robot.joints, part.rate_share, strict=True) if share > 1 + 1e-9]
        if fast:
            worst = part.rate_share.max()
            notes.append(f"{name}: faster than the limit, up to {worst:.1f} times: {', '.join(fast)}")
        if part.slip_m.max() > SLIP_M:
            notes.append(f"{name}: feet slip by up to {1000 * part.slip_m.max():.1f} mm in stance")
        if part.lowest_m < -1e-6:
            notes.append(f"{name}: {-1000 * part.lowest_m:.1f} mm under the ground")
    if motion.apart_m < LEGS_APART * motion.clip.robot.stand_m:
        near = [1000 * part.apart_m for part in (motion.clip, motion.stride)]
        notes.append(
            f"fore and hind leg of a side come within {near[0]:.0f} mm of each other in the clip, {near[1]:.0f} mm in "
            "the stride, measured between their lines"
        )
    if not motion.clip.standing.any(axis=0).all():
        feet = ", ".join(np.array(LEGS)[~motion.clip.standing.any(axis=0)])
        notes.append(f"no stance was found of {feet}")
    if motion.stride.closing_percent > CLOSING_PERCENT:
        notes.append(f"the stride closes to {motion.stride.closing_percent:.1f} % only")
    return notes


# -- what is written -------------------------------------------------------------------------------------------------


def write(solved: RetargetRun, folder: Path) -> None:
    """Everything, into a folder that there is."""
    from recon.robotics.robot.playback import write_robot

    write_tables(solved.motion.clip, folder, "")
    write_tables(solved.motion.stride, folder, "stride_")
    text = to_json(solved.report)
    (folder / REPORT).write_text(text, encoding="utf-8")
    write_robot(solved.motion.clip, folder / "motion.rrd", companion(solved))
    write_robot(repeated(solved.motion.stride, REPEATS), folder / "stride.rrd")


def write_tables(motion: RobotMotion, folder: Path, prefix: str) -> None:
    time = motion.time_s[:, None]
    joints = motion.robot.joints
    _table(
        folder / f"{prefix}joints.csv",
        ["time_s", *joints, *control_columns(joints)],
        *(time, motion.angles_rad, *motion.control),
    )
    columns = ["time_s", "x_m", "y_m", "z_m", "qx", "qy", "qz", "qw"]
    quaternions = motion.pose.rotation.as_quat(canonical=True)
    _table(folder / f"{prefix}base.csv", columns, time, motion.pose.translation, quaternions)
    columns = ["time_s", *(f"{label}_{axis}_m" for label in LEGS for axis in "xyz")]
    flat = motion.feet_m.reshape(len(time), -1)
    rows = [
        [*row, *stands]
        for row, stands in zip(np.hstack([time, flat]).tolist(), motion.standing.astype(int).tolist(), strict=True)
    ]
    write_rows(folder / f"{prefix}feet.csv", [[*columns, *(f"{label}_stands" for label in LEGS)]], rows)


def _table(path: Path, columns: list[str], *parts: Array) -> None:
    write_rows(path, [columns], np.hstack(parts).tolist())


def companion(solved: RetargetRun) -> Any:
    """The animal, of the robot's size, to the left of the robot, at the samples of the clip."""
    from recon.robotics.robot.playback import Companion

    animal, motion = solved.animal, solved.motion.clip
    fitted = animal.analysis.motion
    first = int(np.argmin(np.abs(animal.reference.time_s - solved.clip.time_s[0])))
    rows = animal.rows[first : first + len(motion.time_s)]
    points = np.stack([animal.analysis.joints[name].series.value[rows] for name in fitted.names], axis=1)
    hips = np.array([motion.points(label)[0, 0] for label in LEGS])
    beside = np.ptp(hips[:, 1]) + 2 * motion.robot.stand_m
    placed = motion.scale * animal.in_world(points) + [0.0, beside, 0.0]
    return Companion(placed, fitted.limbs, fitted.limb_sides, fitted.title)


def repeated(stride: RobotMotion, times: int) -> RobotMotion:
    """The stride again and again."""
    assert stride.advance_m is not None
    n = len(stride.time_s) - 1
    step, period = np.append(stride.advance_m, 0.0), stride.time_s[-1]
    at = np.arange(times * n + 1)
    turn, within = at // n, at % n
    ahead = turn[:, None] * step
    return replace(
        stride,
        time_s=stride.time_s[within] + turn * period,
        angles_rad=stride.angles_rad[within],
        pose=RigidTransform.from_components(stride.pose.translation[within] + ahead, stride.pose.rotation[within]),
        feet_m=stride.feet_m[within] + ahead[:, None],
        standing=stride.standing[within],
        short=stride.short[within],
        advance_m=times * stride.advance_m,
    )
