"""Measure the margins of the bundled climbs, and how long planning takes.

    python benchmarks/parts/climb.py [--recipe NAME]

The planner runs on one core, after a first run that is not timed. Tables are in Markdown, as in docs/climb.md.
--recipe names the recipe to time.
"""

from __future__ import annotations

import os
import time

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
from arguments import parser_of
from markdown_table import print_table

from recon.robotics.climb.plan import IN_FILES, RULES, Climb, bundled, load_recipe, plan
from recon.robotics.quadruped import Quadruped, load_robot

RUNS = 5


def margin_table(climbs: dict[str, Climb]) -> None:
    rows = []
    for name, rule in RULES.items():
        rows.append([f"{rule.title}, {rule.unit}", *(f"{c.least[name][0]:.1f}" for c in climbs.values())])
    rows.append(
        ["fastest joint, of rate limit", *(f"{100 * c.motion.rate_share.max():.0f} %" for c in climbs.values())]
    )
    rows.append(["largest pitch, deg", *(f"{np.degrees(c.pitch_rad.max()):.0f}" for c in climbs.values())])
    rows.append(["frames, all in equilibrium", *(f"{len(c.lifted)}" for c in climbs.values())])
    rows.append(["duration, s", *(f"{c.motion.time_s[-1]:.1f}" for c in climbs.values())])
    rows.append(["problems", *("; ".join(c.problems()) or "none" for c in climbs.values())])
    heights = [f"{name}: {1000 * c.recipe.step.height_m:.1f} mm" for name, c in climbs.items()]
    print_table(["smallest margin over all frames", *heights], rows)


def footfall_table(climb: Climb) -> None:
    rows = []
    for p in climb.recipe.primitives:
        falls = " ".join(
            f"({IN_FILES[f.leg] + 1}, {1000 * f.forward_m:z.0f}, {1000 * f.up_m:.1f})" for f in p.footfalls
        )
        rows.append([p.name, falls])
    print_table(["primitive", "footfalls: leg, forward mm, up mm"], rows)


def time_table(robot: Quadruped, name: str) -> None:
    recipe, wall, cpu = load_recipe(name), [], []
    climb = plan(robot, recipe)
    for _ in range(RUNS):
        started, busy = time.perf_counter(), time.process_time()
        climb = plan(robot, recipe)
        wall.append(time.perf_counter() - started)
        cpu.append(time.process_time() - busy)
    row = [f"{len(climb.lifted)}", f"{climb.evaluations.mean():.1f}", f"{np.median(wall):.2f}", f"{np.median(cpu):.2f}"]
    print_table(["frames", "evaluations per frame", "wall, s", "processor, s"], [row])


def main() -> None:
    parser = parser_of(__doc__)
    parser.add_argument("--recipe", default="published-50", help=f"of {', '.join(bundled())}")
    arguments = parser.parse_args()
    robot = load_robot("aibo")
    climbs = {name: plan(robot, load_recipe(name)) for name in bundled()}
    margin_table(climbs)
    for name in bundled():
        if not name.startswith("published"):
            print(f"{name}:\n")
            footfall_table(climbs[name])
    time_table(robot, arguments.recipe)


if __name__ == "__main__":
    main()
