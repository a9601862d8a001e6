"""Test that a camera whose clock is slower than another camera's is found."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from recon.check.clocks import drift_findings
from recon.check.one_step import Step
from recon.check.sights import drift_by_rays
from recon.fit.clip_problem import ClipProblem, TrajectoryOptions
from tests.example_run import BODY, FPS, PRIOR, two


def _with_drift(views, drift_frames: float):
    """Return two views, the second of which has a drifting clock that is in step in the middle of the clip."""
    T = len(views[1].xy_px)
    shown = np.arange(T) + drift_frames * (np.arange(T) - 0.5 * (T - 1)) / T
    xy_px = views[1].xy_px.reshape(T, -1)
    late_px = np.stack([np.interp(shown, np.arange(T), column, np.nan, np.nan) for column in xy_px.T], axis=1)
    return views[0], replace(views[1], xy_px=late_px.reshape(T, -1, 2))


@pytest.mark.parametrize("piece", [512, 1])  # all frames in one piece, and each frame in its own piece
@pytest.mark.parametrize("drift_frames", [-4.0, 0.0, 4.0])
def test_a_drifting_clock_is_named_with_its_rate(monkeypatch, drift_frames, piece):
    monkeypatch.setattr("recon.check.clocks.frames_per_piece", lambda _: piece)
    solution = two()
    T = len(solution.states)
    views = _with_drift(solution.views, drift_frames)
    clip = ClipProblem.from_views(views, BODY, PRIOR, FPS, TrajectoryOptions(fast=True, size_sigma=0.3))
    findings = [*drift_findings(clip, solution, ("A", "B"), FPS)]
    assert [(item.code, item.camera) for item in findings] == [("clock_drifts", "B")] * bool(drift_frames)
    for item in findings:
        assert item.numbers["drift_frames"] == pytest.approx(drift_frames, abs=0.8)
        assert item.numbers["rate_hz"] == pytest.approx(FPS / (1 + drift_frames / T), rel=0.02)
        assert item.numbers["position_effect_m"] == pytest.approx(0.5 * abs(drift_frames) * 9.0 / FPS, rel=0.3)


@pytest.mark.parametrize("drift_frames", [-4.0, 0.0])
def test_a_drift_that_the_rays_refute_is_not_reported(drift_frames, monkeypatch):
    """Wrong lengths of a rough skeleton look like a drift, but are not reported, because the cameras' rays meet."""
    solution = two()
    views = _with_drift(solution.views, drift_frames)
    value, sigma = drift_by_rays(views, solution.markers_m, 1)
    assert value == pytest.approx(drift_frames, abs=max(4 * sigma, 0.3))
    monkeypatch.setattr("recon.check.clocks.drifts_of", lambda *_, **__: {1: Step(-4.0, 0.5)})
    clip = ClipProblem.from_views(views, BODY, PRIOR, FPS, TrajectoryOptions(fast=True, size_sigma=0.3))
    findings = [*drift_findings(clip, solution, ("A", "B"), FPS)]
    assert [item.code for item in findings] == ["clock_drifts"] * bool(drift_frames)
