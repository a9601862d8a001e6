"""Compare the likelihood of a camera's detections under the given inputs and under alternatives.

A hypothesis is a `ClipProblem` with other keypoints or another camera. One second of the clip is solved again under the
hypothesis and compared with the same second as given. This takes as long as a fit, so callers first look for cheap
evidence. Errors of a detector persist over frames, and the keypoints of one limb have similar errors. An error that
persists is therefore more likely than an error that jumps (`negative_log_density`).

The hypotheses in this module are a different picture (fractions of its size as keypoints, a turned picture, a smaller
video, no lens distortion), a picture that zooms, and a different frame rate, at which the angles swing as fast as in
the prior. Left-right swaps are in `recon.check.swaps`.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import cache
from typing import Any

import numpy as np

from recon.animal.prior import ANGLES, NONE, MotionPrior, mean_speed_m_s
from recon.base.arrays import Array, Bools, mean_along
from recon.check.codes import EFFECTS, by_effect, finding
from recon.clip import View, densest_window, frame_ranges
from recon.fit.clip_problem import ClipProblem, contacts, sigmas_above_ground
from recon.fit.least_squares import Estimate, LeastSquares
from recon.fit.posterior import prior_misfit_of
from recon.fit.result import Finding, TrajectorySolution
from recon.fit.starts import APPROACH_HZ, interpolate_states
from recon.fit.terms import MOTION
from recon.fit.trajectory import solve_trajectory
from recon.fit.triangulation import triangulate_views
from recon.geometry.camera import Camera
from recon.geometry.frames import inverse

_TOLERANCE = 3e-3
"""Relative decrease of the cost in an iteration at which a fit in this module ends."""
_ITERATIONS = 12
"""Maximum number of iterations of a fit in this module."""
EXAMINED_GAIN = float(np.log(1000.0))
"""Log-likelihood gain above which a hypothesis is examined further."""
REPORTED_GAIN = 25.0
"""Log-likelihood gain above which a left-right swap or a zoom is reported.

This value and `CERTAIN_GAIN` were chosen on real clips (docs/benchmarks.md, left-right swaps), and allow for errors of
the model.
"""
CERTAIN_GAIN = 30.0
"""Log-likelihood gain above which the evidence counts as clear.

The gain of a swap over a contradicting swap, of the whole clip without its swaps over the clip as given, of a swap that
two or more other cameras show, and of another frame rate over the given rate must exceed this value.
"""
KEYPOINT_WEIGHT = 0.4
"""Weight of each keypoint's log-density, below 1 because the keypoints of one limb have similar errors.

The value was chosen on real clips (docs/benchmarks.md).
"""
STUDENT_T_DEGREES = 3.0
"""Degrees of freedom of Student's t distribution, which the errors of detections are assumed to have."""
TESTED_S = 1.0
"""Duration of the part of a clip that is solved again for a test, seconds."""
LOOSE_NOISE_FACTOR = 2.0
"""Factor by which the noise is multiplied in a fit in which each keypoint may belong to either side."""


def exceeds_margin(ratio: float, surely: bool = False) -> bool:
    """Return whether a log-likelihood gain exceeds `REPORTED_GAIN` or, if `surely` is true, `CERTAIN_GAIN`."""
    return ratio > (CERTAIN_GAIN if surely else REPORTED_GAIN)


def single_view(clip: ClipProblem, view: View) -> ClipProblem:
    """Return the problem of fitting the view of a single camera, with the fast search."""
    origin_m = np.mean(view.centre_m, axis=0)
    return replace(clip, views=(view,), origin_m=origin_m, options=replace(clip.options, fast=True))


@dataclass(frozen=True, eq=False)
class Refit:
    """States (n, D) of the animal, at nominal size, that solve a part of a clip, and their negative log-likelihoods."""

    states: Array
    correlated: float
    """Negative log-likelihood if errors of neighbouring frames are correlated."""
    independent: float
    """Negative log-likelihood if errors of neighbouring frames are independent."""

    @classmethod
    def of_states(cls, clip: ClipProblem, states: Array) -> Refit:
        """Return given states (n, D) with their negative log-likelihoods, or infinity if a frame has no state."""
        if not np.isfinite(states).all():
            return cls(states, np.inf, np.inf)
        noise_px = clip.noise_px(clip.markers(states), np.ones((1, len(clip.body.markers))))
        costs = clip.problem(noise_px, 1.0).costs(states)
        reprojection, independent, ground_cost = costs["reprojection"], sum(costs.values()), 0.0
        if clip.ground_known and len(clip.feet):  # the cost includes feet that never touch the ground
            ground_cost = 0.5 * sigmas_above_ground(clip, clip.markers(states)) ** 2
        return cls(
            states, _view_negative_log_density(clip, states) + ground_cost + independent - reprojection, independent
        )

    def gain_over(self, reference: Refit) -> float:
        """Return the log-likelihood gain over `reference`, the smaller of the gains under the two noise models."""
        if not np.isfinite(self.independent):
            return -np.inf
        return min(reference.correlated - self.correlated, reference.independent - self.independent)


