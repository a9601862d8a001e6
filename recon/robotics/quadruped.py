"""Describe four-legged robots: hips, and legs with the names, limits and rates of their joints.

Robots are read from files: TOML with dimensions and limits (docs/robot.md), URDF or MJCF. The built-in robots are the
files in `robots`.

Body axes: x forwards, y left, z up. Legs are LF, RF, LH, RH (left or right, fore or hind). Joint angles are the robot's
own: for robots described by their dimensions, such as the built-in ones, the angles of the closed form with signs; for
URDF and MJCF, the angles of the file. World: z up. Yaw, pitch and roll turn about z, y and x in this order, so that a
positive pitch puts the nose down.

A leg of three joints has a closed form: swing, flap and knee, with offsets at the knee and the foot. Leg axes have
their origin at the hip: x lateral (outwards), y forward, z up, as seen at the right front leg. For the other legs x, y
or both are mirrored, and the angles have the same meaning. Symbols: a swing, b flap, s knee; l1 thigh, l2 shin, uo
offset at the knee, lo at the foot. In the plane of the leg the foot is P forward of the hip and Q below:

    P = lo cos s + l2 sin s + uo        Q = l1 + l2 cos s - lo sin s

If the swing joint comes first and carries the flap joint (as in the Sony Aibo):

    x = Q sin b        y = Q cos b sin a + P cos a        z = P sin a - Q cos a cos b

If the flap joint comes first and the swing joint is `lateral_m` = d further out (as in most robots of today), Y and Z
are the position in the plane that the flap joint turns:

    Y = Q sin a + P cos a        Z = P sin a - Q cos a
    x = d cos b - Z sin b        y = Y        z = d sin b + Z cos b

The inverse starts at the knee, from P^2 + Q^2 = n^2, the squared distance of the foot from the swing joint:

    s = atan2(q, p) -+ acos(-r / sqrt(p^2 + q^2))
    p = 2 (uo lo + l1 l2)    q = 2 (l2 uo - l1 lo)    r = lo^2 + l2^2 + uo^2 + l1^2 - n^2

The two signs are the two ways to bend the knee. The solution beyond the stretched leg, atan2(q, p), is used, so that
the knee never bends backwards. The other angles follow from linear pairs. Two flap angles reach a foot, one with the
leg pointing down and one with the leg pointing up; the one within 90 degrees of down is used.
"""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from types import ModuleType
from typing import Annotated, Any, Literal, TypeAlias
from xml.etree import ElementTree

import numpy as np
from numpy.typing import ArrayLike
from pydantic import AfterValidator, Field
from scipy.spatial.transform import RigidTransform, Rotation

from recon.base.arrays import Array
from recon.base.documents import FileTable, builtin_names, named_table, utf8_path, validated
from recon.base.errors import InputError, Problem, raise_problems
from recon.base.package import install_command
from recon.geometry.kinematics import Marker, Segment, Tree
from recon.ik.chain import MAX_RATE_RAD_S, SerialChain, joint_chain
from recon.ik.drive import drive_to
from recon.ik.methods import LeastNorm

MjModel: TypeAlias = Any
MjSpec: TypeAlias = Any
"""MuJoCo's model and specification. The package mujoco has no types."""
LEGS = ("LF", "RF", "LH", "RH")
"""Labels of the legs in the order of all arrays: left or right, fore or hind."""
IK_TOLERANCE_M = 1e-5
"""Distance from its target within which a foot has reached it."""
_BISECTIONS = 12
"""Number of bisections of the height to which a leg can lift its foot."""


# -- a leg in closed form ----------------------------------------------------------------------------------------------

LEG_ANGLES = ("swing", "flap", "knee")
Length = Annotated[float, Field(strict=True, gt=-1e6, lt=1e6, allow_inf_nan=False)]
PositiveLength = Annotated[float, Field(strict=True, gt=1e-6, lt=1e6, allow_inf_nan=False)]
"""Numbers in the file of a robot or a recipe, mostly metres or radians. The limits only reject damaged files."""


