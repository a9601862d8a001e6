"""How likely what a camera saw is, under what is expected of an animal and its motion, as it was given or otherwise.

A hypothesis is a `ClipProblem`: other keypoints, or another camera. A second of the clip is solved anew under it, and
compared with the same second solved as it was given. That takes as long as a fit: whoever asks has a cheap reason.

A detector's errors last, and keypoints of one limb err together. An error that stays is hardly surprising, one that
jumps is (`unlikely`): where sides are exchanged, the motion or the errors of all of a limb's keypoints jump at once.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from recon.animal.prior import ANGLES
from recon.base.arrays import Array, Bools, Integers
from recon.clip import View
from recon.clip.keypoints import frame_ranges
from recon.fit import solve_trajectory
from recon.fit.clip_problem import ClipProblem, above_ground
from recon.fit.starts import APPROACH_HZ, between
from recon.geometry.kinematics import ROOT, YAW

_TOLERANCE, _ITERATIONS = 3e-3, 12
"""When a minimum is good enough."""
CLEAR = float(np.log(1000.0))
"""A hypothesis is worth a closer look, or believed where nothing is like it, if it makes what was seen so many times as
likely, as a logarithm."""
MARGIN, SURE = 25.0, 30.0
"""A swap, or a zoom, is believed where it makes a solution so much likelier, as a logarithm; by the second where
another in its place contradicts it, and for the whole clip with all swaps undone, as another frame rate is. Far more
than chance needs: what a model of the animal gets wrong is not noise. Chosen on real clips (docs/benchmarks.md,
left-right swaps)."""
TOGETHER = 0.4
"""Keypoints of one limb err together: so much of what they say is each one's own. Chosen on real clips, by leaving runs
out (docs/benchmarks.md, mistakes)."""
TAILS = 3.0
"""Degrees of freedom of Student's distribution, which errors have."""
AT_ONCE_S = 1.0
"""So much of a clip is judged at once."""
LOOSE = 2.0
"""Factor on the noise of a fit that does not know which side is which."""


def believed(ratio: float, surely: bool = False) -> bool:
    """Whether a hypothesis is, by how much likelier it is, as a logarithm: see `MARGIN`."""
    return ratio > (SURE if surely else MARGIN)


def alone(clip: ClipProblem, view: View) -> ClipProblem:
    """The motion by one camera's view alone, by the fast search."""
    origin_m = np.mean(view.centre_m, axis=0)
    return replace(clip, views=(view,), origin_m=origin_m, options=replace(clip.options, fast=True))


@dataclass(frozen=True, eq=False)
class Refit:
    """The solution of a part of a clip, as it is or otherwise: states (n, D) at nominal size about the origin, and
    minus the logarithm of the likelihood but for a constant, if errors of neighbouring frames are alike and if each
    frame has its own."""

    states: Array
    alike: float
    own: float

    @classmethod
    def of(cls, clip: ClipProblem, states: Array) -> Refit:
        """Infinite where a frame has no states."""
        if not np.isfinite(states).all():
            return cls(states, np.inf, np.inf)
        noise_px = clip.noise_px(clip.markers(states), np.ones((1, len(clip.body.markers))))
        costs = clip.problem(noise_px, 1.0).costs(states)
        ground, pixels, own = off_ground(clip, states), costs["reprojection"], sum(costs.values())
        return cls(states, _seen(clip, states) + ground + own - pixels, own)

    def likelier(self, other: Refit) -> float:
        """Than another by so much, whichever the errors are."""
        if not np.isfinite(self.own):
            return -np.inf
        return min(other.alike - self.alike, other.own - self.own)


def refitted(clip: ClipProblem) -> Refit:
    """The motion by one camera's view, solved as a clip of its own."""
    options = replace(clip.options, fast=False)
    solution = solve_trajectory(
        clip.views, clip.body, clip.prior, clip.fps, options, ground_near_zero=clip.ground_near_zero
    )
    solved = baseline_of(replace(clip, views=solution.views), 0, solution.states, solution.size)
    return Refit.of(solved.clip, solved.states)


def _seen(clip: ClipProblem, states: Array) -> float:
    """What one view sees of keypoints around a motion (T, D)."""
    (view,), markers = clip.views, clip.markers(states)
    (sigma_px,) = clip.noise_px(markers, np.ones((1, markers.shape[1])))
    projected, _ = view.project(view.at_its_time(clip.in_world(markers)))
    return unlikely(view, projected, sigma_px, clip.correlation_frames)