def refit_view(clip: ClipProblem) -> Refit:
    """Solve the clip of a single camera's view, and return the solution with its likelihoods."""
    options = replace(clip.options, fast=False)
    solution = solve_trajectory(
        clip.views, clip.body, clip.prior, clip.fps, options, ground_near_zero=clip.ground_near_zero
    )
    solved = baseline_of(replace(clip, views=solution.views), 0, solution.states, solution.size)
    return Refit.of_states(solved.clip, solved.states)


def _view_negative_log_density(clip: ClipProblem, states: Array) -> float:
    """Return the negative log-density of the keypoints of a single view, given the motion's states (T, D)."""
    (view,), markers = clip.views, clip.markers(states)
    (sigma_px,) = clip.noise_px(markers, np.ones((1, markers.shape[1])))
    projected, _ = view.project(view.shift_to_exposure(clip.in_world(markers)))
    return negative_log_density(view, projected, sigma_px, clip.correlation_frames)


def negative_log_density(view: View, projected: Array, sigma_px: Array, correlation_frames: float) -> float:
    """Return the negative log-density of a view's keypoints, given the projected markers (T, J, 2), up to a constant.

    `sigma_px` are the standard deviations of the detections, shape (T, J). A part of each error is carried over from
    the frame before, so that frames within `correlation_frames` count only once.
    """
    errors = (projected - view.xy_px) / sigma_px[..., None]
    autocorrelation = (correlation_frames - 1) / (correlation_frames + 1)
    innovations = errors.copy()
    innovations[1:] = np.where(
        np.isfinite(errors[:-1]),
        (errors[1:] - autocorrelation * errors[:-1]) / np.sqrt(1 - autocorrelation**2),
        errors[1:],
    )
    weight = np.where(view.present, view.confidence, 0.0)
    spread = 2.0 * float(np.sum(np.log(sigma_px) * weight)) / correlation_frames
    return KEYPOINT_WEIGHT * float(np.sum(log_tail(innovations) * weight)) + spread


def log_tail(residual: Array) -> Array:
    """Return the negative log-density (T, J) of errors (T, J, 2), in standard deviations; 0 for a missing point."""
    return (STUDENT_T_DEGREES + 2) / 2 * np.log1p(np.nan_to_num(np.sum(residual**2, axis=-1)) / STUDENT_T_DEGREES)


@dataclass(frozen=True, eq=False)
class Baseline:
    """Unchanged view of a clip, with which other hypotheses are compared, and the states (T, D) fitted to it.

    The states are those of an animal of nominal size, relative to the origin of the clip's problem.
    """

    clip: ClipProblem
    states: Array
    is_only: bool = True
    """Whether no other view contributed to the states."""
    predicted: tuple[Array, Array] | None = None
    """Keypoints (T, J, 2) that the other views predict, px, and their standard deviations (`predicted_by_others`)."""
    _refits: dict[tuple[int, int], Refit] = field(default_factory=dict, init=False, repr=False)
    """Cache of the results of `refit`, with the first frame of a part and the frame after the last as keys."""
    _settled: dict[tuple[int, int], Estimate] = field(default_factory=dict, init=False, repr=False)
    """Cache of the results of `settled`, with the first frame of a part and the frame after the last as keys."""

    @property
    def view(self) -> View:
        """Return the only view of the baseline's clip."""
        return self.clip.views[0]

    def with_view(self, view: View) -> ClipProblem:
        """Return the problem of the baseline's clip with another view instead of its own."""
        return single_view(self.clip, view)

    def refit(self, part: slice) -> Refit:
        """Return the solution of a part of the clip, with its detections and camera unchanged.

        For the whole clip, the estimated states are used, unless other cameras contributed to them.
        """
        key = part.start, part.stop
        if key not in self._refits:
            is_known = self.is_only and part.stop - part.start == len(self.states)
            refit = Refit.of_states(self.clip, self.states) if is_known else refit_view(self.clip.part(part))
            self._refits[key] = refit
        return self._refits[key]

    def settled(self, rows: slice, noise_px: Array) -> Estimate:
        """Return the best solution near the estimated states of some frames, with the ground under these states.

        The tests of the lens and of the focal length start from this solution. `noise_px` is the fit's standard
        deviation of each detection, pixels, shape (T, J).
        """
        key = rows.start, rows.stop
        if key not in self._settled:
            clip, states = self.clip.part(rows), self.states[rows]
            *_, standing = contacts(clip, clip.markers(states), 1.0)
            problem = clip.problem(noise_px[None, rows], 1.0, standing)
            self._settled[key] = problem.minimise(states, _RATE_TOLERANCE, _LENS_ITERATIONS)
        return self._settled[key]


