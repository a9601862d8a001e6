"""Estimate the poses of cameras from the animal alone, in short clips filmed by the same cameras.

1. Each view is solved on its own, which gives the joints in the frame of its camera, in metres if the body has the
animal's lengths. 2. A rigid motion from the joints of one camera to the joints of the others is fitted robustly to all
joints, frames and clips. The motion gives the camera's pose relative to the cameras with known poses. The upward
direction is the first camera's. 3. All views of a clip are solved together with fixed cameras. At the minimum, the
unknowns of the clip alone (states, time offsets, and the keypoint bias of each view) are eliminated from the normal
equations (`recon.fit.banded`). The poses, and the first camera's tilt and roll, take the Gauss-Newton step of the sum
over the clips. The upward direction follows from the ground under the feet, the animal's climb and its upright posture.
A few rounds of solving the clips and moving the cameras lead to the minimum over all unknowns, and the inverse of the
summed curvature is the covariance of the poses.

If the poses are roughly known, only the third step is done, and the first camera's pose is kept. The distances between
the cameras then determine the size of the animal. Otherwise the animal determines the scale, because its size is fixed
at the size of the body.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation

from recon.base.arrays import Array
from recon.base.errors import InputError, Problem
from recon.base.progress import Progress, silent
from recon.base.threads import one_thread
from recon.clip import View
from recon.fit import constants
from recon.fit.banded import eliminated
from recon.fit.clip_problem import ClipProblem
from recon.fit.least_squares import SharedUnknown
from recon.fit.segment import SegmentFit, refined
from recon.fit.terms import OnGround, extrinsic_correction, time_offset
from recon.fit.trajectory import solve_segments, solve_trajectory
from recon.geometry.frames import level_from_camera, rigid

_UNKNOWN_RAD = float(np.radians(10.0))
"""Standard deviation (rad) of a camera's initial rotation about each axis if no poses are given; an assumption."""
_UNKNOWN_M = 1.0
"""Standard deviation (m) of a camera's initial position along each axis if no poses are given; an assumption."""
LEVEL_RAD = float(np.radians(5.0))
"""Standard deviation (rad) of a camera's tilt and roll about stated values, or about level if none are stated."""
_FIXED = 1e-6
"""Standard deviation, in the unknown's own unit, that is small enough to fix the unknown."""
_SIZE_SIGMA = 1e-3
"""Relative standard deviation that fixes the animal's size, and with it the scale, if no view has a pose."""
_MIN_FRAMES = 5
"""Minimum number of frames in which two cameras both show a pose."""
_TIME_OFFSET_FRAMES = 1.0
"""Standard deviation of the time offset, in frames, between cameras that were started together.

Larger time offsets could be mistaken for rotations of a camera.
"""
_SEARCHED_S = 1.0
"""Maximum time offset between cameras that the search tries, s."""
_MATCHING = 0.5
"""Maximum distance between joints that match, as a fraction of the joints' distance from the animal's middle."""
ROUNDS = 12
"""Maximum number of rounds of solving the clips and moving the cameras."""
CLOSE_ENOUGH = 0.05
"""Root mean square step of the unknowns, in standard deviations, that is small enough to end the rounds."""


@dataclass(frozen=True, eq=False)
class Rig:
    """Estimated poses of V cameras in a common world, with their uncertainty."""

    T_camera_world: tuple[Array, ...]
    """Pose of each camera, (4, 4).

    The world is the given one, or a level world with the first camera at its origin.
    """
    sigma: Array
    """Standard deviations of each camera's pose relative to the first, as in `View.corrected`, shape (V, 6)."""
    ground_m: float
    """Height z of the ground under the middle of the longest segment's path, m; NaN if no ground was found."""
    height_sigma_m: Array
    """Standard deviations of the cameras' heights above the ground, shape (V,); NaN without a ground."""
    disagreement: Array
    """Squared Mahalanobis distance between each camera's pose in one of C clips and in all clips, shape (C, V).

    The expectation of the distance is at most 6 if the errors are as large as stated.
    """
    time_offset_frames: tuple[Array, ...]
    """Delay in frames of each camera's pictures beyond the stated offset, (V,) for each clip.

    The delay is 0 for a camera without detections.
    """
    converged: bool
    """Whether the last step of the unknowns was below `CLOSE_ENOUGH`."""


