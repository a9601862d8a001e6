"""A reconstruction on a quadruped robot: joint angles, base, footholds, report, playback, and an ensemble.

Every draw of an ensemble is a whole clip from the posterior (`recon.fit.posterior`), put on the robot at the scale
and the pace of the fit's own motion. One file each in the layout of `--format`, and all of them stacked in
`samples.npz`: `time_s` (N,), of K draws `base_position` (K, N, 3), `base_quaternion_wxyz` (K, N, 4), `joint_positions`
(K, N, joints) and `contacts` (K, N, 4), the names, and what the fit's verdict is.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import RigidTransform

from recon.base.arrays import Array
from recon.base.errors import all_of
from recon.base.files import name_seen_from, require_free_folder, seen_from, sole_writer, staged_results
from recon.check import usable, verdict_fields
from recon.fit.motion import Motion
from recon.fit.result import TrajectorySolution
from recon.fit.sampling import draws
from recon.gait.gait import doubtful_text
from recon.io.writing import write_rows
from recon.show.plots.style import save
from recon.show.report import to_json
from recon.wings.robotics.ik.drive import control_columns
from recon.wings.robotics.robot import physics
from recon.wings.robotics.robot.quadruped import LEGS
from recon.wings.robotics.robot.reference import reference_of
from recon.wings.robotics.robot.retarget import LEGS_APART, Retargeting, RobotMotion, retarget
from recon.wings.robotics.robot.robot_file import load_robot
from recon.wings.robotics.robot.trainers import FORMATS, KEPT, keep, write_for_trainer
from recon.wings.robotics.settings import RetargetSettings
from recon.workflows.clip_results import problem_of

REPORT, STACKED = "report.json", "samples.npz"
REPEATS = 3
"""How often the stride is repeated in its playback."""
SLIP_M = 0.002
"""What a robot's stance is allowed without a note."""


def run_retarget(settings: RetargetSettings) -> tuple[Retargeting, dict[str, Any]]:
    """`recon retarget`: tables, report and playback into a folder; and what report.json says. Raises InputError."""
    out, folder = settings.out, settings.folder
    results, machine, _ = all_of(
        lambda: usable(Motion.load(folder), folder, settings.anyway),
        lambda: load_robot(settings.robot),
        lambda: require_free_folder(out, (REPORT,), settings.overwrite),
    )
    animal = reference_of(results, settings.stride)
    with sole_writer(out):
        require_free_folder(out, (REPORT,), settings.overwrite)
        done = retarget(animal, machine, settings.scale, settings.slower)
        model = physics.simulated(machine) if settings.check or settings.fit_limits else None
        before: dict[str, Any] = {}
        if settings.fit_limits:
            before = {"before": checked(done, model)}
            done, before["changed"] = within_limits(done, model)
        report: dict[str, Any] = report_of(done) | {
            "scale_found": settings.scale is None,
            "slower_found": settings.slower is None,
        }
        report["animal"]["results"] = seen_from(out, folder)
        report["robot"]["source"] = name_seen_from(out, machine.source)
        said = {k: report[k] for k in ("verdict", "robot", "animal", "scale", "slower")}
        with staged_results(out) as staging:
            if settings.samples is not None:
                motions = drawn(done, settings, settings.samples, model if settings.fit_limits else None)
                report["samples"] = write_ensemble(motions, settings, staging, said)
                if model is not None:
                    report["samples"]["keep_every_rule"] = sum(_least_share(one, model) == 1 for one in motions)
            if model is not None:
                report["check"] = checked(done, model, staging) | before
            _write(done, report, staging)
            keep(done.clip, done.stride, report["robot"]["source"], said, staging / KEPT)
            if settings.format is not None:
                for motion, prefix in ((done.clip, ""), (done.stride, "stride_")):
                    path = staging / f"{prefix}{FORMATS[settings.format][0]}"
                    write_for_trainer(motion, settings.format, settings.rate, path, said)
    return done, report


def within_limits(done: Retargeting, model: Any) -> tuple[Retargeting, dict[str, Any]]:
    """The first of `physics.CHANGES` with which clip and stride, their bases moved, keep every rule, and what it is;
    where none does, the one that keeps most."""
    tried: list[tuple[float, Retargeting, RobotMotion, RobotMotion | None]] = []
    for slower, scale in physics.CHANGES:
        own = done.stride
        again = retarget(done.animal, own.robot, scale * own.scale, slower * own.slower, done.window)
        stride, clip = physics.carried(again.stride, model)[0], None
        share = _least_share(stride, model)
        if share == 1:
            clip = physics.carried(again.clip, model)[0]
            share += _least_share(clip, model)
        tried.append((share, again, stride, clip))
        if share == 2:
            break
    _, again, stride, clip = max(tried, key=lambda one: one[0])
    clip = clip or physics.carried(again.clip, model)[0]
    pairs = ((again.clip.pose, clip.pose), (again.stride.pose, stride.pose))
    ups = clip.pose.translation[:, 2] - again.clip.pose.translation[:, 2]
    changed = {name: getattr(clip, name) / getattr(done.clip, name) for name in ("slower", "scale")} | {
        "height": 1 + float(ups.mean()) / clip.robot.stand_m,
        "base_moved_m": max(float(np.linalg.norm(b.translation - a.translation, axis=1).max()) for a, b in pairs),
        "base_turned_rad": max(float((b.rotation * a.rotation.inv()).magnitude().max()) for a, b in pairs),
    }
    return replace(again, clip=clip, stride=stride), changed


