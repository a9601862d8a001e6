"""Measure the errors that a wrong focal length causes, as with a guess in `recon fit --hfov-deg`.

    python benchmarks/parts/focal.py [FOLDER]

Each run is a folder as in `cheetah_runs.py`. Every camera is used alone with its focal length multiplied by a factor;
the lens distortion stays the same. The table has means over all views: MPJPE over all 24 joints after removing each
pose's middle; the logarithm of the animal's estimated over its true distance; and the speed relative to the speed with
the true focal length. Then all cameras of each run are used with the last focal length 10 % too long, fixed or with
`--set focal-sigma=0.1`. FOLDER is by default the cheetah-runs of $RECON_SHARED_DATA, or of ../shared/data. The script
runs in one thread.
"""

from __future__ import annotations

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

from dataclasses import replace

import numpy as np
from cameras import PRIOR, Run, cameras_of, errors, log_distance_ratio, runs_given
from markdown_table import print_table
from trajectory import body_of, prior_of

from recon.fit.clip_problem import TrajectoryOptions
from recon.fit.result import TrajectorySolution
from recon.fit.trajectory import solve_trajectory

WRONG = 1.1
FACTORS = (0.7, 0.85, 0.95, 1.0, 1.05, 1.15, 1.3)


def solved(run: Run, camera: int, factor: float) -> TrajectorySolution:
    view = run.views[camera]
    matrix = view.camera.matrix.copy()
    matrix[[0, 1], [0, 1]] *= factor
    wrong = replace(view, camera=replace(view.camera, matrix=matrix))
    return solve_trajectory([wrong], body_of(run.subject), prior_of(PRIOR), run.fps)


def speed_m_s(run: Run, solution: TrajectorySolution) -> float:
    path = solution.joints_m.mean(axis=1)
    return float(np.nanmedian(np.linalg.norm(np.diff(path, axis=0), axis=1)) * run.fps)


def sought(run: Run) -> list[str]:
    views = [run.views[camera] for camera in cameras_of(run)["all"]]
    wrong = [*views[:-1], views[-1].with_focal_scale(float(np.log(WRONG)))]
    body, prior = body_of(run.subject), prior_of(PRIOR)
    held = solve_trajectory(wrong, body, prior, run.fps)
    found, as_is = (
        solve_trajectory(of, body, prior, run.fps, TrajectoryOptions(focal_sigma=0.1)) for of in (wrong, views)
    )
    factors = np.exp(found.focal[-1]), np.exp(as_is.focal[-1])
    return [
        run.folder.name[:28],
        f"{WRONG * factors[0]:.3f} ± {found.focal_sigma[-1]:.3f}",
        f"{factors[1]:.3f}",
        *(f"{errors(run, solution)['mpjpe_mm']:.1f}" for solution in (held, found, as_is)),
    ]


def main() -> None:
    runs = runs_given(__doc__)
    found: dict[float, list[list[float]]] = {}
    for run in runs:
        for camera in run.views:
            speed = speed_m_s(run, solved(run, camera, 1.0))
            for factor in FACTORS:
                solution = solved(run, camera, factor)
                of_view = [errors(run, solution)["mpjpe_mm"], log_distance_ratio(run, solution)]
                found.setdefault(factor, []).append([*of_view, speed_m_s(run, solution) / speed - 1])
    rows = []
    for factor in FACTORS:
        mpjpe, far, faster = np.mean(found[factor], axis=0)
        rows.append([f"{factor - 1:+.0%}", f"{mpjpe:.1f}", f"{np.expm1(far):+.0%}", f"{faster:+.0%}"])
    columns = [
        "run",
        "estimated / true focal length",
        "the same, with the true length given",
        "MPJPE, fixed",
        "MPJPE, estimated",
        "MPJPE, estimated from the true one",
    ]
    print_table(columns, [sought(run) for run in runs])
    print_table(["focal length off by", "MPJPE mm", "too far", "faster"], rows)


if __name__ == "__main__":
    main()
