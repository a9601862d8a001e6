"""A robot's reference motion as programs that train policies read it: sampled at a rate of one's own, with velocities.

Everything that is written is worked out from the states of the robot's tree and from their derivatives
(`RobotMotion.states`), so that velocities belong to what is written exactly.

Bodies are the base, the links, called as the joint that moves them (without "_joint"), and the feet; a link's frame is
at its joint, and turned as the base where all angles are 0. World: z up, the ground at 0. Frames last exactly a share
of the whole, the rate being the nearest to the one asked for; the last frame of a stride is its first, a stride on.

Layouts: AMP's JSON is that of A. Escontrela et al., Adversarial Motion Priors Make Good Substitutes for Complex Reward
Functions, 2022: 61 numbers a frame, legs in the order RF, LF, RH, LH, quaternions xyzw, velocities and toes in the
base's axes. Isaac Lab's NPZ and mjlab's have quaternions wxyz and velocities in the world.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from recon.base.arrays import Array, Bools
from recon.base.errors import InputError, Problem, all_of
from recon.base.files import require_free_file, staged_folder
from recon.base.records import load_record, save_record
from recon.wings.robotics.robot.quadruped import LEGS, Quadruped, RobotLeg
from recon.wings.robotics.robot.retarget import RobotMotion
from recon.wings.robotics.robot.robot_file import builtin_robots, load_robot
from recon.wings.robotics.settings import RATE_HZ

KEPT, SCHEMA = "robot.npz", {"name": "recon.robot", "version": 1}
_OPTIONS = {"--rate": "--fps", "--format": "--to"}
"""What options of `recon retarget` are called by `recon convert`."""
AMP_LEGS = ("RF", "LF", "RH", "LH")
AMP_JOINTS = 3
"""The joints of a leg, in the layout."""
STEP_S = 1e-6
"""Between the places whose difference is a velocity; they are on a tangent, so that it is exact to round-off."""


@dataclass(frozen=True, eq=False)
class _RobotSamples:
    """K frames, evenly spaced; the robot's joints in its own order; B bodies."""

    robot: Quadruped
    loops: bool
    rate_hz: float
    time_s: Array
    """The times of the K samples, shape (K,)."""
    angles_rad: Array
    """The joint angles, shape (K, joints)."""
    rates_rad_s: Array
    """The joint rates, shape (K, joints)."""
    bodies: tuple[str, ...]
    """The names of the B bodies, the base first."""
    position_m: Array
    """The positions of the bodies, shape (K, B, 3)."""
    turned: Array
    """(K, B, 3, 3): T_world_body."""
    velocity_m_s: Array
    """The velocities of the bodies, shape (K, B, 3)."""
    angular_velocity_rad_s: Array
    """(K, B, 3), in the world."""
    feet_stand: Bools
    """(K, 4), in the order of `LEGS`."""

    @property
    def quaternions(self) -> Array:
        """(K, B, 4), xyzw, each near to the one before it."""
        flat = Rotation.from_matrix(self.turned.reshape(-1, 3, 3)).as_quat(canonical=True)
        found = flat.reshape(len(self.time_s), len(self.bodies), 4)
        flips = np.sign(np.sum(found[1:] * found[:-1], axis=2))
        found[1:] *= np.cumprod(np.where(flips < 0, -1.0, 1.0), axis=0)[..., None]
        return found

    def foot(self, label: str) -> int:
        """Its place among the bodies."""
        return self.bodies.index(_foot_name(self.robot.legs[label], label))


def sampled(motion: RobotMotion, rate_hz: float) -> _RobotSamples:
    """A motion at the rate nearest to rate_hz of which a whole number of frames fits. Raises InputError where fewer
    than two do."""
    duration = float(motion.time_s[-1] - motion.time_s[0])
    frames = round(duration * rate_hz)
    if frames < 1:
        expected = f"at least {1 / duration:.1f}, two frames of its {duration:.2f} s"
        raise InputError(Problem("--rate", "frames a second", f"{rate_hz:g}", expected))
    time_s = np.linspace(0.0, duration, frames + 1)
    at = motion.time_s[0] + time_s
    states, changes = (motion.states(at, order) for order in (0, 1))
    tree = motion.robot.tree
    straight = tree.orientations(np.zeros((1, tree.n_state)))[0].transpose(0, 2, 1)
    segment = [[s.name for s in tree.segments].index(marker.segment) for marker in tree.markers]
    # Along the tangent, so that what is written of the joints and what is written of the bodies belong together.
    here, before, after = (states + step * changes for step in (0.0, -STEP_S, STEP_S))
    (position_m, p, q), (turned, A, B) = (
        [of(s) for s in (here, before, after)] for of in (lambda s: tree.pose(s).points_m, tree.orientations)
    )
    spin = np.einsum("ksij,kslj->ksil", B - A, turned) / (2 * STEP_S)
    return _RobotSamples(
        robot=motion.robot,
        loops=motion.advance_m is not None,
        rate_hz=frames / duration,
        time_s=time_s,
        angles_rad=states[:, 6:],
        rates_rad_s=changes[:, 6:],
        bodies=_body_names(motion.robot),
        position_m=position_m,
        turned=(turned @ straight)[:, segment],
        velocity_m_s=(q - p) / (2 * STEP_S),
        angular_velocity_rad_s=spin[:, segment][..., [2, 0, 1], [1, 2, 0]],
        feet_stand=motion.stands_at(at),
    )