def solve_extrinsics(
    clips: Sequence[ClipProblem], posed: bool = False, level_rad: float = LEVEL_RAD, progress: Progress = silent
) -> Rig:
    """Estimate the poses of cameras from the animal in the clips that they filmed.

    Parameters
    ----------
    clips
        Problems of clips, each with the same V cameras in the same order. A camera that did not film a clip has no
        detections in it.
    posed
        Whether the views have rough poses, with standard deviations `CAMERA_ROTATION_RAD` and `CAMERA_SHIFT_M` of
        `recon.fit.constants`.
    level_rad
        Standard deviation of the cameras' upward directions (`Camera.up`) about each axis, rad. It is not used if
        `posed`.
    progress
        Function that is called with the name of the stage and the fraction that is done.

    Raises
    ------
    InputError
        If a view has too few frames with a pose in common with the other views.
    """
    clips = [_with_fixed_cameras(clip, posed) for clip in clips]
    rough_sigmas = (constants.CAMERA_ROTATION_RAD, constants.CAMERA_SHIFT_M)
    turn_rad, shift_m = rough_sigmas if posed else (_UNKNOWN_RAD, _UNKNOWN_M)
    sigma = np.tile(np.repeat([turn_rad, shift_m], 3), len(clips[0].views))
    sigma[: 6 if posed else 0] = sigma[3:6] = _FIXED
    with one_thread():
        if not posed:
            clips = _initial_poses(clips, lambda stage, done: progress(stage, 0.5 * done))
        segments = [(i, segment) for i, clip in enumerate(clips) for segment in solve_segments(clip)]
        values, converged, total, reduced = np.zeros(len(sigma)), False, np.diag(sigma**-2.0), []
        for i in range(ROUNDS):
            progress("all cameras", 0.5 * (1 + i / ROUNDS))
            total, pull = _level_prior(clips[0].views, np.inf if posed else level_rad)
            total, pull = total + np.diag(sigma**-2.0), pull + values / sigma**2
            reduced = [(number, _reduced(clips[number], segment)) for number, segment in segments]
            for number, reduced_problem in reduced:
                total += reduced_problem.curvature / clips[number].correlation_frames
                pull += reduced_problem.gradient / clips[number].correlation_frames
            step = np.asarray(np.linalg.solve(total, -pull), dtype=float)
            values = values + step
            clips = [_moved(clip, step.reshape(-1, 6)) for clip in clips]
            segments = [
                (number, refined(clips[number], reduced_problem.follow(step))) for number, reduced_problem in reduced
            ]
            converged = bool(step @ total @ step < CLOSE_ENOUGH**2 * len(step))
            if converged:
                break
    poses = tuple(view.T_camera_world for view in clips[0].views)
    covariance = np.asarray(np.linalg.inv(total), dtype=float)
    segments_of_clips = [[segment for number, segment in segments if number == i] for i in range(len(clips))]
    time_offsets = tuple(map(_time_offsets, segments_of_clips, clips))
    sigma, disagreement = _sigma_to_first(poses, covariance), _disagreement(clips, reduced)
    return Rig(
        poses, sigma, *_ground_and_heights(clips, segments, reduced, covariance), disagreement, time_offsets, converged
    )


def _with_fixed_cameras(clip: ClipProblem, posed: bool) -> ClipProblem:
    """Return the problem with fixed cameras and, if no view has a pose, with a fixed size."""
    size_sigma = clip.options.size_sigma if posed else _SIZE_SIGMA
    options = replace(clip.options, refine_cameras=False, cameras_known=True, size_sigma=size_sigma)
    return replace(clip, options=options, time_offset_frames=_TIME_OFFSET_FRAMES)


