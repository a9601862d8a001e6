"""Robot files -> Quadruped: TOML with dimensions and limits (docs/robot.md), URDF or MJCF.

Built-in robots are the files of `recon/wings/robotics/robot/robots`.
"""

from __future__ import annotations

import warnings
from dataclasses import replace
from importlib import import_module
from pathlib import Path
from typing import Any, Literal
from xml.etree import ElementTree

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import RigidTransform, Rotation

from recon.base.arrays import Array
from recon.base.documents import FileTable, builtin_names, named_file, parse_toml, text_of, validated
from recon.base.errors import InputError, Problem, refuse
from recon.base.package import install_command
from recon.wings.robotics.ik.chain import MAX_RATE_RAD_S, SerialChain, joint_chain
from recon.wings.robotics.robot.quadruped import (
    LEG_ANGLES,
    LEGS,
    Leg,
    Length,
    Limits,
    Masses,
    PositiveLength,
    Quadruped,
    RobotLeg,
    standing,
)

STAND = 0.7
"""Height of the hips of a robot from a URDF or MJCF file, of the stretched leg's length."""
SHORTEST_M = 1e-3
"""Below which a leg of a URDF is none."""
SUFFIXES = (".urdf", ".xml")
LARGEST = 1e6
"""The largest length or angle: more can only be damage."""
LEAST_MASS_KG, LEAST_INERTIA_KG_M2 = 1e-6, 1e-9
"""Mass and inertia of links whose file does not say: their places do not depend on it."""


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
    """Names of the robots that come with the package."""
    return builtin_names("wings/robotics/robot/robots", ".toml")


def load_robot(robot: str | Path) -> Quadruped:
    """A built-in robot by name, or one of a file, .toml, .urdf or .xml (MJCF). Raises InputError."""
    if (path := Path(robot)).suffix.lower() in SUFFIXES:
        return _checked_robot(_quadruped_of_model(path))
    choice = (*builtin_robots(), "a file .urdf or .xml")
    content, _ = named_file(robot, "wings/robotics/robot/robots", ".toml", "--robot", "robot", choice)
    return _checked_robot(_quadruped(str(robot), parse_toml(text_of(content, robot, "a robot file"), robot)))


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
            # A rotation's axis is mirrored with the opposite sign.
            in_body[4:7] * np.prod(mirror) * signs[:, None],
            tool_m=offsets[3],
            limits_rad=(lower, upper),
            max_rate_rad_s=np.array([joints[k].max_rate_rad_s for k in leg.order]),
            names=tuple(name.removeprefix("-") for name in typed),
        )
        legs[label] = RobotLeg(chain, placed.hip_m + in_body[7], closed=leg, signs=signs)
    return Quadruped(file.name, file.title, legs, file.stand_m, source, file.masses)


def _checked_robot(robot: Quadruped) -> Quadruped:
    """Raises InputError for a robot that cannot stand, and for joints named twice."""
    problems = []
    if len({*robot.joints}) < len(robot.joints):
        problems.append(Problem(robot.source, "joints", "one name for several", "a name for each"))
    for label, leg in robot.legs.items():
        if not np.isfinite(leg.angles(leg.neutral_m[None])).all():
            problems.append(_cannot_stand(robot.source, label))
    refuse(problems)
    return robot


def _cannot_stand(source: str, label: str) -> Problem:
    found = f"a leg {label} that does not reach the ground within its limits"
    return Problem(source, "stand_m", found, "a height that it can stand at")


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
    legs = {}
    for label, chain, foot in zip(labels, chains, neutral, strict=True):
        if (home := standing(chain, foot)) is None:  # after a second's search: the other legs are mostly like it
            raise InputError(_cannot_stand(str(path), label))
        legs[label] = RobotLeg(chain, foot, home)
    called = model.names.split(b"\0")[0].decode() or path.stem
    return Quadruped(called, called, {label: legs[label] for label in LEGS}, stand, str(path))


