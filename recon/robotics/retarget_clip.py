"""Write the files of `recon retarget`: tables, report and playback of a robot's motion, and an ensemble of motions.

Every sample of an ensemble is a whole clip, drawn from the posterior (`recon.fit.posterior`) and put on the robot at
the scale and pace of the fitted motion. Each sample is a file in the layout of `--format`. All K samples together are
in `samples.npz`, which has the arrays `time_s` (N,), `base_position` (K, N, 3), `base_quaternion_wxyz` (K, N, 4),
`joint_positions` (K, N, joints) and `contacts` (K, N, 4), the names of joints and contacts, and `source`, the origin of
the motion with the verdict on the fit.

Programs that train policies read motions with velocities, at their own frame rate. Positions and velocities are both
computed from the states of the robot's tree and their derivatives (`RobotMotion.states`), so they agree exactly.

The bodies are the base, the links (named after the joints that move them, without "_joint") and the feet. A link's
frame is at its joint, and parallel to the base's frame when all angles are 0. In the world, z is up and the ground is
at 0. The frame rate is the rate nearest to the requested one that fits a whole number of frames into the duration. The
last frame of a stride equals its first frame, one stride later.

AMP's JSON has 61 numbers per frame, legs in the order RF, LF, RH, LH, quaternions xyzw, and velocities and toes in the
base's axes. The NPZ files of Isaac Lab and mjlab have quaternions wxyz and velocities in the world.

References
----------
A. Escontrela et al., Adversarial Motion Priors Make Good Substitutes for Complex Reward Functions, 2022 (AMP).
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from recon.api.clip_results import problem_of
from recon.base import files, outputs
from recon.base.arrays import Array
from recon.base.errors import InputError, Problem, collect_problems
from recon.base.locks import sole_writer
from recon.base.records import load_record, save_record
from recon.base.settings import input_paths
from recon.check.verdict import usable, verdict_fields
from recon.fit.motion import Motion
from recon.fit.result import TrajectorySolution
from recon.fit.sampling import draws
from recon.gait.gait import rejection_text
from recon.ik.drive import control_columns
from recon.io.writing import write_rows
from recon.robotics import physics
from recon.robotics.models import MjModel
from recon.robotics.quadruped import LEGS, Quadruped, builtin_robots, load_robot
from recon.robotics.retarget import LEGS_APART, KeptMotion, Retargeting, RobotMotion, reference_of, retarget
from recon.robotics.settings import RATE_HZ, RetargetSettings
from recon.show.plain import picked, to_json
from recon.show.plots.style import save

REPORT, STACKED = "report.json", "samples.npz"
STRIDE_REPEATS = 3
"""Number of strides in the playback of a stride."""
SLIP_M = 0.002
"""Maximum slip of a foot in a stance without a note in the report, metres."""


def run_retarget(settings: RetargetSettings) -> tuple[Retargeting, dict[str, Any]]:
    """Run `recon retarget`, and return the motions and the content of report.json.

    Tables, report and playback are written into `settings.out`.
    """
    out, folder = settings.out, settings.folder
    names = [f"{start}{table}.csv" for start in ("", "stride_") for table in ("joints", "base", "feet")]
    names += [REPORT, KEPT, "motion.rrd", "stride.rrd", files.MANIFEST]
    output = outputs.Output(
        out,
        "retarget",
        settings.overwrite,
        input_paths(settings),
        outputs.ReadResults.read(folder),
        has_manifest=True,
        mark=KEPT,
    )
    results, machine, _ = collect_problems(
        lambda: usable(Motion.load(folder), folder, settings.anyway),
        lambda: load_robot(settings.robot),
        lambda: output.require(names),
    )
    animal = reference_of(results, settings.stride)
    with sole_writer(out):
        output.require(names)
        done = retarget(animal, machine, settings.scale, settings.slower)
        model = physics.simulated(machine) if settings.check or settings.fit_limits else None
        earlier: dict[str, Any] = {}
        if settings.fit_limits:
            earlier = {"before": checked(done, model)}
            done, earlier["changed"] = within_limits(done, model)
        report: dict[str, Any] = report_of(done) | {
            "scale_found": settings.scale is None,
            "slower_found": settings.slower is None,
        }
        report["animal"]["results"] = files.relative_path(out, folder)
        report["robot"]["source"] = files.relative_name(out, machine.source)
        origin = {k: report[k] for k in ("verdict", "robot", "animal", "scale", "slower")}
        with output.staged() as staging:
            if settings.samples is not None:
                report["samples"] = _write_samples(done, settings, settings.samples, model, staging, origin)
            if model is not None:
                report["check"] = origin["check"] = checked(done, model, staging) | earlier
            _write(done, report, staging)
            keep(done.clip, done.stride, report["robot"]["source"], origin, staging / KEPT)
            if settings.format is not None:
                for motion, prefix in ((done.clip, ""), (done.stride, "stride_")):
                    path = staging / f"{prefix}{FORMATS[settings.format][0]}"
                    write_for_trainer(motion, settings.format, settings.rate, path, origin)
    return done, report


def _write_samples(
    done: Retargeting,
    settings: RetargetSettings,
    count: int,
    model: MjModel | None,
    folder: Path,
    origin: Mapping[str, Any],
) -> dict[str, Any]:
    """Write motions drawn from the posterior of the animal's motion, and return their entry in the report."""
    motions = drawn(done, settings, count, model if settings.fit_limits else None)
    entry = write_ensemble(motions, settings, folder, origin)
    if model is not None:
        entry["keep_every_rule"] = sum(physics.least_share(sample, model) == 1 for sample in motions)
    return entry