def search_offsets(clip: ClipProblem) -> Array:
    """Return the delay (V,), in whole frames, of each camera relative to the first, beyond the views' stated delay.

    The cameras need no poses, because the joints of each camera's own solution are compared with the first camera's.
    The delay is NaN if the joints never match.
    """
    joints = [_joints_by_view(clip, view) for view in clip.views]
    return np.array([_best_offset(joints[0], camera_joints, round(_SEARCHED_S * clip.fps)) for camera_joints in joints])


def _best_offset(reference: Array, shifted: Array, max_frames: int) -> float:
    """Return the time offset, in video frames, between joints (T, J, 3) in the coordinates of two cameras.

    If offsets match equally well, the one with more common frames is chosen, because poses repeat after a stride.
    """
    T, offset = len(reference), np.nan
    seen = min(np.isfinite(joints[:, 0, 0]).sum() for joints in (reference, shifted))
    size_m = np.nanmedian(np.linalg.norm(reference - reference.mean(axis=1, keepdims=True), axis=-1)) if seen else 0.0
    least_m = _MATCHING * size_m / np.sqrt(max(seen, 1))
    for offset_frames in range(-min(max_frames, T - 1), min(max_frames, T - 1) + 1):
        a = reference[max(offset_frames, 0) : T + min(offset_frames, 0)]
        b = shifted[max(-offset_frames, 0) : T - max(offset_frames, 0)]
        common = np.isfinite(a[:, 0, 0]) & np.isfinite(b[:, 0, 0])
        if common.sum() < max(_MIN_FRAMES, seen / 2):
            continue
        a, b = a[common].reshape(-1, 3), b[common].reshape(-1, 3)
        T_b_a = _rigid_motion(a, b, 8)
        off_m = np.median(np.linalg.norm(a @ T_b_a[:3, :3].T + T_b_a[:3, 3] - b, axis=1)) / np.sqrt(common.sum())
        if off_m < least_m:
            least_m, offset = off_m, float(offset_frames)
    return offset


def _time_offsets(segments: Sequence[SegmentFit], clip: ClipProblem) -> Array:
    """Return the cameras' time offsets (V,), in frames, as estimated in the longest segment."""
    V = range(len(clip.views))
    if not segments:
        return np.zeros(len(V))
    longest = max(segments, key=lambda segment: len(segment.estimate.states))
    return np.array(
        [float(longest.shared_values(time_offset(i))[0]) if clip.views[i].present.any() else 0.0 for i in V]
    )


def _level_prior(views: Sequence[View], sigma_rad: float) -> tuple[Array, Array]:
    """Return the curvature (6V, 6V) and gradient (6V,) of the prior of each camera's upward direction."""
    curvature, gradient = np.zeros((6 * len(views), 6 * len(views))), np.zeros(6 * len(views))
    for i, view in enumerate(views):
        up, columns = view.T_camera_world[:3, 2], slice(6 * i, 6 * i + 3)
        by_turn = np.cross(np.eye(3), up).T / sigma_rad
        curvature[columns, columns] = by_turn.T @ by_turn
        gradient[columns] = by_turn.T @ (up - view.camera.up) / sigma_rad
    return curvature, gradient


def _initial_poses(clips: Sequence[ClipProblem], progress: Progress) -> list[ClipProblem]:
    """Return the clips with camera poses found by solving each view alone and matching the joints."""
    V = len(clips[0].views)
    joints: list[list[Array]] = []
    for i in range(V):
        joints.append([_joints_by_view(clip, clip.views[i]) for clip in clips])
        progress("each camera", (i + 1) / V)
    known, T_camera_first = np.concatenate(joints[0]), {0: np.eye(4)}
    while len(T_camera_first) < V:
        joints_by_camera = {i: np.concatenate(joints[i]) for i in range(V) if i not in T_camera_first}
        shared_frames = {
            i: np.isfinite(points[:, 0, 0]) & np.isfinite(known[:, 0, 0]) for i, points in joints_by_camera.items()
        }
        best = max(joints_by_camera, key=lambda i: int(shared_frames[i].sum()))
        if shared_frames[best].sum() < _MIN_FRAMES:
            name = f"camera {clips[0].views[best].camera.name}"
            expected = "more frames in which this camera and another camera see enough points for a pose"
            raise InputError(Problem("KEYPOINTS", name, "too few frames", expected))
        T = _rigid_motion(
            known[shared_frames[best]].reshape(-1, 3), joints_by_camera[best][shared_frames[best]].reshape(-1, 3)
        )
        T_camera_first[best] = T
        in_first_camera = (joints_by_camera[best] - T[:3, 3]) @ T[:3, :3]
        known = np.where(np.isfinite(known), known, in_first_camera)
    level = rigid(level_from_camera(clips[0].views[0].camera.up).T, np.zeros(3))
    posed_clips = []
    for clip in clips:
        views = tuple(replace(v, T_camera_world=T_camera_first[i] @ level) for i, v in enumerate(clip.views))
        posed_clips.append(replace(clip, views=views, origin_m=np.zeros(3)))
    return posed_clips


