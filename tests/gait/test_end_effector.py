"""Test the boundaries of strides by a chain's end effector."""

from __future__ import annotations

import numpy as np
import pytest

from recon.gait.end_effector import end_effector

TIME_S = np.arange(91) / 90
STRIDES_HZ = 3.0


def swing(wobble_m: float = 0.0):
    """Return the path of a foot that swings by ±0.5 m relative to a body that runs along y, and the body's path."""
    body = np.stack([0 * TIME_S, 10.0 * TIME_S, 0 * TIME_S + 0.7], axis=1)
    forward = -0.5 * np.cos(2 * np.pi * STRIDES_HZ * (TIME_S - 0.1)) + wobble_m * np.sin(2 * np.pi * 20 * TIME_S)
    up = -0.6 + 0.1 * np.sin(2 * np.pi * STRIDES_HZ * (TIME_S - 0.1))
    return body + np.stack([0 * TIME_S, forward, up], axis=1), body


@pytest.mark.parametrize("wobble_m", [0.0, 0.03])
def test_boundaries_are_where_the_foot_is_rearmost(wobble_m):
    effector = end_effector("RF", TIME_S, *swing(wobble_m), np.array([0.0, 1.0, 0.0]))
    np.testing.assert_allclose(effector.boundaries_s, 0.1 + np.arange(3) / STRIDES_HZ, atol=0.02)
    quarter_s = 0.25 / STRIDES_HZ
    np.testing.assert_allclose(np.abs(effector.height_extrema_s - effector.boundaries_s), quarter_s, atol=0.02)


def test_stride_begins_at_a_frame_and_lasts_from_boundary_to_boundary():
    start_s, end_s = end_effector("RF", TIME_S, *swing(), np.array([0.0, 1.0, 0.0])).stride_s(TIME_S)
    assert start_s == pytest.approx(0.1)
    assert end_s - start_s == pytest.approx(1 / STRIDES_HZ, abs=0.004)


def test_foot_that_does_not_return_has_no_stride():
    foot, body = swing()
    few = TIME_S < 0.3
    effector = end_effector("RF", TIME_S[few], foot[few], body[few], np.array([0.0, 1.0, 0.0]))
    assert effector.stride_s(TIME_S[few]) is None
    assert not len(end_effector("RF", TIME_S, np.nan * foot, body, np.array([0.0, 1.0, 0.0])).boundaries_s)
