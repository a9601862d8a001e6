"""Test that a wrong focal length is detected by the animal's perspective, its motion in depth and the ground."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from threadpoolctl import threadpool_limits

from recon.check.focal import focal_finding, focal_test
from recon.check.likelihood import Baseline, lens_findings
from recon.fit.result import Finding


def number(item: Finding, name: str) -> float:
    value = item.numbers[name]
    assert isinstance(value, float)
    return value


def with_focal_scale(baseline: Baseline, log_factor: float, focal_sigma: float | None = None) -> Baseline:
    """Return a baseline with another stated focal length, and the animal moved so that the pictures are equal."""
    (view,) = baseline.clip.views
    axis, states = view.T_camera_world[2, :3], baseline.states.copy()
    states[:, :3] += np.expm1(log_factor) * (states[:, :3] @ axis)[:, None] * axis
    clip = replace(baseline.clip, views=(view.with_focal_scale(log_factor),))
    return Baseline(replace(clip, options=replace(clip.options, focal_sigma=focal_sigma)), states)


@pytest.mark.parametrize(("log_factor", "severity"), [(0.4, "warning"), (-0.4, "note"), (-0.2, None)])
def test_a_wrong_focal_length_is_reported_with_its_factor(sample_baseline, log_factor, severity):
    baseline, noise_px = sample_baseline
    with threadpool_limits(1, user_api="blas"):
        item = focal_finding(with_focal_scale(baseline, log_factor), noise_px)
    assert (None if item is None else item.severity) == severity
    if item is not None:
        assert item.code == "focal_length"
        factor, pose_m, position_m = (number(item, name) for name in ("factor", "pose_effect_m", "position_effect_m"))
        assert (factor > 1) == (log_factor < 0)
        assert pose_m < 0.05 < 1 < position_m


def test_a_focal_length_within_the_stated_uncertainty_is_not_reported(sample_baseline):
    baseline, noise_px = sample_baseline
    with threadpool_limits(1, user_api="blas"):
        assert focal_finding(with_focal_scale(baseline, -0.4, focal_sigma=0.3), noise_px) is None


def test_the_lens_of_an_animal_without_feet_is_tested_but_not_the_focal_length(sample_baseline):
    baseline, noise_px = sample_baseline
    body = replace(baseline.clip.body, feet=(), foot_labels=())
    without_feet = Baseline(replace(baseline.clip, body=body), baseline.states)
    with threadpool_limits(1, user_api="blas"):
        assert list(lens_findings(without_feet, noise_px)) == []
        assert focal_test(without_feet, noise_px) is None