def project_either_side(baseline: Baseline, mirrored: View, is_exchanged: Bools) -> tuple[Array, Array]:
    """Return the projected markers (T, J, 2) and their noise (T, J) of a fit in which a keypoint may be on either side.

    A view and its mirrored version are fitted together. Markers in which the two versions differ (`is_exchanged`, a
    mask of shape (J,)) have half of their weight in each version. Both results are in pixels, and NaN in frames without
    states. They hold at the times of the view's own pictures, since no other camera is involved.
    """
    clip, posed = baseline.clip, np.flatnonzero(np.isfinite(baseline.states[:, 0]))
    shares = (np.where(is_exchanged, 0.5, 1.0), np.where(is_exchanged, 0.5, 0.0))
    views = [
        replace(half_view, confidence=half_view.confidence * fraction, offset_frames=0.0)
        for half_view, fraction in zip((baseline.view, mirrored), shares, strict=True)
    ]
    projected, sigma_px = np.full(mirrored.xy_px.shape, np.nan), np.full(mirrored.confidence.shape, np.nan)
    for rows in (slice(first, stop) for first, stop in frame_ranges(posed)):
        part = replace(clip, views=tuple(view.part(rows) for view in views))
        step = max(1, round(clip.fps / APPROACH_HZ))
        kept_frames, no_factor = np.arange(0, len(part), step), np.ones((2, len(is_exchanged)))
        thin = part.thinned(step)
        states = baseline.states[rows][kept_frames]  # the mean pose, at the animal's position
        states[:, ANGLES] = clip.prior.mean
        problem = thin.problem(LOOSE_NOISE_FACTOR * thin.noise_px(thin.markers(states), no_factor))
        states = problem.minimise(states, _TOLERANCE, _ITERATIONS).states
        markers = part.markers(interpolate_states(states, kept_frames, len(part)))
        sigma_px[rows] = LOOSE_NOISE_FACTOR * part.noise_px(markers, no_factor)[0]
        projected[rows], _ = part.views[0].project(part.in_world(markers))
    return projected, sigma_px


def baseline_of(
    clip: ClipProblem, number: int, states: Array, size: float, predicted: tuple[Array, Array] | None = None
) -> Baseline:
    """Return the baseline of the view with index `number` of a clip, given the states (T, D) and the animal's size.

    The root of the states is in the world frame. `predicted` is what the other views predict (`predicted_by_others`).
    """
    single = single_view(clip, clip.views[number])
    return Baseline(single, single.nominal(states, size), len(clip.views) == 1, predicted)


def best_seen(view: View, fps: float) -> slice:
    """Return the slice of frames of the `TESTED_S` seconds with the most detections.

    Empty frames at either end of these seconds are left out.
    """
    counts = view.present.sum(axis=1)
    part = densest_window(counts, round(TESTED_S * fps))
    seen = part.start + np.flatnonzero(counts[part])
    return slice(int(seen[0]), int(seen[-1]) + 1) if len(seen) else slice(0, 0)


# Hypotheses on the picture

SMALLER_FACTORS = (2, 3, 4)
"""Factors that are tried, by which the video may be smaller than the calibrated camera's picture."""
UPRIGHT_RATIO = 0.7
"""Height of the trunk above the feet, relative to the distance between them, below which turned pictures are tried.

The ratio is 0.95 or more in 32 real views of cheetahs, 0.82 or more in simulated views of dogs, and 0.17 or less if the
picture or the world is turned (`python benchmarks/wrong_inputs.py --only input-limits`).
"""
MIN_INSIDE_PERCENT = 99.0
"""Percentage of the keypoints that must lie within the picture of a smaller video for this video to be considered."""
OPPOSITE_GAIN_RATIO = 0.5
"""Gain of a turn to the opposite side, relative to the best gain, above which no turn is reported.

Only one of two opposite turns can make the animal upright. Both make the clip more likely if most detections are gross
outliers, which show no animal.
"""

RAY_ERROR_RATIO = 2.0
"""Largest reprojection error of triangulated points at which rays meet, relative to the error of the best hypothesis.

Hypotheses within this factor are compared by their likelihood, because level cameras around an animal hardly
distinguish some of them by their rays.
"""

_CAMERA_TO_WORLD = {"pose_inverted", "rotation_transposed"}
"""Codes of findings on camera files whose poses, or only rotations, are given from camera to world."""
_Alternative = tuple[str, dict[str, Any], View]
"""Hypothesis on a view, as the code and numbers of the finding, and the view that would be right."""


def unit_square_finding(baseline: Baseline) -> Finding | None:
    """Return a finding if the keypoints seem to be fractions of the picture's width and height, otherwise None."""
    view = baseline.view
    points = view.xy_px[view.present]
    if not len(points) or np.percentile(np.abs(points - 0.5), MIN_INSIDE_PERCENT) > 1.0:
        return None
    width, height = view.camera.image_size_px
    frames = float(view.present.any(axis=1).sum())
    ratio = float(np.log(width * height / 4.0)) * max(frames / baseline.clip.correlation_frames, 1.0)
    return finding("keypoints_normalised", camera=view.camera.name, log_likelihood_ratio=ratio)


def other_picture_finding(baseline: Baseline) -> Finding | None:
    """Return a finding if the keypoints are clearly more likely to be from another picture, otherwise None."""
    return finding_of_pictures(baseline.view.camera, *other_pictures(baseline))


