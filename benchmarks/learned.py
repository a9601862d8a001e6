"""What one camera gains from a prior that was learned from more, up to one that knows the very run.

    python benchmarks/learned.py [RUNS] [--poses FOLDER]

Every view of `cameras.py` by itself, where the detector's keypoints lie measured in the other runs, with priors made as
`running-cheetah` is: from its gallops, from slower segments too, from the reference's motion of the other runs too, of
the judged run as well, and of that run alone, which no user can have: how far a prior can help at all. Means over
mixtures that begin with other clusters, which differ by as much as these priors do. Without folders: cheetah-runs and
cheetah-poses of $RECON_SHARED_DATA, or of ../shared/data. One thread.
"""

from __future__ import annotations

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import argparse
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
from cameras import Run, as_seen, body_of, errors, run_of, show, states_of, too_far
from mismatch import APART, FAST_M_S, segments_of
from recordings import recordings

from recon.animal.prior import FRAMES_PER_COMPONENT, MotionPrior, fit_prior, mean_speed_m_s
from recon.fit import solve_trajectory

BEGINNINGS = 3
"""Of the mixture's clusters, for each prior."""
COMPONENTS = 16
Segment = tuple[str, np.ndarray, float]


def learned(segments: Sequence[Segment], seed: int) -> MotionPrior:
    components = min(COMPONENTS, sum(len(states) for _, states, _ in segments) // FRAMES_PER_COMPONENT)
    return fit_prior(body_of(), segments, components=components, apart=APART, seed=seed)


def row(label: str, runs: Sequence[Run], known: Callable[[Run], Sequence[Segment]]) -> dict:
    """known: the segments that the prior for a run is learned from."""
    rows = []
    for run in runs:
        body = as_seen(body_of(run.subject), run, runs, posed=True)
        for seed in range(BEGINNINGS):
            prior = learned(known(run), seed)
            for view in run.views.values():
                solution = solve_trajectory([view], body, prior, run.fps)
                rows.append(errors(run, solution) | {"too far": too_far(run, solution), "beginning": seed})
    table = {name: np.array([one[name] for one in rows]) for name in rows[0]}
    begun = [table["beginning"] == seed for seed in range(BEGINNINGS)]
    places = [table["mpe_mm"][of].mean() for of in begun]
    return {
        "prior from": label,
        "mpjpe_mm mean": table["mpjpe_mm"].mean(),
        "mpjpe median": np.mean([np.median(table["mpjpe_mm"][of]) for of in begun]),
        "mpe_mm median": np.mean([np.median(table["mpe_mm"][of]) for of in begun]),
        "mpe mean": np.mean(places),
        "by beginning": f"{min(places):.0f} to {max(places):.0f}",
        "too far": f"{table['too far'].mean():+.1%}",
        "rms": f"{np.sqrt(np.mean(table['too far'] ** 2)):.1%}",
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", nargs="?", type=Path, default=recordings("cheetah-runs"))
    parser.add_argument("--poses", type=Path, default=recordings("cheetah-poses"))
    arguments = parser.parse_args()
    runs = [run_of(path.parent) for path in sorted(arguments.folder.resolve().glob("*/meta.json"))]
    if not runs:
        raise SystemExit(f"no runs in {arguments.folder}")
    segments = segments_of(arguments.poses)
    gallops = [one for one in segments if mean_speed_m_s(one[1], one[2]) >= FAST_M_S]
    of_runs = {run: (run.folder.name, states_of(run, np.zeros(3)), run.fps) for run in runs}

    def others(run: Run) -> list[Segment]:
        return [of_runs[other] for other in runs if other is not run]

    rows = [
        row("gallops", runs, lambda run: gallops),
        row("all segments", runs, lambda run: segments),
        row("gallops and the other runs", runs, lambda run: gallops + others(run)),
        row("gallops and all runs", runs, lambda run: gallops + list(of_runs.values())),
        row("this run alone", runs, lambda run: [of_runs[run]]),
    ]
    show("One camera, all views, and what its prior was learned from", rows)


if __name__ == "__main__":
    main()
