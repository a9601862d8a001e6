"""Where a clip's solution starts from: straight runs of the mean pose, and the way in from the best of them."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from recon.animal.chain import MIN_JOINTS
from recon.animal.prior import ANGLES
from recon.base.arrays import Array, Index
from recon.fit.clip_problem import UP, ClipProblem
from recon.fit.constant_velocity import constant_velocity, run_path
from recon.fit.least_squares import Estimate
from recon.geometry.kinematics import ROOT, YAW

APPROACH_HZ = 30.0
"""Frames a second that are enough on the way in."""
_HEADINGS = 18
_APART_RAD = 0.5
"""Starts nearer to each other than this are one."""
_WIDE = (8.0, 4.0, 2.0, 1.0)
"""Factors on the noise on the way in."""
_MIN_RAYS = 2
"""A row of rays places a shape from so many on."""


@dataclass(frozen=True, eq=False)
class Approached:
    """A start after the approach, best known at the frames of the clip."""

    heading_rad: float
    """About the world's z axis, from the right of the first camera's picture."""
    first_cost: float
    """Of the widest fit, by which the starts are chosen."""
    estimate: Estimate
    finished: bool = False
    """It was carried to the end."""


def approach(clip: ClipProblem) -> list[Approached]:
    """The starts of one window, approached with noise that narrows: best first, only the first ones to the end."""
    fast, ones = clip.options.fast, np.ones((len(clip.views), len(clip.body.markers)))
    step = max(1, round(clip.fps / APPROACH_HZ))
    thin, every = clip.thinned(step), np.arange(0, len(clip), step)

    def minimum(states: Array, widen: float, tolerance: float, iterations: int) -> Estimate:
        noise = thin.noise_px(thin.markers(states), ones) * widen
        return thin.problem(noise).minimise(states, tolerance, iterations)

    tried = []
    for heading_rad, states in _starts(clip):
        estimate = minimum(states[every], _WIDE[0], 1e-2, 12)
        tried.append(Approached(heading_rad, estimate.cost, estimate))
    tried.sort(key=lambda a: a.first_cost)
    for i, start in enumerate(tried[: 1 if fast else 2]):
        estimate = start.estimate
        for widen in _WIDE[1:]:
            estimate = minimum(estimate.states, widen, 3e-3 if fast else 1e-3, 15)
        full = replace(estimate, states=between(estimate.states, every, len(clip)))
        tried[i] = replace(start, estimate=full, finished=True)
    return sorted(tried, key=lambda a: (not a.finished, a.estimate.cost))


def between(states: Array, at: Index, T: int) -> Array:
    """States (T, D) through those (n, D) at some frames (n,), along straight lines between them."""
    states = states.copy()
    states[:, YAW] = np.unwrap(states[:, YAW])
    return np.stack([np.interp(np.arange(T), at, column) for column in states.T], axis=1)


def _starts(clip: ClipProblem) -> list[tuple[float, Array]]:
    """(heading, states) of the best runs, and for one camera of the best one's mirror image in depth."""
    misfit, headings_rad, states = _runs(clip)
    best = int(np.argmin(misfit))
    dips = [i for i in range(len(misfit)) if misfit[i] <= misfit[i - 1] and misfit[i] <= misfit[(i + 1) % len(misfit)]]
    order = sorted(dips, key=lambda i: misfit[i])[: 2 if clip.options.fast else 3]
    chosen: list[int] = []
    for i in [*order, -best % len(misfit)] if len(clip.views) == 1 else order:
        apart = [abs(np.angle(np.exp(1j * (headings_rad[i] - headings_rad[j])))) for j in chosen]
        if all(a > _APART_RAD for a in apart):
            chosen.append(i)
    return [(float(headings_rad[i]), states[i]) for i in chosen]


def _runs(clip: ClipProblem) -> tuple[Array, Array, Array]:
    """Misfits (H,) and states (H, T, D) of the mean pose on a straight run, for headings (H,) around the clock."""
    T, count = len(clip), _HEADINGS // 2 if clip.options.fast else _HEADINGS
    rays, centres, frames = _rays(clip)
    time_s, middle = np.arange(T) / clip.fps, frames.mean() / clip.fps
    headings_rad = 2 * np.pi * np.arange(count) / count
    yaw_rad = headings_rad + np.arctan2(clip.right[1], clip.right[0])
    turned = np.zeros((count, clip.body.n_state))
    turned[:, YAW], turned[:, ANGLES] = yaw_rad, clip.prior.mean
    headings = np.stack([np.cos(yaw_rad), np.sin(yaw_rad), np.zeros(count)], axis=1)
    shapes = clip.markers(turned)
    misfits, runs = constant_velocity(headings, shapes, UP, rays, frames / clip.fps - middle, centres)
    states = np.repeat(turned[:, None], T, axis=1)
    for heading, run, of_run in zip(headings, runs, states, strict=True):
        of_run[:, ROOT] = run_path(heading, UP, time_s - middle) @ run
    return misfits, headings_rad, states


def _rays(clip: ClipProblem) -> tuple[Array, Array, Array]:
    """Rays (F, J, 3), the centres (F, 3) that they come from, about the origin, and their frames (F,), of all views."""
    rays, centres, frames = [], [], []
    counts = [view.present.sum(axis=1) for view in clip.views]
    enough = MIN_JOINTS if max(count.max() for count in counts) >= MIN_JOINTS else _MIN_RAYS
    for view, count in zip(clip.views, counts, strict=True):
        usable = np.flatnonzero(count >= enough)
        some = usable[:: max(1, min(3, len(usable) // 6))]
        rays.append(view.part(some).rays())
        centres.append(view.centre_m[some] - clip.origin_m)
        frames.append(some)
    return np.concatenate(rays), np.concatenate(centres), np.concatenate(frames)
