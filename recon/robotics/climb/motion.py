"""A climb as a motion of its robot, in the axes of retargeted ones, and after another motion."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation, Slerp

from recon.base.arrays import Array
from recon.robotics.climb.paths import Step
from recon.robotics.climb.plan import Climb
from recon.robotics.climb.walker import LABELS
from recon.robotics.robot.quadruped import LEGS, Quadruped
from recon.robotics.robot.retarget import RobotMotion, posed

TURNED = np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
"""From the climb's axes (right, forwards, up) to the robot's (forwards, left, up)."""
ROOM_M = 0.01
"""Between the step's edge and the foremost foot of what comes before a climb."""
PART_S, PACE, LIFT = 0.4, 0.95, 0.1
"""Of the steps into a climb's stance: the time for each, unless joints are too slow; the share of their rates that is
used; how high a foot rises, of the standing height."""
IN_TURN = ("LH", "LF", "RH", "RF")


def robot_motion(climb: Climb, robot: Quadruped) -> RobotMotion:
    """A foot that is out of reach, or beyond a joint's limits, is drawn in."""
    order = [LABELS.index(label) for label in LEGS]
    rotation = Rotation.from_matrix(TURNED @ climb.rotation @ TURNED.T)
    pose = RigidTransform.from_components(climb.position_m @ TURNED.T, rotation)
    standing = climb.lifted[:, None] != np.array(order)
    return posed(robot, climb.time_s, pose, climb.feet_m[:, order] @ TURNED.T, standing)


def before(run: RobotMotion, climb: RobotMotion, step: Step, fps: float) -> tuple[RobotMotion, float]:
    """A motion along x and then a climb's, in one, and when the climb begins.

    The run ends where no foot of it comes nearer to the step's edge than `ROOM_M`. Between them the feet that are up
    come down, and then step one after the other to the climb's first stance, while the body moves to its first pose:
    no forces, and nothing says that it would keep its balance there.
    """
    at = np.arange(0.0, float(run.time_s[-1]), 1 / fps)
    rows = np.append(np.searchsorted(run.time_s, at), len(run.time_s) - 1)
    shift = np.array([step.edge_m - ROOM_M - run.feet_m[..., 0].max(), 0.0, 0.0])
    shift[1] = climb.pose.translation[0, 1] - run.pose.translation[-1, 1]
    place = RigidTransform.from_components(run.pose.translation[rows] + shift, run.pose.rotation[rows])
    feet = run.feet_m[rows] + shift
    first = posed(run.robot, np.append(at, run.time_s[-1]), place, feet, run.standing[rows])
    between = _settling(first, climb, fps)
    parts = [first, between, climb]
    starts = np.cumsum([0.0, first.time_s[-1] + 1 / fps, between.time_s[-1] + 1 / fps])
    whole = replace(
        climb,
        scale=run.scale,
        slower=run.slower,
        time_s=np.concatenate([part.time_s + start for part, start in zip(parts, starts, strict=True)]),
        pose=RigidTransform.concatenate([part.pose for part in parts]),
        **{
            name: np.concatenate([getattr(part, name) for part in parts])
            for name in ("angles_rad", "feet_m", "standing", "short")
        },
    )
    return whole, float(starts[2])


def _settling(run: RobotMotion, climb: RobotMotion, fps: float) -> RobotMotion:
    """From the last sample of a run to the first of a climb, as slow as the joints' rates ask for."""
    count = int(np.ceil(PART_S * fps))
    share = np.arange(1, 5 * count) / (5 * count)
    ends = RigidTransform.concatenate([run.pose[-1], climb.pose[0]])
    smooth = (1 - np.cos(np.pi * share)) / 2
    pose = RigidTransform.from_components(
        ends.translation[0] + smooth[:, None] * (ends.translation[1] - ends.translation[0]),
        Slerp([0.0, 1.0], ends.rotation)(smooth),
    )
    feet, standing = np.empty((len(share), 4, 3)), np.ones((len(share), 4), bool)
    start, goal = run.feet_m[-1], climb.feet_m[0]
    for k, label in enumerate(LEGS):
        part = np.clip(5 * share - 1 - IN_TURN.index(label), 0.0, 1.0)
        feet[:, k] = start[k] + ((1 - np.cos(np.pi * part)) / 2)[:, None] * (goal[k] - start[k])
        feet[:, k, 2] = start[k, 2] * np.clip(1 - 5 * share, 0.0, 1.0) + _rise(part, run.robot)
        standing[:, k] = feet[:, k, 2] <= 0
    motion = posed(run.robot, np.arange(len(share)) / fps, pose, feet, standing)
    slower = max(1.0, float(motion.rate_share.max()) / PACE)
    return replace(motion, time_s=slower * motion.time_s)


def _rise(part: Array, robot: Quadruped) -> Array:
    return np.where(part < 1, LIFT * robot.stand_m * np.sin(np.pi * part), 0.0)
