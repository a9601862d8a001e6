"""How likely what a camera saw is, under what is expected of an animal and its motion, as it was given or otherwise.

A hypothesis is a `ClipProblem`: other keypoints, or another camera. A second of the clip is solved anew under it, and
compared with the same second as it was given. That takes as long as a fit: whoever asks has a cheap reason. A
detector's errors last, and keypoints of one limb err together: an error that stays is hardly surprising, one that jumps
is (`unlikely`).

The hypotheses here are another picture than the camera's (keypoints of 0 to 1, turned over, of a smaller video, of one
without the lens), a picture that zooms, and another frame rate, at which angles do not swing as the prior knows; swaps
are in `swaps`."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import cache
from typing import Any

import numpy as np

from recon.animal.prior import ANGLES, NONE, mean_speed_m_s
from recon.base.arrays import Array, Bools, mean_along
from recon.check.codes import finding
from recon.clip import View, densest_window, frame_ranges
from recon.fit import (
    APPROACH_HZ,
    Estimate,
    Finding,
    LeastSquares,
    TrajectorySolution,
    interpolate_states,
    prior_misfit_of,
    solve_trajectory,
)
from recon.fit.clip_problem import ClipProblem, contacts, sigmas_above_ground
from recon.fit.terms import MOTION
from recon.geometry import ROOT, Camera

_TOLERANCE, _ITERATIONS = 3e-3, 12
"""When a minimum is good enough."""
CLEAR = float(np.log(1000.0))
"""A hypothesis is worth a closer look if it makes what was seen so many times as likely, as a logarithm."""
MARGIN, SURE = 25.0, 30.0
"""A swap, or a zoom, is believed where it makes a solution so much likelier, as a logarithm; by the second where
another in its place contradicts it, and for the whole clip with all swaps undone, as another frame rate is. Chosen on
real clips (docs/benchmarks.md, left-right swaps): what a model of the animal gets wrong is not noise."""
TOGETHER = 0.4
"""So much of what keypoints of one limb say is each one's own. Chosen on real clips (docs/benchmarks.md, mistakes)."""
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
    """The solution of a part of a clip: states (n, D) at nominal size about the origin, and minus the logarithm of the
    likelihood, if errors of neighbouring frames are alike and if each frame has its own."""

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
        pixels, own, ground = costs["reprojection"], sum(costs.values()), 0.0
        if clip.ground_known and len(clip.feet):  # of feet that are off it all the time
            ground = 0.5 * sigmas_above_ground(clip, clip.markers(states)) ** 2
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
    projected, _ = view.project(view.shift_to_exposure(clip.in_world(markers)))
    return unlikely(view, projected, sigma_px, clip.correlation_frames)


def unlikely(view: View, projected: Array, sigma_px: Array, correlation_frames: float) -> float:
    """Minus the logarithm of the density of a view's keypoints around where a motion has them (T, J, 2), with noise
    (T, J), but for a constant. Of each error a part is the one before, so that alike neighbouring frames count once, as
    the noise's size does."""
    off, kept = (projected - view.xy_px) / sigma_px[..., None], (correlation_frames - 1) / (correlation_frames + 1)
    own = off.copy()
    own[1:] = np.where(np.isfinite(off[:-1]), (off[1:] - kept * off[:-1]) / np.sqrt(1 - kept**2), off[1:])
    weight = np.where(view.present, view.confidence, 0.0)
    spread = 2.0 * float(np.sum(np.log(sigma_px) * weight)) / correlation_frames
    return TOGETHER * float(np.sum(log_tail(own) * weight)) + spread


def log_tail(off: Array) -> Array:
    """(T, J): the same of errors (T, J, 2) in standard deviations; 0 where a point is missing."""
    return (TAILS + 2) / 2 * np.log1p(np.nan_to_num(np.sum(off**2, axis=-1)) / TAILS)


@dataclass(frozen=True, eq=False)
class Baseline:
    """A view of a clip as it is, alone, and the states (T, D) that were found for it, at nominal size about its
    origin."""

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
        states = given.states[rows][every]  # of the mean pose, where the animal was found
        states[:, ANGLES] = clip.prior.mean
        problem = thin.problem(LOOSE * thin.noise_px(thin.markers(states), ones))
        states = problem.minimise(states, _TOLERANCE, _ITERATIONS).states
        markers = part.markers(interpolate_states(states, every, len(part)))
        sigma_px[rows] = LOOSE * part.noise_px(markers, ones)[0]
        projected[rows], _ = part.views[0].project(part.views[0].shift_to_exposure(part.in_world(markers)))
    return projected, sigma_px