def within_limits(done: Retargeting, model: MjModel) -> tuple[Retargeting, dict[str, Any]]:
    """Change clip and stride until they keep every rule of `physics.RULES`, and return the motions and the change.

    The changes of duration and size in `physics.CHANGES` are tried one after the other, each with the base moved by
    `physics.carried`. The first change after which every rule is kept is used. If there is none, the change after which
    the rules are kept in most frames is used.
    """
    tried: list[tuple[float, Retargeting, Retargeting]] = []
    for slower, scale in physics.CHANGES:
        given_stride = done.stride
        unmoved = retarget(
            done.animal, given_stride.robot, scale * given_stride.scale, slower * given_stride.slower, done.window
        )
        moved = replace(unmoved, stride=physics.carried(unmoved.stride, model)[0])
        fraction = physics.least_share(moved.stride, model)
        if fraction == 1:
            moved = replace(moved, clip=physics.carried(unmoved.clip, model)[0])
            fraction += physics.least_share(moved.clip, model)
        tried.append((fraction, unmoved, moved))
        if fraction == 2:
            break
    _, unmoved, moved = max(tried, key=lambda trial: trial[0])
    if moved.clip is unmoved.clip:
        moved = replace(moved, clip=physics.carried(unmoved.clip, model)[0])
    clip, pairs = moved.clip, ((unmoved.clip, moved.clip), (unmoved.stride, moved.stride))
    changed = {name: getattr(clip, name) / getattr(done.clip, name) for name in ("slower", "scale")} | {
        "height": 1 + float((clip.position_m - unmoved.clip.position_m)[:, 2].mean()) / clip.robot.stand_m,
        "base_moved_m": max(float(np.linalg.norm(b.position_m - a.position_m, axis=1).max()) for a, b in pairs),
        "base_turned_rad": max(float((b.pose.rotation * a.pose.rotation.inv()).magnitude().max()) for a, b in pairs),
    }
    return moved, changed


def checked(done: Retargeting, model: MjModel, folder: Path | None = None) -> dict[str, Any]:
    """Check clip and stride with MuJoCo, and return the section of the report about the check.

    If a folder is given, tables and figures are written into it.
    """
    answers = {}
    for name, motion, prefix in (("clip", done.clip, ""), ("stride", done.stride, "stride_")):
        time, margins = physics.check(motion, model)
        answers[name] = physics.kept(margins)
        if folder is not None:
            _table(folder / f"{prefix}check.csv", ["time_s", *margins], np.column_stack([time, *margins.values()]))
            title = f"{motion.robot.title}, {name}"
            save(physics.margins_figure(time, margins, physics.RULES, title), folder, f"{prefix}check")
    return answers


