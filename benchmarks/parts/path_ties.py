"""Choose how tightly the frame method ties poses to the path on all runs but one, and test the choice on that run.

    python benchmarks/parts/path_ties.py [FOLDER] [--ties M ...]

Every view of every run is solved frame by frame once, and then again with each tie, the standard deviation of the
reference joint about its path (`--set path-sigma-m`). The path, and with it the speed, is the same for all ties. Each
run is left out once. The choice on the other runs is the tightest tie whose median error in pixels exceeds the error of
frames without a tie by `MORE_PX` at most.
"""

from __future__ import annotations

from unittest import mock

import pandas as pd
from arguments import parser_of, runs_or_exit
from frame_method import pose_holds, view_row
from markdown_table import print_table
from recordings import meta_of

from recon.thesis import solver
from recon.thesis.solver import FrameSolver

FREE_M = 1000.0
"""Standard deviation of a tie so loose that it has no effect, metres."""
TIES_M = (0.01, 0.1, 0.5, FREE_M)
MORE_PX = 0.2
"""Largest excess of the median error over the median error of frames without a tie, pixels."""


class FirstSolutions:
    """Solver that keeps the first solution of a view, so that the fits with all ties start from it."""

    def __init__(self) -> None:
        self.solve_all, self.kept = solver._solve_all, None

    def __call__(self, frames: FrameSolver, progress, first=None):
        if first is not None:
            return self.solve_all(frames, progress, first)
        if self.kept is None:
            self.kept = (*self.solve_all(frames, progress), frames.states.copy())
        covariance, reports, states = self.kept
        frames.states[:] = states
        return covariance, reports


def summary(table: pd.DataFrame) -> list[str]:
    """Summarise the errors of all views with one tie as the cells of a table row."""
    return [
        f"{table['error_px'].median():.2f}, {table['error_px'].mean():.2f}",
        f"{table[table['named']]['mpjpe_mm'].mean():.0f}, {table['mpjpe_mm'].mean():.1f}",
        f"{table['jitter_m'].median():.3f}",
        f"{100 * pose_holds(table):.0f} %",
    ]


def words(tie_m: float) -> str:
    """Format a tie, metres, or return "none" if it has no effect."""
    return "none" if tie_m >= FREE_M else f"{tie_m:g}"


def main() -> None:
    parser = parser_of(__doc__, "--csv", kind="cheetah-runs")
    parser.add_argument("--only", nargs="+", default=[], metavar="RUN", help="prefixes of the names of runs to use")
    parser.add_argument("--rows", nargs="+", default=[], metavar="CSV", help="tables written earlier with --csv")
    parser.add_argument("--ties", nargs="+", type=float, default=TIES_M, metavar="M")
    arguments = parser.parse_args()
    if arguments.rows:
        show(pd.concat(map(pd.read_csv, arguments.rows), ignore_index=True))
        return
    rows: dict[float, list[dict[str, object]]] = {tie_m: [] for tie_m in dict.fromkeys((*arguments.ties, FREE_M))}
    for run in runs_or_exit(parser, arguments.folder):
        if arguments.only and not run.name.startswith(tuple(arguments.only)):
            continue
        for camera in meta_of(run)["cameras"]:
            with mock.patch.object(solver, "_solve_all", FirstSolutions()):
                for tie_m, views in rows.items():
                    views.append({"tie_m": tie_m, **view_row(run, camera, {"path_sigma_m": tie_m})})
    table = pd.DataFrame([row for views in rows.values() for row in views])
    if arguments.csv:
        table.to_csv(arguments.csv, index=False)
    show(table)


def show(table: pd.DataFrame) -> None:
    """Print the errors with each tie, and the tie chosen with each run left out."""
    tables = {tie_m: table[table.tie_m == tie_m].reset_index(drop=True) for tie_m in sorted(set(table.tie_m.tolist()))}
    columns = ["px (median, mean)", "MPJPE mm (named, all)", "depth jitter m", "pose inside 90 %"]
    print_table(["tie, m", *columns], [[words(tie), *summary(table)] for tie, table in tables.items()])
    print()
    free, lines = tables[FREE_M], []
    for run in dict.fromkeys(free["run"]):
        out = free["run"] == run
        most_px = free[~out]["error_px"].median() + MORE_PX
        tie = min(tie for tie, table in tables.items() if table[~out]["error_px"].median() <= most_px)
        chosen = tables[tie][out]
        lines.append([run[:26], words(tie), *summary(chosen)[:3], *summary(free[out])[:2]])
    print_table(["run left out", "chosen on the others", *columns[:3], "no tie: px", "MPJPE mm"], lines)


if __name__ == "__main__":
    main()
