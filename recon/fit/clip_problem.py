"""Define the problem of one clip: its views, a body, the expected motion, and the options."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal, NamedTuple

import numpy as np

from recon.animal.body import ROUGH_SIZE_SIGMA, Body
from recon.animal.prior import ANGLES, NONE, MotionPrior, prior_from_body
from recon.base.arrays import Array, Bools, Index
from recon.clip import View
from recon.fit import constants, terms
from recon.fit.body_shape import FreeShape
from recon.fit.least_squares import LeastSquares, SharedUnknown, frames_per_piece
from recon.fit.result import Ground
from recon.geometry.kinematics import ROOT, YAW

UP = np.array([0.0, 0.0, 1.0])
_NEAREST_M = 0.3
"""Minimum distance (m) from the camera for which the image scale (px/m) is computed.

Closer points are given the scale at this distance, so that the scale stays finite.
"""
_SAME_CENTRE_M = 1e-6
"""Maximum distance (m) between a camera and the scene's origin that counts as zero, to allow for rounding."""


@dataclass(frozen=True)
class TrajectoryOptions:
    """Options of a fit that users choose.

    `recon.fit.constants` holds the numbers that no user sets.
    """

    fast: bool = False
    """Whether the search is shortened by fewer starts and rounds, and by looser tolerances.

    Only one start is then solved to the end.
    """
    ground: Literal["auto", "none"] = "auto"
    """Whether feet in stance are assumed to be at rest and on one plane ("auto"), or not ("none")."""
    sigma_px: float = 3.0
    """Standard deviation of the detector's noise, pixels."""
    keypoint_sigma_m: float | None = None
    """Standard deviation of the distance of keypoints from their markers, m; None for the body's value."""
    size_sigma: float | None = None
    """Relative standard deviation of the animal's size; None for the body's value."""
    find_offsets: bool = False
    """Whether the fit estimates the time offsets of all cameras but the first."""
    refine_cameras: bool = False
    """Whether the fit refines the poses of all cameras but the first."""
    refine_first: bool = False
    """Whether the pose of the first of two cameras is refined as well (`recon.fit.pair_poses`)."""
    focal_sigma: float | None = None
    """Relative standard deviation of all cameras' focal lengths; None if they are exact.

    With several cameras, the fit estimates the focal lengths. With one camera, their errors only add to the
    uncertainty.
    """
    cameras_known: bool = False
    """Whether the poses of two cameras are exact.

    If they are not, the usual errors of the second camera's pose add to the uncertainty.
    """
    lengths_known: bool = False
    """Whether the body's lengths and keypoint offsets are exact.

    If they are not, a fit of several cameras estimates them.
    """

    def keypoint_noise_m(self, body: Body) -> float:
        """Return the standard deviation of the distance of a body's keypoints from its markers, m."""
        return body.keypoint_sigma_m if self.keypoint_sigma_m is None else self.keypoint_sigma_m