def report_of(done: Retargeting) -> dict[str, Any]:
    """Return the content of report.json: robot, animal, clip, repeating stride and notes."""
    animal, window, robot = done.animal, done.window, done.clip.robot
    fitted, time = animal.analysis.motion, animal.reference.time_s
    limits = zip(robot.joints, *(numbers.tolist() for numbers in robot.limits()), strict=True)
    joints = {n: {"lower_rad": low, "upper_rad": up, "max_rate_rad_s": rate} for n, low, up, rate in limits}
    times_s = {"start_s": float(time[window.first]), "end_s": float(time[window.last])}
    stride = (
        {"how": window.source, "gap_percent": window.gap_percent}
        | {"closing_percent": done.stride.closing_percent}
        | times_s
    )
    return {
        "schema": {"name": "recon.retarget", "version": 1},
        "verdict": verdict_fields(fitted),
        "robot": picked(robot, "name", "title", "source", "stand_m") | {"joints": joints},
        "animal": {"results": fitted.file, "title": fitted.title, "leg_m": animal.reference.leg_m},
        "scale": done.clip.scale,
        "hind_feet_out_m": done.spread_m,
        "slower": done.clip.slower,
        "clip": _figures(done.clip) | {"start_s": float(time[0])},
        "stride": _figures(done.stride) | stride,
        "notes": _notes(done),
    }


def _figures(motion: RobotMotion) -> dict[str, Any]:
    way = motion.position_m[-1, :2] - motion.position_m[0, :2]
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
    notes = [rejection_text(stride) for stride in done.animal.gait.rejected_strides]
    if window.source == "return":
        notes.append(
            "the clip has no complete stride, so the repeating stride is the part after which the feet come closest to "
            f"where they started; its gap of {window.gap_percent:.0f} % of the feet's paths was closed"
        )
    parts = {"clip": done.clip, "stride": done.stride}
    for name, part in parts.items():
        if part.short.any():
            feet = ", ".join(label for label, short in zip(LEGS, part.short.T, strict=True) if short.any())
            fraction = 100 * part.short.any(axis=1).mean()
            notes.append(
                f"{name}: {feet} would be out of reach for {fraction:.0f} % of the time and were moved into reach; "
                "a smaller --scale avoids this"
            )
        fast = [
            joint for joint, fraction in zip(part.robot.joints, part.rate_share, strict=True) if fraction > 1 + 1e-9
        ]
        if fast:
            worst = part.rate_share.max()
            joints = ", ".join(fast)
            notes.append(
                f"{name}: {joints} move at up to {worst:.1f} times the rate limit; a larger --slower avoids this"
            )
        if part.slip_m.max() > SLIP_M:
            notes.append(f"{name}: feet slip by up to {1000 * part.slip_m.max():.1f} mm in stance")
    if min(part.apart_m for part in parts.values()) < LEGS_APART * done.clip.robot.stand_m:
        near = [1000 * part.apart_m for part in parts.values()]
        notes.append(
            f"fore and hind leg of a side come within {near[0]:.0f} mm of each other in the clip and {near[1]:.0f} mm "
            "in the stride, measured between the centre lines of their links"
        )
    stands = done.clip.standing.any(axis=0)
    if not stands.all():
        notes.append(f"no stance was found for {', '.join(np.array(LEGS)[~stands])}")
    return notes


def _write(done: Retargeting, report: dict[str, Any], folder: Path) -> None:
    from recon.robotics.playback import write_robot

    write_tables(done.clip, folder, "")
    write_tables(done.stride, folder, "stride_")
    (folder / REPORT).write_text(to_json(report), encoding="utf-8")
    write_robot(done.clip, folder / "motion.rrd", companion(done))
    write_robot(repeated(done.stride, STRIDE_REPEATS), folder / "stride.rrd")


def write_tables(motion: RobotMotion, folder: Path, prefix: str) -> None:
    """Write tables of joints, base and feet into an existing folder, with a prefix before their names."""
    time, joints = motion.time_s[:, None], motion.robot.joints
    names = ["time_s", *joints, *control_columns(joints)]
    states = (motion.states(motion.time_s, derivative)[:, 6:] for derivative in (1, 2))
    _table(folder / f"{prefix}joints.csv", names, time, motion.angles_rad, *states)
    names = ["time_s", "x_m", "y_m", "z_m", "qx", "qy", "qz", "qw"]
    quaternions = motion.pose.rotation.as_quat(canonical=True)
    _table(folder / f"{prefix}base.csv", names, time, motion.position_m, quaternions)
    names = ["time_s", *(f"{label}_{axis}_m" for label in LEGS for axis in "xyz"), *(f"{x}_stands" for x in LEGS)]
    positions = np.hstack([time, motion.feet_m.reshape(len(time), -1)]).tolist()
    stands = motion.standing.astype(int).tolist()
    write_rows(folder / f"{prefix}feet.csv", [names], [[*a, *b] for a, b in zip(positions, stands, strict=True)])


