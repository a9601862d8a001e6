"""Define the 8U chain and the 21 unknowns of one frame, as published.

The chain (`recon.animal.chain`) has links with two angles each, theta and phi. The unknowns of one frame, in order, are

    [theta of every free link, phi of every free link, x0, y0, z0, xi, psi, zeta, base_length]

The base length in metres scales all links. p0 = (x0, y0, z0) is the position of the root joint in the local frame UVW.
A joint with the position c relative to the root lies at R (p0 + c) in the camera frame, where
R = Rx(xi) Ry(psi) Rz(zeta). All positions are in metres, all angles in rad.
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass, fields
from functools import cached_property
from pathlib import Path
from typing import Annotated

import numpy as np
import numpy.typing as npt
from pydantic import BeforeValidator
from scipy.spatial.transform import Rotation

from recon.animal.chain import UVW_BODY, Chain
from recon.animal.chain import load_chain as load_plain_chain
from recon.base.arrays import Array
from recon.geometry.frames import euler_rotation, euler_rotation_with_jacobian
from recon.geometry.kinematics import PITCH, ROLL, ROOT, YAW


@dataclass(frozen=True)
class ChainPose:
    """Positions of a chain's J joints in the camera frame for N states of D unknowns.

    The Jacobians are None unless they were requested.
    """

    state: Array
    """States, shape (N, D)."""
    rotation: Array
    """Rotations R_camera_local, shape (N, 3, 3)."""
    joints_m: Array
    """Positions of the joints in the camera frame in metres, shape (N, J, 3)."""
    joints_jacobian: Array | None = None
    """Derivatives of the positions with respect to the unknowns, shape (N, J, 3, D)."""
    rotation_jacobian: Array | None = None
    """Derivatives of the rotations, shape (N, 3, 3, 3), with xi, psi, zeta along axis 1."""


@dataclass(frozen=True)
class UnknownsChain(Chain):
    """A chain of links, with the D unknowns of one frame and the kinematics that they determine."""

    @property
    def n_state(self) -> int:
        """Return the number of unknowns D = 2 A + 7 for A free links, which is 21 for the 8U chain."""
        return 2 * self.n_angles + 7

    @cached_property
    def theta_slice(self) -> slice:
        """Return the slice of the state that holds theta, the first angle of every free link, in rad."""
        return slice(0, self.n_angles)

    @cached_property
    def phi_slice(self) -> slice:
        """Return the slice of the state that holds phi, the second angle of every free link, in rad."""
        return slice(self.n_angles, 2 * self.n_angles)

    @cached_property
    def position_slice(self) -> slice:
        """Return the slice of the state that holds x0, y0, z0, the root's position in metres in the local frame."""
        return slice(2 * self.n_angles, 2 * self.n_angles + 3)

    @cached_property
    def euler_slice(self) -> slice:
        """Return the slice of the state that holds the Euler angles xi, psi, zeta of R_camera_local, in rad."""
        return slice(2 * self.n_angles + 3, 2 * self.n_angles + 6)

    @property
    def base_index(self) -> int:
        """Return the index of the base length in the state."""
        return 2 * self.n_angles + 6

    @cached_property
    def state_names(self) -> tuple[str, ...]:
        """Return the names of the D unknowns, such as theta_6, x0_m, xi and base_length_m, with angles in rad."""
        return (*self.angle_names, "x0_m", "y0_m", "z0_m", "xi", "psi", "zeta", "base_length_m")

    def to_body(self, state: Array, T_world_camera: Array) -> tuple[Array, Array]:
        """Convert states of the chain to states of its body in the world, with factors for the body's lengths.

        Parameters
        ----------
        state
            States (N, D) of the chain.
        T_world_camera
            Camera poses, (4, 4) or (N, 4, 4).

        Returns
        -------
        tuple
            States (N, D') of `body` in the world, and factors (N,) that scale its lengths.
        """
        R_world_local = T_world_camera[..., :3, :3] @ euler_rotation(state[:, self.euler_slice])
        R = R_world_local @ UVW_BODY
        body_state = np.empty((len(state), self.body.n_state))
        root_local = state[:, self.position_slice, None]
        body_state[:, ROOT] = (R_world_local @ root_local)[..., 0] + T_world_camera[..., :3, 3]
        body_state[:, YAW] = np.arctan2(R[:, 1, 0], R[:, 0, 0])
        body_state[:, PITCH] = np.arctan2(-R[:, 2, 0], np.hypot(R[:, 0, 0], R[:, 1, 0]))
        body_state[:, ROLL] = np.arctan2(R[:, 2, 1], R[:, 2, 2])
        body_state[:, self.body_angles] = state[:, : 2 * self.n_angles]
        return body_state, state[:, self.base_index] / self.nominal_base_length_m

    def _local_state(self, state: Array) -> Array:
        """Return the body's states (N, D') for states (N, D) of the chain, with the root's pose left at 0."""
        local_state = np.zeros((len(state), self.body.n_state))
        local_state[:, self.body_angles] = state[:, : 2 * self.n_angles]
        return local_state

    def local_joints(self, state: Array) -> Array:
        """Return the joints' positions (N, J, 3) relative to the root in metres in UVW, for states (N, D)."""
        size = state[:, self.base_index] / self.nominal_base_length_m
        return self.body.tree.pose(self._local_state(state), size).points_m @ UVW_BODY.T

    def pose(self, state: Array) -> ChainPose:
        """Return the joints' positions in the camera frame for states (N, D), without Jacobians."""
        R = euler_rotation(state[:, self.euler_slice])
        p = self.local_joints(state) + state[:, None, self.position_slice]
        return ChainPose(state, R, p @ R.transpose(0, 2, 1))

    def pose_with_jacobian(self, state: Array) -> ChainPose:
        """Return the joints' positions in the camera frame for states (N, D), with exact Jacobians."""
        N, J, A = len(state), len(self.joints), self.n_angles
        tree = self.body.tree.pose_with_jacobian(self._local_state(state))
        size = state[:, self.base_index, None, None] / self.nominal_base_length_m
        c_per_size = UVW_BODY @ tree.points_m.transpose(0, 2, 1)  # (N, 3, J)
        p = c_per_size * size + state[:, self.position_slice, None]
        # The inner loop of the frame method has one frame, and a single rotation is several times faster than a stack.
        angles = state[:, self.euler_slice]
        R, dR = euler_rotation_with_jacobian(angles[0] if N == 1 else angles)
        R, dR = R.reshape(N, 3, 3), dR.reshape(N, 3, 3, 3)

        jacobian = np.empty((N, 3, J, self.n_state))
        by_angle = tree.jacobian.take(self.body_angles, axis=-1).transpose(0, 2, 1, 3).reshape(N, 3, J * 2 * A)
        jacobian[..., : 2 * A] = (size * (R @ UVW_BODY) @ by_angle).reshape(N, 3, J, 2 * A)
        jacobian[..., self.position_slice] = R[:, :, None]
        jacobian[..., self.euler_slice] = (dR @ p[:, None]).transpose(0, 2, 3, 1)
        jacobian[..., self.base_index] = R @ (c_per_size / self.nominal_base_length_m)
        return ChainPose(state, R, (R @ p).transpose(0, 2, 1), jacobian.transpose(0, 2, 1, 3), dR)


