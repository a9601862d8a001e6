"""Define the terms that a fit of a trajectory minimises, as functions that return a `Linear` term and as classes.

**Idea.** A term compares the states of a few neighbouring frames with detections or with an expectation, and adds the
weighted deviation to the cost. `Reprojection` compares with the detections, `pose_term`, `PoseMixture` and
`dynamics_term` with the prior, `root_term`, `climb_term` and `Heading` with a smooth run forward, `StanceVelocity` and
`OnGround` with feet in stance, and `KnownAngles` with given states.

**Input and output.** A term gets N consecutive frames (`Span`) and returns its cost (N,), its residual r (N, M), the
Jacobian J (N, M, S, D) and a dictionary of the derivatives (N, M, P) by unknowns that all frames share. J'r is
the exact gradient of the cost, and J'J its curvature. Residuals are divided by standard deviations and multiplied by
the square root of a robust loss's slope, so the cost is not half of r'r. The stencil (S,) holds the offsets of the
frames that a residual reads. The offsets are at most (-1, 0, 1) in a `Linear` term, and (0, 1) in a class, because
spans overlap by one frame.

**Size.** States belong to a body of nominal size in a scene about an origin, the first camera's centre. The point p of
this scene lies at origin + size p in the world. Larger animals move further in proportion, so neither a prior nor a
camera that stays at the origin can determine the size. The `Reprojection` of other cameras determines it.
`StanceVelocity` and a plane that is fixed in the world (`OnGround.at`) read the size too, but hardly add to its
precision.

**Frame rate.** Errors of the prior persist over many frames. The weight of a prior per second is therefore the same at
every frame rate (`REFERENCE_HZ`).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property, reduce
from typing import NamedTuple, Protocol

import numpy as np

from recon.animal.prior import ANGLES, MotionPrior
from recon.base.arrays import Array, Bools, Index, Integers
from recon.clip import View
from recon.geometry.frames import euler_rotation_with_jacobian
from recon.geometry.kinematics import ROOT, YAW, TreePose

SIZE = "size"
"""Name of the shared unknown that is a factor on all lengths of the animal."""
COMMON_KEYPOINT_BIAS = "common keypoint bias"
"""Name of the shared unknowns (3J,) of the keypoint bias that all cameras have in common, m.

The bias is given in the frames of the markers' segments.

The fit estimates the bias if the body's shape is unknown. Otherwise the bias only adds to the uncertainty.
"""
LENGTHS = "segment lengths"
"""Name of the shared unknowns (L,) that are logarithms of factors on lengths, the same on both sides."""
SIDESLIP = "sideslip"
"""Name of the shared unknown angle from the animal's trunk to its direction of travel, rad, positive to the left."""
REFERENCE_HZ = 90.0
"""Frame rate (Hz) at which the weights of the priors are 1 for each frame."""
OUT_OF_SIGHT = 50.0
"""Loss, in units of c^2 / 2, of a detected joint that the camera cannot project, for example behind it."""
POSE, MOTION, ROOT_ACCELERATION = "pose prior", "motion prior", "root acceleration"
PRIOR_TERMS = POSE, MOTION
"""Names of the terms of the prior. The terms of the body's own prior have the same names."""
ACCELERATION_TERMS = MOTION, ROOT_ACCELERATION
"""Names of the terms that penalise accelerations."""
_ONE, _ZERO = np.ones(1), np.zeros(1)


def time_offset(view: int) -> str:
    """Return the name of the shared unknown for the delay of a camera's pictures, in frames."""
    return f"time offset {view}"


def offset_values(offsets_frames: Array) -> dict[str, Array]:
    """Return the time offsets (V,) of V cameras, in frames, as a dictionary whose keys are names of shared unknowns."""
    return {time_offset(i): np.array([frames]) for i, frames in enumerate(offsets_frames)}


def keypoint_bias(view: int) -> str:
    """Return the name of the shared unknowns (2J,) for a view's keypoint bias, metres to the right and down."""
    return f"keypoint bias {view}"


def extrinsic_correction(view: int) -> str:
    """Return the name of the shared unknowns (6,) that correct a camera's pose, rad and m, as in `View.corrected`."""
    return f"extrinsic correction {view}"


def focal_scale(view: int) -> str:
    """Return the name of the shared unknown that is the logarithm of the factor on a camera's focal lengths."""
    return f"focal {view}"


def size_of(shared: Mapping[str, Array]) -> float:
    """Return the animal's size from the values of the shared unknowns, or 1 if the size is fixed."""
    return float(shared.get(SIZE, _ONE)[0])