def _body_names(robot: Quadruped) -> tuple[str, ...]:
    names = ["base"]
    for label, leg in robot.legs.items():
        names += [*(name.removesuffix("_joint") for name in leg.joints), _foot_name(leg, label)]
    return tuple(names)


def _foot_name(leg: RobotLeg, label: str) -> str:
    """As FL_foot, of joints that are called FL_hip_joint and so on."""
    head, *rest = leg.joints[0].split("_")
    return f"{head}_foot" if rest and all(name.split("_")[0] == head for name in leg.joints) else f"{label}_foot"


# -- files -----------------------------------------------------------------------------------------------------------


def _amp(found: _RobotSamples, path: Path, said: Mapping[str, Any]) -> None:
    robot = found.robot
    if any(len(leg.joints) != AMP_JOINTS for leg in robot.legs.values()):
        expected = f"a robot with {AMP_JOINTS} joints a leg, or another format"
        raise InputError(Problem("--format", "amp", f"{len(robot.joints)} joints", expected))
    order = [joint for label in AMP_LEGS for joint in robot.legs[label].joints]
    columns = [robot.joints.index(joint) for joint in order]
    feet = [found.foot(label) for label in AMP_LEGS]
    v, w = found.velocity_m_s[:, :1], found.angular_velocity_rad_s[:, :1]
    arms = found.position_m[:, feet] - found.position_m[:, :1]
    relative = found.velocity_m_s[:, feet] - v - np.cross(w, arms)

    def in_base(vectors: Array) -> Array:
        return np.einsum("kbc,kcd->kbd", vectors, found.turned[:, 0]).reshape(len(vectors), -1)

    angles, rates = found.angles_rad[:, columns], found.rates_rad_s[:, columns]
    parts = [found.position_m[:, 0], found.quaternions[:, 0], angles, in_base(arms), in_base(v), in_base(w), rates]
    text = {
        "LoopMode": "Wrap" if found.loops else "Clamp",
        "FrameDuration": 1 / found.rate_hz,
        "EnableCycleOffsetPosition": True,
        "EnableCycleOffsetRotation": True,
        "MotionWeight": 1.0,
        "JointNames": order,
        "FootNames": [found.bodies[k] for k in feet],
        "Contacts": found.feet_stand[:, [LEGS.index(label) for label in AMP_LEGS]].astype(int).tolist(),
        "Source": dict(said),
        "Frames": np.concatenate([*parts, in_base(relative)], axis=1).tolist(),
    }
    path.write_text(json.dumps(text, indent=None) + "\n", encoding="utf-8")


_NPZ = {
    "isaaclab": (
        *("dof_names", "dof_positions", "dof_velocities", "body_positions", "body_rotations"),
        *("body_linear_velocities", "body_angular_velocities"),
    ),
    "mjlab": (
        *("joint_names", "joint_pos", "joint_vel", "body_pos_w", "body_quat_w"),
        *("body_lin_vel_w", "body_ang_vel_w"),
    ),
}
"""What the layouts call names, angles and rates of the joints, and places, quaternions, velocities and angular
velocities of the bodies."""


def _npz(layout: str, found: _RobotSamples, path: Path, said: Mapping[str, Any]) -> None:
    arrays = (
        *(np.array(found.robot.joints), found.angles_rad, found.rates_rad_s, found.position_m),
        *(found.quaternions[..., [3, 0, 1, 2]], found.velocity_m_s, found.angular_velocity_rad_s),
    )
    named: dict[str, Any] = dict(zip(_NPZ[layout], arrays, strict=True))
    np.savez(
        path,
        fps=np.array(found.rate_hz),
        body_names=np.array(found.bodies),
        contacts=found.feet_stand,
        contact_names=np.array([found.bodies[found.foot(label)] for label in LEGS]),
        source=np.array(json.dumps(said)),
        **named,
    )


def _mjlab_csv(found: _RobotSamples, path: Path, said: Mapping[str, Any]) -> None:
    """No header, as its readers expect none: x y z, qx qy qz qw, joints. What it is stands in a file beside it."""
    table = np.concatenate([found.position_m[:, 0], found.quaternions[:, 0], found.angles_rad], axis=1)
    np.savetxt(path, table, delimiter=",", fmt="%.17g")
    beside = {"fps": found.rate_hz, "joint_names": found.robot.joints, "source": dict(said)}
    path.with_suffix(".json").write_text(json.dumps(beside) + "\n", encoding="utf-8")