def other_pictures(baseline: Baseline) -> tuple[list[_Alternative], list[float]]:
    """Return the hypotheses of another picture or world for a view, and their log-likelihood gains."""
    view, part = baseline.view, best_seen(baseline.view, baseline.clip.fps)
    alternatives = (
        [*_turned(view), *_smaller(view)]
        if feet_below_trunk(baseline.clip, view) < UPRIGHT_RATIO
        else [*_smaller(view)]
    )
    if not alternatives:
        return [], []
    as_given = baseline.refit(part)
    return alternatives, [
        refit_view(baseline.with_view(candidate).part(part)).gain_over(as_given) for _, _, candidate in alternatives
    ]


def common_picture_finding(
    baselines: Sequence[Baseline], trials: Sequence[tuple[Sequence[_Alternative], Sequence[float]]]
) -> Finding | None:
    """Return a finding if the same hypothesis of another picture or world explains the detections of all cameras.

    The cameras share a world and usually a detector, so a common cause is more likely than a different one in each
    camera. The log-likelihood gains are summed over the cameras. Only hypotheses under which the rays of the cameras
    meet are compared, because the rays do not meet if the pictures are wrong. The rays also meet in a wrong world.

    Parameters
    ----------
    baselines
        The baseline of each camera of the clip.
    trials
        The hypotheses and their log-likelihood gains for each camera, from `other_pictures`.
    """
    by_cause = [
        {(code, *numbers.items()): (view, gain) for (code, numbers, view), gain in zip(*trial, strict=True)}
        for trial in trials
    ]
    common = [cause for cause in by_cause[0] if all(cause in causes for causes in by_cause)]
    rows = best_seen(baselines[0].view, baselines[0].clip.fps)
    errors_px = []
    for cause in common:
        error_px = triangulate_views([causes[cause][0].part(rows) for causes in by_cause]).error_px
        known_px = error_px[np.isfinite(error_px)]
        errors_px.append(float(np.median(known_px)) if len(known_px) else math.inf)
    limit_px = RAY_ERROR_RATIO * min(errors_px, default=math.inf)
    meeting = [cause for cause, error_px in zip(common, errors_px, strict=True) if error_px <= limit_px]
    alternatives = [(cause[0], dict(cause[1:]), by_cause[0][cause][0]) for cause in meeting]
    sums = [sum(causes[cause][1] for causes in by_cause) for cause in meeting]
    of_first = finding_of_pictures(baselines[0].view.camera, alternatives, sums)
    return None if of_first is None else replace(of_first, camera=None)


def finding_of_pictures(
    camera: Camera, alternatives: Sequence[_Alternative], ratios: Sequence[float]
) -> Finding | None:
    """Return a finding on the likeliest alternative, or on a contradiction that several alternatives explain."""
    if not alternatives:
        return None
    best = int(np.argmax(ratios))
    if not ratios[best] > EXAMINED_GAIN:
        return None
    code, numbers, _ = alternatives[best]
    opposites = (
        gain
        for gain, alternative in zip(ratios, alternatives, strict=True)
        if _are_opposite(alternative, alternatives[best])
    )
    if max(opposites, default=-np.inf) > OPPOSITE_GAIN_RATIO * ratios[best]:
        return None  # the detections show no animal, upright or turned
    likely = [i for i in range(len(ratios)) if not exceeds_margin(ratios[best] - ratios[i], surely=True)]
    if camera.knows_up and len(likely) > 1:
        rivals = [alternatives[i] for i in sorted(likely, key=lambda i: -ratios[i])]
        codes = {rival_code for rival_code, *_ in rivals}
        if all(map(_is_upside_down, rivals)) and not codes <= _CAMERA_TO_WORLD:
            return finding("upside_down", camera=camera.name, log_likelihood_ratio=ratios[best])
        causes = tuple(_WORDS[code].format(**numbers) for code, numbers, _ in rivals)
        return finding("turned_either_way", camera=camera.name, log_likelihood_ratio=ratios[best], causes=causes)
    return finding(code, camera=camera.name, log_likelihood_ratio=ratios[best], **numbers)


def _are_opposite(first: _Alternative, second: _Alternative) -> bool:
    """Return whether two hypotheses turn the picture or the world by 90 degrees to opposite sides."""
    turns = [numbers.get("degrees", 0) for _, numbers, _ in (first, second)]
    axes = [numbers.get("axis", "z").lstrip("-") for _, numbers, _ in (first, second)]
    is_other = first[1] != second[1]
    return first[0] == second[0] and is_other and (sum(turns) == 360 or (axes[0] == axes[1] and axes[0] != "z"))


_WORDS = {
    "picture_upside_down": "the picture is turned by 180 degrees",
    "keypoints_y_up": "the keypoints' y is counted from the bottom of the picture",
    "picture_turned": "the picture is turned by {degrees} degrees",
    "world_not_z_up": "{axis} points up in the camera file's world (--set up={axis})",
    "pose_inverted": "the camera file's pose is from camera to world",
    "rotation_transposed": "only the camera file's rotation is from camera to world",
    "smaller_video": "the video is {times} times smaller than the camera's picture",
}
"""Causes in words, by the code of their finding."""


