"""Provide the fit of the bundled sample to tests of the checks of inputs."""

from __future__ import annotations

import numpy as np
import pytest

from recon.animal.prior import load_prior
from recon.check.likelihood import Baseline, baseline_of
from recon.fit.clip_problem import ClipProblem, TrajectoryOptions
from recon.fit.motion import Motion
from recon.fit.result import TrajectorySolution


@pytest.fixture(scope="session")
def sample_fit(whole_results) -> tuple[ClipProblem, TrajectorySolution]:
    """Return the problem of fitting the bundled sample, and its solution."""
    motion = Motion.load(whole_results)
    solution = motion.solution
    assert isinstance(solution, TrajectorySolution)
    prior = load_prior(solution.prior, motion.body)
    return ClipProblem.from_views(solution.views, motion.body, prior, motion.fps, TrajectoryOptions()), solution


@pytest.fixture(scope="module")
def sample_baseline(sample_fit) -> tuple[Baseline, np.ndarray]:
    """Return the bundled sample as a baseline, and the standard deviations of its detections, pixels, shape (T, J)."""
    clip, solution = sample_fit
    return baseline_of(clip, 0, solution.states, solution.size), solution.noise_px[0]
