"""Whether a robot could do a motion, by MuJoCo's inverse dynamics: limits, torques, forces on the ground.

A robot's own file is taken as it is, without meshes. One that is described by its dimensions gets, from its masses, a
body with its inertia, links as capsules as thick as `LEGS_APART` says, and feet as points.

In every frame, forces of the feet that stand, within the friction cone, are sought that leave the least of what the
body's motion asks for; what is left, in weights, is the margin `forces`. It holds friction and the centre of pressure,
as feet push only where they are, and flights that are no free fall. `carried` moves the base until every rule is kept,
and `followed` simulates a robot that follows what comes of it.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from math import comb
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from scipy import sparse
from scipy.interpolate import BSpline, CubicSpline
from scipy.optimize import nnls
from scipy.sparse.linalg import splu
from scipy.spatial.transform import Rotation

from recon.base.arrays import Array
from recon.base.errors import InputError, Problem
from recon.robotics.quadruped import LEGS, SUFFIXES, Quadruped, read_model, root_of, the_mujoco
from recon.robotics.retarget import LEGS_APART, RobotMotion, moved_by, stances, swinging
from recon.show.plots.style import GREY, SMALL, drawing

if TYPE_CHECKING:
    from matplotlib.figure import Figure

FRICTION = 0.8
RATE_HZ = 100.0
FOOT_M = 1e-3
GAINS = (100.0, 2.0)
"""N m / rad and N m s / rad."""
TIMESTEP_S, TORQUES_HZ = 5e-4, 500.0
STEP_S, STEP = 1e-4, 1e-5
"""Between velocities whose difference is an acceleration; of states whose difference is a derivative."""
SLOPES = np.array([[0, 0, 1], *([x, y, 1] for x, y in FRICTION * np.array([[1, 0], [-1, 0], [0, 1], [0, -1]]))])
"""Forces that span the friction cone."""
TRIES = 5
"""How often forces are sought that keep the torques' limits, too."""
STRETCHED = 0.05
"""A foot does not move in a direction in which its leg reaches less than this share of its best."""
CHANGES = ((1.0, 1.0), (1.0, 0.8), (1.0, 0.6), (1.0, 0.5), (1.0, 0.4), (1.3, 0.8), (1.3, 0.6), (1.3, 0.5))
"""Factors on times and lengths that are tried, in this order: shorter strides first, as a slower robot has to leap the
higher over the same share of a stride."""
DEGREE, MOST = 5, 10.0
"""The degree of the polynomials by which forces grow and fade; the largest coefficient, in weights."""
TURNS, HOPELESS = 12, 50.0
"""Steps at most; what is beyond the limits after three of them where more steps do not help."""
UNIT, TORQUE, WITHIN, NEAR = 0.02, 0.05, 0.02, 3.0
"""What a step allows of each as much: shares of the weight that are left, and of limits of torques, rates and angles,
beyond what is aimed at; weight of the base's deviation (of the standing height, and rad)."""
AIM = {"base": 0.0, "torques": 0.85, "rates": 0.95, "angles": 0.97}
"""Shares of the limits."""
WIDER_RAD = 0.4
"""What joints may go beyond their limits by on the way to a base with which they keep them."""


class Rule(NamedTuple):
    """A rule that is looked at in every frame, and how its margin is shown."""

    what: str
    unit: str
    """How it is printed."""
    least: float = 0.0
    """The margin that is enough."""
    advice: str = ""
    """What to change where it is not kept."""
    per_unit: float = 1.0
    """What a value is multiplied by when it is printed."""


RULES = {
    "joint_limits": Rule("joints within their limits", "rad", -1e-6, "a smaller --scale"),
    "joint_rates": Rule("joint rates, left of the limit", "share", -1e-6, "--fit-limits, or a larger --slower"),
    "torques": Rule("torques, left of the limit", "share", 0.0, "--fit-limits, or a larger --slower"),
    "forces": Rule("forces that standing feet lack", "weight", -0.1, "--fit-limits"),
    "legs_apart": Rule("legs that run into each other", "m", 0.0, "a smaller --scale"),
    "ground": Rule("lowest point above the ground", "m", -1e-3, "a smaller --scale"),
}


