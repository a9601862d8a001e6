"""Test cameras with time offsets or different frame rates."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from command_line import refusal
from example_run import BODY, CAMERA, FPS, KEYPOINT_M, PRIOR, keypoints_of, late, run_views, settings

from recon import fit_clip
from recon.api.clip_inputs import prepare
from recon.api.rigs import at_rate
from recon.check.time_offsets import search_offsets, solve_time_offsets
from recon.clip import Source, clean
from recon.fit.clip_problem import TrajectoryOptions
from recon.fit.result import TrajectorySolution
from recon.fit.trajectory import solve_trajectory


def test_the_search_finds_whole_frames():
    """The search finds that one of three cameras begins 4 frames later, and one 3 frames earlier."""
    views = run_views(3)
    found = search_offsets([views[0], late(views[1], 4), late(views[2], -3)], FPS, 2.0, KEYPOINT_M)
    np.testing.assert_array_equal(found, [0, 4, -3])


def test_camera_without_common_frames_is_not_compared():
    first, second, third = run_views(3)
    blind = replace(second, xy_px=np.full_like(second.xy_px, np.nan))
    np.testing.assert_array_equal(search_offsets([first, blind, third], FPS, 2.0, KEYPOINT_M), [0, np.nan, 0])


def test_lags_are_found_with_their_uncertainty():
    """The second camera's lag relative to the first is within 3 standard deviations of its true value."""
    views = [replace(view, offset_frames=lead) for view, lead in zip(run_views(2), (0.0, 0.75), strict=True)]
    found = solve_trajectory(views, BODY, PRIOR, FPS, TrajectoryOptions(fast=True, find_offsets=True))
    assert (found.time_offset_frames[0], found.time_offset_sigma_frames[0]) == (0, 0)
    assert found.time_offset_frames[1] == pytest.approx(-0.75, abs=0.1)
    assert abs(found.time_offset_frames[1] + 0.75) < 3 * found.time_offset_sigma_frames[1] < 1


def sources() -> list[Source]:
    given = [keypoints_of(view.xy_px) for view in run_views(2)]
    poses = [view.T_camera_world for view in run_views(2)]
    lenses = [replace(CAMERA, rotation=T[:3, :3], translation_m=T[:3, 3], name=f"cam{i}") for i, T in enumerate(poses)]
    return [Source(lens, *clean(own, 0.5), BODY.markers) for lens, own in zip(lenses, given, strict=True)]


def test_sources_are_shifted_until_the_lags_are_small():
    asked = []

    def solve(of: tuple[Source, ...]) -> TrajectorySolution:
        asked.append([one.offset_s * FPS for one in of])
        lag = np.array([0.0, 2.4 - asked[-1][1]])
        return SimpleNamespace(time_offset_frames=0.98 * lag, time_offset_sigma_frames=np.array([0.0, 0.1]))  # type: ignore[return-value]

    found, solution = solve_time_offsets(sources(), [0.0, 0.0], solve, 2.0, KEYPOINT_M)
    assert found[1].offset_s * FPS + solution.time_offset_frames[1] == pytest.approx(2.4, abs=0.01)
    assert found[1].offset_frames == pytest.approx(0.35, abs=0.02)
    assert len(asked) == 2


def test_motion_that_does_not_determine_lags_is_refused():
    def solve(of: tuple[Source, ...]) -> TrajectorySolution:
        return SimpleNamespace(time_offset_frames=np.array([0.0, 0.04]), time_offset_sigma_frames=np.array([0.0, 1.9]))  # type: ignore[return-value]

    with refusal(("--set find-offsets", "camera cam1", "0.0 ± 1.9 frames", [1, "--set offset-s"])):
        solve_time_offsets(sources(), [0.0, 0.0], solve, 2.0, KEYPOINT_M)


def test_offset_of_unsynchronised_cameras_is_found(runs):
    """The lag corrects a wrong `--set offset-s` of five frames for cameras that began together."""
    motion = fit_clip(settings(runs, 1, 2, find_offsets=True, offset_s=[0.0, 5 / FPS]))
    lag = motion.solution.views[1].offset_frames - motion.sources[1].offset_frames
    assert motion.sources[1].offset_s * FPS + lag == pytest.approx(0, abs=0.1)
    assert abs(lag) < 0.05


def test_points_are_resampled_to_another_frame_rate():
    """At half the rate, every second frame is between two points, each of which counts half.

    At twice the rate, every second point is used.
    """
    slow = keypoints_of(np.arange(4.0)[:, None, None] * np.full((4, len(BODY.markers), 2), 10.0), first=3)
    slow.xy_px[2] = np.nan
    clip = at_rate(replace(slow, fps=FPS / 2), FPS)
    np.testing.assert_array_equal(clip.frames, np.arange(6, 13))
    np.testing.assert_allclose(clip.xy_px[:, 0, 0], [0, 5, 10, np.nan, np.nan, np.nan, 30])
    np.testing.assert_allclose(clip.confidence[:, 0], [0.5, 0.5, 0.5, 0, 0, 0, 0.5])
    fast = at_rate(replace(slow, fps=2 * FPS), FPS)
    np.testing.assert_array_equal(fast.frames, [2, 3])
    np.testing.assert_allclose(fast.xy_px[:, 0, 0], [10, 30])
    assert (fast.confidence == 1).all()
    with refusal(("keypoints", "frames", 4, ["two or more", "90 Hz"])):
        at_rate(replace(slow, fps=FPS * 20), FPS)


def test_cameras_with_different_frame_rates_are_combined(runs):
    """The 30 frames of the second file last twice as long."""
    first, second = prepare(settings(runs, 1, 2, fps=None, camera_fps=[FPS, FPS / 2], frames="0:60")).sources
    np.testing.assert_array_equal(first.keypoints.frames, np.arange(59))
    assert np.flatnonzero(second.keypoints.present.any(axis=1)).tolist() == list(range(20, 59))
    assert second.cleaning.notes[-1].startswith("cam2 filmed at 45 Hz: ")
    with refusal(("settings", "camera_fps", "fps 90 as well", "only one of the two")):
        settings(runs, 1, 2, camera_fps=[FPS, FPS / 2])


def test_one_camera_has_no_offset(runs):
    with refusal(("settings", "find_offsets", "one keypoint file", "several cameras")):
        settings(runs, 1, find_offsets=True)
