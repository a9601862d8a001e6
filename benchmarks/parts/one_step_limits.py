"""Compare correct and wrong clips with the limits of the checks for stretched pictures, halves, lenses and clocks.

    python benchmarks/parts/one_step_limits.py [FOLDER] [--views 8]

Every n-th view of the cheetah-runs of $RECON_SHARED_DATA, or of ../shared/data, is fitted unchanged, with x scaled,
with the hind half of a second animal, and with another focal length. Every n-th pair is fitted unchanged, and with a
second camera that takes one picture per second fewer than its file says. The deviations of stretch and halves come from
`recon.check.one_step.one_steps`, and the others from `recon.check.focal.FocalTest.deviation` and the largest of
`recon.check.clocks.drifts_of`; halves and drift are in standard deviations.
"""

from __future__ import annotations

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import tempfile
from collections.abc import Sequence
from contextlib import suppress
from itertools import combinations
from pathlib import Path
from unittest.mock import patch

import numpy as np
from arguments import parser_of, runs_of
from markdown_table import print_table
from wrong_inputs import CASES, Case, Clip, Given, cameras_of, fitted, focal, hind_of_second, scaled

from recon import InputError
from recon.base.arrays import Array
from recon.check import focal as focal_check
from recon.check import halves, inputs
from recon.check.clocks import DRIFT_SIGMAS, drifts_of
from recon.check.likelihood import Baseline
from recon.check.one_step import Step
from recon.check.stretch import LIMITS, deviation
from recon.fit.clip_problem import ClipProblem
from recon.fit.result import TrajectorySolution


def slow_clock(clip: Clip, given: Given) -> Given:
    """Return the detections of a camera that takes one picture per second fewer than its file says."""
    fps, T = clip.meta["fps"], len(given.xy_px)
    at = np.arange(T) * fps / (fps - 1)
    before = at[at <= T - 2].astype(int)
    fraction = (at[: len(before)] - before)[:, None, None]
    xy_px = (1 - fraction) * given.xy_px[before] + fraction * given.xy_px[before + 1]
    return given.seen(xy_px, given.keypoints.frames[: len(before)])


UNTOUCHED = CASES["untouched"]
ROWS = (
    ("stretch", "untouched", UNTOUCHED),
    ("stretch", "x scaled by 0.75", Case(scaled(0.75, 1.0))),
    ("stretch", "x scaled by 1.33", Case(scaled(4 / 3, 1.0))),
    ("halves", "untouched", UNTOUCHED),
    ("halves", "hind half of a second animal", Case(hind_of_second)),
    ("focal length", "untouched", UNTOUCHED),
    ("focal length", "focal length x 1.5", Case(focal(1.5))),
    ("focal length", "focal length x 0.7", Case(focal(0.7))),
    ("focal length", "letterboxed", Case(scaled(0.75, 0.75))),
    ("drift", "two cameras", CASES["two cameras"]),
    ("drift", "two, one slow by a frame per second", Case(slow_clock, two=True)),
)
LIMIT_TEXTS = {
    "stretch": f"{LIMITS[0]} to {LIMITS[1]}",
    "halves": f"{halves.LIMITS[0]} to {halves.LIMITS[1]}",
    "focal length": f"-{focal_check.POSSIBLE_SIGMAS} to {focal_check.POSSIBLE_SIGMAS}",
    "drift": f"0 to {DRIFT_SIGMAS}",
}


def deviation_of(clip: Clip, case: Case, check: str) -> list[float]:
    """Fit a clip, and return the deviation that a check measures, or an empty list if the check does not run."""
    seen: list[float] = []

    def stretch(_problem: ClipProblem, _solution: TrajectorySolution, step: Step | None) -> None:
        seen.extend([] if step is None else [deviation(step)])

    def late_half(_problem: ClipProblem, _solution: TrajectorySolution, step: Step | None) -> None:
        seen.extend([step.value / step.sigma] if check == "halves" and step is not None else [])

    def focal_length(baseline: Baseline, noise_px: Array) -> None:
        test = focal_check.focal_test(baseline, noise_px) if check == "focal length" else None
        seen.extend([] if test is None else [test.deviation])

    def drift(problem: ClipProblem, solution: TrajectorySolution, *_: object) -> tuple[()]:
        steps = drifts_of(problem, solution).values()
        seen.extend([max(abs(step.value / step.sigma) for step in steps)] if steps else [])
        return ()

    with (
        tempfile.TemporaryDirectory() as folder,
        patch.object(inputs, "stretch_finding", stretch if check == "stretch" else lambda *_: None),
        patch.object(inputs, "halves_finding", late_half),
        patch.object(inputs, "focal_finding", focal_length),
        patch.object(inputs, "drift_findings", drift),
        suppress(InputError),  # a clip whose scaled picture is refused has no check
    ):
        fitted(clip, case, Path(folder))
    return seen[-1:]


def beyond_usual(deviations: Sequence[tuple[str, float]], untouched: Sequence[tuple[str, float]]) -> int:
    """Count the deviations that lie outside the middle 75 % of the deviations of unchanged clips of other runs."""
    beyond = 0
    for run, value in deviations:
        usual = [usual_value for usual_run, usual_value in untouched if usual_run != run]
        if usual:
            low, high = np.quantile(usual, [0.125, 0.875])
            beyond += not low <= value <= high
    return beyond


def main() -> None:
    parser = parser_of(__doc__, kind="cheetah-runs")
    parser.add_argument("--views", type=int, default=8, help="every n-th view and pair only (default: %(default)s)")
    arguments = parser.parse_args()
    runs = runs_of(arguments.folder)
    views = [Clip(run, (name,)) for run in runs for name in cameras_of(run)][:: arguments.views]
    pairs = [Clip(run, pair) for run in runs for pair in combinations(cameras_of(run), 2)][:: arguments.views]
    if not views:
        parser.exit(message=f"no runs in {arguments.folder}: nothing measured\n")
    rows, untouched = [], {}
    for check, name, case in ROWS:
        clips = pairs if case.two else views
        deviations = [(clip.run.name, value) for clip in clips for value in deviation_of(clip, case, check)]
        untouched.setdefault(check, deviations)
        sigmas = [value for _, value in deviations]
        ends = [f"{value:.1f}" for value in np.quantile(sigmas, [0.0, 0.5, 1.0])] if sigmas else ["", "", ""]
        rows.append([check, name, len(sigmas), *ends, LIMIT_TEXTS[check], beyond_usual(deviations, untouched[check])])
        print(" ".join(map(str, rows[-1])), flush=True)
    header = ["check", "case", "clips", "smallest deviation", "median", "largest", "not named"]
    print_table([*header, "beyond the middle three quarters of other runs"], rows)


if __name__ == "__main__":
    main()
