"""Describe four-legged robots by their hips, and by the names, limits and rates of their joints.

Robots are read from files: TOML with dimensions and limits (docs/robot.md), URDF or MJCF. The built-in robots are the
files in `robots`.

In body axes, x is forward, y left and z up. In the world, z is up. Legs are LF, RF, LH, RH (left or right, fore or
hind). Joint angles follow the robot's own convention. Robots described by their dimensions, such as the built-in ones,
have the angles of the closed form with signs. Robots from URDF and MJCF have the angles of the file. Yaw, pitch and
roll turn about z, y and x in this order, so that a positive pitch puts the nose down.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import RigidTransform, Rotation

from recon.base.arrays import Array
from recon.base.documents import FileTable, builtin_names, named_table, validated
from recon.base.errors import InputError, Problem, raise_problems
from recon.geometry.kinematics import Marker, Segment, Tree
from recon.ik.chain import SerialChain, joint_chain
from recon.ik.drive import drive_to
from recon.ik.methods import LeastNorm
from recon.robotics.leg import LEG_ANGLES, Leg, Length, Limits, PositiveLength
from recon.robotics.models import bodies_to, body_names, foot_of, leaves_of, model_chain, moving, read_model

LEGS = ("LF", "RF", "LH", "RH")
"""Labels of the legs in the order of all arrays: left or right, fore or hind."""
IK_TOLERANCE_M = 1e-5
"""Distance from its target in metres within which a foot counts as having reached the target."""
_BISECTIONS = 12
"""Number of bisections in the search for the height to which a leg can lift its foot."""


@dataclass(frozen=True, eq=False)
class RobotLeg:
    """A leg of n joints, ordered from the hip down. Feet are positions in body axes, metres."""

    chain: SerialChain
    """Chain of the joints in body axes, with names and limits. Its end effector is the foot."""
    neutral_m: Array
    """Position of the foot of the standing leg in body axes, shape (3,), metres."""
    home_rad: Array | None = None
    """Angles of the standing leg in rad, shape (n,), or None if the leg cannot stand.

    A leg without a closed form is solved from these angles.
    """
    closed: Leg | None = None
    """Closed form of the leg, in leg axes."""
    signs: Array | None = None
    """Signs of the joints' own angles relative to the angles of the closed form, shape (n,)."""

    @property
    def joints(self) -> tuple[str, ...]:
        """Return the names of the leg's joints."""
        return self.chain.names

    @cached_property
    def hip_m(self) -> Array:
        """Return the position (3,) of the leg's first joint in body axes, metres."""
        return self.chain.positions(np.zeros(self.chain.n))[0]

    def margins(self, angles_rad: Array) -> Array:
        """Return the distance of each angle (..., n) from its nearer limit in rad, negative outside; NaN for NaN."""
        return np.minimum(angles_rad - self.chain.lower_rad, self.chain.upper_rad - angles_rad)

    def closed_angles(self, feet_m: Array) -> Array:
        """Return closed-form angles in rad, shape (T, n), for feet (T, 3), without limits; NaN if out of reach."""
        assert self.closed is not None
        assert self.signs is not None
        return self.closed.inverse(_to_leg_axes(feet_m - self.hip_m))[..., self.closed.order] * self.signs

    def slack_m(self, feet_m: Array) -> Array:
        """Return the distance (T,) of feet (T, 3) from the edge of the closed form's reach in m, negative outside."""
        assert self.closed is not None
        return self.closed.slack_m(_to_leg_axes(feet_m - self.hip_m))

    def angles(self, feet_m: Array) -> Array:
        """Return joint angles in rad, shape (T, n), for feet (T, 3) in sequence; NaN if none are within the limits."""
        if self.closed is not None:
            solved = self.closed_angles(feet_m)
            return np.where(np.all(self.margins(solved) >= 0, axis=-1)[..., None], solved, np.nan)
        out, q = np.full((len(feet_m), self.chain.n), np.nan), self.home_rad
        if q is None or self.home_rad is None:
            return out
        for k, foot in enumerate(feet_m):
            solution = reach(self.chain, q, foot)
            if solution is None and q is not self.home_rad:
                solution = reach(self.chain, self.home_rad, foot)
            if solution is not None:
                out[k] = q = solution
        return out


