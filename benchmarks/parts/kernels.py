"""Compare the time of each kernel of a fit with a theoretical limit, and the time of each stage with the whole fit.

    python benchmarks/parts/kernels.py [CASE ...]

A case is frames x cameras, such as 400x1 (default: 400x1 300x6). All times are processor times of one thread. The limit
of a kernel is the larger of two times: its floating-point operations at the speed of small matrix products, and the
bytes that it has to read and write at the speed of copying. Both speeds are measured in the same run, which makes
ratios comparable on a busy machine. The times of stages come from the profiler, which adds about a quarter to each.
"""

from __future__ import annotations

import os

os.environ["OPENBLAS_NUM_THREADS"] = "1"

import argparse
import cProfile
import pstats
import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np
from markdown_table import print_table
from trajectory import FPS, PRIOR, body_of, circling, prior_of

from recon.animal.body import Body
from recon.fit import banded
from recon.fit.clip_problem import ClipProblem, TrajectoryOptions, contacts
from recon.fit.trajectory import solve_trajectory

CASES = ("400x1", "300x6")
REPEATS = 7
STAGES = {
    "solve_trajectory": "whole fit",
    "approach": "starts",
    "_solve_flattened": "flattened mixtures of poses",
    "solve_round": "rounds",
    "prior_misfit_of": "misfit of the prior",
    "_with_reestimated_noise": "noise about the keypoint bias",
    "posterior": "posterior",
    "normal": "normal equations (within all)",
    "cost": "cost (within all)",
    "step": "banded steps (within all)",
}
"""Title of the stage of a fit that each function of the solver computes."""


@dataclass(frozen=True)
class Kernel:
    """A computation on all frames, with the minimum number of operations and bytes per frame."""

    name: str
    run: Callable[[], object]
    flops: float
    bytes_moved: float


def processor_s(run: Callable[[], object]) -> float:
    """Run a function a few times, and return the shortest processor time, seconds."""
    times = []
    for _ in range(REPEATS):
        began = time.process_time()
        run()
        times.append(time.process_time() - began)
    return min(times)


def speeds(body: Body) -> tuple[float, float]:
    """Measure the speed of small matrix products, operations/s, and the speed of copying, bytes/s."""
    D = body.n_state
    a, out = np.ones((400, 3 * D, 3 * D)), np.empty((400, 3 * D, 3 * D))
    flops = 400 * 2 * (3 * D) ** 3 / processor_s(lambda: np.matmul(a, a, out=out))
    source, target = np.ones(4_000_000), np.empty(4_000_000)
    return flops, 2 * source.nbytes / processor_s(lambda: np.copyto(target, source))


def kernels(frames: int, cameras: int) -> list[Kernel]:
    """Build the kernels of a fit from a simulated clip at its solution."""
    body, prior = body_of("phantom"), prior_of(PRIOR)
    views, _ = circling(frames, cameras)
    solution = solve_trajectory(views, body, prior, FPS, TrajectoryOptions(fast=True))
    clip = ClipProblem.from_views(views, body, prior, FPS, TrajectoryOptions()).with_free_shape()
    states = solution.states.copy()
    states[:, :3] = (states[:, :3] - clip.origin_m) / solution.size
    markers, D, J = clip.markers(states), body.n_state, len(body.markers)
    noise_px = clip.noise_px(markers, np.ones((cameras, J)))
    start = clip.problem(noise_px)
    last = clip.problem(noise_px, 1.0, contacts(clip, markers, 1.0)[2], markers)
    normal = last.normal(states)
    whole = banded.factored(normal.blocks, 1e-3)
    factor = partial(whole.first_frames, frames)  # a new object, because a factor keeps its inverse diagonal blocks
    P, width, number = len(normal.corner), 3 * D, 8
    # Multiply the derivatives of pixels and of markers, then accumulate the normal equations of the states.
    by_state = 2 * 2 * cameras * J * D * 3 + 2 * 3 * J * D * (D + P)
    normal_bytes = number * (D * width + D * P + 3 * J * D)
    right = np.concatenate([normal.gradient[..., None], normal.border], axis=2)
    tree = last.tree
    return [
        Kernel("kinematics", lambda: tree.pose(states), 30.0 * D, number * (D + 3 * J)),
        Kernel("kinematics with Jacobian", lambda: tree.pose_with_jacobian(states), 60.0 * D, number * 3 * J * D),
        Kernel("cost, starts", lambda: start.cost(states), 60.0 * cameras * J, number * 3 * cameras * J),
        Kernel("cost, rounds", lambda: last.cost(states), 60.0 * cameras * J, number * 3 * cameras * J),
        Kernel("normal equations, starts", lambda: start.normal(states), by_state, normal_bytes),
        Kernel("normal equations, rounds", lambda: last.normal(states), by_state, normal_bytes),
        Kernel("band from blocks", lambda: banded.lower_band(normal.blocks), 0.0, 2 * number * D * width),
        Kernel("elimination", lambda: banded.factored(normal.blocks, 1e-3), D * width**2, 2 * number * D * width),
        Kernel(
            f"{P + 1} right sides", lambda: factor().whiten(right), 2 * D * width * (P + 1), 2 * number * D * (P + 1)
        ),
        Kernel("covariances", lambda: factor().marginal_blocks(), 4 * D * width**2, 2 * number * D * width),
    ]


def stages(frames: int, cameras: int) -> list[list[str]]:
    """Profile a fit, and return milliseconds per frame and fraction of the whole fit for each stage."""
    views, _ = circling(frames, cameras)
    profile = cProfile.Profile(time.process_time)
    profile.runcall(solve_trajectory, views, body_of("phantom"), prior_of(PRIOR), FPS)
    by_name = dict.fromkeys(STAGES, 0.0)
    for (file, _, name), (_, _, _, cumulative_s, _) in pstats.Stats(profile).stats.items():  # type: ignore[attr-defined]
        if name in by_name and f"recon{os.sep}fit" in file:
            by_name[name] = max(by_name[name], cumulative_s)
    whole_s = by_name["solve_trajectory"]
    return [
        [STAGES[name], f"{1000 * seconds / frames:.2f}", f"{seconds / whole_s:.0%}"]
        for name, seconds in by_name.items()
        if seconds
    ]


def main() -> None:
    """Print the times of kernels and stages for each case."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("cases", nargs="*", default=CASES)
    for case in parser.parse_args().cases:
        frames, cameras = (int(part) for part in case.split("x"))
        flops, copied = speeds(body_of("phantom"))
        print(f"\nCase {case}: small products at {flops / 1e9:.1f} GF/s, copies at {copied / 1e9:.1f} GB/s.\n")
        rows = []
        for kernel in kernels(frames, cameras):
            taken_s = processor_s(kernel.run) / frames
            limit_s = max(kernel.flops / flops, kernel.bytes_moved / copied)
            numbers = (f"{1e6 * taken_s:.1f}", f"{1e6 * limit_s:.2f}", f"{taken_s / limit_s:.1f}")
            rows.append([case, kernel.name, *numbers])
        print_table(["case", "kernel", "µs per frame", "limit µs", "ratio"], rows)
        print()
        print_table(["case", "stage", "ms per frame", "of the fit"], [[case, *row] for row in stages(frames, cameras)])


if __name__ == "__main__":
    main()