def _least_share(motion: RobotMotion, model: Any) -> float:
    """The least share of frames that keep a rule."""
    return min(rule["share"] for rule in physics.kept(physics.check(motion, model)[1]).values())


def checked(done: Retargeting, model: Any, folder: Path | None = None) -> dict[str, Any]:
    """What MuJoCo says of clip and stride, for the report; folder: where tables and figures go."""
    found = {}
    for name, motion, prefix in (("clip", done.clip, ""), ("stride", done.stride, "stride_")):
        time, margins = physics.check(motion, model)
        found[name] = physics.kept(margins)
        if folder is not None:
            _table(folder / f"{prefix}check.csv", ["time_s", *margins], np.column_stack([time, *margins.values()]))
            shown = {rule.what: (margins[one], rule.least, rule.unit) for one, rule in physics.RULES.items()}
            save(physics.margins_figure(time, shown, f"{motion.robot.title}, {name}"), folder, f"{prefix}check")
    return found


# -- the report ------------------------------------------------------------------------------------------------------


def report_of(done: Retargeting) -> dict[str, Any]:
    """What report.json says of it."""
    animal, window, robot = done.animal, done.window, done.clip.robot
    fitted, time = animal.analysis.motion, animal.reference.time_s
    limits = zip(robot.joints, *(numbers.tolist() for numbers in robot.limits()), strict=True)
    stride = {
        "how": window.how,
        "gap_percent": window.gap_percent,
        "closing_percent": done.stride.closing_percent,
        "start_s": float(time[window.first]),
        "end_s": float(time[window.last]),
    }
    return {
        "schema": {"name": "recon.retarget", "version": 1},
        "verdict": verdict_fields(fitted),
        "robot": {
            "name": robot.name,
            "title": robot.title,
            "source": robot.source,
            "stand_m": robot.stand_m,
            "joints": {n: {"lower_rad": low, "upper_rad": up, "max_rate_rad_s": rate} for n, low, up, rate in limits},
        },
        "animal": {
            "results": fitted.file,
            "title": fitted.title,
            "leg_m": animal.reference.leg_m,
        },
        "scale": done.clip.scale,
        "hind_feet_out_m": done.spread_m,
        "slower": done.clip.slower,
        "clip": _figures(done.clip) | {"start_s": float(time[0])},
        "stride": _figures(done.stride) | stride,
        "notes": _notes(done),
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
        "legs_apart_m": motion.apart_m,
        "least_margin_rad": dict(zip(motion.robot.joints, motion.margin_rad.tolist(), strict=True)),
        "rate_share": dict(zip(motion.robot.joints, motion.rate_share.tolist(), strict=True)),
    }


def _notes(done: Retargeting) -> list[str]:
    window = done.window
    notes = [doubtful_text(doubt) for doubt in done.animal.gait.doubtful]
    if window.how == "return":
        notes.append(
            "the clip holds no complete stride: the one that repeats is made of the nearest return of all feet, "
            f"whose ends are {window.gap_percent:.0f} % of the feet's paths apart, closed"
        )
    parts = {"clip": done.clip, "stride": done.stride}
    for name, part in parts.items():
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
    if min(part.apart_m for part in parts.values()) < LEGS_APART * done.clip.robot.stand_m:
        near = [1000 * part.apart_m for part in parts.values()]
        notes.append(
            f"fore and hind leg of a side come within {near[0]:.0f} mm of each other in the clip, {near[1]:.0f} mm in "
            "the stride, measured between their lines"
        )
    stands = done.clip.standing.any(axis=0)
    if not stands.all():
        notes.append(f"no stance was found of {', '.join(np.array(LEGS)[~stands])}")
    return notes


# -- what is written -------------------------------------------------------------------------------------------------


def _write(done: Retargeting, report: dict[str, Any], folder: Path) -> None:
    from recon.wings.robotics.robot.playback import write_robot

    write_tables(done.clip, folder, "")
    write_tables(done.stride, folder, "stride_")
    (folder / REPORT).write_text(to_json(report), encoding="utf-8")
    write_robot(done.clip, folder / "motion.rrd", companion(done))
    write_robot(repeated(done.stride, REPEATS), folder / "stride.rrd")


