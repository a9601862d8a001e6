"""Whether a robot could do a motion, by MuJoCo's inverse dynamics: limits, torques, forces on the ground.

A robot's own file is taken as it is, without meshes. One that is described by its dimensions gets, from its masses, a
body with its inertia, links as capsules as thick as `LEGS_APART` says, and feet as points.

Of every frame: forces of the feet that stand, within the friction cone, are sought that leave the least of what the
body's motion asks for; the share that is left of the weight is `force_missing`. It holds friction and the centre of
pressure, as feet push only where they are, and flights that are no free fall.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from scipy.optimize import nnls
from scipy.spatial.transform import Rotation

from recon.base.arrays import Array
from recon.base.errors import InputError, Problem
from recon.robotics.robot.quadruped import LEGS, Quadruped
from recon.robotics.robot.retarget import LEGS_APART, RobotMotion, slowed
from recon.robotics.robot.robot_file import SUFFIXES, read_model, root_of, the_mujoco
from recon.show.plots.style import GREY, SMALL, drawing

if TYPE_CHECKING:
    from matplotlib.figure import Figure

FRICTION = 0.8
RATE_HZ = 100.0
STEP_S = 1e-4
"""Between velocities whose difference is an acceleration."""
FACTOR = 1.05
"""Between the paces that are tried, of which there are `TRIED`."""
TRIED = 30


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
    "forces": _Rule("forces that standing feet lack", -0.1, "weight", "nothing here: a policy has to find its own"),
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
    for k, leg in enumerate(robot.legs.values()):
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
        body.add_geom(type=sphere, pos=way, size=[1e-3, 0, 0], mass=masses.foot_kg, contype=0, conaffinity=0)
    return spec


def check(motion: RobotMotion, model: Any) -> tuple[Array, dict[str, Array]]:
    """Times (K,), and by the names of `RULES` the margins (K,) of a motion."""
    mujoco = the_mujoco(motion.robot.source)
    robot, tree = motion.robot, motion.robot.tree
    duration = float(motion.time_s[-1] - motion.time_s[0])
    time = motion.time_s[0] + np.linspace(0.0, duration, max(2, round(duration * RATE_HZ) + 1))
    states, rates = motion.states(time), motion.states(time, 1)
    points = tree.pose(states).points_m
    feet = robot.foot_markers
    lower, upper, fastest = robot.limits()
    columns = [model.joint(name).dofadr[0] for name in robot.joints]
    torque_limits = model.jnt_actfrcrange[[model.joint(name).id for name in robot.joints], 1]
    root = root_of(model)
    stands = motion.stands_at(time)
    data, weight = mujoco.MjData(model), float(model.body_subtreemass[root]) * float(np.linalg.norm(model.opt.gravity))
    slopes = np.array([[0, 0, 1], *([x, y, 1] for x, y in FRICTION * np.array([[1, 0], [-1, 0], [0, 1], [0, -1]]))])
    torques, missing, apart = np.zeros(len(time)), np.zeros(len(time)), np.zeros(len(time))
    for k, t in enumerate(time):
        near = np.clip([t - STEP_S, t + STEP_S], time[0], time[-1])
        before, after = (_velocities(motion, at, columns, model.nv) for at in near)
        data.qpos[:7] = [*states[k, :3], *_turn(states[k]).as_quat(scalar_first=True)]
        data.qpos[[c + 1 for c in columns]] = states[k, 6:]
        data.qvel[:], data.qacc[:] = (before + after) / 2, (after - before) / (near[1] - near[0])
        mujoco.mj_fwdPosition(model, data)
        apart[k] = min((float(c.dist) for c in data.contact), default=0.0)
        model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONSTRAINT)
        mujoco.mj_inverse(model, data)
        model.opt.disableflags &= ~int(mujoco.mjtDisableBit.mjDSBL_CONSTRAINT)
        needed, ways = data.qfrc_inverse.copy(), []
        for label in np.flatnonzero(stands[k]):
            jacobian = np.zeros((3, model.nv))
            body = model.joint(robot.legs[LEGS[label]].joints[-1]).bodyid[0]
            mujoco.mj_jac(model, data, jacobian, None, points[k, feet[label]], body)
            ways += list(slopes @ jacobian)
        if ways:
            pushes = np.array(ways).T
            size = np.array([1, 1, 1, *(1 / robot.stand_m for _ in range(3))]) / weight
            of_torques = 1e-3 / torque_limits[:, None]
            left = np.vstack([size[:, None] * pushes[:6], of_torques * pushes[columns]])
            found, _ = nnls(left, np.concatenate([size * needed[:6], of_torques[:, 0] * needed[columns]]))
            needed = needed - pushes @ found
        missing[k] = np.linalg.norm(needed[:3]) / weight + np.linalg.norm(needed[3:6]) / (weight * robot.stand_m)
        torques[k] = np.abs(needed[columns] / torque_limits).max()
    return time, {
        "joint_limits": np.minimum(states[:, 6:] - lower, upper - states[:, 6:]).min(axis=1),
        "joint_rates": 1 - np.abs(rates[:, 6:] / fastest).max(axis=1),
        "torques": 1 - torques,
        "forces": -missing,
        "legs_apart": apart,
        "ground": points[..., 2].min(axis=1),
    }


def kept(margins: dict[str, Array]) -> dict[str, dict[str, float]]:
    """For the report: by rule the share of frames that keep it, and the least margin."""
    return {
        name: {"share": float(np.mean(margins[name] >= rule.least)), "least": float(margins[name].min())}
        for name, rule in RULES.items()
    }


def pace_that_holds(motion: RobotMotion, model: Any) -> float | None:
    """Factor on the motion's times, at least 1, from which on joints' rates and torques are within their limits; None
    where none of those tried is slow enough. Forces on the ground are not asked for: no pace makes free falls of
    flights."""
    for factor in FACTOR ** np.arange(TRIED):
        found = kept(check(slowed(motion, float(factor)), model)[1])
        if found["joint_rates"]["share"] == found["torques"]["share"] == 1:
            return float(factor)
    return None


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


def _turn(state: Array) -> Rotation:
    return Rotation.from_euler("ZYX", state[3:6])


def _velocities(motion: RobotMotion, time_s: float, columns: list[int], size: int) -> Array:
    """MuJoCo's (nv,): of the body's place in the world, of its turn in its own axes, of the joints."""
    state, rate = motion.states(np.array([time_s]))[0], motion.states(np.array([time_s]), 1)[0]
    (yaw, pitch, roll), found = rate[3:6], np.zeros(size)
    z, y, x = np.eye(3)[[2, 1, 0]]
    about_y = Rotation.from_euler("ZYX", [0.0, 0.0, state[5]]).inv().apply(y)
    found[:3], found[columns] = rate[:3], rate[6:]
    found[3:6] = yaw * _turn(state).inv().apply(z) + pitch * about_y + roll * x
    return found