def with_step(states: Array, step: Array, size: float, next_size: float) -> Array:
    """Return states (T, D) at nominal size moved by a step (T, D), while the animal's size changes to `next_size`.

    The animal's position in the world changes linearly along the step. The position is the size times the root, so the
    step of the root is divided by the growth of the size.
    """
    moved = states + step
    moved[:, ROOT] = states[:, ROOT] + size / next_size * step[:, ROOT]
    return moved


@dataclass(frozen=True)
class Span:
    """Consecutive frames of a clip, from frame `first` on, with their markers and the unknowns that all frames share.

    Unless `is_last` is true, the last frame is included only for stencils that reach it.
    """

    first: int
    states: Array
    """Unknowns of each frame, shape (n, D)."""
    pose: TreePose
    is_last: bool
    shared: Mapping[str, Array] = field(default_factory=dict)
    rotations: Array | None = None
    """Rotations of the markers' segments, shape (n, J, 3, 3), for derivatives with respect to `COMMON_KEYPOINT_BIAS`.

    None if the bias is fixed, or if the lengths are unknowns too, so that `recon.fit.body_shape.FreeShape` gives them.
    """

    @property
    def own_rows(self) -> slice:
        """Return the slice of the span's own frames, without the last frame if the next span begins with it."""
        return slice(0, len(self.states) - (not self.is_last))


@dataclass(frozen=True)
class TermRows:
    """Cost (N,), residual (N, M), Jacobian (N, M, S, D) and derivatives by shared unknowns (N, M, P) of a term.

    If no Jacobian was requested, all but the cost are empty.
    """

    cost: Array
    residual: Array = field(default_factory=lambda: _ZERO[:0])
    jacobian: Array = field(default_factory=lambda: _ZERO[:0])
    by_shared: Mapping[str, Array] = field(default_factory=dict)


@dataclass(frozen=True)
class PointRows:
    """Residuals of one camera's detections, with derivatives with respect to the markers instead of the states."""

    cost: Array
    """Cost of the detections in each frame, shape (N,)."""
    residual: Array
    """Weighted residuals of the detections, shape (N, J, 2)."""
    by_point: Array
    """Derivatives of the residuals with respect to the markers at nominal size, 1/m, shape (N, J, 2, 3)."""
    by_shared: dict[str, Array]
    """Derivatives (N, 2J, P) of the residuals by the size and the camera's unknowns except its keypoint bias.

    The keys are the names of the unknowns.
    """
    number: int = 0
    """Index of the view among the clip's views."""
    by_bias: Array | None = None
    """Derivatives of each residual with respect to the same coordinate of the joint's keypoint bias, shape (N, J).

    The derivatives are None if the bias is fixed.
    """


@dataclass(frozen=True)
class FootRows:
    """M residuals of each of F feet, with derivatives with respect to the foot in each of n frames and the next one."""

    feet: Index
    """Indices (F,) of the feet's markers."""
    cost: Array
    """Cost of the feet in each frame, shape (n,)."""
    residual: Array
    """Weighted residuals, shape (n, F, M)."""
    directions: Array
    """Directions of a foot's movement to which its residuals respond, shape (M, 3)."""
    scales: tuple[Array, Array]
    """Factors (n, F) on `directions` that give the derivatives with respect to the foot at nominal size, 1/m.

    The first belong to the foot in the residual's frame, the second to the foot in the next frame.
    """
    by_size: Array | None = None
    """Derivatives with respect to the size, shape (n, F, M); None if the size is fixed or has no influence."""

    def as_term_rows(self, jacobian: Array) -> TermRows:
        """Return the residuals with derivatives by the states, given those (n + 1, J, 3, D) of all markers."""
        n, F, M = self.residual.shape
        moved = self.directions @ jacobian[:, self.feet]
        rows = np.stack(
            [moved[slot : n + slot] * scale[..., None, None] for slot, scale in enumerate(self.scales)], axis=3
        )
        by_shared = {} if self.by_size is None else {SIZE: self.by_size.reshape(n, F * M, 1)}
        return TermRows(self.cost, self.residual.reshape(n, F * M), rows.reshape(n, F * M, 2, -1), by_shared)


class ReprojectionErrors(NamedTuple):
    """Errors of the detections of J markers in N frames of one camera."""

    cost: Array
    """Cost of each frame, shape (N,)."""
    in_sigmas: Array
    """Errors in standard deviations, 0 for markers that are not seen, shape (N, J, 2)."""
    squares: Array
    """Squared errors divided by the squared width c of the robust loss, shape (N, J)."""
    seen: Bools
    """Mask of the markers that are detected and can be projected, shape (N, J)."""
    confidence: Array
    """Confidence of the detections, 0 for missing ones, shape (N, J)."""
    unbiased_px: Array
    """Projected markers without keypoint bias, px, shape (N, J, 2)."""
    by_point: Array
    """Derivatives of `unbiased_px` with respect to the markers, px/m, shape (N, J, 2, 3); empty unless requested."""


