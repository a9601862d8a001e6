"""Model a chain of rigid links joined by universal joints: the 8U chain, as published and as a tree.

The chain hangs from a root joint in the local frame UVW (U forwards along the first spine link, V down, W to the side,
right-handed). Every link has two angles relative to its parent, theta in the sagittal UV plane and phi in the
transverse UW plane, and no twist. Along a path from the root the angles add up, T = sum of theta, P = sum of phi, and a
link of length r adds

    r (cos T cos P,  sin T,  cos T sin P)

to the position, so that it keeps its length for any angles. The pose of the chain in the camera frame is R (p0 + c),
with c the joint's local position, p0 the root's, and R = Rx(xi) Ry(psi) Rz(zeta). The unknowns of one frame, the state,
are

    [theta of every free link, phi of every free link, x0, y0, z0, xi, psi, zeta, base_length]

with base_length in metres scaling all links. The frame method (`recon.thesis`) uses this form. Everything else takes
the chain as a tree of segments, as for any animal (`Chain.body`).

References
----------
C. van der Leek, "Kinematic Modeling and Dynamic Aspects of an Accelerating Quadruped", MSc(Eng), University of Cape
Town, 2022, with the link direction corrected (printed sin T cos P for the first component does not keep the length).
"""

from __future__ import annotations

import os
import warnings
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import numpy.typing as npt
from pydantic import BeforeValidator, Field
from scipy.spatial.transform import Rotation

from recon.animal.body import CHAIN_PLACES, MIN_JOINTS, Body, Side, Skeleton, foot_problems, foot_table
from recon.base import Array, Index, InputError, Problem, documents, raise_problems
from recon.base.documents import FileTable, Number, Sigma, unknown, validated
from recon.geometry import euler_rotation, euler_rotation_with_jacobian
from recon.geometry.kinematics import PITCH, ROLL, ROOT, YAW, Joint, Marker, Segment, Tree

_SKELETONS = "animal/skeletons"
UVW_BODY = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])
"""Takes the body's axes x forwards, y left, z up to U, V (down), W."""
_PITCH_RAD = 0.3
"""Standard deviation of a running animal's pitch."""
_ROOT_RAD_S2 = 40.0
"""Standard deviation of the acceleration of its pitch and roll."""


def _left_and_right(names: Any) -> Any:
    """Return a keypoint's name, or a table of both sides, as (left, right)."""
    if isinstance(names, dict) and {*names} == {"left", "right"}:
        return names["left"], names["right"]
    return (names, names) if isinstance(names, str) else names


_Sides = Annotated[tuple[str, str], BeforeValidator(_left_and_right)]


class _Range(FileTable):
    mean_rad: Number
    tolerance_rad: Sigma
    max_rate_rad_s: Sigma


class _Link(FileTable):
    """One rigid link."""

    name: str
    start: str = Field(alias="from")
    end: str = Field(alias="to")
    limb: str
    length_ratio: Sigma
    keypoint: _Sides
    theta: _Range | None = None
    phi: _Range | None = None

    @property
    def free(self) -> bool:
        """Whether it has angles of its own; otherwise it lies on its parent's axis."""
        return self.theta is not None


class _BaseLength(FileTable):
    nominal_m: Sigma
    sigma_m: Sigma


class _Prior(FileTable):
    theta_sigma_rad: Sigma
    phi_sigma_rad: Sigma
    roll_sigma_rad: Sigma
    heading_sigma_rad_per_sqrt_s: Sigma
    travel_sigma_rad: Sigma


_ChainFeet = Annotated[dict[str, str], foot_table(CHAIN_PLACES, '{ fore = "J4", hind = "J8" }, with its joints')]


class _ChainFile(FileTable):
    name: str
    title: str
    root: str
    root_keypoint: _Sides
    forward: tuple[str, str]
    feet: _ChainFeet = Field(default=None, validate_default=True)
    keypoint_sigma_m: Sigma
    base_length: _BaseLength
    softness_rad: Sigma
    prior: _Prior
    links: tuple[_Link, ...] = Field(min_length=1)
    length_m: dict[str, Sigma] = Field(default_factory=dict)
    """Measured lengths of links, which replace their ratios."""


