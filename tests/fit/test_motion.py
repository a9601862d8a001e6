"""Test that motions of both methods have the same quantities in the same frames of reference."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from motions import with_first

from recon.animal.skeleton_file import load_skeleton
from recon.fit.motion import Motion
from recon.fit.result import TrajectorySolution


@pytest.fixture(params=["small_motion", "small_trajectory", "world_trajectory"])
def motion(request) -> Motion:
    return request.getfixturevalue(request.param)


def chain_trajectory(of: Motion, small_motion: Motion) -> Motion:
    """Return a trajectory of the 8U chain's body, with poses around the mean pose."""
    body, T = load_skeleton("cheetah-8u"), 6
    states = np.zeros((T, body.n_state))
    states[:, :3] = [-1.0, 9.0, 0.3] + 0.3 * np.arange(T)[:, None] * [1.0, 0.0, 0.0]
    states[:, 3] = 0.3
    states[:, 4:] = body.mean_rad + np.random.default_rng(3).normal(0, 0.1, (T, body.n_state - 4))
    states[3] = np.nan
    arrays = {
        "states": states,
        "joints_m": body.tree.pose(states, 1.1).points_m,
        "covariance_m2": np.tile(np.eye(3), (T, 9, 1, 1)),
        "relative_covariance_m2": np.tile(np.eye(3), (T, 9, 1, 1)),
        "angle_sigma_rad": np.full((T, body.n_state - 3), 0.1),
        "angle_data_share": np.ones((T, body.n_state - 3)),
        "data_share": np.ones(9),
        "views": (of.solution.views[0].part(slice(0, T)),),
        "noise_px": np.full((1, T, 9), 5.0),
        "weight": np.ones((1, T, 9)),
        "flags": ((),) * T,
        "alternative_m": np.full(T, np.nan),
        "contact": np.zeros((T, 2)),
    }
    solution = replace(of.solution, body=body, size=1.1, **arrays)
    return replace(small_motion, solution=solution)


def test_shapes_and_names_agree(motion: Motion):
    T, J, D = len(motion.frames), len(motion.names), len(motion.state_names)
    assert motion.joints_m.shape == motion.joints_camera_m.shape == (T, J, 3)
    assert motion.states.shape == (T, D)
    assert motion.angles_rad.shape == (T, len(motion.angle_names))
    assert motion.root_m.shape == (T, 3)
    (picture,) = motion.pictures
    assert picture.sigma_px.shape == picture.outliers.shape == picture.distance_px.shape == (T, J)
    assert len(motion.joints) == J
    assert {j for limb in motion.limbs.values() for j in limb} <= set(range(J))
    assert all(len(limb) > 1 for limb in motion.limbs.values())
    rear, front = motion.forward
    ahead = motion.joints_camera_m[motion.solved][:, front] - motion.joints_camera_m[motion.solved][:, rear]
    assert (ahead[:, 0] > 0).all()
    lowest = np.argsort(motion.joints_camera_m[0, :, 1])[-len(motion.feet) :]
    assert set(motion.feet) == set(lowest)


def test_root_is_the_joint_that_names_it(motion: Motion):
    at = motion.joints.index(motion.root_name)
    np.testing.assert_allclose(motion.root_m, motion.joints_m[:, at], atol=1e-12)
    assert motion.root_name == ("J0" if motion.body.one_sided else "spine")


def test_detections_far_from_the_pose_are_outliers(small_motion, small_trajectory):
    for motion, frame, name in ((small_motion, 14, "neck_base"), (small_trajectory, 14, "nose")):
        ((t, j),) = np.argwhere(motion.pictures[0].outliers)
        assert (motion.frames[t], motion.names[j]) == (frame, name)
    assert small_trajectory.pictures[0].distance_px[4, 0] == pytest.approx(300.0)


def test_unused_and_missing_keypoints(small_trajectory):
    assert small_trajectory.unused_keypoints == ("ear",)
    assert small_trajectory.missing_keypoints == ("r_eye",)


def test_reprojections_lie_where_the_detector_sees_the_joints(small_trajectory):
    """Reprojections include the offsets of the skeleton's shoulder keypoints from the joints."""
    body = small_trajectory.body
    shifted = replace(body, keypoint_offset_m={"l_shoulder": (0.0, 0.0, 0.1)})
    motion = replace(small_trajectory, solution=replace(small_trajectory.solution, body=shifted))
    j = body.markers.index("l_shoulder")
    np.testing.assert_array_equal(motion.joints_m, small_trajectory.joints_m)
    depth, focal = motion.joints_camera_m[0, j, 2], motion.camera.matrix[1, 1]
    difference = motion.pictures[0].reprojected_px - motion.camera.project(motion.joints_camera_m)[0]
    assert difference[0, j, 1] == pytest.approx(-0.1 * focal / depth, rel=0.01)
    assert np.abs(np.delete(difference, j, axis=1)).max() == 0


