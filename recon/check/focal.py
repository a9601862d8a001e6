"""Test the focal length of a single camera, which affects the animal's perspective, its motion in depth and the ground.

Through a lens of 1.5 times the focal length, an animal 1.5 times as far away looks equally large but flatter, and moves
1.5 times as far in depth. One second of the clip is solved again with other focal lengths. Each fit starts from the
solution, moved along the optical axis. The cost of a fit is divided by the correlation time of the errors, in frames,
because errors persist over frames. The minimum of a parabola through the costs is the estimated focal length.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from recon.base.arrays import Array
from recon.base.numbers import NORMAL_90
from recon.check.codes import finding
from recon.check.likelihood import Baseline, best_seen, effects_m
from recon.check.stretch import feet_are_detected
from recon.fit import constants
from recon.fit.clip_problem import ClipProblem, contacts, sigmas_above_ground
from recon.fit.least_squares import Estimate
from recon.fit.result import Finding, TrajectorySolution
from recon.fit.trajectory import solve_trajectory
from recon.geometry.camera import Camera
from recon.geometry.kinematics import ROOT

SHORTER_LOG_FACTORS = (-0.4, -0.6)
"""Logarithms of the two factors below 1 by which the focal length is multiplied in the test.

The second factor is tried if the first one fits better than the given focal length, or if the estimate's deviation
exceeds `POSSIBLE_SIGMAS`. Even shorter lenses would bring the animal closer than any camera stands.
"""
LONGER_LOG_FACTORS = (0.2, 0.4)
"""Logarithms of the two factors above 1 by which the focal length is multiplied, tried as `SHORTER_LOG_FACTORS` are."""
MEAN_LOG_FACTOR = -0.12
"""Mean over correct views of the logarithm of the estimated factor on the focal length."""
LOG_FACTOR_SIGMA = 0.15
"""Standard deviation over correct views of the logarithm of the estimated factor, not counting detection errors."""
POSSIBLE_SIGMAS = 0.65
"""Deviation of the estimate, in standard deviations, beyond which another focal length is reported as possible.

With the limit chosen on other runs, it is exceeded in 6 of 28 correct views, in 15 of 23 views with 1.5 times the focal
length, in 18 of 25 views with 0.7 times, and in 15 of 26 letterboxed views (`benchmarks/parts/one_step_limits.py
--views 1`).
"""
LIKELY_SIGMAS = 1.6
"""Deviation of the estimate, in standard deviations, beyond which another focal length is reported as likely.

The deviation is -0.5 to 0.9 in correct views, -1.3 to 0.2 in views with 1.5 times the focal length, and 0.7 to 1.6 with
0.7 times (`python benchmarks/wrong_inputs.py --only limits`, five views each). The limit is above the values of correct
views, because the deviation is larger in short clips and if the animal is partly hidden.
"""
MAX_LOG_EXTRAPOLATION = 0.2
"""Maximum distance of the logarithm of the estimate beyond the range of logarithms that were tried."""
INSIDE_90 = 0.5 * NORMAL_90**2
"""Increase of the cost from its minimum to the ends of the 90 % interval of the focal length."""
_UNKNOWN_SIGMA = 0.3
"""Standard deviation of the estimate's logarithm if the parabola has no minimum."""
WIDE_HFOV_DEG = 90.0
"""Horizontal field of view, in degrees, above which a lens without distortion is not taken for granted.

Lenses of cameras and phones that show straight edges straight are rarely wider. The wide modes of action cameras begin
at about 94 degrees.
"""
_TOLERANCE, _ITERATIONS = 1e-3, 12