@dataclass(frozen=True, eq=False)
class ClipProblem:
    """Fixed inputs of one fit, for all T frames of a clip or a part of them."""

    views: tuple[View, ...]
    body: Body
    prior: MotionPrior
    fps: float
    options: TrajectoryOptions
    origin_m: Array
    """Fixed point about which the body's size scales the scene, shape (3,), world frame.

    The point is the (mean) centre of the first camera.
    """
    ground_near_zero: bool
    """Whether the ground is known to lie near the world's z = 0."""
    time_offset_frames: float
    """Standard deviation of the pictures' time offset, in frames, if the offset is not estimated."""
    body_prior: MotionPrior
    """Prior from the skeleton file alone, which gets the weight that `prior` loses."""
    prior_weight: float = 1.0
    """Factor on the weight of the prior, 0 to 1, as in `MotionSegment.prior_weight`."""
    known_states: Array | None = None
    """States (T, D) whose heading and angles are known, NaN in frames without known states; None for no frame."""
    shape: FreeShape | None = None
    """Unknown lengths and keypoint offsets of `body`; None if they are known."""
    solves_shape: bool = True
    """Whether the fit estimates an unknown shape. If it does not, the errors of the shape add to the uncertainty."""
    shape_scale: tuple[float, float] = (1.0, 1.0)
    """Factors on the expected standard deviations of lengths and of keypoint offsets.

    Factors above 1 allow an animal whose proportions differ more from the skeleton's.
    """
    pose_means: Array | None = None
    """Prior means (2, 6) of the errors of two refined cameras' poses, rad and m; None for 0."""
    acceleration_scale: Array | None = None
    """Factors on the expected standard deviations of the states' accelerations, (D,); None for 1."""

    @classmethod
    def from_views(
        cls,
        views: Sequence[View],
        body: Body,
        prior: MotionPrior,
        fps: float,
        options: TrajectoryOptions,
        ground_near_zero: bool | None = None,
    ) -> ClipProblem:
        """Return the problem of a whole clip from the arguments of `recon.fit.trajectory.solve_trajectory`."""
        if ground_near_zero is None:
            ground_near_zero = all(view.camera.knows_up for view in views)
        views = tuple(view.mask_outside_image() for view in views)
        origin_m = np.mean(views[0].centre_m, axis=0)
        offset_frames, body_prior = constants.TIME_OFFSET_FRAMES, prior_from_body(body)
        return cls(views, body, prior, fps, options, origin_m, ground_near_zero, offset_frames, body_prior)

    def __len__(self) -> int:
        """Return T, the number of frames of the problem."""
        return len(self.views[0].xy_px)

    def part(self, frames: slice | Index) -> ClipProblem:
        """Return the problem of only some frames of the clip."""
        known = None if self.known_states is None else self.known_states[frames]
        return replace(self, views=tuple(view.part(frames) for view in self.views), known_states=known)

    def with_free_shape(self) -> ClipProblem:
        """Return the problem with the body's shape unknown, if several cameras can estimate it.

        With one camera, unknown lengths only add to the uncertainty, and only if they were measured on other animals.
        """
        if self.options.lengths_known or self.known_states is not None:
            return self
        if len(self.views) == 1:
            is_chain = self.body.one_sided  # a chain has the lengths of the published animal
            is_rough = self.body.subject is None and self.prior.name == NONE and not is_chain
            return replace(self, shape=FreeShape.of_body(self.body), solves_shape=False) if is_rough else self
        scale = constants.KNOWN_SHAPE_SCALE if self.detector_is_measured else constants.FIRST_SHAPE_SCALE
        return replace(self, shape=FreeShape.of_body(self.body), shape_scale=scale)

    def without_ground(self) -> ClipProblem:
        """Return the problem without the assumption that feet in stance are at rest and on one plane."""
        return replace(self, options=replace(self.options, ground="none"))

    @property
    def detector_is_measured(self) -> bool:
        """Return whether the offsets and the noise of the detector's keypoints were measured."""
        return bool(self.body.keypoint_noise_m)

    def with_likely_shape_spread(self, shared: Mapping[str, Array]) -> ClipProblem:
        """Return the problem with `shape_scale` estimated from the lengths and offsets of a solution.

        The expected spread counts as `SHAPE_COUNT` lengths or offsets in the estimate, which is never below it.
        """
        unknowns, _ = self.shared_unknowns()
        least = constants.KNOWN_SHAPE_SCALE if self.detector_is_measured else (1.0, 1.0)
        floors = dict(zip((terms.LENGTHS, terms.COMMON_KEYPOINT_BIAS), least, strict=True))
        scales = dict(zip((terms.LENGTHS, terms.COMMON_KEYPOINT_BIAS), self.shape_scale, strict=True))
        for unknown in unknowns:
            if unknown.name in scales and unknown.name in shared:
                sigma = unknown.sigma * np.sqrt(self.correlation_frames) / scales[unknown.name]
                squares, floor = (shared[unknown.name] / sigma) ** 2, floors[unknown.name] ** 2
                square = (squares.sum() + constants.SHAPE_COUNT * floor) / (len(squares) + constants.SHAPE_COUNT)
                scales[unknown.name] = float(np.sqrt(max(square, floor)))
        return replace(self, shape_scale=(scales[terms.LENGTHS], scales[terms.COMMON_KEYPOINT_BIAS]))

    def thinned(self, step: int) -> ClipProblem:
        """Return the problem of every step-th frame, whose detections count `step` times."""
        thin = self.part(slice(None, None, step))
        views = tuple(
            replace(view, confidence=step * view.confidence, offset_frames=view.offset_frames / step)
            for view in thin.views
        )
        return replace(thin, views=views, fps=self.fps / step)

    def before_offsets(self, offsets_frames: Array) -> ClipProblem:
        """Return the problem before its views were shifted by estimated time offsets (V,), in frames.

        The time offsets are unknowns again, and the views' normal equations can be computed together, as in the fit.
        """
        views = zip(self.views, offsets_frames, strict=True)
        return replace(
            self, views=tuple(replace(view, offset_frames=view.offset_frames - frames) for view, frames in views)
        )

    @property
    def image_right(self) -> Array:
        """Return the horizontal unit vector (3,), in the world, that points right in the first camera's picture."""
        right, down, _ = self.views[0].T_camera_world.reshape(-1, 4, 4)[0, :3, :3]
        x = down if abs(right @ UP) > 1 - 1e-9 else right  # the right of a picture turned by 90 degrees is vertical
        level = x - UP * x[2]
        return level / np.linalg.norm(level)

    @property
    def feet(self) -> Index:
        """Return the indices (F,) of the feet's markers."""
        return np.array([self.body.markers.index(foot) for foot in self.body.feet], dtype=np.intp)

    @property
    def ground_known(self) -> bool:
        """Return whether the ground is known to lie near z = 0, and the fit uses the ground."""
        return self.ground_near_zero and self.options.ground == "auto"

    @property
    def finds_ground(self) -> bool:
        """Return whether contacts and a ground are estimated, which needs feet and more than two frames."""
        return self.options.ground == "auto" and len(self.body.feet) > 0 and len(self) > 2

    @property
    def size_sigma(self) -> float:
        """Return the prior standard deviation of the animal's size, whose prior mean is 1."""
        return self.body.size_sigma if self.options.size_sigma is None else self.options.size_sigma

    @property
    def shows_size(self) -> bool:
        """Return whether any picture was taken away from the scene's origin, so that the pictures show the size.

        The size scales the scene about the origin, which changes no picture that is taken from there.
        """
        return any(np.abs(view.centre_m - self.origin_m).max() > _SAME_CENTRE_M for view in self.views)

    def present(self) -> Bools:
        """Return a mask (T, J) of the markers that at least one camera saw."""
        return np.any([view.present for view in self.views], axis=0)

    def nominal(self, states: Array, size: float) -> Array:
        """Convert states (T, D) of an animal of a given size in the world to the states that `markers` expects.

        The result belongs to a body of nominal size, and its root is relative to `origin_m` in a scene of that size.
        """
        nominal = states.copy()
        nominal[:, ROOT] = (states[:, ROOT] - self.origin_m) / size
        return nominal

    def markers(self, states: Array) -> Array:
        """Return the positions (T, J, 3), m, at which the detector sees the markers of a body of nominal size.

        Positions and states are relative to `origin_m`. `nominal` computes such states from states in the world.
        """
        return self.body.detected.pose(states).points_m

    def in_world(self, points_m: Array, size: float = 1.0) -> Array:
        """Transform points (..., 3), m, relative to `origin_m`, of a body of nominal size to points in the world."""
        return self.origin_m + size * points_m

    @property
    def correlation_frames(self) -> float:
        """Return the correlation time of the errors, in frames, 1 or more.

        Frames within this time count as one frame in the uncertainty.
        """
        return max(constants.ERROR_TIME_S * self.fps, 1.0)

    @property
    def keypoint_sigma_m(self) -> float:
        """Return the standard deviation of the distance of keypoints from their markers, m."""
        return self.options.keypoint_noise_m(self.body)

    @property
    def keypoint_bias_m(self) -> float:
        """Return the standard deviation (m) of the keypoint bias, which stays constant over a clip."""
        return constants.KEYPOINT_BIAS_SHARE * self.keypoint_sigma_m

    @property
    def in_frame_m(self) -> Array:
        """Return the standard deviation of each marker's keypoints in a single frame, (J,), m."""
        noise_m = self.body.keypoint_noise_m if self.options.keypoint_sigma_m is None else {}
        return np.array([noise_m.get(marker, self.keypoint_sigma_m) for marker in self.body.markers])

    def px_per_m(self, points_m: Array, size: float = 1.0) -> Array:
        """Return the image scale (V, T), pixels per metre of the nominal body, at the median of markers (T, J, 3)."""
        middle = self.in_world(np.median(points_m, axis=1, keepdims=True), size)
        scales = []
        for view in self.views:
            nearest = np.max(view.focal_px) / _NEAREST_M
            _, by_point, valid = view.project_with_jacobian(middle)
            image_scale = np.sqrt(0.5 * np.sum(by_point[:, 0] ** 2, axis=(1, 2)))
            distant_scale = view.focal_px / np.maximum(np.linalg.norm(middle[:, 0] - view.centre_m, axis=1), _NEAREST_M)
            scales.append(size * np.where(valid[:, 0], np.minimum(image_scale, nearest), distant_scale))
        return np.array(scales)

    def noise_px(self, points_m: Array, factor: Array, size: float = 1.0) -> Array:
        """Return the standard deviation in px, (V, T, J), of the detections of markers (T, J, 3) at nominal size.

        The noise of the detector and of the keypoints, multiplied by sqrt(factor) (V, J), is combined with the noise
        from errors of a camera's rotation.
        """
        px_per_m = self.px_per_m(points_m, size)[..., None]
        noise = np.hypot(self.options.sigma_px, self.in_frame_m * px_per_m) * np.sqrt(factor)[:, None]
        if all(view.rotation_sigma_rad is None for view in self.views):
            return noise
        rotation_px = np.array([np.broadcast_to(view.turn_px, len(self)) for view in self.views])
        return np.hypot(noise, rotation_px[..., None])

    def shared_unknowns(self, shifts_m: Array | None = None) -> tuple[list[SharedUnknown], list[SharedUnknown]]:
        """Return the unknowns that all frames share, first the estimated ones, then the nuisance unknowns.

        Nuisance unknowns only add to the uncertainty, such as a single camera's time offset and focal length.
        `shifts_m` (V,) are the standard deviations of refined cameras' positions. The standard deviations of persistent
        errors are divided by sqrt(`correlation_frames`), because the posterior multiplies all variances by
        `correlation_frames`.
        """
        options, V = self.options, len(self.views)
        size = [SharedUnknown(terms.SIZE, np.ones(1), np.array([self.size_sigma]))] if self.shows_size else []
        time_offsets, focals = self._time_offset_unknowns(), self._focal_unknowns()
        biases, common_biases = self._bias_unknowns()
        if V == 1:
            lengths = [] if self.shape is None else [self._lasting(terms.LENGTHS, self._single_length_sigmas)]
            return size, [*time_offsets, *focals, *biases, *common_biases, *lengths]
        shapes = self._shape_unknowns()
        if not self.solves_shape or self.shape is None:  # the shape only adds to the uncertainty
            shapes, biases = [], [*biases, *(shapes or common_biases)]
        sideslip = [self._lasting(terms.SIDESLIP, constants.SIDESLIP_RAD)] if len(self) > 1 else []
        poses = {} if shifts_m is None else self._pose_sigmas(shifts_m)
        corrections = [self._lasting(terms.extrinsic_correction(i), sigmas) for i, sigmas in poses.items()]
        if self.pose_means is not None:
            corrections = [replace(u, mean=mean) for u, mean in zip(corrections, self.pose_means, strict=True)]
        if not options.refine_cameras:
            corrections, biases = [], [*biases, *corrections]
        return [*size, *sideslip, *time_offsets, *corrections, *focals, *shapes], biases

    def _lasting(self, name: str, sigma: Array | float) -> SharedUnknown:
        """Return unknowns of mean 0 and standard deviation `sigma` that all frames share.

        Their variances are divided by `correlation_frames`, because these errors persist for the whole clip.
        """
        sigmas = np.asarray(np.atleast_1d(sigma) / np.sqrt(self.correlation_frames), dtype=float)
        return SharedUnknown(name, np.zeros(len(sigmas)), sigmas)

    def _time_offset_unknowns(self) -> list[SharedUnknown]:
        """Return the cameras' time offsets as shared unknowns, without the first camera's if the fit estimates them."""
        first_view, sigma_frames = 0, self.time_offset_frames
        if self.options.find_offsets:
            first_view, sigma_frames = 1, constants.SOUGHT_OFFSET_FRAMES
        return [self._lasting(terms.time_offset(i), sigma_frames) for i in range(first_view, len(self.views))]

    def _focal_unknowns(self) -> list[SharedUnknown]:
        """Return the factors on the cameras' focal lengths as shared unknowns, or none if focal lengths are exact."""
        sigma = self.options.focal_sigma
        return [] if sigma is None else [self._lasting(terms.focal_scale(i), sigma) for i in range(len(self.views))]

    def _bias_sigmas_m(self) -> tuple[Array, Array]:
        """Return the standard deviations of each view's own keypoint bias, (2J,), and of the common bias, (3J,), m."""
        common = constants.COMMON_BIAS_SHARE if len(self.views) > 1 else 0.0
        bias_m = np.array([self.body.keypoint_spread_m.get(m, self.keypoint_bias_m) for m in self.body.markers])
        return np.repeat(bias_m * (1 - common) ** 0.5, 2), np.repeat(bias_m * common**0.5, 3)

    def _bias_unknowns(self) -> tuple[list[SharedUnknown], list[SharedUnknown]]:
        """Return each view's own keypoint bias and the common keypoint bias as shared unknowns, unless they are 0."""
        own_m, common_m = self._bias_sigmas_m()
        biases = [self._lasting(terms.keypoint_bias(i), own_m) for i in range(len(self.views))] if own_m.all() else []
        return biases, [self._lasting(terms.COMMON_KEYPOINT_BIAS, common_m)] if common_m.all() else []

    def _shape_unknowns(self) -> list[SharedUnknown]:
        """Return the lengths and any keypoint offsets of a body of unknown shape as shared unknowns."""
        if self.shape is None:
            return []
        length_scale, offset_scale = self.shape_scale
        sigma = constants.LENGTH_SHARE * length_scale * self.body.size_sigma
        lengths = self._lasting(terms.LENGTHS, np.full(len(self.shape.lengths), sigma))
        _, common_m = self._bias_sigmas_m()
        if not common_m.all():
            return [lengths]
        offset_share = constants.OFFSET_SHARE * offset_scale if self.solves_shape else 1.0
        return [lengths, self._lasting(terms.COMMON_KEYPOINT_BIAS, offset_share * common_m)]

    def _pose_sigmas(self, shifts_m: Array) -> dict[int, Array]:
        """Return the standard deviations (6,), rad and m, of the pose's errors for each camera whose pose is uncertain.

        The poses of two cameras are uncertain even if they are not refined, unless they are known to be exact.
        `shifts_m` (V,) are the standard deviations of the cameras' positions relative to the first.
        """
        options, V = self.options, len(self.views)
        if options.refine_cameras and not options.refine_first:
            rotation_rad = constants.CAMERA_ROTATION_RAD
            return {i: np.repeat([rotation_rad, shifts_m[i]], 3) for i in range(1, V)}
        if V != 2 or options.cameras_known:
            return {}
        if self.size_sigma > ROUGH_SIZE_SIGMA:
            return {1: np.repeat([constants.CALIBRATED_RAD, shifts_m[1]], 3)}
        return dict.fromkeys(range(2), constants.SHARE_OF_PAIR * np.repeat([constants.CALIBRATED_RAD, shifts_m[1]], 3))

    @property
    def _single_length_sigmas(self) -> Array:
        """Return the relative standard deviations (L,) of the lengths, which a fit of one camera cannot estimate."""
        assert self.shape is not None
        fraction = max(constants.LENGTH_SIGMA, constants.LENGTH_SHARE * self.body.size_sigma)
        return np.full(len(self.shape.lengths), fraction)

    def shifts_m(self, around_m: Array, size: float) -> Array:
        """Return the prior standard deviation of each camera's position, smaller if the animal is close, (V,), m.

        `around_m` (T, J, 3) are the markers at nominal size, m, and `size` is the size of the animal.
        """
        middle = self.in_world(around_m.mean(axis=1), size)
        distances_m = [np.median(np.linalg.norm(middle - view.centre_m, axis=1)) for view in self.views]
        return np.minimum(constants.CAMERA_SHIFT_M, constants.CAMERA_SHIFT_SHARE * np.array(distances_m))

    def problem(
        self,
        noise_px: Array,
        temperature: float | None = None,
        contact_terms: Sequence[terms.Term] = (),
        around_m: Array | None = None,
        size: float = 1.0,
    ) -> LeastSquares:
        """Return the least-squares problem of the clip with all of its terms.

        This method selects all terms except the terms of the feet, which `contacts` makes.

        Parameters
        ----------
        noise_px
            Standard deviation of each detection, (V, T, J), pixels.
        temperature
            Temperature of the prior's mixture of poses; None replaces the mixture with one Gaussian.
        contact_terms
            Terms of the feet and the ground, from `contacts`.
        around_m
            Markers of a solution at nominal size, (T, J, 3), metres; None keeps the shared unknowns fixed.
        size
            Size of the animal in the solution, a factor on the body's lengths.
        """
        D, T = self.body.n_state, len(self)
        rear, front = (self.body.markers.index(marker) for marker in self.body.forward)
        reprojections = [
            terms.Reprojection(view, sigma_px, constants.ROBUST_C, self.origin_m, i)
            for i, (view, sigma_px) in enumerate(zip(self.views, noise_px, strict=True))
        ]
        shared, nuisance = ([], []) if around_m is None else self.shared_unknowns(self.shifts_m(around_m, size))
        if around_m is not None:
            drift_m = np.gradient(around_m, axis=0) if T > 1 else np.zeros_like(around_m)
            px_per_m = self.px_per_m(around_m, size)
            reprojections = [
                replace(term, drift_m=drift_m, px_per_m=px) for term, px in zip(reprojections, px_per_m, strict=True)
            ]
        pose_weight, motion_weight = (
            weight * self.prior_weight for weight in (constants.POSE_WEIGHT, constants.MOTION_WEIGHT)
        )
        scale = np.ones(D) if self.acceleration_scale is None else self.acceleration_scale
        root_m_s2 = np.array(constants.ACCELERATION_M_S2) * scale[ROOT]
        yaw_rad_s2 = constants.YAW_ACCELERATION_RAD_S2 * float(scale[YAW])
        linear = [
            terms.climb_term(D, self.fps, constants.CLIMB_M_S),
            terms.root_term(D, self.fps, root_m_s2, yaw_rad_s2),
        ]
        prior = self.prior if self.acceleration_scale is None else self.prior.with_accelerations(scale[ANGLES])
        linear.append(terms.dynamics_term(prior, D, self.fps, motion_weight))
        nonlinear: list[terms.Term] = [*reprojections]
        if temperature is None:
            linear.append(terms.pose_term(self.prior, D, self.fps, pose_weight))
        else:
            nonlinear.append(terms.PoseMixture(self.prior, self.fps, pose_weight, temperature))
        if self.prior_weight < 1:
            linear.append(terms.pose_term(self.body_prior, D, self.fps, constants.POSE_WEIGHT - pose_weight))
            linear.append(terms.dynamics_term(self.body_prior, D, self.fps, constants.MOTION_WEIGHT - motion_weight))
        if self.known_states is not None:
            nonlinear.append(terms.KnownAngles(self.known_states))
        if T > 1:
            nonlinear.append(terms.Heading(rear, front, self.fps, constants.LATERAL_M_S))
        every_term, shape = [*nonlinear, *contact_terms], None if around_m is None else self.shape
        return LeastSquares(self.body.detected, linear, every_term, shared, nuisance, frames_per_piece(self.fps), shape)


