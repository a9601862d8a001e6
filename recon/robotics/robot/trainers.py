"""A robot's reference motion as programs that train policies read it: sampled at a rate of one's own, with velocities.

Joint angles, the base's place and its roll, pitch and yaw are cubic splines through the motion's samples, of which
there are ten for each frame; those of a stride that repeats are periodic. Everything that is written is worked out from
them and from their derivatives, so that velocities belong to what is written exactly, by the robot's kinematics:

    w = sum of the turns of roll, pitch and yaw;    v(p) = v + w x (p - base) + sum over joints before p of
    rate * axis x (p - joint)

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
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation

from recon.base.arrays import Array, Bools
from recon.base.errors import InputError, Problem
from recon.robotics.robot.quadruped import LEGS, RobotLeg
from recon.robotics.robot.retarget import RobotMotion

AMP_LEGS = ("RF", "LF", "RH", "LH")
AMP_JOINTS = 3
"""Of a leg, in the layout."""


@dataclass(frozen=True, eq=False)
class Sampled:
    """K frames, evenly spaced; the robot's joints in its own order; B bodies."""

    motion: RobotMotion
    rate_hz: float
    time_s: Array
    """(K,)"""
    joints: tuple[str, ...]
    angles_rad: Array
    """(K, joints)"""
    rates_rad_s: Array
    """(K, joints)"""
    bodies: tuple[str, ...]
    """The base first."""
    place_m: Array
    """(K, B, 3)"""
    turned: Rotation
    """(K * B): T_world_body."""
    velocity_m_s: Array
    """(K, B, 3)"""
    angular_velocity_rad_s: Array
    """(K, B, 3), in the world."""
    feet_stand: Bools
    """(K, 4), in the order of `LEGS`."""

    @property
    def loops(self) -> bool:
        return self.motion.advance_m is not None

    @property
    def quaternions(self) -> Array:
        """(K, B, 4), xyzw, each near to the one before it."""
        found = self.turned.as_quat(canonical=True).reshape(len(self.time_s), len(self.bodies), 4)
        flips = np.sign(np.sum(found[1:] * found[:-1], axis=2))
        found[1:] *= np.cumprod(np.where(flips < 0, -1.0, 1.0), axis=0)[..., None]
        return found

    def foot(self, label: str) -> int:
        """Its place among the bodies."""
        return self.bodies.index(_foot_name(self.motion.robot.legs[label], label))


def sampled(motion: RobotMotion, rate_hz: float) -> Sampled:
    """A motion at the rate nearest to rate_hz of which a whole number of frames fits. Raises InputError where fewer
    than two do."""
    duration = float(motion.time_s[-1] - motion.time_s[0])
    frames = round(duration * rate_hz)
    if frames < 1:
        expected = f"at least {1 / duration:.1f}, two frames of its {duration:.2f} s"
        raise InputError(Problem("--rate", "frames a second", f"{rate_hz:g}", expected))
    time_s = np.linspace(0.0, duration, frames + 1)
    at = _spline(motion, motion.angles_rad)
    q, qd = at(time_s), at(time_s, 1)
    base, v, turned, w = _base(motion, time_s)
    bodies, places, rotations, velocities, spins = ["base"], [base], [turned], [v], [w]
    joint = 0
    for label in LEGS:
        leg = motion.robot.legs[label]
        columns = slice(joint, joint + len(leg.joints))
        joint = columns.stop
        links = _links(leg, q[:, columns], qd[:, columns])
        bodies += [*(name.removesuffix("_joint") for name in leg.joints), _foot_name(leg, label)]
        for place, link, moves, spin in zip(*links, strict=True):
            arm = turned.apply(place)
            places.append(base + arm)
            rotations.append(turned * link)
            velocities.append(v + np.cross(w, arm) + turned.apply(moves))
            spins.append(w + turned.apply(spin))
    matrices = np.stack([rotation.as_matrix() for rotation in rotations], axis=1)
    nearest = np.argmin(np.abs(motion.time_s[None] - motion.time_s[0] - time_s[:, None]), axis=1)
    return Sampled(
        motion=motion,
        rate_hz=frames / duration,
        time_s=time_s,
        joints=motion.robot.joints,
        angles_rad=q,
        rates_rad_s=qd,
        bodies=tuple(bodies),
        place_m=np.stack(places, axis=1),
        turned=Rotation.from_matrix(matrices.reshape(-1, 3, 3)),
        velocity_m_s=np.stack(velocities, axis=1),
        angular_velocity_rad_s=np.stack(spins, axis=1),
        feet_stand=motion.standing[nearest],
    )