def _ordered(limits: tuple[float, float]) -> tuple[float, float]:
    if limits[0] > limits[1]:
        raise ValueError("the lower limit first")
    return limits


Limits = Annotated[tuple[Length, Length], AfterValidator(_ordered)]

_ROUNDING = 1e-12
"""Distance beyond the reach, as a fraction of the leg, that still counts as reached, so that a stretched leg reaches
its own foot.
"""


@dataclass(frozen=True)
class Leg:
    """A leg with a thigh and a shin.

    Feet have shape (..., 3), in leg axes. Angles are swing, flap and knee, shape (..., 3), radians.
    """

    __pydantic_config__ = FileTable.model_config
    first: Literal["swing", "flap"]
    """Joint next to the body."""
    thigh_m: PositiveLength
    shin_m: PositiveLength
    knee_offset_m: Length = 0.0
    """Offset forwards, at right angles to the thigh."""
    foot_offset_m: Length = 0.0
    """Offset forwards, at right angles to the shin."""
    lateral_m: Length = 0.0
    """Distance from the flap joint out to the swing joint, if the flap joint comes first."""
    mirror: tuple[float, float, float] = (1.0, 1.0, 1.0)
    """Factor 1 or -1 for each leg axis: 1 as in the right front leg, -1 mirrored."""

    @property
    def order(self) -> list[int]:
        """Return the indices into (swing, flap, knee) in the order of the joints from the hip down."""
        return [0, 1, 2] if self.first == "swing" else [1, 0, 2]

    @cached_property
    def chain(self) -> SerialChain:
        """Return the leg as a chain of joints from the hip down, not mirrored."""
        out, swing, flap = (self.lateral_m, 0.0, 0.0), (1, 0, 0), (0, -1, 0)
        return joint_chain(
            [(0, 0, 0), out, (0.0, self.knee_offset_m, -self.thigh_m)],
            [swing, flap, swing] if self.first == "swing" else [flap, swing, swing],
            tool_m=(0.0, self.foot_offset_m, -self.shin_m),
        )

    @property
    def stretched_rad(self) -> float:
        """Return the knee angle at which the foot is farthest from the swing joint."""
        p, q, _ = self._pqr
        return float(np.arctan2(q, p))

    @property
    def distances_m(self) -> tuple[float, float]:
        """Return the smallest and the largest distance of the foot from the swing joint."""
        upper, lower = np.hypot(self.thigh_m, self.knee_offset_m), np.hypot(self.shin_m, self.foot_offset_m)
        return float(abs(upper - lower)), float(upper + lower)

    @property
    def _pqr(self) -> tuple[float, float, float]:
        """Return p, q and r + n^2 of the inverse of the knee, as defined in the module's docstring."""
        l1, l2, uo, lo = self.thigh_m, self.shin_m, self.knee_offset_m, self.foot_offset_m
        return 2 * (uo * lo + l1 * l2), 2 * (l2 * uo - l1 * lo), lo * lo + l2 * l2 + uo * uo + l1 * l1

    def in_plane(self, knee_rad: Array) -> tuple[Array, Array]:
        """Return the foot's coordinates P and Q (...) in the plane of the leg, in metres."""
        c, s = np.cos(knee_rad), np.sin(knee_rad)
        P = self.foot_offset_m * c + self.shin_m * s + self.knee_offset_m
        return P, self.thigh_m + self.shin_m * c - self.foot_offset_m * s

    def forward(self, angles_rad: ArrayLike) -> Array:
        """Return the positions (..., 3) of the feet relative to the hip for angles (..., 3)."""
        return self.chain.end(np.asarray(angles_rad, float)[..., self.order]) * self.mirror

    def inverse(self, feet_m: ArrayLike) -> Array:
        """Return the angles (..., 3) for feet (..., 3); NaN if a foot is out of reach. Joint limits are ignored."""
        x, y, z = np.moveaxis(np.asarray(feet_m, float) * self.mirror, -1, 0)
        d, swing_first = self.lateral_m, self.first == "swing"
        z2 = x * x + z * z - d * d
        n2 = x * x + y * y + z * z if swing_first else np.maximum(z2, 0.0) + y * y
        p, q, r_plus_n2 = self._pqr
        cosine = (n2 - r_plus_n2) / np.hypot(p, q)
        s = np.arctan2(q, p) + np.arccos(np.clip(cosine, -1.0, 1.0))
        P, Q = self.in_plane(s)
        # U^2 = y^2 + z^2 - P^2 with atan2: asin(x / Q) would lose half the digits at 90 degrees.
        square = y * y + z * z - P * P if swing_first else z2
        root = np.sqrt(np.maximum(square, 0.0))
        if swing_first:
            up = np.where(Q < 0, -1.0, 1.0)
            a, b = _wrapped(np.arctan2(z, y) + np.arctan2(up * root, P)), np.arctan2(up * x, root)
        else:
            # (x, z) is (d, Z) turned by b; (y, Z) is (P, -Q) turned by a.
            a = _wrapped(np.arctan2(-root, y) + np.arctan2(Q, P))
            b = _wrapped(np.arctan2(z, x) - np.arctan2(-root, d))
        longest = np.hypot(self.distances_m[1], d)
        reached = (np.abs(cosine) <= 1 + _ROUNDING) & (square >= -_ROUNDING * longest**2)
        return np.where(reached[..., None], np.stack([a, b, s], axis=-1), np.nan)

    def slack_m(self, feet_m: Array) -> Array:
        """Return the distance (...) of feet from the edge of the reach, negative outside.

        Only for a leg whose swing joint comes first.
        """
        distance, (shortest, longest) = np.linalg.norm(feet_m, axis=-1), self.distances_m
        p, q, r_plus_n2 = self._pqr
        bend = np.arccos(np.clip((distance**2 - r_plus_n2) / np.hypot(p, q), -1.0, 1.0))
        # The foot of a bent leg cannot come closer than P to the axis of the swing joint.
        beyond_axis = np.hypot(feet_m[..., 1], feet_m[..., 2]) - np.abs(self.in_plane(self.stretched_rad + bend)[0])
        return np.minimum(np.minimum(distance - shortest, longest - distance), beyond_axis)


