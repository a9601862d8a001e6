"""Find the states from which the solution of a clip starts.

The mean pose, moving at constant velocity, is fitted to the viewing rays for many headings. The best of these starts
are then refined while the noise decreases (`approach`). For a given heading, the position that brings a shape nearest
to the rays of one frame is the solution of a small least-squares problem. The distance follows from the size of the
shape. The path over a window shows whether the animal comes nearer or goes away, which a single frame cannot show.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from recon.animal.body import MIN_JOINTS
from recon.animal.prior import ANGLES
from recon.base.arrays import Array, Index
from recon.fit.clip_problem import UP, ClipProblem
from recon.fit.least_squares import Estimate
from recon.geometry.kinematics import ROOT, YAW

_MISFIT_M = 0.15
"""Distance (m) of a joint of the mean pose from its ray at which the robust loss is half the squared distance.

Swinging legs are about this far from the mean pose.
"""


def position_on_rays(joints_m: Array, rays: Array) -> Array:
    """Return the translations that bring a rigid shape nearest to viewing rays.

    The first guess is the median over the joints, at the distance from the camera that is the median over pairs of
    joints. Gauss-Newton steps with Geman-McClure weights then minimise the angles between joints and rays. Distances
    from the rays would draw the shape towards the camera. Leading axes broadcast.

    Parameters
    ----------
    joints_m
        Points of the shape, (..., J, 3), metres.
    rays
        Unit vectors from the camera, (..., J, 3), NaN if missing. At least two of the J rays must be known.

    Returns
    -------
    (..., 3) array
        Translations, metres.
    """
    seen = np.isfinite(rays[..., 0])
    middle = _median_of_known(rays.swapaxes(-1, -2))
    middle /= np.linalg.norm(middle, axis=-1, keepdims=True)
    i, j = np.triu_indices(rays.shape[-2], 1)
    between_joints = joints_m[..., i, :] - joints_m[..., j, :]
    along = (between_joints @ middle[..., None])[..., 0]
    apart_m = np.sqrt(np.maximum(np.sum(between_joints**2, axis=-1) - along**2, 0.0))
    apart_rad = np.linalg.norm(rays[..., i, :] - rays[..., j, :], axis=-1)
    depth = _median_of_known(apart_m / np.maximum(apart_rad, 1e-6))
    t = _median_of_known((rays * depth[..., None, None] - joints_m).swapaxes(-1, -2))

    for _ in range(6):
        deviations = _off_rays(joints_m + t[..., None, :], rays)
        miss = np.sqrt(_dot(deviations[2], deviations[2])) * depth[..., None]
        normal, pull = _normal(*deviations, seen / (1.0 + (miss / _MISFIT_M) ** 2) ** 2)
        step = -_solution(normal + 1e-9 * np.eye(3), pull)[..., 0]
        length = np.linalg.norm(step, axis=-1)
        t = t + step * np.minimum(1.0, 0.3 * depth / np.maximum(length, 1e-9))[..., None]
    return t


def _median_of_known(values: Array) -> Array:
    """Return the medians (...) of the values (..., N) that are not NaN, much faster than `numpy.nanmedian`."""
    ordered, counts = np.sort(values, axis=-1), np.isfinite(values).sum(axis=-1)[..., None]  # NaN values come last
    middle = [np.take_along_axis(ordered, index, axis=-1) for index in ((counts - 1) // 2, counts // 2)]
    return (0.5 * (middle[0] + middle[1]))[..., 0]


def _dot(a: Array, b: Array) -> Array:
    """Return scalar products (...) of vectors (..., 3)."""
    return np.einsum("...i,...i->...", a, b)


def _off_rays(points_m: Array, rays: Array) -> tuple[Array, Array, Array]:
    """Return the deviations of points (..., J, 3) from their rays, as q / r, c and m.

    Let q be the direction of a point (a unit vector), r its distance, and d its ray, 0 if missing. The results are q /
    r (..., J, 3), the cosine c (..., J) between q and d, and the part m = d - c q (..., J, 3) of d perpendicular to q,
    whose length is the sine.
    """
    square, rays = _dot(points_m, points_m), np.nan_to_num(rays)
    cosine = _dot(points_m, rays) / np.sqrt(square)
    near = points_m / square[..., None]
    return near, cosine, rays - (cosine * np.sqrt(square))[..., None] * near


def _normal(near: Array, cosine: Array, across: Array, weight: Array) -> tuple[Array, Array]:
    """Return the normal equations (..., 3, 3) and (..., 3, 1) of a translation that brings points towards their rays.

    The first three arguments are the results of `_off_rays`. The equations are summed over the joints with `weight`
    (..., J). The residual is q - c d. Its derivative with respect to the point is S = (I - d d' - (q - c d) q') / r, so
    that S'S = (I - m m' - q q') / r^2 and S'(q - c d) = -c m / r.
    """
    square = weight * _dot(near, near)  # equals weight / r^2
    along = np.concatenate([across * np.sqrt(square)[..., None], near * np.sqrt(weight)[..., None]], axis=-2)
    normal = np.sum(square, axis=-1)[..., None, None] * np.eye(3) - along.swapaxes(-1, -2) @ along
    return normal, -across.swapaxes(-1, -2) @ (np.sqrt(weight * square) * cosine)[..., None]


def run_path(heading: Array, up: Array, time_s: Array) -> Array:
    """Return the derivatives (F, 3, 6) of a run's positions at times (F,), s, with respect to its six unknowns.

    The unknowns are those that `constant_velocity` returns.
    """
    motion = np.zeros((len(time_s), 3, 6))
    motion[:, :, :3] = np.eye(3)
    motion[:, :, 3] = heading * time_s[:, None]
    motion[:, :, 4] = heading * (time_s**2)[:, None] / 2
    motion[:, :, 5] = up * time_s[:, None]
    return motion


def constant_velocity(
    headings: Array, shapes: Array, up: Array, rays: Array, time_s: Array, centres_m: Array | None = None
) -> tuple[Array, Array]:
    """Fit shapes that each run straight along a heading to rays from one or more cameras.

    All H headings are solved at once, by Gauss-Newton steps with Geman-McClure weights.

    Parameters
    ----------
    headings
        Directions of running as unit vectors, (H, 3).
    shapes
        The shape turned to each heading, (H, J, 3), metres.
    up
        Upward direction, (3,), along which a run may climb.
    rays
        Viewing rays as unit vectors, (F, J, 3), NaN if missing.
    time_s
        Times of the rays, (F,), seconds, with mean zero.
    centres_m
        Origins of the rays, (F, 3), metres; None for zero.

    Returns
    -------
    misfits : (H,) array
        Misfit of each heading, 0 to 1, plus 1 if the animal would run backwards.
    unknowns : (H, 6) array
        Position at time zero (m), speed and acceleration along the heading (m/s, m/s^2), and climb (m/s).
    """
    (H, J), F = shapes.shape[:2], len(rays)
    centres = np.zeros((F, 3)) if centres_m is None else centres_m
    positions = position_on_rays(shapes[:, None], rays)  # (H, F, 3)
    scale = np.median(np.linalg.norm(positions, axis=2), axis=1)[:, None, None] / _MISFIT_M
    seen = np.isfinite(rays[..., 0])
    motion = np.stack([run_path(heading, up, time_s) for heading in headings])  # (H, F, 3, 6)
    # A wide prior bounds the unknowns that a short clip does not determine.
    prior = np.diag(1.0 / np.array([1e3, 1e3, 1e3, 15.0, 10.0, 1.0]) ** 2)
    x = np.zeros((H, 6))
    x[:, :3] = np.median(positions + centres, axis=1)
    x[:, 3] = np.maximum(np.sum(_robust_slopes(time_s, positions + centres) * headings, axis=1), 0.0)
    miss = np.zeros((H, F, J))
    for _ in range(8):
        path = (motion @ x[:, None, :, None])[..., 0] - centres  # (H, F, 3)
        deviations = _off_rays(shapes[:, None] + path[:, :, None], rays)
        miss = np.where(deviations[1] > 0, np.sqrt(_dot(deviations[2], deviations[2])) * scale, np.inf)
        curvature, pull = _normal(*deviations, scale**2 * seen / (1.0 + miss**2) ** 2)
        transposed = motion.swapaxes(-1, -2)
        normal = np.sum(transposed @ curvature @ motion, axis=1) + prior + 1e-9 * np.eye(6)
        gradient = np.sum(transposed @ pull, axis=1)[..., 0] + x @ prior
        x = x - _solution(normal, gradient[..., None])[..., 0]
    fraction = np.where(seen, 1.0 - 1.0 / (1.0 + miss**2), 0.0)
    return fraction.sum(axis=(1, 2)) / max(int(seen.sum()), 1) + (x[:, 3] < 0), x


def _solution(matrix: Array, right: Array) -> Array:
    """Return matrix^-1 right (N, n, m), regularised if one of the matrices (N, n, n) is singular to rounding."""
    try:
        return np.asarray(np.linalg.solve(matrix, right), dtype=float)
    except np.linalg.LinAlgError:
        regularisation = 1e-9 * np.trace(matrix, axis1=-2, axis2=-1)[..., None, None] * np.eye(matrix.shape[-1])
        return np.linalg.solve(matrix + regularisation, right)


def _robust_slopes(time_s: Array, positions_m: Array) -> Array:
    """Return the velocities (H, 3) of straight paths fitted to positions (H, N, 3) by least absolute distances."""
    design = np.stack([np.ones_like(time_s), time_s - time_s.mean()], axis=1)
    weight, line = np.ones(positions_m.shape[:2]), np.zeros((len(positions_m), 2, 3))
    for _ in range(10):
        weighted = (design * weight[..., None]).swapaxes(1, 2)  # (H, 2, N)
        line = np.asarray(np.linalg.solve(weighted @ design + 1e-12 * np.eye(2), weighted @ positions_m), dtype=float)
        weight = 1.0 / np.maximum(np.linalg.norm(positions_m - design @ line, axis=2), 0.05)
    return line[:, 1]


APPROACH_HZ = 30.0
"""Frame rate of the approach (Hz) to which clips with a higher rate are thinned."""
_HEADINGS = 18
"""Number of headings that are tried, of which a fast fit tries half."""
_BEST_HEADINGS = 2
"""Number of headings, those with the smallest misfits, from which the search starts.

