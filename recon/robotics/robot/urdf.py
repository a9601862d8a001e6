"""Chains from URDF files, for `recon.robotics.ik`. Reading needs `yourdfpy` (extra urdf)."""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
from scipy.spatial.transform import Rotation

from recon.base.arrays import Array
from recon.base.errors import InputError, Problem
from recon.base.package import install_command
from recon.robotics.ik.chain import MAX_RATE_RAD_S, SerialChain, joint_chain

LARGEST, SMALLEST = 1e6, 1e-6
"""Of a length or an angle; of a rate or an axis: more, or less, can only be damage."""
MOVING = ("revolute", "continuous", "prismatic")


@dataclass(frozen=True, eq=False)
class UrdfRobot:
    """A robot as its file describes it."""

    path: Path
    """Of the file."""
    name: str
    base: str
    """The root link."""
    joint_of: dict[str, Any]
    """The joint that each other link hangs on, by link."""

    @property
    def links(self) -> tuple[str, ...]:
        return (self.base, *self.joint_of)

    def leaves(self) -> tuple[str, ...]:
        """Links on which none hangs."""
        parents = {joint.parent for joint in self.joint_of.values()}
        return tuple(link for link in self.links if link not in parents)

    def way(self, tip: str, base: str) -> list[Any]:
        """The joints from base to tip; empty where the tip does not hang on the base."""
        joints, link = [], tip
        while link != base:
            if link not in self.joint_of:
                return []
            joints.append(self.joint_of[link])
            link = joints[-1].parent
        return joints[::-1]


def read_urdf(path: str | Path) -> UrdfRobot:
    """Raises InputError for a file that is none, and without `yourdfpy`."""
    path = Path(path)
    try:
        from yourdfpy import URDF
    except ImportError:
        expected = f"the package yourdfpy: {install_command('urdf')}"
        raise InputError(Problem(path, "format", "URDF, which is not installed", expected)) from None
    if not path.is_file():
        raise InputError(Problem(path, "file", "no such file", "a URDF file"))
    try:
        # yourdfpy reads what there is of a file that is not whole.
        ElementTree.parse(path)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # NumPy's, of numbers that are none; they are looked at below
            robot = URDF.load(str(path), build_scene_graph=False, load_meshes=False)
    # Of the syntax (ParseError is a SyntaxError), and of elements and attributes that are not there.
    except (SyntaxError, ValueError, TypeError, LookupError, AttributeError, AssertionError, OverflowError) as error:
        found = " ".join(str(error).split())[:120] or type(error).__name__
        raise InputError(Problem(path, "content", found, "a URDF file")) from None
    links = [link.name for link in robot.robot.links]
    joint_of = {joint.child: joint for joint in robot.robot.joints}
    lost = sorted({name for j in joint_of.values() for name in (j.parent, j.child)} - {*links}, key=str)
    roots = [link for link in links if link not in joint_of]
    problems = [Problem(path, "joints", f"the link {name!r}, which is not there", "links of the file") for name in lost]
    if len(roots) != 1:
        problems.append(
            Problem(path, "links", f"{len(roots)} roots: {', '.join(map(str, roots))}", "one tree of links")
        )
    elif not problems and (ring := _ring(joint_of, links)):
        problems.append(Problem(path, "links", f"a ring: {' on '.join(ring)}", "one tree of links"))
    if problems:
        raise InputError(problems)
    return UrdfRobot(path, robot.robot.name or path.stem, roots[0], joint_of)


def _ring(joint_of: dict[str, Any], links: list[str]) -> list[str]:
    """Links that hang on one another, from one back to the same; none in a tree."""
    for link in links:
        seen = [link]
        while (joint := joint_of.get(seen[-1])) is not None:
            if joint.parent in seen:
                return [*seen[seen.index(joint.parent) :], joint.parent]
            seen.append(joint.parent)
    return []


def urdf_chain(robot: str | Path | UrdfRobot, tip: str, base: str | None = None) -> SerialChain:
    """The chain from a link, by default the root, to another, with its limits; fixed joints are part of the links.

    It is in the axes of its base link, its end effector the origin of the tip link, its joints those that move.

    Joints without limits of their angle turn freely, without one of the rate as fast as `MAX_RATE_RAD_S`. Raises
    InputError.
    """
    robot = robot if isinstance(robot, UrdfRobot) else read_urdf(robot)
    start = robot.base if base is None else base
    missing = [name for name in (start, tip) if name not in robot.links]
    if missing:
        expected = ", ".join(robot.links)
        raise InputError([Problem(robot.path, "link", repr(name), expected) for name in missing])
    way = robot.way(tip, start)
    problems = list(_problems(robot, tip, start, way))
    if problems:
        raise InputError(problems)

    placed, here = [], np.eye(4)
    for joint in way:
        here = here @ (np.eye(4) if joint.origin is None else joint.origin)
        if joint.type in MOVING:
            placed.append(here)
            here = np.eye(4)
    moving = [joint for joint in way if joint.type in MOVING]
    places = np.array(placed)
    limits = np.array([_limits(joint) for joint in moving])
    return joint_chain(
        places[:, :3, 3],
        np.array([_axis(joint) for joint in moving]),
        Rotation.from_matrix(places[:, :3, :3]),
        [joint.type == "prismatic" for joint in moving],
        here[:3, 3],
        Rotation.from_matrix(here[:3, :3]),
        (limits[:, 0], limits[:, 1]),
        limits[:, 2],
        tuple(joint.name for joint in moving),
    )


def _problems(robot: UrdfRobot, tip: str, base: str, way: list[Any]) -> Iterator[Problem]:
    if not any(joint.type in MOVING for joint in way):
        yield Problem(robot.path, "chain", f"none that moves from {base} to {tip}", "a link that joints move")
    for joint in way:
        stated = (np.eye(4) if joint.origin is None else joint.origin, _axis(joint), _limits(joint)[2:])
        known = all((np.abs(numbers) < LARGEST).all() for numbers in stated)
        known &= _limits(joint)[2] > SMALLEST and _axis(joint).shape == (3,)
        if not known or not np.linalg.norm(_axis(joint)) > SMALLEST:
            yield Problem(robot.path, f"joint {joint.name}", "numbers that are none of a robot", "finite ones, an axis")
        if joint.type not in (*MOVING, "fixed"):
            yield Problem(robot.path, f"joint {joint.name}", f"type {joint.type}", f"{', '.join(MOVING)} or fixed")
        if joint.mimic is not None:
            yield Problem(robot.path, f"joint {joint.name}", "one that mimics another", "joints that move on their own")
        if joint.type in ("revolute", "prismatic"):
            lower, upper, _ = _limits(joint)
            if not lower <= upper:
                yield Problem(robot.path, f"joint {joint.name}", f"limits {lower}, {upper}", "a lower and an upper one")


def _axis(joint: Any) -> Array:
    return np.array([1.0, 0.0, 0.0]) if joint.axis is None else np.asarray(joint.axis, float)


def _limits(joint: Any) -> tuple[float, float, float]:
    """Lower, upper, rate."""
    limit = joint.limit
    rate = MAX_RATE_RAD_S if limit is None or not limit.velocity else float(limit.velocity)
    if joint.type == "continuous" or limit is None:
        return -np.inf, np.inf, rate
    # The format's own default is 0.
    return float(limit.lower or 0.0), float(limit.upper or 0.0), rate