def _wrapped(angle: Array) -> Array:
    """Return an angle in [-pi, pi)."""
    return (angle + np.pi) % (2 * np.pi) - np.pi


# -- legs and robots ---------------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class RobotLeg:
    """A leg of n joints, in order from the hip down; feet are points in body axes."""

    chain: SerialChain
    """Chain of the joints in body axes, with names and limits. Its end effector is the foot."""
    neutral_m: Array
    """(3,): foot of the standing leg."""
    home_rad: Array | None = None
    """(n,): angles of the standing leg, from which the angles of a leg without a closed form are solved; None if the
    leg cannot stand.
    """
    closed: Leg | None = None
    """Closed form of the leg, in leg axes."""
    signs: Array | None = None
    """(n,): signs of the joints' own angles relative to those of the closed form."""

    @property
    def joints(self) -> tuple[str, ...]:
        """Return the names of the leg's joints."""
        return self.chain.names

    @cached_property
    def hip_m(self) -> Array:
        """Return the position (3,) of the first joint in body axes."""
        return self.chain.positions(np.zeros(self.chain.n))[0]

    def margins(self, angles_rad: Array) -> Array:
        """Return the distance (..., n) of each angle from its nearer limit, negative outside, NaN for NaN angles."""
        return np.minimum(angles_rad - self.chain.lower_rad, self.chain.upper_rad - angles_rad)

    def closed_angles(self, feet_m: Array) -> Array:
        """Return angles (T, n) for feet (T, 3) in closed form; NaN if out of reach. Joint limits are ignored."""
        assert self.closed is not None
        assert self.signs is not None
        return self.closed.inverse(_to_leg_axes(feet_m - self.hip_m))[..., self.closed.order] * self.signs

    def slack_m(self, feet_m: Array) -> Array:
        """Return the distance (T,) of feet (T, 3) from the edge of the closed form's reach, negative outside."""
        assert self.closed is not None
        return self.closed.slack_m(_to_leg_axes(feet_m - self.hip_m))

    def angles(self, feet_m: Array) -> Array:
        """Return angles (T, n) for feet (T, 3), each close to the previous ones; NaN if none is within the limits."""
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
    """Masses of a robot and the torques of its motors, those of a leg in the order of its joints."""

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
    """Legs by label: LF, RF, LH, RH, in this order."""
    stand_m: float
    """Standing height of the hips."""
    source: str = ""
    masses: Masses | None = None
    """Masses, for a robot that is described by its dimensions."""

    @property
    def joints(self) -> tuple[str, ...]:
        """Return the names of all legs' joints, in the order of `LEGS`."""
        return tuple(name for leg in self.legs.values() for name in leg.joints)

    def limits(self) -> tuple[Array, Array, Array]:
        """Return the lower limits, upper limits and fastest rates (joints,) of the joints of all legs."""
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
        """Return the height of the ground in body axes when the robot stands: the mean height of its feet."""
        return float(np.mean([leg.neutral_m[2] for leg in self.legs.values()]))

    @cached_property
    def folding_m(self) -> Array:
        """Return the height (4,) to which each leg can lift its foot when the robot stands, in the order of `LEGS`."""
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
    # Rates should not limit a single position, so every iteration lasts as long as the slowest joint needs for a turn.
    interval = 2 * np.pi / float(chain.max_rate_rad_s.min())
    run = drive_to(chain, q, foot_m, LeastNorm(), IK_TOLERANCE_M, max_iterations=200, interval_s=interval)
    return run.q[-1] if run.reached else None


