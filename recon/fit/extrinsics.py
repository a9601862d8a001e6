"""Where cameras stand, from the animal alone: clips of a few seconds that the same cameras filmed.

1. Each view is solved by itself, which gives the joints in its own camera's frame, in metres of the animal's lengths.
2. The rigid motion that takes one camera's joints to the others', over all joints, frames and clips, robustly, is where
   that camera stands beside those already placed; the first is level.
3. All views of a clip are solved together with the cameras held. At the minimum everything of the clip's own (states,
   lags, and how far keypoints lie beside their markers in each view) is eliminated from the normal equations
   (`recon.fit.banded`), and the poses take the Gauss-Newton step of the sum over the clips, the first camera's tilt and
   roll with them. Up is where the ground under the feet, the animal's climb and its upright posture say. A few rounds
   of both lead to the minimum over all unknowns, and the inverse of the sum is the poses' covariance.

Where poses are known roughly, only the third is done, and the first camera stays; the distances between the cameras say
how large the animal is. Otherwise the scale is the animal's: its size is held at that of the body.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation
from threadpoolctl import threadpool_limits

from recon.base import Array, InputError, Problem, Progress, silent
from recon.clip import View
from recon.fit import constants
from recon.fit.banded import eliminated
from recon.fit.clip_problem import ClipProblem
from recon.fit.least_squares import Unknown
from recon.fit.terms import OnGround, extrinsic_correction, time_offset
from recon.fit.trajectory import SegmentFit, refined, solve_segments, solve_trajectory
from recon.geometry.frames import level_from_camera, rigid

_UNKNOWN_RAD, _UNKNOWN_M = float(np.radians(10.0)), 1.0
"""How far off the first poses are, about each axis and along it."""
LEVEL_RAD = float(np.radians(5.0))
"""How far cameras are from level, or from the tilt that is said, about each axis, if nobody looked."""
_HELD, _SIZE_SIGMA, _MIN_FRAMES = 1e-6, 1e-3, 5
_TIME_OFFSET_FRAMES = 1.0
"""How far out of step cameras are that began together: in two clips a camera's turn would stand for what is more."""
_SEARCHED_S = 1.0
"""How much later or earlier than said a camera may have begun."""
_ALIKE = 0.5
"""Joints are nowhere near others if they are off by more than that part of their distance from the animal's middle."""
ROUNDS, CLOSE_ENOUGH = 12, 0.05
"""Rounds at most, and the step, in standard deviations, that ends them."""


@dataclass(frozen=True, eq=False)
class Rig:
    """Where V cameras stand in a common world, in metres."""

    T_camera_world: tuple[Array, ...]
    """(4, 4) each. The world is the given one, or level, with the first camera in its origin."""
    sigma: Array
    """(V, 6): of each one's place beside the first, as in `View.corrected`."""
    ground_m: float
    """Height of the ground below the middle of the animal's longest path; NaN where none was found."""
    height_sigma_m: Array
    """(V,): of the cameras above it, NaN without."""
    disagreement: Array
    """(C, V): squared deviations by which each of C clips would have each camera elsewhere than all do together; about
    6 at most, from errors of the size that is stated."""
    time_offset_frames: tuple[Array, ...]
    """(V,) of each clip: how much later than said the cameras' pictures were taken; 0 of one that saw nothing."""
    converged: bool
    """Whether the last step was small."""