def _table(path: Path, columns: list[str], *parts: Array) -> None:
    write_rows(path, [columns], np.hstack(parts).tolist())


def companion(done: Retargeting) -> tuple[Array, Motion]:
    """Return the animal's points (N, J, 3), scaled to the robot and shifted to its left, and the animal's motion."""
    animal, motion = done.animal, done.clip
    fitted = animal.analysis.motion
    points = np.stack([animal.analysis.moved(name).series.value[animal.rows] for name in fitted.names], axis=1)
    hips = np.array([motion.points(label)[0, 0] for label in LEGS])
    offset_m = np.ptp(hips[:, 1]) + 2 * motion.robot.stand_m
    placed = motion.scale * (points - animal.origin_m) @ animal.rotation.as_matrix().T + [0.0, offset_m, 0.0]
    return placed, fitted


def repeated(stride: RobotMotion, times: int) -> RobotMotion:
    """Return a stride repeated `times` times."""
    assert stride.advance_m is not None
    n = len(stride.time_s) - 1
    step, period = np.append(stride.advance_m, 0.0), stride.time_s[-1]
    at = np.arange(times * n + 1)
    turn, sample = at // n, at % n
    ahead = turn[:, None] * step
    return replace(
        stride,
        time_s=stride.time_s[sample] + turn * period,
        angles_rad=stride.angles_rad[sample],
        position_m=stride.position_m[sample] + ahead,
        quaternion_xyzw=stride.quaternion_xyzw[sample],
        feet_m=stride.feet_m[sample] + ahead[:, None],
        standing=stride.standing[sample],
        short=stride.short[sample],
        advance_m=times * stride.advance_m,
    )


def drawn(done: Retargeting, settings: RetargetSettings, count: int, model: MjModel | None = None) -> list[RobotMotion]:
    """Draw clips from the posterior of the animal's motion, at the same scale and pace as the fitted motion.

    If MuJoCo's model of the robot is given, the clips have the stances of the fitted clip, and their bases are moved by
    `physics.carried`.

    Raises
    ------
    InputError
        If settings or a prior are missing or changed, or if the fit was made frame by frame.
    """
    fitted, robot = done.animal.analysis.motion, done.clip.robot
    problem = problem_of(fitted, settings.folder)
    assert isinstance(fitted.solution, TrajectorySolution)
    every = (replace(fitted, solution=item) for item in draws(problem, fitted.solution, count, 0))
    animals = (reference_of(item, settings.stride) for item in every)
    placement = robot, done.clip.scale, done.clip.slower, done.window
    if model is None:
        return [retarget(item, *placement).clip for item in animals]
    stands = done.animal.reference.standing
    standing_alike = (replace(item, reference=replace(item.reference, standing=stands)) for item in animals)
    return [physics.carried(retarget(item, *placement).clip, model, np.inf)[0] for item in standing_alike]


def write_ensemble(
    motions: list[RobotMotion], settings: RetargetSettings, out: Path, origin: Mapping[str, Any]
) -> dict[str, Any]:
    """Write the files of an ensemble into an existing folder, and return the spread of the samples.

    The spread holds medians over the clip of the standard deviations of the base's position (m, by axis) and of the
    joint angles (rad), for the report.
    """
    first = motions[0]
    positions = np.stack([motion.position_m for motion in motions])
    angles = np.stack([motion.angles_rad for motion in motions])
    np.savez(
        out / STACKED,
        time_s=first.time_s,
        base_position=positions,
        base_quaternion_wxyz=np.stack([motion.pose.rotation.as_quat(scalar_first=True) for motion in motions]),
        joint_positions=angles,
        joint_names=np.array(first.robot.joints),
        contacts=np.stack([motion.standing for motion in motions]),
        contact_names=np.array(LEGS),
        source=np.array(json.dumps(origin)),
    )
    if settings.format is not None:
        for number, motion in enumerate(motions, start=1):
            sample_origin = dict(origin) | {"sample": number}
            path = out / f"sample_{number:02d}_{FORMATS[settings.format][0]}"
            write_for_trainer(motion, settings.format, settings.rate, path, sample_origin)
    base, joint = (np.median(values.std(axis=0), axis=0).tolist() for values in (positions, angles))
    return {
        "count": len(motions),
        "base_sigma_m": dict(zip("xyz", base, strict=True)),
        "joint_sigma_rad": dict(zip(first.robot.joints, joint, strict=True)),
    }


