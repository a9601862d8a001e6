"""Test projections of views, and motions solved from several or moving cameras."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from example_run import AHEAD, ASIDE, BODY, CAMERA, FPS, PRIOR, run, seen, truth_m, two, view_of

from recon import samples_folder
from recon.animal.prior import prior_from_body
from recon.clip import View, camera_poses, still_view
from recon.fit import constants
from recon.fit.clip_problem import ClipProblem, TrajectoryOptions
from recon.fit.result import TrajectorySolution
from recon.fit.terms import LENGTHS
from recon.fit.trajectory import solve_trajectory
from recon.geometry.frames import inverse, moved, rigid
from recon.io.positions import read_pose3d
from recon.testing.cameras import level_pose

SAMPLES = samples_folder()


def test_poses_of_cameras_keep_the_files_world_where_z_points_up():
    rotation = np.array([[0.0, -1.0, 0.0], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0]])
    camera = replace(CAMERA, rotation=rotation, translation_m=[1.0, 2.0, 3.0])
    (T,) = camera_poses([camera])
    points = np.random.default_rng(0).normal(size=(4, 3))
    np.testing.assert_allclose(moved(T, points), camera.world_to_camera(points), atol=1e-12)


def test_without_a_known_upward_direction_the_world_is_level_under_the_first_camera():
    """The origin is the first camera's centre, z is up, and other cameras keep their poses relative to the first."""
    first = replace(CAMERA, rotation=np.eye(3), translation_m=np.array([0.0, 0.0, 5.0]), world_z_up=False)
    second = replace(first, translation_m=np.array([2.0, 0.0, 5.0]))
    a, b = camera_poses([first, second])
    np.testing.assert_allclose(inverse(a)[:3, 3], 0.0, atol=1e-12)
    np.testing.assert_allclose(a[:3, :3] @ [0.0, 0.0, 1.0], first.up, atol=1e-12)
    file_m = np.array([[0.3, 0.1, 9.0]])
    np.testing.assert_allclose(
        moved(b @ inverse(a), first.world_to_camera(file_m)), second.world_to_camera(file_m), atol=1e-12
    )


def test_zoom_scales_the_picture_about_the_principal_point():
    points = truth_m()
    view = still_view(CAMERA, np.zeros((len(points), len(BODY.markers), 2)), np.ones(points.shape[:2]))
    fx, fy, cx, cy = CAMERA.matrix[0, 0], CAMERA.matrix[1, 1], CAMERA.matrix[0, 2], CAMERA.matrix[1, 2]
    zoomed = replace(view, intrinsics_px=np.tile([2 * fx, 2 * fy, cx, cy], (len(points), 1)))
    centre = np.array([cx, cy])
    plain, _ = view.project(points)
    twice, _ = zoomed.project(points)
    np.testing.assert_allclose(twice - centre, 2 * (plain - centre), atol=1e-9)
    np.testing.assert_allclose(replace(zoomed, xy_px=twice).rays(), replace(view, xy_px=plain).rays(), atol=1e-12)


def test_rays_of_a_moving_view_meet_the_points():
    points, T = truth_m(), len(truth_m())
    poses = np.stack([level_pose([0.05 * t, 0.0, 0.0], np.pi / 2 + 0.01 * t) for t in range(T)])
    view = view_of(points, poses, sigma_px=0.0)
    off = points - view.centre_m[:, None]
    np.testing.assert_allclose(view.rays(), off / np.linalg.norm(off, axis=-1, keepdims=True), atol=1e-9)


def test_keypoint_noise_scales_with_the_magnification():
    """The magnification is the root mean square shift, px/m, of the animal's middle over all directions.

    A fisheye that turns towards the animal shows it as large as before.
    """
    lens, points = replace(CAMERA, model="fisheye", distortion=np.zeros(4)), truth_m()
    found = []
    for heading in (np.pi / 2, np.pi / 2 + 0.5):
        view = replace(view_of(points, level_pose([0.0, 0.0, 0.0], heading)), camera=lens)
        found.append(ClipProblem.from_views([view], BODY, PRIOR, FPS, TrajectoryOptions()).px_per_m(points)[0])
        middle = np.median(points, axis=1, keepdims=True)
        steps = 1e-6 * np.concatenate([np.eye(3), -np.eye(3)])
        moved, at = view.project(middle + steps)[0], view.project(middle)[0]
        # The sum has two steps along each of three axes, and two coordinates in the picture.
        along = np.sqrt(np.sum((moved - at) ** 2, axis=(1, 2)) / 4)
        np.testing.assert_allclose(found[-1], 1e6 * along, rtol=1e-4)
    np.testing.assert_allclose(found[1], found[0], rtol=0.06)