@dataclass(frozen=True)
class Masses:
    """Masses and maximum torques of a robot, with the links and torques of a leg ordered from the hip down."""

    __pydantic_config__ = FileTable.model_config
    body_kg: PositiveLength
    body_inertia_kg_m2: tuple[PositiveLength, PositiveLength, PositiveLength]
    links_kg: tuple[PositiveLength, PositiveLength, PositiveLength]
    foot_kg: PositiveLength
    max_torque_n_m: tuple[PositiveLength, PositiveLength, PositiveLength]


@dataclass(frozen=True, eq=False)
class Quadruped:
    """A robot with four legs."""

    name: str
    title: str
    legs: Mapping[str, RobotLeg]
    """Legs, keyed by their labels LF, RF, LH and RH, in this order."""
    stand_m: float
    """Standing height of the hips, metres."""
    source: str = ""
    masses: Masses | None = None
    """Masses of a robot that is described by its dimensions; None if they are not known."""

    @property
    def joints(self) -> tuple[str, ...]:
        """Return the names of all legs' joints, in the order of `LEGS`."""
        return tuple(name for leg in self.legs.values() for name in leg.joints)

    def limits(self) -> tuple[Array, Array, Array]:
        """Return the lower limits (rad), upper limits (rad) and maximum rates (rad/s) of all joints, (joints,) each."""
        names = ("lower_rad", "upper_rad", "max_rate_rad_s")
        chains = [leg.chain for leg in self.legs.values()]
        lower, upper, rate = (np.concatenate([getattr(chain, name) for chain in chains]) for name in names)
        return lower, upper, rate

    @cached_property
    def tree(self) -> Tree:
        """Return the kinematic tree of the body, which moves freely in the world, and of all legs.

        The state is the body's position, yaw, pitch and roll, then `joints`. The markers are the body's origin and the
        joints and the foot of each leg.
        """
        segments, markers = [Segment("base", None, "free")], [Marker("base", "base")]
        for label, leg in self.legs.items():
            leg_tree = leg.chain.tree
            called = {segment.name: f"{label} {segment.name}" for segment in leg_tree.segments[1:]} | {"base": "base"}
            for segment in leg_tree.segments[1:]:
                parent = called[segment.parent or "base"]
                segments.append(replace(segment, name=called[segment.name], parent=parent))
                markers.append(Marker(called[segment.name], called[segment.name]))
            foot = leg_tree.markers[0]
            markers.append(replace(foot, name=f"{label} foot", segment=called[foot.segment]))
        return Tree(tuple(segments), tuple(markers))

    @cached_property
    def foot_markers(self) -> list[int]:
        """Return the indices of the feet among the tree's markers, in the order of `LEGS`."""
        names = [marker.name for marker in self.tree.markers]
        return [names.index(f"{label} foot") for label in LEGS]

    @cached_property
    def ground_m(self) -> float:
        """Return the height of the ground in body axes when the robot stands, which is the mean height of its feet."""
        return float(np.mean([leg.neutral_m[2] for leg in self.legs.values()]))

    @cached_property
    def folding_m(self) -> Array:
        """Return the height (4,) to which each leg of the standing robot can lift its foot, in the order of `LEGS`."""
        heights = []
        for leg in self.legs.values():
            reached_m, unreached = 0.0, -float(leg.neutral_m[2])
            for _ in range(_BISECTIONS):
                height = (reached_m + unreached) / 2
                reached = np.isfinite(leg.angles((leg.neutral_m + np.array([0.0, 0.0, height]))[None])).all()
                reached_m, unreached = (height, unreached) if reached else (reached_m, height)
            heights.append(reached_m)
        return np.array(heights)


def reach(chain: SerialChain, q: Array, foot_m: Array) -> Array | None:
    """Return angles (n,) within the limits that put the end effector at `foot_m`, or None if a search from q fails."""
    # Rates must not limit a single position, so every iteration lasts as long as the slowest joint needs for a turn.
    interval = 2 * np.pi / float(chain.max_rate_rad_s.min())
    run = drive_to(chain, q, foot_m, LeastNorm(), IK_TOLERANCE_M, max_iterations=200, interval_s=interval)
    return run.q[-1] if run.reached else None