KEPT, SCHEMA, OLDER_VERSIONS = "robot.npz", {"name": "recon.robot", "version": 2}, (1,)
AMP_LEGS = ("RF", "LF", "RH", "LH")
AMP_JOINTS = 3
"""Number of joints of a leg in AMP's layout."""
STEP_S = 1e-6
"""Time between two positions whose difference gives a velocity, seconds.

The positions lie on a tangent, so the velocity is exact to round-off.
"""


class RobotSamples:
    """A motion sampled at the rate nearest to `rate_hz` that gives a whole number of frames.

    Arrays hold K evenly spaced frames, the robot's joints in the robot's order, and B bodies, the base first.

    Raises
    ------
    InputError
        If the motion is too short for two frames at this rate. The message names `option`.
    """

    def __init__(self, motion: RobotMotion, rate_hz: float, option: str = "--rate") -> None:
        duration = float(motion.time_s[-1] - motion.time_s[0])
        frames = round(duration * rate_hz)
        if frames < 1:
            expected = (
                f"at least {1 / duration:.1f} frames per second, so that the motion of {duration:.2f} s has two frames"
            )
            raise InputError(Problem(option, "frame rate", f"{rate_hz:g} frames per second", expected))
        self.robot, self.loops, self.rate_hz = motion.robot, motion.advance_m is not None, frames / duration
        self.time_s = np.linspace(0.0, duration, frames + 1)
        at, tree = motion.time_s[0] + self.time_s, motion.robot.tree
        self.bodies, self.feet = _bodies(motion.robot)
        states, changes = (motion.states(at, order) for order in (0, 1))
        self.angles_rad, self.rates_rad_s = states[:, 6:], changes[:, 6:]
        self.feet_stand = motion.stands_at(at)  # (K, 4), in the order of `LEGS`
        straight = tree.orientations(np.zeros((1, tree.n_state)))[0].transpose(0, 2, 1)
        segment = [[s.name for s in tree.segments].index(marker.segment) for marker in tree.markers]
        # Step along the tangent, so that the velocities of joints and of bodies agree.
        present, previous, following = (states + step * changes for step in (0.0, -STEP_S, STEP_S))
        (self.position_m, p, q), (turned, A, B) = (  # (K, B, 3)
            [pose_of(s) for s in (present, previous, following)]
            for pose_of in (lambda s: tree.pose(s).points_m, tree.orientations)
        )
        spin = np.einsum("ksij,kslj->ksil", B - A, turned) / (2 * STEP_S)
        self.turned = (turned @ straight)[:, segment]  # (K, B, 3, 3), T_world_body
        self.velocity_m_s = (q - p) / (2 * STEP_S)
        self.angular_velocity_rad_s = spin[:, segment][..., [2, 0, 1], [1, 2, 0]]

    @property
    def quaternions(self) -> Array:
        """Return the bodies' quaternions xyzw, shape (K, B, 4), with signs that make them continuous in time."""
        flat = Rotation.from_matrix(self.turned.reshape(-1, 3, 3)).as_quat(canonical=True)
        quaternions = flat.reshape(len(self.time_s), len(self.bodies), 4)
        flips = np.sign(np.sum(quaternions[1:] * quaternions[:-1], axis=2))
        quaternions[1:] *= np.cumprod(np.where(flips < 0, -1.0, 1.0), axis=0)[..., None]
        return quaternions


def _bodies(robot: Quadruped) -> tuple[list[str], list[int]]:
    """Return the names of all bodies, and the indices of the feet in the order of `LEGS`.

    A foot is named FL_foot if the names of its leg's joints start with FL_.
    """
    names, feet = ["base"], []
    for label, leg in robot.legs.items():
        head = leg.joints[0].split("_")[0]
        has_common_head = all(name.startswith(f"{head}_") for name in leg.joints)
        feet.append(len(names) + len(leg.joints))
        names += [*(name.removesuffix("_joint") for name in leg.joints), f"{head if has_common_head else label}_foot"]
    return names, feet


