"""A chain of rigid links joined by universal joints, and its forward kinematics.

The chain hangs from a root joint in the local frame UVW (U forwards along the first spine link, V down, W to the side,
right-handed). Every link has two angles relative to its parent, theta in the sagittal UV plane and phi in the
transverse UW plane, and no twist. Along a path from the root the angles add up, T = sum of theta, P = sum of phi, and a
link of length r adds

    r (cos T cos P,  sin T,  cos T sin P)

to the position, so that it keeps its length for any angles. The pose of the chain in the camera frame is R (p0 + c): c
is the joint's local position, p0 the root's, R = Rx(xi) Ry(psi) Rz(zeta). One frame's unknowns, the state, are

    [theta of every free link, phi of every free link, x0, y0, z0, xi, psi, zeta, base_length]

with base_length in metres scaling all links. Source: C. van der Leek, "Kinematic Modeling and Dynamic Aspects of an
Accelerating Quadruped", MSc(Eng), University of Cape Town, 2022, with the link direction corrected (printed sin T cos P
for the first component does not keep the length).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from recon.rotations import euler_rotation, euler_rotation_with_jacobian

Array = NDArray[np.float64]
Side = Literal["left", "right"]

MIN_JOINTS = 5
"""Fewer detected joints than this do not place a chain."""


@dataclass(frozen=True)
class Link:
    """One rigid link. `free` says whether it has angles of its own or lies on its parent's axis."""

    name: str
    start: str
    end: str
    limb: str
    length_ratio: float
    free: bool


@dataclass(frozen=True)
class AngleRanges:
    """Expected ranges of the free links' angles, in the order of the state: each array has shape (A,).

    mean_rad, tolerance_rad: the expected range is mean +- tolerance. max_rate_rad_s: the fastest expected change.
    """

    mean_rad: Array
    tolerance_rad: Array
    max_rate_rad_s: Array


@dataclass(frozen=True)
class PriorScales:
    """Standard deviations of the skeleton's soft expectations (see docs/skeletons.md for the fields)."""

    softness_rad: float
    theta_rad: float
    phi_rad: float
    roll_rad: float
    heading_rad_per_sqrt_s: float
    travel_rad: float
    base_length_m: float
    keypoint_m: float


@dataclass(frozen=True)
class Posed:
    """States and where they put the skeleton, in the camera frame; N states, J joints, D unknowns.

    state (N, D); rotation (N, 3, 3) is R_camera_local; joints_m (N, J, 3). With Jacobian: joints_jacobian
    (N, J, 3, D) and rotation_jacobian (N, 3, 3, 3), whose axis 1 runs over xi, psi, zeta; otherwise None.
    """

    state: Array
    rotation: Array
    joints_m: Array
    joints_jacobian: Array | None = None
    rotation_jacobian: Array | None = None