class Term(Protocol):
    """Term of the least-squares problem, which gives residuals and derivatives for a span of frames."""

    @property
    def name(self) -> str:
        """Return the name of the term in lists of costs and in `recon.check.inputs.MAX_PATH_COSTS`."""
        ...

    @property
    def stencil(self) -> tuple[int, ...]:
        """Return the offsets (S,) of the frames on which a residual depends, relative to the residual's own frame."""
        ...

    def evaluate(self, span: Span, jacobian: bool) -> TermRows:
        """Return the term's cost in each frame of a span and, if `jacobian` is true, its residual and derivatives."""
        ...


@dataclass(frozen=True)
class Linear:
    """Gaussian term with a constant Jacobian and the residual r = sum_s slots[s] x(frame + stencil[s]) - target.

    The term applies to every frame whose stencil is within the clip. `slots` (S, M, D) and `target` (M,) are divided by
    standard deviations.
    """

    name: str
    stencil: tuple[int, ...]
    slots: Array
    target: Array

    @cached_property
    def curvature(self) -> dict[tuple[int, int], Array]:
        """Return the blocks (D, D) of J'J, keyed by column and row, which are offsets of the stencil."""
        return {
            (column, row): self.slots[b].T @ self.slots[a]
            for a, column in enumerate(self.stencil)
            for b, row in enumerate(self.stencil[a:], start=a)
        }

    def frames(self, T: int) -> Index:
        """Return the frames (N,) of a clip of T frames whose stencil is within the clip."""
        return np.arange(-self.stencil[0], max(T - self.stencil[-1], -self.stencil[0]))

    def residual(self, states: Array) -> Array:
        """Return the residual (N, M) for the states (T, D) of a whole clip."""
        first = -self.stencil[0]
        stop = max(len(states) - self.stencil[-1], first)
        r = np.empty((stop - first, len(self.target)))
        r[:] = -self.target
        for offset, slot in zip(self.stencil, self.slots, strict=True):
            r += states[first + offset : stop + offset] @ slot.T
        return r


def _rate(fps: float, weight: float) -> float:
    """Return the factor on a term's residuals that gives the term the same weight per second at every frame rate."""
    return float(np.sqrt(weight * REFERENCE_HZ / fps))


def pose_term(prior: MotionPrior, n_state: int, fps: float, weight: float) -> Linear:
    """Return the cost term that keeps the angles near the mean pose of the prior, which is taken as a single Gaussian.

    `n_state` is the number of columns of a state, `fps` the frame rate in Hz, and `weight` the weight of the term.
    """
    rows = np.zeros((len(prior.mean), n_state))
    rows[:, ANGLES] = prior.pose_whitener * _rate(fps, weight)
    return Linear(POSE, (0,), rows[None], rows[:, ANGLES] @ prior.mean)


def dynamics_term(prior: MotionPrior, n_state: int, fps: float, weight: float) -> Linear:
    """Return the cost term that keeps the angles' accelerations near a linear function of angles and rates.

    The prior gives this function. The parameters are as in `pose_term`.
    """
    A = len(prior.mean)
    white = prior.acceleration_whitener * _rate(fps, weight)
    by_angle, by_rate = prior.drift[:, :A], prior.drift[:, A:]
    slots = np.zeros((3, A, n_state))
    for slot, bend, slope in zip(slots, (1.0, -2.0, 1.0), (-0.5, 0.0, 0.5), strict=True):
        slot[:, ANGLES] = white @ (bend * fps**2 * np.eye(A) - slope * fps * by_rate)
    slots[1][:, ANGLES] -= white @ by_angle
    return Linear(MOTION, (-1, 0, 1), slots, -white @ by_angle @ prior.mean)


def root_term(n_state: int, fps: float, acceleration_m_s2: Array, yaw_acceleration_rad_s2: float) -> Linear:
    """Return the cost term that keeps the root's acceleration (x, y horizontal, z up) and yaw acceleration near 0.

    `acceleration_m_s2` (3,) and `yaw_acceleration_rad_s2` are the standard deviations of these accelerations.
    `n_state` is the number of columns of a state, and `fps` the frame rate in Hz.
    """
    rows = np.zeros((4, n_state))
    rows[:3, ROOT] = np.diag(1.0 / np.asarray(acceleration_m_s2))
    rows[3, YAW] = 1.0 / yaw_acceleration_rad_s2
    rows *= fps**2 * _rate(fps, 1.0)
    return Linear(ROOT_ACCELERATION, (-1, 0, 1), np.array([rows, -2 * rows, rows]), np.zeros(4))


