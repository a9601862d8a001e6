"""A robot's reference as an ensemble of what the animal's motion may have been: draws from the fit's posterior.

Every draw is a whole clip (`recon.fit.draws`), put on the robot at the scale and the pace of the fit's own motion. One
file each in the layout of `--format`, and all of them stacked in `samples.npz`: `time_s` (N,), of K draws
`base_position` (K, N, 3), `base_quaternion_wxyz` (K, N, 4), `joint_positions` (K, N, joints) and `contacts` (K, N, 4),
the names, the animal's `size` (K,), and what the fit's verdict is.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from recon.base.arrays import Array
from recon.fit.draws import draws
from recon.fit.motion import Motion
from recon.fit.result import TrajectorySolution
from recon.robotics.robot.quadruped import LEGS
from recon.robotics.robot.retarget import RobotMotion
from recon.robotics.robot.trainers import write_for_trainer
from recon.workflows.made_from import problem_of

STACKED = "samples.npz"


def drawn(motion: Motion, folder: Path, count: int, seed: int = 0) -> list[Motion]:
    """Motions as the animal's may have been. folder: of the results that it was loaded from. Raises InputError as
    `problem_of`."""
    clip = problem_of(motion, folder)
    assert isinstance(motion.solution, TrajectorySolution)
    return [replace(motion, solution=one) for one in draws(clip, motion.solution, count, seed)]


def write_ensemble(
    motions: Sequence[RobotMotion], out: Path, said: Mapping[str, Any], layout: str | None, rate_hz: float
) -> dict[str, Any]:
    """The files, into a folder that there is, and how far the draws lie apart, for the report: standard deviations of
    the base's place (m, by axis) and of the joints' angles (rad), medians over the clip. layout: of `--format`."""
    places = np.stack([motion.pose.translation for motion in motions])
    angles = np.stack([motion.angles_rad for motion in motions])
    _write_stacked(motions, places, angles, out / STACKED, said)
    if layout is not None:
        for number, motion in enumerate(motions, start=1):
            own = dict(said) | {"sample": number}
            write_for_trainer(motion, layout, rate_hz, out, f"sample_{number:02d}_", own)
    spread = np.median(places.std(axis=0), axis=0), np.median(angles.std(axis=0), axis=0)
    return {
        "count": len(motions),
        "base_sigma_m": dict(zip("xyz", spread[0].tolist(), strict=True)),
        "joint_sigma_rad": dict(zip(motions[0].robot.joints, spread[1].tolist(), strict=True)),
    }


def _write_stacked(
    motions: Sequence[RobotMotion], places: Array, angles: Array, path: Path, said: Mapping[str, Any]
) -> None:
    first = motions[0]
    np.savez(
        path,
        time_s=first.time_s,
        base_position=places,
        base_quaternion_wxyz=np.stack([one.pose.rotation.as_quat(scalar_first=True) for one in motions]),
        joint_positions=angles,
        joint_names=np.array(first.robot.joints),
        contacts=np.stack([one.standing for one in motions]),
        contact_names=np.array(LEGS),
        source=np.array(json.dumps(said)),
    )
