"""Build chains from Denavit-Hartenberg parameters in both conventions, and compute what `recon robot` prints.

The transform between two links is, in the two conventions::

    modified (Craig)  T_{i-1, i} = Rx(alpha_{i-1}) Tx(a_{i-1}) Rz(theta_i) Tz(d_i)
    standard          T_{i-1, i} = Rz(theta_i) Tz(d_i) Tx(a_i) Rx(alpha_i)

A revolute joint adds q to theta, and a sliding joint adds q to d. As in printed tables, a row holds a and alpha of the
link before the joint in the modified convention, and of the link after the joint in the standard convention.

The functions `pose_answer` and `table_answer` return the data that `--json` prints, in metres and radians. The
command-line options are in degrees. MINPACK's Levenberg-Marquardt with the exact Jacobian searches from many random
starts (with a fixed seed) for the configurations that put the end of a chain at a given position. Equal solutions count
once. The search may miss solutions, and more starts can find more of them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import accumulate, pairwise
from math import isfinite
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from numpy.typing import ArrayLike
from pydantic import Field, StrictBool
from scipy.optimize import root
from scipy.spatial.transform import RigidTransform, Rotation

from recon.base.arrays import Array
from recon.base.documents import FileTable, read_toml, validated
from recon.base.errors import InputError, Problem
from recon.ik.chain import SerialChain, joint_chain
from recon.robotics import models
from recon.robotics.leg import Length, Limits
from recon.robotics.quadruped import LEGS, SUFFIXES, body_pose, builtin_robots, leg_targets, load_robot
from recon.robotics.settings import PoseSettings, TableSettings

Convention = Literal["modified", "standard"]
_PARALLEL = 1e-9
"""Smallest sine of the angle between two axes, or distance in metres, that does not count as 0."""


@dataclass(frozen=True)
class DHRow:
    """One row of a Denavit-Hartenberg table."""

    __pydantic_config__ = FileTable.model_config
    a_m: Length = 0.0
    """Length of the link, metres."""
    alpha_rad: Length = 0.0
    """Twist of the link, rad."""
    d_m: Length = 0.0
    """Offset along the joint's axis at q = 0, metres."""
    theta_rad: Length = 0.0
    """Angle about the joint's axis at q = 0, rad."""
    slides: StrictBool = False
    """Whether q is added to d instead of theta."""
    limits: Limits | None = None
    """Lower and upper limit of q, rad or metres; None for a joint without limits."""


class _DHFile(FileTable):
    convention: Convention
    joints: Annotated[list[DHRow], Field(min_length=1)]


def load_dh(path: Path) -> tuple[SerialChain, Convention, list[DHRow]]:
    """Load a Denavit-Hartenberg table from a TOML file (docs/robot.md), and return its chain, convention and rows.

    Raises
    ------
    InputError
        If the file is missing or not a valid table.
    """
    file = validated(_DHFile, read_toml(path, "a table of Denavit-Hartenberg parameters (TOML)"), path)
    return dh_chain(file.joints, file.convention), file.convention, file.joints


def dh_chain(rows: Sequence[DHRow], convention: Convention) -> SerialChain:
    """Build a chain from the rows of a Denavit-Hartenberg table, starting at the base.

    Raises
    ------
    ValueError
        If there are no rows, or if the convention is unknown.
    """
    if convention not in ("modified", "standard") or not rows:
        raise ValueError(f"expected rows and 'modified' or 'standard', got {len(rows)} rows and {convention!r}")
    link = [_along("x", row.a_m, row.alpha_rad) for row in rows]
    joint = [_along("z", row.d_m, row.theta_rad) for row in rows]
    nothing = RigidTransform.identity()
    links, tool = (link, nothing) if convention == "modified" else ([nothing, *link[:-1]], link[-1])
    frames = [*accumulate((a * b for a, b in zip(links, joint, strict=True)), lambda frame, step: frame * step)]
    end = frames[-1] * tool
    steps = np.diff([np.zeros(3), *(T.translation for T in frames), end.translation], axis=0)
    return joint_chain(
        steps[:-1],
        [T.rotation.apply([0.0, 0.0, 1.0]) for T in frames],
        [row.slides for row in rows],
        steps[-1],
        end.rotation,
        (*np.transpose([row.limits or (-np.inf, np.inf) for row in rows]),),
    )