def climb_term(n_state: int, fps: float, sigma_m_s: float) -> Linear:
    """Return the cost term that keeps the root from climbing or sinking fast.

    `sigma_m_s` is the standard deviation of the vertical velocity. The other parameters are as in `root_term`.
    """
    row = np.zeros((1, n_state))
    row[0, 2] = fps / sigma_m_s * _rate(fps, 1.0)
    return Linear("climb", (0, 1), np.array([-row, row]), np.zeros(1))


@dataclass(frozen=True)
class PoseMixture:
    """Term that keeps the pose likely under a mixture of Gaussians, -log sum_k w_k N(z; mean_k, cov_k).

    A temperature of 1 or more flattens the mixture. The residuals belong to a Gaussian with the mixture's gradient. The
    Gaussian's precision is the mean of the components' precisions, weighted by their posterior probabilities.
    """

    prior: MotionPrior
    fps: float
    weight: float
    temperature: float = 1.0
    name: str = POSE
    stencil: tuple[int, ...] = (0,)
    _precision: Array = field(init=False, repr=False)
    _offset: Array = field(init=False, repr=False)

    def __post_init__(self) -> None:
        white = self.prior.mixture_whiteners
        offset = -np.log(self.prior.weights) - np.log(np.diagonal(white, axis1=1, axis2=2)).sum(axis=1)
        object.__setattr__(self, "_precision", white.swapaxes(1, 2) @ white)
        object.__setattr__(self, "_offset", offset - offset.min())

    def evaluate(self, span: Span, jacobian: bool) -> TermRows:
        """Return this term's cost in each frame of a span and, if `jacobian` is true, its residual and derivatives."""
        cost, gradient, precision = self._expanded(span, jacobian)
        if not jacobian:
            return TermRows(cost)
        N, A = gradient.shape
        root = np.linalg.cholesky(precision)  # root root' = precision; rows root' dz, residual root^-1 gradient
        rows = np.zeros((N, A, 1, span.states.shape[1]))
        rows[:, :, 0, ANGLES] = root.swapaxes(1, 2)
        residual = np.asarray(np.linalg.solve(root, gradient[..., None])[..., 0], dtype=float)
        return TermRows(cost, residual, rows)

    def add_normal(self, span: Span, blocks: Array, gradient: Array) -> Array:
        """Add the curvature to a span's blocks (N, D, D) and the gradient to its gradient (N, D), in place.

        The curvature and the gradient equal J'J and J'r from `evaluate`, but need no Cholesky root. The result is the
        cost in each frame, (N,).
        """
        cost, by_angles, precision = self._expanded(span, jacobian=True)
        gradient[:, ANGLES] += by_angles
        blocks[:, ANGLES, ANGLES] += precision
        return cost

    def _expanded(self, span: Span, jacobian: bool) -> tuple[Array, Array, Array]:
        """Return the cost (N,), and with `jacobian` its gradient (N, A) and curvature (N, A, A) for the angles."""
        z = span.states[span.own_rows, ANGLES]
        N, A = z.shape
        deviation = z - self.prior.means[:, None]  # (K, N, A)
        pull = deviation @ self._precision
        level = 0.5 * np.sum(deviation * pull, axis=2).T + self._offset
        least = level.min(axis=1, keepdims=True)
        fraction = np.exp(-(level - least) / self.temperature)
        total = fraction.sum(axis=1)
        weight = self.weight * REFERENCE_HZ / self.fps
        cost = weight * (least[:, 0] - self.temperature * np.log(total))
        if not jacobian:
            return cost, _ZERO[:0], _ZERO[:0]
        fraction *= weight / total[:, None]
        gradient = np.sum(fraction.T[..., None] * pull, axis=0)
        precision = (fraction @ self._precision.reshape(-1, A * A)).reshape(N, A, A)
        return cost, gradient, precision


@dataclass(frozen=True)
class Scene:
    """Markers and camera of a view in N frames, for given values of the unknowns that all frames share."""

    frames: slice
    """Frames of the clip to which the pictures belong."""
    parts: list[tuple[slice, float]]
    """Frames of the span between which each picture was taken, and their interpolation weights."""
    points_m: Array
    """Markers of a body of nominal size at the times of the pictures, relative to the origin, m, shape (N, J, 3)."""
    size: float
    world_m: Array
    """Markers in the world, m, shape (N, J, 3)."""
    given_view: View
    """The view before its camera is corrected."""
    view: View
    sigma_px: Array
    """Standard deviation of the detections, shape (N, J)."""