def with_unknowns(chain: object) -> object:
    """Return a chain as `UnknownsChain`, and anything else unchanged."""
    if isinstance(chain, UnknownsChain) or not isinstance(chain, Chain):
        return chain
    return UnknownsChain(**{field.name: getattr(chain, field.name) for field in fields(Chain)})


AnyChain = Annotated[UnknownsChain, BeforeValidator(with_unknowns)]
"""Type of a field that also accepts a plain chain, as in files of earlier versions."""


def load_chain(name_or_path: str | Path) -> UnknownsChain:
    """Load a skeleton as a chain with the unknowns of one frame.

    Raises
    ------
    InputError
        If the file cannot be used, or the skeleton describes a whole animal.
    """
    chain = with_unknowns(load_plain_chain(name_or_path))
    assert isinstance(chain, UnknownsChain)
    return chain


def mean_pose(chain: UnknownsChain) -> Array:
    """Return the state (D,) of a chain at the origin with its expected angles and nominal size."""
    state = np.zeros(chain.n_state)
    state[chain.theta_slice] = chain.theta.mean_rad
    state[chain.phi_slice] = chain.phi.mean_rad
    state[chain.base_index] = chain.nominal_base_length_m
    return state


def euler_angles(rotation: npt.ArrayLike) -> Array:
    """Return the Euler angles xi, psi, zeta (..., 3) of rotations (..., 3, 3), in rad.

    This is the inverse of `recon.geometry.frames.euler_rotation`. psi is in [-pi/2, pi/2]. At psi = ±pi/2 only xi +
    zeta or xi - zeta is determined, and zeta is set to 0.

    Raises
    ------
    ValueError
        If the determinant of a matrix is not positive.
    """
    matrices = np.asarray(rotation, dtype=float)
    if (np.linalg.det(matrices) <= 0).any():  # older versions of scipy accept such matrices as rotations
        raise ValueError("a rotation matrix must have a positive determinant")
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message="Gimbal lock")
        angles = Rotation.from_matrix(matrices.reshape(-1, 3, 3)).as_euler("XYZ")
    return np.asarray(angles).reshape(*matrices.shape[:-2], 3)