`python benchmarks/accuracy.py --only starts` counts the windows in which a third heading would lead to a lower minimum.
"""
_APART_RAD = 0.5
"""Minimum angle (rad) between the headings of two starts."""
_NOISE_FACTORS = (8.0, 4.0, 2.0, 1.0)
"""Factors on the noise during the approach, in the order in which they are used, for one camera."""
_FACTORS_OF_SEVERAL = (8.0, 1.0)
"""Factors on the noise for several cameras, which determine the animal's position.

`python benchmarks/accuracy.py --only starts` counts the windows in which all factors would lead to a lower minimum.
"""
_SAME_M = 0.05
"""Maximum mean distance (m) between the markers of two motions that count as the same minimum."""
ALTERNATIVE_COST = 20.0
"""Maximum extra cost at which a second solution is reported."""
_INTERMEDIATE_TOLERANCE = 0.2
"""Relative decrease of the cost that ends the search with each noise factor between the first and the last."""
_RAYS = 16
"""Approximate number of frames, over all views, whose rays determine the headings."""
_MIN_RAYS = 2
"""Minimum number of rays in a frame that determine the position of a shape."""
_MAX_EXTRA_MISFIT = 0.2
"""Maximum difference between the misfits of a start and of the best start, for several cameras.

Starts with a larger misfit are not tried. The heading is often ambiguous for one camera, but not for several. `python
benchmarks/accuracy.py --only starts` counts the starts that are left out, and how many of them would lead to a lower
minimum.
"""


def approach(clip: ClipProblem) -> list[Estimate]:
    """Return the starts of one window after the approach with decreasing noise, best first.

    Only the two best starts (one in a fast fit) are solved down to the smallest noise and interpolated to all frames of
    the window. The search from the second one stops early if it reaches the minimum of the first, or if its cost is too
    high to be reported.
    """
    fast, no_factor = clip.options.fast, np.ones((len(clip.views), len(clip.body.markers)))
    step = max(1, round(clip.fps / APPROACH_HZ))
    thin, kept_frames = clip.thinned(step), np.arange(0, len(clip), step)

    def minimum(states: Array, widen: float, tolerance: float, iterations: int) -> Estimate:
        noise = thin.noise_px(thin.markers(states), no_factor) * widen
        return thin.problem(noise).minimise(states, tolerance, iterations)

    widest, *between, last = _NOISE_FACTORS if len(clip.views) == 1 else _FACTORS_OF_SEVERAL
    narrower = [*((widen, _INTERMEDIATE_TOLERANCE) for widen in between), (last, 3e-3 if fast else 1e-3)]
    starts = [minimum(states[kept_frames], widest, 1e-2, 12) for states in _starts(clip)]
    starts.sort(key=lambda start: start.cost)
    minima = [starts[0]]
    for widen, tolerance in narrower:
        minima.append(minimum(minima[-1].states, widen, tolerance, 15))
    finished = [minima[-1]]
    for estimate in [] if fast else starts[1:2]:
        for (widen, tolerance), best in zip(narrower, minima[1:], strict=True):
            if estimate.cost > finished[0].cost + ALTERNATIVE_COST:
                break  # the cost only increases when the noise decreases
            estimate = minimum(estimate.states, widen, tolerance, 15)
            if _distance_m(thin, estimate, best) < _SAME_M:
                estimate = finished[0]
                break
        finished.append(estimate)
    finished.sort(key=lambda estimate: estimate.cost)
    T = len(clip)
    return [
        *(replace(estimate, states=interpolate_states(estimate.states, kept_frames, T)) for estimate in finished),
        *starts[len(finished) :],
    ]


def _distance_m(clip: ClipProblem, estimate: Estimate, reference: Estimate) -> float:
    """Return the mean distance between the markers of two motions, m."""
    return float(np.linalg.norm(clip.markers(estimate.states) - clip.markers(reference.states), axis=2).mean())


def interpolate_states(states: Array, at: Index, T: int) -> Array:
    """Interpolate states (n, D), given at frames (n,), linearly to all frames, (T, D).

    After the last given frame, the root moves on at its last velocity and the angles stay constant.
    """
    states, frames = states.copy(), np.arange(T)
    states[:, YAW] = np.unwrap(states[:, YAW])
    result = np.stack([np.interp(frames, at, column) for column in states.T], axis=1)
    if len(at) > 1:
        velocity = (states[-1, ROOT] - states[-2, ROOT]) / (at[-1] - at[-2])
        result[:, ROOT] += np.maximum(frames - at[-1], 0)[:, None] * velocity
    return result


def _starts(clip: ClipProblem) -> list[Array]:
    """Return the states (T, D) of the best straight runs and, for one camera, of the best run mirrored in depth."""
    misfit, headings_rad, states = _runs(clip)
    best = int(np.argmin(misfit))
    minima = [
        i for i in range(len(misfit)) if misfit[i] <= misfit[i - 1] and misfit[i] <= misfit[(i + 1) % len(misfit)]
    ]
    order = sorted(minima, key=lambda i: misfit[i])[:_BEST_HEADINGS]
    if len(clip.views) == 1:
        order.append(-best % len(misfit))
    else:
        order = [i for i in order if misfit[i] < misfit[best] + _MAX_EXTRA_MISFIT]
    chosen: list[int] = []
    for i in order:
        angles = [abs(np.angle(np.exp(1j * (headings_rad[i] - headings_rad[j])))) for j in chosen]
        if all(a > _APART_RAD for a in angles):
            chosen.append(i)
    return [states[i] for i in chosen]


def _runs(clip: ClipProblem) -> tuple[Array, Array, Array]:
    """Return misfits (H,), headings (H,) in rad, and states (H, T, D) of the mean pose that runs straight."""
    T, count = len(clip), _HEADINGS // 2 if clip.options.fast else _HEADINGS
    rays, centres, frames = _rays(clip)
    time_s, middle = np.arange(T) / clip.fps, frames.mean() / clip.fps
    headings_rad = 2 * np.pi * np.arange(count) / count
    yaw_rad = headings_rad + np.arctan2(clip.image_right[1], clip.image_right[0])
    first_states = np.zeros((count, clip.body.n_state))
    first_states[:, YAW], first_states[:, ANGLES] = yaw_rad, clip.prior.mean
    headings = np.stack([np.cos(yaw_rad), np.sin(yaw_rad), np.zeros(count)], axis=1)
    shapes = clip.markers(first_states)
    misfits, runs = constant_velocity(headings, shapes, UP, rays, frames / clip.fps - middle, centres)
    states = np.repeat(first_states[:, None], T, axis=1)
    for heading, run, run_states in zip(headings, runs, states, strict=True):
        run_states[:, ROOT] = run_path(heading, UP, time_s - middle) @ run
    return misfits, headings_rad, states


def _rays(clip: ClipProblem) -> tuple[Array, Array, Array]:
    """Return rays (F, J, 3) of all views, origins (F, 3) relative to `origin_m` in m, and their frames (F,)."""
    rays, centres, frames = [], [], []
    counts = [view.present.sum(axis=1) for view in clip.views]
    min_rays = MIN_JOINTS if max(count.max() for count in counts) >= MIN_JOINTS else _MIN_RAYS
    for view, count in zip(clip.views, counts, strict=True):
        usable = np.flatnonzero(count >= min_rays)
        step = max(1, min(3 * len(clip.views), len(usable) // 6), len(usable) // max(_RAYS // len(clip.views), 3))
        chosen = usable[::step]
        rays.append(view.part(chosen).rays())
        centres.append(view.centre_m[chosen] - clip.origin_m)
        frames.append(chosen)
    return np.concatenate(rays), np.concatenate(centres), np.concatenate(frames)