@dataclass(frozen=True)
class Reprojection:
    """Term that keeps projected markers near their detections, with one robust loss for each detection.

    The loss of an error e is c^2/2 log(1 + |e|^2 / (c sigma)^2) (Cauchy), times the view's confidence. `sigma_px` (T,
    J) is held fixed during a search, because a noise that followed the depth would influence the distance.
    """

    view: View
    sigma_px: Array
    c: float
    origin_m: Array
    number: int = 0
    """Index of the view, which the names of the view's own unknowns contain."""
    drift_m: Array | None = None
    """Fixed movement (m) of the markers per frame at nominal size, shape (T, J, 3); None without a time offset."""
    px_per_m: Array | None = None
    """Fixed image scale at the animal's distance, pixels per metre, shape (T,); None without a `keypoint_bias`."""
    name: str = "reprojection"

    def on_own_markers(self, count: int) -> tuple[Integers, Reprojection]:
        """Return the indices of all `count` markers, and this term unchanged.

        Other terms depend on some markers only, and return a term for these markers.
        """
        return np.arange(count), self

    @property
    def stencil(self) -> tuple[int, ...]:
        """Return the offsets of the frames between which the pictures were taken."""
        return (0, 1) if self.view.offset_frames else (0,)

    def evaluate(self, span: Span, jacobian: bool) -> TermRows:
        """Return this term's cost in each frame of a span and, if `jacobian` is true, its residual and derivatives."""
        if not jacobian:
            return TermRows(self._errors(self._scene(span), span, jacobian=False).cost)
        points, parts = self.point_rows(span), self._parts(span)
        (N, J), D = points.residual.shape[:2], span.pose.jacobian.shape[-1]
        slots = []
        for part, fraction in parts:
            by_point = points.by_point if fraction == 1.0 else points.by_point * fraction
            slots.append((by_point @ span.pose.jacobian[part]).reshape(N, 2 * J, 1, D))
        rows = slots[0] if len(slots) == 1 else np.concatenate(slots, axis=2)
        by_shared = points.by_shared
        if points.by_bias is not None:
            by_shared = by_shared | {
                keypoint_bias(self.number): np.repeat(points.by_bias, 2, axis=1)[..., None] * np.eye(2 * J)
            }
        if span.rotations is not None:
            by_common_bias, joints = np.zeros((N, J, 2, J, 3)), np.arange(J)
            for part, fraction in parts:
                by_common_bias[:, joints, :, joints] += (points.by_point * fraction @ span.rotations[part]).swapaxes(
                    0, 1
                )
            by_shared = by_shared | {COMMON_KEYPOINT_BIAS: by_common_bias.reshape(N, 2 * J, 3 * J)}
        return TermRows(points.cost, points.residual.reshape(N, 2 * J), rows, by_shared)

    def point_rows(self, span: Span) -> PointRows:
        """Return the residuals of the detections, with derivatives with respect to markers and shared unknowns."""
        scene = self._scene(span)
        return self._rows_of(span, scene, self._errors(scene, span, jacobian=True))

    def _rows_of(self, span: Span, scene: Scene, errors: ReprojectionErrors) -> PointRows:
        """Return the weighted residuals of the detections with their derivatives, from the errors."""
        view, weight = scene.view, self.weights_of(scene, errors)
        by_point = errors.by_point * weight[..., None, None]
        N, J = errors.squares.shape  # N is 0 for a single frame without the next one
        by_shared = self._by_scene(span, scene, by_point)
        by_bias = None
        if self._bias_m(span) is not None and self.px_per_m is not None:
            by_bias = weight * self.px_per_m[scene.frames, None]
        if focal_scale(self.number) in span.shared:
            off_centre = np.where(errors.seen[..., None], errors.unbiased_px - view.camera.matrix[:2, 2], 0.0)
            by_shared[focal_scale(self.number)] = (off_centre * weight[..., None]).reshape(N, 2 * J, 1)
        if (correction := span.shared.get(extrinsic_correction(self.number))) is not None:
            by_camera = by_point @ view.rotation.swapaxes(-1, -2)
            in_camera = scene.given_view.to_camera(scene.world_m)
            rotation = euler_rotation_with_jacobian(correction[:3])[1] @ in_camera[..., None, :, None]
            by_correction = np.concatenate([by_camera @ rotation[..., 0].swapaxes(-1, -2), by_camera], axis=-1)
            by_shared[extrinsic_correction(self.number)] = by_correction.reshape(N, 2 * J, 6)
        residual = errors.in_sigmas * (weight * scene.sigma_px)[..., None]
        return PointRows(errors.cost, residual, by_point * scene.size, by_shared, self.number, by_bias)

    def _errors(self, scene: Scene, span: Span, jacobian: bool) -> ReprojectionErrors:
        """Project the markers, and return their distances from the detections with the cost of these errors."""
        view = scene.view
        if jacobian:
            projected, by_point, valid = view.project_with_jacobian(scene.world_m)
        else:
            (projected, valid), by_point = view.project(scene.world_m), _ZERO[:0]
        unbiased_px, bias_m = projected, self._bias_m(span)
        if bias_m is not None and self.px_per_m is not None:
            projected = projected + self.px_per_m[scene.frames, None, None] * bias_m.reshape(-1, 2)
        present = view.present
        seen = present & valid
        e = np.empty(projected.shape)
        for axis in (0, 1):
            e[..., axis] = np.where(seen, projected[..., axis] - view.xy_px[..., axis], 0.0) / scene.sigma_px
        q = (e[..., 0] ** 2 + e[..., 1] ** 2) / self.c**2  # numpy is slow if the last axis has two values
        confidence = np.where(present, view.confidence, 0.0)
        loss = np.where(valid, np.log1p(q), OUT_OF_SIGHT)
        cost = 0.5 * self.c**2 * np.sum(loss * confidence, axis=1)
        return ReprojectionErrors(cost, e, q, seen, confidence, unbiased_px, by_point)

    def weights_of(self, scene: Scene, errors: ReprojectionErrors) -> Array:
        """Return the factors (N, J) that turn errors in pixels into residuals, 0 for markers that are not seen."""
        return np.sqrt(np.where(errors.seen, errors.confidence / (1.0 + errors.squares), 0.0)) / scene.sigma_px

    def _scene(self, span: Span) -> Scene:
        """Return the markers at the times of the view's pictures, and the view with its camera corrected."""
        parts = self._parts(span)
        points_m = reduce(np.add, (fraction * span.pose.points_m[part] for part, fraction in parts))
        frames = slice(span.first, span.first + len(points_m))
        delay = span.shared.get(time_offset(self.number))
        if delay is not None and self.drift_m is not None:
            points_m = points_m + delay * self.drift_m[frames]
        size = size_of(span.shared)
        given_view = view = self.view.part(frames)
        if (correction := span.shared.get(extrinsic_correction(self.number))) is not None:
            view = view.corrected(correction)
        if (log_focal := span.shared.get(focal_scale(self.number))) is not None:
            view = view.with_focal_scale(float(log_focal[0]))
        world_m = self.origin_m + size * points_m
        return Scene(frames, parts, points_m, size, world_m, given_view, view, self.sigma_px[frames])

    def _bias_m(self, span: Span) -> Array | None:
        return span.shared.get(keypoint_bias(self.number))

    def _by_scene(self, span: Span, scene: Scene, by_point: Array) -> dict[str, Array]:
        """Return the residuals' derivatives with respect to the size and the time offset, if they are unknowns."""
        N, J = by_point.shape[:2]
        by_shared: dict[str, Array] = {}
        if SIZE in span.shared:
            by_shared[SIZE] = np.einsum("njra,nja->njr", by_point, scene.points_m).reshape(N, 2 * J, 1)
        if time_offset(self.number) in span.shared and self.drift_m is not None:
            by_offset = scene.size * np.einsum("njra,nja->njr", by_point, self.drift_m[scene.frames])
            by_shared[time_offset(self.number)] = by_offset.reshape(N, 2 * J, 1)
        return by_shared

    def _parts(self, span: Span) -> list[tuple[slice, float]]:
        """Return the frames of the span between which each picture was taken, and their interpolation weights."""
        fraction, count = self.view.offset_frames, len(span.states)
        return (
            [(slice(0, count - 1), 1.0 - fraction), (slice(1, count), fraction)] if fraction else [(span.own_rows, 1.0)]
        )

    def weights(self, points_m: Array) -> Array:
        """Return the robust weights (T, J) of detections, 0 to 1, for markers (T, J, 3), m; NaN if missing."""
        projected, valid = self.view.project(points_m)
        q = np.sum((projected - self.view.xy_px) ** 2, axis=-1) / (self.c * self.sigma_px) ** 2
        return np.where(self.view.present, np.where(valid, 1.0 / (1.0 + q), 0.0), np.nan)


