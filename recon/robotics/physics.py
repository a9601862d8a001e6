"""Check with MuJoCo's inverse dynamics whether a robot's limits, torques and ground forces allow a motion.

A robot from a URDF or MJCF file is used without its meshes. A robot that is described by dimensions and masses is
modelled as a body with inertia, links that are capsules with the thickness `LEGS_APART`, and point feet.

In every frame, the forces of the feet in stance are chosen within the friction cone so that they meet the forces that
the body's motion requires as well as possible. The unmet part, as a fraction of the weight, is the margin `forces`. It
covers friction, the centre of pressure (feet push only where they stand) and flight phases that are not free fall.
`carried` moves the base until every rule is kept, and `followed` simulates a robot that follows the resulting motion.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from math import comb
from pathlib import Path
from textwrap import fill
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from scipy import sparse
from scipy.interpolate import BSpline, CubicSpline
from scipy.optimize import nnls
from scipy.sparse.linalg import splu
from scipy.spatial.transform import Rotation

from recon.base.arrays import Array
from recon.base.errors import InputError, Problem
from recon.base.numbers import decimals
from recon.robotics.models import MjModel, MjSpec, read_model, require_mujoco, root_of
from recon.robotics.quadruped import LEGS, SUFFIXES, Quadruped
from recon.robotics.retarget import LEGS_APART, RobotMotion, moved_by, stances, swinging
from recon.show.plots.style import GREY, SMALL, drawing

if TYPE_CHECKING:
    from matplotlib.figure import Figure

FRICTION = 0.8
"""Friction coefficient of the ground in the check."""
RATE_HZ = 100.0
"""Frames per second at which a motion is checked and changed."""
FOOT_M = 1e-3
"""Radius of the balls that represent point feet, metres."""
GAINS = (100.0, 2.0)
"""Stiffness and damping of a joint, N m / rad and N m s / rad."""
TIMESTEP_S = 5e-4
"""Time step of the simulation, seconds."""
TORQUES_HZ = 500.0
"""Number of times per second at which `followed` computes the torques that the motion requires."""
STEP_S = 1e-4
"""Time between two velocities whose difference gives an acceleration, seconds."""
STEP = 1e-5
"""Step of a numerical derivative with respect to the state, m or rad."""
SLOPES = np.array([[0, 0, 1], *([x, y, 1] for x, y in FRICTION * np.array([[1, 0], [-1, 0], [0, 1], [0, -1]]))])
"""Axis and edges of the pyramid inscribed in the friction cone, within which ground forces lie, shape (5, 3)."""
MAX_ATTEMPTS = 5
"""Maximum number of attempts to find forces that also keep the torque limits."""
MIN_MOBILITY = 0.05
"""Minimum mobility of a movable foot in a direction, as a fraction of that in its most mobile direction."""
CHANGES = ((1.0, 1.0), (1.0, 0.8), (1.0, 0.6), (1.0, 0.5), (1.0, 0.4), (1.3, 0.8), (1.3, 0.6), (1.3, 0.5))
"""Factors on the times and the lengths of a motion, in the order in which `--fit-limits` tries them.

Shorter strides come first, since a slower robot has to leap higher to be in the air for the same fraction of a stride.
"""
DEGREE = 5
"""Degree of the polynomials that describe how a foot's force rises and falls over a stance."""
MAX_COEFFICIENT = 10.0
"""Largest coefficient of the polynomials that describe a foot's force, as a fraction of the weight."""
MAX_STEPS = 12
"""Maximum number of optimisation steps in `carried`."""
MAX_EXCESS = 50.0
"""Maximum weighted sum of squared excesses over the limits after three steps with which `carried` continues."""
WEIGHT_UNIT = 0.02
"""Unmet part of the required forces that gives a residual of 1, as a fraction of the weight."""
TORQUE_UNIT = 0.05
"""Excess of a torque that gives a residual of 1, as a fraction of its limit."""
LIMIT_UNIT = 0.02
"""Excess of a rate or an angle that gives a residual of 1, as a fraction of its limit."""
BASE_WEIGHT = 3.0
"""Weight in `carried` of the base's displacement (in standing heights) and rotation (rad)."""
LIMIT_FRACTIONS = {"base": 0.0, "torques": 0.85, "rates": 0.95, "angles": 0.97}
"""Fraction of each limit that the optimisation in `carried` aims to stay below."""
WIDER_RAD = 0.4
"""Angle by which joints may exceed their limits in intermediate steps of `carried`, rad."""


