"""Test that a stretched video is detected by the animal's proportions."""

from __future__ import annotations

from dataclasses import replace

import pytest
from threadpoolctl import threadpool_limits

from recon.check.one_step import Step, one_steps
from recon.check.stretch import STRETCH, stretch_finding
from recon.fit.clip_problem import ClipProblem


def stretched(clip: ClipProblem, factor: float) -> ClipProblem:
    (view,) = clip.views
    centre_x, xy_px = view.camera.matrix[0, 2], view.xy_px.copy()
    xy_px[..., 0] = centre_x + factor * (xy_px[..., 0] - centre_x)
    return replace(clip, views=(replace(view, xy_px=xy_px),))


@pytest.mark.parametrize(("factor", "is_named"), [(0.75, True), (1.0, False), (4 / 3, True)])
def test_a_stretched_picture_is_reported_with_its_factor(sample_fit, factor, is_named):
    clip, solution = sample_fit
    with threadpool_limits(1, user_api="blas"):
        stretched_clip = stretched(clip, factor)
        stretch = one_steps(stretched_clip, solution, {"stretch": STRETCH}).get("stretch")
        item = stretch_finding(stretched_clip, solution, stretch)
    assert (item is not None) == is_named
    if item is not None:
        assert (item.code, item.severity) == ("picture_stretched", "warning")
        assert item.numbers["factor"] == pytest.approx(factor, rel=0.12)


@pytest.mark.parametrize("feet", ["none", "all"])
def test_the_stretch_is_not_tested_without_feet(sample_fit, feet):
    clip, solution = sample_fit
    if feet == "none":
        clip = replace(clip, body=replace(clip.body, feet=(), foot_labels=()))
    item = stretch_finding(clip, solution, Step(value=0.5, sigma=0.01))
    assert (item is None) == (feet == "none")
