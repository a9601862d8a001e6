"""A robot's kinematics, forward and inverse: its body's pose, a leg, the arm with a lift, a Denavit-Hartenberg table.

Each answer is what `--json` prints: metres and radians.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import RigidTransform, Rotation

from recon.base.arrays import Array
from recon.base.errors import InputError, Problem
from recon.robotics.ik.chain import SerialChain
from recon.robotics.robot.body_pose import body_pose, leg_targets
from recon.robotics.robot.dh import DHRow, dh_table
from recon.robotics.robot.lift_arm import lift_arm, lift_arm_hand
from recon.robotics.robot.quadruped import LEGS
from recon.robotics.robot.robot_file import load_dh, load_robot
from recon.robotics.robot.solutions import all_solutions
from recon.robotics.robot.urdf import read_urdf, urdf_chain

Answer = dict[str, Any]
ENDLESS = "the joints can move on without moving the end: one of endlessly many"


def pose_of(robot: str | Path, position_m: ArrayLike, roll_rad: float, pitch_rad: float, yaw_rad: float) -> Answer:
    """The legs' angles of a body moved by position_m (3,) and turned from where it stands, the feet planted."""
    machine = load_robot(robot)
    legs = [machine.legs[label] for label in LEGS]
    pose = body_pose(position_m, roll_rad, pitch_rad, yaw_rad)
    feet = leg_targets(pose, np.zeros((4, 3)), [leg.neutral_m for leg in legs])
    found = {}
    for label, leg, foot in zip(LEGS, legs, feet, strict=True):
        q = leg.angles(foot[None])[0]
        reached = bool(np.isfinite(q).all())
        why = "" if reached else "beyond a joint's limits" if len(leg.solutions(foot)) else "out of reach"
        margin = float(np.minimum(q - leg.lower_rad, leg.upper_rad - q).min())
        angles = q if reached else None
        found[label] = {"joints": leg.joints, "foot_m": foot, "angles_rad": angles, "margin_rad": margin, "why": why}
    turned = {"roll_rad": roll_rad, "pitch_rad": pitch_rad, "yaw_rad": yaw_rad}
    return {"robot": machine.title, "position_m": position_m, **turned, "legs": found}


def leg_of(robot: str | Path, label: str, angles: ArrayLike | None, foot_m: ArrayLike | None) -> Answer:
    """A leg's table and limits; its foot, body axes, at angles, as typed (degrees, metres of joints
    that slide); all angles that put the foot at foot_m (3,)."""
    machine = load_robot(robot)
    leg = machine.legs[label]
    answer = _chain_answer(leg.chain, leg.joints, _table_answer(leg.chain)) | {"robot": machine.title, "leg": label}
    answer |= {"stands_at_m": leg.neutral_m}
    if angles is not None:
        answer["forward"] = _forward(leg.chain, _joints(angles, leg.chain))
    if foot_m is not None:
        every = leg.solutions(np.asarray(foot_m, float))
        ended = all_solutions(leg.chain, foot_m).isolated if leg.chain.n > 3 else True
        answer["inverse"] = _inverse(leg.chain, every, ended) | {"place_m": foot_m}
    return answer


def table_answer(
    file: Path,
    tip: str | None,
    angles: ArrayLike | None,
    place_m: ArrayLike | None,
    roll_pitch_yaw_rad: ArrayLike | None,
) -> Answer:
    """Of a table of parameters (TOML) or of a URDF chain from the root to the link `tip`, by default the only leaf.
    angles: as typed; roll_pitch_yaw_rad: how the end is turned, None: anyhow."""
    if file.suffix.lower() == ".urdf":
        robot = read_urdf(file)
        ends = [tip] if tip is not None else list(robot.leaves())
        if len(ends) > 1:
            raise InputError(Problem("--tip", "link", "none", f"one of {', '.join(ends)}"))
        chain = urdf_chain(robot, ends[0])
        table = _table_answer(chain)
    else:
        if tip is not None:
            raise InputError(Problem("--tip", "link", tip, "none: the file has one chain"))
        chain, convention, rows = load_dh(file)
        table = _table(convention, rows)
    answer = _chain_answer(chain, chain.names, table)
    if angles is not None:
        answer["forward"] = _forward(chain, _joints(angles, chain))
    if place_m is not None:
        turned = None if roll_pitch_yaw_rad is None else _rotation_matrix(roll_pitch_yaw_rad)
        every = all_solutions(chain, place_m, turned)
        answer["inverse"] = _inverse(chain, every.q, every.isolated) | {"place_m": place_m}
        answer["inverse"]["roll_pitch_yaw_rad"] = roll_pitch_yaw_rad
    return answer