@dataclass(frozen=True, eq=False)
class FocalTest:
    """Estimate of the focal length from a test of one second of a clip."""

    log_factor: float
    """Logarithm of the most likely focal length relative to the given one."""
    sigma: float
    """Standard deviation of `log_factor` due to the errors of the detections."""
    effects_m: dict[str, float]
    """Effects on poses and positions (`EFFECTS`) of another focal length that was tried.

    One or two focal lengths are tried on the side of the estimate. The effects are those of the one farther from the
    given focal length if it was tried and is within the 90 % interval, otherwise of the nearer one.
    """

    @property
    def deviation(self) -> float:
        """Return the deviation from the usual estimate, in standard deviations; negative for a shorter lens."""
        return (self.log_factor - MEAN_LOG_FACTOR) / math.hypot(LOG_FACTOR_SIGMA, self.sigma)


def focal_finding(baseline: Baseline, noise_px: Array) -> Finding | None:
    """Return a warning if another focal length is likely, a note if it is possible, and None otherwise.

    The effects of the warning or note widen the intervals of the verdict. `noise_px` is the fit's standard deviation of
    each detection, pixels, shape (T, J).
    """
    test = focal_test(baseline, noise_px)
    if test is None or abs(test.deviation) <= POSSIBLE_SIGMAS:
        return None
    stated_sigma = baseline.clip.options.focal_sigma or 0.0
    if abs(test.log_factor) < NORMAL_90 * stated_sigma:  # the intervals already contain this error
        return None
    factor = math.exp(test.log_factor - MEAN_LOG_FACTOR)
    item = finding("focal_length", None, None, factor=factor, sigmas=abs(test.deviation), **test.effects_m)
    return replace(item, severity="note") if abs(test.deviation) <= LIKELY_SIGMAS else item


def focal_test(baseline: Baseline, noise_px: Array) -> FocalTest | None:
    """Return an estimate of the focal length from the one second of the clip with the most detections.

    Return None if the camera moves, if the animal has no feet or one of them is rarely detected, or if this second has
    fewer than three frames or a frame without a pose. `noise_px` is the fit's standard deviation of each detection,
    pixels, shape (T, J).
    """
    rows = best_seen(baseline.view, baseline.clip.fps)
    clip, states = baseline.clip.part(rows), baseline.states[rows]
    if not baseline.view.is_still or len(states) < 3 or not np.isfinite(states).all():
        return None
    if not feet_are_detected(clip):
        return None
    refits = {0.0: _scene_refit(clip, baseline.settled(rows, noise_px))}
    for nearer, farther in (SHORTER_LOG_FACTORS, LONGER_LOG_FACTORS):
        refits[nearer] = _refit(clip, states, noise_px[None, rows], nearer)
        if refits[nearer].cost < refits[0.0].cost:
            refits[farther] = _refit(clip, states, noise_px[None, rows], farther)
    log_factor, sigma = _lowest({tried: refit.cost for tried, refit in refits.items()})
    test = FocalTest(log_factor, sigma, {})
    nearer, farther = SHORTER_LOG_FACTORS if log_factor < MEAN_LOG_FACTOR else LONGER_LOG_FACTORS
    if farther not in refits and abs(test.deviation) > POSSIBLE_SIGMAS:
        refits[farther] = _refit(clip, states, noise_px[None, rows], farther)
    highest = min(refit.cost for refit in refits.values()) + INSIDE_90
    end = farther if farther in refits and refits[farther].cost < highest else nearer
    return replace(test, effects_m=effects_m(*(clip.markers(refits[at].states) for at in (0.0, end))))