def test_two_cameras_find_the_position_and_the_size():
    """Two cameras find the position ten times as accurately as one, and the size within its stated uncertainty."""
    solution = two()
    error = np.linalg.norm(solution.joints_m - truth_m(), axis=-1)
    assert error.mean() < 0.02
    assert solution.size == pytest.approx(1.0, abs=3 * solution.size_sigma)
    assert solution.size_sigma < 0.03  # offsets of keypoints from their markers limit the size to this
    assert solution.size_from == ("prior", "views")
    assert solution.weight.shape == (2, *error.shape)


def test_a_wrong_size_of_the_body_is_found():
    """With a body that is 10 % too large, the joints have the right positions, and the size is 10 % too small."""
    long = replace(
        BODY,
        tree=replace(
            BODY.tree,
            segments=tuple(replace(s, offset_m=tuple(1.1 * x for x in s.offset_m)) for s in BODY.tree.segments),
            markers=tuple(replace(m, offset_m=tuple(1.1 * x for x in m.offset_m)) for m in BODY.tree.markers),
        ),
    )
    views = [view_of(truth_m(), AHEAD), view_of(truth_m(), ASIDE, seed=1)]
    solution = solve_trajectory(views, long, PRIOR, FPS, TrajectoryOptions(fast=True, size_sigma=0.3))
    assert solution.size == pytest.approx(1 / 1.1, abs=0.015)
    assert np.linalg.norm(solution.joints_m - truth_m(), axis=-1).mean() < 0.03


def test_a_view_that_does_not_see_the_animal_for_a_while():
    views = [view_of(truth_m(), AHEAD), view_of(truth_m(), ASIDE, seed=1)]
    hidden = views[1].xy_px.copy()
    hidden[15:] = np.nan
    views[1] = replace(views[1], xy_px=hidden, confidence=np.where(np.isnan(hidden[..., 0]), 0.0, 1.0))
    solution = solve_trajectory(views, BODY, PRIOR, FPS, TrajectoryOptions(fast=True))
    error = np.linalg.norm(solution.joints_m - truth_m(), axis=-1).mean(axis=1)
    assert error[:15].mean() < 0.025
    assert np.isfinite(error).all()
    sigma = np.sqrt(np.trace(solution.covariance_m2, axis1=2, axis2=3)).mean(axis=1)
    assert sigma[30:].mean() > 1.5 * sigma[:10].mean()


@pytest.mark.slow
def test_sideslip_is_estimated(monkeypatch):
    """Every frame is turned by 0.2 rad about its middle, so that the animal runs obliquely to its heading.

    The estimated angle of an animal that runs straight is zero.
    """
    points, turn = truth_m(), 0.2
    middle = points.mean(axis=1, keepdims=True)
    rotation = np.array([[np.cos(turn), np.sin(turn), 0.0], [-np.sin(turn), np.cos(turn), 0.0], [0.0, 0.0, 1.0]])
    beside = middle + (points - middle) @ rotation.T
    views = [view_of(beside, AHEAD), view_of(beside, ASIDE, seed=1)]
    found = solve_trajectory(views, BODY, PRIOR, FPS, TrajectoryOptions(fast=True))
    with monkeypatch.context() as patch:
        patch.setattr(constants, "SIDESLIP_RAD", 1e-4)
        held = solve_trajectory(views, BODY, PRIOR, FPS, TrajectoryOptions(fast=True))
    assert found.sideslip_rad == pytest.approx(turn, abs=3 * found.sideslip_sigma_rad)
    assert found.sideslip_sigma_rad < 0.05
    assert abs(two().sideslip_rad) < 3 * two().sideslip_sigma_rad
    errors = [np.linalg.norm(solution.joints_m - beside, axis=-1).mean() for solution in (found, held)]
    assert errors[0] < 0.9 * errors[1]


def test_points_between_frames_and_at_the_end_of_a_stretch():
    points = np.arange(6.0)[:, None, None] * np.ones((6, 1, 3))
    points[3] = np.nan
    late = replace(view_of(np.ones((6, 1, 3)), AHEAD), offset_frames=0.25)
    expected = [0.25, 1.25, 2.25, np.nan, 4.25, 5.25]
    np.testing.assert_allclose(late.shift_to_exposure(points)[:, 0, 0], expected)