@dataclass(frozen=True, eq=False)
class KnownAngles:
    """Term that keeps the heading and the angles at given states (T, D), and leaves the position free.

    Frames without given states are NaN, and free.
    """

    states: Array
    sigma_rad: float = 1e-4
    name: str = "known angles"
    stencil: tuple[int, ...] = (0,)

    def evaluate(self, span: Span, jacobian: bool) -> TermRows:
        """Return this term's cost in each frame of a span and, if `jacobian` is true, its residual and derivatives."""
        states = span.states[span.own_rows]
        frames = slice(span.first, span.first + len(states))
        r = np.nan_to_num((states - self.states[frames])[:, YAW:] / self.sigma_rad)
        cost = 0.5 * np.sum(r * r, axis=1)
        if not jacobian:
            return TermRows(cost)
        known = np.isfinite(self.states[frames][:, YAW:])[..., None]
        rows = np.where(known, np.eye(states.shape[1])[YAW:] / self.sigma_rad, 0.0)
        return TermRows(cost, r, rows[:, :, None])


@dataclass(frozen=True)
class Heading:
    """Term that keeps the animal moving in the direction that it faces, or at an angle `SIDESLIP` to that direction.

    The residual of each pair of frames is the vertical component of (u x v) / sigma, where u is the level direction
    from the marker `rear` to `front` and v the root's velocity, m/s.
    """

    rear: int
    front: int
    fps: float
    sigma_m_s: float
    name: str = "heading"
    stencil: tuple[int, ...] = (0, 1)

    def on_own_markers(self, count: int) -> tuple[Integers, Heading]:
        """Return the indices of the markers that this term depends on, and a copy of the term for these markers alone.

        `count` is the body's number of markers, which only other terms need.
        """
        return np.array([self.rear, self.front]), replace(self, rear=0, front=1)

    def evaluate(self, span: Span, jacobian: bool) -> TermRows:
        """Return this term's cost in each frame of a span and, if `jacobian` is true, its residual and derivatives."""
        n = len(span.states) - 1
        forward = span.pose.points_m[:, self.front, :2] - span.pose.points_m[:, self.rear, :2]
        length = np.maximum(np.linalg.norm(forward, axis=1, keepdims=True), 1e-6)
        u = forward / length
        angle = float(span.shared.get(SIDESLIP, _ZERO)[0])
        sideslip_rotation = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
        v = np.diff(span.states[:, :2], axis=0) * self.fps @ sideslip_rotation.T
        scale = _rate(self.fps, 1.0) / self.sigma_m_s
        mean = 0.5 * (u[1:] + u[:-1])
        r = scale * (mean[:, 0] * v[:, 1] - mean[:, 1] * v[:, 0])
        if not jacobian:
            return TermRows(0.5 * r**2)
        D = span.pose.jacobian.shape[-1]
        rotation = span.pose.jacobian[:, self.front, :2] - span.pose.jacobian[:, self.rear, :2]  # (n + 1, 2, D)
        d_u = (rotation - u[..., None] * (u[:, None] @ rotation)) / length[..., None]
        rows = np.zeros((n, 1, 2, D))
        across = np.stack([v[:, 1], -v[:, 0]], axis=1)
        by_velocity = np.stack([-mean[:, 1], mean[:, 0]], axis=1) @ sideslip_rotation
        for slot, sign in enumerate((-1.0, 1.0)):
            rows[:, 0, slot] = 0.5 * scale * (across[:, None] @ d_u[slot : n + slot])[:, 0]
            rows[:, 0, slot, :2] += sign * scale * self.fps * by_velocity
        along = -scale * np.sum(mean * v, axis=1)
        by_shared = {SIDESLIP: along[:, None, None]} if SIDESLIP in span.shared else {}
        return TermRows(0.5 * r**2, r[:, None], rows, by_shared)