def simulated(robot: Quadruped) -> Any:
    """Return MuJoCo's model (`MjModel`) of a robot, free in the world; raise InputError for one without masses."""
    if Path(robot.source).suffix.lower() in SUFFIXES:
        return read_model(robot.source, free=True)
    return described(robot).compile()


def described(robot: Quadruped) -> Any:
    """Return MuJoCo's description (`MjSpec`) of a robot given by its dimensions; raise InputError."""
    mujoco = the_mujoco(robot.source)
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
        places, axes = leg.chain.positions(np.zeros(leg.chain.n)), leg.chain.joint_axes(np.zeros(leg.chain.n))
        body, position, way = base, np.zeros(3), np.zeros(3)
        for j, name in enumerate(leg.joints):
            body = body.add_body(name=name, pos=places[j] - position)
            position, way = places[j], places[j + 1] - places[j]
            limit = masses.max_torque_n_m[j]
            within = {"limited": 1, "range": [leg.chain.lower_rad[j], leg.chain.upper_rad[j]]}
            body.add_joint(name=name, axis=axes[j], actfrclimited=1, actfrcrange=[-limit, limit], **within)
            kind = {"type": capsule, "fromto": [*np.zeros(3), *way]} if np.linalg.norm(way) > 1e-3 else {"type": sphere}
            # Legs meet those of other legs only.
            meet = {"contype": (1 << k) if j else 0, "conaffinity": (15 & ~(1 << k)) if j else 0}
            body.add_geom(**kind, size=[thick, 0, 0], mass=masses.links_kg[j], **meet)
        foot = {"name": f"{label} foot", "type": sphere, "size": [FOOT_M, 0, 0], "pos": way}
        body.add_geom(**foot, mass=masses.foot_kg, contype=0, conaffinity=0)
    return spec


class _Asked(NamedTuple):
    """Forces that N states of a robot, with rates and accelerations, ask for.

    They go by the base's position, its turn about its own axes and the J joints.
    """

    needed: Array
    """(N, 6 + J): forces, moments and torques, without those of the ground."""
    moves: Array
    """(N, 4, 3, 6 + J): how the feet move with them."""


def _asked(robot: Quadruped, model: Any, states: Array, rates: Array, bends: Array) -> _Asked:
    """Return what states (N, 6 + J) of the robot's tree, their rates and their accelerations ask for."""
    mujoco = the_mujoco(robot.source)
    joints = [model.joint(name) for name in robot.joints]
    order = [*range(6), *(joint.dofadr[0] for joint in joints)]
    bodies = [model.joint(leg.joints[-1]).bodyid[0] for leg in robot.legs.values()]
    data, n = mujoco.MjData(model), len(states)
    places, v, a = _places(model, robot, states), np.zeros((n, model.nv)), np.zeros((n, model.nv))
    v[:, order], a[:, order] = rates, bends
    on, here, off = (
        Rotation.from_euler("ZYX", (states + step * rates + step**2 / 2 * bends)[:, 3:6])
        for step in (STEP_S, 0.0, -STEP_S)
    )
    later, earlier = ((one.inv() * other).as_rotvec() / STEP_S for one, other in ((here, on), (off, here)))
    v[:, 3:6], a[:, 3:6] = (later + earlier) / 2, (later - earlier) / STEP_S
    feet = robot.tree.pose(states).points_m[:, robot.foot_markers]
    needed, moves = np.zeros((n, model.nv)), np.zeros((n, len(LEGS), 3, model.nv))
    flags = model.opt.disableflags
    model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONSTRAINT)
    for k in range(n):
        data.qpos[:], data.qvel[:], data.qacc[:] = places[k], v[k], a[k]
        mujoco.mj_inverse(model, data)
        needed[k] = data.qfrc_inverse
        for foot, body in enumerate(bodies):
            mujoco.mj_jac(model, data, moves[k, foot], None, feet[k, foot], body)
    model.opt.disableflags = flags
    return _Asked(needed[:, order], moves[..., order])