def _joints_by_view(clip: ClipProblem, view: View) -> Array:
    """Return the joints of a fit to one view in the frame of its camera, shape (T, J, 3), m; NaN without a pose."""
    level = rigid(level_from_camera(view.camera.up).T, np.zeros(3))
    views = [replace(view, T_camera_world=level)]
    return solve_trajectory(
        views, clip.body, clip.prior, clip.fps, clip.options, ground_near_zero=False
    ).joints_camera_m


def _rigid_motion(a: Array, b: Array, rounds: int = 30) -> Array:
    """Return the rigid transform (4, 4) that maps points a (N, 3) to points b (N, 3), robust to outliers."""
    weight, R, t = np.ones(len(a)), np.eye(3), np.zeros(3)
    for _ in range(rounds):
        fraction = weight / weight.sum()
        R = Rotation.align_vectors(b - fraction @ b, a - fraction @ a, fraction)[0].as_matrix()
        t = fraction @ b - R @ (fraction @ a)
        distance_m = np.linalg.norm(a @ R.T + t - b, axis=1)
        weight = 1.0 / (1.0 + (distance_m / max(float(np.median(distance_m)), 1e-6)) ** 2)
    return rigid(R, t)


@dataclass(frozen=True, eq=False)
class _ReducedProblem:
    """Quadratic cost of a segment as a function of the V camera poses, with curvature (6V, 6V) and gradient (6V,)."""

    curvature: Array
    gradient: Array
    solved: SegmentFit
    states: Array
    """Negative derivatives of the states by the poses, shape (T, D, 6V + 1).

    The last column is the negative step of the states at fixed poses.
    """
    shared_step: Array
    """Negative derivatives of the P shared unknowns by the poses, shape (P, 6V + 1), with columns as in `states`."""

    def follow(self, step: Array) -> SegmentFit:
        """Return the segment with the unknowns predicted for a step (6V,) of the poses."""
        estimate, columns, step_and_one = self.solved.estimate, self.solved.problem.columns, np.append(step, 1.0)
        shared_step = -self.shared_step @ step_and_one
        shared = {name: value + shared_step[columns[name]] for name, value in estimate.shared.items()}
        followed = replace(estimate, states=estimate.states - self.states @ step_and_one, shared=shared)
        return replace(self.solved, estimate=followed)


def _reduced(clip: ClipProblem, segment: SegmentFit) -> _ReducedProblem:
    """Return the cost of a segment as a function of the camera poses alone.

    The ground is left out, because a fixed plane would fix the tilt of the world.
    """
    V, problem = len(clip.views), segment.problem
    corrections = [SharedUnknown(extrinsic_correction(i), np.zeros(6), np.full(6, np.inf)) for i in range(V)]
    terms = [term for term in problem.terms if not isinstance(term, OnGround)]
    shared = [*problem.shared, *problem.nuisance, *corrections]
    problem = replace(problem, terms=terms, shared=shared, nuisance=())
    normal = problem.normal(segment.estimate.states, problem.expected() | dict(segment.estimate.shared))
    (window,) = eliminated([normal], bounded=True)
    Y, S = np.roll(window.solved(), -1, axis=2), window.reduced()  # both with the gradient in the last column
    n = len(S) - 6 * V
    by_poses = np.asarray(np.linalg.solve(S[:n, :n], S[:n, n:]), dtype=float)
    remaining = S[n:, n:] - S[n:, :n] @ by_poses
    return _ReducedProblem(remaining[:, :-1], remaining[:, -1], segment, Y[..., n:] - Y[..., :n] @ by_poses, by_poses)


