"""Draw motions of whole clips from the posterior.

Let H = L L' be the curvature at the solution (`recon.fit.banded`). Then x = L^-T z is one draw if z is white noise.
Neighbouring frames of a draw are correlated as in H^-1. The shared unknowns and the size are drawn separately, and the
states change with them.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import fields, replace
from typing import Any

import numpy as np

from recon.animal.prior import load_prior
from recon.base.arrays import Array, mean
from recon.base.errors import InputError, Problem
from recon.clip import Source, views_of
from recon.fit.clip_problem import ClipProblem, TrajectoryOptions, contacts
from recon.fit.constants import focal_sigma_of
from recon.fit.least_squares import Estimate
from recon.fit.posterior import curvature, with_reestimated_noise
from recon.fit.result import TrajectorySolution
from recon.fit.terms import SIDESLIP, SIZE, offset_values
from recon.geometry.kinematics import ROOT


def draws(clip: ClipProblem, solution: TrajectorySolution, count: int, seed: int = 0) -> list[TrajectorySolution]:
    """Return motions drawn from the posterior, as solutions.

    Each draw has its own states, joints and size. Everything else, including the contacts, is copied from the solution.
    The problem is set up again at the solution, with each joint's mean noise over the segments. A segment has no pose
    if one of its frames diverged, because it cannot be set up again. Errors of the track of a single moving camera are
    not drawn.

    Parameters
    ----------
    clip
        The problem that was solved.
    solution
        Solution of the problem, around which motions are drawn.
    count
        Number of draws.
    seed
        Seed of the random numbers.
    """
    rng = np.random.default_rng(seed)
    sizes = solution.size + solution.size_sigma * rng.normal(size=count)
    mean_noise_px = np.array(
        [[mean(joint_noise_px) for joint_noise_px in noise_px.T] for noise_px in solution.noise_px]
    )
    size = solution.size if clip.shows_size else 1.0
    shared_values = offset_values(solution.time_offset_frames)
    shared_values |= {SIZE: np.array([size]), SIDESLIP: np.array([solution.sideslip_rad])}
    nominal, drawn = clip.nominal(solution.states, solution.size), np.full((count, *solution.states.shape), np.nan)
    for segment in solution.segments:
        segment_clip = replace(clip.part(segment.rows), prior_weight=segment.prior_weight)
        states = nominal[segment.rows]
        if not np.isfinite(states).all():
            continue
        points = segment_clip.markers(states)
        noise_px = segment_clip.noise_px(points, np.ones_like(mean_noise_px), size)
        noise_px *= (mean_noise_px / noise_px.mean(axis=1))[:, None]
        problem = segment_clip.problem(noise_px, 1.0, contacts(segment_clip, points, size)[2], points, size)
        # the views already contain the refined cameras, so those unknowns are left out
        shared = {name: (problem.expected() | shared_values)[name] for name in problem.columns}
        estimate, variance_factor = Estimate(states, 0.0, 0, True, shared), clip.correlation_frames
        problem_curvature = curvature(
            with_reestimated_noise(problem, estimate, variance_factor), estimate, variance_factor
        )
        white = rng.normal(size=(*states.shape, count))
        common_steps = problem_curvature.covariance_root @ rng.normal(
            size=(len(problem_curvature.covariance_root), count)
        )
        first = segment.rows.start
        for window, by_others, by_size in problem_curvature.windows():
            rows = window.rows
            steps = window.unwhiten(white[window.rows_with_following]) - by_others @ common_steps
            steps = np.sqrt(clip.correlation_frames) * steps + by_size[..., None] * (sizes - solution.size)
            drawn[:, first + rows.start : first + rows.stop] = states[rows] + np.moveaxis(steps, 2, 0)
    return [_draw(clip, solution, drawn_states, size) for drawn_states, size in zip(drawn, sizes.tolist(), strict=True)]


def sample_joints(
    sources: Sequence[Source],
    solution: TrajectorySolution,
    fps: float,
    settings: Mapping[str, Any],
    count: int,
    seed: int = 0,
) -> Array:
    """Return draws of the joints from the posterior, shape (count, T, J, 3), metres; NaN without a pose.

    Parameters
    ----------
    sources
        Keypoints and camera of each view, as in the fit.
    solution
        Solution of the fit to the sources.
    fps
        Frames per second.
    settings
        Settings of the fit as a dictionary keyed by their names, from which the problem is set up again.
    count, seed
        Number of draws, and the seed of the random numbers.

    Raises
    ------
    InputError
        If the fit's prior cannot be loaded by its name.
    """
    prior = load_prior(settings.get("prior"), solution.body)
    if prior.name != solution.prior:
        expected = f"{solution.prior}, the prior of the fit; otherwise fit again with a built-in prior"
        raise InputError(Problem("sample", "prior", prior.name, expected))
    values: dict[str, Any] = {
        f.name: settings[f.name] for f in fields(TrajectoryOptions) if settings.get(f.name) is not None
    }
    values["focal_sigma"] = focal_sigma_of(settings, len(sources))
    options = TrajectoryOptions(**values)
    clip = ClipProblem.from_views(views_of(sources), solution.body, prior, fps, options)
    return np.stack([draw.joints_m for draw in draws(clip, solution, count, seed)])


def _draw(clip: ClipProblem, solution: TrajectorySolution, states: Array, size: float) -> TrajectorySolution:
    posed = np.isfinite(states).all(axis=1)
    joints_m, in_world = np.full(solution.joints_m.shape, np.nan), states.copy()
    joints_m[posed] = clip.in_world(clip.body.tree.pose(states[posed]).points_m, size)
    in_world[posed, ROOT] = clip.in_world(states[posed][:, ROOT], size)
    return replace(solution, states=in_world, joints_m=joints_m, size=size)