def assumed_lens_finding(
    clip: ClipProblem, solution: TrajectorySolution, settings: Mapping[str, Any]
) -> Finding | None:
    """Return a warning if a wide lens is assumed to be a pinhole without being stated, and None otherwise.

    The second of the clip with the most detections is solved again with an equidistant fisheye lens of the same field
    of view. The difference is the effect of the finding, which widens the intervals of the verdict. The effect is
    unknown if this second has fewer than three frames or a frame without a pose.

    Parameters
    ----------
    clip
        The problem of the clip.
    solution
        The solution with a pinhole camera.
    settings
        Settings of the fit, of which `hfov_deg` and `lens` are read.
    """
    hfov_deg = settings.get("hfov_deg")
    if hfov_deg is None or hfov_deg <= WIDE_HFOV_DEG or settings.get("lens") is not None:
        return None
    (view,) = clip.views
    rows = best_seen(view, clip.fps)
    effects: dict[str, Any] = {}
    states = clip.part(rows).nominal(solution.states[rows], solution.size)
    if len(states) >= 3 and np.isfinite(states).all():
        lens = Camera.from_hfov(hfov_deg, view.camera.image_size_px, model="fisheye")
        camera = replace(view.camera, matrix=lens.matrix, distortion=lens.distortion, model=lens.model)
        part = replace(clip.part(rows), views=(replace(view.part(rows), camera=camera),))
        distorted = solve_trajectory(
            part.views, part.body, part.prior, part.fps, part.options, ground_near_zero=part.ground_near_zero
        )
        if distorted.posed.all():
            other_states = part.nominal(distorted.states, distorted.size)
            effects = effects_m(part.markers(states), part.markers(other_states))
    return finding("lens_assumed", hfov_deg=hfov_deg, **effects)


@dataclass(frozen=True, eq=False)
class SceneRefit:
    """Solution of a part of a clip with another camera: states (T, D) at the animal's nominal size, and their cost."""

    cost: float
    """Cost of the solution, in which errors within the correlation time count only once."""
    states: Array


def _refit(clip: ClipProblem, states: Array, noise_px: Array, log_factor: float) -> SceneRefit:
    """Return the solution with the focal length multiplied by exp(log_factor), with new contacts and a new ground."""
    (view,) = clip.views
    scaled = replace(clip, views=(view.with_focal_scale(log_factor),))
    axis = view.T_camera_world.reshape(-1, 4, 4)[0, 2, :3]
    start = states.copy()  # relative to the camera's centre
    start[:, ROOT] += math.expm1(log_factor) * (start[:, ROOT] @ axis)[:, None] * axis
    return refit_scene(scaled, start, noise_px)


def refit_scene(clip: ClipProblem, start: Array, noise_px: Array) -> SceneRefit:
    """Return the best solution near the states `start` (T, D), with the contacts and the ground of these states."""
    *_, contact_terms = contacts(clip, clip.markers(start), 1.0)
    return _scene_refit(clip, clip.problem(noise_px, 1.0, contact_terms).minimise(start, _TOLERANCE, _ITERATIONS))


def _scene_refit(clip: ClipProblem, estimate: Estimate) -> SceneRefit:
    cost = estimate.cost / clip.correlation_frames + _ground_cost(clip, clip.markers(estimate.states))
    return SceneRefit(cost, estimate.states)


def _ground_cost(clip: ClipProblem, markers_m: Array) -> float:
    """Return the cost of a ground that slopes or, if it is known to be at z = 0, lies at another height."""
    if not (clip.finds_ground and clip.views[0].camera.knows_up):
        return 0.0
    _, ground, _ = contacts(clip, markers_m, 1.0)
    slope = 0.0 if ground is None else 0.5 * float(np.sum((ground.slope / constants.GROUND_SLOPE) ** 2))
    return slope + (0.5 * sigmas_above_ground(clip, markers_m) ** 2 if clip.ground_known else 0.0)


def _lowest(costs: Mapping[float, float]) -> tuple[float, float]:
    """Return where a parabola through the smallest cost and its neighbours has its minimum, and the standard deviation.

    The keys of `costs`, and the result, are logarithms of factors on the focal length.
    """
    values = sorted(costs)
    least = min(values, key=costs.__getitem__)
    middle = min(max(values.index(least), 1), len(values) - 2)
    x = np.array(values[middle - 1 : middle + 2])
    bend, slope, _ = np.polyfit(x, [costs[value] for value in x], 2)
    if bend <= 0:
        return least, _UNKNOWN_SIGMA
    lowest, highest = values[0] - MAX_LOG_EXTRAPOLATION, values[-1] + MAX_LOG_EXTRAPOLATION
    return float(np.clip(-0.5 * slope / bend, lowest, highest)), float((2 * bend) ** -0.5)