def solve_extrinsics(
    clips: Sequence[ClipProblem], posed: bool = False, level_rad: float = LEVEL_RAD, progress: Progress = silent
) -> Rig:
    """settings: of clips, each with the same V cameras in the same order; one that did not film a clip saw nothing
    in it. posed: the cameras stand where the views say, but for `constants.CAMERA_ROTATION_RAD` and `CAMERA_SHIFT_M`.
    level_rad: how far the upward directions of cameras that are not (`Camera.up`) are from the truth, about each axis.

    Raises InputError for a view with too few frames with a pose in common with the others.
    """
    clips = [_as_rig(one, posed) for one in clips]
    rough = (constants.CAMERA_ROTATION_RAD, constants.CAMERA_SHIFT_M)
    turn_rad, shift_m = rough if posed else (_UNKNOWN_RAD, _UNKNOWN_M)
    sigma = np.tile(np.repeat([turn_rad, shift_m], 3), len(clips[0].views))
    sigma[: 6 if posed else 0] = sigma[3:6] = _HELD
    with threadpool_limits(1, user_api="blas"):
        if not posed:
            clips = _placed(clips, lambda what, done: progress(what, 0.5 * done))
        segments = [(i, segment) for i, one in enumerate(clips) for segment in solve_segments(one)]
        values, converged, total, reduced = np.zeros(len(sigma)), False, np.diag(sigma**-2.0), []
        for i in range(ROUNDS):
            progress("all cameras", 0.5 * (1 + i / ROUNDS))
            total, pull = _level(clips[0].views, np.inf if posed else level_rad)
            total, pull = total + np.diag(sigma**-2.0), pull + values / sigma**2
            reduced = [(number, _reduced(clips[number], segment)) for number, segment in segments]
            for number, one in reduced:
                total += one.curvature / clips[number].correlation_frames
                pull += one.gradient / clips[number].correlation_frames
            step = np.asarray(np.linalg.solve(total, -pull), dtype=float)
            values = values + step
            clips = [_moved(one, step.reshape(-1, 6)) for one in clips]
            segments = [(number, refined(clips[number], one.follow(step))) for number, one in reduced]
            converged = bool(step @ total @ step < CLOSE_ENOUGH**2 * len(step))
            if converged:
                break
    poses = tuple(view.T_camera_world for view in clips[0].views)
    covariance = np.asarray(np.linalg.inv(total), dtype=float)
    of_clips = [[segment for number, segment in segments if number == i] for i in range(len(clips))]
    time_offsets = tuple(map(_time_offsets, of_clips, clips))
    sigma, apart = _beside_first(poses, covariance), _disagreement(clips, reduced)
    return Rig(poses, sigma, *_above_ground(clips, segments, reduced, covariance), apart, time_offsets, converged)


def _as_rig(clip: ClipProblem, posed: bool) -> ClipProblem:
    size_sigma = clip.options.size_sigma if posed else _SIZE_SIGMA
    options = replace(clip.options, refine_cameras=False, size_sigma=size_sigma)
    return replace(clip, options=options, time_offset_frames=_TIME_OFFSET_FRAMES)


def search_offsets(clip: ClipProblem) -> Array:
    """(V,): by how many whole frames cameras without poses began later, beside the first, than the views say: where the
    joints that each sees by itself are most nearly the first one's from elsewhere. NaN where they are never near."""
    joints = [_alone(clip, view) for view in clip.views]
    return np.array([_offset(joints[0], own, round(_SEARCHED_S * clip.fps)) for own in joints])


def _offset(first: Array, own: Array, most: int) -> float:
    """The offset in frames between joints (T, J, 3) in two cameras' frames. Of offsets as near as each other, that with
    more frames in common: a stride later the same pose comes again."""
    T, found = len(first), np.nan
    seen = min(np.isfinite(joints[:, 0, 0]).sum() for joints in (first, own))
    size_m = np.nanmedian(np.linalg.norm(first - first.mean(axis=1, keepdims=True), axis=-1)) if seen else 0.0
    least = _ALIKE * size_m / np.sqrt(max(seen, 1))
    for later in range(-min(most, T - 1), min(most, T - 1) + 1):
        a, b = first[max(later, 0) : T + min(later, 0)], own[max(-later, 0) : T - max(later, 0)]
        common = np.isfinite(a[:, 0, 0]) & np.isfinite(b[:, 0, 0])
        if common.sum() < max(_MIN_FRAMES, seen / 2):
            continue
        a, b = a[common].reshape(-1, 3), b[common].reshape(-1, 3)
        T_b_a = _aligned(a, b, 8)
        off_m = np.median(np.linalg.norm(a @ T_b_a[:3, :3].T + T_b_a[:3, 3] - b, axis=1)) / np.sqrt(common.sum())
        if off_m < least:
            least, found = off_m, float(later)
    return found


def _time_offsets(segments: Sequence[SegmentFit], clip: ClipProblem) -> Array:
    """(V,): those of the longest segment."""
    V = range(len(clip.views))
    if not segments:
        return np.zeros(len(V))
    longest = max(segments, key=lambda segment: len(segment.estimate.states))
    return np.array([float(longest.found(time_offset(i))[0]) if clip.views[i].present.any() else 0.0 for i in V])


