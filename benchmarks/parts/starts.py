"""Test whether starts and noise factors that the search leaves out would have led to better minima.

    python benchmarks/parts/starts.py [FOLDER]

Windows are all frames of each run, as in `cameras.py`, seen by each single camera, each pair of cameras, and all
cameras of a run. Each window is approached (`recon.fit.starts.approach`) as in a fit; with a third heading
(`_BEST_HEADINGS`); with several cameras, also with all starts, of any misfit (`_MAX_EXTRA_MISFIT` infinite), and with
all noise factors, as for one camera. The columns are the windows in which the change has an effect; how many of these
windows have another best minimum, or another second minimum that would be reported, with a lower cost after the change;
and the largest decrease of the best minimum's cost. Two motions closer than `_SAME_M` are the same minimum. Costs are
half squared standard deviations.
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


def windows_of(run: Run) -> list[ClipProblem]:
    """Return the fitting problems of single cameras, pairs and all cameras."""
    cameras = [*run.views]
    sets = [*((camera,) for camera in cameras), *combinations(cameras, 2), tuple(cameras)]
    body, prior = body_of(run.subject), prior_of(PRIOR)
    return [
        ClipProblem.from_views([run.views[c] for c in some], body, prior, run.fps, TrajectoryOptions()) for some in sets
    ]


def approached(clip: ClipProblem, constant: str, value: object) -> list[Estimate]:
    """Search the minima of a window with another value of a constant of the search."""
    with patch.object(starts, constant, value):
        return starts.approach(clip)


def two_minima(estimates: list[Estimate], frames: int) -> list[Estimate | None]:
    """Return the best and the second minimum; None if no second one would be reported."""
    best, *others = [estimate for estimate in estimates if len(estimate.states) == frames]
    # Other starts that lead to the best minimum have the same cost.
    second = [other for other in others if best.cost < other.cost <= best.cost + starts.ALTERNATIVE_COST]
    return [best, *second, None][:2]


def decrease(clip: ClipProblem, given: Estimate | None, other: Estimate | None) -> float:
    """Return by how much the cost of another minimum is lower; 0 if there is none, or both are the same minimum."""
    if other is None:
        return 0.0
    if given is None:
        return np.inf
    is_same = starts._distance_m(clip, given, other) < starts._SAME_M
    return 0.0 if is_same else given.cost - other.cost


def main() -> None:
    parser = parser_of(__doc__, kind="cheetah-runs")
    windows = [
        clip for folder in runs_or_exit(parser, parser.parse_args().folder) for clip in windows_of(run_of(folder))
    ]
    rows = []
    for label, constant, value, has_several in (
        ("one camera, a third heading", "_BEST_HEADINGS", 3, False),
        ("several cameras, a third heading", "_BEST_HEADINGS", 3, True),
        ("several cameras, starts with a larger misfit", "_MAX_EXTRA_MISFIT", np.inf, True),
        ("several cameras, noise factors", "_FACTORS_OF_SEVERAL", starts._NOISE_FACTORS, True),
    ):
        clips = [clip for clip in windows if (len(clip.views) > 1) == has_several]
        lower, count = [], 0
        for clip in clips:
            given, other = starts.approach(clip), approached(clip, constant, value)
            work = [sum(estimate.iterations for estimate in estimates) for estimates in (given, other)]
            count += len(given) != len(other) or work[0] != work[1]
            pairs = zip(two_minima(given, len(clip)), two_minima(other, len(clip)), strict=True)
            lower.append([decrease(clip, *pair) for pair in pairs])
        lower_by = np.array(lower)
        rows.append([label, len(clips), count, *(lower_by > 0).sum(axis=0), f"{lower_by[:, 0].max():.1f}"])
    print_table(
        ["left out", "windows", "with an effect", "lower best cost", "lower second cost", "largest decrease"], rows
    )


if __name__ == "__main__":
    main()
