"""Test that a solution keeps its pictures if its size is changed."""

from __future__ import annotations

import numpy as np
import pytest

from recon.fit.solution import states_at_size


@pytest.mark.parametrize("other_size", [0.8, 0.999, 1.3])
def test_another_size_keeps_the_pictures_of_a_moving_camera(other_size):
    """A camera moves 7 m with an animal that is 14 m away, as in the frame of a belt.

    From each position of the camera, the animal's distance is proportional to its size.
    """
    size, origin_m = 0.78, np.array([3.8, -14.0, 1.5])
    centres_m = origin_m + np.linspace(-3.5, 3.5, 30)[:, None] * [1.0, 0.1, 0.0]
    from_camera = np.random.default_rng(0).normal([0.0, 14.0, -1.0], 0.1, (30, 3))  # for an animal of nominal size
    states = np.concatenate([(centres_m - origin_m) / size + from_camera, np.zeros((30, 4))], axis=1)
    by_size = np.zeros_like(states)
    by_size[:, :3] = -(centres_m - origin_m) / size**2
    by_size[:, 3:] = 0.1

    found = states_at_size(states, by_size, size, other_size)
    seen_m = origin_m + other_size * found[:, :3] - centres_m
    np.testing.assert_allclose(seen_m, other_size * from_camera, atol=1e-12)
    np.testing.assert_allclose(found[:, 3:], 0.1 * (other_size - size))
