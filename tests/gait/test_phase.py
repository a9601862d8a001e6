"""Test vector fields of links, phase portraits and degrees of closure."""

from __future__ import annotations

import numpy as np
import pytest
from command_line import refusal

from recon.gait.kinematics import angle_kinematics
from recon.gait.phase import (
    Portrait,
    closure,
    degree_of_closure,
    field_means,
    field_with_sigma,
    means_of_field,
    phase_portrait,
    pose_vector_field,
    scaled,
    tip_changes,
    tips,
    vector_field,
)
from recon.io.common import Pose3D

FPS = 90.0
TIME_S = np.arange(90) / FPS


def chain(angles: list[np.ndarray], lengths: list[np.ndarray], heading: float, place: np.ndarray) -> np.ndarray:
    """Return the joints of a chain from a moving point (T, 3) on, given each link's length and inclination (T,)."""
    ahead = np.array([np.cos(heading), np.sin(heading), 0.0])
    joints = [place]
    for angle, length in zip(angles, lengths, strict=True):
        link = np.cos(angle)[:, None] * ahead + np.sin(angle)[:, None] * [0, 0, 1]
        joints.append(joints[-1] + length[:, None] * link)
    return np.stack(joints, axis=1)


@pytest.mark.parametrize("heading", [0.0, 2.0])
def test_a_rotating_link(heading):
    """The tip of a rigid link of 0.3 m that turns at w moves at 0.3 |w|, for any motion of the parent."""
    parent = -1.2 + 0.8 * np.sin(9 * TIME_S)
    relative = 0.4 + 0.5 * np.sin(6 * TIME_S)
    rate = 3.0 * np.cos(6 * TIME_S)
    position = np.stack([9 * TIME_S, 0.3 * TIME_S, 0.5 + 0.1 * np.sin(8 * TIME_S)], axis=1)
    one = np.ones(90)
    joints = chain([parent, parent + relative], [0.5 * one, 0.3 * one], heading, position)
    forward = np.tile([np.cos(heading), np.sin(heading), 0.2], (90, 1))
    (field,) = vector_field(TIME_S, joints, ("a", "b", "c"), forward)
    assert (field.link, field.parent) == (("b", "c"), ("a", "b"))
    np.testing.assert_allclose(field.radius_m, 0.3, atol=1e-12)
    np.testing.assert_allclose(field.position_m[:, 2], 0.0, atol=1e-12)
    np.testing.assert_allclose(np.arctan2(*field.position_m[:, 1::-1].T), relative, atol=1e-9)
    np.testing.assert_allclose(field.dtheta_rad_s, rate, atol=2e-3)
    np.testing.assert_allclose(field.dr_m_s, 0.0, atol=1e-3)
    np.testing.assert_allclose(field.speed_m_s, 0.3 * np.abs(rate), atol=1e-3)
    means = means_of_field(field)
    assert means.speed_m_s == pytest.approx(0.3 * np.mean(np.abs(rate)), rel=1e-3)
    assert means.frames == 90
    table = field_means([field])
    assert (tuple(table), table.loc[0, "speed_m_s"], table.loc[0, "frames"]) == (means._fields, means.speed_m_s, 90)


def test_a_stretching_link_and_an_unmoved_link():
    one, stretch = np.ones(90), 0.3 + 0.1 * np.sin(5 * TIME_S)
    angles = [0.1 * one, -0.2 * one, 0.5 * one]
    joints = chain(angles, [one, stretch, 0.2 * one], 0.0, np.zeros((90, 3)))
    fields = vector_field(TIME_S, joints, ("a", "b", "c", "d"), np.tile([1.0, 0, 0], (90, 1)))
    np.testing.assert_allclose(fields[0].dr_m_s, 0.5 * np.cos(5 * TIME_S), atol=1e-4)
    np.testing.assert_allclose(fields[0].dtheta_rad_s, 0.0, atol=1e-9)
    np.testing.assert_allclose(fields[1].speed_m_s, 0.0, atol=1e-9)


def test_motion_out_of_the_plane_counts_in_the_3d_speed():
    swing = 0.5 * np.sin(4 * TIME_S)
    b = np.zeros((90, 3))
    c = np.stack([np.cos(swing), -np.sin(swing), 0 * swing], axis=1)
    joints = np.stack([b - [1, 0, 0], b, c], axis=1)
    (field,) = vector_field(TIME_S, joints, ("a", "b", "c"), np.tile([1.0, 0, 0], (90, 1)))
    np.testing.assert_allclose(field.position_m[:, 2], np.sin(swing), atol=1e-12)  # to the right
    np.testing.assert_allclose(np.linalg.norm(field.velocity_m_s, axis=1), np.abs(2 * np.cos(4 * TIME_S)), atol=1e-3)


def test_poses_with_gaps():
    one = np.ones(90)
    joints = chain([0 * one, 5 * TIME_S], [one, one], 0.0, np.zeros((90, 3)))
    joints[30:60, 2] = np.nan
    pose = Pose3D(("tail_base", "neck_base", "paw"), joints, np.arange(90))
    (field,) = pose_vector_field(pose, ("tail_base", "neck_base", "paw"), FPS)
    assert np.isnan(field.speed_m_s[30:60]).all()
    means = means_of_field(field)
    assert means.frames == 60
    assert means.dtheta_rad_s == pytest.approx(5.0, rel=1e-4)
    joints[:] = np.nan
    empty = pose_vector_field(Pose3D(pose.names, joints, pose.frames), ("tail_base", "neck_base", "paw"), FPS)
    assert np.isnan(means_of_field(empty[0]).speed_m_s)
    with refusal(("pose", "joints", "'hoof'")):
        pose_vector_field(pose, ("tail_base", "neck_base", "hoof"), FPS)
    with pytest.raises(ValueError, match="three joints"):
        pose_vector_field(pose, ("tail_base", "paw"), FPS)


