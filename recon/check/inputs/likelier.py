"""What a clip is likelier as: keypoints of another picture than the camera's (of 0 to 1, turned over, of a smaller
video), a picture that zooms, and another frame rate.

What could make a clip so at all is looked at first, and costs nothing; only then is the animal sought under the other
hypothesis. Played too slowly or too fast, an animal's angles do not swing as the motion prior knows it: poses stay as
they are, but speeds and accelerations change.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np

from recon.animal.prior import NONE
from recon.base.arrays import Array
from recon.check.codes import finding
from recon.check.inputs.likelihood import CLEAR, Baseline, believed, best_seen, refitted
from recon.clip import View
from recon.fit.clip_problem import ClipProblem, contacts
from recon.fit.least_squares import Estimate, LeastSquares
from recon.fit.posterior import prior_misfit_of
from recon.fit.result import Finding
from recon.fit.starts import APPROACH_HZ
from recon.fit.terms import dynamics_term
from recon.geometry.camera import Camera

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
    """Keypoints as parts of the picture's width and height: all lie in its corner, where the detector of a video would
    have put them anywhere."""
    view = given.view
    points = view.xy_px[view.present]
    if not len(points) or np.percentile(np.abs(points - 0.5), NEARLY_ALL) > 1.0:
        return None
    width, height = view.camera.image_size_px
    frames = float(view.present.any(axis=1).sum())
    ratio = float(np.log(width * height / 4.0)) * max(frames / given.clip.correlation_frames, 1.0)
    return finding("keypoints_normalised", camera=view.camera.name, log_likelihood_ratio=ratio)


def of_other_picture(given: Baseline) -> Finding | None:
    """A picture that is upside down, has y up or is turned by a quarter, or a world whose z is not up, looked for where
    the feet are not below the trunk; or a smaller version of the video, where all lies in the part that it would
    fill."""
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
    animal that stands on the ground, -1 of one that is upside down; less, too, where the camera looks up or down."""
    trunk = [clip.body.markers.index(marker) for marker in clip.body.forward]
    off_px = _mean(view.xy_px[:, clip.feet]) - _mean(view.xy_px[:, trunk])
    off_px = off_px[np.isfinite(off_px[:, 0])]
    if not len(off_px):
        return 1.0
    away, up = np.median(off_px, axis=0), view.rotation.reshape(-1, 3, 3)[0, :2, 2]
    return -float(away @ up) / max(float(np.linalg.norm(away)), 1e-9)


def _mean(values: Array) -> Array:
    """(T, 2) of points (T, N, 2), over what is known."""
    count = np.isfinite(values).sum(axis=1)
    return np.where(count > 0, np.nansum(values, axis=1) / np.maximum(count, 1), np.nan)


def smaller(camera: Camera, times: float) -> Camera:
    """The camera of the same video, made smaller."""
    scale = np.array([[1.0 / times], [1.0 / times], [1.0]])
    # pixels count from the middle of the first one
    shift = np.array([[0, 0, 0.5 / times - 0.5], [0, 0, 0.5 / times - 0.5], [0, 0, 0]])
    width, height = camera.image_size_px
    size_px = (max(round(width / times), 1), max(round(height / times), 1))
    return replace(camera, matrix=scale * camera.matrix + shift, image_size_px=size_px)


# -- the lens -------------------------------------------------------------------------------------------------------

ZOOM, _ROUNDS = 0.2, 6
"""Logarithm of a zoom in a clip that is tried, and the least that is named: smaller ones fit better, too, where an
animal of other proportions comes nearer. Chosen by leaving runs out; and rounds of the solver."""


def zooms(given: Baseline, noise_px: Array) -> Iterator[Finding]:
    """A picture that zooms in the second in which most is seen, or seems to: an animal that comes nearer looks alike,
    but goes where it comes nearer. noise_px (T, J): as the fit found it."""
    part = best_seen(given.view, given.clip.fps)
    clip, states, (view,) = given.clip.part(part), given.states[part], given.clip.part(part).views
    if len(states) < 3 or not np.isfinite(states).all():
        return
    *_, standing = contacts(clip, clip.markers(states), 1.0)
    centre, time = view.camera.matrix[:2, 2], np.linspace(-0.5, 0.5, len(states))[:, None, None]

    def minimum(zoom: float, states: Array) -> Estimate:
        undone = replace(view, xy_px=centre + (view.xy_px - centre) * np.exp(-zoom * time))
        problem = replace(clip, views=(undone,)).problem(noise_px[None, part], 1.0, standing)
        return problem.minimise(states, _TOLERANCE, _ROUNDS)

    as_given = minimum(0.0, states)
    nearer, away = (as_given.cost - minimum(zoom, as_given.states).cost for zoom in (ZOOM, -ZOOM))
    slope, bend = 0.5 * (nearer - away), nearer + away  # of the parabola through both, in zooms
    best = -slope / bend if bend < 0 else float(np.sign(slope))
    ratio = slope * best + 0.5 * bend * best**2
    if believed(ratio) and abs(best) >= 1.0:
        yield finding("picture_zooms", way="in" if best > 0 else "out", log_likelihood_ratio=ratio)


# -- the frame rate ---------------------------------------------------------------------------------------------------

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
    if not (believed(given - cost, surely=True) and _known(clip, states, factor)):
        return None
    other_hz = clip.fps * factor
    return finding("frame_rate", given_hz=clip.fps, other_hz=other_hz, log_likelihood_ratio=given - cost)


def _swings_better(clip: ClipProblem, states: Array, factor: float) -> bool:
    """Whether the angles as they are could be likelier at another rate: at a lower one they accelerate less than the
    noise that is expected, at a higher one they follow the expected swing more closely."""
    expected = (dynamics_term(clip.prior, states.shape[1], clip.fps * by, 1.0) for by in (1.0, factor))
    given, other = (float(np.sum(term.residual(states) ** 2)) for term in expected)
    return other < given * max(factor, 1.0) ** 3


def _cost(clip: ClipProblem, states: Array, factor: float) -> float:
    """The cost of the keypoints and of how the angles move, not of the poses, which are as likely at any rate."""
    step = max(1, round(clip.fps / APPROACH_HZ))
    problem, found = _at_rate(clip.thinned(step), states[::step], factor)
    costs = problem.costs(found.states)
    return costs["reprojection"] / clip.correlation_frames + costs.get("motion prior", 0.0)


def _known(clip: ClipProblem, states: Array, factor: float) -> bool:
    """Whether the prior knows the motion at that rate, or better than at the given one: one that fits as
    badly there says nothing of the rate."""
    given, there = (prior_misfit_of(*_at_rate(clip, states, by), clip.fps * by) for by in (1.0, factor))
    return not there.unlike or there.level < given.level


def _at_rate(clip: ClipProblem, states: Array, factor: float) -> tuple[LeastSquares, Estimate]:
    """The minimum at another rate. With the noise that is expected: what a fit found depends on its rate."""
    noise_px = clip.noise_px(clip.markers(states), np.ones((len(clip.views), len(clip.body.markers))))
    problem = replace(clip, fps=clip.fps * factor).problem(noise_px)
    return problem, problem.minimise(states, _TOLERANCE, _ITERATIONS)