def unlikely(view: View, projected: Array, sigma_px: Array, correlation_frames: float) -> float:
    """Minus the logarithm of the density in pixels of a view's keypoints around where a motion has them (T, J, 2), with
    noise (T, J), but for a constant.

    Of each error a part is the one before, so that alike neighbouring frames count once, and the rest is its own. The
    noise's size, which only follows the distance, counts once in that time.
    """
    off, kept = (projected - view.xy_px) / sigma_px[..., None], (correlation_frames - 1) / (correlation_frames + 1)
    own = off.copy()
    own[1:] = np.where(np.isfinite(off[:-1]), (off[1:] - kept * off[:-1]) / np.sqrt(1 - kept**2), off[1:])
    weight = np.where(view.present, view.confidence, 0.0)
    spread = 2.0 * float(np.sum(np.log(sigma_px) * weight)) / correlation_frames
    return TOGETHER * float(np.sum(log_tail(own) * weight)) + spread


def log_tail(off: Array) -> Array:
    """(T, J): minus the logarithm of the density of errors (T, J, 2), in standard deviations, but for a constant; 0
    where a point is missing."""
    return (TAILS + 2) / 2 * np.log1p(np.nan_to_num(np.sum(off**2, axis=-1)) / TAILS)


@dataclass(frozen=True, eq=False)
class Baseline:
    """A view of a clip as it is, alone, and the states (T, D) that were found for it, at nominal size about its origin;
    NaN where there are none."""

    clip: ClipProblem
    states: Array
    own: bool = True
    """Whether nothing but this view led to the states."""

    @property
    def view(self) -> View:
        return self.clip.views[0]

    def other(self, view: View) -> ClipProblem:
        """With another view in its place."""
        return alone(self.clip, view)

    def refit(self, part: slice) -> Refit:
        """The fit of a part of the clip as it is: for all of it, what was found, unless other cameras had a say."""
        if self.own and part.stop - part.start == len(self.states):
            return Refit.of(self.clip, self.states)
        return refitted(self.clip.part(part))


def _mean_pose(clip: ClipProblem, found: Array) -> Array:
    """States (n, D) of the mean pose where the animal was found."""
    start = np.zeros_like(found)
    start[:, ANGLES], start[:, ROOT], start[:, YAW] = clip.prior.mean, found[:, ROOT], found[:, YAW]
    return start


def either_side(given: Baseline, other: View, which: Bools) -> tuple[Array, Array]:
    """Where a fit to both views of a clip, half each, has the keypoints in the picture, (T, J, 2), and their noise
    (T, J): NaN in frames without states. which (J,): the markers that the views have on different sides."""
    clip, posed = given.clip, np.flatnonzero(np.isfinite(given.states[:, 0]))
    shares = (np.where(which, 0.5, 1.0), np.where(which, 0.5, 0.0))
    views = [replace(v, confidence=v.confidence * of) for v, of in zip((given.view, other), shares, strict=True)]
    projected, sigma_px = np.full(other.xy_px.shape, np.nan), np.full(other.confidence.shape, np.nan)
    for rows in (slice(first, stop) for first, stop in frame_ranges(posed)):
        part = replace(clip, views=tuple(view.part(rows) for view in views))
        step = max(1, round(clip.fps / APPROACH_HZ))
        every, ones = np.arange(0, len(part), step), np.ones((2, len(which)))
        thin = part.thinned(step)
        states = _mean_pose(clip, given.states[rows])[every]
        problem = thin.problem(LOOSE * thin.noise_px(thin.markers(states), ones))
        states = problem.minimise(states, _TOLERANCE, _ITERATIONS).states
        markers = part.markers(between(states, every, len(part)))
        sigma_px[rows] = LOOSE * part.noise_px(markers, ones)[0]
        projected[rows], _ = part.views[0].project(part.views[0].at_its_time(part.in_world(markers)))
    return projected, sigma_px


def baseline_of(clip: ClipProblem, number: int, states: Array, size: float) -> Baseline:
    """What one view of a clip is compared with. states (T, D) have the root in the world."""
    own = alone(clip, clip.views[number])
    found = states.copy()
    found[:, ROOT] = (states[:, ROOT] - own.origin_m) / size
    return Baseline(own, found, len(clip.views) == 1)


def off_ground(clip: ClipProblem, states: Array) -> float:
    """Where the ground's height is known: of feet that are off it all the time."""
    if not clip.ground_known or not len(clip.feet):
        return 0.0
    return 0.5 * above_ground(clip, clip.markers(states)) ** 2


def best_seen(view: View, fps: float) -> slice:
    """The stretch of `AT_ONCE_S`, or less, in which most is seen."""
    counts = view.present.sum(axis=1)
    part = busiest(counts, round(AT_ONCE_S * fps))
    seen = part.start + np.flatnonzero(counts[part])
    return slice(int(seen[0]), int(seen[-1]) + 1) if len(seen) else slice(0, 0)


def busiest(counts: Integers, n: int) -> slice:
    """The stretch of so many rows, at most, in which the sum is largest."""
    n, total = min(n, len(counts)), np.concatenate([[0], np.cumsum(counts)])
    first = int(np.argmax(total[n:] - total[: len(total) - n]))
    return slice(first, first + n)
