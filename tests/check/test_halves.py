"""A hind half that is another animal's is told by its time offset."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from threadpoolctl import threadpool_limits

from recon.animal.prior import load_prior
from recon.check.halves import halves_finding, hind_markers
from recon.fit.clip_problem import ClipProblem, TrajectoryOptions
from recon.fit.motion import Motion
from recon.fit.result import TrajectorySolution


@pytest.mark.parametrize(("late", "is_named"), [(0, False), (2, True)])
def test_a_hind_half_of_a_later_animal_is_named(whole_results, late, is_named):
    motion = Motion.load(whole_results)
    solution = motion.solution
    assert isinstance(solution, TrajectorySolution)
    prior = load_prior(solution.prior, motion.body)
    clip = ClipProblem.from_views(solution.views, motion.body, prior, motion.fps, TrajectoryOptions())
    (view,), is_hind = clip.views, hind_markers(clip)
    assert {"tail_base", "l_hip", "l_back_paw"} < {*np.array(motion.body.markers)[is_hind]}
    assert not {"nose", "l_shoulder", "l_front_paw"} & {*np.array(motion.body.markers)[is_hind]}
    xy_px = view.xy_px.copy()
    xy_px[late:, is_hind] = view.xy_px[: len(xy_px) - late, is_hind]
    with threadpool_limits(1, user_api="blas"):
        item = halves_finding(replace(clip, views=(replace(view, xy_px=xy_px),)), solution)
    assert (item is not None) == is_named
    if item is not None:
        assert (item.code, item.severity) == ("halves_apart", "warning")
        assert item.numbers["late_frames"] == pytest.approx(2.0, abs=1.5)
