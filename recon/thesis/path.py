"""Smooth the path of the reference joint once the frames have been solved one by one.

A single frame of one camera hardly determines depth. The positions R p0 jitter along the line of sight by decimetres
from frame to frame, and their derivatives are noise. The acceleration of an animal, however, is limited and changes
gradually. The path is therefore estimated from all frames at once. Its state is position, velocity and acceleration in
three dimensions. The acceleration is a random process with the standard deviation `ACCELERATION_M_S2` and the
correlation time `ACCELERATION_LASTS_S`. The measurement in each frame is the position with its posterior covariance.
Neighbouring frames have similar poses and therefore similar errors, so all positions within `ERRORS_LAST_S` count as
one measurement. A Kalman filter with a backward pass computes the estimate (Rauch, Tung and Striebel 1965).

The frames are then solved again, with the distance between R p0 and this path (`PathTie`) as an additional objective.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import expm

from recon.base.arrays import Array
from recon.thesis.chain import ChainPose, UnknownsChain
from recon.thesis.objectives import Objective, ResidualAndJacobian

ACCELERATION_M_S2 = 9.0
"""Standard deviation of the reference joint's acceleration along each axis in a running animal, in m/s²."""
ACCELERATION_LASTS_S = 0.05
"""Correlation time of the reference joint's acceleration, in seconds."""
ERRORS_LAST_S = 0.06
"""Correlation time of the position errors in seconds, within which positions count as one measurement."""
MIN_SIGMA_M = 0.02
"""Minimum standard deviation of a position in metres, because the reference joint is not fixed on the animal."""
_FIRST_POSITION_M = 100.0
"""Standard deviation of the position before the first frame in metres, large enough to leave the position free."""
_FIRST_SPEED_M_S = 30.0
"""Standard deviation of the velocity before the first frame in m/s, larger than any animal's speed."""


@dataclass(frozen=True, eq=False)
class Path:
    """Path of the reference joint in the camera frame over T frames, if the base length has its expected value."""

    position_m: Array
    """Positions in metres, shape (T, 3)."""
    velocity_m_s: Array
    """Velocities in m/s, shape (T, 3)."""
    covariance: Array
    """Covariances of position, velocity and acceleration, shape (T, 9, 9), without the base length's uncertainty.

    In files of earlier versions the acceleration is missing, and the shape is (T, 6, 6).
    """
    acceleration_m_s2: Array | None = None
    """Accelerations in m/s², shape (T, 3); None in files of earlier versions."""


@dataclass(frozen=True, eq=False)
class PathTie(Objective):
    """Penalty on the distance between the reference joint and its smoothed path.

    The residuals are (R p0 * expected base length / base length - path) / sigma. The ratio of the base lengths leaves
    the scale free, because the pixels do not determine the scale either.
    """

    position_m: Array
    """Positions of the path in metres, shape (T, 3); NaN in frames without a penalty."""
    nominal_base_length_m: float
    base_index: int
    sigma_m: float
    name: str = "path tie"

    def evaluate(self, pose: ChainPose, previous: ChainPose | None, frame: int, dt_s: float) -> ResidualAndJacobian:
        assert pose.joints_jacobian is not None
        target_m = self.position_m[frame]
        if not np.isfinite(target_m[0]):
            return np.zeros(3), np.zeros((3, pose.state.shape[1]))
        base_m = pose.state[0, self.base_index]
        scale = self.nominal_base_length_m / base_m
        root_m = pose.joints_m[0, 0]
        jacobian = scale * pose.joints_jacobian[0, 0]
        jacobian[:, self.base_index] -= scale * root_m / base_m
        return (scale * root_m - target_m) / self.sigma_m, jacobian / self.sigma_m


def path_of(chain: UnknownsChain, states: Array, covariance: Array, fps: float) -> Path | None:
    """Estimate the path of the reference joint from the frames' solutions; None for fewer than two solved frames.

    Parameters
    ----------
    chain
        The fitted chain.
    states
        States (T, D); NaN without a pose.
    covariance
        Covariances (T, D, D) of the states, given the previous frame.
    fps
        Frames per second.
    """
    pose = chain.pose_with_jacobian(states)
    assert pose.joints_jacobian is not None
    base_m = states[:, chain.base_index, None]
    scale = chain.nominal_base_length_m / base_m
    root_m = scale * pose.joints_m[:, 0]
    by_state = scale[..., None] * pose.joints_jacobian[:, 0]
    by_state[..., chain.base_index] -= root_m / base_m
    of_root = np.einsum("tad,tde,tbe->tab", by_state, covariance, by_state)
    is_known = np.isfinite(root_m).all(axis=1) & np.isfinite(of_root).all(axis=(1, 2))
    if is_known.sum() < 2:
        return None
    inflation = max(1.0, ERRORS_LAST_S * fps)
    noise = inflation * of_root + MIN_SIGMA_M**2 * np.eye(3)
    return _smoothed(root_m, noise, is_known, 1.0 / fps)


def _smoothed(points_m: Array, noise: Array, is_known: Array, dt_s: float) -> Path:
    """Return the smoothed path of points (T, 3) in metres with covariances `noise` (T, 3, 3)."""
    F, Q = _motion_model(dt_s)
    T = len(points_m)
    x = np.concatenate([points_m[np.flatnonzero(is_known)[0]], np.zeros(6)])
    P = np.diag(np.repeat([_FIRST_POSITION_M**2, _FIRST_SPEED_M_S**2, ACCELERATION_M_S2**2], 3))
    # row 0 is predicted from the previous frame, and row 1 is updated with the frame's position
    means, covariances = np.empty((2, T, 9)), np.empty((2, T, 9, 9))
    for t in range(T):
        if t:
            x, P = F @ x, F @ P @ F.T + Q
        means[0, t], covariances[0, t] = x, P
        if is_known[t]:
            gain = np.linalg.solve(P[:3, :3] + noise[t], P[:3]).T
            x, P = x + gain @ (points_m[t] - x[:3]), P - gain @ P[:3]
        means[1, t], covariances[1, t] = x, P
    smooth_x, smooth_P = means[1].copy(), covariances[1].copy()
    for t in range(T - 2, -1, -1):
        back = np.linalg.solve(covariances[0, t + 1], F @ covariances[1, t]).T
        smooth_x[t] += back @ (smooth_x[t + 1] - means[0, t + 1])
        smooth_P[t] += back @ (smooth_P[t + 1] - covariances[0, t + 1]) @ back.T
    return Path(smooth_x[:, :3], smooth_x[:, 3:6], smooth_P, smooth_x[:, 6:])


def _motion_model(dt_s: float) -> tuple[Array, Array]:
    """Return the transition matrix (9, 9) of position, velocity and acceleration over `dt_s`, and its covariance."""
    A = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [0.0, 0.0, -1.0 / ACCELERATION_LASTS_S]])
    drive = np.zeros((3, 3))
    drive[2, 2] = 2.0 * ACCELERATION_M_S2**2 / ACCELERATION_LASTS_S
    # Van Loan (1978): both matrices are blocks of one matrix exponential.
    blocks = expm(dt_s * np.block([[-A, drive], [np.zeros((3, 3)), A.T]]))
    F = blocks[3:, 3:].T
    Q = F @ blocks[:3, 3:]
    return np.asarray(np.kron(F, np.eye(3)), float), np.asarray(np.kron(Q, np.eye(3)), float)
