"""Read a robot's model from a URDF or MJCF file with MuJoCo (install the extra `robots`).

Meshes are not read, because they need more files and kinematics does not use them.
"""

from __future__ import annotations

import warnings
from pathlib import Path
from types import ModuleType
from typing import Any, TypeAlias
from xml.etree import ElementTree

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from recon.base.arrays import Array
from recon.base.documents import utf8_path
from recon.base.errors import InputError, Problem, raise_problems
from recon.base.package import install_command
from recon.ik.chain import MAX_RATE_RAD_S, SerialChain, joint_chain

MjModel: TypeAlias = Any
"""Type of MuJoCo's model, which is `Any` because the package mujoco has no type hints."""
MjSpec: TypeAlias = Any
"""Type of MuJoCo's editable description of a model."""
MAX_ABSOLUTE = 1e6
"""Largest plausible length (m) or angle (rad). A file with a larger value counts as damaged."""
MIN_MASS_KG = 1e-6
"""Mass given to links that have none in the file, since kinematics does not depend on masses."""
MIN_INERTIA_KG_M2 = 1e-9
"""Moment of inertia given to links that have none in the file, since kinematics does not depend on inertia."""


def require_mujoco(source: str | Path) -> ModuleType:
    """Return the module mujoco.

    Raises
    ------
    InputError
        If the module is not installed, with `source` as the file concerned.
    """
    try:
        import mujoco
    except ImportError:
        expected = f"the package mujoco: {install_command('robots')}"
        raise InputError(Problem(source, "robot", "no package mujoco", expected)) from None
    return mujoco


def read_model(path: str | Path, free: bool = False) -> MjModel:
    """Return MuJoCo's model of a file, with its fixed joints and without its meshes.

    If `free` is true, the root of the model moves freely in the world.

    Raises
    ------
    InputError
        If the file is not a URDF or MJCF file, or if MuJoCo is not installed.
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
        spec.compiler.boundmass, spec.compiler.boundinertia = MIN_MASS_KG, MIN_INERTIA_KG_M2
        for geom in [geom for geom in spec.geoms if geom.type == mujoco.mjtGeom.mjGEOM_MESH]:
            spec.delete(geom)
        for mesh in list(spec.meshes):
            spec.delete(mesh)
        if free and not any(joint.type == mujoco.mjtJoint.mjJNT_FREE for joint in spec.joints):
            spec.worldbody.first_body().add_freejoint()
        with warnings.catch_warnings():
            # MuJoCo warns about moving parts without mass, but kinematics needs no masses.
            warnings.simplefilter("ignore")
            model = spec.compile()
    # MuJoCo also raises these errors if it runs out of memory.
    except (ValueError, RuntimeError, mujoco.FatalError) as error:
        detail = " ".join(str(error).split())[:160]
        raise InputError(Problem(path, "content", detail, "a URDF or MJCF file")) from None
    for quantity, numbers in {"links": model.body_pos, "limits": model.jnt_range}.items():
        if not (np.abs(numbers) < MAX_ABSOLUTE).all():
            raise InputError(Problem(path, quantity, "implausibly large numbers", "metres and radians"))
    return model


def rates_of(path: Path) -> dict[str, float]:
    """Read the maximum rate of each joint, rad/s or m/s, from a URDF file, because MuJoCo does not keep the rates.

    An MJCF file has no rates, so the result is empty.

    Raises
    ------
    InputError
        If a limit is not a number, if a lower limit exceeds the upper limit, or if a rate is implausible.
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
    wrong += [(n, f"velocity {r:g}", "a rate above 0") for n, r in rates.items() if not 1e-6 < r < MAX_ABSOLUTE]
    raise_problems(Problem(path, f"joint {name}", detail, expected) for name, detail, expected in wrong)
    return rates


def body_names(model: MjModel) -> list[str]:
    """Return the names of all bodies except the world. A body without a name gets one such as "body 3"."""
    return [model.body(k).name or f"body {k}" for k in range(1, model.nbody)]