def _disagreement(clips: Sequence[ClipProblem], reduced: Sequence[tuple[int, _ReducedProblem]]) -> Array:
    """Return twice the decrease (C, V) of a clip's cost if a camera's pose were free in this clip alone."""
    C, V = len(clips), len(clips[0].views)
    curvature, gradient = np.zeros((C, V, 6, 6)), np.zeros((C, V, 6))
    cameras = np.arange(V)
    for number, reduced_problem in reduced:
        curvature[number] += (
            reduced_problem.curvature.reshape(V, 6, V, 6)[cameras, :, cameras] / clips[number].correlation_frames
        )
        gradient[number] += reduced_problem.gradient.reshape(V, 6) / clips[number].correlation_frames
    regularised = curvature + 1e-9 * np.eye(6)  # a camera without detections determines nothing
    return np.sum(gradient * np.linalg.solve(regularised, gradient[..., None])[..., 0], axis=-1)


def _moved(clip: ClipProblem, step: Array) -> ClipProblem:
    """Return the clip with the poses of its V cameras corrected by a step (V, 6), as in `View.corrected`."""
    return replace(
        clip, views=tuple(view.corrected(correction) for view, correction in zip(clip.views, step, strict=True))
    )


def _sigma_to_first(poses: Sequence[Array], covariance: Array) -> Array:
    """Return the standard deviations (V, 6) of the poses relative to the first, from their covariance (6V, 6V)."""
    sigmas = np.zeros((len(poses), 6))
    for i, pose in enumerate(poses[1:], start=1):
        T = pose @ np.linalg.inv(poses[0])
        by_poses = np.zeros((6, len(covariance)))
        by_poses[:, 6 * i : 6 * i + 6] = np.eye(6)
        by_poses[:3, :3] = by_poses[3:, 3:6] = -T[:3, :3]
        by_poses[3:, :3] = -np.cross(T[:3, 3], T[:3, :3], axisb=0, axisc=0)
        sigmas[i] = np.sqrt(np.diagonal(by_poses @ covariance @ by_poses.T))
    return sigmas


def _ground_and_heights(
    clips: Sequence[ClipProblem],
    segments: Sequence[tuple[int, SegmentFit]],
    reduced: Sequence[tuple[int, _ReducedProblem]],
    covariance: Array,
) -> tuple[float, Array]:
    """Return the ground's height, m, and the standard deviations (V,) of the cameras' heights above it, as in `Rig`.

    If the poses of the cameras change, the ground moves as the animal does.
    """
    V = len(clips[0].views)
    solved_segments = [
        (clips[number], segment, reduced_problem)
        for (number, segment), (_, reduced_problem) in zip(segments, reduced, strict=True)
    ]
    on_ground = [solved for solved in solved_segments if solved[1].ground is not None]
    if not on_ground:
        return float("nan"), np.full(V, np.nan)
    clip, segment, reduced_problem = max(on_ground, key=lambda solved: len(solved[1].estimate.states))
    assert segment.ground is not None
    ground = segment.ground.about(clip.origin_m, segment.size)
    middle = clip.in_world(np.mean(segment.estimate.states[:, :3], axis=0), segment.size)
    height_by_poses = np.tile(segment.size * reduced_problem.states[:, 2, : 6 * V].mean(axis=0), (V, 1))
    for i, view in enumerate(clip.views):
        height_by_poses[i, 6 * i + 3 : 6 * i + 6] -= view.T_camera_world[:3, 2]
    variance = np.einsum("vi,ij,vj->v", height_by_poses, covariance, height_by_poses) + ground.sigma_m**2
    return float(ground.height_m + ground.slope @ middle[:2]), np.sqrt(variance)
