"""Another frame rate than was given: what the file says of itself, and what the motion is like.

Played too slowly or too fast, an animal's angles do not swing as the motion prior knows it: poses stay as they are, but
speeds and accelerations change. The motion that was found is fitted again at other rates, from where it is.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from recon.animal.prior import ANGLES, NONE
from recon.base.arrays import Array
from recon.check.codes import finding
from recon.check.inputs.likelihood import believed
from recon.fit.clip_problem import ClipProblem
from recon.fit.least_squares import Estimate, LeastSquares
from recon.fit.posterior import prior_misfit_of
from recon.fit.result import Finding
from recon.fit.starts import APPROACH_HZ

OTHER_RATES = (0.25, 1 / 3, 0.5, 2.0, 3.0, 4.0)
"""Videos are slowed down, sped up and thinned by such factors."""
NEARLY = 1.02
"""Rates that differ by less are one."""
_TOLERANCE, _ITERATIONS = 1e-3, 10


def other_rate(clip: ClipProblem, states: Array, stated_hz: float | None) -> Finding | None:
    """states (T, D) at nominal size about the origin, without gaps, of a solved stretch. stated_hz: what the file
    says."""
    if stated_hz is not None and not 1 / NEARLY < stated_hz / clip.fps < NEARLY:
        return finding("frame_rate_stated", given_hz=clip.fps, other_hz=stated_hz)
    learned = clip.prior.name != NONE
    factors = [factor for factor in OTHER_RATES if learned and _swings_better(clip, states, factor)]
    if not factors:
        return None
    given = _cost(clip, states, 1.0)
    cost, factor = min((_cost(clip, states, factor), factor) for factor in factors)
    if not (believed(given - cost) and _known(clip, states, factor)):
        return None
    other_hz = clip.fps * factor
    return finding("frame_rate", given_hz=clip.fps, other_hz=other_hz, log_likelihood_ratio=given - cost)


def _swings_better(clip: ClipProblem, states: Array, factor: float) -> bool:
    """Whether the angles as they are could be likelier at another rate: at a lower one they accelerate less than the
    noise that is expected, at a higher one they follow the expected swing more closely."""
    given, other = (_unexplained(clip, states, clip.fps * by) for by in (1.0, factor))
    return other * min(factor, 1.0) ** 3 < given


def _unexplained(clip: ClipProblem, states: Array, fps: float) -> float:
    """What the motion prior does not expect of the angles' bends from frame to frame, squared."""
    prior, z = clip.prior, states[:, ANGLES]
    A = z.shape[1]
    if len(z) < 3:
        return 0.0
    bend, slope = z[2:] - 2 * z[1:-1] + z[:-2], 0.5 * (z[2:] - z[:-2])
    expected = (z[1:-1] - prior.mean) @ prior.drift[:, :A].T / fps**2 + slope @ prior.drift[:, A:].T / fps
    off = bend - expected
    return float(np.einsum("na,ab,nb->", off, np.linalg.inv(prior.acceleration_covariance), off))


def _cost(clip: ClipProblem, states: Array, factor: float) -> float:
    """Of the keypoints and of how the angles move, not of the poses, which are as likely at any rate."""
    step = max(1, round(clip.fps / APPROACH_HZ))
    problem, found = _at_rate(clip.thinned(step), states[::step], factor)
    costs = problem.costs(found.states)
    return costs["reprojection"] / clip.correlation_frames + costs.get("motion prior", 0.0)


def _known(clip: ClipProblem, states: Array, factor: float) -> bool:
    """Whether the prior knows the motion at that rate, or better than at the given one: one that is as much of a
    surprise there says nothing of the rate."""
    given, there = (prior_misfit_of(*_at_rate(clip, states, by), clip.fps * by) for by in (1.0, factor))
    return not there.unlike or there.level < given.level


def _at_rate(clip: ClipProblem, states: Array, factor: float) -> tuple[LeastSquares, Estimate]:
    """The minimum at another rate. With the noise that is expected: what a fit found depends on its rate."""
    noise_px = clip.noise_px(clip.markers(states), np.ones((len(clip.views), len(clip.body.markers))))
    problem = replace(clip, fps=clip.fps * factor).problem(noise_px)
    return problem, problem.minimise(states, _TOLERANCE, _ITERATIONS)