def test_known_delay_of_half_a_frame_does_not_matter():
    """A delay of half a frame that the view states does not reduce the accuracy."""
    points = truth_m()
    between = 0.5 * (points + np.concatenate([points[1:], 2 * points[-1:] - points[-2:-1]]))
    late = view_of(between, ASIDE, seed=1)
    said = solve_trajectory(
        [view_of(points, AHEAD), replace(late, offset_frames=0.5)], BODY, PRIOR, FPS, TrajectoryOptions(fast=True)
    )
    error = np.linalg.norm(said.joints_m - points, axis=-1).mean()
    assert error < np.linalg.norm(two().joints_m - points, axis=-1).mean() + 0.003


@pytest.mark.slow
def test_a_camera_late_by_less_than_a_frame_is_found(monkeypatch):
    """A lag that the view does not state is found, and positions are as accurate as without a lag.

    With one camera, the uncertainty of the positions includes the lag.
    """
    points = truth_m()
    late = view_of(0.6 * points + 0.4 * np.concatenate([points[1:], 2 * points[-1:] - points[-2:-1]]), AHEAD)
    third = view_of(points, level_pose([-6.0, 2.0, 0.5], 0.6), seed=2)

    def known_to(frames: float, *views: View) -> TrajectorySolution:
        with monkeypatch.context() as patch:
            patch.setattr(constants, "TIME_OFFSET_FRAMES", frames)
            return solve_trajectory(views, BODY, PRIOR, FPS, TrajectoryOptions(fast=True))

    of_three = (late, view_of(points, ASIDE, seed=1), third)
    found, held = (known_to(frames, *of_three) for frames in (constants.TIME_OFFSET_FRAMES, 1e-3))
    assert found.time_offset_frames[0] - found.time_offset_frames[1:].mean() == pytest.approx(0.4, abs=0.1)
    error = [np.linalg.norm(solution.joints_m - points, axis=-1).mean() for solution in (found, held)]
    assert error[0] < error[1]
    step_m = 9.0 / FPS
    one, sure = (known_to(frames, view_of(points, AHEAD)) for frames in (0.5, 1e-6))
    along = np.gradient(points.mean(axis=1), axis=0)
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    more = np.einsum("ta,tjab,tb->tj", along, one.covariance_m2 - sure.covariance_m2, along)
    assert 0.7 < np.median(more) / (0.5 * step_m) ** 2 < 1.0  # the motion prior reduces the uncertainty a little


def test_panning_camera_is_as_accurate_as_a_still_camera():
    """A panning camera has the rays of a static camera, and gives the same motion and uncertainty."""
    points = truth_m()
    T = len(points)
    still = still_view(CAMERA, seen(run()), np.ones(points.shape[:2]))
    angles = np.linspace(-0.2, 0.2, T)
    turn = np.tile(np.eye(3), (T, 1, 1))
    turn[:, 0, 0], turn[:, 0, 2], turn[:, 2, 0], turn[:, 2, 2] = (
        np.cos(angles),
        -np.sin(angles),
        np.sin(angles),
        np.cos(angles),
    )
    pans = rigid(turn @ still.T_camera_world[:3, :3], np.zeros(3))
    blank = replace(still, T_camera_world=pans)
    panning = replace(blank, xy_px=blank.project(still.rays())[0])
    options = TrajectoryOptions(fast=True)
    a = solve_trajectory([still], BODY, PRIOR, FPS, options)
    b = solve_trajectory([panning], BODY, PRIOR, FPS, options, ground_near_zero=False)
    assert np.linalg.norm(a.joints_m - b.joints_m, axis=-1).max() < 0.02
    assert b.size_from == ("prior",)
    spread = [np.sqrt(np.trace(s.relative_covariance_m2, axis1=2, axis2=3)).mean() for s in (a, b)]
    assert spread[1] == pytest.approx(spread[0], rel=0.03)


def test_carried_camera_determines_the_size():
    """The size follows from the path of the carried camera, which is known in metres."""
    points = truth_m()
    T = len(points)
    poses = np.stack([level_pose([np.sin(14 * t / FPS), 0.0, 0.3 * np.cos(14 * t / FPS)], np.pi / 2) for t in range(T)])
    solution = solve_trajectory(
        [view_of(points, poses)], BODY, PRIOR, FPS, TrajectoryOptions(fast=True, size_sigma=10.0)
    )
    assert solution.size_from == ("prior", "views")
    assert solution.size_sigma < 0.3
    assert solution.size == pytest.approx(1.0, abs=2 * solution.size_sigma)