def _is_upside_down(alternative: _Alternative) -> bool:
    code, numbers, _ = alternative
    return code in {"picture_upside_down", "keypoints_y_up", *_CAMERA_TO_WORLD} or numbers.get("axis") == "-z"


def _turned(view: View) -> Iterator[_Alternative]:
    (width, height), (x, y) = view.camera.image_size_px, np.moveaxis(view.xy_px, -1, 0)
    pictures: list[tuple[str, dict[str, Any], tuple[Array, Array]]] = [
        ("picture_upside_down", {}, (width - 1 - x, height - 1 - y)),
        ("keypoints_y_up", {}, (x, height - 1 - y)),
        ("picture_turned", {"degrees": 90}, (y, height - 1 - x)),
        ("picture_turned", {"degrees": 270}, (width - 1 - y, x)),
    ]
    for code, numbers, xy_px in pictures:
        yield code, numbers, replace(view, xy_px=np.stack(xy_px, axis=-1))
    if view.camera.knows_up:
        turned_over = view.T_camera_world @ np.diag([1.0, -1.0, -1.0, 1.0])
        yield "world_not_z_up", {"axis": "-z"}, replace(view, T_camera_world=turned_over)
        yield "pose_inverted", {}, replace(view, T_camera_world=inverse(view.T_camera_world))
        yield "rotation_transposed", {}, replace(view, T_camera_world=_with_transposed_rotation(view.T_camera_world))
    upward = {"y": (0, 1, 0), "-y": (0, -1, 0)} | ({"x": (1, 0, 0), "-x": (-1, 0, 0)} if view.camera.knows_up else {})
    for axis, up in upward.items():
        turn = np.eye(4)
        turn[:3, :3] = _raising(np.array(up, dtype=float))
        yield "world_not_z_up", {"axis": axis}, replace(view, T_camera_world=view.T_camera_world @ turn.T)


def _with_transposed_rotation(transform: Array) -> Array:
    """Return rigid transforms (..., 4, 4) with their rotation transposed and their translation unchanged."""
    transposed = transform.copy()
    transposed[..., :3, :3] = np.swapaxes(transform[..., :3, :3], -1, -2)
    return transposed


def _raising(up: Array) -> Array:
    """Return the matrix (3, 3) of the rotation by 90 degrees that turns a horizontal unit vector (3,) to the z axis."""
    level = np.cross(up, [0.0, 0.0, 1.0])
    return np.outer(level, level) + np.outer([0.0, 0.0, 1.0], up) - np.outer(up, [0.0, 0.0, 1.0])


def _smaller(view: View) -> Iterator[_Alternative]:
    """Yield a hypothesis for each smaller video (`SMALLER_FACTORS`) whose picture contains nearly all keypoints."""
    points, size = view.xy_px[view.present], np.array(view.camera.image_size_px)
    for times in SMALLER_FACTORS:
        if len(points) and (np.percentile(points, MIN_INSIDE_PERCENT, axis=0) < size / times).all():
            yield "smaller_video", {"times": times}, replace(view, camera=smaller(view.camera, times))


def feet_below_trunk(clip: ClipProblem, view: View) -> float:
    """Return the height of the trunk above the feet in the picture, relative to the distance between them.

    The value is 1 for a standing animal, and -1 for an animal that is upside down.
    """
    trunk = [clip.body.markers.index(marker) for marker in clip.body.forward]
    off_px = mean_along(view.xy_px[:, clip.feet], 1) - mean_along(view.xy_px[:, trunk], 1)
    off_px = off_px[np.isfinite(off_px[:, 0])]
    if not len(off_px):
        return 1.0
    direction, up = np.median(off_px, axis=0), view.rotation.reshape(-1, 3, 3)[0, :2, 2]
    return -float(direction @ up) / max(float(np.linalg.norm(direction)), 1e-9)


def smaller(camera: Camera, times: float) -> Camera:
    """Return the camera of a video after its pictures were made smaller by the factor `times`."""
    scale = np.array([[1.0 / times], [1.0 / times], [1.0]])
    # Pixel coordinates are 0 in the middle of the first pixel.
    shift = np.array([[0, 0, 0.5 / times - 0.5], [0, 0, 0.5 / times - 0.5], [0, 0, 0]])
    width, height = camera.image_size_px
    size_px = (max(round(width / times), 1), max(round(height / times), 1))
    return replace(camera, matrix=scale * camera.matrix + shift, image_size_px=size_px)


# Hypotheses on the lens