class Rule(NamedTuple):
    """Physical limit that a motion must respect in every frame, and how its margin is printed."""

    title: str
    unit: str
    """Unit of the printed margin."""
    least: float = 0.0
    """Smallest margin at which the rule is not broken."""
    advice: str = ""
    """Option of `recon retarget` that helps if the rule is broken."""
    per_unit: float = 1.0
    """Factor that converts the margin to the printed value."""


RULES = {
    "joint_limits": Rule("joints within their limits", "rad", -1e-6, "a smaller --scale"),
    "joint_rates": Rule("reserve of the joint rates", "of limit", -1e-6, "--fit-limits, or a larger --slower"),
    "torques": Rule("reserve of the torques", "of limit", 0.0, "--fit-limits, or a larger --slower"),
    "forces": Rule("missing force of the standing feet", "of weight", -0.1, "--fit-limits"),
    "legs_apart": Rule("colliding legs", "m", 0.0, "a smaller --scale"),
    "ground": Rule("lowest point above the ground", "m", -1e-3, "a smaller --scale"),
}


def simulated(robot: Quadruped) -> MjModel:
    """Build MuJoCo's model of a robot whose base moves freely.

    Raises
    ------
    InputError
        If MuJoCo is not installed, if the robot's file cannot be read, or if its masses are not known.
    """
    if Path(robot.source).suffix.lower() in SUFFIXES:
        return read_model(robot.source, free=True)
    return described(robot).compile()


def described(robot: Quadruped) -> MjSpec:
    """Build MuJoCo's description of a robot given by its dimensions.

    Raises
    ------
    InputError
        If MuJoCo is not installed, or if the robot's masses are not known.
    """
    mujoco = require_mujoco(robot.source)
    if robot.masses is None:
        raise InputError(Problem(robot.source, "masses", "none", "masses and max_torque_n_m (docs/robot.md)"))
    spec, masses = mujoco.MjSpec(), robot.masses
    spec.compiler.degree = False
    base = spec.worldbody.add_body(name="base", mass=masses.body_kg, inertia=masses.body_inertia_kg_m2)
    base.explicitinertial = True
    base.add_freejoint()
    capsule, sphere = mujoco.mjtGeom.mjGEOM_CAPSULE, mujoco.mjtGeom.mjGEOM_SPHERE
    thick = LEGS_APART * robot.stand_m / 2
    for k, (label, leg) in enumerate(robot.legs.items()):
        positions, axes = leg.chain.positions(np.zeros(leg.chain.n)), leg.chain.joint_axes(np.zeros(leg.chain.n))
        body, position, to_next = base, np.zeros(3), np.zeros(3)
        for j, name in enumerate(leg.joints):
            body = body.add_body(name=name, pos=positions[j] - position)
            position, to_next = positions[j], positions[j + 1] - positions[j]
            limit = masses.max_torque_n_m[j]
            limit_fields = {"limited": 1, "range": [leg.chain.lower_rad[j], leg.chain.upper_rad[j]]}
            body.add_joint(name=name, axis=axes[j], actfrclimited=1, actfrcrange=[-limit, limit], **limit_fields)
            kind = (
                {"type": capsule, "fromto": [*np.zeros(3), *to_next]}
                if np.linalg.norm(to_next) > 1e-3
                else {"type": sphere}
            )
            # A leg collides with other legs, not with itself.
            contacts = {"contype": (1 << k) if j else 0, "conaffinity": (15 & ~(1 << k)) if j else 0}
            body.add_geom(**kind, size=[thick, 0, 0], mass=masses.links_kg[j], **contacts)
        foot = {"name": f"{label} foot", "type": sphere, "size": [FOOT_M, 0, 0], "pos": to_next}
        body.add_geom(**foot, mass=masses.foot_kg, contype=0, conaffinity=0)
    return spec


class _Demand(NamedTuple):
    """Forces that a robot's motion requires in N states, and the derivatives of the foot positions.

    The coordinates of a state are the base's position, its rotation about its own axes, and the J joints, 6 + J in all.
    """

    needed: Array
    """Required forces (N), moments and torques (N m), without the forces from the ground, shape (N, 6 + J)."""
    moves: Array
    """Derivatives of the foot positions with respect to the coordinates, shape (N, 4, 3, 6 + J)."""