def _apart(motion: RobotMotion, model: Any, time_s: Array) -> Array:
    """Return the least distance (K,) of parts that run into each other, negative, else 0."""
    mujoco = the_mujoco(motion.robot.source)
    data, distances = mujoco.MjData(model), np.zeros(len(time_s))
    for k, place in enumerate(_places(model, motion.robot, motion.states(time_s))):
        data.qpos[:] = place
        mujoco.mj_fwdPosition(model, data)
        distances[k] = min((float(c.dist) for c in data.contact), default=0.0)
    return distances


def _places(model: Any, robot: Quadruped, states: Array) -> Array:
    """Return MuJoCo's coordinates (K, nq) of states (K, 6 + J) of the robot's tree."""
    places = np.zeros((len(states), model.nq))
    places[:, :3] = states[:, :3]
    places[:, 3:7] = Rotation.from_euler("ZYX", states[:, 3:6]).as_quat(scalar_first=True)
    places[:, [model.joint(name).qposadr[0] for name in robot.joints]] = states[:, 6:]
    return places


def _units(motion: RobotMotion, model: Any, torques: float) -> Array:
    """Return factors (6 + J) that make shares of forces, moments and torques.

    Forces and moments on the base are shares of the weight, torques shares of their limits times a factor.
    """
    weight = float(model.body_subtreemass[root_of(model)]) * float(np.linalg.norm(model.opt.gravity))
    limits = model.jnt_actfrcrange[[model.joint(name).id for name in motion.robot.joints], 1]
    of_base = np.array([1, 1, 1, *[1 / motion.robot.stand_m] * 3]) / weight
    return np.concatenate([of_base, torques / np.where(limits > 0, limits, np.inf)])  # a file may state none


def balanced(motion: RobotMotion, model: Any, time_s: Array) -> Array:
    """Return what is left (K, 6 + J) of a motion's needs at times (K,).

    It is what the forces of the standing feet, in the friction cone, do not give the base, and the joints' torques with
    these forces.
    """
    asked, plain = _asked(motion.robot, model, *_states(motion, time_s)), _units(motion, model, 1.0)
    left = asked.needed.copy()
    for k, stands in enumerate(motion.stands_at(time_s)):
        pushes = (SLOPES @ asked.moves[k, stands]).reshape(-1, len(plain)).T
        units, over = plain * ([1.0] * 6 + [1e-3] * (len(plain) - 6)), np.zeros(len(plain), bool)
        for _ in range(TRIES if stands.any() else 0):
            units[over] *= 3
            left[k] = asked.needed[k] - pushes @ nnls(units[:, None] * pushes, units * asked.needed[k])[0]
            over[6:] = np.abs(plain * left[k])[6:] > 1
            if not over.any():
                break
    return left


def _states(motion: RobotMotion, time_s: Array) -> tuple[Array, Array, Array]:
    """Return states (K, 6 + J) of the robot's tree at times (K,), their rates and their accelerations."""
    states, rates, bends = (motion.states(time_s, order) for order in range(3))
    return states, rates, bends


