"""Draws from the posterior: motions of whole clips as they may have been.

With H = L L' at the solution (`recon.fit.banded`), x = L^-T z of a white z is one draw, alike in neighbouring frames as
H says. What all frames share is drawn beside it, and the size, which the states follow.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from recon.base.arrays import Array, mean
from recon.fit.clip_problem import ClipProblem, contacts
from recon.fit.least_squares import Estimate
from recon.fit.posterior import about_keypoint_bias, curvature
from recon.fit.result import TrajectorySolution
from recon.fit.terms import SIDESLIP, SIZE, time_offset
from recon.geometry.kinematics import ROOT


def draws(clip: ClipProblem, solution: TrajectorySolution, count: int, seed: int = 0) -> list[TrajectorySolution]:
    """So many draws from the posterior, the problem being set up again at the solution: each a solution with states and
    joints of its own, and a size; all else is the solution's. Frames of segments that cannot be set up again, as one of
    their frames diverged, have no pose. Errors of the track of a single camera that moves are not drawn. The noise of
    the joints is the solution's, the mean of several segments; contacts follow from the solution."""
    rng = np.random.default_rng(seed)
    sizes = solution.size + solution.size_sigma * rng.normal(size=count)
    mean_noise_px = np.array([[mean(of_joint) for of_joint in noise_px.T] for noise_px in solution.noise_px])
    size = solution.size if clip.shows_size else 1.0
    stated = {time_offset(i): np.array([later]) for i, later in enumerate(solution.time_offset_frames)}
    stated |= {SIZE: np.array([size]), SIDESLIP: np.array([solution.sideslip_rad])}
    nominal, drawn = solution.states.copy(), np.full((count, *solution.states.shape), np.nan)
    nominal[:, ROOT] = (nominal[:, ROOT] - clip.origin_m) / solution.size
    for segment in solution.segments:
        part, states = replace(clip.part(segment.rows), prior_weight=segment.prior_weight), nominal[segment.rows]
        if not np.isfinite(states).all():
            continue
        points = part.markers(states)
        noise_px = part.noise_px(points, np.ones_like(mean_noise_px), size)
        noise_px *= (mean_noise_px / noise_px.mean(axis=1))[:, None]
        stand = clip.options.ground == "auto" and len(part.feet) > 0 and len(states) > 2
        problem = part.problem(noise_px, 1.0, contacts(part, points, size)[2] if stand else (), points, size)
        # refined cameras are in place
        shared = {name: (problem.expected() | stated)[name] for name in problem.columns}
        at, alike = Estimate(states, 0.0, 0, True, shared), clip.correlation_frames
        known = curvature(about_keypoint_bias(problem, at, alike), at, alike)
        white = rng.normal(size=(*states.shape, count))
        others = known.root @ rng.normal(size=(len(known.root), count))
        first = segment.rows.start
        for window, by_others, by_size in known.windows():
            rows, taken = window.rows, slice(window.rows.start, window.rows.start + len(window.white))
            steps = window.coloured(white[taken]) - by_others @ others
            steps = np.sqrt(clip.correlation_frames) * steps + by_size[..., None] * (sizes - solution.size)
            drawn[:, first + rows.start : first + rows.stop] = states[rows] + np.moveaxis(steps, 2, 0)
    return [_drawn(clip, solution, of_one, size) for of_one, size in zip(drawn, sizes.tolist(), strict=True)]


def _drawn(clip: ClipProblem, solution: TrajectorySolution, states: Array, size: float) -> TrajectorySolution:
    posed = np.isfinite(states).all(axis=1)
    joints_m, in_world = np.full(solution.joints_m.shape, np.nan), states.copy()
    joints_m[posed] = clip.in_world(clip.body.tree.pose(states[posed]).points_m, size)
    in_world[posed, ROOT] = clip.in_world(states[posed][:, ROOT], size)
    return replace(solution, states=in_world, joints_m=joints_m, size=size)
