"""A robot's reference as an ensemble of what the animal's motion may have been: draws from the fit's posterior.

Every draw is a whole clip (`recon.fit.draws`), put on the robot at the scale and the pace of the fit's own motion. One
file each in the layout of `--format`, and all of them stacked in `samples.npz`: `time_s` (N,), of K draws
`base_position` (K, N, 3), `base_quaternion_wxyz` (K, N, 4), `joint_positions` (K, N, joints) and `contacts` (K, N, 4),
the names, and what the fit's verdict is.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from recon.fit.draws import draws
from recon.fit.result import TrajectorySolution
from recon.robotics.robot.quadruped import LEGS
from recon.robotics.robot.reference import reference_of
from recon.robotics.robot.retarget import Retargeted, RobotMotion, retarget
from recon.robotics.robot.trainers import write_for_trainer
from recon.robotics.settings import RetargetSettings
from recon.workflows.made_from import problem_of

STACKED = "samples.npz"


def drawn(own: Retargeted, settings: RetargetSettings, count: int) -> list[RobotMotion]:
    """Clips as the animal's may have been. Raises InputError as `problem_of`."""
    fitted, robot = own.animal.analysis.motion, own.clip.robot
    problem = problem_of(fitted, settings.folder)
    assert isinstance(fitted.solution, TrajectorySolution)
    every = (replace(fitted, solution=one) for one in draws(problem, fitted.solution, count, 0))
    given = robot, own.clip.scale, own.clip.slower, own.window
    return [retarget(reference_of(one, settings.stride), *given).clip for one in every]


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
            write_for_trainer(motion, settings.format, settings.rate, out, f"sample_{number:02d}_", own)
    base, joint = (np.median(values.std(axis=0), axis=0).tolist() for values in (places, angles))
    return {
        "count": len(motions),
        "base_sigma_m": dict(zip("xyz", base, strict=True)),
        "joint_sigma_rad": dict(zip(first.robot.joints, joint, strict=True)),
    }