@dataclass(frozen=True)
class AngleRanges:
    """Expected ranges of the free links' angles, in the order of the state: each array has shape (A,)."""

    mean_rad: Array
    """The expected range is mean +- tolerance."""
    tolerance_rad: Array
    max_rate_rad_s: Array
    """Fastest expected change."""


@dataclass(frozen=True)
class ChainPose:
    """States and the chain's pose in the camera frame; N states, J joints, D unknowns.

    The Jacobians are None unless requested.
    """

    state: Array
    """(N, D)"""
    rotation: Array
    """(N, 3, 3): R_camera_local."""
    joints_m: Array
    """(N, J, 3)"""
    joints_jacobian: Array | None = None
    """(N, J, 3, D)"""
    rotation_jacobian: Array | None = None
    """(N, 3, 3, 3); axis 1 runs over xi, psi, zeta."""


@dataclass(frozen=True)
class Chain(Skeleton):
    """A chain's geometry, its keypoints and the expectations of its angles."""

    file: _ChainFile
    """Content of the skeleton's file."""
    nominal_base_length_m: float

    @cached_property
    def links(self) -> tuple[_Link, ...]:
        """Links of the file, with measured lengths where the file has them."""
        ratios = {name: length_m / self.file.base_length.nominal_m for name, length_m in self.file.length_m.items()}
        return tuple(x.model_copy(update={"length_ratio": ratios.get(x.name, x.length_ratio)}) for x in self.file.links)

    @cached_property
    def joints(self) -> tuple[str, ...]:
        """Names of the joints, the root first, then the links' ends in the order of the links."""
        return self.file.root, *(link.end for link in self.links)

    @cached_property
    def theta(self) -> AngleRanges:
        """Expected theta of the free links."""
        return _ranges(link.theta for link in self.links)

    @cached_property
    def phi(self) -> AngleRanges:
        """Expected phi of the free links."""
        return _ranges(link.phi for link in self.links)

    # -- layout of the state --------------------------------------------------------------------------------------

    @cached_property
    def n_angles(self) -> int:
        """Number of free links A; a state has D = 2 A + 7 unknowns."""
        return sum(link.free for link in self.links)

    @property
    def n_state(self) -> int:
        """Number D of unknowns of a frame."""
        return 2 * self.n_angles + 7

    @cached_property
    def theta_slice(self) -> slice:
        """Theta of the free links in the state."""
        return slice(0, self.n_angles)

    @cached_property
    def phi_slice(self) -> slice:
        """Phi of the free links in the state."""
        return slice(self.n_angles, 2 * self.n_angles)

    @cached_property
    def place_slice(self) -> slice:
        """x0, y0, z0 in the state: the root in the local frame, metres."""
        return slice(2 * self.n_angles, 2 * self.n_angles + 3)

    @cached_property
    def euler_slice(self) -> slice:
        """xi, psi, zeta of R_camera_local in the state, rad."""
        return slice(2 * self.n_angles + 3, 2 * self.n_angles + 6)

    @property
    def base_index(self) -> int:
        """Index of the base length in the state."""
        return 2 * self.n_angles + 6

    @cached_property
    def angle_names(self) -> tuple[str, ...]:
        """theta_<link's end> and phi_<link's end> without the joint's letter, as in theta_6."""
        ends = [link.end.lstrip("J") for link in self.links if link.free]
        return tuple(f"theta_{e}" for e in ends) + tuple(f"phi_{e}" for e in ends)

    @cached_property
    def state_names(self) -> tuple[str, ...]:
        """Names of the unknowns, (D,)."""
        return (*self.angle_names, "x0_m", "y0_m", "z0_m", "xi", "psi", "zeta", "base_length_m")

    # -- kinematics ----------------------------------------------------------------------------------------------

    @cached_property
    def body(self) -> Body:
        """The chain as a tree of segments in metres, root first, one per link, named after its end joint.

        The segments' x axes lie along the links. The root's axes are x = U, y = W, z = -V, its origin is the root
        joint, and every joint is a marker. Theta is pitch and phi is yaw, both summed.
        """
        length = {link.end: link.length_ratio * self.nominal_base_length_m for link in self.links}
        segments = [Segment(self.joints[0], None, "free")]
        for link in self.links:
            joint: Joint = "summed" if link.free else "fixed"
            segments.append(Segment(link.end, link.start, joint, (length.get(link.start, 0.0), 0.0, 0.0)))
        markers = (Marker(self.joints[0], self.joints[0]), *(Marker(j, j, (length[j], 0.0, 0.0)) for j in length))
        tree = Tree(tuple(segments), markers)
        limbs: dict[str, tuple[str, ...]] = {}
        for link in self.links:
            limbs[link.limb] = (*limbs.get(link.limb, (link.start,)), link.end)

        ranges, prior = [self.theta, self.phi], self.file.prior
        expected = np.zeros((3, tree.n_state))
        expected[:, PITCH] = 0.0, _PITCH_RAD, _ROOT_RAD_S2
        expected[:, ROLL] = 0.0, prior.roll_sigma_rad, _ROOT_RAD_S2
        expected[0, self.body_angles] = np.concatenate([r.mean_rad for r in ranges])
        expected[1, self.body_angles] = np.repeat([prior.theta_sigma_rad, prior.phi_sigma_rad], self.n_angles)
        # A swing through the expected range that just reaches the fastest rate, w = rate / tolerance, has a largest
        # acceleration of w^2 tolerance, and a root mean square of that over sqrt(2).
        swing = [r.max_rate_rad_s**2 / r.tolerance_rad / np.sqrt(2) for r in ranges]
        expected[2, self.body_angles] = np.concatenate(swing)
        return Body(
            name=self.name,
            title=self.title,
            tree=tree,
            keypoints=(self.file.root_keypoint, *(link.keypoint for link in self.links)),
            limbs=limbs,
            forward=self.file.forward,
            feet=tuple(self.file.feet.values()),
            foot_labels=tuple(CHAIN_PLACES[position] for position in self.file.feet),
            keypoint_sigma_m=self.file.keypoint_sigma_m,
            size_sigma=self.file.base_length.sigma_m / self.nominal_base_length_m,
            mean_rad=expected[0, 4:],
            sigma_rad=expected[1, 4:],
            acceleration_rad_s2=expected[2, 4:],
        )

    @cached_property
    def body_angles(self) -> Index:
        """(2 A,): indices of the chain's angles in the body's state."""
        # After the root's six unknowns, every free link has its yaw and then its pitch.
        pitch = 7 + 2 * np.arange(self.n_angles)
        return np.concatenate([pitch, pitch - 1])

    def to_body(self, state: Array, T_world_camera: Array) -> tuple[Array, Array]:
        """Return the body's states in the world (N, D') and sizes (N,) for states of this chain (N, D).

        `T_world_camera` is (4, 4) or (N, 4, 4).
        """
        R_world_local = T_world_camera[..., :3, :3] @ euler_rotation(state[:, self.euler_slice])
        R = R_world_local @ UVW_BODY
        body_state = np.empty((len(state), self.body.n_state))
        in_local = state[:, self.place_slice, None]
        body_state[:, ROOT] = (R_world_local @ in_local)[..., 0] + T_world_camera[..., :3, 3]
        body_state[:, YAW] = np.arctan2(R[:, 1, 0], R[:, 0, 0])
        body_state[:, PITCH] = np.arctan2(-R[:, 2, 0], np.hypot(R[:, 0, 0], R[:, 1, 0]))
        body_state[:, ROLL] = np.arctan2(R[:, 2, 1], R[:, 2, 2])
        body_state[:, self.body_angles] = state[:, : 2 * self.n_angles]
        return body_state, state[:, self.base_index] / self.nominal_base_length_m

    def _local_state(self, state: Array) -> Array:
        """Return the body's states with the chain's angles and the root at the origin."""
        local_state = np.zeros((len(state), self.body.n_state))
        local_state[:, self.body_angles] = state[:, : 2 * self.n_angles]
        return local_state

    def local_joints(self, state: Array) -> Array:
        """Return joint positions relative to the root in the local frame UVW, metres, (N, J, 3), for states (N, D)."""
        size = state[:, self.base_index] / self.nominal_base_length_m
        return self.body.tree.pose(self._local_state(state), size).points_m @ UVW_BODY.T

    def pose(self, state: Array) -> ChainPose:
        """Return joints in the camera frame for states (N, D), without Jacobian."""
        R = euler_rotation(state[:, self.euler_slice])
        p = self.local_joints(state) + state[:, None, self.place_slice]
        return ChainPose(state, R, p @ R.transpose(0, 2, 1))

    def pose_with_jacobian(self, state: Array) -> ChainPose:
        """Return joints in the camera frame and their exact derivatives by the state (N, D)."""
        N, J, A = len(state), len(self.joints), self.n_angles
        tree = self.body.tree.pose_with_jacobian(self._local_state(state))
        size = state[:, self.base_index, None, None] / self.nominal_base_length_m
        c_per_size = UVW_BODY @ tree.points_m.transpose(0, 2, 1)  # (N, 3, J)
        p = c_per_size * size + state[:, self.place_slice, None]
        # The frame method's inner loop has one frame, and a single rotation is several times quicker.
        angles = state[:, self.euler_slice]
        R, dR = euler_rotation_with_jacobian(angles[0] if N == 1 else angles)
        R, dR = R.reshape(N, 3, 3), dR.reshape(N, 3, 3, 3)

        jacobian = np.empty((N, 3, J, self.n_state))
        turned = tree.jacobian.take(self.body_angles, axis=-1).transpose(0, 2, 1, 3).reshape(N, 3, J * 2 * A)
        jacobian[..., : 2 * A] = (size * (R @ UVW_BODY) @ turned).reshape(N, 3, J, 2 * A)
        jacobian[..., self.place_slice] = R[:, :, None]
        jacobian[..., self.euler_slice] = (dR @ p[:, None]).transpose(0, 2, 3, 1)
        jacobian[..., self.base_index] = R @ (c_per_size / self.nominal_base_length_m)
        return ChainPose(state, R, (R @ p).transpose(0, 2, 1), jacobian.transpose(0, 2, 1, 3), dR)