def test_a_parent_across_the_travel_has_no_frame():
    joints = np.array([[[0.0, 0, 0], [0, 1, 0], [1, 1, 0]]] * 5)
    (field,) = vector_field(TIME_S[:5], joints, ("a", "b", "c"), np.tile([1.0, 0, 0], (5, 1)))
    assert np.isnan(field.speed_m_s).all()


def test_closure_of_a_full_and_of_a_half_turn():
    """The closures of a full and of half a turn of 0.3 cos(w t), 72 frames, agree with values computed by hand.

    Half a turn from the least to the greatest angle, in the scaled plane, runs from (0, 0) to (1, 0) over the half
    ellipse (u, 2 sqrt(u (1 - u))), whose farthest point from an end is at u = 2/3: d_max = sqrt(4/9 + 8/9).
    """
    angle = angle_kinematics(TIME_S, 0.3 * np.cos(2 * np.pi * 1.25 * TIME_S))
    full, half = (closure(phase_portrait(angle, a / FPS, b / FPS)) for a, b in ((5, 77), (36, 72)))
    assert full.angle == pytest.approx(100.0, abs=0.01)
    assert full.plane == pytest.approx(100.0, abs=0.1)
    assert half.angle == pytest.approx(0.0, abs=1e-9)
    assert half.plane == pytest.approx(100 * (1 - np.sqrt(3) / 2), abs=0.01)


def test_deviation_of_a_closure_by_hand():
    """The standard deviation of a closure agrees with a value computed by hand.

    The ends of a full turn have independent errors of sigma: D = 100 - 100 |n| / 0.6 with n normal of sqrt(2) sigma,
    and the standard deviation of |n| is sqrt(1 - 2 / pi) times the standard deviation of n.
    """
    sigma, error_time_s = 0.006, 0.05
    time_s = np.linspace(0.0, 0.8, 201)
    turn = 2 * np.pi * time_s / 0.8
    of_both = np.full(201, sigma), np.full(201, sigma / error_time_s)
    found = closure(Portrait(time_s, 0.3 * np.cos(turn), -0.3 * 2 * np.pi / 0.8 * np.sin(turn), *of_both))
    assert found.angle_sigma == pytest.approx(100 * np.sqrt(2) * sigma / 0.6 * np.sqrt(1 - 2 / np.pi), rel=0.2)
    without = closure(Portrait(time_s, np.cos(turn), np.sin(turn)))
    assert np.isnan([without.angle_sigma, without.plane_sigma]).all()


def test_deviations_of_a_link_that_turns():
    """A link that turns at 2 ± 0.1 rad/s has a speed with the error of its length times 0.1, and an exact radius."""
    angle = 0.5 + 2.0 * TIME_S
    tip = 0.4 * np.column_stack([np.cos(angle), np.zeros(90), np.sin(angle)])
    joints = np.stack([np.tile([-1.0, 0, 0], (90, 1)), np.zeros((90, 3)), tip], axis=1)
    (field,) = vector_field(TIME_S, joints, ("a", "b", "c"), np.tile([1.0, 0, 0], (90, 1)))
    across = np.stack([-field.position_m[:, 1], field.position_m[:, 0]], axis=1)
    found = field_with_sigma(field, 0.1 * across[:, :, None])
    np.testing.assert_allclose(found.dtheta_sigma_rad_s, 0.1)
    np.testing.assert_allclose(found.speed_sigma_m_s, 0.04, rtol=1e-3)
    np.testing.assert_allclose(found.dr_sigma_m_s, 0, atol=1e-12)
    means = means_of_field(found)
    assert means.speed_sigma_m_s == pytest.approx(0.04, rel=1e-3)


def test_changes_of_the_tips_agree_with_central_differences():
    rng, step = np.random.default_rng(0), 1e-6
    joints, forward = rng.normal(size=(7, 5, 3)), rng.normal(size=(7, 3))
    moved, forward_moved = rng.normal(size=(7, 5, 3, 2)), rng.normal(size=(7, 3, 2))
    found = tip_changes(joints, forward, moved, forward_moved)
    for k in range(2):
        later, earlier = (
            tips(joints + s * moved[..., k], forward + s * forward_moved[..., k])[..., :2] for s in (step, -step)
        )
        np.testing.assert_allclose(found[..., k], (later - earlier) / (2 * step), rtol=1e-6, atol=1e-7)


def test_closure_of_a_quarter_circle_by_hand():
    turn = np.linspace(0, 1.5 * np.pi, 1001)
    path = np.column_stack([np.cos(turn), np.sin(turn)])
    assert degree_of_closure(path) == pytest.approx(100 * (1 - np.sqrt(2) / 2), abs=1e-3)
    assert degree_of_closure(path[:, :1]) == pytest.approx(50.0, abs=1e-3)
    np.testing.assert_allclose(np.ptp(scaled(path * [3.0, 50.0]), axis=0), 1.0)
    assert degree_of_closure(scaled(path * [3.0, 50.0])) == pytest.approx(degree_of_closure(path))


def test_closure_without_motion_or_points():
    still = Portrait(TIME_S, np.ones(90), np.zeros(90))
    assert np.isnan(closure(still).angle)
    assert np.isnan(closure(still).plane)
    with pytest.raises(ValueError, match="without gaps"):
        closure(Portrait(TIME_S, np.full(90, np.nan), np.zeros(90)))
    with pytest.raises(ValueError, match="two points"):
        closure(phase_portrait(angle_kinematics(TIME_S, np.ones(90)), 5.0, 6.0))
