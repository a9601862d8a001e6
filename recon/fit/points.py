"""Solve for the states of a body whose markers are known in 3D."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from recon.animal.body import Body
from recon.base.arrays import Array
from recon.geometry.kinematics import PITCH, ROOT, YAW

MIN_MARKERS = 8
"""Minimum number of known markers in a frame that is solved."""

_BLOCK = 512
"""Number of frames that are solved together, to limit the memory of the Jacobians."""
_ITERATIONS = 300
"""Maximum number of Levenberg-Marquardt steps for the pose of a frame."""
_TOLERANCE = 1e-10
"""Maximum change of any angle (rad) or position (m) in a step at which a frame counts as converged."""
_SIZE_ROUNDS = 20
"""Maximum number of rounds, each of which estimates the poses and then the size."""
_RETRIES = 2
"""Number of times that frames with a large error are solved again, starting from their neighbours."""
_DAMPING = (1e-12, 1e12)
"""Minimum damping of a step, and maximum damping, at which the search of a frame ends."""


def solve_points(
    body: Body, points_m: Array, size: float | None = 1.0, pull_m_per_rad: float = 1e-2
) -> tuple[Array, Array, float]:
    """Return the states of a body, and its size, that bring its markers nearest to given 3D points.

    Parameters
    ----------
    body
        The body with J markers and D unknowns per frame.
    points_m
        Points (T, J, 3) in the world, z up, metres; NaN if missing.
    size
        Factor on the body's lengths for all frames; None to estimate it.
    pull_m_per_rad
        Weight of the angles' deviations from the body's expected angles, metres per radian. The default is small, and
        only keeps undetermined angles from drifting, such as a rotation about an axis along the segment.

    Returns
    -------
    states : (T, D) array
        Unknowns of each frame, NaN in frames with fewer than `MIN_MARKERS` markers. The heading is continuous over
        time.
    rms_m : (T,) array
        Root mean square distance of the markers from the points.
    size : float
        Factor on the body's lengths, as given or estimated.

    Raises
    ------
    ValueError
        If the points do not fit the body, or if no frame has enough markers to estimate a size.
    """
    points_m = np.asarray(points_m, dtype=float)
    if points_m.ndim != 3 or points_m.shape[1:] != (len(body.markers), 3):
        raise ValueError(f"points of shape {points_m.shape}, but a body of {len(body.markers)} markers needs (T, J, 3)")
    known = np.asarray(np.isfinite(points_m).all(axis=2))
    enough = np.asarray(known.sum(axis=1) >= MIN_MARKERS)
    states = np.full((len(points_m), body.n_state), np.nan)
    rms_m = np.full(len(points_m), np.nan)
    if not enough.any():
        if size is None:
            raise ValueError(f"no frame has the {MIN_MARKERS} markers that an estimate of the size needs")
        return states, rms_m, size
    targets, weight = np.where(known[..., None], points_m, 0.0)[enough], known[enough].astype(float)
    factor = 1.0 if size is None else size
    solved = _start(body, targets, weight, factor)
    for _ in range(_SIZE_ROUNDS if size is None else 0):
        solved = _solve(body, targets, weight, factor, pull_m_per_rad, solved)
        step = _log_size_step(body, targets, weight, factor, pull_m_per_rad, solved)
        factor *= float(np.exp(np.clip(step, -0.3, 0.3)))
        if abs(step) < 1e-9:
            break
    solved = _nearest_turns(body, _solve(body, targets, weight, factor, pull_m_per_rad, solved))
    for _ in range(_RETRIES):
        solved = _retried(body, targets, weight, factor, pull_m_per_rad, solved)
    solved[:, YAW] = np.unwrap(solved[:, YAW])
    states[enough] = solved
    squares = (weight[..., None] * (body.tree.pose(solved, factor).points_m - targets) ** 2).sum(axis=(1, 2))
    rms_m[enough] = np.sqrt(squares / weight.sum(axis=1))
    return states, rms_m, factor


def _start(body: Body, targets: Array, weight: Array, size: float) -> Array:
    """Return states (T, D) of the expected pose, turned about the vertical and moved to fit the points."""
    states = np.zeros((len(targets), body.n_state))
    states[:, PITCH:] = body.mean_rad
    fraction = (weight / weight.sum(axis=1, keepdims=True))[..., None]
    model = body.tree.pose(states[:1], size).points_m
    a = (model - (fraction * model).sum(axis=1, keepdims=True)) * fraction
    b = targets - (fraction * targets).sum(axis=1, keepdims=True)
    cross = (a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]).sum(axis=1)
    states[:, YAW] = np.arctan2(cross, (a[..., :2] * b[..., :2]).sum(axis=(1, 2)))
    states[:, ROOT] = (fraction * (targets - body.tree.pose(states, size).points_m)).sum(axis=1)
    return states


def _nearest_turns(body: Body, states: Array) -> Array:
    """Return the states with every angle within half a turn of its expected value."""
    difference = states[:, PITCH:] - body.mean_rad
    return np.concatenate(
        [states[:, :PITCH], body.mean_rad + np.remainder(difference + np.pi, 2 * np.pi) - np.pi], axis=1
    )


def _retried(body: Body, targets: Array, weight: Array, size: float, pull: float, states: Array) -> Array:
    """Solve frames with an unusual pose or a large misfit again, starting from the poses of neighbouring frames.

    A segment that turns about two axes points in the same direction at (yaw + pi, pi - pitch). This is a second
    minimum, from which no small step leads back. The solution with the lower cost is kept.
    """
    cost = _cost(body, targets, weight, size, pull, states)
    odd = (np.abs(states[:, PITCH:] - body.mean_rad) > np.pi / 2).any(axis=1) | (cost > 4 * np.median(cost))
    good_frames, odd_frames = np.nonzero(~odd)[0], np.nonzero(odd)[0]
    if not len(odd_frames) or not len(good_frames):
        return states
    start = states[odd_frames]
    for a in range(PITCH, states.shape[1]):
        start[:, a] = np.interp(odd_frames, good_frames, states[good_frames, a])
    tried = _nearest_turns(body, _solve(body, targets[odd_frames], weight[odd_frames], size, pull, start))
    better = _cost(body, targets[odd_frames], weight[odd_frames], size, pull, tried) < cost[odd_frames]
    states = states.copy()
    states[odd_frames[better]] = tried[better]
    return states


class _NormalEquations(NamedTuple):
    """Normal equations of N frames with D unknowns each, and of the size that all frames share."""

    hessian: Array
    """Curvature of the cost with respect to the states, shape (N, D, D)."""
    gradient: Array
    """Gradient of the cost with respect to the states, shape (N, D)."""
    size_hessian: Array
    """Mixed curvature of the size's logarithm and each state, then the curvature of the size, shape (N, D + 1)."""
    size_gradient: Array
    """Gradient of each frame's cost with respect to the size's logarithm, shape (N,)."""