def dh_table(chain: SerialChain) -> tuple[RigidTransform, tuple[DHRow, ...], RigidTransform]:
    """Return a base transform, Denavit-Hartenberg rows (modified convention) and a tool transform for any chain.

    The chain is base * rows * tool. a_m and alpha_rad of the first row are 0. Base and tool hold the part that
    Denavit-Hartenberg parameters cannot express. The z axis of a joint's frame is the axis of the joint. The x axis is
    the common normal to the next joint's axis. If the two axes are parallel, the normal through the previous origin is
    used.
    """
    zero = np.zeros(chain.n)
    axes, positions = chain.joint_axes(zero), chain.positions(zero)
    frames, x, origin = [], _across(axes[0]), positions[0]
    for j, z in enumerate(axes):
        origin = _nearest_on_axis(positions[j], z, origin)
        normal = np.zeros(3)
        if j + 1 < chain.n:
            position_after, z_after = positions[j + 1], axes[j + 1]
            normal = np.cross(z, z_after)
            if np.linalg.norm(normal) < _PARALLEL:
                normal = _nearest_on_axis(position_after, z_after, origin) - origin
            else:
                # Solve position_after - position = s z + t normal - u z_after for s, t and u.
                along = np.linalg.solve(np.column_stack([z, normal, -z_after]), position_after - positions[j])
                origin, normal = positions[j] + along[0] * z, normal if along[1] >= -1e-12 else -normal
        # If the normal does not determine x, keep the previous x, which makes theta 0.
        x = normal if np.linalg.norm(normal) > _PARALLEL else x
        x = x - (x @ z) * z
        size = float(np.linalg.norm(x))
        x = x / size if size > 1e-6 else _across(z)
        frames.append(_transform(np.column_stack([x, np.cross(z, x), z]), origin))
    steps = [a.inv() * b for a, b in pairwise(frames)]
    rows = [DHRow(slides=bool(chain.sliding[0])), *map(_row, steps, chain.sliding[1:])]
    return frames[0], tuple(rows), frames[-1].inv() * _transform(*chain.pose(zero))


def _row(step: RigidTransform, slides: bool) -> DHRow:
    """Return the table row (modified convention) whose transform Rx(alpha) Tx(a) Rz(theta) Tz(d) equals `step`."""
    T = step.as_matrix()
    alpha = np.arctan2(-T[1, 2], T[2, 2])
    d = -np.sin(alpha) * T[1, 3] + np.cos(alpha) * T[2, 3]
    theta = np.arctan2(-T[0, 1], T[0, 0])
    return DHRow(float(T[0, 3]), float(alpha), float(d), float(theta), bool(slides))


def _transform(R: ArrayLike, p: Array) -> RigidTransform:
    return RigidTransform.from_components(p, Rotation.from_matrix(np.asarray(R, dtype=float)))


def _nearest_on_axis(origin: Array, z: Array, point: Array) -> Array:
    """Return the point (3,) on the axis through `origin` along z that is nearest to `point` (3,)."""
    return origin + ((point - origin) @ z) * z


def _across(z: Array) -> Array:
    """Return the unit vector perpendicular to z that is closest to the x axis, or to the y axis if z is close to x."""
    x = np.eye(3)[0 if abs(z[0]) < 0.9 else 1]
    x = x - (x @ z) * z
    return x / np.linalg.norm(x)


def _along(axis: Literal["x", "z"], distance_m: float, angle_rad: float) -> RigidTransform:
    """Return a screw motion, which is a translation along an axis and a rotation about the same axis."""
    shift = distance_m * np.eye(3)["xyz".index(axis)]
    return RigidTransform.from_components(shift, Rotation.from_euler(axis, angle_rad))


ENDLESS = "the joints can move without moving the end: this is one of infinitely many solutions"
STARTS = 100
"""Number of random starts of the search for configurations."""
MAX_DIFFERENCE = 1e-4
"""Largest difference, in rad or m, between configurations that count as the same."""
MAX_RELATIVE_ERROR = 1e-7
"""Largest error of a solution as a fraction of the chain's length."""


