"""Whether a robot could do a motion, by MuJoCo's inverse dynamics: limits, torques, forces on the ground.

A robot's own file is taken as it is, without meshes. One that is described by its dimensions gets, from its masses, a
body with its inertia, links as capsules as thick as `LEGS_APART` says, and feet as points.

In every frame, forces of the feet that stand, within the friction cone, are sought that leave the least of what the
body's motion asks for; what is left, in weights, is the margin `forces`. It holds friction and the centre of pressure,
as feet push only where they are, and flights that are no free fall. `carried` moves the base until nothing is left,
and `followed` simulates a robot that follows what comes of it.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from itertools import product
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.optimize import nnls
from scipy.spatial.transform import RigidTransform, Rotation
from scipy.stats import binom

from recon.base.arrays import Array
from recon.base.errors import InputError, Problem
from recon.robotics.robot.quadruped import LEGS, Quadruped
from recon.robotics.robot.retarget import LEGS_APART, RobotMotion, posed, stances
from recon.robotics.robot.robot_file import SUFFIXES, read_model, root_of, the_mujoco
from recon.show.plots.style import GREY, SMALL, drawing

if TYPE_CHECKING:
    from matplotlib.figure import Figure

FRICTION = 0.8
RATE_HZ = 100.0
FOOT_M = 1e-3
GAINS = (100.0, 2.0)
"""N m / rad and N m s / rad."""
TIMESTEP_S, TORQUES_HZ = 5e-4, 500.0
STEP_S = 1e-4
"""Between velocities whose difference is an acceleration."""
SLOPES = np.array([[0, 0, 1], *([x, y, 1] for x, y in FRICTION * np.array([[1, 0], [-1, 0], [0, 1], [0, -1]]))])
"""Forces that span the friction cone."""
STRETCHED = 0.05
"""A foot does not move in a direction in which its leg reaches less than this share of its best."""
KNOTS_S, DEGREE, TURNS = 0.015, 5, 12
"""Between knots of the base's way; degree of the forces' polynomials; steps."""
TORQUES, NEAR, ENOUGH, CLOSE = 0.02, 0.15, 0.8, 1.0
"""Weights of torques (shares of the limits) and of the base's deviation (of the standing height, and rad)."""


class _Rule(NamedTuple):
    """What is looked at in every frame."""

    what: str
    least: float
    """The margin that is enough."""
    unit: str
    advice: str
    """What to change where it is not kept."""


RULES = {
    "joint_limits": _Rule("joints within their limits", -1e-6, "rad", "a smaller --scale"),
    "joint_rates": _Rule("joint rates, left of the limit", -1e-6, "share", "--fit-limits, or a larger --slower"),
    "torques": _Rule("torques, left of the limit", 0.0, "share", "--fit-limits, or a larger --slower"),
    "forces": _Rule("forces that standing feet lack", -0.1, "weight", "--fit-limits"),
    "legs_apart": _Rule("legs that run into each other", 0.0, "m", "a smaller --scale"),
    "ground": _Rule("lowest point above the ground", -1e-3, "m", "a smaller --scale"),
}


def simulated(robot: Quadruped) -> Any:
    """MuJoCo's model (`MjModel`) of the robot, free in the world. Raises InputError for one without masses."""
    if Path(robot.source).suffix.lower() in SUFFIXES:
        return read_model(robot.source, free=True)
    return described(robot).compile()


def described(robot: Quadruped) -> Any:
    """What MuJoCo makes a model from (`MjSpec`), of a robot that is described by its dimensions. Raises InputError."""
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
        body, at, way = base, np.zeros(3), np.zeros(3)
        for j, name in enumerate(leg.joints):
            body = body.add_body(name=name, pos=places[j] - at)
            at, way = places[j], places[j + 1] - places[j]
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


class _Frames(NamedTuple):
    """What a motion asks for at K times, by the base's place, its turn about the world's axes and the J joints."""

    needed: Array
    """(K, 6 + J): forces, moments and torques, without those of the ground."""
    moves: Array
    """(K, 4, 3, 6 + J): how the feet move with them."""
    mass: Array
    """(K, 6, 6): what an acceleration of the base asks for while the feet keep to their paths."""
    apart_m: Array
    """(K,): the least distance of parts that run into each other, negative, else 0."""


