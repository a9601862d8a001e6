"""Test chains from skeletons and their joint angles."""

from __future__ import annotations

import numpy as np
import pytest

from recon.animal.skeleton_file import load_skeleton
from recon.geometry.frames import inverse, rigid
from recon.geometry.kinematics import ROOT, YAW
from recon.ik.animal_chain import body_chain, body_chain_angles, chain_angles, projected_chain, spine_front_leg
from recon.ik.chain import planar_chain
from recon.testing.gallop import gallop
from recon.thesis.chain import load_chain


def test_spine_front_leg_has_the_links_of_the_skeleton():
    skeleton = load_chain("cheetah-8u")
    chain = spine_front_leg(skeleton)
    np.testing.assert_allclose(chain.lengths_m, 0.203 * np.array([2.045, 1.545, 1.273, 1.364, 1.0]))
    assert (chain.n, chain.dim) == (10, 3)
    np.testing.assert_allclose(chain.lower_rad, [-0.9, -0.4, 0.8, -2.1, -0.8, -0.75, -0.5, -0.5, -0.5, -0.5])
    np.testing.assert_allclose(chain.upper_rad, [0.9, 0.5, 3.0, 0.3, 1.8, 0.75, 0.5, 0.5, 0.5, 0.5])
    np.testing.assert_allclose(chain.max_rate_rad_s, [8, 8, 30, 30, 30, 5, 5, 10, 10, 10])
    flat = spine_front_leg(skeleton, base_length_m=0.1, dim=2, limited=False)
    np.testing.assert_allclose(flat.lengths_m, [0.2045, 0.1545, 0.1273, 0.1364, 0.1])
    assert flat.n == 5
    assert np.isinf(flat.upper_rad).all()


@pytest.mark.parametrize("direction", ["left", "right"])
def test_chain_angles_reproduce_the_joint_positions(direction):
    skeleton = load_chain("cheetah-8u")
    clip = gallop(n_frames=20, heading_rad=0.3, direction=direction)
    states, _ = skeleton.to_body(clip.state, inverse(rigid(clip.camera.rotation, clip.camera.translation_m)))
    q = chain_angles(skeleton, states)
    names = ["J0", "J9", "J1", "J2", "J3", "J4"]
    where = [skeleton.joints.index(name) for name in names]
    joints = clip.camera.camera_to_world(skeleton.pose(clip.state).joints_m[:, where])
    root, up = joints[:, 0], np.array([0.0, 0.0, 1.0])
    ahead = root[-1] - root[0]
    ahead = ahead - (ahead @ up) * up
    ahead /= np.linalg.norm(ahead)
    base = np.stack([ahead, -up, np.cross(ahead, -up)])
    chain = spine_front_leg(skeleton)
    for t in range(20):
        np.testing.assert_allclose(chain.positions(q[t]), (joints[t] - root[t]) @ base.T, atol=1e-12)
    # No link jumps to its second pair of angles, which has the same direction.
    assert np.abs(np.diff(q[:, :5], axis=0)).max() < 1.5
    np.testing.assert_allclose(chain_angles(skeleton, states, travel=ahead), q, atol=1e-12)
    np.testing.assert_array_equal(chain_angles(skeleton, states, dim=2), q[:, :5])


def test_chain_angles_of_a_level_animal_equal_the_skeletons():
    skeleton = load_chain("cheetah-8u")
    state = np.zeros((2, skeleton.body.n_state))
    state[:, 4:] = skeleton.body.mean_rad
    q = chain_angles(skeleton, state)
    at = [skeleton.body.state_names.index(f"theta_{k}") for k in (1, 2, 3, 4)]
    np.testing.assert_allclose(q[:, 1:5], state[:, at], atol=1e-12)
    np.testing.assert_allclose(np.delete(q, [1, 2, 3, 4], axis=1), 0, atol=1e-12)


def test_chain_angles_leave_missing_frames_missing():
    skeleton = load_chain("cheetah-8u")
    state, _ = skeleton.to_body(gallop(n_frames=6).state, np.eye(4))
    state[2] = np.nan
    q = chain_angles(skeleton, state)
    assert np.isnan(q[2]).all()
    assert np.isfinite(np.delete(q, 2, axis=0)).all()


def cheetah():
    return load_skeleton("cheetah-24")


def random_states(body, count=6, seed=0):
    """Draw states around the expected pose, with the root at random positions."""
    rng = np.random.default_rng(seed)
    states = rng.normal(size=(count, body.n_state))
    states[:, 4:] = body.mean_rad + 0.7 * body.sigma_rad * states[:, 4:]
    return states