def _amp(samples: RobotSamples, path: Path, origin: Mapping[str, Any]) -> None:
    robot = samples.robot
    if any(len(leg.joints) != AMP_JOINTS for leg in robot.legs.values()):
        robot_text = f"a robot with {AMP_JOINTS} joints per leg, {AMP_JOINTS * len(robot.legs)} in all"
        expected = f"{robot_text}, or another --format"
        raise InputError(Problem(robot.name, "format amp", f"{len(robot.joints)} joints", expected))
    order = [joint for label in AMP_LEGS for joint in robot.legs[label].joints]
    columns = [robot.joints.index(joint) for joint in order]
    feet = [samples.feet[LEGS.index(label)] for label in AMP_LEGS]
    v, w = samples.velocity_m_s[:, :1], samples.angular_velocity_rad_s[:, :1]
    arms = samples.position_m[:, feet] - samples.position_m[:, :1]
    relative = samples.velocity_m_s[:, feet] - v - np.cross(w, arms)

    def in_base(vectors: Array) -> Array:
        return np.einsum("kbc,kcd->kbd", vectors, samples.turned[:, 0]).reshape(len(vectors), -1)

    angles, rates = samples.angles_rad[:, columns], samples.rates_rad_s[:, columns]
    parts = [samples.position_m[:, 0], samples.quaternions[:, 0], angles, in_base(arms), in_base(v), in_base(w), rates]
    text = {
        "LoopMode": "Wrap" if samples.loops else "Clamp",
        "FrameDuration": 1 / samples.rate_hz,
        "EnableCycleOffsetPosition": True,
        "EnableCycleOffsetRotation": True,
        "MotionWeight": 1.0,
        "JointNames": order,
        "FootNames": [samples.bodies[k] for k in feet],
        "Contacts": samples.feet_stand[:, [LEGS.index(label) for label in AMP_LEGS]].astype(int).tolist(),
        "Source": dict(origin),
        "Frames": np.concatenate([*parts, in_base(relative)], axis=1).tolist(),
    }
    path.write_text(json.dumps(text, indent=None) + "\n", encoding="utf-8")


_NPZ = {
    "isaaclab": (
        "dof_names",
        "dof_positions",
        "dof_velocities",
        "body_positions",
        "body_rotations",
        "body_linear_velocities",
        "body_angular_velocities",
    ),
    "mjlab": (
        "joint_names",
        "joint_pos",
        "joint_vel",
        "body_pos_w",
        "body_quat_w",
        "body_lin_vel_w",
        "body_ang_vel_w",
    ),
}
"""Names of the arrays in the NPZ files of Isaac Lab and mjlab.

The order is: joint names, joint angles, joint rates, then the bodies' positions, quaternions, velocities and angular
velocities.
"""


def _npz(layout: str, samples: RobotSamples, path: Path, origin: Mapping[str, Any]) -> None:
    arrays = (
        np.array(samples.robot.joints),
        samples.angles_rad,
        samples.rates_rad_s,
        samples.position_m,
        samples.quaternions[..., [3, 0, 1, 2]],
        samples.velocity_m_s,
        samples.angular_velocity_rad_s,
    )
    named: dict[str, Any] = dict(zip(_NPZ[layout], arrays, strict=True))
    np.savez(
        path,
        fps=np.array(samples.rate_hz),
        body_names=np.array(samples.bodies),
        contacts=samples.feet_stand,
        contact_names=np.array([samples.bodies[k] for k in samples.feet]),
        source=np.array(json.dumps(origin)),
        **named,
    )


def _mjlab_csv(samples: RobotSamples, path: Path, origin: Mapping[str, Any]) -> None:
    """Write a table without a header, in the columns that mjlab expects: x y z, qx qy qz qw, joints.

    A JSON file of the same name describes the table.
    """
    table = np.concatenate([samples.position_m[:, 0], samples.quaternions[:, 0], samples.angles_rad], axis=1)
    np.savetxt(path, table, delimiter=",", fmt="%.17g")
    description = {"fps": samples.rate_hz, "joint_names": samples.robot.joints, "source": dict(origin)}
    path.with_suffix(".json").write_text(json.dumps(description) + "\n", encoding="utf-8")


