"""Another frame rate than was given: what the file says of itself, and what the motion is like.

Played too slowly or too fast, an animal's angles do not swing as the motion prior knows it: poses stay as they are, but
speeds and accelerations change. The motion that was found is fitted again at other rates, from where it is.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from recon.arrays import Array
from recon.mistakes.mistake import CLEAR, Mistake
from recon.prior import ANGLES, NONE
from recon.solve.setting import Setting
from recon.solve.starts import APPROACH_HZ
from recon.solve.surprise import surprise_of

OTHER_RATES = (0.25, 1 / 3, 0.5, 2.0, 3.0, 4.0)
"""Videos are slowed down, sped up and thinned by such factors."""
NEARLY = 1.02
"""Rates that differ by less are one."""
_TOLERANCE, _ITERATIONS = 1e-3, 10


def other_rate(setting: Setting, states: Array, noise_px: Array, stated_hz: float | None) -> Mistake | None:
    """states (T, D) at nominal size about the origin, without gaps, and noise_px (V, T, J), of a solved stretch.
    stated_hz: what the file says."""
    if stated_hz is not None and not 1 / NEARLY < stated_hz / setting.fps < NEARLY:
        return Mistake("frame_rate", np.nan, found=stated_hz)
    learned = setting.prior.name != NONE
    factors = [factor for factor in OTHER_RATES if learned and _swings_better(setting, states, factor)]
    if not factors:
        return None
    given, surprise = _at_rate(setting, states, noise_px, 1.0)
    tried = {factor: _at_rate(setting, states, noise_px, factor) for factor in factors}
    factor, (cost, there) = min(tried.items(), key=lambda one: one[1][0])
    # A motion that is as much of a surprise there is one that the prior knows at no rate.
    clear = given - cost > CLEAR and there < surprise
    return Mistake("frame_rate", given - cost, found=setting.fps * factor) if clear else None


def _swings_better(setting: Setting, states: Array, factor: float) -> bool:
    """Whether the angles as they are could be likelier at another rate: at a lower one they accelerate less than the
    noise that is expected, at a higher one they follow the expected swing more closely."""
    given, other = (_unexplained(setting, states, setting.fps * by) for by in (1.0, factor))
    return other * min(factor, 1.0) ** 3 < given


def _unexplained(setting: Setting, states: Array, fps: float) -> float:
    """What the motion prior does not expect of the angles' bends from frame to frame, squared."""
    prior, z = setting.prior, states[:, ANGLES]
    A = z.shape[1]
    if len(z) < 3:
        return 0.0
    bend, slope = z[2:] - 2 * z[1:-1] + z[:-2], 0.5 * (z[2:] - z[:-2])
    expected = (z[1:-1] - prior.mean) @ prior.drift[:, :A].T / fps**2 + slope @ prior.drift[:, A:].T / fps
    off = bend - expected
    return float(np.einsum("na,ab,nb->", off, np.linalg.inv(prior.acceleration_covariance), off))


def _at_rate(setting: Setting, states: Array, noise_px: Array, factor: float) -> tuple[float, float]:
    """The cost of the keypoints and of how the angles move, not of the poses, which are as likely at any rate; and how
    surprising poses and motion are there."""
    step = max(1, round(setting.fps / APPROACH_HZ))
    thin = setting.thinned(step)
    thin = replace(thin, fps=thin.fps * factor)
    problem = thin.problem(noise_px[:, ::step])
    found = problem.minimise(states[::step], _TOLERANCE, _ITERATIONS)
    of_terms = problem.costs(found.states)
    cost = of_terms["reprojection"] / setting.alike + of_terms.get("motion prior", 0.0)
    return cost, surprise_of(problem, found, thin.fps).level