@pytest.mark.parametrize("foot", ["l_front_paw", "r_front_paw", "l_back_paw", "r_back_paw", "nose", "tail2"])
def test_body_chain_ends_at_the_marker(foot):
    body, size = cheetah(), 1.07
    states, travel = random_states(body), np.array([-0.4, 1.1, 0.3])
    chain = body_chain(body, foot, size)
    names = chain.names
    q = body_chain_angles(body, foot, states, travel)
    assert names[:3] == ("rear_trunk_yaw", "rear_trunk_pitch", "rear_trunk_roll")
    assert q.shape == (len(states), chain.n)
    heading = np.arctan2(travel[1], travel[0])
    base = np.array([[np.cos(heading), np.sin(heading), 0], [-np.sin(heading), np.cos(heading), 0], [0, 0, 1]])
    marker = body.tree.pose(states, size).points_m[:, body.markers.index(foot)] - states[:, ROOT]
    np.testing.assert_allclose([chain.end(x) for x in q], marker @ base.T, rtol=0, atol=1e-12)
    others = [body.state_names.index(name) for name in names[1:]]
    np.testing.assert_array_equal(q[:, 1:], states[:, others])


def test_body_chain_of_a_front_leg():
    body = cheetah()
    chain = body_chain(body, "l_front_paw")
    assert chain.names[3:] == (
        *("front_trunk_yaw", "front_trunk_pitch", "front_trunk_roll"),
        *("l_fore_upper_pitch", "l_fore_lower_pitch", "l_fore_foot_pitch"),
    )
    assert chain.groups == ((0, 3), (1, 4, 6, 7, 8), (2, 5))
    pitch = body.state_names.index("l_fore_upper_pitch")
    assert chain.lower_rad[6] == pytest.approx(body.mean_rad[pitch - 4] - 3 * body.sigma_rad[pitch - 4])
    assert chain.upper_rad[6] == pytest.approx(body.mean_rad[pitch - 4] + 3 * body.sigma_rad[pitch - 4])
    np.testing.assert_allclose((chain.lower_rad[0], chain.upper_rad[0]), (-np.pi, np.pi))
    assert np.isinf(body_chain(body, "l_front_paw", limited=False).upper_rad).all()
    # The trunk's joints rotate the link from the spine to the shoulder, the next joints the upper arm, and so on.
    shoulder = np.hypot(0.444, 0.1141)
    np.testing.assert_allclose(chain.joint_lengths_m[:8], [*[shoulder] * 6, 0.25, 0.275])


def test_travel_of_a_body_and_its_yaw():
    body = cheetah()
    states = np.zeros((5, body.n_state))
    states[:, YAW] = [3.0, 3.1, 3.2, 3.3, np.nan]
    # The animal stands, so its direction is between the first and the last yaw, without a jump at half a turn.
    q = body_chain_angles(body, "l_front_paw", states)
    np.testing.assert_allclose(q[:, 0], [-0.15, -0.05, 0.05, 0.15, np.nan], atol=1e-12)
    # The animal walks backwards along y.
    states[:, 1] = np.arange(5) * -0.5
    q = body_chain_angles(body, "l_front_paw", states)
    np.testing.assert_allclose(q[:4, 0], np.array([3.0, 3.1, 3.2, 3.3]) + np.pi / 2 - 2 * np.pi, atol=1e-12)


def test_body_chain_refuses_unknown_markers_and_summed_angles():
    with pytest.raises(ValueError, match="no marker paw, only nose"):
        body_chain(cheetah(), "paw")
    with pytest.raises(ValueError, match="add up"):
        body_chain(load_chain("cheetah-8u").body, "J4")


def test_planar_chain_of_a_planar_motion_is_exact():
    rng = np.random.default_rng(5)
    true, q = planar_chain((0.4, 0.3, 0.25)), rng.uniform(-1, 1, (7, 3))
    travel, side = np.array([0.6, 0.8, 0.0]), np.array([-0.8, 0.6, 0.0])
    flat = np.array([true.positions(x) for x in q])
    points = flat[..., :1] * travel - flat[..., 1:] * [0, 0, 1] + rng.normal(size=(7, 4, 1)) * side + [1.0, 2.0, 3.0]
    points[3] = np.nan
    chain, found, misfit = projected_chain(points, travel + np.array([0, 0, 0.2]))
    known = np.arange(7) != 3
    np.testing.assert_allclose(chain.lengths_m, true.lengths_m)
    np.testing.assert_allclose(found[known], q[known], atol=1e-12)
    np.testing.assert_allclose(misfit[known], 0, atol=1e-12)
    assert np.isnan(misfit[3])
    # If a link is seen shorter in one frame, the chain, whose lengths are constant, does not reach the foot.
    points[0, 3] = points[0, 2] + 0.8 * (points[0, 3] - points[0, 2])
    chain, _, misfit = projected_chain(points, travel)
    np.testing.assert_allclose(chain.lengths_m, true.lengths_m)
    np.testing.assert_allclose(misfit[0], 0.2 * 0.25, atol=1e-12)


def test_angles_of_a_planar_chain_do_not_jump():
    angles = np.linspace(0, 9, 40)
    points = np.zeros((40, 3, 3))
    points[:, 1] = 0.3 * np.stack([np.cos(angles), 0 * angles, -np.sin(angles)], axis=1)
    points[:, 2] = points[:, 1] * 2
    _, q, _ = projected_chain(points, [1.0, 0.0, 0.0])
    np.testing.assert_allclose(q[:, 0], angles, atol=1e-12)
    np.testing.assert_allclose(q[:, 1], 0, atol=1e-12)