def _level(views: Sequence[View], sigma_rad: float) -> tuple[Array, Array]:
    """Curvature (6V, 6V) and gradient (6V,) of what is expected of the upward direction in each camera."""
    curvature, gradient = np.zeros((6 * len(views), 6 * len(views))), np.zeros(6 * len(views))
    for i, view in enumerate(views):
        up, own = view.T_camera_world[:3, 2], slice(6 * i, 6 * i + 3)
        by_turn = np.cross(np.eye(3), up).T / sigma_rad
        curvature[own, own] = by_turn.T @ by_turn
        gradient[own] = by_turn.T @ (up - view.camera.up) / sigma_rad
    return curvature, gradient


def _placed(clips: Sequence[ClipProblem], progress: Progress) -> list[ClipProblem]:
    """With each view solved by itself, and placed where most of its joints meet those of the others."""
    V = len(clips[0].views)
    joints: list[list[Array]] = []
    for i in range(V):
        joints.append([_alone(one, one.views[i]) for one in clips])
        progress("each camera", (i + 1) / V)
    known, T_camera_first = np.concatenate(joints[0]), {0: np.eye(4)}
    while len(T_camera_first) < V:
        own = {i: np.concatenate(joints[i]) for i in range(V) if i not in T_camera_first}
        common = {i: np.isfinite(points[:, 0, 0]) & np.isfinite(known[:, 0, 0]) for i, points in own.items()}
        best = max(own, key=lambda i: int(common[i].sum()))
        if common[best].sum() < _MIN_FRAMES:
            name = f"camera {clips[0].views[best].camera.name}"
            expected = "some in which it and another camera see enough for a pose"
            raise InputError(Problem("KEYPOINTS", name, "too few frames", expected))
        T = _aligned(known[common[best]].reshape(-1, 3), own[best][common[best]].reshape(-1, 3))
        T_camera_first[best] = T
        there = (own[best] - T[:3, 3]) @ T[:3, :3]
        known = np.where(np.isfinite(known), known, there)
    level = rigid(level_from_camera(clips[0].views[0].camera.up).T, np.zeros(3))
    placed = []
    for one in clips:
        views = tuple(replace(v, T_camera_world=T_camera_first[i] @ level) for i, v in enumerate(one.views))
        placed.append(replace(one, views=views, origin_m=np.zeros(3)))
    return placed


def _alone(clip: ClipProblem, view: View) -> Array:
    """(T, J, 3): the joints in the camera's frame, NaN where there is no pose."""
    level = rigid(level_from_camera(view.camera.up).T, np.zeros(3))
    views = [replace(view, T_camera_world=level)]
    return solve_trajectory(
        views, clip.body, clip.prior, clip.fps, clip.options, ground_near_zero=False
    ).joints_camera_m


def _aligned(a: Array, b: Array, rounds: int = 30) -> Array:
    """T (4, 4) that takes points (N, 3) to others as well as can be, those far off counting less."""
    weight, R, t = np.ones(len(a)), np.eye(3), np.zeros(3)
    for _ in range(rounds):
        share = weight / weight.sum()
        R = Rotation.align_vectors(b - share @ b, a - share @ a, share)[0].as_matrix()
        t = share @ b - R @ (share @ a)
        off = np.linalg.norm(a @ R.T + t - b, axis=1)
        weight = 1.0 / (1.0 + (off / max(float(np.median(off)), 1e-6)) ** 2)
    return rigid(R, t)


@dataclass(frozen=True, eq=False)
class _ReducedProblem:
    """A segment's cost by all cameras' places, all else eliminated: curvature (6V, 6V) and gradient (6V,)."""

    curvature: Array
    gradient: Array
    solved: SegmentFit
    states: Array
    """(T, D, 6V + 1): how the states follow the places, and their own step."""
    own: Array
    """(P, 6V + 1): the same of the clip's own shared unknowns."""

    def follow(self, step: Array) -> SegmentFit:
        """The segment as it is expected to be after a step of the places (6V,)."""
        estimate, columns, by = self.solved.estimate, self.solved.problem.columns, np.append(step, 1.0)
        own = -self.own @ by
        shared = {name: value + own[columns[name]] for name, value in estimate.shared.items()}
        followed = replace(estimate, states=estimate.states - self.states @ by, shared=shared)
        return replace(self.solved, estimate=followed)


