"""Test the strides that inverse kinematics follows."""

from __future__ import annotations

import numpy as np
import pytest

from recon.ik.chain import planar_chain
from recon.ik.drive import follow
from recon.ik.methods import LeastNorm
from recon.ik.stride import farthest_reach, find_stride

CHAIN = planar_chain((0.5, 0.4, 0.3))


def swings(frames, period=20.0, drift=0.0):
    """Return joint angles (T, 3), rad, that are periodic except for a drift."""
    phase = 2 * np.pi * np.arange(frames)[:, None] / period
    mean, size, shift = np.array([0.9, 0.8, -0.6]), np.array([0.3, 0.4, 0.5]), np.array([0.0, 1.0, 2.0])
    return mean + size * np.sin(phase + shift) + drift * np.arange(frames)[:, None]


def test_the_stride_of_a_periodic_motion_is_one_period():
    found = find_stride(CHAIN, swings(55), fps=100)
    assert found.origin == "return"
    assert found.end_s - found.start_s == pytest.approx(0.2)
    assert found.gap_m < 1e-4
    np.testing.assert_array_equal(found.path_m[0], found.path_m[-1])
    np.testing.assert_allclose(found.path_m[::10], [CHAIN.end(q) for q in found.q], atol=1e-4)
    assert (len(found.q), len(found.path_m)) == (21, 201)
    assert found.interval_s == pytest.approx(0.001)
    run = follow(CHAIN, found.q[0], found.path_m, LeastNorm(), interval_s=found.interval_s)
    assert run.note == ""
    assert run.distance_m.max() < 1e-3


def test_the_gap_is_spread_over_the_path():
    q = swings(25, drift=0.004)
    # The stride begins at the nearest frame, 2.
    found = find_stride(CHAIN, q, fps=100, span_s=(0.018, 0.218))
    assert (found.origin, found.start_s, found.end_s) == ("given", 0.02, 0.22)
    np.testing.assert_array_equal(found.q, q[2:23])
    ends = np.array([CHAIN.end(x) for x in found.q])
    gap = ends[-1] - ends[0]
    assert found.gap_m == pytest.approx(np.linalg.norm(gap))
    diameter = max(np.linalg.norm(ends - x, axis=1).max() for x in ends)
    assert found.gap_percent == pytest.approx(100 * found.gap_m / diameter, rel=1e-2)
    np.testing.assert_array_equal(found.path_m[-1], found.path_m[0])
    np.testing.assert_allclose(found.path_m[::10], ends - np.linspace(0, 1, 21)[:, None] * gap, atol=1e-12)


@pytest.mark.parametrize("period", [9.3, 9.5, 20.4])
def test_a_stride_ends_between_frames(period):
    # Both a given stride and a return can end between two frames.
    q = swings(40, period)
    given = find_stride(CHAIN, q, 30, (3.4 / 30, (3.4 + period) / 30))
    assert (given.start_s, given.end_s) == pytest.approx((3 / 30, (3 + period) / 30))
    found = find_stride(CHAIN, q, 30)
    assert found.end_s - found.start_s == pytest.approx(period / 30, rel=0.005)
    for stride in (given, found):
        assert stride.gap_percent < 2
        assert stride.interval_s * (len(stride.path_m) - 1) == pytest.approx(stride.end_s - stride.start_s)
    # At the end of the clip, the stride begins earlier instead of being shorter.
    late = find_stride(CHAIN, q, 30, ((39.4 - period) / 30, 39.4 / 30))
    assert late.end_s - late.start_s == pytest.approx(period / 30)
    assert late.end_s <= 39 / 30 + 1e-9


def test_a_return_respects_the_duration_range():
    # The foot comes close to its position halfway through the stride, and returns to it exactly after the stride.
    phase = 2 * np.pi * np.arange(50)[:, None] / 30
    q = [0.9, 0.8, -0.6] + [0.4, 0.4, 0.5] * np.sin(2 * phase + [0, 1, 2]) + 0.05 * np.sin(phase)
    half, whole = (
        find_stride(CHAIN, q[:40], 100, duration_range_s=duration) for duration in ((0.0, 0.2), (0.25, np.inf))
    )
    assert half.end_s - half.start_s == pytest.approx(0.15, abs=0.02)
    assert whole.end_s - whole.start_s == pytest.approx(0.3, abs=0.01)
    assert whole.gap_percent < 1


def test_a_clip_without_a_return_is_used_whole():
    found = find_stride(CHAIN, swings(9), fps=100)
    assert found.origin == "whole clip"
    assert (found.start_s, found.end_s) == (0.0, 0.08)
    assert found.gap_percent > 50


def test_short_gaps_are_bridged_and_long_gaps_split():
    q = swings(60)
    q[[4, 33]] = np.nan
    q[5:15] = np.nan
    found = find_stride(CHAIN, q, fps=100)
    # The longer of the two stretches is used, and its short gap is bridged.
    assert found.start_s >= 0.15
    assert found.end_s - found.start_s == pytest.approx(0.2)
    assert np.isfinite(found.path_m).all()
    with pytest.raises(ValueError, match="consecutive frames with a pose"):
        find_stride(CHAIN, np.full((20, 3), np.nan), fps=100)
    with pytest.raises(ValueError, match=r"a stride within 0.150 to 0.590 s, got 0.050"):
        find_stride(CHAIN, q, fps=100, span_s=(0.05, 0.3))


def test_farthest_reach_finds_rearmost_and_foremost_position():
    q = swings(30)
    q[3] = np.nan
    start, target = farthest_reach(CHAIN, q)
    ends = np.array([CHAIN.end(x) for x in q])
    assert CHAIN.end(start)[0] == pytest.approx(np.nanmin(ends[:, 0]), abs=1e-15)
    assert target[0] == pytest.approx(np.nanmax(ends[:, 0]), abs=1e-15)
    np.testing.assert_allclose(target, ends[np.nanargmax(ends[:, 0])], rtol=0, atol=1e-15)
    with pytest.raises(ValueError, match="missing value"):
        farthest_reach(CHAIN, np.full((2, 3), np.nan))