def baseline_of(clip: ClipProblem, number: int, states: Array, size: float) -> Baseline:
    """What one view of a clip is compared with. states (T, D) have the root in the world."""
    own = alone(clip, clip.views[number])
    found = states.copy()
    found[:, ROOT] = (states[:, ROOT] - own.origin_m) / size
    return Baseline(own, found, len(clip.views) == 1)


def best_seen(view: View, fps: float) -> slice:
    """The stretch of `AT_ONCE_S`, or less, in which most is seen."""
    counts = view.present.sum(axis=1)
    part = densest_window(counts, round(AT_ONCE_S * fps))
    seen = part.start + np.flatnonzero(counts[part])
    return slice(int(seen[0]), int(seen[-1]) + 1) if len(seen) else slice(0, 0)


# -- the picture -------------------------------------------------------------------------------------------------------

SMALLER = (2, 3, 4)
"""A video may be so many times smaller than the camera's calibration says."""
LEANING = 0.7
"""Feet that are less far below the trunk, as a part of how far they are from it, are sought elsewhere: 0.83 or more in
32 real views."""
NEARLY_ALL = 99.0
"""Percentile of the points that have to lie in a part of the picture."""

_Other = tuple[str, dict[str, Any], View]
"""What the view of a clip may be: the finding's code and numbers, and the view that the camera has then."""


def of_unit_square(given: Baseline) -> Finding | None:
    """Keypoints as parts of the picture's width and height: all lie in its corner."""
    view = given.view
    points = view.xy_px[view.present]
    if not len(points) or np.percentile(np.abs(points - 0.5), NEARLY_ALL) > 1.0:
        return None
    width, height = view.camera.image_size_px
    frames = float(view.present.any(axis=1).sum())
    ratio = float(np.log(width * height / 4.0)) * max(frames / given.clip.correlation_frames, 1.0)
    return finding("keypoints_normalised", camera=view.camera.name, log_likelihood_ratio=ratio)


def of_other_picture(given: Baseline) -> Finding | None:
    """A picture that is turned or has y up, or a world whose z is not up, looked for where the feet are not below the
    trunk; or a smaller video, where all lies in the part that it would fill."""
    view, part = given.view, best_seen(given.view, given.clip.fps)
    others = [*_turned(view), *_smaller(view)] if _feet_below(given.clip, view) < LEANING else [*_smaller(view)]
    if not others:
        return None
    as_given = given.refit(part)
    ratios = [refitted(given.other(other).part(part)).likelier(as_given) for _, _, other in others]
    best = int(np.argmax(ratios))
    if not ratios[best] > CLEAR:
        return None
    code, numbers, _ = others[best]
    return finding(code, camera=view.camera.name, log_likelihood_ratio=ratios[best], **numbers)


def _turned(view: View) -> Iterator[_Other]:
    (width, height), (x, y) = view.camera.image_size_px, np.moveaxis(view.xy_px, -1, 0)
    pictures: list[tuple[str, dict[str, Any], tuple[Array, Array]]] = [
        ("picture_upside_down", {}, (width - 1 - x, height - 1 - y)),
        ("keypoints_y_up", {}, (x, height - 1 - y)),
        ("picture_turned", {"degrees": 90}, (y, height - 1 - x)),
        ("picture_turned", {"degrees": 270}, (width - 1 - y, x)),
    ]
    for code, numbers, xy_px in pictures:
        yield code, numbers, replace(view, xy_px=np.stack(xy_px, axis=-1))
    for axis, sign in (("y", 1.0), ("-y", -1.0)):
        up = np.array([[1, 0, 0, 0], [0, 0, -sign, 0], [0, sign, 0, 0], [0, 0, 0, 1.0]])
        yield "world_not_z_up", {"axis": axis}, replace(view, T_camera_world=view.T_camera_world @ up.T)


def _smaller(view: View) -> Iterator[_Other]:
    points, size = view.xy_px[view.present], np.array(view.camera.image_size_px)
    for times in SMALLER:
        if len(points) and (np.percentile(points, NEARLY_ALL, axis=0) < size / times).all():
            yield "smaller_video", {"times": times}, replace(view, camera=smaller(view.camera, times))


def _feet_below(clip: ClipProblem, view: View) -> float:
    """How far the feet are below the trunk's ends, as a part of how far they are from them in the picture: 1 of an
    animal that stands, -1 of one that is upside down."""
    trunk = [clip.body.markers.index(marker) for marker in clip.body.forward]
    off_px = mean_along(view.xy_px[:, clip.feet], 1) - mean_along(view.xy_px[:, trunk], 1)
    off_px = off_px[np.isfinite(off_px[:, 0])]
    if not len(off_px):
        return 1.0
    away, up = np.median(off_px, axis=0), view.rotation.reshape(-1, 3, 3)[0, :2, 2]
    return -float(away @ up) / max(float(np.linalg.norm(away)), 1e-9)


