"""Robot files -> Quadruped: TOML with dimensions and limits (docs/robot.md), or URDF; Denavit-Hartenberg tables.

Built-in robots are the files of `recon/robotics/robot/robots`.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, StrictBool

from recon.base.documents import parse_toml, read_toml, validated
from recon.base.errors import InputError, Problem
from recon.base.package import builtin_file, builtin_names
from recon.robotics.ik.chain import SerialChain
from recon.robotics.robot.dh import Convention, DHRow, dh_chain
from recon.robotics.robot.leg import LEG_ANGLES, FlapLeg, Leg, SwingLeg
from recon.robotics.robot.quadruped import LEGS, ChainLeg, ClosedLeg, Quadruped, standing
from recon.robotics.robot.urdf import MOVING, UrdfRobot, read_urdf, urdf_chain

STAND = 0.7
SHORTEST_M = 1e-3
"""Below which a leg of a URDF is none."""
"""Height of the hips of a robot from a URDF file, of the stretched leg's length."""


FiniteFloat = Annotated[float, Field(gt=-1e6, lt=1e6, allow_inf_nan=False)]
PositiveFloat = Annotated[float, Field(gt=1e-6, lt=1e6, allow_inf_nan=False)]
"""More, or less, can only be damage."""


class _Table(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


class _Leg(_Table):
    first: Literal["swing", "flap"]
    thigh_m: PositiveFloat
    shin_m: PositiveFloat
    knee_offset_m: FiniteFloat = 0.0
    foot_offset_m: FiniteFloat = 0.0
    lateral_m: FiniteFloat = 0.0


class _Joint(_Table):
    limits_rad: tuple[FiniteFloat, FiniteFloat]
    max_rate_rad_s: PositiveFloat


class _Joints(_Table):
    swing: _Joint
    flap: _Joint
    knee: _Joint


class _Placed(_Table):
    hip_m: tuple[FiniteFloat, FiniteFloat, FiniteFloat]
    knee_bends: Literal["backwards", "forwards"] = "backwards"
    swing: str
    flap: str
    knee: str


class _Legs(_Table):
    LF: _Placed
    RF: _Placed
    LH: _Placed
    RH: _Placed


class _RobotFile(_Table):
    name: str
    title: str
    stand_m: PositiveFloat
    leg: _Leg
    joints: _Joints
    legs: _Legs


class _DHJoint(_Table):
    a_m: FiniteFloat = 0.0
    alpha_rad: FiniteFloat = 0.0
    d_m: FiniteFloat = 0.0
    theta_rad: FiniteFloat = 0.0
    slides: StrictBool = False
    limits: tuple[FiniteFloat, FiniteFloat] | None = None


class _DHFile(_Table):
    convention: Convention
    joints: Annotated[list[_DHJoint], Field(min_length=1)]


def builtin_robots() -> tuple[str, ...]:
    """Names of the robots that come with the package."""
    return builtin_names("robotics/robot/robots", ".toml")


def load_robot(robot: str | Path) -> Quadruped:
    """A built-in robot by name, or one of a file, .toml or .urdf. Raises InputError."""
    text = str(robot)
    if text in builtin_robots():
        content = builtin_file("robotics/robot/robots", f"{text}.toml").read_text(encoding="utf-8")
        return _quadruped(text, parse_toml(content, text))
    path = Path(robot)
    if path.suffix.lower() == ".urdf":
        return quadruped_from_urdf(read_urdf(path))
    if path.suffix.lower() == ".toml" and path.is_file():
        return _quadruped(text, read_toml(path))
    found = "no such file" if path.suffix.lower() in (".toml", ".urdf") else "no such robot"
    expected = f"{', '.join(builtin_robots())}, or a file .toml or .urdf"
    raise InputError(Problem(text, "robot", found, expected))


def load_dh(path: Path) -> tuple[SerialChain, Convention, list[DHRow]]:
    """The chain of a table in TOML (docs/robot.md), and the table. Raises InputError."""
    file = validated(_DHFile, read_toml(path, "a table of Denavit-Hartenberg parameters (TOML)"), path)
    limits = [joint.limits or (-np.inf, np.inf) for joint in file.joints]
    problems = [
        Problem(path, f"joints[{k}].limits", str(limit), "the lower one first")
        for k, limit in enumerate(limits)
        if limit[0] > limit[1]
    ]
    if problems:
        raise InputError(problems)
    rows = [DHRow(**joint.model_dump(exclude={"limits"})) for joint in file.joints]
    lower, upper = np.transpose(limits)
    return dh_chain(rows, file.convention, (lower, upper)), file.convention, rows


def _quadruped(source: str, table: dict[str, Any]) -> Quadruped:
    file = validated(_RobotFile, table, source)
    lengths = file.leg.model_dump(exclude={"first"})
    lateral = lengths.pop("lateral_m")
    geometry = FlapLeg(**lengths, lateral_m=lateral) if file.leg.first == "flap" else SwingLeg(**lengths)
    joints = {name: getattr(file.joints, name) for name in LEG_ANGLES}
    problems = [
        Problem(source, f"joints.{name}.limits_rad", str(joint.limits_rad), "the lower one first")
        for name, joint in joints.items()
        if joint.limits_rad[0] > joint.limits_rad[1]
    ]
    if lateral and file.leg.first == "swing":
        problems.append(Problem(source, "leg.lateral_m", str(lateral), "0 for a leg whose swing joint comes first"))
    if problems:
        raise InputError(problems)
    limits = np.array([joint.limits_rad for joint in joints.values()]).T
    legs = {}
    for label in LEGS:
        placed = getattr(file.legs, label)
        mirror = (1.0 if label[0] == "R" else -1.0, 1.0 if placed.knee_bends == "backwards" else -1.0, 1.0)
        named = [LEG_ANGLES[k] for k in geometry.order]
        names = [getattr(placed, name) for name in named]
        legs[label] = ClosedLeg.of(
            Leg(geometry, mirror, (limits[0], limits[1])),
            np.array(placed.hip_m),
            tuple(name.removeprefix("-") for name in names),
            np.array([-1.0 if name.startswith("-") else 1.0 for name in names]),
            np.array([joints[name].max_rate_rad_s for name in named]),
            file.stand_m,
        )
    return _checked_robot(Quadruped(file.name, file.title, legs, file.stand_m, source))


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


def quadruped_from_urdf(robot: UrdfRobot) -> Quadruped:
    """The four chains of at least three moving joints that end in a leaf, told apart by where their hips are.

    Of leaves on the same joints the farthest down is the foot. The hips stand at `STAND` of the stretched legs' length,
    each foot below the leg's second joint. Raises InputError.
    """
    found = {}
    for leaf in robot.leaves():
        moving = tuple(joint.name for joint in robot.way(leaf, robot.base) if joint.type in MOVING)
        if len(moving) >= 3:
            chain = urdf_chain(robot, leaf)
            low = chain.end(_middle(chain.lower_rad, chain.upper_rad))[2]
            if moving not in found or low < found[moving][0]:
                found[moving] = (low, leaf, chain)
    if len(found) != 4:
        ends = ", ".join(leaf for _, leaf, _ in found.values()) or "none"
        expected = "four legs of three or more joints, and no arm"
        raise InputError(Problem(robot.path, "legs", f"{len(found)} chains: {ends}", expected))
    chains = [chain for _, _, chain in found.values()]
    hips = np.array([chain.positions(np.zeros(chain.n))[1] for chain in chains])
    middle = hips.mean(axis=0)
    labels = [f"{'L' if y > 0 else 'R'}{'F' if x > 0 else 'H'}" for x, y, _ in hips - middle]
    if sorted(labels) != sorted(LEGS):
        places = "; ".join(f"({x:.2f}, {y:.2f})" for x, y, _ in hips)
        expected = "one at each corner, x forwards and y left"
        raise InputError(Problem(robot.path, "hips", places, expected))
    lengths = [float(chain.lengths_m[1:].sum()) for chain in chains]
    stand = STAND * min(lengths)
    if not stand > SHORTEST_M:
        raise InputError(Problem(robot.path, "legs", f"{min(lengths):g} m long", f"legs longer than {SHORTEST_M:g} m"))
    legs, problems = {}, []
    for label, hip, chain in zip(labels, hips, chains, strict=True):
        neutral = hip - [0.0, 0.0, stand]
        home = standing(chain, neutral)
        if home is None:
            problems.append(Problem(robot.path, f"leg {label}", f"no way to stand {stand:.3f} m high", "one"))
        else:
            legs[label] = ChainLeg(chain.names, chain, neutral, home)
    if problems:
        raise InputError(problems)
    ordered = {label: legs[label] for label in LEGS}
    return _checked_robot(Quadruped(robot.name, robot.name, ordered, stand, str(robot.path)))


def _middle(lower: np.ndarray, upper: np.ndarray) -> np.ndarray:
    bounded = np.isfinite(lower) & np.isfinite(upper)
    return np.where(bounded, np.where(bounded, lower, 0.0) + np.where(bounded, upper, 0.0), 0.0) / 2