FORMATS: dict[str, tuple[str, Callable[[RobotSamples, Path, Mapping[str, Any]], None]]] = {
    "amp": ("amp.json", _amp),
    "isaaclab": ("isaaclab.npz", partial(_npz, "isaaclab")),
    "mjlab": ("mjlab.npz", partial(_npz, "mjlab")),
    "mjlab-csv": ("mjlab.csv", _mjlab_csv),
}
"""File name and writing function of each file format for programs that train policies."""


def write_for_trainer(
    motion: RobotMotion, name: str, rate_hz: float, path: Path, origin: Mapping[str, Any], option: str = "--rate"
) -> float:
    """Write a file in one of `FORMATS`, and return the file's frame rate.

    The file states the origin of the motion. `name` is the format's name, and `option` the option that an error message
    names.

    Raises
    ------
    InputError
        If the motion is too short for two frames at this rate, or if the format cannot hold the robot.
    """
    samples = RobotSamples(motion, rate_hz, option)
    FORMATS[name][1](samples, path, origin)
    return samples.rate_hz


@dataclass(frozen=True, eq=False)
class _Kept:
    robot: str
    """Name of the robot, or path of its file relative to the folder."""
    said: Mapping[str, Any]
    clip: KeptMotion
    stride: KeptMotion


def keep(clip: RobotMotion, stride: RobotMotion, robot: str, origin: Mapping[str, Any], path: Path) -> None:
    """Write clip and repeating stride unchanged, so that `convert` can later write any of `FORMATS` at any rate."""
    names = [field.name for field in fields(KeptMotion)]
    save_record(
        _Kept(robot, origin, *(KeptMotion(**picked(motion, *names)) for motion in (clip, stride))), path, SCHEMA
    )


def kept_motions(path: Path) -> tuple[RobotMotion, RobotMotion, Mapping[str, Any]]:
    """Read the clip, the stride and their origin from a file that `keep` wrote.

    Raises
    ------
    InputError
        If the file cannot be used.
    """
    expected = "motions of a robot, written by `recon retarget`"
    arrays = load_record(_Kept, path, SCHEMA, expected, older_versions=OLDER_VERSIONS)
    named = arrays.robot if arrays.robot in builtin_robots() else str(path.parent / arrays.robot)
    robot = load_robot(named)

    joints = len(robot.joints)

    def restored(kept: KeptMotion) -> RobotMotion:
        n = len(kept.time_s)
        shapes = {"time_s": (n,), "angles_rad": (n, joints), "position_m": (n, 3), "quaternion_xyzw": (n, 4)}
        shapes |= {"feet_m": (n, 4, 3), "standing": (n, 4), "short": (n, 4)}
        shapes |= {} if kept.advance_m is None else {"advance_m": (2,)}
        for name, shape in shapes.items():
            values: Array = getattr(kept, name)
            if values.shape != shape or not np.isfinite(values).all():
                expected = f"finite numbers in the shape {shape}, for the {joints} joints of {named}"
                raise InputError(Problem(path, name, f"numbers in the shape {values.shape}", expected))
        if n < 2 or not (np.diff(kept.time_s) > 0).all() or not kept.quaternion_xyzw.any(axis=1).all():
            raise InputError(Problem(path, "content", "no motion", "increasing times, and rotations"))
        return RobotMotion(**vars(kept), robot=robot)

    return restored(arrays.clip), restored(arrays.stride), arrays.said


def convert(folder: Path, out: Path, name: str, rate_hz: float | None, output: outputs.Output) -> str:
    """Convert the motions in a folder of `recon retarget` to another format, and return a sentence about the files.

    The clip is written to `out`, and the repeating stride to a file next to it. Either both files are written or
    neither. `name` is one of `FORMATS`.
    """
    stride = out.with_name(f"stride_{out.name}")
    names = out.name, stride.name
    (*motions, origin), _ = collect_problems(lambda: kept_motions(folder / KEPT), lambda: output.require(names))
    with output.staged(adds=True) as staging:
        rates = [
            write_for_trainer(motion, name, rate_hz or RATE_HZ, staging / path.name, origin, "--fps")
            for motion, path in zip(motions, (out, stride), strict=True)
        ]
    hz = " and ".join(f"{rate:.4g}" for rate in rates)
    return f"{out}: {name}, {motions[0].robot.title}, {hz} frames per second; a stride that repeats is in {stride}"