def _middle(lower: Array, upper: Array) -> Array:
    """The middle of limits; 0 for a joint that has none."""
    bounded = np.isfinite(lower) & np.isfinite(upper)
    return np.where(bounded, np.where(bounded, lower, 0.0) + np.where(bounded, upper, 0.0), 0.0) / 2


# -- what MuJoCo reads (extra robots); meshes are left out: they need files beside it, and no kinematics needs them ----


def the_mujoco(source: str | Path) -> Any:
    """The module. Raises InputError where it is not installed; source: what it is needed for."""
    try:
        return import_module("mujoco")
    except ImportError:
        expected = f"the package mujoco: {install_command('robots')}"
        raise InputError(Problem(source, "robot", "no MuJoCo to read or to simulate it", expected)) from None


def read_model(path: str | Path, free: bool = False) -> Any:
    """The file as MuJoCo's model (`MjModel`), fixed joints kept; free: its root moves freely in the world. Raises
    InputError for a file that is none, and without MuJoCo."""
    path, mujoco = Path(path), the_mujoco(path)
    if not path.is_file():
        raise InputError(Problem(path, "file", "no such file", "a URDF or MJCF file"))
    mujoco.set_mju_user_warning(lambda message: None)  # instead of a file in the working folder
    try:
        spec = mujoco.MjSpec.from_file(str(path))
        spec.compiler.fusestatic = False
        spec.compiler.boundmass, spec.compiler.boundinertia = LEAST_MASS_KG, LEAST_INERTIA_KG_M2
        for geom in [geom for geom in spec.geoms if geom.type == mujoco.mjtGeom.mjGEOM_MESH]:
            spec.delete(geom)
        for mesh in list(spec.meshes):
            spec.delete(mesh)
        if free and not any(joint.type == mujoco.mjtJoint.mjJNT_FREE for joint in spec.joints):
            spec.worldbody.first_body().add_freejoint()
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # masses that nothing moves by: kinematics do not need them
            model = spec.compile()
    except (ValueError, RuntimeError, mujoco.FatalError) as error:  # also where it has no memory
        found = " ".join(str(error).split())[:160]
        raise InputError(Problem(path, "content", found, "a URDF or MJCF file")) from None
    for what, numbers in {"links": model.body_pos, "limits": model.jnt_range}.items():
        if not (np.abs(numbers) < LARGEST).all():
            raise InputError(Problem(path, what, "numbers that are none of a robot", "metres and radians"))
    return model


def rates_of(path: Path) -> dict[str, float]:
    """The joints' fastest rates that a URDF file states, which MuJoCo does not keep; MJCF has none. Raises InputError
    for limits of joints that it takes for none."""
    rates, problems = {}, []
    try:
        stated = {j.get("name", ""): j.find("limit") for j in ElementTree.parse(path).getroot().iter("joint")}
        numbers = {
            name: [float(limit.get(what) or 0) for what in ("lower", "upper", "velocity")]
            for name, limit in stated.items()
            if limit is not None
        }
    except (ElementTree.ParseError, ValueError) as error:
        raise InputError(Problem(path, "limit", str(error)[:120], "numbers in a whole file")) from None
    for name, (lower, upper, rate) in numbers.items():
        if lower > upper:
            problems.append(Problem(path, f"joint {name}", f"limits {lower:g}, {upper:g}", "the lower one first"))
        if rate and not 1e-6 < rate < LARGEST:
            problems.append(Problem(path, f"joint {name}", f"velocity {rate:g}", "a rate above 0"))
        elif rate:
            rates[name] = rate
    if problems:
        raise InputError(problems)
    return rates


def body_names(model: Any) -> list[str]:
    """The names of all bodies but the world; a body without a name is body 3, by its number."""
    return [model.body(k).name or f"body {k}" for k in range(1, model.nbody)]


def root_of(model: Any) -> int:
    """The body that moves freely in the world, or the first that hangs on it."""
    free = [int(model.jnt_bodyid[j]) for j in range(model.njnt) if model.jnt_type[j] == 0]
    return free[0] if free else 1


def leaves_of(model: Any) -> list[int]:
    """Bodies on which none hangs."""
    return [k for k in range(1, model.nbody) if k not in model.body_parentid[1:]]


