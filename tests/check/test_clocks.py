"""A camera whose clock runs slow beside another one's."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from recon.check.clocks import drift_findings
from recon.fit.clip_problem import ClipProblem, TrajectoryOptions
from tests.example_run import BODY, FPS, PRIOR, two


@pytest.mark.parametrize("drift_frames", [-4.0, 0.0, 4.0])
def test_a_clock_that_drifts_is_named_with_its_rate(drift_frames):
    solution = two()
    T = len(solution.states)
    shown = np.arange(T) + drift_frames * (np.arange(T) - 0.5 * (T - 1)) / T
    xy_px = solution.views[1].xy_px.reshape(T, -1)
    late_px = np.stack([np.interp(shown, np.arange(T), column, np.nan, np.nan) for column in xy_px.T], axis=1)
    views = (solution.views[0], replace(solution.views[1], xy_px=late_px.reshape(T, -1, 2)))
    clip = ClipProblem.from_views(views, BODY, PRIOR, FPS, TrajectoryOptions(fast=True, size_sigma=0.3))
    findings = [*drift_findings(clip, solution, ("A", "B"), FPS)]
    assert [(item.code, item.camera) for item in findings] == [("clock_drifts", "B")] * bool(drift_frames)
    for item in findings:
        assert item.numbers["drift_frames"] == pytest.approx(drift_frames, abs=0.8)
        assert item.numbers["rate_hz"] == pytest.approx(FPS / (1 + drift_frames / T), rel=0.02)
        assert item.numbers["position_effect_m"] == pytest.approx(0.5 * abs(drift_frames) * 9.0 / FPS, rel=0.3)