def _spline(motion: RobotMotion, values: Array) -> CubicSpline:
    time_s = motion.time_s - motion.time_s[0]
    if motion.advance_m is None:
        return CubicSpline(time_s, values)
    return CubicSpline(time_s, np.concatenate([values[:-1], values[:1]]), bc_type="periodic")


def _base(motion: RobotMotion, time_s: Array) -> tuple[Array, Array, Rotation, Array]:
    """Place (K, 3), velocity, T_world_base and angular velocity."""
    period = float(motion.time_s[-1] - motion.time_s[0])
    on = np.zeros(3) if motion.advance_m is None else np.append(motion.advance_m, 0.0)
    share = (motion.time_s - motion.time_s[0])[:, None] / period
    place = _spline(motion, motion.pose.translation - share * on)
    turn = _spline(motion, np.unwrap(motion.pose.rotation.as_euler("ZYX"), axis=0))
    angles, rates = turn(time_s), turn(time_s, 1)
    z, y, x = np.eye(3)[[2, 1, 0]]
    yawed = Rotation.from_euler("Z", angles[:, [0]])
    pitched = yawed * Rotation.from_euler("Y", angles[:, [1]])
    w = rates[:, :1] * z + rates[:, 1:2] * yawed.apply(y) + rates[:, 2:] * pitched.apply(x)
    turned = pitched * Rotation.from_euler("X", angles[:, [2]])
    return place(time_s) + time_s[:, None] / period * on, place(time_s, 1) + on / period, turned, w


def _links(leg: RobotLeg, q: Array, qd: Array) -> tuple[list[Array], list[Rotation], list[Array], list[Array]]:
    """In the base's axes, of each link and of the foot: where it is (K, 3), how it is turned from where all angles are
    0, its velocity and its angular velocity."""
    chain, n = leg.chain, len(leg.joints)
    points = chain.positions(q)
    straight, turned = chain.frames(np.zeros((1, n))), chain.frames(q)
    axes = turned[..., 2]
    slides = chain.sliding
    places, rotations, velocities, spins = [], [], [], []
    for k in range(n + 1):
        link = min(k, n - 1)
        velocity, spin = np.zeros((len(q), 3)), np.zeros((len(q), 3))
        for i in range(link + 1):
            by = qd[:, i, None] * axes[:, i]
            velocity += by if slides[i] else np.cross(by, points[:, k] - points[:, i])
            spin += 0.0 if slides[i] else by
        places.append(points[:, k])
        rotations.append(Rotation.from_matrix(turned[:, link] @ straight[0, link].T))
        velocities.append(velocity)
        spins.append(spin)
    return places, rotations, velocities, spins


def _foot_name(leg: RobotLeg, label: str) -> str:
    """As FL_foot, of joints that are called FL_hip_joint and so on."""
    head, *rest = leg.joints[0].split("_")
    return f"{head}_foot" if rest and all(name.split("_")[0] == head for name in leg.joints) else f"{label}_foot"


# -- files -----------------------------------------------------------------------------------------------------------