FORMATS: dict[str, tuple[str, Callable[[_RobotSamples, Path, Mapping[str, Any]], None]]] = {
    "amp": ("amp.json", _amp),
    "isaaclab": ("isaaclab.npz", partial(_npz, "isaaclab")),
    "mjlab": ("mjlab.npz", partial(_npz, "mjlab")),
    "mjlab-csv": ("mjlab.csv", _mjlab_csv),
}
"""By name, the file's and what writes it."""


def write_for_trainer(motion: RobotMotion, name: str, rate_hz: float, path: Path, said: Any) -> float:
    """Write a file of one of `FORMATS`, and return its rate. said: what the file should say of where it comes from.
    Raises InputError as `sampled`, and of a robot that the format has no room for."""
    found = sampled(motion, rate_hz)
    FORMATS[name][1](found, path, said)
    return found.rate_hz


# -- motions that are kept, for `recon convert` ------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class _KeptMotion:
    """A `RobotMotion` as plain arrays, without its robot."""

    scale: float
    slower: float
    time_s: Array
    angles_rad: Array
    position_m: Array
    quaternion_xyzw: Array
    feet_m: Array
    standing: Bools
    short: Bools
    advance_m: Array | None


@dataclass(frozen=True, eq=False)
class _Kept:
    robot: str
    """The name, or the file, seen from the folder."""
    said: Mapping[str, Any]
    clip: _KeptMotion
    stride: _KeptMotion


def keep(clip: RobotMotion, stride: RobotMotion, robot: str, said: Mapping[str, Any], path: Path) -> None:
    """Write both motions as they are, from which `convert` makes files of any of `FORMATS`, at any rate."""

    def plain(motion: RobotMotion) -> _KeptMotion:
        same = {f.name: getattr(motion, f.name) for f in fields(_KeptMotion) if hasattr(motion, f.name)}
        place, turn = motion.pose.translation, motion.pose.rotation.as_quat()
        return _KeptMotion(position_m=place, quaternion_xyzw=turn, **same)

    save_record(_Kept(robot, said, plain(clip), plain(stride)), path, SCHEMA)


def kept_motions(path: Path) -> tuple[RobotMotion, RobotMotion, Mapping[str, Any]]:
    """The clip, the stride, and what files of them say of where they come from. Raises InputError."""
    found = load_record(_Kept, path, SCHEMA, "motions of a robot, as `recon retarget` writes them")
    named = found.robot if found.robot in builtin_robots() else str(path.parent / found.robot)
    robot = load_robot(named)

    joints = len(robot.joints)

    def restored(kept: _KeptMotion) -> RobotMotion:
        n = len(kept.time_s)
        shapes = {"time_s": (n,), "angles_rad": (n, joints), "position_m": (n, 3), "quaternion_xyzw": (n, 4)}
        shapes |= {"feet_m": (n, 4, 3), "standing": (n, 4), "short": (n, 4)}
        shapes |= {} if kept.advance_m is None else {"advance_m": (2,)}
        for name, shape in shapes.items():
            values: Array = getattr(kept, name)
            if values.shape != shape or not np.isfinite(values).all():
                expected = f"finite numbers {shape}, {joints} joints as in {named}"
                raise InputError(Problem(path, name, f"{values.shape}", expected))
        if n < 2 or not (np.diff(kept.time_s) > 0).all() or not kept.quaternion_xyzw.any(axis=1).all():
            raise InputError(Problem(path, "content", "no motion", "times that go on, and rotations"))
        same = {f.name: getattr(kept, f.name) for f in fields(kept)}
        place, turn = same.pop("position_m"), Rotation.from_quat(same.pop("quaternion_xyzw"))
        return RobotMotion(robot=robot, pose=RigidTransform.from_components(place, turn), **same)

    return restored(found.clip), restored(found.stride), found.said


def convert(folder: Path, out: Path, name: str, rate_hz: float | None, overwrite: bool) -> str:
    """`recon convert` of a folder of `recon retarget`: the clip into out, the stride that repeats beside it, both or
    none; and what to say of it. name: of `FORMATS`. Raises InputError."""
    (*motions, said), _ = all_of(lambda: kept_motions(folder / KEPT), lambda: require_free_file(out, overwrite, "OUT"))
    stride = out.with_name(f"stride_{out.name}")
    with staged_folder(out.parent) as staging:
        try:
            rates = [
                write_for_trainer(motion, name, rate_hz or RATE_HZ, staging / path.name, said)
                for motion, path in zip(motions, (out, stride), strict=True)
            ]
        except InputError as error:
            raise InputError(
                replace(one, file=_OPTIONS.get(str(one.file), one.file)) for one in error.problems
            ) from None
        all_of(*(partial(require_free_file, out.parent / one.name, overwrite, "OUT") for one in staging.iterdir()))
    hz = " and ".join(f"{rate:.4g}" for rate in rates)
    return f"{out}: {name}, {motions[0].robot.title}, {hz} frames per second; a stride that repeats is in {stride}"