def standing(chain: SerialChain, foot_m: Array) -> Array | None:
    """Search for the angles (n,) of the standing leg in rad, and return None if the search fails.

    The search starts from the middle of the limits, then from random angles within the limits.
    """
    turns = _turns(chain)
    starts = [turns.mean(axis=0), *np.random.default_rng(0).uniform(turns[0], turns[1], (30, chain.n))]
    candidates = (reach(chain, q, foot_m) for q in starts)
    return next((q for q in candidates if q is not None), None)


def _to_leg_axes(v: Array) -> Array:
    return np.stack([-v[..., 1], v[..., 0], v[..., 2]], axis=-1)


def body_pose(position_m: ArrayLike, roll_rad: ArrayLike, pitch_rad: ArrayLike, yaw_rad: ArrayLike) -> RigidTransform:
    """Return T_world_body for body positions (..., 3) in metres and angles (...) in rad."""
    angles = np.stack(np.broadcast_arrays(yaw_rad, pitch_rad, roll_rad), axis=-1)
    return RigidTransform.from_components(np.asarray(position_m, float), Rotation.from_euler("ZYX", angles))


def leg_targets(pose: RigidTransform, hips_m: ArrayLike, feet_m: ArrayLike) -> Array:
    """Return the feet relative to their hips, in body axes (..., L, 3).

    `pose` is T_world_body (...). Hips are (L, 3) in body axes, and feet are (L, 3) or (..., L, 3) in the world.
    """
    hips, feet = np.asarray(hips_m, float), np.asarray(feet_m, float)
    position, R = np.asarray(pose.translation), np.asarray(pose.rotation.as_matrix())
    return np.einsum("...lj,...jk->...lk", feet - position[..., None, :], R) - hips


def feet_in_world(pose: RigidTransform, hips_m: ArrayLike, targets_m: ArrayLike) -> Array:
    """Return the feet (..., L, 3) in the world from their positions relative to the hips (`leg_targets`)."""
    position, R = np.asarray(pose.translation), np.asarray(pose.rotation.as_matrix())
    return np.einsum("...lk,...jk->...lj", np.asarray(targets_m) + np.asarray(hips_m), R) + position[..., None, :]


STANDING_HEIGHT = 0.7
"""Standing height of the hips as a fraction of the stretched leg's length, for a robot from a URDF or MJCF file."""
SHORTEST_M = 1e-3
"""Smallest length of a leg in a URDF or MJCF file."""
SUFFIXES = (".urdf", ".xml")


class _Joint(FileTable):
    limits_rad: Limits
    max_rate_rad_s: PositiveLength


class _Joints(FileTable):
    swing: _Joint
    flap: _Joint
    knee: _Joint


class _LegTable(FileTable):
    hip_m: tuple[Length, Length, Length]
    knee_bends: Literal["backwards", "forwards"] = "backwards"
    swing: str
    flap: str
    knee: str


class _Legs(FileTable):
    LF: _LegTable
    RF: _LegTable
    LH: _LegTable
    RH: _LegTable


class _RobotFile(FileTable):
    name: str
    title: str
    stand_m: PositiveLength
    leg: Leg
    joints: _Joints
    legs: _Legs
    masses: Masses | None = None


def builtin_robots() -> tuple[str, ...]:
    """Return the names of the built-in robots."""
    return builtin_names("robotics/robots", ".toml")


def load_robot(robot: str | Path) -> Quadruped:
    """Load the built-in robot of a given name, or a robot from a file (.toml, .urdf, or .xml for MJCF).

    Raises
    ------
    InputError
        If the file is not valid, if the robot cannot stand, or if joints share a name.
    """
    if (path := Path(robot)).suffix.lower() in SUFFIXES:
        robot_of_file = _quadruped_of_model(path)
    else:
        choice = (*builtin_robots(), "a .urdf or .xml file")
        table, _ = named_table(robot, "robotics/robots", "--robot", "robot", choice)
        robot_of_file = _quadruped(str(robot), table)
    problems = []
    if len({*robot_of_file.joints}) < len(robot_of_file.joints):
        problems.append(Problem(robot_of_file.source, "joints", "joints that share a name", "one name per joint"))
    for label, leg in robot_of_file.legs.items():
        if not np.isfinite(leg.angles(leg.neutral_m[None])).all():
            problems.append(_cannot_stand(robot_of_file.source, label))
    raise_problems(problems)
    return robot_of_file


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
        leg = replace(file.leg, mirror=mirror)
        typed = [getattr(placed, LEG_ANGLES[k]) for k in leg.order]
        signs = np.array([-1.0 if name.startswith("-") else 1.0 for name in typed])
        stands = np.array([leg.lateral_m, 0.0, -file.stand_m])
        straight = np.array([*leg.chain.positions(np.zeros(3)), *leg.chain.joint_axes(np.zeros(3)), stands]) * mirror
        in_body = np.column_stack([straight[:, 1], -straight[:, 0], straight[:, 2]])
        offsets = np.diff(placed.hip_m + in_body[:4], axis=0, prepend=0.0)
        lower, upper = np.sort(limits[:, leg.order] * signs, axis=0)
        chain = joint_chain(
            offsets[:3],
            # Mirroring reverses the axis of a rotation.
            in_body[4:7] * np.prod(mirror) * signs[:, None],
            tool_m=offsets[3],
            limits_rad=(lower, upper),
            max_rate_rad_s=np.array([joints[k].max_rate_rad_s for k in leg.order]),
            names=tuple(name.removeprefix("-") for name in typed),
        )
        legs[label] = RobotLeg(chain, placed.hip_m + in_body[7], closed=leg, signs=signs)
    return Quadruped(file.name, file.title, legs, file.stand_m, source, file.masses)