def _demand_of(robot: Quadruped, model: MjModel, states: Array, rates: Array, second_rates: Array) -> _Demand:
    """Compute the forces that a motion requires from its states (N, 6 + J) and their first and second derivatives."""
    mujoco = require_mujoco(robot.source)
    joints = [model.joint(name) for name in robot.joints]
    order = [*range(6), *(joint.dofadr[0] for joint in joints)]
    bodies = [model.joint(leg.joints[-1]).bodyid[0] for leg in robot.legs.values()]
    data, n = mujoco.MjData(model), len(states)
    coordinates = _coordinates(model, robot, states)
    velocities = np.zeros((n, model.nv))
    accelerations = np.zeros((n, model.nv))
    velocities[:, order], accelerations[:, order] = rates, second_rates
    # Angular velocity and acceleration are not the derivatives of the Euler angles, so compute them from rotations.
    following, present, previous = (
        Rotation.from_euler("ZYX", (states + step * rates + step**2 / 2 * second_rates)[:, 3:6])
        for step in (STEP_S, 0.0, -STEP_S)
    )
    later, earlier = (
        (start.inv() * end).as_rotvec() / STEP_S for start, end in ((present, following), (previous, present))
    )
    velocities[:, 3:6], accelerations[:, 3:6] = (later + earlier) / 2, (later - earlier) / STEP_S
    feet = robot.tree.pose(states).points_m[:, robot.foot_markers]
    needed, moves = np.zeros((n, model.nv)), np.zeros((n, len(LEGS), 3, model.nv))
    flags = model.opt.disableflags
    model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONSTRAINT)
    for k in range(n):
        data.qpos[:], data.qvel[:], data.qacc[:] = coordinates[k], velocities[k], accelerations[k]
        mujoco.mj_inverse(model, data)
        needed[k] = data.qfrc_inverse
        for foot, body in enumerate(bodies):
            mujoco.mj_jac(model, data, moves[k, foot], None, feet[k, foot], body)
    model.opt.disableflags = flags
    return _Demand(needed[:, order], moves[..., order])


def _apart(motion: RobotMotion, model: MjModel, time_s: Array) -> Array:
    """Return the deepest penetration of two parts as a negative distance (K,) in metres, or 0 if no parts touch."""
    mujoco = require_mujoco(motion.robot.source)
    data, distances = mujoco.MjData(model), np.zeros(len(time_s))
    for k, coordinates in enumerate(_coordinates(model, motion.robot, motion.states(time_s))):
        data.qpos[:] = coordinates
        mujoco.mj_fwdPosition(model, data)
        distances[k] = min((float(c.dist) for c in data.contact), default=0.0)
    return distances


def _coordinates(model: MjModel, robot: Quadruped, states: Array) -> Array:
    """Return MuJoCo's coordinates (K, nq) of states (K, 6 + J) of the robot's tree."""
    positions = np.zeros((len(states), model.nq))
    positions[:, :3] = states[:, :3]
    positions[:, 3:7] = Rotation.from_euler("ZYX", states[:, 3:6]).as_quat(scalar_first=True)
    positions[:, [model.joint(name).qposadr[0] for name in robot.joints]] = states[:, 6:]
    return positions


def _units(motion: RobotMotion, model: MjModel, torques: float) -> Array:
    """Return factors (6 + J) that turn forces, moments and torques into fractions.

    Forces and moments on the base become fractions of the weight. Torques become fractions of their limits, times
    `torques`.
    """
    weight = float(model.body_subtreemass[root_of(model)]) * float(np.linalg.norm(model.opt.gravity))
    limits = model.jnt_actfrcrange[[model.joint(name).id for name in motion.robot.joints], 1]
    of_base = np.array([1, 1, 1, *[1 / motion.robot.stand_m] * 3]) / weight
    return np.concatenate([of_base, torques / np.where(limits > 0, limits, np.inf)])  # the file may lack a limit