def arm_of(lengths: tuple[float, float], hand: ArrayLike | None, height: float, q: ArrayLike | None) -> Answer:
    """The arm with a lift: both branches of a hand (x, y, angle) at a height, or the hand of q (4,)."""
    if min(lengths) <= 0:
        raise InputError(Problem("LENGTHS", "links", f"{lengths[0]:g}, {lengths[1]:g}", "two positive lengths"))
    answer: Answer = {"lengths": lengths}
    if q is not None:
        found, at = lift_arm_hand(lengths, q)
        answer["forward"] = {"q": q, "hand": found, "height": float(at)}
    if hand is not None:
        solved = lift_arm(lengths, hand, height)
        branches = [q for q in solved.branches if np.isfinite(q).all()]
        answer["inverse"] = {"hand": hand, "height": height, "solutions": branches, "note": solved.reason}
    return answer


def _chain_answer(chain: SerialChain, joints: tuple[str, ...], table: Answer) -> Answer:
    lists = {"joints": joints, "slides": chain.sliding, "lower": chain.lower_rad, "upper": chain.upper_rad}
    return lists | {"dh": table}


def _table_answer(chain: SerialChain) -> Answer:
    table = dh_table(chain)
    return {"base": _pose_answer(table.base), "tool": _pose_answer(table.tool), **_table("modified", table.rows)}


def _table(convention: str, rows: Sequence[DHRow]) -> Answer:
    columns = ("a_m", "alpha_rad", "d_m", "theta_rad")
    return {"convention": convention, "rows": [{name: getattr(row, name) for name in columns} for row in rows]}


def _forward(chain: SerialChain, q: Array) -> Answer:
    R, place = chain.pose(q)
    end = RigidTransform.from_components(place, Rotation.from_matrix(R))
    return {"q": q, **_pose_answer(end), "within_limits": _within(chain, q)}


def _pose_answer(transform: RigidTransform) -> Answer:
    yaw, pitch, roll = transform.rotation.as_euler("ZYX", suppress_warnings=True)
    return {"place_m": transform.translation, "roll_pitch_yaw_rad": [roll, pitch, yaw]}


def _inverse(chain: SerialChain, every: Array, isolated: bool) -> Answer:
    solutions = [_in_limits(chain, q) for q in every]
    note = "no solution" if not solutions else "" if isolated else ENDLESS
    rows = [{"q": q, "within_limits": _within(chain, q)} for q in solutions]
    return {"solutions": rows, "note": note}


def _in_limits(chain: SerialChain, q: Array) -> Array:
    """Turning joints by whole turns, to nearest the middle of their limits, if they have any."""
    bounded = np.isfinite(chain.lower_rad) & np.isfinite(chain.upper_rad) & ~chain.sliding
    middle = np.where(bounded, (np.where(bounded, chain.lower_rad, 0) + np.where(bounded, chain.upper_rad, 0)) / 2, q)
    return np.where(bounded, middle + (q - middle + np.pi) % (2 * np.pi) - np.pi, q)


def _within(chain: SerialChain, q: Array) -> bool:
    return bool(((q >= chain.lower_rad - 1e-9) & (q <= chain.upper_rad + 1e-9)).all())


def _rotation_matrix(roll_pitch_yaw_rad: ArrayLike) -> Array:
    return Rotation.from_euler("ZYX", np.asarray(roll_pitch_yaw_rad, float)[::-1]).as_matrix()


def _joints(given: ArrayLike, chain: SerialChain) -> Array:
    """(n,), rad and m, of what is typed: degrees where a joint turns."""
    q = np.asarray(given, float)
    if len(q) != chain.n:
        raise InputError(Problem("--angles", "joints", f"{len(q)} numbers", f"{chain.n}, one for each joint"))
    return np.where(chain.sliding, q, np.radians(q))
