"""What a clip is likelier as: keypoints of another picture than the camera's (of 0 to 1, upside down or y up, of a
smaller video, another camera's), and another frame rate.

What could make a clip so at all is looked at first, and costs nothing; only then is the animal sought under the other
hypothesis. Played too slowly or too fast, an animal's angles do not swing as the motion prior knows it: poses stay as
they are, but speeds and accelerations change.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from recon.animal.prior import ANGLES, NONE
from recon.base.arrays import Array
from recon.check.codes import finding
from recon.check.inputs.likelihood import CLEAR, Baseline, believed, best_seen, judged, off_ground
from recon.clip import View, camera_poses
from recon.fit.clip_problem import ClipProblem
from recon.fit.least_squares import Estimate, LeastSquares
from recon.fit.posterior import prior_misfit_of
from recon.fit.result import Finding
from recon.fit.starts import APPROACH_HZ
from recon.geometry.camera import Camera

SMALLER = (2, 3, 4)
"""A video may be so many times smaller than the camera's calibration says."""
UNUSUAL = 1.5
"""A prior's misfit from which a quarter's turn is tried; up to 1.3 in 32 real views of running cheetahs."""
NEARLY_ALL = 99.0
"""Percentile of the points that have to lie in a part of the picture."""


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


def turned_over(given: Baseline, misfit: float = 0.0) -> Finding | None:
    """A picture upside down, or with y up, if the feet are above the trunk; where the prior does not know the motion,
    by its misfit, also one turned by a quarter, and a world whose z is not up."""
    view = given.view
    width, height = view.camera.image_size_px
    x, y = view.xy_px[..., 0], view.xy_px[..., 1]
    turned: list[tuple[str, dict[str, Any], View]] = []
    if _feet_up(given.clip, view):
        turned += [
            ("picture_upside_down", {}, replace(view, xy_px=[width - 1, height - 1] - view.xy_px)),
            ("keypoints_y_up", {}, replace(view, xy_px=[0, height - 1] + [1, -1] * view.xy_px)),
        ]
    if misfit > UNUSUAL:
        for degrees, xy_px in ((90, [y, height - 1 - x]), (270, [width - 1 - y, x])):
            turned.append(("picture_turned", {"degrees": degrees}, replace(view, xy_px=np.stack(xy_px, axis=-1))))
        for axis, sign in (("y", 1.0), ("-y", -1.0)):
            up = np.array([[1, 0, 0, 0], [0, 0, -sign, 0], [0, sign, 0, 0], [0, 0, 0, 1.0]])
            turned.append(("world_not_z_up", {"axis": axis}, replace(view, T_camera_world=view.T_camera_world @ up.T)))
    ratios = [_ratio(given, other) for _, _, other in turned]
    best = int(np.argmax(ratios)) if ratios else 0
    if not ratios or not ratios[best] > CLEAR:
        return None
    code, numbers, _ = turned[best]
    return finding(code, camera=view.camera.name, log_likelihood_ratio=ratios[best], **numbers)


def _feet_up(clip: ClipProblem, view: View) -> bool:
    """Whether the feet are above the trunk's ends in the picture, for the most part."""
    trunk = [clip.body.markers.index(marker) for marker in clip.body.forward]
    up = view.rotation.reshape(-1, 3, 3)[0, :2, 2]  # of the camera, in its picture
    height = view.xy_px @ up
    with np.errstate(invalid="ignore"):
        above = _mean(height[:, clip.feet]) - _mean(height[:, trunk])
    above = above[np.isfinite(above)]
    return bool(len(above)) and float(np.median(above)) > 0.0


def _mean(values: Array) -> Array:
    """(T,) of (T, N), over what is known."""
    count = np.isfinite(values).sum(axis=1)
    return np.where(count > 0, np.nansum(values, axis=1) / np.maximum(count, 1), np.nan)


def of_smaller_video(given: Baseline) -> Finding | None:
    """Keypoints found in a smaller version of the video: all lie in the part of the picture that it would fill."""
    view = given.view
    points, size = view.xy_px[view.present], np.array(view.camera.image_size_px)
    ratios = {
        times: _ratio(given, replace(view, camera=smaller(view.camera, times)))
        for times in SMALLER
        if len(points) and (np.percentile(points, NEARLY_ALL, axis=0) < size / times).all()
    }
    times = max(ratios, key=lambda n: ratios[n], default=None)
    if times is None or ratios[times] <= CLEAR:
        return None
    return finding("smaller_video", camera=view.camera.name, times=times, log_likelihood_ratio=ratios[times])


def smaller(camera: Camera, times: float) -> Camera:
    """The camera of the same video, made smaller."""
    scale = np.array([[1.0 / times], [1.0 / times], [1.0]])
    # pixels count from the middle of the first one
    shift = np.array([[0, 0, 0.5 / times - 0.5], [0, 0, 0.5 / times - 0.5], [0, 0, 0]])
    width, height = camera.image_size_px
    size_px = (max(round(width / times), 1), max(round(height / times), 1))
    return replace(camera, matrix=scale * camera.matrix + shift, image_size_px=size_px)


def of_other_camera(given: Baseline, others: Sequence[Camera], named: str | None) -> Finding | None:
    """Keypoints that another camera of the file found. named: whose name their own file has.

    Where no name says so, the height of the ground may: cameras look alike, but stand elsewhere and are tilted.
    """
    view, part = given.view, best_seen(given.view, given.clip.fps)
    name = view.camera.name
    if named is not None:
        return finding("other_camera_named", camera=name, given=name, other=named)
    posed = np.isfinite(given.states[part]).all()
    if not (others and posed and off_ground(given.clip, given.states[part]) > CLEAR):
        return None
    correlation_frames = given.clip.correlation_frames
    seen = [
        (judged(given.other(_seen_by(view, camera)).part(part)).lasting(correlation_frames), camera.name)
        for camera in others
    ]
    least, other = min(seen)
    ratio = given.judged(part).lasting(correlation_frames) - least
    if not ratio > CLEAR:
        return None
    return finding("other_camera", camera=name, given=name, other=other, log_likelihood_ratio=ratio)


def _seen_by(view: View, camera: Camera) -> View:
    return replace(view, camera=camera, T_camera_world=camera_poses([camera])[0])


def _ratio(given: Baseline, other: View) -> float:
    """How many times as likely the keypoints are with another view in place of the given one, as a logarithm."""
    part = best_seen(given.view, given.clip.fps)
    return given.judged(part).surprise - judged(given.other(other).part(part)).surprise


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