def balanced(motion: RobotMotion, model: MjModel, time_s: Array) -> Array:
    """Return the part (K, 6 + J) of a motion's required forces that the feet in stance do not provide at times (K,).

    The columns of the base are the forces and moments that feet within the friction cone cannot provide. The columns of
    the joints are the torques that the joints need in addition to the forces of the feet.
    """
    asked, plain = _demand_of(motion.robot, model, *_states(motion, time_s)), _units(motion, model, 1.0)
    left = asked.needed.copy()
    for k, stands in enumerate(motion.stands_at(time_s)):
        pushes = (SLOPES @ asked.moves[k, stands]).reshape(-1, len(plain)).T
        units, over = plain * ([1.0] * 6 + [1e-3] * (len(plain) - 6)), np.zeros(len(plain), bool)
        for _ in range(MAX_ATTEMPTS if stands.any() else 0):
            units[over] *= 3
            left[k] = asked.needed[k] - pushes @ nnls(units[:, None] * pushes, units * asked.needed[k])[0]
            over[6:] = np.abs(plain * left[k])[6:] > 1
            if not over.any():
                break
    return left


def _states(motion: RobotMotion, time_s: Array) -> tuple[Array, Array, Array]:
    """Return the states (K, 6 + J) of the robot's tree at times (K,), and their first and second derivatives."""
    states, rates, second_rates = (motion.states(time_s, order) for order in range(3))
    return states, rates, second_rates


def check(motion: RobotMotion, model: MjModel) -> tuple[Array, dict[str, Array]]:
    """Compute the margins of a motion to each of `RULES`.

    Returns
    -------
    time_s : (K,)
        Times of the checked frames, `RATE_HZ` per second.
    margins : dict
        Margins (K,) of each rule, which is broken at margins below its `Rule.least`.
    """
    duration = float(motion.time_s[-1] - motion.time_s[0])
    time = motion.time_s[0] + np.linspace(0.0, duration, max(2, round(duration * RATE_HZ) + 1))
    states, rates = motion.states(time), motion.states(time, 1)
    lower, upper, fastest = motion.robot.limits()
    left = _units(motion, model, 1.0) * balanced(motion, model, time)
    return time, {
        "joint_limits": np.minimum(states[:, 6:] - lower, upper - states[:, 6:]).min(axis=1),
        "joint_rates": 1 - np.abs(rates[:, 6:] / fastest).max(axis=1),
        "torques": 1 - np.abs(left[:, 6:]).max(axis=1),
        "forces": -np.linalg.norm(left[:, :3], axis=1) - np.linalg.norm(left[:, 3:6], axis=1),
        "legs_apart": _apart(motion, model, time),
        "ground": motion.robot.tree.pose(states).points_m[..., 2].min(axis=1),
    }


def followed(motion: RobotMotion, strides: int = 1) -> tuple[Array, Array]:
    """Simulate a robot, given by its dimensions, that follows a motion.

    In every step of the simulation each joint gets a torque within its limits: the torque that the motion requires,
    given the forces of the feet in stance, plus a spring and a damper (`GAINS`) towards the motion's angle and rate.
    The ground is level, with a friction coefficient of 1.

    Parameters
    ----------
    motion : RobotMotion
        The motion to follow.
    strides : int
        Number of times that the motion is repeated.

    Returns
    -------
    time_s : (K,)
        Times of the simulated samples, seconds.
    off_m : (K,)
        Distance of the base from its position in the motion, metres.
    """
    mujoco, robot = require_mujoco(motion.robot.source), motion.robot
    model = simulated(robot)
    spec = described(robot)
    spec.option.timestep, ground = TIMESTEP_S, 1 << len(LEGS)
    spec.worldbody.add_geom(
        type=mujoco.mjtGeom.mjGEOM_PLANE,
        size=[0, 0, 1],
        pos=[0, 0, -FOOT_M],
        contype=0,
        conaffinity=ground,
        friction=[1, 0, 0],
    )
    for foot in [geom for geom in spec.geoms if geom.name.endswith(" foot")]:
        foot.contype, foot.friction = ground, [1, 0, 0]
    world = spec.compile()
    data, order = mujoco.MjData(world), [world.joint(name) for name in robot.joints]
    positions, columns = [joint.qposadr[0] for joint in order], [joint.dofadr[0] for joint in order]
    limits = world.jnt_actfrcrange[[joint.id for joint in order], 1]
    lasts = float(motion.time_s[-1] - motion.time_s[0])
    time = np.linspace(0.0, strides * lasts, round(strides * lasts / TIMESTEP_S), endpoint=False)
    knots = np.linspace(0.0, lasts, round(lasts * TORQUES_HZ) + 1)
    torques = CubicSpline(knots, balanced(motion, model, motion.time_s[0] + knots)[:, 6:])(time % lasts)
    states, rates = motion.states(motion.time_s[0] + time), motion.states(motion.time_s[0] + time, 1)
    off_m = np.zeros(len(time))
    begin = _coordinates(model, robot, motion.states(motion.time_s[0] + np.array([0.0, STEP_S])))
    data.qpos[:] = begin[0]
    mujoco.mj_differentiatePos(world, data.qvel, STEP_S, *begin)
    for k, (state, rate, torque) in enumerate(zip(states, rates, torques, strict=True)):
        off_m[k] = np.linalg.norm(data.qpos[:3] - state[:3])
        torque = torque + GAINS[0] * (state[6:] - data.qpos[positions]) + GAINS[1] * (rate[6:] - data.qvel[columns])
        data.qfrc_applied[columns] = np.clip(torque, -limits, limits)
        mujoco.mj_step(world, data)
    return time, off_m