def smaller(camera: Camera, times: float) -> Camera:
    """The camera of the same video, made smaller."""
    scale = np.array([[1.0 / times], [1.0 / times], [1.0]])
    # pixels count from the middle of the first one
    shift = np.array([[0, 0, 0.5 / times - 0.5], [0, 0, 0.5 / times - 0.5], [0, 0, 0]])
    width, height = camera.image_size_px
    size_px = (max(round(width / times), 1), max(round(height / times), 1))
    return replace(camera, matrix=scale * camera.matrix + shift, image_size_px=size_px)


# -- the lens -------------------------------------------------------------------------------------------------------

ZOOM, LARGEST, _ROUNDS = 0.2, 5.0, 6
"""Logarithm of a zoom in a second that is tried, and the least that is named: smaller ones fit better, too, where an
animal of other proportions comes nearer. Chosen by leaving runs out; how many times as large one is believed, and
rounds of the solver."""
LASTING = 0.25
"""Keypoints seen in a larger part of the first and of the last third of a second are seen all the time. By these a zoom
is judged, and only with all feet among them: an animal that leaves the picture does not grow, and feet that nobody sees
do not slide."""
_Minimum = Callable[[View, Array], Estimate]
"""The minimum of another view of a second of a clip, from states."""


def whole_ratio(other: TrajectorySolution, given: TrajectorySolution) -> float:
    """How much likelier a whole fit of the same detections is than another, as a logarithm, each with its own noise."""
    before, after = (sum(solution.cost_by_term.values()) for solution in (given, other))
    weight = np.array([np.where(view.present, view.confidence, 0.0) for view in given.views])
    spread = 2.0 * np.nansum(weight * np.log(given.noise_px / other.noise_px))  # both coordinates of a detection
    return before - after + float(spread)


def of_lens(given: Baseline, noise_px: Array) -> Iterator[Finding]:
    """At most one: a lens that the keypoints no longer have, or a picture that zooms, in the second in which most is
    seen. noise_px (T, J): as the fit found it."""
    part = best_seen(given.view, given.clip.fps)
    clip, states, (view,) = given.clip.part(part), given.states[part], given.clip.part(part).views
    if len(states) < 3 or not np.isfinite(states).all():
        return
    *_, standing = contacts(clip, clip.markers(states), 1.0)

    def minimum(view: View, states: Array) -> Estimate:
        problem = replace(clip, views=(view,)).problem(noise_px[None, part], 1.0, standing)
        return problem.minimise(states, _RATE_TOLERANCE, _ROUNDS)

    as_given = minimum(view, states)
    flat = replace(view.camera, model="pinhole", distortion=np.zeros(0))
    if view.camera.distortion.any() and as_given.cost - minimum(replace(view, camera=flat), states).cost > CLEAR:
        ratio = _without_lens(given.clip, flat)
        if believed(ratio, surely=True):
            yield finding("keypoints_undistorted", log_likelihood_ratio=ratio)
            return
    ends = np.array_split(view.present, 3)
    lasting = (ends[0].mean(axis=0) > LASTING) & (ends[-1].mean(axis=0) > LASTING)
    if lasting[clip.feet].all():
        steady = replace(view, xy_px=np.where(lasting[:, None], view.xy_px, np.nan))
        yield from _zooms(steady, as_given.states, minimum)


def _without_lens(clip: ClipProblem, flat: Camera) -> float:
    """How much likelier the stretch in which most is seen is if the camera bends nothing, solved both ways."""
    clip = clip.part(densest_window(clip.present().sum(axis=1), round(RATE_S * clip.fps)))
    bent, straight = (
        solve_trajectory(views, clip.body, clip.prior, clip.fps, replace(clip.options, fast=False))
        for views in (clip.views, [replace(view, camera=flat) for view in clip.views])
    )
    return whole_ratio(straight, bent)


