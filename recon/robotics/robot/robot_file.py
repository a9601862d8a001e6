"""Robot files -> Quadruped: TOML with dimensions and limits (docs/robot.md), URDF or MJCF; Denavit-Hartenberg tables.

Built-in robots are the files of `recon/robotics/robot/robots`.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from recon.base.arrays import Array
from recon.base.documents import builtin_file, builtin_names, parse_toml, read_toml, validated
from recon.base.errors import InputError, Problem
from recon.robotics.ik.chain import SerialChain
from recon.robotics.robot.dh import Convention, DHRow, dh_chain
from recon.robotics.robot.leg import LEG_ANGLES, Leg, Length, Limits, PositiveLength
from recon.robotics.robot.model_file import (
    SUFFIXES,
    body_names,
    foot_of,
    leaves_of,
    model_chain,
    moving,
    read_model,
    root_of,
    way_to,
)
from recon.robotics.robot.quadruped import LEGS, Masses, Quadruped, RobotLeg, closed_leg, standing

STAND = 0.7
"""Height of the hips of a robot from a URDF or MJCF file, of the stretched leg's length."""
SHORTEST_M = 1e-3
"""Below which a leg of a URDF is none."""


class _Table(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


class _Joint(_Table):
    limits_rad: Limits
    max_rate_rad_s: PositiveLength


class _Joints(_Table):
    swing: _Joint
    flap: _Joint
    knee: _Joint


class _JointPlace(_Table):
    hip_m: tuple[Length, Length, Length]
    knee_bends: Literal["backwards", "forwards"] = "backwards"
    swing: str
    flap: str
    knee: str


class _Legs(_Table):
    LF: _JointPlace
    RF: _JointPlace
    LH: _JointPlace
    RH: _JointPlace


class _RobotFile(_Table):
    name: str
    title: str
    stand_m: PositiveLength
    leg: Leg
    joints: _Joints
    legs: _Legs
    masses: Masses | None = None


class _DHFile(_Table):
    convention: Convention
    joints: Annotated[list[DHRow], Field(min_length=1)]


def builtin_robots() -> tuple[str, ...]:
    """Names of the robots that come with the package."""
    return builtin_names("robotics/robot/robots", ".toml")


def load_robot(robot: str | Path) -> Quadruped:
    """A built-in robot by name, or one of a file, .toml, .urdf or .xml (MJCF). Raises InputError."""
    text, path = str(robot), Path(robot)
    suffix = path.suffix.lower()
    if text in builtin_robots():
        content = builtin_file("robotics/robot/robots", f"{text}.toml").read_text(encoding="utf-8")
        return _checked_robot(_quadruped(text, parse_toml(content, text)))
    if suffix in SUFFIXES:
        return _checked_robot(_quadruped_of_model(path))
    if suffix == ".toml" and path.is_file():
        return _checked_robot(_quadruped(text, read_toml(path)))
    found = "no such file" if suffix == ".toml" else "no such robot"
    expected = f"{', '.join(builtin_robots())}, or a file .toml, .urdf or .xml"
    raise InputError(Problem(text, "robot", found, expected))


def load_dh(path: Path) -> tuple[SerialChain, Convention, list[DHRow]]:
    """The chain of a table in TOML (docs/robot.md), and the table. Raises InputError."""
    file = validated(_DHFile, read_toml(path, "a table of Denavit-Hartenberg parameters (TOML)"), path)
    return dh_chain(file.joints, file.convention), file.convention, file.joints


def _quadruped(source: str, table: dict[str, Any]) -> Quadruped:
    file = validated(_RobotFile, table, source)
    if file.leg.lateral_m and file.leg.first == "swing":
        expected = "0 for a leg whose swing joint comes first"
        raise InputError(Problem(source, "leg.lateral_m", str(file.leg.lateral_m), expected))
    joints: list[_Joint] = [getattr(file.joints, name) for name in LEG_ANGLES]
    limits = np.array([joint.limits_rad for joint in joints]).T
    legs = {}
    for label in LEGS:
        placed = getattr(file.legs, label)
        mirror = (1.0 if label[0] == "R" else -1.0, 1.0 if placed.knee_bends == "backwards" else -1.0, 1.0)
        names = [getattr(placed, LEG_ANGLES[k]) for k in file.leg.order]
        legs[label] = closed_leg(
            replace(file.leg, mirror=mirror),
            np.array(placed.hip_m),
            tuple(name.removeprefix("-") for name in names),
            np.array([-1.0 if name.startswith("-") else 1.0 for name in names]),
            (limits[0], limits[1]),
            np.array([joints[k].max_rate_rad_s for k in file.leg.order]),
            file.stand_m,
        )
    return Quadruped(file.name, file.title, legs, file.stand_m, source, file.masses)


def _checked_robot(robot: Quadruped) -> Quadruped:
    """Raises InputError for a robot that cannot stand, and for joints named twice."""
    problems = []
    if len({*robot.joints}) < len(robot.joints):
        problems.append(Problem(robot.source, "joints", "one name for several", "a name for each"))
    for label, leg in robot.legs.items():
        if not np.isfinite(leg.angles(leg.neutral_m[None])).all():
            found = f"a leg {label} that does not reach the ground within its limits"
            problems.append(Problem(robot.source, "stand_m", found, "a height that it can stand at"))
    if problems:
        raise InputError(problems)
    return robot


def _quadruped_of_model(path: Path) -> Quadruped:
    """The four chains of at least three moving joints that end in a leaf, told apart by where their hips are.

    Of leaves on the same joints the farthest down is the foot. The hips stand at `STAND` of the stretched legs' length,
    each foot below the leg's second joint. Raises InputError.
    """
    model = read_model(path)
    names, root, found = body_names(model), root_of(model), {}
    for leaf in leaves_of(model):
        joints = tuple(moving(model, way_to(model, leaf, root)))
        if len(joints) >= 3:
            chain = model_chain(model, path, names[leaf - 1], end_m=foot_of(model, leaf))
            low = chain.end(_middle(chain.lower_rad, chain.upper_rad))[2]
            if joints not in found or low < found[joints][0]:
                found[joints] = (low, names[leaf - 1], chain)
    if len(found) != 4:
        ends = ", ".join(leaf for _, leaf, _ in found.values()) or "none"
        expected = "four legs of three or more joints, and no arm"
        raise InputError(Problem(path, "legs", f"{len(found)} chains: {ends}", expected))
    chains = [chain for _, _, chain in found.values()]
    hips = np.array([chain.positions(np.zeros(chain.n))[1] for chain in chains])
    labels = [f"{'L' if y > 0 else 'R'}{'F' if x > 0 else 'H'}" for x, y, _ in hips - hips.mean(axis=0)]
    if sorted(labels) != sorted(LEGS):
        places = "; ".join(f"({x:.2f}, {y:.2f})" for x, y, _ in hips)
        raise InputError(Problem(path, "hips", places, "one at each corner, x forwards and y left"))
    shortest = min(float(chain.lengths_m[1:].sum()) for chain in chains)
    stand = STAND * shortest
    if not stand > SHORTEST_M:
        raise InputError(Problem(path, "legs", f"{shortest:g} m long", f"legs longer than {SHORTEST_M:g} m"))
    neutral = hips - [0.0, 0.0, stand]
    homes = [standing(chain, foot) for chain, foot in zip(chains, neutral, strict=True)]
    problems = [
        Problem(path, f"leg {label}", f"no way to stand {stand:.3f} m high", "one")
        for label, home in zip(labels, homes, strict=True)
        if home is None
    ]
    if problems:
        raise InputError(problems)
    every = zip(labels, chains, neutral, homes, strict=True)
    legs = {label: RobotLeg(chain, foot, home) for label, chain, foot, home in every}
    called = model.names.split(b"\0")[0].decode() or path.stem
    return Quadruped(called, called, {label: legs[label] for label in LEGS}, stand, str(path))


def _middle(lower: Array, upper: Array) -> Array:
    """The middle of limits; 0 for a joint that has none."""
    bounded = np.isfinite(lower) & np.isfinite(upper)
    return np.where(bounded, np.where(bounded, lower, 0.0) + np.where(bounded, upper, 0.0), 0.0) / 2