def check(motion: RobotMotion, model: Any) -> tuple[Array, dict[str, Array]]:
    """Return times (K,), and by the names of `RULES` the margins (K,) of a motion."""
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

    Each joint is driven by the torque that the motion asks for with the forces of the standing feet, and by a spring
    and a damper (`GAINS`) to its angle and rate in the motion, at every step of the simulation, within its limits. The
    ground is level, with a friction of 1.

    Returns
    -------
    time_s : (K,)
        Times.
    off_m : (K,)
        Distance of the base from its position in the motion.
    """
    mujoco, robot = the_mujoco(motion.robot.source), motion.robot
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
    places, columns = [joint.qposadr[0] for joint in order], [joint.dofadr[0] for joint in order]
    limits = world.jnt_actfrcrange[[joint.id for joint in order], 1]
    lasts = float(motion.time_s[-1] - motion.time_s[0])
    time = np.linspace(0.0, strides * lasts, round(strides * lasts / TIMESTEP_S), endpoint=False)
    knots = np.linspace(0.0, lasts, round(lasts * TORQUES_HZ) + 1)
    torques = CubicSpline(knots, balanced(motion, model, motion.time_s[0] + knots)[:, 6:])(time % lasts)
    states, rates = motion.states(motion.time_s[0] + time), motion.states(motion.time_s[0] + time, 1)
    off = np.zeros(len(time))
    begin = _places(model, robot, motion.states(motion.time_s[0] + np.array([0.0, STEP_S])))
    data.qpos[:] = begin[0]
    mujoco.mj_differentiatePos(world, data.qvel, STEP_S, *begin)
    for k, (state, rate, torque) in enumerate(zip(states, rates, torques, strict=True)):
        off[k] = np.linalg.norm(data.qpos[:3] - state[:3])
        torque = torque + GAINS[0] * (state[6:] - data.qpos[places]) + GAINS[1] * (rate[6:] - data.qvel[columns])
        data.qfrc_applied[columns] = np.clip(torque, -limits, limits)
        mujoco.mj_step(world, data)
    return time, off


def carried(motion: RobotMotion, model: Any, hopeless: float = HOPELESS) -> tuple[RobotMotion, Array]:
    """Return a motion with its base moved by as little as lets the robot do it, and by how much (N, 6).

    The move is of the base's position, yaw, pitch and roll. Where no motion is found that keeps every rule, it is the
    last one tried; `hopeless` is as `HOPELESS`.

    The base's path is a cubic spline with a knot a frame. Each stance pushes with forces in the friction cone that grow
    from nothing and fade to nothing, as Bernstein's polynomials do. Both are found together by least squares (Levenberg
    and Marquardt's steps, with the derivatives of the whole robot's dynamics): of what the forces leave of the base's
    needs, of what torques, rates and angles are beyond their limits, and of the base's deviation.
    """
    work, off = _Carrying(motion, model), np.zeros((len(motion.time_s), 6))
    moved, pushes = np.zeros(work.moved_shape), np.full(work.n_pushes, 0.2)
    now, best, found = motion, motion, _asked(motion.robot, model, *_states(motion, work.time_s))
    values, damping, slow = work.values(now, found, moved, pushes), 300.0, 0
    for turn in range(TURNS):
        if least_share(best, model) == 1 or slow > 2:
            break
        beyond = work.beyond(values)
        if turn > 2 and float(np.sum(beyond[work.limited] ** 2)) > hopeless:
            break
        cost, slopes = float(np.sum(beyond**2)), work.slopes(now, found, pushes)
        for _ in range(8):
            step = work.step(slopes, values, damping)
            to, by = moved + step[: moved.size].reshape(moved.shape), pushes + step[moved.size :]
            tried = moved_by(motion, work.everywhere @ to, work.wider)
            after = _asked(motion.robot, model, *_states(tried, work.time_s))
            ahead = work.values(tried, after, to, by)
            less = float(np.sum(work.beyond(ahead) ** 2))
            if less < cost:
                break
            damping *= 5
        else:
            break
        slow = slow + 1 if less > 0.98 * cost else 0
        now, moved, pushes, found, values, damping = tried, to, by, after, ahead, damping / 5
        off = work.everywhere @ moved
        best = moved_by(motion, off)
    return best, off


class _Carrying:
    """The least squares of `carried`, over K frames.

    Rows are what is left of the base's needs; torques, rates and angles as shares of their limits; pushes; and the
    base's deviation. Columns are the base's path and the pushes.
    """

    def __init__(self, motion: RobotMotion, model: Any) -> None:
        self.motion, self.model, robot = motion, model, motion.robot
        self.start, self.lasts = motion.time_s[0], float(motion.time_s[-1] - motion.time_s[0])
        self.loops, self.frames = motion.advance_m is not None, max(6, round(RATE_HZ * self.lasts))
        time = self.start + np.linspace(0.0, self.lasts, self.frames + 1)
        self.time_s = time[:-1] if self.loops else time
        self.ways = [self._spline(self.time_s, order) for order in range(3)]
        self.everywhere = self._spline(motion.time_s)
        self.units = _units(motion, model, 1.0)
        lower, upper, self.fastest = robot.limits()
        lower, upper = np.maximum(lower, -1e3), np.minimum(upper, 1e3)  # a file may state none
        self.middle, self.half = (lower + upper) / 2, (upper - lower) / 2
        wider = {}
        for label, leg in robot.legs.items():
            lower, upper = leg.chain.lower_rad - WIDER_RAD, leg.chain.upper_rad + WIDER_RAD
            wider[label] = replace(leg, chain=replace(leg.chain, lower_rad=lower, upper_rad=upper))
        self.wider = replace(robot, legs=wider)
        loose = swinging(motion)
        self.held = 1 - np.stack([np.interp(self.time_s, motion.time_s, of) for of in loose.T], axis=1)
        self.stances = [(foot, grown / self.units[0]) for foot, grown in _pushes(motion, self.time_s)]
        self.n_pushes = len(SLOPES) * sum(grown.shape[1] for _, grown in self.stances)
        K, n, J = len(self.time_s), self.ways[0].shape[1], len(robot.joints)
        self.moved_shape = n, 6
        scale = np.diag([1 / robot.stand_m] * 3 + [1.0] * 3)
        self.near = sparse.csr_array(np.einsum("kn,ij->kinj", self.ways[0], scale).reshape(6 * K, 6 * n))
        sizes = [6 * K, J * K, J * K, J * K, self.n_pushes, 6 * K]
        self.weights = np.repeat([1 / UNIT, 1 / TORQUE, 1 / WITHIN, 1 / WITHIN, 1 / UNIT, NEAR], sizes)
        self.allowed = np.repeat([*AIM.values(), MOST / 2, 0.0], sizes)
        self.limited = slice(6 * K, sum(sizes[:4]))

    def _spline(self, time_s: Array, order: int = 0) -> Array:
        """Return how each of the spline's coefficients moves the base at times (K,): (K, n), or its derivative."""
        m, size = self.frames, self.lasts / self.frames
        at = np.clip((time_s - self.start) / size, 0, m)
        columns = BSpline(np.arange(-3.0, m + 4), np.eye(m + 3), 3)(at, nu=order) / size**order
        if not self.loops:
            return columns
        columns[:, :3] += columns[:, m:]
        return columns[:, :m]

    def _forces(self, pushes: Array) -> Array:
        """Return the forces (K, 4, 3) on the feet."""
        forces, ends = np.zeros((len(self.time_s), len(LEGS), 3)), 0
        for foot, grown in self.stances:
            begin, ends = ends, ends + len(SLOPES) * grown.shape[1]
            forces[:, foot] += grown @ pushes[begin:ends].reshape(len(SLOPES), -1).T @ SLOPES
        return forces

    def values(self, motion: RobotMotion, found: _Asked, moved: Array, pushes: Array) -> Array:
        """Return the rows, of a motion and what it asks for."""
        states, rates, _ = _states(motion, self.time_s)
        left = self.units * (found.needed - np.einsum("kfi,kfij->kj", self._forces(pushes), found.moves))
        shares = [left[:, :6], left[:, 6:], rates[:, 6:] / self.fastest, (states[:, 6:] - self.middle) / self.half]
        return np.concatenate([*(of.ravel() for of in shares), pushes - MOST / 2, self.near @ moved.ravel()])

    def beyond(self, values: Array) -> Array:
        """Return how far rows are beyond what is allowed, by their weights."""
        return self.weights * np.maximum(np.abs(values) - self.allowed, 0.0)

    def slopes(self, motion: RobotMotion, found: _Asked, pushes: Array) -> Any:
        """Return the rows' derivatives, sparse: by the base's path, and by the pushes."""
        states = _states(motion, self.time_s)
        K, J, forces = len(self.time_s), len(self.fastest), self._forces(pushes)
        # How states go with the base's: the joints of a leg whose foot is held turn with it.
        moves = motion.robot.tree.pose_with_jacobian(states[0]).jacobian[:, motion.robot.foot_markers]
        goes, ends = np.zeros((K, 6 + J, 6)), np.cumsum([6, *(len(leg.joints) for leg in motion.robot.legs.values())])
        goes[:, range(6), range(6)] = 1.0
        for foot, own in enumerate(map(slice, ends[:-1], ends[1:])):
            back = np.linalg.pinv(moves[:, foot, :, own], rcond=STRETCHED)
            goes[:, own] = -self.held[:, foot, None, None] * (back @ moves[:, foot, :, :6])
        if self.loops:
            time = np.append(self.time_s, self.start + self.lasts)
            along = CubicSpline(time, np.concatenate([goes, goes[:1]]), bc_type="periodic")
        else:
            along = CubicSpline(self.time_s, goes)
        speeds, bends, still = along(self.time_s, 1), along(self.time_s, 2), np.zeros_like(goes)

        def needs(*ways: Array) -> Array:
            """Return how needs change (K, 6 + J, 6) with states, rates and accelerations that change as given."""
            near = (np.swapaxes(of[:, :, None] + STEP * way, 1, 2) for of, way in zip(states, ways, strict=True))
            there = _asked(motion.robot, self.model, *(of.reshape(-1, 6 + J) for of in near))
            given = np.einsum("nfi,nfij->nj", np.repeat(forces, 6, axis=0), there.moves)
            here = found.needed - np.einsum("kfi,kfij->kj", forces, found.moves)
            return ((there.needed - given).reshape(K, 6, -1) - here[:, None]).swapaxes(1, 2) / STEP

        def rows(*parts: Array) -> Array:
            """Return derivatives by the spline's coefficients, from those by the base's deviation."""
            by = (np.einsum("kij,kn->kinj", part, way) for part, way in zip(parts, self.ways, strict=False))
            return np.sum([*by], axis=0).reshape(K, parts[0].shape[1], -1)

        left = self.units[:, None] * rows(
            needs(goes, speeds, bends), needs(still, goes, 2 * speeds), needs(still, still, goes)
        )
        rates = rows(speeds[:, 6:], goes[:, 6:]) / self.fastest[:, None]
        angles = rows(goes[:, 6:]) / self.half[:, None]
        given = [np.einsum("gi,kij,km->kjgm", SLOPES, found.moves[:, foot], of) for foot, of in self.stances]
        given = np.concatenate([of.reshape(K, 6 + J, -1) for of in given], axis=2) * -self.units[:, None]
        parts = [left[:, :6], left[:, 6:], rates, angles, given[:, :6], given[:, 6:]]
        base, torques, rates, angles, on_base, on_torques = (
            sparse.csr_array(of.reshape(-1, of.shape[2])) for of in parts
        )
        pushed = sparse.eye_array(self.n_pushes)
        return sparse.block_array(
            [[base, on_base], [torques, on_torques], [rates, None], [angles, None], [None, pushed], [self.near, None]],
            format="csr",
        )

    def step(self, slopes: Any, values: Array, damping: float) -> Array:
        """Return the step of all unknowns with the least sum of squares of what is beyond.

        These are Newton's steps, each as far as the sum falls, since a row counts only while it is beyond what is
        allowed.
        """
        size = slopes.shape[1]
        slack = sparse.block_diag([damping * self.near.T @ self.near, 1e-3 * sparse.eye_array(self.n_pushes)])
        step, now, shares = np.zeros(size), values, 0.6 ** np.arange(16)

        def total(step: Array, now: Array) -> float:
            return float(step @ (slack @ step) + np.sum(self.beyond(now) ** 2))

        least = total(step, now)
        for _ in range(25):
            over = np.abs(now) > self.allowed
            weighed = (sparse.diags_array(self.weights[over]) @ slopes[over]).tocsr()
            pull = weighed.T @ (self.weights * (values - np.sign(now) * self.allowed))[over]
            factor = splu((slack + weighed.T @ weighed).tocsc(), "MMD_AT_PLUS_A", 0.0, options={"SymmetricMode": True})
            way = -factor.solve(pull) - step
            ahead = slopes @ way
            totals = [total(step + share * way, now + share * ahead) for share in shares]
            best = int(np.argmin(totals))
            if totals[best] < least:
                step, now = step + shares[best] * way, now + shares[best] * ahead
            if totals[best] > 0.999 * least:
                break
            least = totals[best]
        return step


