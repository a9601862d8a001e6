"""A robot climbs a step by potential fields: margins of the bundled climbs, and how long planning takes.

    python benchmarks/climb.py [--recipe NAME]

One core, warm. Tables in Markdown, as in docs/climb.md; --recipe: the one that is timed.
"""

from __future__ import annotations

import argparse
import os
import time

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
from markdown_table import print_table

from recon.robotics.climb import Climb, Walker, bundled, check, load_recipe, plan
from recon.robotics.climb.equilibrium import MAX_EVALUATIONS
from recon.robotics.climb.margins import RULES
from recon.robotics.climb.plan import Method
from recon.robotics.robot.robot_file import load_robot

RUNS = 5


def margin_table(climbs: dict[str, Climb]) -> None:
    checks = {name: check(c) for name, c in climbs.items()}
    rows = []
    for name, rule in RULES.items():
        rows.append([f"{rule.what}, {rule.unit}", *(f"{k.rows[name].value:.1f}" for k in checks.values())])
    rows.append(["deepest foot under the surface, mm", *(f"{1000 * k.deepest_m:.3f}" for k in checks.values())])
    rows.append(["all feet end on top", *("yes" if k.on_top else "no" for k in checks.values())])
    rows.append(["fastest joint, of its limit", *(f"{100 * k.rate_share:.0f} %" for k in checks.values())])
    rows.append(["largest pitch, deg", *(f"{np.degrees(c.pitch_rad.max()):.0f}" for c in climbs.values())])
    rows.append(["frames, all in equilibrium", *(f"{len(c)}" for c in climbs.values())])
    rows.append(["duration, s", *(f"{c.time_s[-1]:.1f}" for c in climbs.values())])
    rows.append(["valid in every frame", *("yes" if k.valid else "no" for k in checks.values())])
    heights = [f"{name}: {1000 * c.recipe.step.height_m:.1f} mm" for name, c in climbs.items()]
    print_table(["least margin over all frames", *heights], rows)


def footfall_table(climb: Climb) -> None:
    rows = []
    for p in climb.recipe.primitives:
        falls = " ".join(f"({f.leg + 1}, {1000 * f.forward_m:z.0f}, {1000 * f.up_m:.1f})" for f in p.footfalls)
        rows.append([p.name, falls])
    print_table(["primitive", "footfalls: leg, forward mm, up mm"], rows)


def planned(walker: Walker, name: str, method: Method, runs: int) -> tuple[Climb, float, float]:
    """The climb, and the medians of its wall time and of its processor time, seconds."""
    recipe, wall, cpu = load_recipe(name), [], []
    climb = plan(walker, recipe)
    for _ in range(runs):
        started, busy = time.perf_counter(), time.process_time()
        climb = plan(walker, recipe, method)
        wall.append(time.perf_counter() - started)
        cpu.append(time.process_time() - busy)
    return climb, float(np.median(wall)), float(np.median(cpu))


def time_table(walker: Walker, name: str) -> None:
    rows, solved = [], plan(walker, load_recipe(name))
    methods: list[tuple[Method, int, str]] = [
        ("solve", RUNS, "solved (Newton)"),
        ("ride", 1, f"ridden, at most {MAX_EVALUATIONS} evaluations"),
    ]
    for method, runs, label in methods:
        climb, wall, cpu = planned(walker, name, method, runs)
        end = 1000 * float(np.linalg.norm(climb.position_m[-1] - solved.position_m[-1]))
        rows.append(
            [
                label,
                f"{len(climb)}",
                f"{climb.evaluations.mean():.1f}",
                f"{100 * climb.settled.mean():.0f} %",
                f"{wall:.2f}",
                f"{cpu:.2f}",
                f"{1000 * cpu / len(climb):.2f}",
                f"{end:.2f}",
                "yes" if check(climb).valid else "no",
            ]
        )
    header = ["torso", "frames", "evaluations a frame", "frames at the minimum", "wall, s", "processor, s"]
    print_table([*header, "processor, ms a frame", "apart at the end, mm", "valid"], rows)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--recipe", default="published-50", help=f"of {', '.join(bundled())}")
    arguments = parser.parse_args()
    walker = Walker.of(load_robot("aibo"))
    climbs = {name: plan(walker, load_recipe(name)) for name in bundled()}
    margin_table(climbs)
    for name in bundled():
        if not name.startswith("published"):
            print(f"{name}:\n")
            footfall_table(climbs[name])
    time_table(walker, arguments.recipe)


if __name__ == "__main__":
    main()
