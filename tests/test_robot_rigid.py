"""Twists: a published value, the group's axioms, and the plane against its own formula."""

import numpy as np
import pytest
from scipy.linalg import expm

from recon.robotics.robot.rigid import exp_se3, log_se3

V, W = np.array([2.0, 1.0, -3.0]), np.array([np.pi / 10, -np.pi / 4, np.pi / 9])


def test_published_value():
    motion = exp_se3(V, W, 2.0)
    assert motion.translation == pytest.approx([4.6977, 4.5839, -0.8141], abs=5e-5)
    assert motion.rotation.as_matrix()[0] == pytest.approx([-0.1084, -0.7389, -0.6650], abs=5e-5)
    v, w = log_se3(motion, 2.0)
    np.testing.assert_allclose(np.concatenate([v, w]), np.concatenate([V, W]), rtol=0, atol=1e-12)


def twists(n, scale, seed=0):
    rng = np.random.default_rng(seed)
    return rng.normal(size=(n, 3)), scale * rng.normal(size=(n, 3))


@pytest.mark.parametrize("scale", [1.0, 1e-7, 0.0])
def test_exponential_of_the_matrix(scale):
    v, w = twists(50, scale)
    motions = exp_se3(v, w).as_matrix()
    for k in range(50):
        x, y, z = w[k]
        twist = np.array([[0, -z, y, v[k, 0]], [z, 0, -x, v[k, 1]], [-y, x, 0, v[k, 2]], [0, 0, 0, 0]])
        np.testing.assert_allclose(motions[k], expm(twist), atol=1e-12)


@pytest.mark.parametrize("scale", [0.5, 1e-7, 0.0])
def test_log_of_exp(scale):
    v, w = twists(50, scale)
    back = log_se3(exp_se3(v, w))
    np.testing.assert_allclose(back, (v, w), atol=1e-12)


def test_times_add_up():
    whole = exp_se3(V, W, 1.5)
    parts = exp_se3(V, W, 0.5) * exp_se3(V, W, 1.0)
    np.testing.assert_allclose(whole.as_matrix(), parts.as_matrix(), atol=1e-12)
    many = exp_se3(V, W, np.array([0.0, 1.5]))
    np.testing.assert_allclose(many.as_matrix(), [np.eye(4), whole.as_matrix()], atol=1e-12)