def _pushes(motion: RobotMotion, time_s: Array) -> list[tuple[int, Array]]:
    """Return the foot of each stance, and how its forces may grow and fade (K, .) at times (K,)."""
    lasts, loops, stance_pushes = float(motion.time_s[-1] - motion.time_s[0]), motion.advance_m is not None, []
    for foot in range(len(LEGS)):
        spans = [(motion.time_s[a], motion.time_s[b]) for a, b in stances(motion.standing[:, foot])]
        if loops and len(spans) > 1 and motion.standing[0, foot]:
            spans = [*spans[1:-1], (spans[-1][0] - lasts, spans[0][1])]
        for begin, end in spans:
            open_ends = (not loops and begin == motion.time_s[0], not loops and end == motion.time_s[-1])
            orders = range(1 - open_ends[0], DEGREE + open_ends[1])
            share = (time_s[:, None] + np.array([-lasts, 0.0, lasts] if loops else [0.0]) - begin) / (end - begin)
            within = np.where((share >= 0) & (share <= 1), share, np.nan)
            values = [np.nan_to_num(comb(DEGREE, n) * within**n * (1 - within) ** (DEGREE - n)) for n in orders]
            stance_pushes.append((foot, np.stack(values).sum(axis=2).T))
    return stance_pushes


def kept(margins: dict[str, Array]) -> dict[str, dict[str, float]]:
    """Return, for the report, by rule the share of frames that keep it, and the least margin."""
    return {
        name: {"share": float(np.mean(margins[name] >= rule.least)), "least": float(margins[name].min())}
        for name, rule in RULES.items()
    }