def _normal_equations(
    body: Body, targets: Array, weight: Array, size: float, pull: float, states: Array
) -> _NormalEquations:
    """Return the normal equations of the squared distances, and of the pull towards the expected angles.

    `targets` (N, J, 3) are the points, m, `weight` (N, J) holds 1 for known points and 0 for missing ones, and `pull`
    is `pull_m_per_rad` of `solve_points`.
    """
    N, D = states.shape
    pose = body.tree.pose_with_jacobian(states, size)
    jacobian = (pose.jacobian * weight[..., None, None]).reshape(N, -1, D)
    residual = ((pose.points_m - targets) * weight[..., None]).reshape(N, -1)
    d_size = (pose.d_size * weight[..., None]).reshape(N, -1)
    hessian = jacobian.swapaxes(1, 2) @ jacobian
    gradient = (residual[:, None] @ jacobian)[:, 0]
    angles = np.arange(PITCH, D)
    hessian[:, angles, angles] += pull**2
    gradient[:, angles] += pull**2 * (states[:, angles] - body.mean_rad)
    mixed = (d_size[:, None] @ jacobian)[:, 0]
    size_hessian = np.concatenate([mixed, (d_size**2).sum(axis=1)[:, None]], axis=1)
    return _NormalEquations(hessian, gradient, size_hessian, (d_size * residual).sum(axis=1))


def _cost(body: Body, targets: Array, weight: Array, size: float, pull: float, states: Array) -> Array:
    """Return the cost of each frame, (N,): half the squared distances plus the pull towards the expected angles.

    The parameters are as in `_normal_equations`.
    """
    residual = (body.tree.pose(states, size).points_m - targets) * weight[..., None]
    pulled = pull * (states[:, PITCH:] - body.mean_rad)
    return 0.5 * ((residual**2).sum(axis=(1, 2)) + (pulled**2).sum(axis=1))


def _solve(body: Body, targets: Array, weight: Array, size: float, pull: float, start: Array) -> Array:
    """Return the states that minimise each frame's cost, by Levenberg-Marquardt with a damping for each frame.

    The search begins at the states `start` (N, D). The other parameters are as in `_normal_equations`.
    """
    states, damping, diagonal = start.copy(), np.full(len(start), 1e-3), np.arange(start.shape[1])
    cost = _cost(body, targets, weight, size, pull, states)
    for active in np.array_split(np.arange(len(states)), range(_BLOCK, len(states), _BLOCK)):
        for _ in range(_ITERATIONS):
            if not len(active):
                break
            goals, weights = targets[active], weight[active]
            hessian, gradient, _, _ = _normal_equations(body, goals, weights, size, pull, states[active])
            hessian[:, diagonal, diagonal] *= 1.0 + damping[active, None]
            step = -np.linalg.solve(hessian, gradient[..., None])[..., 0]
            tried = states[active] + step
            new_cost = _cost(body, goals, weights, size, pull, tried)
            better = new_cost < cost[active]
            states[active[better]], cost[active[better]] = tried[better], new_cost[better]
            damping[active] = np.clip(damping[active] * np.where(better, 0.2, 5.0), *_DAMPING)
            # Near the minimum, rounding decides which step is better, so a step this small always ends the search.
            active = active[(np.abs(step).max(axis=1) >= _TOLERANCE) & (damping[active] < _DAMPING[1])]
    return states


def _log_size_step(body: Body, targets: Array, weight: Array, size: float, pull: float, states: Array) -> float:
    """Return the Gauss-Newton step of the logarithm of the size, with the states eliminated at their minimum.

    The parameters are as in `_normal_equations`.
    """
    curvature = gradient = 0.0
    for first in range(0, len(states), _BLOCK):
        block = slice(first, first + _BLOCK)
        hessian, _, by_size, d_size = _normal_equations(body, targets[block], weight[block], size, pull, states[block])
        cross = by_size[:, :-1]
        curvature += (by_size[:, -1] - (cross * np.linalg.solve(hessian, cross[..., None])[..., 0]).sum(axis=1)).sum()
        gradient += d_size.sum()
    return float(-gradient / curvature)
