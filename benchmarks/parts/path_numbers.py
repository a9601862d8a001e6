"""Choose the parameters of the smooth path between frames on all runs but one, and test them on the remaining run.

    python benchmarks/parts/path_numbers.py [FOLDER]

Every view of every run is solved once, frame by frame (`path=free`). Paths with other accelerations and correlation
times are estimated from the solutions, which takes little time. The score of a choice compares the peak speed of the
path with the true one: the fraction of views within `WITHIN`, minus the difference between the 90 % intervals' coverage
and 90 %. Each run is left out once. The table has the best choice on the other runs, and the results of this choice
and of the frame method's default parameters on the run that was left out.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product
from pathlib import Path
from unittest import mock

import numpy as np
from arguments import parser_of, runs_or_exit
from cheetah_runs import PUBLISHED
from frame_method import WITHIN, true_peak_m_s
from markdown_table import print_table
from recordings import fit_settings, meta_of

from recon import fit_clip, read_pose3d
from recon.fit.regions import radius
from recon.gait.stances import INTERVAL
from recon.thesis import path
from recon.thesis.chain import UnknownsChain
from recon.thesis.solution import frame_solution

ACCELERATIONS_M_S2 = (6.0, 9.0, 12.0, 16.0)
LASTS_S = (0.05, 0.1, 0.2)
ERRORS_LAST_S = (0.03, 0.06, 0.12)
SIZE_SIGMA = 0.1
"""Relative standard deviation of the animal's size, which scales every speed."""
CHOICES = tuple(product(ACCELERATIONS_M_S2, LASTS_S, ERRORS_LAST_S))
OWN = (path.ACCELERATION_M_S2, path.ACCELERATION_LASTS_S, path.ERRORS_LAST_S)


@dataclass(frozen=True)
class SolvedView:
    """Solution of one view, frame by frame, with the true peak speed."""

    run: str
    chain: UnknownsChain
    states: np.ndarray
    covariance: np.ndarray
    fps: float
    true_peak_m_s: float

    def peak(self, choice: tuple[float, float, float]) -> tuple[float, float]:
        """Return the path's peak speed and the standard deviation (m/s) for one choice of the parameters."""
        names = ("ACCELERATION_M_S2", "ACCELERATION_LASTS_S", "ERRORS_LAST_S")
        with mock.patch.multiple(path, **dict(zip(names, choice, strict=True))):
            smooth = path.path_of(self.chain, self.states, self.covariance, self.fps)
        assert smooth is not None
        speed = np.linalg.norm(smooth.velocity_m_s, axis=1)
        t = int(np.argmax(speed))
        along = smooth.velocity_m_s[t] / speed[t]
        variance = along @ smooth.covariance[t, 3:6, 3:6] @ along
        return float(speed[t]), float(np.hypot(np.sqrt(variance), SIZE_SIGMA * speed[t]))


def solve(run: Path, camera: int) -> SolvedView:
    """Solve one view like `recon frame --set path=free`, with the covariances that the path needs."""
    from recon.thesis import solver

    covariances: list[np.ndarray] = []
    solve_all = solver._solve_all

    def kept(*given):
        covariance, reports = solve_all(*given)
        covariances.append(covariance)
        return covariance, reports

    settings = fit_settings(run, [camera], method="frame", skeleton=PUBLISHED, path="free")
    with (
        mock.patch.object(solver, "_solve_all", kept),
        mock.patch.object(
            solver, "with_tolerance", lambda options, least=1e-3: solver.replace(options, tolerance=least)
        ),
    ):
        motion = fit_clip(settings)
    solution = frame_solution(motion)
    truth = read_pose3d(run / "truth.csv")
    return SolvedView(
        run.name, solution.chain, solution.chain_states, covariances[0], motion.fps, true_peak_m_s(motion, truth)
    )


def score(peaks: np.ndarray, true_m_s: np.ndarray) -> tuple[float, float, float]:
    """Compare peak speeds and standard deviations (V, 2) of V views with the truth (V,), m/s.

    Returns
    -------
    tuple
        Fraction of views near the truth, coverage of the 90 % intervals, and the score that combines both.
    """
    peak, sigma = peaks.T
    near = float(np.mean(np.abs(peak / true_m_s - 1) <= WITHIN))
    covered = float(np.mean(np.abs(peak - true_m_s) <= radius(INTERVAL) * sigma))
    return near, covered, near - abs(covered - INTERVAL)


def main() -> None:
    parser = parser_of(__doc__, kind="cheetah-runs")
    views = []
    for run in runs_or_exit(parser, parser.parse_args().folder):
        views += [solve(run, camera) for camera in meta_of(run)["cameras"]]
    true_m_s = np.array([view.true_peak_m_s for view in views])
    names = np.array([view.run for view in views])
    peaks = {choice: np.array([view.peak(choice) for view in views]) for choice in {*CHOICES, OWN}}

    def cells(choice: tuple[float, float, float], rows: np.ndarray) -> list[str]:
        near, covered, _ = score(peaks[choice][rows], true_m_s[rows])
        return [f"{near:.0%}", f"{covered:.0%}"]

    def choice_text(choice: tuple[float, float, float]) -> str:
        return ", ".join(f"{number:g}" for number in choice)

    every = np.ones(len(views), bool)
    lines = []
    left_out = np.empty((len(views), 2))
    for run in dict.fromkeys(names):
        out = names == run
        best = max(CHOICES, key=lambda choice: score(peaks[choice][~out], true_m_s[~out])[2])
        left_out[out] = peaks[best][out]
        lines.append([run[:26], str(out.sum()), choice_text(best), *cells(best, out), *cells(OWN, out)])
    near, covered, _ = score(left_out, true_m_s)
    lines.append(["all, each left out", str(len(views)), "", f"{near:.0%}", f"{covered:.0%}", *cells(OWN, every)])
    best = max(CHOICES, key=lambda choice: score(peaks[choice], true_m_s)[2])
    lines.append(["none", str(len(views)), choice_text(best), *cells(best, every), *cells(OWN, every)])
    heads = "run left out, views, chosen on the others (m/s2; s; s), near, inside 90 %"
    print_table([*heads.split(", "), f"own ({choice_text(OWN)}): near", "inside 90 %"], lines)


if __name__ == "__main__":
    main()