@dataclass(frozen=True)
class StanceVelocity:
    """Term that keeps nearly still feet (F,) at rest, by the Geman-McClure loss of their velocities, at most c^2 / 2.

    The velocities are measured in the world. Velocities of the body of nominal size would vanish if the animal were
    large enough, for example in front of a camera that follows it.

    `by_size` (n, F, 3) is the derivative of velocities with respect to the size about `at`, m/s, with fixed states. It
    is held fixed during a search. By default, velocities are proportional to the size. In the picture of one moving
    camera, the velocities relative to the camera are proportional to the size instead. A smaller animal then has slower
    feet if the camera is slow, which is no evidence of its size. Therefore `contacts` gives `by_size`.
    """

    feet: Index
    fps: float
    sigma_m_s: float
    c: float
    at: float = 1.0
    by_size: Array | None = None
    name: str = "stance"
    stencil: tuple[int, ...] = (0, 1)

    def on_own_markers(self, count: int) -> tuple[Integers, StanceVelocity]:
        """Return the indices of the markers that this term depends on, and a copy of the term for these markers alone.

        `count` is the body's number of markers, which only other terms need.
        """
        return np.asarray(self.feet), replace(self, feet=np.arange(len(self.feet)))

    def contact(self, points_m: Array, size: float) -> tuple[Array, Array, Array]:
        """Return the feet's velocity (n, F, 3) in m/s, its loss (n, F) and the loss's slope (n, F).

        The velocity is the change from each frame of markers (n + 1, J, 3) to the next. A slope of 1 means that the
        foot is in stance, and 0 that it is in swing.
        """
        v = np.diff(points_m[:, self.feet], axis=0) * self.fps * size
        return v, *self._loss(v)

    def _loss(self, v: Array) -> tuple[Array, Array]:
        q = np.sum(v * v, axis=-1) / self.sigma_m_s**2
        shrink = 1.0 / (1.0 + q / self.c**2)
        return q * shrink, shrink**2

    def evaluate(self, span: Span, jacobian: bool) -> TermRows:
        """Return this term's cost in each frame of a span and, if `jacobian` is true, its residual and derivatives."""
        if not jacobian:
            loss, _ = self._loss(self._velocity(span)[0])
            return TermRows(self._weight * 0.5 * loss.sum(axis=1))
        return self.foot_rows(span).as_term_rows(span.pose.jacobian)

    def foot_rows(self, span: Span) -> FootRows:
        """Return this term's cost and residuals, with derivatives with respect to the feet and the size."""
        v, factor, by_size = self._velocity(span)
        loss, slope = self._loss(v)
        root = np.sqrt(self._weight * slope)[..., None] / self.sigma_m_s
        later = factor * self.fps * root[..., 0]
        by_size = by_size * root if SIZE in span.shared else None
        cost = self._weight * 0.5 * loss.sum(axis=1)
        return FootRows(self.feet, cost, v * root, np.eye(3), (-later, later), by_size)

    @property
    def _weight(self) -> float:
        return REFERENCE_HZ / self.fps

    def _velocity(self, span: Span) -> tuple[Array, float, Array]:
        """Return the velocities (n, F, 3), the size about which they are linear, and their derivatives by the size."""
        size = size_of(span.shared)
        nominal = np.diff(span.pose.points_m[:, self.feet], axis=0) * self.fps
        if self.by_size is None:
            return size * nominal, size, nominal
        by_size = self.by_size[span.first : span.first + len(nominal)]
        return self.at * nominal + (size - self.at) * by_size, self.at, by_size