def test_states_of_a_body_give_its_joints_in_the_world(world_trajectory):
    motion = world_trajectory
    assert motion.states_frame == "world"
    points = motion.body.tree.pose(motion.states, motion.solution.size).points_m
    np.testing.assert_allclose(points, motion.joints_m, atol=1e-12)
    # The camera looks along x, and the animal runs along -y.
    np.testing.assert_allclose(motion.states[:, 3], -np.pi / 2)
    np.testing.assert_allclose(np.diff(motion.root_m, axis=0), np.tile([0, -0.3, 0], (7, 1)), atol=1e-12)


def test_states_without_a_world_are_in_the_level_frame(small_trajectory):
    motion = small_trajectory
    assert motion.states_frame == "level"
    np.testing.assert_array_equal(motion.states, motion.solution.states)
    points = motion.body.tree.pose(motion.states).points_m
    np.testing.assert_allclose(motion.in_reference(points), motion.joints_m, atol=1e-12)
    # The world of a calibration board may be tilted, so that yaw has no meaning in it.
    board = with_first(
        motion, camera=replace(motion.camera, rotation=np.eye(3), translation_m=np.zeros(3), world_z_up=False)
    )
    assert (board.states_frame, board.frame_of_reference) == ("level", "world")
    np.testing.assert_array_equal(board.states, motion.solution.states)


def test_states_of_a_chain_have_the_names_of_its_unknowns(small_trajectory, small_motion):
    motion = chain_trajectory(small_trajectory, small_motion)
    assert motion.states_frame == small_motion.states_frame == "level"
    assert motion.state_names == small_motion.state_names
    assert motion.state_names[3:8] == ("J0_yaw", "J0_pitch", "J0_roll", "phi_6", "theta_6")
    assert list(motion.solved) == [True, True, True, False, True, True]
    assert np.isnan(motion.states[3]).all()
    assert [motion.names[foot] for foot in motion.feet] == ["r_back_paw", "r_front_paw"]


def test_states_of_the_frame_method_give_its_joints_in_the_world(small_motion):
    solved, solution = small_motion.solved, small_motion.solution
    chain, base = solution.chain, solution.chain_states[:, solution.chain.base_index]
    points = small_motion.body.tree.pose(small_motion.states[solved], base[solved] / chain.nominal_base_length_m)
    np.testing.assert_allclose(points.points_m, solution.joints_m[solved], atol=1e-12)
    published = chain.pose(solution.chain_states[solved]).joints_m
    np.testing.assert_allclose(published, small_motion.joints_camera_m[solved], atol=1e-12)
    assert solution.size == np.nanmedian(base) / chain.nominal_base_length_m
    assert small_motion.names == chain.body.keypoint_names("right")


def test_sigmas_are_along_the_axes_of_the_frame_of_reference(small_trajectory, world_trajectory):
    np.testing.assert_allclose(small_trajectory.relative_sigma_m[0, 0], [0.02, 0.02, 0.08])
    # The camera looks along x.
    np.testing.assert_allclose(world_trajectory.relative_sigma_m[0, 0], [0.08, 0.02, 0.02])
    position = np.array([0.3, 0.05, 0.05])
    np.testing.assert_allclose(world_trajectory.joint_sigma_m[0, 0], np.hypot([0.08, 0.02, 0.02], position))
    np.testing.assert_allclose(world_trajectory.relative_rms_m, np.sqrt(2 * 0.02**2 + 0.08**2))


def test_place_sigma_is_along_the_line_of_sight(small_trajectory):
    """`place_sigma_m` agrees with the spread of the joints' mean in draws of a position and of relative offsets."""
    rng = np.random.default_rng(5)
    J, draws = 24, 4000
    mixing = rng.normal(0, 0.05, (3 * J, 3 * J)) / np.sqrt(J)
    offsets = (rng.normal(size=(draws, 3 * J)) @ mixing.T).reshape(draws, J, 3)
    # The offsets and the position are correlated, so the joints' covariances are not their sums.
    position = rng.normal(0, [0.05, 0.05, 0.3], (draws, 3)) + 2 * offsets[:, 0]
    points = position[:, None] + offsets  # camera frame
    centred = points - points.mean(axis=1, keepdims=True)

    def covariance(values):
        off = (values - values.mean(axis=0)) @ small_trajectory.solution.views[0].rotation  # world frame
        return np.einsum("nja,njb->jab", off, off) / draws

    solution: TrajectorySolution = replace(
        small_trajectory.solution,
        covariance_m2=np.tile(covariance(points), (8, 1, 1, 1)),
        relative_covariance_m2=np.tile(covariance(centred), (8, 1, 1, 1)),
    )
    motion = replace(small_trajectory, solution=solution)
    ray = motion.joints_camera_m.mean(axis=1)
    ray /= np.linalg.norm(ray, axis=1, keepdims=True)
    expected = (points.mean(axis=1) @ ray.T).std(axis=0)
    np.testing.assert_allclose(motion.place_sigma_m, expected, rtol=1e-9)