def pose_answer(settings: PoseSettings) -> dict[str, Any]:
    """Return the joint angles of a robot's legs when its body is moved and turned on planted feet."""
    machine, position = load_robot(settings.robot), settings.move or (0.0, 0.0, 0.0)
    turned = {name: float(np.radians(getattr(settings, name))) for name in ("roll", "pitch", "yaw")}
    body_frame = body_pose(position, turned["roll"], turned["pitch"], turned["yaw"])
    feet = leg_targets(body_frame, np.zeros((4, 3)), [leg.neutral_m for leg in machine.legs.values()])
    legs = {}
    for (label, leg), foot in zip(machine.legs.items(), feet, strict=True):
        q = leg.angles(foot[None])[0]
        reached = bool(np.isfinite(q).all())
        legs[label] = {
            "joints": leg.joints,
            "foot_m": foot,
            "angles_rad": q if reached else None,
            "margin_rad": float(leg.margins(q).min()),
            "why": "" if reached else "out of reach, or outside a joint's limits",
        }
    turn_angles = {f"{name}_rad": angle for name, angle in turned.items()}
    return {"robot": machine.title, "position_m": position, **turn_angles, "legs": legs}


def table_answer(settings: TableSettings) -> dict[str, Any]:
    """Return a chain's Denavit-Hartenberg table, and its forward or inverse kinematics if requested.

    The chain comes from a table of parameters (TOML), from a leg of a robot, or from a URDF or MJCF file. A file with
    several leaves needs `settings.tip`.
    """
    chain, table = _chain(settings.source, settings.tip)
    if table is None:
        base, rows, tool = dh_table(chain)
        table = {"base": _pose_answer(base), "tool": _pose_answer(tool), **_table("modified", rows)}
    answer: dict[str, Any] = {"joints": chain.names, "slides": chain.sliding, "lower": chain.lower_rad}
    answer |= {"upper": chain.upper_rad, "dh": table}
    if settings.angles is not None:
        q = np.array(_numbers("--angles", settings.angles))
        if len(q) != chain.n:
            raise InputError(
                Problem("--angles", "joints", f"{len(q)} numbers", f"{chain.n} numbers, one for each joint")
            )
        q = np.where(chain.sliding, q, np.radians(q))
        end = _pose_answer(_transform(*chain.pose(q)))
        answer["forward"] = {"q": q, **end, "within_limits": _within(chain, q)}
    if settings.place is not None:
        turned = None if settings.turned is None else np.radians(settings.turned)
        matrix = None if turned is None else Rotation.from_euler("ZYX", turned[::-1]).as_matrix()
        every, isolated = all_solutions(chain, settings.place, matrix)
        rows = [{"q": q, "within_limits": _within(chain, q)} for q in (_in_limits(chain, q) for q in every)]
        note = "no solution" if not rows else "" if isolated else ENDLESS
        answer["inverse"] = {"solutions": rows, "note": note, "place_m": settings.place, "roll_pitch_yaw_rad": turned}
    return answer


def _numbers(option: str, text: str) -> list[float]:
    """Parse the value of an option such as "1,2.5,-3"; raise InputError if it is not a list of numbers."""
    try:
        values = [float(part) for part in text.split(",")]
    except ValueError:
        values = []
    if not values or not all(map(isfinite, values)):
        raise InputError(Problem(option, "numbers", repr(text), "numbers with commas, such as 0.1,-20,3"))
    return values


def _chain(source: str, tip: str | None) -> tuple[SerialChain, dict[str, Any] | None]:
    """Return the chain of a robot's leg or of a file, and the file's Denavit-Hartenberg table or None.

    If `tip` is the label of a leg, the chain is that leg of the robot `source`. In a URDF or MJCF file, the chain ends
    at the link `tip`, by default at the only leaf.
    """
    if tip in LEGS:
        return load_robot(source).legs[tip].chain, None
    if source in builtin_robots():
        raise InputError(Problem("--tip", "leg", str(tip or "no leg"), f"one of {', '.join(LEGS)}"))
    if (file := Path(source)).suffix.lower() in SUFFIXES:
        model = models.read_model(file)
        ends = [tip] if tip is not None else [models.body_names(model)[leaf - 1] for leaf in models.leaves_of(model)]
        if len(ends) > 1:
            raise InputError(Problem("--tip", "link", "no link", f"one of {', '.join(ends)}"))
        return models.model_chain(model, file, ends[0]), None
    if tip is not None:
        raise InputError(Problem("--tip", "link", tip, "no --tip, because the file has only one chain"))
    chain, convention, rows = load_dh(file)
    return chain, _table(convention, rows)


