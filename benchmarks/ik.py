"""Inverse kinematics of the spine-front-leg chain: time per step, success rates, iterations and closures.

    python benchmarks/ik.py

Joints of `cheetah-8u` in their level base frame. One core, warm. Tables in Markdown, as in docs/ik.md.
"""

from __future__ import annotations

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import time

import numpy as np

from recon.ik.chain import PlanarChain, SummedChain, spine_front_leg
from recon.ik.costs import HarmonicMap, joint_differences, rotational_energy
from recon.ik.drive import drive_to, follow, to_null_space_optimum
from recon.ik.methods import (
    DampedLeastSquares,
    ExtendedJacobian,
    GradientProjection,
    JacobianTranspose,
    LeastNorm,
    Method,
    SelectivelyDamped,
    WeightedLeastNorm,
)
from recon.skeleton_file import load_chain

Array = np.ndarray

TASKS, SEED = 50, 0
STEPS, WARM = 4000, 500
TURNS, POINTS, RADIUS_M = 10, 400, 0.1


def chain_of(dim: int, limited: bool) -> PlanarChain | SummedChain:
    return spine_front_leg(load_chain("cheetah-8u"), dim=3 if dim == 3 else 2, limited=limited)


def methods(chain: PlanarChain | SummedChain) -> dict[str, Method]:
    differences, energy = joint_differences(chain), rotational_energy(chain)
    return {
        "least norm": LeastNorm(),
        "Jacobian transpose": JacobianTranspose(),
        "gradient projection (differences)": GradientProjection(differences),
        "weighted (lengths)": WeightedLeastNorm(np.tile(chain.lengths_m, len(chain.groups))),
        "damped (0.05 m)": DampedLeastSquares(),
        "selectively damped": SelectivelyDamped(),
        "extended Jacobian (differences)": ExtendedJacobian(differences),
        "extended Jacobian (energy)": ExtendedJacobian(energy),
        "extended Jacobian (energy), N constant": ExtendedJacobian(energy, full=False),
        "extended Jacobian (harmonic map)": ExtendedJacobian(HarmonicMap()),
    }


def step_us(chain: PlanarChain | SummedChain, method: Method) -> float:
    """Median time of `rates` at random configurations within the limits, microseconds."""
    rng = np.random.default_rng(SEED)
    q = rng.uniform(chain.lower_rad, chain.upper_rad, (STEPS, chain.n))
    dx = rng.normal(size=(STEPS, chain.dim))
    times = np.empty(STEPS)
    for k in range(STEPS):
        start = time.perf_counter()
        method.rates(chain, q[k], dx[k])
        times[k] = time.perf_counter() - start
    return 1e6 * float(np.median(times[WARM:]))


def tasks(dim: int) -> tuple[Array, Array]:
    """Starts and targets from random poses within the limits."""
    chain, rng = chain_of(dim, True), np.random.default_rng(SEED)
    starts, ends = rng.uniform(chain.lower_rad, chain.upper_rad, (2, TASKS, chain.n))
    return starts, np.array([chain.end(q) for q in ends])


def closure(chain: PlanarChain | SummedChain, method: Method) -> str:
    """Least closures of any joint after the turns on a circle, from the optimum of the method's cost (or the energy's):
    angle / (angle, rate) plane."""
    limited = chain_of(chain.dim, True)
    q = (limited.lower_rad + limited.upper_rad) / 2
    q[5:] = [0.1, 0.15, -0.1, 0.2, 0.15][: len(q[5:])]
    cost = method.cost if isinstance(method, ExtendedJacobian) else rotational_energy(chain)
    q = to_null_space_optimum(chain, q, cost).q[-1]
    angle, start = np.linspace(0, 2 * np.pi, POINTS + 1), chain.end(q)
    u, v = np.array([1.0, 0.0, 0.0])[: chain.dim], np.array([0.0, 0.8, 0.6])[: chain.dim]
    path = start + RADIUS_M * ((np.cos(angle) - 1)[:, None] * u + np.sin(angle)[:, None] * v)
    path[-1] = path[0]
    run = follow(chain, q, path, method, turns=TURNS)
    closures = run.closures()
    singular = ", singular on the way" if run.singular.any() else ""
    return f"{closures.angle.min():.2f} / {closures.plane.min():.2f}{singular}"


def main() -> None:
    print("| method | 2D, us a step | 3D, us a step |\n| --- | --- | --- |")
    flat, space = chain_of(2, True), chain_of(3, True)
    for name, method in methods(flat).items():
        print(f"| {name} | {step_us(flat, method):.0f} | {step_us(space, methods(space)[name]):.0f} |")
    for dim in (2, 3):
        print(f"\n{dim}D, {TASKS} targets, seed {SEED}:\n")
        print("| method | reached | iterations, median (max) | path, m | roughness, rad2 | reached within limits |")
        print("| --- | --- | --- | --- | --- | --- |")
        free, limited = chain_of(dim, False), chain_of(dim, True)
        for name, method in methods(free).items():
            drives = [drive_to(free, q, x, method) for q, x in zip(*tasks(dim), strict=True)]
            within = [drive_to(limited, q, x, method).reached for q, x in zip(*tasks(dim), strict=True)]
            done = [d for d in drives if d.reached]
            steps = [d.iterations for d in done]
            print(
                f"| {name} | {100 * len(done) / TASKS:.0f} % | {np.median(steps):.0f} ({max(steps)}) | "
                f"{np.mean([d.length_m for d in done]):.3f} | {np.median([d.roughness_rad2 for d in done]):.1e} | "
                f"{100 * np.mean(within):.0f} % |"
            )
    print(f"\nLeast closure of any joint after {TURNS} turns on a circle of {RADIUS_M} m, percent, angle / plane:\n")
    print("| method | 2D | 3D |\n| --- | --- | --- |")
    flat, space = chain_of(2, False), chain_of(3, False)
    for name, method in methods(flat).items():
        print(f"| {name} | {closure(flat, method)} | {closure(space, methods(space)[name])} |")


if __name__ == "__main__":
    main()