@dataclass(frozen=True)
class Skeleton:
    """A chain's geometry, its keypoints and what is expected of its angles.

    joints: names, root first, then the links' ends in the order of the links. keypoints: for each joint its keypoint's
    name on the (left, right) side. forward: two joints, from rear to front.
    """

    name: str
    title: str
    links: tuple[Link, ...]
    joints: tuple[str, ...]
    keypoints: tuple[tuple[str, str], ...]
    forward: tuple[str, str]
    theta: AngleRanges
    phi: AngleRanges
    scales: PriorScales
    nominal_base_length_m: float

    # -- layout of the state --------------------------------------------------------------------------------------

    @cached_property
    def n_angles(self) -> int:
        """Number of free links A; a state has D = 2 A + 7 unknowns."""
        return sum(link.free for link in self.links)

    @property
    def n_state(self) -> int:
        return 2 * self.n_angles + 7

    @cached_property
    def theta_slice(self) -> slice:
        return slice(0, self.n_angles)

    @cached_property
    def phi_slice(self) -> slice:
        return slice(self.n_angles, 2 * self.n_angles)

    @cached_property
    def place_slice(self) -> slice:
        """x0, y0, z0: the root in the local frame, metres."""
        return slice(2 * self.n_angles, 2 * self.n_angles + 3)

    @cached_property
    def euler_slice(self) -> slice:
        """xi, psi, zeta of R_camera_local, rad."""
        return slice(2 * self.n_angles + 3, 2 * self.n_angles + 6)

    @property
    def base_index(self) -> int:
        return 2 * self.n_angles + 6

    @cached_property
    def angle_names(self) -> tuple[str, ...]:
        """theta_<link's end> and phi_<link's end> without the joint's letter, as in theta_6."""
        ends = [link.end.lstrip("J") for link in self.links if link.free]
        return tuple(f"theta_{e}" for e in ends) + tuple(f"phi_{e}" for e in ends)

    @cached_property
    def state_names(self) -> tuple[str, ...]:
        return (*self.angle_names, "x0_m", "y0_m", "z0_m", "xi", "psi", "zeta", "base_length_m")

    def keypoint_names(self, side: Side) -> tuple[str, ...]:
        """The joints' keypoints when the limbs of that side are fitted, (J,)."""
        return tuple(left if side == "left" else right for left, right in self.keypoints)

    @cached_property
    def limbs(self) -> dict[str, tuple[str, ...]]:
        """Joints along each limb, from its start, for drawing."""
        limbs: dict[str, list[str]] = {}
        for link in self.links:
            limbs.setdefault(link.limb, [link.start]).append(link.end)
        return {name: tuple(joints) for name, joints in limbs.items()}

    # -- kinematics ----------------------------------------------------------------------------------------------

    @cached_property
    def length_ratios(self) -> Array:
        """(L,)"""
        return np.array([link.length_ratio for link in self.links])

    @cached_property
    def free_length_ratios(self) -> Array:
        """(A,): of the links that have angles, in the order of the state."""
        return np.array([link.length_ratio for link in self.links if link.free])

    @cached_property
    def _paths(self) -> Array:
        """(J, L): 1 where a link lies between the root and a joint."""
        paths = {self.joints[0]: np.zeros(len(self.links))}
        for i, link in enumerate(self.links):
            paths[link.end] = paths[link.start] + np.eye(len(self.links))[i]
        return np.array([paths[joint] for joint in self.joints])

    @cached_property
    def _sums(self) -> Array:
        """(A, L): 1 where a free link's angle adds to a link's cumulated angle."""
        free = np.flatnonzero([link.free for link in self.links])
        return self._paths[1:][:, free].T.copy()

    @cached_property
    def _sweep(self) -> Array:
        """(L, J A): how far a change of each angle moves each joint through each link, per base length."""
        sweep = np.einsum("jl,l,al->lja", self._paths, self.length_ratios, self._sums)
        return np.ascontiguousarray(sweep.reshape(len(self.links), -1))

    def _directions(self, state: Array) -> tuple[Array, Array, Array, Array]:
        T = state[:, self.theta_slice] @ self._sums
        P = state[:, self.phi_slice] @ self._sums
        return np.cos(T), np.sin(T), np.cos(P), np.sin(P)

    def local_joints(self, state: Array) -> Array:
        """Joint positions relative to the root in the local frame UVW, metres: states (N, D) -> (N, J, 3)."""
        cT, sT, cP, sP = self._directions(state)
        directions = np.stack([cT * cP, sT, cT * sP], axis=1)
        per_base = directions @ (self._paths * self.length_ratios).T
        return per_base.transpose(0, 2, 1) * state[:, self.base_index, None, None]

    def pose(self, state: Array) -> Posed:
        """Joints in the camera frame for states (N, D), without Jacobian."""
        R = euler_rotation(state[:, self.euler_slice])
        p = self.local_joints(state) + state[:, None, self.place_slice]
        return Posed(state, R, p @ R.transpose(0, 2, 1))

    def pose_with_jacobian(self, state: Array) -> Posed:
        """Joints in the camera frame and their exact derivatives with respect to the state (N, D)."""
        N, J, A = len(state), len(self.joints), self.n_angles
        cT, sT, cP, sP = self._directions(state)
        base = state[:, self.base_index, None, None]
        directions = np.stack([cT * cP, sT, cT * sP], axis=1)
        c_per_base = directions @ (self._paths * self.length_ratios).T  # (N, 3, J)
        p = c_per_base * base + state[:, self.place_slice, None]
        R, dR = euler_rotation_with_jacobian(state[:, self.euler_slice])

        local = np.empty((N, 3, J, self.n_state))
        d_theta = np.stack([-sT * cP, cT, -sT * sP], axis=1) * base
        d_phi = np.stack([-cT * sP, np.zeros_like(sP), cT * cP], axis=1) * base
        local[..., self.theta_slice] = (d_theta @ self._sweep).reshape(N, 3, J, A)
        local[..., self.phi_slice] = (d_phi @ self._sweep).reshape(N, 3, J, A)
        local[..., self.place_slice] = np.eye(3)[:, None, :]
        local[..., self.euler_slice] = 0.0
        local[..., self.base_index] = c_per_base
        jacobian = (R @ local.reshape(N, 3, -1)).reshape(local.shape)
        jacobian[..., self.euler_slice] = (dR @ p[:, None]).transpose(0, 2, 3, 1)
        return Posed(state, R, (R @ p).transpose(0, 2, 1), jacobian.transpose(0, 2, 1, 3), dR)
