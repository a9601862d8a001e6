"""A robot's kinematics, forward and inverse: its body's pose, a leg, a Denavit-Hartenberg table.

Each answer is what `--json` prints: metres and radians. What is asked is as typed, in degrees.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from recon.base.arrays import Array
from recon.base.errors import InputError, Problem
from recon.robotics.ik.chain import SerialChain
from recon.robotics.robot.dh import DHRow, dh_table
from recon.robotics.robot.model_file import SUFFIXES, body_names, leaves_of, model_chain, read_model
from recon.robotics.robot.rigid import body_pose, leg_targets
from recon.robotics.robot.robot_file import load_dh, load_robot
from recon.robotics.robot.solutions import all_solutions
from recon.robotics.settings import LegSettings, PoseSettings, TableSettings

Answer = dict[str, Any]
ENDLESS = "the joints can move on without moving the end: one of endlessly many"


def pose_of(settings: PoseSettings) -> Answer:
    """The legs' angles of a body moved and turned from where it stands, the feet planted."""
    machine, position = load_robot(settings.robot), settings.move or (0.0, 0.0, 0.0)
    turned = {name: float(np.radians(getattr(settings, name))) for name in ("roll", "pitch", "yaw")}
    pose = body_pose(position, turned["roll"], turned["pitch"], turned["yaw"])
    feet = leg_targets(pose, np.zeros((4, 3)), [leg.neutral_m for leg in machine.legs.values()])
    found = {}
    for (label, leg), foot in zip(machine.legs.items(), feet, strict=True):
        q = leg.angles(foot[None])[0]
        reached = bool(np.isfinite(q).all())
        why = "" if reached else "beyond a joint's limits" if len(leg.solutions(foot)[0]) else "out of reach"
        angles, margin = q if reached else None, float(leg.margins(q).min())
        found[label] = {"joints": leg.joints, "foot_m": foot, "angles_rad": angles, "margin_rad": margin, "why": why}
    angles = {f"{name}_rad": angle for name, angle in turned.items()}
    return {"robot": machine.title, "position_m": position, **angles, "legs": found}


def leg_of(settings: LegSettings, angles: Sequence[float] | None) -> Answer:
    """A leg's table and limits; its foot, body axes, at angles; all angles of a foot."""
    machine = load_robot(settings.robot)
    leg = machine.legs[settings.leg]
    answer = _chain_answer(leg.chain, angles) | {"robot": machine.title, "leg": settings.leg}
    answer |= {"stands_at_m": leg.neutral_m}
    if settings.foot is not None:
        answer["inverse"] = _inverse(leg.chain, *leg.solutions(np.array(settings.foot))) | {"place_m": settings.foot}
    return answer


def chain_of(settings: TableSettings, angles: Sequence[float] | None) -> Answer:
    """A table of parameters (TOML), or that of a chain of a URDF or MJCF file, by default to its only leaf."""
    file, tip = settings.file, settings.tip
    if file.suffix.lower() in SUFFIXES:
        model = read_model(file)
        ends = [tip] if tip is not None else [body_names(model)[leaf - 1] for leaf in leaves_of(model)]
        if len(ends) > 1:
            raise InputError(Problem("--tip", "link", "none", f"one of {', '.join(ends)}"))
        chain, table = model_chain(model, file, ends[0]), None
    else:
        if tip is not None:
            raise InputError(Problem("--tip", "link", tip, "none: the file has one chain"))
        chain, convention, rows = load_dh(file)
        table = _table(convention, rows)
    answer = _chain_answer(chain, angles, table)
    if settings.place is not None:
        turned = None if settings.turned is None else np.radians(settings.turned)
        matrix = None if turned is None else Rotation.from_euler("ZYX", turned[::-1]).as_matrix()
        answer["inverse"] = _inverse(chain, *all_solutions(chain, settings.place, matrix))
        answer["inverse"] |= {"place_m": settings.place, "roll_pitch_yaw_rad": turned}
    return answer


def _chain_answer(chain: SerialChain, angles: Sequence[float] | None, table: Answer | None = None) -> Answer:
    """table: None: the chain's own."""
    if table is None:
        base, rows, tool = dh_table(chain)
        table = {"base": _pose_answer(base), "tool": _pose_answer(tool), **_table("modified", rows)}
    answer: Answer = {"joints": chain.names, "slides": chain.sliding, "lower": chain.lower_rad}
    answer |= {"upper": chain.upper_rad, "dh": table}
    if angles is not None:
        q = np.asarray(angles, float)
        if len(q) != chain.n:
            raise InputError(Problem("--angles", "joints", f"{len(q)} numbers", f"{chain.n}, one for each joint"))
        q = np.where(chain.sliding, q, np.radians(q))
        R, place = chain.pose(q)
        end = RigidTransform.from_components(place, Rotation.from_matrix(R))
        answer["forward"] = {"q": q, **_pose_answer(end), "within_limits": _within(chain, q)}
    return answer


def _table(convention: str, rows: Sequence[DHRow]) -> Answer:
    columns = ("a_m", "alpha_rad", "d_m", "theta_rad")
    return {"convention": convention, "rows": [{name: getattr(row, name) for name in columns} for row in rows]}


def _pose_answer(transform: RigidTransform) -> Answer:
    yaw, pitch, roll = transform.rotation.as_euler("ZYX", suppress_warnings=True)
    return {"place_m": transform.translation, "roll_pitch_yaw_rad": [roll, pitch, yaw]}


def _inverse(chain: SerialChain, every: Array, isolated: bool) -> Answer:
    rows = [{"q": q, "within_limits": _within(chain, q)} for q in (_in_limits(chain, q) for q in every)]
    return {"solutions": rows, "note": "no solution" if not rows else "" if isolated else ENDLESS}


def _in_limits(chain: SerialChain, q: Array) -> Array:
    """Turning joints by whole turns, to nearest the middle of their limits, if they have any."""
    bounded = np.isfinite(chain.lower_rad) & np.isfinite(chain.upper_rad) & ~chain.sliding
    middle = np.where(bounded, (np.where(bounded, chain.lower_rad, 0) + np.where(bounded, chain.upper_rad, 0)) / 2, q)
    return np.where(bounded, middle + (q - middle + np.pi) % (2 * np.pi) - np.pi, q)


def _within(chain: SerialChain, q: Array) -> bool:
    return bool(((q >= chain.lower_rad - 1e-9) & (q <= chain.upper_rad + 1e-9)).all())