ZOOM_PER_S = 0.2
"""Logarithm of the zoom per second that is tried first, and the smallest zoom that is reported.

A smaller zoom may also fit better because an animal of other proportions comes nearer. The size of the best zoom is at
most 0.42 (median 0) in 32 correct views, and up to 0.57 (median 0.29) if the picture zooms by 1.5 in a clip. At twice
the value, most of these zooms would be missed (`python benchmarks/wrong_inputs.py --only input-limits`). The gain of a
zoom must also exceed `REPORTED_GAIN`, so only some of these zooms are reported (`--only zoom` counts them).
"""
MAX_ZOOM_FACTOR = 5.0
"""Largest zoom that is tried, as a multiple of `ZOOM_PER_S`."""
_SMALL_ZOOM = 1e-4
"""Logarithm of a zoom per second that is so small that detections move by far less than their noise."""
_LENS_ITERATIONS = 6
"""Maximum number of iterations of a fit with another lens or zoom."""
DETECTED_FRACTION = 0.25
"""Minimum fraction of the frames, in both the first and the last third of a second, in which a keypoint is detected.

A zoom is tested only with such keypoints, and only if all feet are among them. Otherwise an animal that leaves the
picture would seem to shrink, and the feet would not show whether they slide.
"""


def whole_fit_gain(alternative: TrajectorySolution, original: TrajectorySolution) -> float:
    """Return the log-likelihood gain of one fit of a whole clip over another fit, each with its own estimated noise."""
    original_cost, alternative_cost = (sum(solution.cost_by_term.values()) for solution in (original, alternative))
    weight = np.array([np.where(view.present, view.confidence, 0.0) for view in original.views])
    # The factor is 2 because each detection has two coordinates.
    log_noise = 2.0 * np.nansum(weight * np.log(original.noise_px / alternative.noise_px))
    return original_cost - alternative_cost + float(log_noise)


def lens_findings(baseline: Baseline, noise_px: Array) -> Iterator[Finding]:
    """Yield at most one finding, on keypoints that were already undistorted or on a picture that zooms.

    The second with the most detections is tested. `noise_px` is the fit's standard deviation of each detection, pixels,
    shape (T, J).
    """
    stretch = best_seen(baseline.view, baseline.clip.fps)
    clip, states, (view,) = baseline.clip.part(stretch), baseline.states[stretch], baseline.clip.part(stretch).views
    if len(states) < 3 or not np.isfinite(states).all():
        return
    *_, standing = contacts(clip, clip.markers(states), 1.0)

    def problem(view: View) -> LeastSquares:
        return replace(clip, views=(view,)).problem(noise_px[None, stretch], 1.0, standing)

    def minimum(view: View, states: Array) -> Estimate:
        return problem(view).minimise(states, _RATE_TOLERANCE, _LENS_ITERATIONS)

    as_given = baseline.settled(stretch, noise_px)
    flat = replace(view.camera, model="pinhole", distortion=np.zeros(0))
    if (
        view.camera.distortion.any()
        and as_given.cost - minimum(replace(view, camera=flat), states).cost > EXAMINED_GAIN
    ):
        ratio = _without_lens(baseline.clip, flat)
        if exceeds_margin(ratio, surely=True):
            yield finding("keypoints_undistorted", log_likelihood_ratio=ratio)
            return
    thirds = np.array_split(view.present, 3)
    lasting = (thirds[0].mean(axis=0) > DETECTED_FRACTION) & (thirds[-1].mean(axis=0) > DETECTED_FRACTION)
    if lasting[clip.feet].all():
        lasting_view = replace(view, xy_px=np.where(lasting[:, None], view.xy_px, np.nan))
        yield from _zooms(clip, lasting_view, minimum(lasting_view, as_given.states), problem)


def _without_lens(clip: ClipProblem, flat: Camera) -> float:
    """Return the log-likelihood gain of the camera `flat`, which has no lens distortion, over the given camera.

    The part of the clip with the most detections is compared.
    """
    clip = clip.part(densest_window(clip.present().sum(axis=1), round(RATE_S * clip.fps)))
    bent, straight = (
        solve_trajectory(views, clip.body, clip.prior, clip.fps, replace(clip.options, fast=False))
        for views in (clip.views, [replace(view, camera=flat) for view in clip.views])
    )
    return whole_fit_gain(straight, bent)


def _zooms(
    clip: ClipProblem, view: View, as_given: Estimate, problem: Callable[[View], LeastSquares]
) -> Iterator[Finding]:
    """Yield the finding on a picture that zooms, if any, given the solution without a zoom."""
    centre, time = view.camera.matrix[:2, 2], np.linspace(-0.5, 0.5, len(as_given.states))[:, None, None]

    def at(zoom: float) -> LeastSquares:
        return problem(replace(view, xy_px=centre + (view.xy_px - centre) * np.exp(-zoom * time)))

    def minimum(zoom: float) -> Estimate:
        return at(zoom).minimise(as_given.states, _RATE_TOLERANCE, _LENS_ITERATIONS)

    def gain(zoom: float) -> float:
        return as_given.cost - minimum(zoom).cost

    # The states that fit best with a small zoom change the cost only to second order.
    nearer, farther = (at(zoom).cost(as_given.states) for zoom in (_SMALL_ZOOM, -_SMALL_ZOOM))
    slope = (farther - nearer) / (2 * _SMALL_ZOOM)
    direction = math.copysign(1.0, slope)
    gained = gain(direction * ZOOM_PER_S)
    if gained <= 0.5 * abs(slope) * ZOOM_PER_S:  # a parabola with this slope has its maximum at a smaller zoom
        return
    zoom = direction * zoom_of(gained, gain(-direction * ZOOM_PER_S))
    if abs(zoom) < ZOOM_PER_S:
        return
    zoomed = minimum(zoom)
    if exceeds_margin(ratio := as_given.cost - zoomed.cost):
        zoomed_m = clip.markers(zoomed.states)
        numbers = {"log_likelihood_ratio": ratio, **effects_m(clip.markers(as_given.states), zoomed_m)}
        sight_m = clip.in_world(zoomed_m).mean(axis=1) - view.centre_m
        numbers |= {"zoom": zoom, "distance_m": float(np.linalg.norm(sight_m, axis=-1).mean())}
        yield finding("picture_zooms", None, None, way="in" if zoom > 0 else "out", **numbers)