def carried(motion: RobotMotion, model: MjModel, hopeless: float = MAX_EXCESS) -> tuple[RobotMotion, Array]:
    """Move a motion's base as little as possible so that the robot can perform the motion.

    The base's path is a cubic spline with one knot per frame. The forces of each stance are within the friction cone,
    and rise from 0 and fall to 0 as sums of Bernstein polynomials. Path and forces are found together by least squares
    over three terms: the required forces that the feet do not provide, the excess of torques, rates and angles over
    their limits, and the deviation of the base. The solver is Levenberg-Marquardt with derivatives of the whole robot's
    dynamics.

    Parameters
    ----------
    motion : RobotMotion
        The motion, of N samples.
    model
        MuJoCo's model of the robot (`simulated`).
    hopeless : float
        Weighted sum of squares of the excess over the limits, after three steps, above which the search stops.

    Returns
    -------
    motion : RobotMotion
        The first motion found that keeps every rule, or the last motion tried.
    shifts : (N, 6)
        Changes of the base's position (m) and of its yaw, pitch and roll (rad).
    """
    problem, shifts = _Carrying(motion, model), np.zeros((len(motion.time_s), 6))
    moved, pushes = np.zeros(problem.moved_shape), np.full(problem.n_pushes, 0.2)
    current, best, demand = motion, motion, _demand_of(motion.robot, model, *_states(motion, problem.time_s))
    values, damping, stalled_steps = problem.values(current, demand, moved, pushes), 300.0, 0
    for turn in range(MAX_STEPS):
        if least_share(best, model) == 1 or stalled_steps > 2:
            break
        excess = problem.beyond(values)
        if turn > 2 and float(np.sum(excess[problem.limited] ** 2)) > hopeless:
            break
        cost, derivatives = float(np.sum(excess**2)), problem.slopes(current, demand, pushes)
        for _ in range(8):
            step = problem.step(derivatives, values, damping)
            tried_moved, tried_pushes = moved + step[: moved.size].reshape(moved.shape), pushes + step[moved.size :]
            tried = moved_by(motion, problem.everywhere @ tried_moved, problem.wider)
            tried_demand = _demand_of(motion.robot, model, *_states(tried, problem.time_s))
            tried_values = problem.values(tried, tried_demand, tried_moved, tried_pushes)
            tried_cost = float(np.sum(problem.beyond(tried_values) ** 2))
            if tried_cost < cost:
                break
            damping *= 5
        else:
            break
        stalled_steps = stalled_steps + 1 if tried_cost > 0.98 * cost else 0
        current = tried
        moved = tried_moved
        pushes = tried_pushes
        demand = tried_demand
        values = tried_values
        damping /= 5
        shifts = problem.everywhere @ moved
        best = moved_by(motion, shifts)
    return best, shifts