def _frames(motion: RobotMotion, model: Any, time_s: Array) -> _Frames:
    mujoco, robot = the_mujoco(motion.robot.source), motion.robot
    joints = [model.joint(name) for name in robot.joints]
    order = [*range(6), *(joint.dofadr[0] for joint in joints)]
    bodies = [model.joint(leg.joints[-1]).bodyid[0] for leg in robot.legs.values()]
    ends = np.cumsum([6, *(len(leg.joints) for leg in robot.legs.values())])
    data, rates = mujoco.MjData(model), np.zeros((2, model.nv))
    feet = robot.tree.pose(motion.states(time_s)).points_m[:, robot.foot_markers]
    near, rows = np.stack([motion.states(time_s + step) for step in (-STEP_S, 0.0, STEP_S)], axis=1), []
    off = int(mujoco.mjtDisableBit.mjDSBL_CONSTRAINT)
    for states, points in zip(near, feet, strict=True):
        places = _places(model, robot, states)
        for rate, before, after in zip(rates, places[:-1], places[1:], strict=True):
            mujoco.mj_differentiatePos(model, rate, STEP_S, before, after)
        data.qpos[:], data.qvel[:], data.qacc[:] = places[1], rates.mean(axis=0), (rates[1] - rates[0]) / STEP_S
        mujoco.mj_fwdPosition(model, data)
        apart = min((float(c.dist) for c in data.contact), default=0.0)
        model.opt.disableflags |= off
        mujoco.mj_inverse(model, data)
        model.opt.disableflags &= ~off
        turn, mass, moves = np.eye(len(order)), np.zeros((model.nv, model.nv)), np.zeros((4, 3, model.nv))
        turn[3:6, 3:6] = Rotation.from_quat(places[1, 3:7], scalar_first=True).as_matrix()
        mujoco.mj_fullM(model, data, mass)
        held = np.eye(len(order), 6)
        for k, point in enumerate(points):
            mujoco.mj_jac(model, data, moves[k], None, point, bodies[k])
            leg = slice(ends[k], ends[k + 1])
            own = moves[k][:, order]
            held[leg] = -np.linalg.pinv(own[:, leg], rcond=STRETCHED) @ own[:, :6]
        wide = turn @ mass[np.ix_(order, order)] @ held @ turn[:6, :6].T
        rows.append((turn @ data.qfrc_inverse[order], moves[..., order] @ turn.T, wide[:6], apart))
    return _Frames(*(np.array(of) for of in zip(*rows, strict=True)))


def _places(model: Any, robot: Quadruped, states: Array) -> Array:
    """MuJoCo's (K, nq) of states (K, 6 + J) of the robot's tree."""
    places = np.zeros((len(states), model.nq))
    places[:, :3] = states[:, :3]
    places[:, 3:7] = Rotation.from_euler("ZYX", states[:, 3:6]).as_quat(scalar_first=True)
    places[:, [model.joint(name).qposadr[0] for name in robot.joints]] = states[:, 6:]
    return places


def _units(motion: RobotMotion, model: Any, torques: float) -> Array:
    """(6 + J): what forces and moments on the base, as shares of the weight, and torques, as shares of their limits
    times a factor, are multiplied by."""
    weight = float(model.body_subtreemass[root_of(model)]) * float(np.linalg.norm(model.opt.gravity))
    limits = model.jnt_actfrcrange[[model.joint(name).id for name in motion.robot.joints], 1]
    of_base = np.array([1, 1, 1, *[1 / motion.robot.stand_m] * 3]) / weight
    return np.concatenate([of_base, torques / np.where(limits > 0, limits, np.inf)])  # a file may state none


def balanced(motion: RobotMotion, model: Any, time_s: Array) -> tuple[Array, _Frames]:
    """What is left (K, 6 + J) of a motion's needs at times (K,), and these: what the forces of the feet that stand, in
    the friction cone, do not give the base, and the joints' torques with these forces."""
    found, asked = _frames(motion, model, time_s), _units(motion, model, 1e-3)
    left = found.needed.copy()
    for k, stands in enumerate(motion.stands_at(time_s)):
        if stands.any():
            pushes = (SLOPES @ found.moves[k, stands]).reshape(-1, len(asked)).T
            left[k] -= pushes @ nnls(asked[:, None] * pushes, asked * left[k])[0]
    return left, found


def check(motion: RobotMotion, model: Any) -> tuple[Array, dict[str, Array]]:
    """Times (K,), and by the names of `RULES` the margins (K,) of a motion."""
    duration = float(motion.time_s[-1] - motion.time_s[0])
    time = motion.time_s[0] + np.linspace(0.0, duration, max(2, round(duration * RATE_HZ) + 1))
    states, rates = motion.states(time), motion.states(time, 1)
    lower, upper, fastest = motion.robot.limits()
    left, found = balanced(motion, model, time)
    used = _used(_units(motion, model, 1.0) * left)
    return time, {
        "joint_limits": np.minimum(states[:, 6:] - lower, upper - states[:, 6:]).min(axis=1),
        "joint_rates": 1 - np.abs(rates[:, 6:] / fastest).max(axis=1),
        "torques": 1 - used[:, 1:].max(axis=1),
        "forces": used[:, 0] * RULES["forces"].least,
        "legs_apart": found.apart_m,
        "ground": motion.robot.tree.pose(states).points_m[..., 2].min(axis=1),
    }