def zoom_of(gain: float, opposite_gain: float) -> float:
    """Return the logarithm of the most likely zoom per second, the maximum of a parabola through three gains.

    `gain` and `opposite_gain` are the log-likelihood gains of the zooms `ZOOM_PER_S` and -`ZOOM_PER_S`. The gain
    without a zoom is 0.
    """
    slope, bend = 0.5 * (gain - opposite_gain), gain + opposite_gain
    return ZOOM_PER_S * float(np.clip(-slope / bend if bend < 0 else np.sign(slope), -MAX_ZOOM_FACTOR, MAX_ZOOM_FACTOR))


def with_calibration_at_either_end(item: Finding) -> Finding:
    """Return a finding on a zoom, with its effect on positions if the calibration applies to one end of the clip.

    The effect is not decreased. The test assumes that the calibrated focal length applies to the middle of the tested
    second.
    """
    numbers = item.numbers
    zoom, distance_m, effect_m = (numbers.get(name) for name in ("zoom", "distance_m", "position_effect_m"))
    if not (isinstance(zoom, float) and isinstance(distance_m, float) and isinstance(effect_m, float)):
        return item
    off_m = distance_m * 0.5 * float(np.expm1(abs(zoom)))
    return replace(item, numbers={**numbers, "position_effect_m": max(effect_m, off_m)})


# Hypotheses on the frame rate

RATE_STEP = 2**0.5
"""Ratio of successive frame rates that are tried. A parabola gives the best rate between them."""
RATE_STEPS = 8
"""Maximum number of steps upwards or downwards, which correspond to a factor of 16."""
EQUAL_RATE_RATIO = 1.02
"""Largest ratio of two frame rates that count as equal."""
OTHER_RATE_RATIO = 1.3
"""Smallest factor between the speeds of angles in the clip and in the prior that suggests another frame rate.

Animals of the same gait may move their angles somewhat faster or more slowly than those of the prior.
"""
SPEED_FACTOR = 1.25
"""Factor by which the animal, at the other frame rate, may be faster or slower than all animals of the prior.

The other rate is not reported beyond this factor, so that an animal that stands or turns does not count as slow motion.
"""
WRONG_RATE_RATIO = 1.5
"""Ratio of frame rates from which a different rate is an error, because speeds are wrong even if poses are right.

Below this ratio, a different rate is at most a warning, unless poses or positions change as well, because animals that
turn swing their legs more slowly than animals that run straight ahead.
"""
RATE_S = 5.0
"""Duration of the part of a clip in which the frame rate and the lens distortion are tested, seconds."""
_RATE_TOLERANCE = 1e-3
"""Relative decrease of the cost in an iteration at which the fit with another frame rate ends."""
_RATE_ITERATIONS = 10
"""Maximum number of iterations of the fit with another frame rate."""