LOW_FEET = 0.1
"""Quantile, over the frames, of the height of the lowest foot, at which this foot is assumed to stand on the ground.

The value is an assumption. Feet that are placed too low by an error in some frames then do not lower the ground.
"""
OFF_ZERO_SIGMAS = 2.0
"""Maximum distance of the lowest feet from z = 0, in standard deviations, for a ground that is expected near z = 0.

The value is an assumption. Beyond this distance, the fit ignores z = 0 and finds the ground from the feet alone.
"""


def sigmas_above_ground(clip: ClipProblem, points_m: Array, size: float = 1.0) -> float:
    """Return the height above z = 0 of the lowest feet in markers (T, J, 3), in standard deviations of this height."""
    low_m = float(np.quantile(points_m[:, clip.feet, 2].min(axis=1), LOW_FEET))
    sigma_m = float(np.hypot(constants.GROUND_HEIGHT_M, clip.size_sigma * low_m))
    return (float(clip.origin_m[2]) / size + low_m) / sigma_m


def contacts(clip: ClipProblem, points_m: Array, size: float) -> tuple[Array, Ground | None, tuple[terms.Term, ...]]:
    """Return the contact weights (T, F) of the feet, the ground, and the cost terms of both.

    `points_m` are the markers (T, J, 3) at nominal size. The ground is a plane through the feet in stance, fitted by
    reweighted least squares. The ground is None if too few feet stand. If the clip has no ground to find
    (`ClipProblem.finds_ground`), all weights are 0, and there are no terms.
    """
    feet = clip.feet
    if not clip.finds_ground:
        return np.zeros((len(clip), len(feet))), None, ()
    stance = terms.StanceVelocity(feet, clip.fps, constants.SLIP_M_S, constants.SLIP_C)
    _, _, slow = stance.contact(points_m, size)
    if len(clip.views) == 1 and clip.shows_size:
        stance = replace(stance, at=size, by_size=_stance_by_size(clip, points_m, size, slow))
    middle = 0.5 * (points_m[1:, feet] + points_m[:-1, feet])
    near_zero = abs(sigmas_above_ground(clip, points_m, size)) < OFF_ZERO_SIGMAS if clip.ground_known else None
    height, sigma = float(np.percentile(middle[..., 2], 10)), 10.0
    if near_zero:
        height = -float(clip.origin_m[2]) / size
        sigma = float(np.hypot(constants.GROUND_HEIGHT_M, clip.size_sigma * height))
    contact, plane, centre, covariance = _fit_plane(middle, slow, height, sigma, clip.fps)
    contact_of_frames = np.concatenate([contact[:1], np.maximum(contact[1:], contact[:-1]), contact[-1:]])
    if contact.sum() < 3:  # too few feet stand to determine the ground
        return contact_of_frames, None, (stance,)
    # Several cameras see the height of the ground, and a plane at nominal size would bias the size. Refined cameras
    # see the height less well.
    in_world = len(clip.views) > 1 and (near_zero or not clip.options.refine_cameras)
    plane_size = size if in_world else None
    on_ground = terms.OnGround(feet, contact, plane, centre, clip.fps, constants.GROUND_FOOT_M, plane_size)
    slope = plane[1:]
    sigma = float(np.sqrt(covariance[0, 0] * clip.correlation_frames))
    ground = Ground(float(plane[0] - slope @ centre), slope, sigma, near_zero)
    return contact_of_frames, ground, (stance, on_ground)