class _Carrying:
    """Least-squares problem of `carried` over K frames.

    The residuals are the unmet part of the base's required forces; torques, rates and angles as fractions of their
    limits; the coefficients of the foot forces (`pushes`); and the base's deviation. The unknowns are the coefficients
    of the base's path and the pushes.
    """

    def __init__(self, motion: RobotMotion, model: MjModel) -> None:
        self.motion, self.model, robot = motion, model, motion.robot
        self.start, self.lasts = motion.time_s[0], float(motion.time_s[-1] - motion.time_s[0])
        self.loops, self.frames = motion.advance_m is not None, max(6, round(RATE_HZ * self.lasts))
        time = self.start + np.linspace(0.0, self.lasts, self.frames + 1)
        self.time_s = time[:-1] if self.loops else time
        self.ways = [self._spline(self.time_s, order) for order in range(3)]
        self.everywhere = self._spline(motion.time_s)
        self.units = _units(motion, model, 1.0)
        lower, upper, self.fastest = robot.limits()
        lower, upper = np.maximum(lower, -1e3), np.minimum(upper, 1e3)  # the file may lack limits
        self.middle, self.half = (lower + upper) / 2, (upper - lower) / 2
        wider = {}
        for label, leg in robot.legs.items():
            lower, upper = leg.chain.lower_rad - WIDER_RAD, leg.chain.upper_rad + WIDER_RAD
            wider[label] = replace(leg, chain=replace(leg.chain, lower_rad=lower, upper_rad=upper))
        self.wider = replace(robot, legs=wider)
        loose = swinging(motion)
        self.held = 1 - np.stack([np.interp(self.time_s, motion.time_s, weights) for weights in loose.T], axis=1)
        self.stances = [(foot, grown / self.units[0]) for foot, grown in _pushes(motion, self.time_s)]
        self.n_pushes = len(SLOPES) * sum(grown.shape[1] for _, grown in self.stances)
        K, n, J = len(self.time_s), self.ways[0].shape[1], len(robot.joints)
        self.moved_shape = n, 6
        scale = np.diag([1 / robot.stand_m] * 3 + [1.0] * 3)
        self.near = sparse.csr_array(np.einsum("kn,ij->kinj", self.ways[0], scale).reshape(6 * K, 6 * n))
        sizes = [6 * K, J * K, J * K, J * K, self.n_pushes, 6 * K]
        self.weights = np.repeat(
            [1 / WEIGHT_UNIT, 1 / TORQUE_UNIT, 1 / LIMIT_UNIT, 1 / LIMIT_UNIT, 1 / WEIGHT_UNIT, BASE_WEIGHT], sizes
        )
        self.allowed = np.repeat([*LIMIT_FRACTIONS.values(), MAX_COEFFICIENT / 2, 0.0], sizes)
        self.limited = slice(6 * K, sum(sizes[:4]))

    def _spline(self, time_s: Array, order: int = 0) -> Array:
        """Return the matrix (K, n) from the spline's coefficients to the base, or its derivative, at times (K,).

        `order` is the order of the derivative in time, 0 for none.
        """
        m, size = self.frames, self.lasts / self.frames
        at = np.clip((time_s - self.start) / size, 0, m)
        columns = BSpline(np.arange(-3.0, m + 4), np.eye(m + 3), 3)(at, nu=order) / size**order
        if not self.loops:
            return columns
        columns[:, :3] += columns[:, m:]
        return columns[:, :m]

    def _forces(self, pushes: Array) -> Array:
        """Return the forces (K, 4, 3) on the feet for the coefficients `pushes`."""
        forces, ends = np.zeros((len(self.time_s), len(LEGS), 3)), 0
        for foot, grown in self.stances:
            begin, ends = ends, ends + len(SLOPES) * grown.shape[1]
            forces[:, foot] += grown @ pushes[begin:ends].reshape(len(SLOPES), -1).T @ SLOPES
        return forces

    def values(self, motion: RobotMotion, demand: _Demand, moved: Array, pushes: Array) -> Array:
        """Return all residuals of a motion and its required forces, before subtracting limits and applying weights."""
        states, rates, _ = _states(motion, self.time_s)
        left = self.units * (demand.needed - np.einsum("kfi,kfij->kj", self._forces(pushes), demand.moves))
        shares = [left[:, :6], left[:, 6:], rates[:, 6:] / self.fastest, (states[:, 6:] - self.middle) / self.half]
        return np.concatenate(
            [*(part.ravel() for part in shares), pushes - MAX_COEFFICIENT / 2, self.near @ moved.ravel()]
        )

    def beyond(self, values: Array) -> Array:
        """Return the weighted excess of the residuals over their allowed values."""
        return self.weights * np.maximum(np.abs(values) - self.allowed, 0.0)

    def slopes(self, motion: RobotMotion, demand: _Demand, pushes: Array) -> sparse.csr_array:
        """Return the sparse derivatives of the residuals with respect to the unknowns."""
        states = _states(motion, self.time_s)
        K, J, forces = len(self.time_s), len(self.fastest), self._forces(pushes)
        state_rates = self._states_by_base(motion.robot, states[0])
        along = self._over_time(state_rates)
        speeds, curvatures, zero = along(self.time_s, 1), along(self.time_s, 2), np.zeros_like(state_rates)

        def needs(*ways: Array) -> Array:
            """Return the derivatives (K, 6 + J, 6) of the required forces.

            `ways` are the derivatives of states, rates and accelerations with respect to the base's pose.
            """
            near = (
                np.swapaxes(values[:, :, None] + STEP * way, 1, 2) for values, way in zip(states, ways, strict=True)
            )
            nudged = _demand_of(motion.robot, self.model, *(values.reshape(-1, 6 + J) for values in near))
            by_feet = np.einsum("nfi,nfij->nj", np.repeat(forces, 6, axis=0), nudged.moves)
            unmet = demand.needed - np.einsum("kfi,kfij->kj", forces, demand.moves)
            return ((nudged.needed - by_feet).reshape(K, 6, -1) - unmet[:, None]).swapaxes(1, 2) / STEP

        def rows(*parts: Array) -> Array:
            """Convert derivatives with respect to the base's pose to derivatives for the spline's coefficients."""
            by = (np.einsum("kij,kn->kinj", part, way) for part, way in zip(parts, self.ways, strict=False))
            return np.sum([*by], axis=0).reshape(K, parts[0].shape[1], -1)

        left = self.units[:, None] * rows(
            needs(state_rates, speeds, curvatures), needs(zero, state_rates, 2 * speeds), needs(zero, zero, state_rates)
        )
        rates = rows(speeds[:, 6:], state_rates[:, 6:]) / self.fastest[:, None]
        angles = rows(state_rates[:, 6:]) / self.half[:, None]
        by_pushes = self._demand_by_pushes(demand) * -self.units[:, None]
        parts = [left[:, :6], left[:, 6:], rates, angles, by_pushes[:, :6], by_pushes[:, 6:]]
        base, torques, rates, angles, on_base, on_torques = (
            sparse.csr_array(values.reshape(-1, values.shape[2])) for values in parts
        )
        pushed = sparse.eye_array(self.n_pushes)
        return sparse.block_array(
            [[base, on_base], [torques, on_torques], [rates, None], [angles, None], [None, pushed], [self.near, None]],
            format="csr",
        )

    def _states_by_base(self, robot: Quadruped, states: Array) -> Array:
        """Return the derivatives (K, 6 + J, 6) of the states (K, 6 + J) with respect to the base's pose.

        The joints of a leg move with the base so that its foot stays planted.
        """
        moves = robot.tree.pose_with_jacobian(states).jacobian[:, robot.foot_markers]
        state_rates = np.zeros((*states.shape, 6))
        ends = np.cumsum([6, *(len(leg.joints) for leg in robot.legs.values())])
        state_rates[:, range(6), range(6)] = 1.0
        for index, columns in enumerate(map(slice, ends[:-1], ends[1:])):
            follow = np.linalg.pinv(moves[:, index, :, columns], rcond=MIN_MOBILITY)
            state_rates[:, columns] = -self.held[:, index, None, None] * (follow @ moves[:, index, :, :6])
        return state_rates

    def _over_time(self, values: Array) -> CubicSpline:
        """Return a spline through the values (K, ...) of the K frames, periodic for a motion that repeats."""
        if not self.loops:
            return CubicSpline(self.time_s, values)
        time = np.append(self.time_s, self.start + self.lasts)
        return CubicSpline(time, np.concatenate([values, values[:1]]), bc_type="periodic")

    def _demand_by_pushes(self, demand: _Demand) -> Array:
        """Return the derivatives (K, 6 + J, P) of the forces of the feet with respect to the pushes."""
        by_stance = [
            np.einsum("gi,kij,km->kjgm", SLOPES, demand.moves[:, index], growth) for index, growth in self.stances
        ]
        return np.concatenate([values.reshape(*values.shape[:2], -1) for values in by_stance], axis=2)

    def step(self, slopes: sparse.csr_array, values: Array, damping: float) -> Array:
        """Return the step of all unknowns that minimises the sum of squares of the excess.

        A residual counts only while it exceeds its limit, so Newton steps with a line search find the minimum.
        """
        size = slopes.shape[1]
        slack = sparse.block_diag([damping * self.near.T @ self.near, 1e-3 * sparse.eye_array(self.n_pushes)])
        step, reached, shares = np.zeros(size), values, 0.6 ** np.arange(16)

        def total(step: Array, reached: Array) -> float:
            return float(step @ (slack @ step) + np.sum(self.beyond(reached) ** 2))

        least = total(step, reached)
        for _ in range(25):
            over = np.abs(reached) > self.allowed
            weighed = (sparse.diags_array(self.weights[over]) @ slopes[over]).tocsr()
            pull = weighed.T @ (self.weights * (values - np.sign(reached) * self.allowed))[over]
            factor = splu((slack + weighed.T @ weighed).tocsc(), "MMD_AT_PLUS_A", 0.0, options={"SymmetricMode": True})
            way = -factor.solve(pull) - step
            ahead = slopes @ way
            totals = [total(step + fraction * way, reached + fraction * ahead) for fraction in shares]
            best = int(np.argmin(totals))
            if totals[best] < least:
                step, reached = step + shares[best] * way, reached + shares[best] * ahead
            if totals[best] > 0.999 * least:
                break
            least = totals[best]
        return step