def frame_rate_finding(
    clip: ClipProblem, states: Array, stated_hz: float | None, by_motion: bool = True
) -> Finding | None:
    """Return a finding if a file states another frame rate, or if the angles suggest another one, otherwise None.

    Angles suggest another rate if they swing faster or more slowly than in the motions of the prior.

    Parameters
    ----------
    clip
        A solved part of the clip.
    states
        States (T, D) of an animal of nominal size about the origin, without gaps.
    stated_hz
        Frame rate that a keypoint file states, or None.
    by_motion
        Whether the angles may lead to a finding, in addition to `stated_hz`.
    """
    if stated_hz is not None and not 1 / EQUAL_RATE_RATIO < stated_hz / clip.fps < EQUAL_RATE_RATIO:
        return finding("frame_rate_stated", given_hz=clip.fps, other_hz=stated_hz)
    if clip.prior.name == NONE or not by_motion:
        return None
    rows = densest_window(clip.present().sum(axis=1), round(RATE_S * clip.fps))
    clip, states = clip.part(rows), states[rows]
    factor, thin_gain = _likeliest_rate(clip, states)
    if 1 / OTHER_RATE_RATIO < factor < OTHER_RATE_RATIO or not _has_usual_speed(
        clip.prior, mean_speed_m_s(states, clip.fps * factor)
    ):
        return None
    as_stated, rescaled = (_at_rate(clip, states, by) for by in (1.0, factor))
    misfit_given, misfit_other = (prior_misfit_of(*solved) for solved in (as_stated, rescaled))
    gain = _rate_cost(*as_stated, clip.correlation_frames) - _rate_cost(*rescaled, clip.correlation_frames)
    # The motion is unlike the motions of the prior at the other rate as well, and no less so than at the given rate.
    is_unknown = misfit_other.unlike and misfit_other.level >= misfit_given.level
    if is_unknown or gain < (EXAMINED_GAIN if thin_gain > EXAMINED_GAIN else CERTAIN_GAIN):
        return None
    numbers: dict[str, Any] = {"given_hz": clip.fps, "other_hz": clip.fps * factor, "log_likelihood_ratio": gain}
    numbers |= effects_m(*(clip.markers(estimate.states) for _, estimate in (as_stated, rescaled)))
    rear, front = (clip.markers(states)[:, clip.body.markers.index(marker)] for marker in clip.body.forward)
    trunk_m = float(np.linalg.norm(front - rear, axis=-1).mean())
    item = finding("frame_rate", **numbers)
    # Speeds are wrong by this factor even if the poses are right.
    if not 1 / WRONG_RATE_RATIO < factor < WRONG_RATE_RATIO:
        return item
    return by_effect(item, trunk_m, is_gross=True)


def effects_m(points_m: Array, other_points_m: Array) -> dict[str, float]:
    """Return the mean differences (m) between two motions in the pose and in the position (`EFFECTS`).

    The motions are given by their points (T, J, 3), m. The pose is the points relative to their mean, and the position
    is this mean. Frames that one motion lacks do not count; without common frames, both differences are NaN.
    """
    apart_m = points_m - other_points_m
    apart_m = apart_m[np.isfinite(apart_m).all(axis=(1, 2))]
    if not len(apart_m):
        return dict.fromkeys(EFFECTS, np.nan)
    middle_m = apart_m.mean(axis=1, keepdims=True)
    lengths_m = (np.linalg.norm(vectors_m, axis=-1).mean() for vectors_m in (apart_m - middle_m, middle_m))
    return dict(zip(EFFECTS, map(float, lengths_m), strict=True))


def _likeliest_rate(clip: ClipProblem, states: Array) -> tuple[float, float]:
    """Return the factor on the frame rate at which angles swing as in the prior, and its log-likelihood gain.

    Rates in steps of `RATE_STEP` are tried on a few frames, in the direction of lower cost. The best rate is the
    minimum of a parabola through the last three. The factor is 1 if the given rate is the best, or if the best rate is
    the last one that was tried.
    """
    step = max(1, round(clip.fps / APPROACH_HZ))
    thin, thin_states, correlation_frames = clip.thinned(step), states[::step], clip.correlation_frames

    @cache
    def cost(steps: int) -> float:
        return _rate_cost(*_at_rate(thin, thin_states, RATE_STEP**steps, correlation_frames))

    steps = 0
    for direction in (-1, 1):
        while abs(steps) < RATE_STEPS and cost(steps + direction) < cost(steps):
            steps += direction
    if abs(steps) in (0, RATE_STEPS):
        return 1.0, 0.0
    slope = 0.5 * (cost(steps + 1) - cost(steps - 1))
    bend = cost(steps - 1) - 2 * cost(steps) + cost(steps + 1)
    return RATE_STEP ** (steps - slope / max(bend, 1e-9)), cost(0) - cost(steps)


def _has_usual_speed(prior: MotionPrior, speed_m_s: float) -> bool:
    """Return whether the speed is within `SPEED_FACTOR` of the speeds of the motions to which the prior was fitted."""
    speeds_m_s = [segment.speed_m_s for segment in prior.segments]
    return not speeds_m_s or min(speeds_m_s) / SPEED_FACTOR < speed_m_s < max(speeds_m_s) * SPEED_FACTOR


def _rate_cost(problem: LeastSquares, estimate: Estimate, correlation_frames: float = 1.0) -> float:
    """Return the cost of the keypoints and of the motion, but not of the poses, which do not depend on the rate."""
    costs = problem.costs(estimate.states)
    return costs["reprojection"] / correlation_frames + costs[MOTION]


def _at_rate(
    clip: ClipProblem, states: Array, factor: float, correlation_frames: float = 1.0
) -> tuple[LeastSquares, Estimate]:
    """Return the problem with `factor` times the given frame rate, and its solution near the states (T, D).

    `correlation_frames` is the number of successive frames whose errors count only once. The expected noise is used,
    because the noise that a fit estimates depends on the frame rate.
    """
    noise_px = clip.noise_px(
        clip.markers(states), np.full((len(clip.views), len(clip.body.markers)), correlation_frames)
    )
    problem = replace(clip, fps=clip.fps * factor).problem(noise_px)
    return problem, problem.minimise(states, _RATE_TOLERANCE, _RATE_ITERATIONS)