def least_share(motion: RobotMotion, model: Any) -> float:
    """Return the least share of frames that keep a rule."""
    return min(rule["share"] for rule in kept(check(motion, model)[1]).values())


def margins_figure(time_s: Array, margins: Mapping[str, Array], rules: Mapping[str, Rule], title: str) -> Figure:
    """Draw margins over time by rule, (K,), infinite where there are none; a dot is the least."""
    with drawing(40.0 * -(-len(margins) // 2), title=title) as figure:
        panels = np.ravel(figure.subplots(-(-len(margins) // 2), 2, sharex=True))
        for axes, (name, values) in zip(panels, margins.items(), strict=True):
            label, unit, enough, _, per_unit = rules[name]
            drawn_rules = per_unit * np.where(np.isfinite(values), values, np.nan)
            least = int(np.nanargmin(drawn_rules))
            axes.axhline(per_unit * enough, color=GREY, lw=0.8)
            axes.plot(time_s, drawn_rules, color="k", lw=0.9)
            axes.plot(time_s[least], drawn_rules[least], "o", ms=3, color="k")
            axes.set_title(f"{label}: least {drawn_rules[least]:.3g} {unit}", fontsize=SMALL, loc="left", pad=2)
            axes.set_ylabel(unit, fontsize=SMALL)
        for axes in panels[-2:]:
            axes.set_xlabel("time (s)")
    return figure