def write_tables(motion: RobotMotion, folder: Path, prefix: str) -> None:
    """Joints, base and feet, into a folder that there is."""
    time, joints = motion.time_s[:, None], motion.robot.joints
    names = ["time_s", *joints, *control_columns(joints)]
    states = (motion.states(motion.time_s, derivative)[:, 6:] for derivative in (1, 2))
    _table(folder / f"{prefix}joints.csv", names, time, motion.angles_rad, *states)
    names = ["time_s", "x_m", "y_m", "z_m", "qx", "qy", "qz", "qw"]
    quaternions = motion.pose.rotation.as_quat(canonical=True)
    _table(folder / f"{prefix}base.csv", names, time, motion.pose.translation, quaternions)
    names = ["time_s", *(f"{label}_{axis}_m" for label in LEGS for axis in "xyz"), *(f"{x}_stands" for x in LEGS)]
    places = np.hstack([time, motion.feet_m.reshape(len(time), -1)]).tolist()
    stands = motion.standing.astype(int).tolist()
    write_rows(folder / f"{prefix}feet.csv", [names], [[*a, *b] for a, b in zip(places, stands, strict=True)])


def _table(path: Path, columns: list[str], *parts: Array) -> None:
    write_rows(path, [columns], np.hstack(parts).tolist())


def companion(done: Retargeting) -> Any:
    """The animal, of the robot's size, to the left of the robot, at the samples of the clip."""
    from recon.wings.robotics.robot.playback import Companion

    animal, motion = done.animal, done.clip
    fitted = animal.analysis.motion
    points = np.stack([animal.analysis.moved(name).series.value[animal.rows] for name in fitted.names], axis=1)
    hips = np.array([motion.points(label)[0, 0] for label in LEGS])
    beside = np.ptp(hips[:, 1]) + 2 * motion.robot.stand_m
    placed = motion.scale * (points - animal.origin_m) @ animal.rotation.as_matrix().T + [0.0, beside, 0.0]
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


# -- an ensemble of what the animal's motion may have been ------------------------------------------------------------


def drawn(own: Retargeting, settings: RetargetSettings, count: int, model: Any = None) -> list[RobotMotion]:
    """Clips as the animal's may have been, at the same scale and pace. With MuJoCo's model of the robot, stances are
    those of the clip, and bases are moved as `physics.carried` does. Raises InputError as `problem_of`."""
    fitted, robot = own.animal.analysis.motion, own.clip.robot
    problem = problem_of(fitted, settings.folder)
    assert isinstance(fitted.solution, TrajectorySolution)
    every = (replace(fitted, solution=one) for one in draws(problem, fitted.solution, count, 0))
    animals = (reference_of(one, settings.stride) for one in every)
    given = robot, own.clip.scale, own.clip.slower, own.window
    if model is None:
        return [retarget(one, *given).clip for one in animals]
    stands = own.animal.reference.standing
    alike = (replace(one, reference=replace(one.reference, standing=stands)) for one in animals)
    return [physics.carried(retarget(one, *given).clip, model, np.inf)[0] for one in alike]


def write_ensemble(
    motions: list[RobotMotion], settings: RetargetSettings, out: Path, said: Mapping[str, Any]
) -> dict[str, Any]:
    """The files, into a folder that there is, and how far the draws lie apart, for the report: standard deviations of
    the base's place (m, by axis) and of the joints' angles (rad), medians over the clip."""
    first = motions[0]
    places = np.stack([motion.pose.translation for motion in motions])
    angles = np.stack([motion.angles_rad for motion in motions])
    np.savez(
        out / STACKED,
        time_s=first.time_s,
        base_position=places,
        base_quaternion_wxyz=np.stack([one.pose.rotation.as_quat(scalar_first=True) for one in motions]),
        joint_positions=angles,
        joint_names=np.array(first.robot.joints),
        contacts=np.stack([one.standing for one in motions]),
        contact_names=np.array(LEGS),
        source=np.array(json.dumps(said)),
    )
    if settings.format is not None:
        for number, motion in enumerate(motions, start=1):
            own = dict(said) | {"sample": number}
            path = out / f"sample_{number:02d}_{FORMATS[settings.format][0]}"
            write_for_trainer(motion, settings.format, settings.rate, path, own)
    base, joint = (np.median(values.std(axis=0), axis=0).tolist() for values in (places, angles))
    return {
        "count": len(motions),
        "base_sigma_m": dict(zip("xyz", base, strict=True)),
        "joint_sigma_rad": dict(zip(first.robot.joints, joint, strict=True)),
    }