def _amp(found: Sampled, path: Path, said: Mapping[str, Any]) -> None:
    robot = found.motion.robot
    if any(len(leg.joints) != AMP_JOINTS for leg in robot.legs.values()):
        expected = f"a robot with {AMP_JOINTS} joints a leg, or another format"
        raise InputError(Problem("--format", "amp", f"{len(robot.joints)} joints", expected))
    order = [joint for label in AMP_LEGS for joint in robot.legs[label].joints]
    columns = [found.joints.index(joint) for joint in order]
    feet = [found.foot(label) for label in AMP_LEGS]
    base = found.turned[:: len(found.bodies)]
    v, w = found.velocity_m_s[:, 0], found.angular_velocity_rad_s[:, 0]
    K = len(found.time_s)

    def in_base(vectors: Array) -> Array:
        return np.stack([base.inv().apply(vectors[:, k]) for k in range(vectors.shape[1])], axis=1).reshape(K, -1)

    arms = found.place_m[:, feet] - found.place_m[:, :1]
    relative = found.velocity_m_s[:, feet] - v[:, None] - np.cross(w[:, None], arms)
    parts = [
        found.place_m[:, 0],
        found.quaternions[:, 0],
        found.angles_rad[:, columns],
        in_base(arms),
        in_base(v[:, None]),
        in_base(w[:, None]),
        found.rates_rad_s[:, columns],
        in_base(relative),
    ]
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
        "Frames": np.concatenate(parts, axis=1).tolist(),
    }
    path.write_text(json.dumps(text, indent=None) + "\n", encoding="utf-8")


def _arrays(found: Sampled, said: Mapping[str, Any]) -> dict[str, Any]:
    return {
        "fps": np.array(found.rate_hz),
        "contacts": found.feet_stand,
        "contact_names": np.array([found.bodies[found.foot(label)] for label in LEGS]),
        "source": np.array(json.dumps(said)),
    }


def _isaac_lab(found: Sampled, path: Path, said: Mapping[str, Any]) -> None:
    np.savez(
        path,
        **_arrays(found, said),
        dof_names=np.array(found.joints),
        body_names=np.array(found.bodies),
        dof_positions=found.angles_rad,
        dof_velocities=found.rates_rad_s,
        body_positions=found.place_m,
        body_rotations=found.quaternions[..., [3, 0, 1, 2]],
        body_linear_velocities=found.velocity_m_s,
        body_angular_velocities=found.angular_velocity_rad_s,
    )


def _mjlab(found: Sampled, path: Path, said: Mapping[str, Any]) -> None:
    np.savez(
        path,
        **_arrays(found, said),
        joint_names=np.array(found.joints),
        body_names=np.array(found.bodies),
        joint_pos=found.angles_rad,
        joint_vel=found.rates_rad_s,
        body_pos_w=found.place_m,
        body_quat_w=found.quaternions[..., [3, 0, 1, 2]],
        body_lin_vel_w=found.velocity_m_s,
        body_ang_vel_w=found.angular_velocity_rad_s,
    )


def _mjlab_csv(found: Sampled, path: Path, said: Mapping[str, Any]) -> None:
    """No header, as its readers expect none: x y z, qx qy qz qw, joints. What it is stands in a file beside it."""
    table = np.concatenate([found.place_m[:, 0], found.quaternions[:, 0], found.angles_rad], axis=1)
    np.savetxt(path, table, delimiter=",", fmt="%.17g")
    beside = {"fps": found.rate_hz, "joint_names": found.joints, "source": dict(said)}
    path.with_suffix(".json").write_text(json.dumps(beside) + "\n", encoding="utf-8")


FORMATS: dict[str, tuple[str, Callable[[Sampled, Path, Mapping[str, Any]], None]]] = {
    "amp": ("amp.json", _amp),
    "isaaclab": ("isaaclab.npz", _isaac_lab),
    "mjlab": ("mjlab.npz", _mjlab),
    "mjlab-csv": ("mjlab.csv", _mjlab_csv),
}
"""By name, the file's and what writes it."""


def write_for_trainer(motion: RobotMotion, name: str, rate_hz: float, folder: Path, prefix: str, said: Any) -> None:
    """Of `FORMATS`, into folder. said: what the file should say of where it comes from. Raises InputError as `sampled`,
    and of a robot that the format has no room for."""
    file, write = FORMATS[name]
    write(sampled(motion, rate_hz), folder / f"{prefix}{file}", said)
