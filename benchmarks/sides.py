"""Does the cost tell whether left and right are exchanged in a whole clip?

    python benchmarks/sides.py FOLDER

FOLDER has one folder for each run, as in benchmarks/trajectory.py. Every view is fitted (`fast`, default lengths) with
its labels as they are and with left and right exchanged.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
from trajectory import PRIOR, body_of, meta_of, prior_of, view_of, views

from recon.body import other_side
from recon.clip import still_view
from recon.solve import TrajectoryOptions, solve_trajectory


def costs(run: Path, camera: int) -> tuple[float, float]:
    """As it is, exchanged."""
    lens, xy_px, confidence, _ = view_of(run, camera)
    body, fps = body_of(), meta_of(run)["fps"]
    both = []
    for names in (body.markers, [other_side(marker) for marker in body.markers]):
        at = [body.markers.index(name) for name in names]
        view = still_view(lens, xy_px[:, at], confidence[:, at])
        found = solve_trajectory([view], body, prior_of(PRIOR), fps, TrajectoryOptions(fast=True))
        both.append(sum(found.cost_by_term.values()))
    return both[0], both[1]


def main() -> None:
    runs = sorted(path for path in Path(sys.argv[1]).iterdir() if (path / "meta.json").is_file())
    print("| run | camera | cost | exchanged | difference |\n| --- | --- | --- | --- | --- |")
    more = []
    for job in views(runs):
        here, there = costs(job.run, job.camera)
        more.append(there - here)
        print(f"| {job.run.name} | {job.camera} | {here:.0f} | {there:.0f} | {there - here:+.0f} |", flush=True)
    right = np.array(more) > 0
    wrong = np.abs(np.array(more)[~right]).max(initial=0.0)
    print(
        f"\nLower as it is: {right.sum()} of {len(more)}; median difference {np.median(more):.0f}; "
        f"largest where it is not: {wrong:.0f}"
    )


if __name__ == "__main__":
    main()
