"""Motions as they may have been: draws from the posterior of a fit, of whole clips.

The fit's last problem is set up again at its solution (`at_solution`). There the posterior of a segment's unknowns is
taken as a Gaussian, as the stated uncertainties are (`recon.fit.posterior`): with the factor H = L L' of the normal
equations, x = L^-T z of a white z is one draw, alike in neighbouring frames as H says. Unknowns of all frames are drawn
beside it, and the size, which the states follow.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from recon.base.arrays import Array, mean
from recon.fit.clip_problem import ClipProblem, contacts
from recon.fit.least_squares import Estimate, LeastSquares
from recon.fit.posterior import curvature
from recon.fit.result import MotionSegment, TrajectorySolution
from recon.fit.terms import SIDESLIP, SIZE, time_offset
from recon.geometry.kinematics import ROOT


def at_solution(
    clip: ClipProblem, solution: TrajectorySolution
) -> Iterator[tuple[MotionSegment, LeastSquares, Estimate]]:
    """Every segment with what it was solved for, and its solution: states (T, D) about the clip's origin and at nominal
    size, and the unknowns that its frames share. The noise of the joints is the solution's, the mean of several
    segments; contacts follow from the solution. A segment with a frame that diverged is left out."""
    mean_noise_px = np.array([[mean(of_joint) for of_joint in noise_px.T] for noise_px in solution.noise_px])
    size = solution.size if clip.shows_size else 1.0
    stated = {time_offset(i): np.array([later]) for i, later in enumerate(solution.time_offset_frames)}
    stated |= {SIZE: np.array([size]), SIDESLIP: np.array([solution.sideslip_rad])}
    states = solution.states.copy()
    states[:, ROOT] = (states[:, ROOT] - clip.origin_m) / solution.size
    for segment in solution.segments:
        part, found = replace(clip.part(segment.rows), prior_weight=segment.prior_weight), states[segment.rows]
        if not np.isfinite(found).all():
            continue
        points = part.markers(found)
        noise_px = part.noise_px(points, np.ones_like(mean_noise_px), size)
        noise_px *= (mean_noise_px / noise_px.mean(axis=1))[:, None]
        stand = clip.options.ground == "auto" and len(part.feet) > 0 and len(found) > 2
        problem = part.problem(noise_px, 1.0, contacts(part, points, size)[2] if stand else (), points, size)
        # refined cameras are in place
        shared = {name: (problem.expected() | stated)[name] for name in problem.columns}
        yield segment, problem, Estimate(found, 0.0, 0, True, shared)


def draws(clip: ClipProblem, solution: TrajectorySolution, count: int, seed: int = 0) -> list[TrajectorySolution]:
    """So many solutions, each with states and joints of its own, and a size; all else is the solution's. Frames of
    segments that cannot be set up again have no pose. Of one camera that moves, errors of its track are not drawn."""
    rng = np.random.default_rng(seed)
    sizes = solution.size + solution.size_sigma * rng.normal(size=count)
    states = np.full((count, *solution.states.shape), np.nan)
    for segment, problem, found in at_solution(clip, solution):
        known = curvature(problem, found, clip.correlation_frames)
        white = rng.normal(size=(*found.states.shape, count))
        others = known.root @ rng.normal(size=(len(known.root), count))
        first = segment.rows.start
        for window, by_others, by_size in known.windows():
            rows, taken = window.rows, slice(window.rows.start, window.rows.start + len(window.white))
            steps = window.coloured(white[taken]) - by_others @ others
            steps = np.sqrt(clip.correlation_frames) * steps + by_size[..., None] * (sizes - solution.size)
            states[:, first + rows.start : first + rows.stop] = found.states[rows] + np.moveaxis(steps, 2, 0)
    return [_drawn(clip, solution, of_one, size) for of_one, size in zip(states, sizes.tolist(), strict=True)]


def _drawn(clip: ClipProblem, solution: TrajectorySolution, states: Array, size: float) -> TrajectorySolution:
    posed = np.isfinite(states).all(axis=1)
    joints_m, in_world = np.full(solution.joints_m.shape, np.nan), states.copy()
    joints_m[posed] = clip.in_world(clip.body.tree.pose(states[posed]).points_m, size)
    in_world[posed, ROOT] = clip.in_world(states[posed][:, ROOT], size)
    return replace(solution, states=in_world, joints_m=joints_m, size=size)