def _stance_by_size(clip: ClipProblem, points_m: Array, size: float, slow: Array) -> Array:
    """Return the derivatives (T - 1, F, 3) of the feet's velocities with respect to the size, for one moving camera.

    Standing feet show the size: with a wrong size they would appear to move with the camera, while swinging feet move
    in any case. If the camera moves along with the animal, feet appear to move both forwards and backwards, and all of
    them get more weight. `slow` (T - 1, F) holds weights, 1 for a foot that stands and 0 for a foot that swings.
    """
    camera = np.diff(clip.views[0].centre_m, axis=0)[:, None]
    # the body's motion between frames if the animal had the expected size
    body = np.diff(points_m.mean(axis=1), axis=0)[:, None] + (1.0 - 1.0 / size) * camera
    co_movement = np.clip(np.sum(body * camera) / max(np.sum(body**2), 1e-12), 0.0, 1.0)
    seen_velocity = (1.0 - co_movement) * np.where(slow[..., None] > 0.5, 0.0, camera) / size
    return (seen_velocity + co_movement * np.diff(points_m[:, clip.feet], axis=0)) * clip.fps


class _GroundPlane(NamedTuple):
    """A plane under F feet, fitted to N pairs of neighbouring frames."""

    contact: Array
    """Weights of the feet, shape (N, F), 1 for a slow foot on the plane."""
    plane: Array
    """Height at `centre`, m, and slopes along x and y, shape (3,)."""
    centre: Array
    """Median x and y of the feet, m, shape (2,)."""
    covariance: Array
    """Covariance of `plane`, shape (3, 3)."""