def _pushes(motion: RobotMotion, time_s: Array) -> list[tuple[int, Array]]:
    """Return the foot of each stance, and the Bernstein polynomials of the foot's force at times (K,).

    The polynomials of a stance have the shape (K, n), with up to `DEGREE` + 1 columns.
    """
    lasts, loops, stance_pushes = float(motion.time_s[-1] - motion.time_s[0]), motion.advance_m is not None, []
    for foot in range(len(LEGS)):
        spans = [(motion.time_s[a], motion.time_s[b]) for a, b in stances(motion.standing[:, foot])]
        if loops and len(spans) > 1 and motion.standing[0, foot]:
            spans = [*spans[1:-1], (spans[-1][0] - lasts, spans[0][1])]
        for begin, end in spans:
            open_ends = (not loops and begin == motion.time_s[0], not loops and end == motion.time_s[-1])
            orders = range(1 - open_ends[0], DEGREE + open_ends[1])
            fraction = (time_s[:, None] + np.array([-lasts, 0.0, lasts] if loops else [0.0]) - begin) / (end - begin)
            share_inside = np.where((fraction >= 0) & (fraction <= 1), fraction, np.nan)
            values = [
                np.nan_to_num(comb(DEGREE, n) * share_inside**n * (1 - share_inside) ** (DEGREE - n)) for n in orders
            ]
            stance_pushes.append((foot, np.stack(values).sum(axis=2).T))
    return stance_pushes