def upright_rotation(heading: Array, up: Array) -> Array:
    """Return R_camera_local (..., 3, 3) of a level animal.

    U points along heading (..., 3), V down, W to the side.
    """
    down = np.broadcast_to(-up, heading.shape)
    return np.stack([heading, down, np.cross(heading, down)], axis=-1)


# -- files -------------------------------------------------------------------------------------------------------------


def builtin_chains() -> tuple[str, ...]:
    """Return the names of the built-in skeletons that are chains, for the frame method."""
    return tuple(name for name in documents.builtin_names(_SKELETONS, ".toml") if "segments" not in _read(name)[0])


def load_chain(name_or_path: str | Path) -> Chain:
    """Load a skeleton that is a chain, for the frame method.

    Raises InputError, also for a whole animal.
    """
    raw, source = _read(name_or_path, builtin_chains())
    if "segments" in raw:
        expected = f"a chain for the frame method: one of {', '.join(builtin_chains())}, or a file with [[links]]"
        raise InputError(Problem("--skeleton", "name or file", repr(str(name_or_path)), expected))
    return chain_of(raw, source)


def _read(name: str | Path, suggested: Iterable[str] | None = None) -> tuple[dict[str, Any], str]:
    return documents.named_table(name, _SKELETONS, "--skeleton", "skeleton", suggested)