def test_mean_weight(small_trajectory):
    weight = small_trajectory.mean_weight
    assert weight[0] == 1
    assert np.isnan(weight[3])
    assert weight[4] == pytest.approx((22 + 0.05) / 23)


def test_ground_below_the_animal(small_trajectory, world_trajectory):
    (segment,) = small_trajectory.solution.segments
    below, ground = small_trajectory.below_m(segment), segment.ground
    assert below is not None
    assert below[:2] == pytest.approx([-1.5 + 0.15 * 7, 9.0])
    assert below[2] == pytest.approx(ground.height_m + 0.02 * 9.0)
    # The camera stands 3 m high.
    (segment,) = world_trajectory.solution.segments
    assert world_trajectory.below_m(segment)[2] == pytest.approx(3 + below[2])
    assert world_trajectory.below_m(replace(segment, ground=None)) is None


def test_refuses_keypoints_of_another_skeleton(small_motion, small_trajectory):
    with pytest.raises(ValueError, match="are not those of the joints"):
        with_first(small_trajectory, keypoints=small_motion.keypoints)
    with pytest.raises(ValueError, match="are not those of the joints"):
        replace(small_motion, side="left")
    with pytest.raises(ValueError, match="no frame rate"):
        with_first(small_motion, keypoints=replace(small_motion.keypoints, fps=None))


def test_a_second_camera_does_not_change_the_picture_of_the_first(two_cameras, world_trajectory):
    for name in ("detected_px", "reprojected_px", "sigma_px", "image_error_px", "distance_px", "outliers"):
        np.testing.assert_array_equal(
            *(getattr(motion.pictures[0], name) for motion in (two_cameras, world_trajectory))
        )


def test_every_camera_has_its_picture(two_cameras):
    motion, picture = two_cameras, two_cameras.pictures[1]
    assert [picture.name for picture in motion.pictures] == ["cam1", "cam2"]
    np.testing.assert_allclose(picture.T_reference_camera[:3, 3], [10, -8, 2.5], atol=1e-12)
    np.testing.assert_allclose(picture.T_reference_camera[:3, 2], [0, 1, 0], atol=1e-12)
    assert not picture.present[:2].any()
    assert np.argwhere(picture.outliers).tolist() == [[5, motion.names.index("tail_base")]]
    assert picture.distance_px[5, motion.names.index("tail_base")] == pytest.approx(200)
    assert np.nanmedian(picture.distance_px) < 1e-9
    away_m = np.linalg.norm(motion.joints_m.mean(axis=1) - [10, -8, 2.5], axis=-1)
    np.testing.assert_allclose(picture.distance_m, away_m)


def test_moving_camera_has_a_pose_in_each_frame(two_cameras):
    first, second = two_cameras.solution.views
    poses = np.tile(second.T_camera_world, (8, 1, 1))
    poses[:, :3, 3] -= np.arange(8)[:, None] * poses[:, :3, 0]  # the camera moves along x by one metre per frame
    moving = replace(two_cameras.solution, views=(first, replace(second, T_camera_world=poses)))
    places_m = replace(two_cameras, solution=moving).pictures[1].T_reference_camera[:, :3, 3]
    np.testing.assert_allclose(places_m - [10, -8, 2.5], np.arange(8)[:, None] * [1, 0, 0], atol=1e-12)


def test_detections_and_weights_include_all_cameras(two_cameras):
    assert two_cameras.detections.tolist() == [23, 23, 47, 24, 47, 47, 47, 47]
    assert two_cameras.mean_weight[[0, 3]].tolist() == [1.0, 0.5]
    assert two_cameras.mean_weight[2] == pytest.approx((23 + 24 / 2) / 47)
    assert two_cameras.missing_keypoints == ()  # the second camera's file has r_eye
    assert two_cameras.unused_keypoints == ("ear",)


def test_derived_results_are_cached_until_the_motion_changes(small_trajectory: Motion):
    made = []

    def frames_of(motion: Motion) -> int:
        made.append(motion)
        return len(motion.frames)

    motion, renamed = replace(small_trajectory), replace(small_trajectory, side_reason="another")
    assert motion.derived(frames_of) == motion.derived(frames_of) == len(motion.frames)
    assert renamed.derived(frames_of) == len(renamed.frames)
    assert [*map(id, made)] == [id(motion), id(renamed)]