def followed(motion: RobotMotion, strides: int = 1) -> tuple[Array, Array]:
    """A simulation of the robot that follows a motion, and what it does: times (K,), and how far the base is from where
    it should be (K,), in metres. Of a robot that is described by its dimensions.

    Each joint is driven by the torque that the motion asks for with the forces of the standing feet, and by a spring
    and a damper (`GAINS`) to its angle and rate in the motion, at every step of the simulation, within its limits. The
    ground is level, with a friction of 1.
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
    torques = CubicSpline(knots, balanced(motion, model, motion.time_s[0] + knots)[0][:, 6:])(time % lasts)
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


def carried(motion: RobotMotion, model: Any) -> tuple[RobotMotion, Array]:
    """The motion with its base moved by as little as lets the feet carry it, and by how much (N, 6): along and about
    the world's axes.

    The base's way is a cubic spline through knots `KNOTS_S` apart. Each stance pushes with forces in the friction cone
    that grow from nothing and fade to nothing, as Bernstein's polynomials do. Both are found together by least squares
    (Levenberg and Marquardt's steps, the base's dynamics anew in each): of what the forces leave of the motion's
    needs, of the torques, and of the base's deviation.
    """
    start, loops = motion.time_s[0], motion.advance_m is not None
    lasts = float(motion.time_s[-1] - start)
    time = start + np.linspace(0.0, lasts, (1 + loops) * max(4, round(RATE_HZ * lasts)) + 1)[: -1 if loops else None]
    knots = start + np.linspace(0.0, lasts, max(6, round(lasts / KNOTS_S)) + 1)
    at = np.eye(len(knots))
    if loops:
        spline = CubicSpline(knots, np.vstack([at[:-1, :-1], at[:1, :-1]]), bc_type="periodic")
    else:
        spline = CubicSpline(knots, at)
    here, bends = spline(time), spline(time, 2)
    pushes, asked = _pushes(motion, time), np.tile(_units(motion, model, TORQUES), (len(time), 1))
    scale = np.array([1 / motion.robot.stand_m] * 3 + [1.0] * 3)
    near = np.einsum("kn,ij->kinj", here, np.diag(scale)).reshape(-1, 6 * here.shape[1])

    def least(found: _Frames, moved: Array, forces: Array, damping: float) -> tuple[Array, Array]:
        """Shares of the pushes, and the step of the base's knots (n, 6)."""
        ways = [np.einsum("gi,kij,km->kjgm", SLOPES, found.moves[:, foot], grown) for foot, grown in pushes]
        ways = np.concatenate([way.reshape(*way.shape[:2], -1) for way in ways], axis=2)
        asks = np.zeros((*asked.shape, here.shape[1], 6))
        asks[:, :6] = np.einsum("kij,kn->kinj", found.mass, bends)
        # A foot's force turns the base the less about itself the nearer the base is to its line.
        asks[:, 3:6, :, :3] += np.einsum("kij,kn->kinj", np.cross(np.eye(3), forces[:, None]).swapaxes(1, 2), here)
        asks = -(asked[..., None, None] * asks).reshape(-1, near.shape[1])
        free = np.concatenate([asks, NEAR * near, damping * near])
        target = np.concatenate([(asked * found.needed).ravel(), -NEAR * near @ moved.ravel(), np.zeros(len(near))])
        shares = np.zeros((len(free), ways.shape[2]))
        shares[: len(asks)] = (asked[..., None] * ways).reshape(-1, ways.shape[2])
        own = np.linalg.qr(free)[0]
        best, _ = nnls(shares - own @ (own.T @ shares), target - own @ (own.T @ target), maxiter=10 * shares.shape[1])
        step = np.linalg.lstsq(free, target - shares @ best)[0]
        return ways @ best, np.asarray(step, float).reshape(-1, 6)

    def based(moved: Array) -> RobotMotion:
        off = spline(motion.time_s) @ moved
        pose = RigidTransform.from_components(
            motion.pose.translation + off[:, :3], Rotation.from_rotvec(off[:, 3:]) * motion.pose.rotation
        )
        again = posed(motion.robot, motion.time_s, pose, motion.feet_m, motion.standing)
        return replace(again, scale=motion.scale, slower=motion.slower, advance_m=motion.advance_m)

    plain, tight = asked[0] * np.array([1.0] * 6 + [1 / TORQUES] * len(motion.robot.joints)), 1e-3
    left, found = balanced(motion, model, time)
    moved, size, forces = np.zeros((here.shape[1], 6)), np.inf, np.zeros((len(time), 3))
    best = float(_used(plain * left).max()), motion, moved
    for _ in range(TURNS):
        if best[0] < 0.95:
            break
        given, step = least(found, moved, forces, tight)
        tried = based(moved + step)
        after = _frames(tried, model, time)
        left = after.needed - given
        if tried.short.any() or np.linalg.norm((asked * left)[:, :6]) > max(size, CLOSE):
            tight *= 8
            continue
        moved, found, forces, tight = moved + step, after, given[:, :3], tight / 4
        used = _used(plain * left)
        if used.max() < best[0]:
            best = float(used.max()), tried, moved
        # More weight for what is still too much.
        asked[:, :6] *= np.clip(used[:, :1] / ENOUGH, 1.0, 2.0)
        asked[:, 6:] *= np.clip(used[:, 1:] / ENOUGH, 1.0, 2.0)
        size = float(np.linalg.norm((asked * left)[:, :6]))
    return best[1], spline(motion.time_s) @ best[2]