def _fit_plane(middle: Array, slow: Array, height: float, sigma: float, fps: float) -> _GroundPlane:
    """Fit the ground to feet (N, F, 3) with weights `slow` (N, F), which are 1 for a foot that does not move.

    `height` and `sigma` are the ground's expected height and its standard deviation, m. Each round reduces the weights
    of feet far from the last plane (Geman-McClure).
    """
    spread = np.array([sigma, constants.GROUND_SLOPE, constants.GROUND_SLOPE])
    centre = np.median(middle[..., :2].reshape(-1, 2), axis=0)
    rows = np.concatenate([np.ones((*middle.shape[:2], 1)), middle[..., :2] - centre], axis=-1)
    plane, covariance, contact = np.array([height, 0.0, 0.0]), np.diag(spread**2), slow
    count = terms.REFERENCE_HZ / fps / constants.GROUND_FOOT_M**2
    for _ in range(5):
        above = middle[..., 2] - rows @ plane
        contact = slow / (1.0 + (above / (3 * constants.GROUND_FOOT_M)) ** 2) ** 2
        normal = np.einsum("tf,tfa,tfb->ab", contact, rows, rows) * count + np.diag(spread**-2.0)
        covariance = np.linalg.inv(normal)
        pull = np.einsum("tf,tfa,tf->a", contact, rows, middle[..., 2]) * count + spread**-2.0 * (height, 0.0, 0.0)
        plane = covariance @ pull
    return _GroundPlane(contact, plane, centre, covariance)
