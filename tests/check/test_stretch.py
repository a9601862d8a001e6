"""A picture whose pixels are not square is told by the animal's proportions."""

from __future__ import annotations

from dataclasses import replace

import pytest
from threadpoolctl import threadpool_limits

from recon.animal.prior import load_prior
from recon.check.stretch import stretch_finding
from recon.fit.clip_problem import ClipProblem, TrajectoryOptions
from recon.fit.motion import Motion
from recon.fit.result import TrajectorySolution


@pytest.fixture(scope="module")
def solved(whole_results):
    """The problem of the sample, and its solution."""
    motion = Motion.load(whole_results)
    solution = motion.solution
    assert isinstance(solution, TrajectorySolution)
    prior = load_prior(solution.prior, motion.body)
    return ClipProblem.from_views(solution.views, motion.body, prior, motion.fps, TrajectoryOptions()), solution


def stretched(clip: ClipProblem, factor: float) -> ClipProblem:
    (view,) = clip.views
    centre_x, xy_px = view.camera.matrix[0, 2], view.xy_px.copy()
    xy_px[..., 0] = centre_x + factor * (xy_px[..., 0] - centre_x)
    return replace(clip, views=(replace(view, xy_px=xy_px),))


@pytest.mark.parametrize(("factor", "is_named"), [(0.75, True), (1.0, False), (4 / 3, True)])
def test_a_stretched_picture_is_named_with_its_factor(solved, factor, is_named):
    clip, solution = solved
    with threadpool_limits(1, user_api="blas"):
        item = stretch_finding(stretched(clip, factor), solution)
    assert (item is not None) == is_named
    if item is not None:
        assert (item.code, item.severity) == ("picture_stretched", "warning")
        assert item.numbers["factor"] == pytest.approx(factor, rel=0.12)