@dataclass(frozen=True)
class OnGround:
    """Term that keeps feet in stance on a plane.

    The residual of a foot is r = (z - height - slope . (x - middle)) sqrt(contact) / sigma.

    The coordinates x and z of the feet are multiplied by the size relative to `at`. `contact` (T - 1, F) holds fixed
    weights, `plane` (3,) the height in metres at `middle` (2,), also in metres, and the slopes along x and y.
    """

    feet: Index
    contact: Array
    plane: Array
    middle: Array
    fps: float
    sigma_m: float
    at: float | None = None
    """Size at which a plane that is fixed in the world was fitted; None if the plane scales with the animal's size."""
    name: str = "ground"
    stencil: tuple[int, ...] = (0, 1)

    def on_own_markers(self, count: int) -> tuple[Integers, OnGround]:
        """Return the indices of the markers that this term depends on, and a copy of the term for these markers alone.

        `count` is the body's number of markers, which only other terms need.
        """
        return np.asarray(self.feet), replace(self, feet=np.arange(len(self.feet)))

    def evaluate(self, span: Span, jacobian: bool) -> TermRows:
        """Return this term's cost in each frame of a span and, if `jacobian` is true, its residual and derivatives."""
        rows = self.foot_rows(span)
        return rows.as_term_rows(span.pose.jacobian) if jacobian else TermRows(rows.cost)

    def foot_rows(self, span: Span) -> FootRows:
        """Return this term's cost and residuals, with derivatives with respect to the feet and the size."""
        n = len(span.states) - 1
        frames = slice(span.first, span.first + n)
        foot = span.pose.points_m[:, self.feet]
        middle = 0.5 * (foot[1:] + foot[:-1])
        root = np.sqrt(self.contact[frames] * REFERENCE_HZ / self.fps) / self.sigma_m
        factor = 1.0 if self.at is None else size_of(span.shared) / self.at
        by_factor = middle[..., 2] - middle[..., :2] @ self.plane[1:]
        r = (factor * by_factor - self.plane[0] + self.middle @ self.plane[1:]) * root
        normal, scale = np.array([[-self.plane[1], -self.plane[2], 1.0]]), 0.5 * factor * root
        by_size = None if self.at is None or SIZE not in span.shared else (by_factor * root / self.at)[..., None]
        return FootRows(self.feet, 0.5 * np.sum(r * r, axis=1), r[..., None], normal, (scale, scale), by_size)


FOOT_TERMS = (StanceVelocity, OnGround)
"""Terms of the feet, each with a method `foot_rows`."""
MARKER_TERMS = (Reprojection, Heading, StanceVelocity, OnGround)
"""Terms that read the markers (`span.pose`), each with a method `on_own_markers`.

A new term that reads markers must be listed here. Otherwise a problem without another such term has no markers at all,
and fits that solve for lengths and offsets lack the term's derivatives.
"""