def _zooms(view: View, states: Array, minimum: _Minimum) -> Iterator[Finding]:
    centre, time = view.camera.matrix[:2, 2], np.linspace(-0.5, 0.5, len(states))[:, None, None]

    def at(zoom: float, states: Array) -> Estimate:
        return minimum(replace(view, xy_px=centre + (view.xy_px - centre) * np.exp(-zoom * time)), states)

    as_given = at(0.0, states)
    nearer, away = (as_given.cost - at(zoom, as_given.states).cost for zoom in (ZOOM, -ZOOM))
    slope, bend = 0.5 * (nearer - away), nearer + away  # of the parabola through both, in zooms
    best = float(np.clip(-slope / bend if bend < 0 else np.sign(slope), -LARGEST, LARGEST))
    if abs(best) >= 1.0 and believed(ratio := as_given.cost - at(ZOOM * best, as_given.states).cost):
        yield finding("picture_zooms", way="in" if best > 0 else "out", log_likelihood_ratio=ratio)


# -- the frame rate ---------------------------------------------------------------------------------------------------

RATE_STEP, RATE_STEPS = 2**0.5, 8
"""The factor between rates that are tried, and so many of them are sought through upwards and downwards at most."""
NEARLY, ANOTHER, SPEEDS = 1.02, 1.3, 1.25
"""Factors by which rates that files state are one, and from which on a rate at which angles swing is another: animals
of one gait swing up to 1.21 times faster or slower than the prior's (32 real views; 1.22 in a drawn clip), with a
standard deviation of a tenth. At its true rate, an animal is by no more than the last faster or slower than all of the
prior's: what stands or turns is no slow motion."""
RATE_S = 5.0
"""So much of a clip is judged."""
_RATE_TOLERANCE, _RATE_ITERATIONS = 1e-3, 10


def other_rate(clip: ClipProblem, states: Array, stated_hz: float | None, by_motion: bool = True) -> Finding | None:
    """states (T, D) at nominal size about the origin, without gaps, of a solved stretch. stated_hz: what the file
    says. by_motion: whether angles that swing at another rate are a finding, too."""
    if stated_hz is not None and not 1 / NEARLY < stated_hz / clip.fps < NEARLY:
        return finding("frame_rate_stated", given_hz=clip.fps, other_hz=stated_hz)
    if clip.prior.name == NONE or not by_motion:
        return None
    rows = densest_window(clip.present().sum(axis=1), round(RATE_S * clip.fps))
    clip, states, step = clip.part(rows), states[rows], max(1, round(clip.fps / APPROACH_HZ))
    thin, few, alike = clip.thinned(step), states[::step], clip.correlation_frames

    @cache
    def cost(steps: int) -> float:
        return _rate_cost(*_at_rate(thin, few, RATE_STEP**steps, alike))

    at, last = 0, 1
    while at != last and abs(at) < RATE_STEPS:  # downhill
        around: list[int] = [at, at - 1, at + 1]
        at, last = min(around, key=cost), at
    if abs(at) in (0, RATE_STEPS):
        return None
    slope, bend = 0.5 * (cost(at + 1) - cost(at - 1)), cost(at - 1) - 2 * cost(at) + cost(at + 1)
    factor = RATE_STEP ** (at - slope / max(bend, 1e-9))  # where the parabola through the three has its minimum
    speeds_m_s, there_m_s = [one.speed_m_s for one in clip.prior.segments], mean_speed_m_s(states, clip.fps * factor)
    usual = not speeds_m_s or min(speeds_m_s) / SPEEDS < there_m_s < max(speeds_m_s) * SPEEDS
    if 1 / ANOTHER < factor < ANOTHER or not usual:
        return None
    given, there = (_at_rate(clip, states, by) for by in (1.0, factor))
    before, after = (prior_misfit_of(*one) for one in (given, there))
    ratio = _rate_cost(*given, alike) - _rate_cost(*there, alike)
    unknown = after.unlike and after.level >= before.level  # to the prior, at that rate
    if unknown or ratio < (CLEAR if cost(0) - cost(at) > CLEAR else SURE):
        return None
    return finding("frame_rate", given_hz=clip.fps, other_hz=clip.fps * factor, log_likelihood_ratio=ratio)


def _rate_cost(problem: LeastSquares, found: Estimate, alike: float = 1.0) -> float:
    """The cost of the keypoints and of how the angles move, not of the poses, which are as likely at any rate."""
    costs = problem.costs(found.states)
    return costs["reprojection"] / alike + costs[MOTION]


def _at_rate(clip: ClipProblem, states: Array, factor: float, alike: float = 1.0) -> tuple[LeastSquares, Estimate]:
    """The minimum at another rate, if the errors of so many frames are alike and count once. With the noise that is
    expected: what a fit found depends on its rate."""
    noise_px = clip.noise_px(clip.markers(states), np.full((len(clip.views), len(clip.body.markers)), alike))
    problem = replace(clip, fps=clip.fps * factor).problem(noise_px)
    return problem, problem.minimise(states, _RATE_TOLERANCE, _RATE_ITERATIONS)
