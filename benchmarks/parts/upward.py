"""Estimate the upward direction from standing feet, and compare it with the calibration of several cameras.

    python benchmarks/parts/upward.py

The cheetah-runs and the plate-trials of $RECON_SHARED_DATA, or of ../shared/data, are used with all cameras of a run,
and the cheetah-runs also with every pair. "error" is the angle between the two directions, degrees. "stated" is its
standard deviation about the less certain axis, which has nearly all of the error. If the stated values are right, the
median of error / stated is 0.67, and nine in ten ratios are below 1.64. If the stated value is above 10 degrees, the
clip is "refused", and recon does not turn the world. The script runs in one thread.
"""

from __future__ import annotations

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

from collections.abc import Iterator, Sequence
from itertools import combinations
from unittest.mock import patch

import numpy as np
from arguments import runs_of
from cameras import run_of
from markdown_table import print_table
from recordings import recordings

from recon import load_skeleton
from recon.check import upward
from recon.check.upward import up_from_feet
from recon.clip import View
from recon.fit.clip_problem import TrajectoryOptions

BODY, SIGMA_PX = load_skeleton("cheetah-24"), TrajectoryOptions().sigma_px


def clips() -> Iterator[tuple[str, Sequence[View], float]]:
    """Yield the name, the views and the frame rate of each clip."""
    for folder in runs_of(recordings("cheetah-runs")):
        run = run_of(folder)
        yield "cheetah-runs, all cameras", [*run.views.values()], run.fps
        for two in combinations(run.views.values(), 2):
            yield "cheetah-runs, two cameras", two, run.fps
    for folder in runs_of(recordings("plate-trials")):
        run = run_of(folder)
        yield "plate-trials, two cameras", [*run.views.values()], run.fps


def main() -> None:
    found: dict[str, list[tuple[float, float]]] = {}
    limit_deg = np.degrees(upward.MAX_SIGMA_RAD)
    with patch.object(upward, "MAX_SIGMA_RAD", np.inf):
        for what, views, fps in clips():
            up = up_from_feet(views, BODY, fps, SIGMA_PX)
            off_rad = np.nan if up is None else np.arccos(np.clip(up.up[2], -1.0, 1.0))
            found.setdefault(what, []).append((np.degrees(off_rad), np.nan if up is None else np.degrees(up.sigma_rad)))
    rows = []
    for what, each in found.items():
        off, sigma = np.array(each)[np.isfinite(each).all(axis=1)].T
        for label, which in ((what, sigma < limit_deg), (f"{what}, refused", sigma >= limit_deg)):
            if which.any():
                within = np.quantile(off[which] / sigma[which], [0.5, 0.9])
                deg = (f"{x:.1f}" for x in (np.median(off[which]), off[which].max(), np.median(sigma[which])))
                rows.append((label, f"{which.sum()} of {len(each)}", *deg, *(f"{x:.2f}" for x in within)))
    header = (
        "clips",
        "number",
        "off, median",
        "off, worst",
        "stated, median",
        "error / stated, median",
        "90th percentile",
    )
    print_table(header, rows)


if __name__ == "__main__":
    main()