def standing(chain: SerialChain, foot_m: Array) -> Array | None:
    """Return the angles (n,) of the standing leg, or None if no angles are found.

    The search starts from the middle of the limits, then from random angles within the limits.
    """
    turns = _turns(chain)
    starts = [turns.mean(axis=0), *np.random.default_rng(0).uniform(turns[0], turns[1], (30, chain.n))]
    candidates = (reach(chain, q, foot_m) for q in starts)
    return next((q for q in candidates if q is not None), None)


def _to_leg_axes(v: Array) -> Array:
    return np.stack([-v[..., 1], v[..., 0], v[..., 2]], axis=-1)


# -- the body on its feet ----------------------------------------------------------------------------------------------


def body_pose(position_m: ArrayLike, roll_rad: ArrayLike, pitch_rad: ArrayLike, yaw_rad: ArrayLike) -> RigidTransform:
    """Return T_world_body for positions (..., 3) and angles (...)."""
    angles = np.stack(np.broadcast_arrays(yaw_rad, pitch_rad, roll_rad), axis=-1)
    return RigidTransform.from_components(np.asarray(position_m, float), Rotation.from_euler("ZYX", angles))


def leg_targets(pose: RigidTransform, hips_m: ArrayLike, feet_m: ArrayLike) -> Array:
    """Return the feet relative to their hips, in body axes (..., L, 3).

    `pose` is T_world_body (...). Hips are (L, 3) in body axes; feet are (L, 3) or (..., L, 3) in the world.
    """
    hips, feet = np.asarray(hips_m, float), np.asarray(feet_m, float)
    position, R = np.asarray(pose.translation), np.asarray(pose.rotation.as_matrix())
    return np.einsum("...lj,...jk->...lk", feet - position[..., None, :], R) - hips


