"""Test the estimation of camera poses from several clips of the animal."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from command_line import refusal
from example_run import AHEAD, ASIDE, BODY, FPS, PRIOR, truth_m, view_of

from recon.api.extrinsics import MAX_CHI_SQUARED
from recon.base.arrays import Index
from recon.base.progress import silent
from recon.clip import View, still_view
from recon.fit.clip_problem import ClipProblem, TrajectoryOptions
from recon.fit.extrinsics import _initial_poses, _level_prior, _sigma_to_first, solve_extrinsics
from recon.geometry.frames import euler_rotation, inverse, moved, rigid
from recon.testing.cameras import level_pose

BEHIND = level_pose([3.0, 17.0, 0.2], -np.pi / 2)


def across() -> np.ndarray:
    """Return the joints (T, J, 3), m, of the run of `truth_m` in another direction through the pictures."""
    points = truth_m()
    middle = points.mean(axis=(0, 1)) * [1, 1, 0]
    return (points - middle) @ rigid(euler_rotation([0, 0, 1.2]), np.zeros(3))[:3, :3].T + middle


def setting(views: list[View], posed: bool = False) -> ClipProblem:
    lenses = [replace(view.camera, rotation=None, translation_m=None) for view in views]
    bare = [still_view(lens, view.xy_px, view.confidence) for lens, view in zip(lenses, views, strict=True)]
    return ClipProblem.from_views(views if posed else bare, BODY, PRIOR, FPS, TrajectoryOptions(fast=True), False)


def blind(view: View) -> View:
    return replace(view, xy_px=np.full_like(view.xy_px, np.nan), confidence=np.zeros_like(view.confidence))


def with_frames_unseen(view: View, rows: Index) -> View:
    xy_px, confidence = view.xy_px.copy(), view.confidence.copy()
    xy_px[rows], confidence[rows] = np.nan, 0.0
    return replace(view, xy_px=xy_px, confidence=confidence)


def apart(found: np.ndarray, true: np.ndarray) -> tuple[float, float]:
    """Return the difference of two poses, degrees and metres."""
    turn = found[:3, :3] @ true[:3, :3].T
    off_m = np.linalg.norm(inverse(found)[:3, 3] - inverse(true)[:3, 3])
    return float(np.degrees(np.arccos(np.clip((np.trace(turn) - 1) / 2, -1, 1)))), float(off_m)


@pytest.mark.slow
def test_two_clips_determine_a_camera_that_one_clip_lacks():
    """The second clip determines the third camera, which did not film the first clip."""
    first = [view_of(truth_m(), AHEAD), view_of(truth_m(), ASIDE, seed=1), blind(view_of(truth_m(), BEHIND))]
    second = [view_of(across(), p, seed=2 + i) for i, p in enumerate((AHEAD, ASIDE, BEHIND))]
    one, both = solve_extrinsics([setting(first[:2])]), solve_extrinsics([setting(first), setting(second)])
    assert one.converged
    assert both.converged
    for i, true in ((1, ASIDE), (2, BEHIND)):
        degrees, metres = apart(both.T_camera_world[i], true @ inverse(AHEAD) @ both.T_camera_world[0])
        assert degrees < 1.0
        assert metres < 0.2
    assert not both.sigma[0].any()
    assert (both.sigma[1] < one.sigma[1]).all()
    assert both.disagreement.shape == (2, 3)
    assert both.disagreement.max() < MAX_CHI_SQUARED


@pytest.mark.slow
def test_a_camera_moved_between_two_clips_disagrees():
    turned = rigid(euler_rotation([0.0, np.radians(5.0), 0.0]), np.zeros(3)) @ ASIDE
    clips = [
        setting([view_of(truth_m(), p, seed=i) for i, p in enumerate((AHEAD, ASIDE, BEHIND))]),
        setting([view_of(across(), p, seed=3 + i) for i, p in enumerate((AHEAD, turned, BEHIND))]),
    ]
    assert solve_extrinsics(clips).disagreement.max() > MAX_CHI_SQUARED


def test_levelled_cameras_determine_the_upward_direction():
    """Levelled cameras determine the upward direction, although the ground slopes by 5 degrees."""
    slope = rigid(euler_rotation([np.radians(5.0), 0, 0]), np.zeros(3))
    views = [view_of(moved(slope, truth_m()), p, seed=i) for i, p in enumerate((AHEAD, ASIDE))]
    rig = solve_extrinsics([setting(views)], level_rad=np.radians(0.5))
    for T, view in zip(rig.T_camera_world, views, strict=True):
        assert np.degrees(np.arccos(T[:3, 2] @ view.camera.up)) < 0.5


def test_cameras_are_placed_relative_to_known_cameras():
    """The third camera shares frames only with the second camera, and the second camera also with the first."""
    poses, points, unseen = [AHEAD, ASIDE, BEHIND], truth_m(), [np.s_[20:], np.r_[0:10, 30:40], np.s_[:20]]
    views = [with_frames_unseen(view_of(points, p, 0.5), rows) for p, rows in zip(poses, unseen, strict=True)]
    (placed,) = _initial_poses([setting(views)], silent)
    for view, true in zip(placed.views, poses, strict=True):
        turned_deg, off_m = apart(view.T_camera_world @ inverse(placed.views[0].T_camera_world), true @ inverse(AHEAD))
        assert turned_deg < 10.0  # the refinement expects errors up to these limits
        assert off_m < 1.0


def test_cameras_without_common_frames_are_refused():
    points = truth_m()
    with refusal(("KEYPOINTS", "camera cam1", "too few frames")):
        solve_extrinsics([setting([view_of(points, AHEAD), blind(view_of(points, ASIDE))])])


def test_rough_poses_are_refined():
    wrong = rigid(euler_rotation(np.radians([1.0, -1.0, 0.5])), np.array([0.03, 0.0, -0.03])) @ ASIDE
    clips = []
    for i, points in enumerate((truth_m(), across())):
        beside = replace(view_of(points, ASIDE, seed=9 - i), T_camera_world=wrong)
        clips.append(setting([view_of(points, AHEAD, seed=i), beside], posed=True))
    rig = solve_extrinsics(clips, posed=True)
    np.testing.assert_allclose(rig.T_camera_world[0], AHEAD, atol=1e-4)
    (degrees, metres), before = apart(rig.T_camera_world[1], ASIDE), apart(wrong, ASIDE)
    assert degrees < 0.4 * before[0]
    assert metres < 0.05  # as in the prior, since two clips of half a second hardly determine positions


def test_rough_poses_determine_the_size():
    """A rig that is 5 % too large keeps its size, and no camera turns by 2 degrees."""
    larger = [rigid(p[:3, :3], 1.05 * p[:3, 3]) for p in (AHEAD, ASIDE)]
    views = [
        replace(view_of(truth_m(), p, seed=i), T_camera_world=q)
        for i, (p, q) in enumerate(zip((AHEAD, ASIDE), larger, strict=True))
    ]
    rig = solve_extrinsics([setting(views, posed=True)], posed=True)
    degrees, metres = apart(rig.T_camera_world[1], larger[1])
    assert degrees < 1.0
    assert metres < 0.03


def test_standard_deviations_relative_to_the_first_camera():
    """The standard deviations agree with finite differences, even if the first camera is uncertain."""
    rng, poses = np.random.default_rng(0), [AHEAD, ASIDE, BEHIND]
    root = rng.normal(size=(18, 18))

    def relative(by: np.ndarray) -> np.ndarray:
        """Return the poses (V, 6) relative to the first camera's, in their own frames."""
        positions = [rigid(euler_rotation(own[:3]), own[3:]) for own in by.reshape(-1, 6)]
        moved_by = [
            position @ T @ inverse(positions[0] @ poses[0]) @ poses[0] @ inverse(T)
            for position, T in zip(positions, poses, strict=True)
        ]
        return np.array([[m[2, 1], m[0, 2], m[1, 0], *m[:3, 3]] for m in moved_by])

    step = 1e-6
    slopes = np.stack([(relative(step * e) - relative(-step * e)) / (2 * step) for e in np.eye(18)], axis=-1)
    expected = np.sqrt(np.einsum("vap,pq,vaq->va", slopes, root @ root.T, slopes))
    np.testing.assert_allclose(_sigma_to_first(poses, root @ root.T), expected, rtol=1e-6, atol=1e-6)


def test_level_prior_has_its_minimum_at_the_upward_direction():
    turned = rigid(euler_rotation([0.02, 0.3, -0.03]), np.zeros(3)) @ ASIDE
    view = replace(view_of(truth_m(), ASIDE), T_camera_world=turned)
    curvature, gradient = _level_prior([view], 0.1)
    step = -np.linalg.lstsq(curvature[:3, :3], gradient[:3], rcond=None)[0]
    up = moved(rigid(euler_rotation(step), np.zeros(3)), turned[:3, 2])
    np.testing.assert_allclose(up, view.camera.up, atol=2e-3)
