"""Compare the pose of a body on planted feet with the published trigonometry."""

import numpy as np
import pytest

from recon.robotics.quadruped import body_pose, feet_in_world, leg_targets

A, C, L = 0.065, 0.0625, 0.11
"""Half length and half width of the rectangle of the hips, and height of the hips above the feet, metres."""
HIPS = np.array([(A, C, 0), (A, -C, 0), (-A, C, 0), (-A, -C, 0)], float)
FEET = HIPS - [0, 0, L]
ANGLES = np.linspace(-0.6, 0.6, 25)


def test_pitch_equals_the_published_formula():
    pitch = ANGLES
    targets = leg_targets(body_pose(np.zeros((25, 3)), 0.0, pitch, 0.0), HIPS, FEET)
    s, c = np.sin(pitch), np.cos(pitch)
    front, rear = L - A * s, L + A * s
    expected_front = np.stack([front * s + A * (1 - c) * c, 0 * s, -(front * c - A * (1 - c) * s)], axis=-1)
    expected_rear = np.stack([rear * s - A * (1 - c) * c, 0 * s, -(rear * c + A * (1 - c) * s)], axis=-1)
    np.testing.assert_allclose(targets[:, :2], np.stack([expected_front] * 2, axis=1), atol=1e-12)
    np.testing.assert_allclose(targets[:, 2:], np.stack([expected_rear] * 2, axis=1), atol=1e-12)


def test_yaw_equals_the_published_formula():
    # Compare the right front leg with the published formula, in which x is right, y forwards and a clockwise.
    width, length, a = C, A, ANGLES
    r, b = np.hypot(width, length), np.arctan(length / width)
    E, D = r * np.sin(b - a), r * np.cos(b - a)
    G, F = length - E, D - width
    targets = leg_targets(body_pose(np.zeros((25, 3)), 0.0, 0.0, -a), HIPS, FEET)[:, 1]
    # The foot from the hip is (-F, G) in ground axes, turned by minus the yaw for body axes.
    right, forwards = -F, G
    x = np.cos(a) * forwards + np.sin(a) * right
    y = -(np.cos(a) * right - np.sin(a) * forwards)
    np.testing.assert_allclose(targets, np.stack([x, y, np.full(25, -L)], axis=-1), atol=1e-12)


def test_roll_equals_pitch_with_width_and_length_exchanged():
    # Right side down equals nose down with width and length exchanged.
    turned = leg_targets(body_pose(np.zeros((25, 3)), ANGLES, 0.0, 0.0), HIPS, FEET)
    s, c = np.sin(ANGLES), np.cos(ANGLES)
    right = L - C * s
    expected = np.stack([0 * s, -(right * s + C * (1 - c) * c), -(right * c - C * (1 - c) * s)], axis=-1)
    np.testing.assert_allclose(turned[:, 1], expected, atol=1e-12)


def test_translation_moves_the_feet_the_other_way():
    moved = leg_targets(body_pose([0.01, -0.02, 0.03], 0.0, 0.0, 0.0), HIPS, FEET)
    np.testing.assert_allclose(moved, np.tile([-0.01, 0.02, -L - 0.03], (4, 1)), atol=1e-15)


def test_feet_in_world_inverts_leg_targets():
    rng = np.random.default_rng(0)
    pose = body_pose(rng.normal(size=(40, 3)), *rng.uniform(-1, 1, (3, 40)))
    targets = leg_targets(pose, HIPS, FEET)
    assert targets.shape == (40, 4, 3)
    np.testing.assert_allclose(feet_in_world(pose, HIPS, targets), np.broadcast_to(FEET, (40, 4, 3)), atol=1e-12)
    # Distances from the hips do not depend on the axes.
    hips = feet_in_world(pose, HIPS, np.zeros((4, 3)))
    assert np.linalg.norm(targets, axis=-1) == pytest.approx(np.linalg.norm(FEET - hips, axis=-1))