def root_of(model: MjModel) -> int:
    """Return the index of the body that moves freely in the world, or of the first body."""
    free = [int(model.jnt_bodyid[j]) for j in range(model.njnt) if model.jnt_type[j] == 0]
    return free[0] if free else 1


def leaves_of(model: MjModel) -> list[int]:
    """Return the indices of the bodies that have no child."""
    return [k for k in range(1, model.nbody) if k not in model.body_parentid[1:]]


def foot_of(model: MjModel, leaf: int) -> Array:
    """Return the position (3,) of the foot in the axes of a leaf, metres.

    The foot is at the leaf's origin if no joint moves the leaf. Otherwise, as at the ends of legs in MJCF files, the
    foot is the centre of the leaf's farthest sphere, or of its farthest shape if there is no sphere.
    """
    shapes = [g for g in range(model.ngeom) if model.geom_bodyid[g] == leaf]
    shapes = [g for g in shapes if model.geom_type[g] == 2] or shapes
    if not model.body_jntnum[leaf] or not shapes:
        return np.zeros(3)
    return np.array(max((model.geom_pos[g] for g in shapes), key=np.linalg.norm))


def bodies_to(model: MjModel, tip: int) -> list[int]:
    """Return the indices of the bodies from the root (excluded) to `tip`; empty if `tip` is not below the root."""
    bodies, root = [], root_of(model)
    while tip not in (root, 0):
        bodies.append(tip)
        tip = int(model.body_parentid[tip])
    return bodies[::-1] if tip == root else []


def moving(model: MjModel, bodies: list[int]) -> list[int]:
    """Return the indices of the joints that move the given bodies, in the order of the bodies."""
    return [j for k in bodies for j in range(model.body_jntadr[k], model.body_jntadr[k] + model.body_jntnum[k])]


def model_chain(model: MjModel, path: Path, tip: str, end_m: ArrayLike = (0.0, 0.0, 0.0)) -> SerialChain:
    """Return the chain from the root to a body, with its limits, and with fixed joints as parts of the links.

    The chain is in the root's axes, and its end effector is at `end_m` (3,) in the axes of the tip. A hinge without
    limits turns freely. A joint without a maximum rate gets `MAX_RATE_RAD_S`.

    Raises
    ------
    InputError
        If no chain of joints leads to `tip`, or if a joint neither turns nor slides.
    """
    names, start = body_names(model), root_of(model)
    if tip not in names:
        raise InputError(Problem(path, "link", repr(tip), ", ".join(names)))
    way = bodies_to(model, last := names.index(tip) + 1)
    joints = moving(model, way)
    if not joints:
        detail = f"no moving joint from {names[start - 1]} to {tip}"
        raise InputError(Problem(path, "chain", detail, "a link moved by joints"))
    # MuJoCo numbers a slide 2 and a hinge 3.
    unlike = [model.joint(j).name for j in joints if model.jnt_type[j] not in (2, 3)]
    expected = "a joint that turns or slides"
    raise_problems(Problem(path, f"joint {name}", "a joint that neither turns nor slides", expected) for name in unlike)
    mujoco = require_mujoco(path)
    mujoco.mj_kinematics(model, data := mujoco.MjData(model))  # new data has all joints at 0
    root_axes, tip_axes = (data.xmat[body].reshape(3, 3) for body in (start, last))
    end = data.xpos[last] + tip_axes @ np.asarray(end_m, dtype=float)
    steps = np.diff([data.xpos[start], *data.xanchor[joints], end], axis=0) @ root_axes
    axes, turns = data.xaxis[joints] @ root_axes, model.body_quat[way]
    if not np.isfinite([*steps, *axes]).all() or not (axes.any(axis=1).all() and turns.any(axis=1).all()):
        # Numbers in the file can overflow to infinity or NaN.
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
