"""Fit animals of 0.1 m, 1 m and 2 m seen by simulated cameras, with proportions that differ from the skeleton's.

    python benchmarks/parts/rigs.py [--animals mouse-top dog-27 human-25] [--seeds 4] [--cameras 4 1] [--refine]

Each clip draws lengths that differ from the skeleton's by 0, 10, 20 or 30 % (standard deviation; independent, left and
right equal), and a constant keypoint bias of half the skeleton's keypoint_sigma_m along each axis. In its motion, every
angle swings about its expected value, and the animal follows a curved path at two thirds of its length per second. The
cameras stand around the animal, at five times its length. Detections have 2 px of noise, and one in twenty is missing.
Fits use independent angles. The table has MPJPE, MPE, and the fraction of coordinates within the stated 90 % intervals,
for positions and poses.

--refine prints results with four cameras, whose poses are refined, and with the skeleton's lengths. The refinement
starts from the true poses, with three cameras turned by 2 degrees, with one turned by 15 degrees, and with one that has
the pose of another camera. The table has the MPE as given and refined, and whether the refined cameras are accepted, or
the code of the finding. The script runs in one thread.
"""

from __future__ import annotations

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from arguments import parser_of
from markdown_table import print_header, print_row

from recon import load_skeleton
from recon.animal.prior import prior_from_body
from recon.check.refined_poses import why_not_refined
from recon.fit.clip_problem import TrajectoryOptions
from recon.fit.result import TrajectorySolution
from recon.fit.trajectory import solve_trajectory
from recon.gait.evaluation import aligned
from recon.testing.cameras import turn_view
from recon.testing.coverage import coordinate_coverage
from recon.testing.rigs import FPS, random_clip

WRONG = (0.0, 0.1, 0.2, 0.3)


def scored(found: TrajectorySolution, true_m: np.ndarray) -> tuple[float, ...]:
    """Return the fractions of positions and poses within the 90 % intervals, and MPJPE and MPE, metres."""
    off, centred = found.joints_m - true_m, aligned(found.joints_m, true_m) - true_m
    errors = (float(np.linalg.norm(e, axis=2).mean()) for e in (centred, off))
    return (
        coordinate_coverage(off, found.covariance_m2, 0.9),
        coordinate_coverage(centred, found.relative_covariance_m2, 0.9),
        *errors,
    )


def print_refined(animals: Sequence[str], seeds: Sequence[int]) -> None:
    print_header(("animal", "cameras", "MPE as given, mm", "refined", "accepted"))
    for name in animals:
        body, options = load_skeleton(name), TrajectoryOptions(fast=True)
        for seed in seeds:
            (*views, last), true_m = random_clip(body, 0.0, 4, seed)
            random = np.random.default_rng(100 + seed)
            cases = {
                "as they are": [*views, last],
                "three turned by 2°": [views[0], *(turn_view(view, 2.0, random) for view in (*views[1:], last))],
                "one turned by 15°": [*views, turn_view(last, 15.0, random)],
                "one with another's pose": [*views, replace(last, T_camera_world=views[2].T_camera_world)],
            }
            for case, given in cases.items():
                held, found = (
                    solve_trajectory(given, body, prior_from_body(body), FPS, replace(options, refine_cameras=refine))
                    for refine in (False, True)
                )
                errors_mm = (f"{1000 * scored(of, true_m)[3]:.1f}" for of in (held, found))
                refused = why_not_refined(found, held)
                print_row((name, case, *errors_mm, refused[0].code if refused else "yes"))


def main(arguments: Sequence[str] | None = None) -> None:
    parser = parser_of(__doc__)
    parser.add_argument("--animals", nargs="+", default=["mouse-top", "dog-27", "human-25"])
    parser.add_argument("--seeds", type=int, default=4)
    parser.add_argument("--first-seed", type=int, default=0)
    parser.add_argument("--cameras", nargs="+", type=int, default=[4, 1])
    parser.add_argument("--refine", action="store_true")
    given = parser.parse_args(arguments)
    if given.refine:
        print_refined(given.animals, range(given.first_seed, given.first_seed + given.seeds))
        return
    print_header(("animal", "cameras", "deviation of lengths, %", "position 90 %", "pose 90 %", "MPJPE, mm", "MPE, mm"))
    for count in given.cameras:
        for wrong in WRONG:
            every = []
            for name in given.animals:
                body, options = load_skeleton(name), TrajectoryOptions(fast=True)
                of_seeds = []
                for seed in range(given.first_seed, given.first_seed + given.seeds):
                    views, true_m = random_clip(body, wrong, count, seed)
                    of_seeds.append(scored(solve_trajectory(views, body, prior_from_body(body), FPS, options), true_m))
                position, pose, *errors_m = np.mean(of_seeds, axis=0)
                every.append((position, pose))
                print_row(
                    (
                        name,
                        count,
                        *(f"{100 * of:.0f}" for of in (wrong, position, pose)),
                        *(f"{1000 * e:.1f}" for e in errors_m),
                    )
                )
            print_row(("all", count, *(f"{100 * of:.0f}" for of in (wrong, *np.mean(every, axis=0))), "", ""))


if __name__ == "__main__":
    main()