def _table(convention: str, rows: Sequence[DHRow]) -> dict[str, Any]:
    columns = ("a_m", "alpha_rad", "d_m", "theta_rad")
    return {"convention": convention, "rows": [{name: getattr(row, name) for name in columns} for row in rows]}


def _pose_answer(transform: RigidTransform) -> dict[str, Any]:
    yaw, pitch, roll = transform.rotation.as_euler("ZYX", suppress_warnings=True)
    return {"place_m": transform.translation, "roll_pitch_yaw_rad": [roll, pitch, yaw]}


def _in_limits(chain: SerialChain, q: Array) -> Array:
    """Shift the angle of each joint with limits by whole turns, to the value nearest the middle of the limits."""
    bounded = np.isfinite(chain.lower_rad) & np.isfinite(chain.upper_rad) & ~chain.sliding
    middle = np.where(bounded, (np.where(bounded, chain.lower_rad, 0) + np.where(bounded, chain.upper_rad, 0)) / 2, q)
    return np.where(bounded, middle + (q - middle + np.pi) % (2 * np.pi) - np.pi, q)


def _within(chain: SerialChain, q: Array) -> bool:
    return bool(((q >= chain.lower_rad - 1e-9) & (q <= chain.upper_rad + 1e-9)).all())


def all_solutions(
    chain: SerialChain, place_m: ArrayLike, rotation: ArrayLike | None = None, starts: int = STARTS
) -> tuple[Array, bool]:
    """Search for the joint coordinates that put the end effector at a position.

    Parameters
    ----------
    chain : SerialChain
        A chain of n joints.
    place_m : (3,)
        Position of the end effector in the chain's base frame, m.
    rotation : (3, 3), optional
        Rotation of the end effector; by default any rotation.
    starts : int
        Number of random starts.

    Returns
    -------
    solutions : (m, n)
        Joint coordinates, rad or m, with angles in [-pi, pi). Limits are ignored.
    isolated : bool
        False if the joints can keep moving without moving the end effector. Then `solutions` holds one of infinitely
        many.
    """
    target = np.asarray(place_m, float)
    size = max(float(chain.lengths_m.sum()), float(np.linalg.norm(target)), 1e-9)
    turns = ~np.asarray(chain.sliding, bool)

    def equations(q: Array) -> tuple[Array, Array]:
        """Return residuals (12 + n,) and their derivatives.

        The last n residuals are 0, because MINPACK needs at least as many residuals as unknowns.
        """
        R, p = chain.pose(q)
        J = chain.geometric_jacobian(q)
        error, slope = np.zeros(12 + chain.n), np.zeros((12 + chain.n, chain.n))
        error[:3], slope[:3] = (p - target) / size, J[:3] / size
        if rotation is not None:
            error[3:12] = (R - np.asarray(rotation, float)).T.ravel()
            slope[3:12] = np.concatenate([np.cross(J[3:].T, axis).T for axis in R.T])
        return error, slope

    low = np.where(turns, -np.pi, np.maximum(chain.lower_rad, -size))
    high = np.where(turns, np.pi, np.minimum(chain.upper_rad, size))
    start_points = [(low + high) / 2, *np.random.default_rng(0).uniform(low, high, (starts, chain.n))]
    ends = (root(equations, q, jac=True, method="lm", options={"xtol": 1e-12, "ftol": 1e-14}).x for q in start_points)
    solutions = [
        np.where(turns, (q + np.pi) % (2 * np.pi) - np.pi, q)
        for q in ends
        if np.abs(equations(q)[0]).max() < MAX_RELATIVE_ERROR
    ]
    isolated = all(np.linalg.matrix_rank(equations(q)[1], 1e-6) == chain.n for q in solutions)
    distinct: list[Array] = []
    for q in solutions if isolated else solutions[:1]:
        differences = [np.where(turns, np.angle(np.exp(1j * (q - known))), q - known) for known in distinct]
        if all(np.abs(difference).max() > MAX_DIFFERENCE for difference in differences):
            distinct.append(q)
    sorted_solutions = np.array(distinct).reshape(len(distinct), chain.n)
    return sorted_solutions[np.lexsort(sorted_solutions.round(6).T[::-1])], isolated
