"""Test the direction of travel, the side and the position that are estimated from geometry."""

from __future__ import annotations

import numpy as np
import pytest

from recon.animal.chain import facing_side, upright_rotation
from recon.fit import starts
from recon.fit.starts import constant_velocity, position_on_rays
from recon.testing.gallop import gallop
from recon.thesis.chain import load_chain, mean_pose
from recon.thesis.start import estimate_travel, geometric_start

SK = load_chain("cheetah-8u")


def near_detections(clip) -> np.ndarray:
    return clip.keypoints.xy_px[:, [clip.keypoints.names.index(n) for n in SK.body.keypoint_names(clip.side)]]


@pytest.mark.parametrize("direction", ["left", "right"])
@pytest.mark.parametrize("heading_rad", [-0.6, 0.0, 0.35, 0.6])
def test_travel_and_side_of_a_gallop(direction, heading_rad: float):
    clip = gallop(heading_rad=heading_rad, direction=direction)
    travel = estimate_travel(clip.camera, SK, near_detections(clip), 30)
    path = clip.camera.world_to_camera(clip.truth_m[:, clip.names.index("tail_base")])
    truth = (path[-1] - path[0]) / np.linalg.norm(path[-1] - path[0])
    assert np.degrees(np.arccos(travel.heading @ truth)).max() < 10
    assert travel.speed_m_s[0] == pytest.approx(np.linalg.norm(path[-1] - path[0]) / (29 / 30), rel=0.15)
    rear, front = near_detections(clip)[:, 0], near_detections(clip)[:, SK.joints.index("J1")]
    assert facing_side(rear, front)[0] == direction == clip.side


def test_travel_without_data_is_not_moving():
    clip = gallop()
    travel = estimate_travel(clip.camera, SK, np.full((30, 9, 2), np.nan), 30)
    assert np.all(travel.speed_m_s == 0)
    np.testing.assert_allclose(np.linalg.norm(travel.heading, axis=1), 1)


def test_placing_a_known_shape_on_its_own_rays_is_exact_and_survives_a_wrong_ray():
    heading, up = np.array([0.8, 0, 0.6]), np.array([0.0, -1, 0])
    shape = SK.local_joints(mean_pose(SK)[None])[0] @ upright_rotation(heading, up).T
    position = np.array([1.0, 0.5, 8.0])
    rays = shape + position
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    np.testing.assert_allclose(position_on_rays(shape, rays[None])[0], position, atol=1e-5)
    rays[3] = [1, 0, 0]
    np.testing.assert_allclose(position_on_rays(shape, rays[None])[0], position, atol=0.05)


def test_geometric_start_faces_the_heading_and_lies_in_front():
    clip = gallop(heading_rad=0.35)
    rays, _ = clip.camera.rays(near_detections(clip)[0])
    heading = estimate_travel(clip.camera, SK, near_detections(clip), 30).heading[0]
    start = geometric_start(clip.camera, SK, rays, heading)
    posed = SK.pose(start[None])
    np.testing.assert_allclose(posed.rotation[0, :, 0], heading, atol=1e-12)
    truth = clip.camera.world_to_camera(clip.truth_m[0, clip.names.index("tail_base")])
    assert np.linalg.norm(posed.joints_m[0, 0] - truth) < 0.15 * np.linalg.norm(truth)


def test_rays_that_coincide_give_a_start():
    """Rays that coincide do not determine the distance, which is large and finite in the start."""
    ray = np.array([0.1, -0.05, 1.0]) / np.linalg.norm([0.1, -0.05, 1.0])
    heading, up = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]), np.array([0.0, -1.0, 0.0])
    shape = SK.local_joints(mean_pose(SK)[None])[0] @ upright_rotation(heading, up).transpose(0, 2, 1)
    for frames in (1, 2, 7):
        rays = np.broadcast_to(ray, (frames, 9, 3))
        misfit, run = constant_velocity(heading, shape, up, rays, np.arange(frames) - (frames - 1) / 2)
        assert np.isfinite(misfit).all()
        assert np.isfinite(run).all()


def test_nearly_singular_normal_equations_are_solved():
    """Normal equations that rounding makes singular are solved with nearly unchanged other unknowns."""
    matrix = np.array([np.diag([2.0, 4.0]), np.ones((2, 2))])
    right = np.array([[[2.0], [4.0]], [[3.0], [3.0]]])
    with pytest.raises(np.linalg.LinAlgError):
        np.linalg.solve(matrix, right)
    np.testing.assert_allclose(starts._solution(matrix, right), [[[1.0], [1.0]], [[1.5], [1.5]]], rtol=1e-6)