def _used(left: Array) -> Array:
    """(K, 1 + J): what is left of the base's needs (shares of the weight), of what may be, and the torques' shares."""
    missing = np.linalg.norm(left[:, :3], axis=1) + np.linalg.norm(left[:, 3:6], axis=1)
    return np.column_stack([missing / -RULES["forces"].least, np.abs(left[:, 6:])])


def _pushes(motion: RobotMotion, time_s: Array) -> list[tuple[int, Array]]:
    """The foot of each stance, and how its forces may grow and fade (K, .) at times (K,)."""
    lasts, loops, found = float(motion.time_s[-1] - motion.time_s[0]), motion.advance_m is not None, []
    for foot in range(len(LEGS)):
        spans = [(motion.time_s[a], motion.time_s[b]) for a, b in stances(motion.standing[:, foot])]
        if loops and len(spans) > 1 and motion.standing[0, foot]:
            spans = [*spans[1:-1], (spans[-1][0] - lasts, spans[0][1])]
        for begin, end in spans:
            open_ends = (not loops and begin == motion.time_s[0], not loops and end == motion.time_s[-1])
            orders = range(1 - open_ends[0], DEGREE + open_ends[1])
            share = (time_s[:, None] + np.array([-lasts, 0.0, lasts] if loops else [0.0]) - begin) / (end - begin)
            values = [
                np.where((share >= 0) & (share <= 1), binom.pmf(n, DEGREE, np.clip(share, 0, 1)), 0) for n in orders
            ]
            found.append((foot, np.stack(values).sum(axis=2).T))
    return found


def kept(margins: dict[str, Array]) -> dict[str, dict[str, float]]:
    """For the report: by rule the share of frames that keep it, and the least margin."""
    return {
        name: {"share": float(np.mean(margins[name] >= rule.least)), "least": float(margins[name].min())}
        for name, rule in RULES.items()
    }


def changes() -> list[tuple[float, float, float]]:
    """Factors on times, lengths and the standing height that are tried, the smallest change first."""
    every = product((1.0, 1.3), (1.0, 0.8, 0.6), (1.0, 1.1))
    return sorted(every, key=lambda factors: float(np.abs(np.log(factors)).sum()))


def margins_figure(time_s: Array, margins: Mapping[str, tuple[Array, float, str]], title: str) -> Figure:
    """Margins over time by what they are of: values (K,), infinite where there are none, what they have to stay above,
    and their unit. A dot is the least."""
    with drawing(40.0 * -(-len(margins) // 2), title=title) as figure:
        panels = np.ravel(figure.subplots(-(-len(margins) // 2), 2, sharex=True))
        for axes, (what, (values, enough, unit)) in zip(panels, margins.items(), strict=True):
            shown = np.where(np.isfinite(values), values, np.nan)
            least = int(np.nanargmin(shown))
            axes.axhline(enough, color=GREY, lw=0.8)
            axes.plot(time_s, shown, color="k", lw=0.9)
            axes.plot(time_s[least], shown[least], "o", ms=3, color="k")
            axes.set_title(f"{what}: least {shown[least]:.3g} {unit}", fontsize=SMALL, loc="left", pad=2)
            axes.set_ylabel(unit, fontsize=SMALL)
        for axes in panels[-2:]:
            axes.set_xlabel("time (s)")
    return figure