def feet_in_world(pose: RigidTransform, hips_m: ArrayLike, targets_m: ArrayLike) -> Array:
    """Return the feet (..., L, 3) in the world from their positions relative to the hips; see `leg_targets`."""
    position, R = np.asarray(pose.translation), np.asarray(pose.rotation.as_matrix())
    return np.einsum("...lk,...jk->...lj", np.asarray(targets_m) + np.asarray(hips_m), R) + position[..., None, :]


# -- robot files: TOML with dimensions and limits, URDF or MJCF --------------------------------------------------------

STAND = 0.7
"""Standing height of the hips as a fraction of the stretched leg's length, for a robot from a URDF or MJCF file."""
SHORTEST_M = 1e-3
"""Smallest length of a leg in a URDF or MJCF file."""
SUFFIXES = (".urdf", ".xml")
LARGEST = 1e6
"""Largest plausible length or angle: larger numbers mean a damaged file."""
LEAST_MASS_KG = 1e-6
"""Mass of links without one in the file; kinematics does not depend on it."""
LEAST_INERTIA_KG_M2 = 1e-9
"""Moment of inertia of links without one in the file; kinematics does not depend on it."""


class _Joint(FileTable):
    limits_rad: Limits
    max_rate_rad_s: PositiveLength


class _Joints(FileTable):
    swing: _Joint
    flap: _Joint
    knee: _Joint


class _JointPlace(FileTable):
    hip_m: tuple[Length, Length, Length]
    knee_bends: Literal["backwards", "forwards"] = "backwards"
    swing: str
    flap: str
    knee: str


class _Legs(FileTable):
    LF: _JointPlace
    RF: _JointPlace
    LH: _JointPlace
    RH: _JointPlace


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
    """Return a built-in robot by name, or a robot from a file: .toml, .urdf or .xml (MJCF).

    Raises InputError if the file is not valid, if the robot cannot stand, or if joints share a name.
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
    detail = f"leg {label} does not reach the ground within its limits"
    return Problem(source, "stand_m", detail, "a height at which the robot can stand")


def _quadruped_of_model(path: Path) -> Quadruped:
    """Return a robot from a URDF or MJCF file.

    The legs are the four chains of at least three moving joints that end in a leaf. The positions of the hips decide
    which leg is which. If several leaves hang on the same joints, the lowest one is the foot. The hips stand at `STAND`
    of the stretched legs' length, each foot below the second joint of its leg. Raises InputError if the number of
    chains is not four.
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
        places = "; ".join(f"({x:.2f}, {y:.2f})" for x, y, _ in hips)
        raise InputError(Problem(path, "hips", places, "one at each corner, x forwards and y left"))
    shortest = min(float(chain.lengths_m[1:].sum()) for chain in chains)
    stand = STAND * shortest
    if not stand > SHORTEST_M:
        raise InputError(Problem(path, "legs", f"{shortest:g} m long", f"legs longer than {SHORTEST_M:g} m"))
    neutral = hips - [0.0, 0.0, stand]
    legs = {}
    for label, chain, foot in zip(labels, chains, neutral, strict=True):
        # The search takes a second, and the other legs usually fail too: stop at the first.
        if (home := standing(chain, foot)) is None:
            raise InputError(_cannot_stand(str(path), label))
        legs[label] = RobotLeg(chain, foot, home)
    called = model.names.split(b"\0")[0].decode() or path.stem
    return Quadruped(called, called, {label: legs[label] for label in LEGS}, stand, str(path))


def _turns(chain: SerialChain) -> Array:
    """Return the limits (2, n), with half a turn each way for joints without limits."""
    return np.array([np.maximum(chain.lower_rad, -np.pi), np.minimum(chain.upper_rad, np.pi)])


# -- models read by MuJoCo (extra robots), without meshes: these need more files, and kinematics does not need them ----