def _cannot_stand(source: str, label: str) -> Problem:
    detail = f"a height at which leg {label} does not reach the ground within its limits"
    return Problem(source, "stand_m", detail, "a height at which the robot can stand")


def _quadruped_of_model(path: Path) -> Quadruped:
    """Build a robot from a URDF or MJCF file.

    The legs are the four chains of at least three moving joints that end in a leaf. The positions of the hips decide
    which leg is which. If several leaves hang on the same joints, the lowest leaf is the foot. The hips stand at the
    fraction `STANDING_HEIGHT` of the stretched legs' length, with each foot below the second joint of its leg.
    """
    model = read_model(path)
    names, chain_of_leaf = body_names(model), {}
    for leaf in leaves_of(model):
        joints = tuple(moving(model, bodies_to(model, leaf)))
        if len(joints) >= 3:
            chain = model_chain(model, path, names[leaf - 1], end_m=foot_of(model, leaf))
            low = chain.end(_turns(chain).mean(axis=0))[2]
            if joints not in chain_of_leaf or low < chain_of_leaf[joints][0]:
                chain_of_leaf[joints] = (low, names[leaf - 1], chain)
    if len(chain_of_leaf) != 4:
        ends = ", ".join(leaf for _, leaf, _ in chain_of_leaf.values()) or "none"
        expected = "four legs of three or more joints, and no arm"
        raise InputError(Problem(path, "legs", f"{len(chain_of_leaf)} chains: {ends}", expected))
    chains = [chain for _, _, chain in chain_of_leaf.values()]
    hips = np.array([chain.positions(np.zeros(chain.n))[1] for chain in chains])
    labels = [f"{'L' if y > 0 else 'R'}{'F' if x > 0 else 'H'}" for x, y, _ in hips - hips.mean(axis=0)]
    if sorted(labels) != sorted(LEGS):
        hips_text = "; ".join(f"({x:.2f}, {y:.2f})" for x, y, _ in hips)
        raise InputError(Problem(path, "hips", hips_text, "one hip at each corner, with x forwards and y to the left"))
    shortest = min(float(chain.lengths_m[1:].sum()) for chain in chains)
    stand = STANDING_HEIGHT * shortest
    if not stand > SHORTEST_M:
        raise InputError(Problem(path, "legs", f"a leg {shortest:g} m long", f"legs longer than {SHORTEST_M:g} m"))
    neutral = hips - [0.0, 0.0, stand]
    legs = {}
    for label, chain, foot in zip(labels, chains, neutral, strict=True):
        # The search is slow, and if one leg fails, the others usually fail too, so stop at the first failure.
        if (home := standing(chain, foot)) is None:
            raise InputError(_cannot_stand(str(path), label))
        legs[label] = RobotLeg(chain, foot, home)
    called = model.names.split(b"\0")[0].decode() or path.stem
    return Quadruped(called, called, {label: legs[label] for label in LEGS}, stand, str(path))


def _turns(chain: SerialChain) -> Array:
    """Return the lower and upper limits in rad, shape (2, n), with half a turn each way for joints without limits."""
    return np.array([np.maximum(chain.lower_rad, -np.pi), np.minimum(chain.upper_rad, np.pi)])