def _extended(raw: dict[str, Any], source: str) -> dict[str, Any]:
    """Return a file's tables, completed with those of the skeleton that it `extends`."""
    if "extends" not in raw:
        return raw
    if not isinstance(name := raw["extends"], str):
        raise InputError(Problem(source, "extends", repr(name), "the name or the file of a skeleton"))
    parent, parent_source = _read(_parent_of_file(name, source))
    if "segments" in parent or "extends" in parent:
        expected = "a chain that extends none; a body's lengths stand in a subject file"
        raise InputError(Problem(source, "extends", parent_source, expected))
    return {**parent, **{key: value for key, value in raw.items() if key != "extends"}}


def _parent_of_file(name: str, source: str) -> str:
    """Return the file of a skeleton beside `source`, or the name if it is built in.

    A path that is not beside `source` is relative to the user's folder.
    """
    file = Path(source).parent / name
    return str(file) if os.path.isfile(file) and name not in documents.builtin_names(_SKELETONS, ".toml") else name


def chain_of(raw: dict[str, Any], source: str) -> Chain:
    """Return a file's tables as a chain; raise InputError with every problem."""
    file = validated(_ChainFile, _extended(raw, source), source)
    raise_problems(_chain_problems(file, source))
    return Chain(file.name, file.title, file, file.base_length.nominal_m)