def require_mujoco(source: str | Path) -> ModuleType:
    """Return the module mujoco; raise InputError about `source` if the module is not installed."""
    try:
        import mujoco
    except ImportError:
        expected = f"the package mujoco: {install_command('robots')}"
        raise InputError(Problem(source, "robot", "MuJoCo is not installed", expected)) from None
    return mujoco


def read_model(path: str | Path, free: bool = False) -> MjModel:
    """Return MuJoCo's model of a file, with its fixed joints and without its meshes.

    If `free` is true, the root of the model moves freely in the world. Raises InputError for other kinds of files, and
    if MuJoCo is not installed.
    """
    path = Path(path)
    mujoco = require_mujoco(path)
    if not path.is_file():
        raise InputError(Problem(path, "file", "no such file", "a URDF or MJCF file"))
    name = utf8_path(path)
    mujoco.set_mju_user_warning(lambda message: None)  # MuJoCo would write warnings to a file in the working folder
    try:
        spec = mujoco.MjSpec.from_file(name)
        spec.compiler.fusestatic = False
        spec.compiler.boundmass, spec.compiler.boundinertia = LEAST_MASS_KG, LEAST_INERTIA_KG_M2
        for geom in [geom for geom in spec.geoms if geom.type == mujoco.mjtGeom.mjGEOM_MESH]:
            spec.delete(geom)
        for mesh in list(spec.meshes):
            spec.delete(mesh)
        if free and not any(joint.type == mujoco.mjtJoint.mjJNT_FREE for joint in spec.joints):
            spec.worldbody.first_body().add_freejoint()
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # warnings about moving parts without mass: kinematics needs no masses
            model = spec.compile()
    except (ValueError, RuntimeError, mujoco.FatalError) as error:  # MuJoCo raises these also if it runs out of memory
        detail = " ".join(str(error).split())[:160]
        raise InputError(Problem(path, "content", detail, "a URDF or MJCF file")) from None
    for quantity, numbers in {"links": model.body_pos, "limits": model.jnt_range}.items():
        if not (np.abs(numbers) < LARGEST).all():
            raise InputError(Problem(path, quantity, "implausibly large numbers", "metres and radians"))
    return model


def rates_of(path: Path) -> dict[str, float]:
    """Return the joints' maximum rates from a URDF file; MuJoCo does not keep them.

    The result is empty for MJCF, which has no rates. Raises InputError for limits that are not numbers.
    """
    try:
        stated = {j.get("name", ""): j.find("limit") for j in ElementTree.parse(path).getroot().iter("joint")}
        limits = {
            name: [float(limit.get(bound) or 0) for bound in ("lower", "upper", "velocity")]
            for name, limit in stated.items()
            if limit is not None
        }
    except (ElementTree.ParseError, ValueError) as error:
        raise InputError(Problem(path, "limit", str(error)[:120], "a complete file with numbers as limits")) from None
    rates = {name: rate for name, (_, _, rate) in limits.items() if rate}
    wrong = [(n, f"limits {low:g}, {up:g}", "the lower limit first") for n, (low, up, _) in limits.items() if low > up]
    wrong += [(n, f"velocity {r:g}", "a rate above 0") for n, r in rates.items() if not 1e-6 < r < LARGEST]
    raise_problems(Problem(path, f"joint {name}", detail, expected) for name, detail, expected in wrong)
    return rates


def body_names(model: MjModel) -> list[str]:
    """Return the names of all bodies except the world; a body without a name is called by its number, "body 3"."""
    return [model.body(k).name or f"body {k}" for k in range(1, model.nbody)]


def root_of(model: MjModel) -> int:
    """Return the index of the body that moves freely in the world, or of the first body."""
    free = [int(model.jnt_bodyid[j]) for j in range(model.njnt) if model.jnt_type[j] == 0]
    return free[0] if free else 1


def leaves_of(model: MjModel) -> list[int]:
    """Return the indices of the bodies without a child."""
    return [k for k in range(1, model.nbody) if k not in model.body_parentid[1:]]