def test_driven_camera_determines_the_size_from_standing_feet():
    """The camera moves at 10 m/s, and the feet of an animal of another size would slip on the ground."""
    points = read_pose3d(SAMPLES / "whole_truth.csv").xyz_m
    seconds = (np.arange(len(points)) - len(points) / 2) / 60
    poses = np.stack([level_pose([10.0 * t, -9.0, 0.6], np.pi / 2) for t in seconds])
    solution = solve_trajectory(
        [view_of(points, poses, sigma_px=0.5)], BODY, PRIOR, 60.0, TrajectoryOptions(fast=True, size_sigma=10.0)
    )
    assert solution.size_sigma < 0.2
    assert solution.size == pytest.approx(1.0, abs=0.1)


def test_displaced_view_equals_the_view_of_a_displaced_camera():
    """`View.corrected` and `Camera.corrected` move a camera in the same way."""
    extrinsic_correction, points = np.array([0.02, -0.03, 0.05, 0.1, -0.2, 0.05]), truth_m()
    camera = replace(CAMERA, rotation=ASIDE[:3, :3], translation_m=ASIDE[:3, 3])
    turned, view = camera.corrected(extrinsic_correction), view_of(points, ASIDE).corrected(extrinsic_correction)
    np.testing.assert_allclose(view.project(points)[0], turned.project(turned.world_to_camera(points))[0], atol=1e-9)


def test_displaced_cameras_are_refined():
    """The fit corrects the second of two cameras, which is turned by 1.5 degrees and moved by 4 cm."""
    extrinsic_correction = np.array([0.015, 0.02, -0.01, 0.03, 0.02, -0.02])
    views = [view_of(truth_m(), AHEAD), view_of(truth_m(), ASIDE, seed=1)]
    wrong = [views[0], views[1].corrected(-extrinsic_correction)]
    options = TrajectoryOptions(fast=True, refine_cameras=True)
    found = solve_trajectory(wrong, BODY, PRIOR, FPS, options)
    assert not found.extrinsic_correction[0].any()
    assert found.extrinsic_correction_sigma[1].all()
    turned = found.views[1].T_camera_world[:3, :3] @ views[1].T_camera_world[:3, :3].T
    assert np.degrees(np.arccos((np.trace(turned) - 1) / 2)) < 0.7
    off = found.joints_m - truth_m()
    assert np.linalg.norm(off - off.mean(axis=1, keepdims=True), axis=-1).mean() < 0.03
    assert np.nanmean(found.weight[1]) > 0.8  # weights are those for the refined pose, not for the given pose


def test_a_wrong_focal_length_is_found_by_two_cameras():
    """Two cameras find a focal length that is 8 % too short. A single camera keeps its focal length."""
    views = [view_of(truth_m(), AHEAD), view_of(truth_m(), ASIDE, seed=1)]
    options = TrajectoryOptions(fast=True, focal_sigma=0.1)
    found = solve_trajectory([views[0], views[1].with_focal_scale(-0.08)], BODY, PRIOR, FPS, options)
    assert found.focal[1] - found.focal[0] == pytest.approx(0.08, abs=0.03)
    assert (found.focal_sigma > 0).all()
    assert np.nanmean(found.weight[1]) > 0.8
    assert found.views[1].focal_px == pytest.approx(views[1].focal_px * np.exp(found.focal[1] - 0.08))
    alone = solve_trajectory(views[:1], BODY, PRIOR, FPS, options)
    assert (alone.focal[0], alone.focal_sigma[0]) == (0, 0)
    exact = solve_trajectory(views[:1], BODY, PRIOR, FPS, TrajectoryOptions(fast=True))
    assert alone.joints_m == pytest.approx(exact.joints_m)
    added_m2 = np.trace(alone.covariance_m2 - exact.covariance_m2, axis1=2, axis2=3).mean()
    distance_m = np.linalg.norm(exact.joints_m - views[0].centre_m[0], axis=-1).mean()
    assert np.sqrt(added_m2) == pytest.approx(0.1 * distance_m, rel=0.2)


def test_unmeasured_lengths_add_to_the_uncertainty_of_one_camera():
    """Unmeasured lengths add to the uncertainty only if the prior was not learned."""
    views = (view_of(truth_m(), AHEAD),)
    body = replace(BODY, subject=None)
    rough = ClipProblem.from_views(views, body, prior_from_body(body), FPS, TrajectoryOptions()).with_free_shape()
    _, nuisance = rough.shared_unknowns()
    (lengths,) = (unknown for unknown in nuisance if unknown.name == LENGTHS)
    assert lengths.sigma * np.sqrt(rough.correlation_frames) == pytest.approx(np.full(len(lengths.sigma), 0.1))
    for known_body, prior in ((body, PRIOR), (replace(body, subject="rex"), prior_from_body(body))):
        known = ClipProblem.from_views(views, known_body, prior, FPS, TrajectoryOptions()).with_free_shape()
        assert known.shape is None