def kept(margins: dict[str, Array]) -> dict[str, dict[str, float]]:
    """Return, for each rule, the fraction of frames that keep the rule and its smallest margin."""
    return {
        name: {"share": float(np.mean(margins[name] >= rule.least)), "least": float(margins[name].min())}
        for name, rule in RULES.items()
    }


def least_share(motion: RobotMotion, model: MjModel) -> float:
    """Return the smallest fraction, over all rules, of frames that keep a rule."""
    return min(rule["share"] for rule in kept(check(motion, model)[1]).values())


TITLE_CHARACTERS = 60
"""Largest number of characters in a line above a panel of half the page's width."""


def margins_figure(time_s: Array, margins: Mapping[str, Array], rules: Mapping[str, Rule], title: str) -> Figure:
    """Draw the margins (K,) of each rule over time, with a dot at the smallest margin.

    Frames in which a rule does not apply have an infinite margin, and are left out.
    """
    with drawing(40.0 * -(-len(margins) // 2), title=title) as figure:
        panels = np.ravel(figure.subplots(-(-len(margins) // 2), 2, sharex=True))
        for axes, (name, values) in zip(panels, margins.items(), strict=True):
            label, unit, enough, _, per_unit = rules[name]
            drawn_rules = per_unit * np.where(np.isfinite(values), values, np.nan)
            least = int(np.nanargmin(drawn_rules))
            axes.axhline(per_unit * enough, color=GREY, lw=0.8)
            axes.plot(time_s, drawn_rules, color="k", lw=0.9)
            axes.plot(time_s[least], drawn_rules[least], "o", ms=3, color="k")
            smallest = float(drawn_rules[least])
            heading = fill(f"{label}: minimum {smallest:{decimals(smallest)}} {unit}", TITLE_CHARACTERS)
            axes.set_title(heading, fontsize=SMALL, loc="left", pad=2)
            axes.set_ylabel(unit, fontsize=SMALL)
        for axes in panels[-2:]:
            axes.set_xlabel("time (s)")
    return figure