def foot_of(model: MjModel, leaf: int) -> Array:
    """Return the position (3,) of the foot in the axes of a leaf.

    The foot is at the leaf's origin if no joint moves the leaf. Otherwise, as at the ends of legs in MJCF files, the
    foot is the centre of the leaf's farthest sphere, or of its farthest shape if there is no sphere.
    """
    shapes = [g for g in range(model.ngeom) if model.geom_bodyid[g] == leaf]
    shapes = [g for g in shapes if model.geom_type[g] == 2] or shapes
    if not model.body_jntnum[leaf] or not shapes:
        return np.zeros(3)
    return np.array(max((model.geom_pos[g] for g in shapes), key=np.linalg.norm))


def bodies_to(model: MjModel, tip: int) -> list[int]:
    """Return the bodies from the root (not included) to `tip`; none if `tip` is not a descendant of the root."""
    bodies, root = [], root_of(model)
    while tip not in (root, 0):
        bodies.append(tip)
        tip = int(model.body_parentid[tip])
    return bodies[::-1] if tip == root else []


def moving(model: MjModel, bodies: list[int]) -> list[int]:
    """Return the indices of the joints of bodies, in the order of the bodies."""
    return [j for k in bodies for j in range(model.body_jntadr[k], model.body_jntadr[k] + model.body_jntnum[k])]


def model_chain(model: MjModel, path: Path, tip: str, end_m: ArrayLike = (0.0, 0.0, 0.0)) -> SerialChain:
    """Return the chain from the root to a body, with its limits; fixed joints become part of the links.

    The chain is in the root's axes, and its end effector is at `end_m` (3,) in the axes of the tip. An angle without
    limits turns freely; a joint without a rate gets `MAX_RATE_RAD_S`. Raises InputError if a joint neither turns nor
    slides.
    """
    names, start = body_names(model), root_of(model)
    if tip not in names:
        raise InputError(Problem(path, "link", repr(tip), ", ".join(names)))
    way = bodies_to(model, last := names.index(tip) + 1)
    joints = moving(model, way)
    if not joints:
        detail = f"no moving joint from {names[start - 1]} to {tip}"
        raise InputError(Problem(path, "chain", detail, "a link moved by joints"))
    unlike = [model.joint(j).name for j in joints if model.jnt_type[j] not in (2, 3)]  # MuJoCo: 2 is a slide, 3 a hinge
    raise_problems(Problem(path, f"joint {name}", "another kind", "joints that turn or slide") for name in unlike)
    mujoco = require_mujoco(path)
    mujoco.mj_kinematics(model, data := mujoco.MjData(model))  # all joints at 0
    root_axes, tip_axes = (data.xmat[body].reshape(3, 3) for body in (start, last))
    end = data.xpos[last] + tip_axes @ np.asarray(end_m, dtype=float)
    steps = np.diff([data.xpos[start], *data.xanchor[joints], end], axis=0) @ root_axes
    axes, turns = data.xaxis[joints] @ root_axes, model.body_quat[way]
    if not np.isfinite([*steps, *axes]).all() or not (axes.any(axis=1).all() and turns.any(axis=1).all()):
        # numbers in the file that overflow to infinity or NaN
        lost = f"a joint between the root and {tip} without an axis or a position"
        raise InputError(Problem(path, "chain", lost, "axes of joints, and positions in metres"))
    rates = rates_of(path)
    limits = np.where(model.jnt_limited[joints, None], model.jnt_range[joints], [-np.inf, np.inf])
    called = tuple(model.joint(j).name or f"joint {j}" for j in joints)
    return joint_chain(
        steps[:-1],
        axes,
        model.jnt_type[joints] == 2,
        steps[-1],
        Rotation.from_matrix(root_axes.T @ tip_axes),
        (limits[:, 0], limits[:, 1]),
        np.array([rates.get(name, MAX_RATE_RAD_S) for name in called]),
        called,
    )