def foot_of(model: Any, leaf: int) -> Array:
    """(3,) in the leaf's axes: its origin, or, of a link that a joint moves, as MJCF files end their legs, the middle
    of the farthest sphere on it, or else shape."""
    shapes = [g for g in range(model.ngeom) if model.geom_bodyid[g] == leaf]
    shapes = [g for g in shapes if model.geom_type[g] == 2] or shapes
    if not model.body_jntnum[leaf] or not shapes:
        return np.zeros(3)
    return np.array(max((model.geom_pos[g] for g in shapes), key=np.linalg.norm))


def way_to(model: Any, tip: int, base: int) -> list[int]:
    """The bodies after base as far as tip; empty where the tip does not hang on the base."""
    bodies = []
    while tip not in (base, 0):
        bodies.append(tip)
        tip = int(model.body_parentid[tip])
    return bodies[::-1] if tip == base else []


def moving(model: Any, bodies: list[int]) -> list[int]:
    """The joints of bodies, in their order."""
    return [j for k in bodies for j in range(model.body_jntadr[k], model.body_jntadr[k] + model.body_jntnum[k])]


def model_chain(
    model: Any, path: Path, tip: str, base: str | None = None, end_m: ArrayLike = (0.0, 0.0, 0.0)
) -> SerialChain:
    """The chain from a body, by default the root, to another, with its limits; fixed joints are part of the links.

    It is in the axes of its base, its end effector at end_m (3,) in those of the tip, its joints those that move.
    Joints without limits of their angle turn freely, without one of the rate as fast as `MAX_RATE_RAD_S`. Raises
    InputError.
    """
    names = body_names(model)
    problems = [Problem(path, "link", repr(n), ", ".join(names)) for n in (base, tip) if n not in (None, *names)]
    if problems:
        raise InputError(problems)
    start = root_of(model) if base is None else names.index(base) + 1
    way = way_to(model, names.index(tip) + 1, start)
    joints = moving(model, way)
    if not joints:
        found = f"none that moves from {names[start - 1]} to {tip}"
        raise InputError(Problem(path, "chain", found, "a link that joints move"))
    other = [model.joint(j).name for j in joints if model.jnt_type[j] not in (2, 3)]  # slide, hinge
    if other:
        raise InputError(
            [Problem(path, f"joint {name}", "another kind", "joints that turn or slide") for name in other]
        )
    lost = f"a joint on the way to {tip} without an axis or a place"
    without = InputError(Problem(path, "chain", lost, "axes of joints, and places in metres"))
    if not (np.linalg.norm(model.body_quat[way], axis=1) > 0).all():  # a file's numbers beyond those of floats
        raise without
    placed, here = [], RigidTransform.identity()
    for k in way:
        turn = Rotation.from_quat(model.body_quat[k], scalar_first=True)
        here = here * RigidTransform.from_components(model.body_pos[k], turn)
        for j in moving(model, [k]):
            placed.append(here * RigidTransform.from_translation(model.jnt_pos[j]))
            here = RigidTransform.from_translation(-model.jnt_pos[j])
    here = here * RigidTransform.from_translation(np.asarray(end_m, dtype=float))
    places = np.array([*(place.translation for place in placed), here.translation, *model.jnt_axis[joints]])
    if not np.isfinite(places).all() or not model.jnt_axis[joints].any(axis=1).all():
        raise without
    rates = rates_of(path)
    limits = np.where(model.jnt_limited[joints, None], model.jnt_range[joints], [-np.inf, np.inf])
    called = tuple(model.joint(j).name or f"joint {j}" for j in joints)
    return joint_chain(
        np.array([place.translation for place in placed]),
        model.jnt_axis[joints],
        Rotation.concatenate([place.rotation for place in placed]),
        model.jnt_type[joints] == 2,
        here.translation,
        here.rotation,
        (limits[:, 0], limits[:, 1]),
        np.array([rates.get(name, MAX_RATE_RAD_S) for name in called]),
        called,
    )
