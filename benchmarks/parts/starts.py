"""Test whether starts that the search leaves out or gives up would have led to better minima.

    python benchmarks/parts/starts.py [FOLDER]

Windows are all frames of each run, as in `cameras.py`, seen by each single camera, each pair of cameras, and all
cameras of a run. Each window is approached (`recon.fit.starts.approach`) as in a fit, with all starts
(`_MAX_EXTRA_MISFIT` infinite; for one camera none is left out), and without giving any start up (`_GIVE_UP_FACTOR`
infinite). The columns are the windows in which the constant has an effect; how many of these windows have a best
minimum, or a second minimum that would be reported, whose cost is lower by at least `LOWER` without the constant; and
the largest decrease of the best minimum's cost. Costs are half squared standard deviations.
"""

from __future__ import annotations

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

from itertools import combinations
from unittest.mock import patch

import numpy as np
from arguments import parser_of, runs_or_exit
from cameras import PRIOR, Run, run_of
from markdown_table import print_table
from trajectory import body_of, prior_of

from recon.fit import starts
from recon.fit.clip_problem import ClipProblem, TrajectoryOptions
from recon.fit.least_squares import Estimate

LOWER = 1.0
"""Smallest decrease of the cost that counts, because two searches that end in the same minimum differ by less."""


def windows_of(run: Run) -> list[tuple[bool, ClipProblem]]:
    """Return the fitting problems of single cameras, pairs and all cameras, and whether each has several cameras."""
    cameras = [*run.views]
    sets = [*((camera,) for camera in cameras), *combinations(cameras, 2), tuple(cameras)]
    body, prior = body_of(run.subject), prior_of(PRIOR)
    return [
        (
            len(some) > 1,
            ClipProblem.from_views([run.views[c] for c in some], body, prior, run.fps, TrajectoryOptions()),
        )
        for some in sets
    ]


def approached(clip: ClipProblem, constant: str) -> list[Estimate]:
    """Search the minima of a window with a constant of the search made infinite, so that it has no effect."""
    with patch.object(starts, constant, np.inf):
        return starts.approach(clip)


def two_costs(estimates: list[Estimate], frames: int) -> np.ndarray:
    """Return the costs (2,) of the best and the second minimum; infinite if no second one would be reported."""
    costs = [estimate.cost for estimate in estimates if len(estimate.states) == frames]
    # Other starts that lead to the best minimum have the same cost.
    second = [cost for cost in costs[1:] if costs[0] < cost <= costs[0] + starts.ALTERNATIVE_COST]
    return np.array([costs[0], *second, np.inf][:2])


def decreases(given: np.ndarray, other: np.ndarray) -> np.ndarray:
    """Return by how much the other search lowers the costs of the best and the second minimum, shape (2,).

    The value is 0 for a minimum that the other search lacks.
    """
    return np.where(np.isinf(other), 0.0, given - np.where(np.isinf(other), 0.0, other))


def main() -> None:
    parser = parser_of(__doc__, kind="cheetah-runs")
    windows = [
        window for folder in runs_or_exit(parser, parser.parse_args().folder) for window in windows_of(run_of(folder))
    ]
    rows = []
    for label, constant, has_several in (
        ("several cameras, starts left out", "_MAX_EXTRA_MISFIT", True),
        ("one camera, starts given up", "_GIVE_UP_FACTOR", False),
        ("several cameras, starts given up", "_GIVE_UP_FACTOR", True),
    ):
        clips = [clip for several, clip in windows if several == has_several]
        lower, count = [], 0
        for clip in clips:
            given, other = starts.approach(clip), approached(clip, constant)
            work = [sum(estimate.iterations for estimate in estimates) for estimates in (given, other)]
            count += len(given) != len(other) or work[0] != work[1]
            lower.append(decreases(two_costs(given, len(clip)), two_costs(other, len(clip))))
        lower_by = np.array(lower)
        rows.append([label, len(clips), count, *(lower_by > LOWER).sum(axis=0), f"{lower_by[:, 0].max():.1f}"])
    print_table(
        ["starts", "windows", "with an effect", "lower best cost", "lower second cost", "largest decrease"], rows
    )


if __name__ == "__main__":
    main()