def _chain_problems(file: _ChainFile, source: str) -> Iterator[Problem]:
    known = [file.root]
    for i, link in enumerate(file.links):
        if link.start not in known:
            yield Problem(source, f"links[{i}].from", repr(link.start), "the root or the `to` of an earlier link")
        if link.end in known:
            yield Problem(source, f"links[{i}].to", repr(link.end), "a joint that no earlier link ends in")
        if (link.theta is None) != (link.phi is None):
            yield Problem(source, f"links[{i}]", "only one of theta and phi", "both or neither")
        known.append(link.end)
    names = [link.name for link in file.links]
    yield from unknown(source, [(f"length_m.{name}", name) for name in file.length_m], sorted(names))
    if len(names) + 1 < MIN_JOINTS:
        yield Problem(source, "links", f"{len(names)}", f"at least {MIN_JOINTS - 1}: fewer joints do not place it")
    if not any(link.theta is None and link.start == file.root for link in file.links):
        expected = f"one from {file.root} without theta and phi: the body's forward axis lies along it"
        yield Problem(source, "links", "none without angles from the root", expected)
    ends = [*(("forward", joint) for joint in file.forward), *(("feet", joint) for joint in file.feet.values())]
    yield from unknown(source, ends, sorted(known))
    yield from foot_problems(file.feet, source)


def _ranges(ranges: Iterable[_Range | None]) -> AngleRanges:
    rows = [(r.mean_rad, r.tolerance_rad, r.max_rate_rad_s) for r in ranges if r is not None]
    return AngleRanges(*np.array(rows, dtype=float).reshape(-1, 3).T)


def euler_angles(rotation: npt.ArrayLike) -> Array:
    """Return angles (xi, psi, zeta) (..., 3) of rotations (..., 3, 3).

    The inverse of `recon.geometry.frames.euler_rotation`. psi lies in [-pi/2, pi/2]. At psi = +-pi/2 only xi + zeta or
    xi - zeta is determined; zeta is then set to 0. Raises ValueError for a matrix that is not a rotation (determinant
    not positive).
    """
    matrices = np.asarray(rotation, dtype=float)
    if (np.linalg.det(matrices) <= 0).any():  # older scipy takes them for rotations
        raise ValueError("a matrix with a determinant that is not positive is no rotation")
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message="Gimbal lock")
        angles = Rotation.from_matrix(matrices.reshape(-1, 3, 3)).as_euler("XYZ")
    return np.asarray(angles).reshape(*matrices.shape[:-2], 3)


def facing_side(rear_px: Array, front_px: Array) -> tuple[Side, str]:
    """Return the side of the animal that faces an upright camera, and the reason.

    rear_px, front_px (T, 2) are the ends of the trunk, NaN where missing. An animal that faces the right of the picture
    shows its right side.
    """
    ahead = (front_px - rear_px)[:, 0]
    ahead = ahead[np.isfinite(ahead)]
    if len(ahead) == 0:
        return "right", "no frame shows both ends of the trunk: right by default"
    side: Side = "right" if np.median(ahead) > 0 else "left"
    agree = np.mean((ahead > 0) == (side == "right"))
    return side, f"the animal faces the {side} of the picture in {agree:.0%} of {len(ahead)} frames"