def _reduced(clip: ClipProblem, solved: SegmentFit) -> _ReducedProblem:
    """Without the ground, whose plane follows the feet: as it is, it would hold the world's tilt."""
    V, problem = len(clip.views), solved.problem
    places = [Unknown(extrinsic_correction(i), np.zeros(6), np.full(6, np.inf)) for i in range(V)]
    terms = [term for term in problem.terms if not isinstance(term, OnGround)]
    shared = [*problem.shared, *problem.doubtful, *places]
    problem = replace(problem, terms=terms, shared=shared, doubtful=())
    normal = problem.normal(solved.estimate.states, problem.expected() | dict(solved.estimate.shared))
    (window,) = eliminated([normal], bounded=True)
    Y, S = np.roll(window.solved(), -1, axis=2), window.reduced()
    n = len(S) - 6 * V
    own = np.asarray(np.linalg.solve(S[:n, :n], S[:n, n:]), dtype=float)
    left = S[n:, n:] - S[n:, :n] @ own
    return _ReducedProblem(left[:, :-1], left[:, -1], solved, Y[..., n:] - Y[..., :n] @ own, own)


def _disagreement(clips: Sequence[ClipProblem], reduced: Sequence[tuple[int, _ReducedProblem]]) -> Array:
    """(C, V), see `Rig`: the drop of each clip's cost if that camera stood elsewhere for this clip alone, twice."""
    C, V = len(clips), len(clips[0].views)
    curvature, gradient = np.zeros((C, V, 6, 6)), np.zeros((C, V, 6))
    each = np.arange(V)
    for number, one in reduced:
        curvature[number] += one.curvature.reshape(V, 6, V, 6)[each, :, each] / clips[number].correlation_frames
        gradient[number] += one.gradient.reshape(V, 6) / clips[number].correlation_frames
    held = curvature + 1e-9 * np.eye(6)  # nothing is known of a camera that saw nothing
    return np.sum(gradient * np.linalg.solve(held, gradient[..., None])[..., 0], axis=-1)


def _moved(clip: ClipProblem, step: Array) -> ClipProblem:
    """With cameras that lie beside their places by (V, 6)."""
    return replace(clip, views=tuple(view.corrected(own) for view, own in zip(clip.views, step, strict=True)))


def _beside_first(poses: Sequence[Array], covariance: Array) -> Array:
    """(V, 6): standard deviations of the cameras' places beside the first, from the covariance (6V, 6V) of the places
    of all."""
    found = np.zeros((len(poses), 6))
    for i, pose in enumerate(poses[1:], start=1):
        T = pose @ np.linalg.inv(poses[0])
        by = np.zeros((6, len(covariance)))
        by[:, 6 * i : 6 * i + 6] = np.eye(6)
        by[:3, :3] = by[3:, 3:6] = -T[:3, :3]
        by[3:, :3] = -np.cross(T[:3, 3], T[:3, :3], axisb=0, axisc=0)
        found[i] = np.sqrt(np.diagonal(by @ covariance @ by.T))
    return found


def _above_ground(
    clips: Sequence[ClipProblem],
    segments: Sequence[tuple[int, SegmentFit]],
    reduced: Sequence[tuple[int, _ReducedProblem]],
    covariance: Array,
) -> tuple[float, Array]:
    """The ground's height and the deviations (V,) of the cameras' heights above it, see `Rig`. The ground follows the
    cameras' places as the animal does."""
    V = len(clips[0].views)
    both = [(clips[number], segment, one) for (number, segment), (_, one) in zip(segments, reduced, strict=True)]
    on_ground = [of for of in both if of[1].ground is not None]
    if not on_ground:
        return float("nan"), np.full(V, np.nan)
    clip, segment, one = max(on_ground, key=lambda of: len(of[1].estimate.states))
    assert segment.ground is not None
    ground = segment.ground.about(clip.origin_m, segment.size)
    middle = clip.in_world(np.mean(segment.estimate.states[:, :3], axis=0), segment.size)
    by = np.tile(segment.size * one.states[:, 2, : 6 * V].mean(axis=0), (V, 1))
    for i, view in enumerate(clip.views):
        by[i, 6 * i + 3 : 6 * i + 6] -= view.T_camera_world[:3, 2]
    variance = np.einsum("vi,ij,vj->v", by, covariance, by) + ground.sigma_m**2
    return float(ground.height_m + ground.slope @ middle[:2]), np.sqrt(variance)
