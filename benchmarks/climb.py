"""A robot climbs a step by potential fields: margins of the bundled climbs, and how long planning takes.

    python benchmarks/climb.py [--figure FILE.png] [--playback FILE.rrd] [--recipe NAME]

One core, warm. Tables in Markdown, as in docs/climb.md. --figure (needs matplotlib) and --playback draw one recipe.
"""

from __future__ import annotations

import argparse
import os
import time
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
from markdown_table import print_table

from recon.robot.climb import Climb, Walker, bundled, check, load_recipe, plan, write_playback
from recon.robot.climb.equilibrium import MAX_EVALUATIONS
from recon.robot.climb.margins import RULES
from recon.robot.climb.plan import Method
from recon.robot.climb.playback import lines, step_lines
from recon.robot.robot_file import load_robot

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


def draw(climb: Climb, path: Path) -> None:
    """The torso and the legs from the right: at first, in the middle of every footfall, and in the end."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    outline, legs = lines(climb)
    profile = step_lines(climb)[1]
    frames = [0]
    for k in range(len(climb.recipe.footfalls)):
        up = np.flatnonzero((climb.footfall == k) & (climb.lifted >= 0))
        frames.append(int(up[len(up) // 2]))
    frames.append(len(climb) - 1)
    figure, axes = plt.subplots(2, 7, figsize=(21, 4.4), layout="constrained", sharex=True, sharey=True)
    for ax, frame in zip(axes.flat, frames, strict=True):
        ax.plot(profile[:, 1], profile[:, 2], color="0.3")
        for leg in range(4):
            colour = "#e69f00" if climb.walker.side[leg] > 0 else "#56b4e9"
            ax.plot(legs[frame, leg, :, 1], legs[frame, leg, :, 2], "-o", color=colour, markersize=3)
        ax.plot(outline[frame, :, 1], outline[frame, :, 2], color="#009e73", linewidth=3)
        up = int(climb.lifted[frame])
        ax.set_title(f"{climb.time_s[frame]:.1f} s" + (f", leg {up + 1}" if up >= 0 else ""))
        ax.set_aspect("equal")
    low, high = climb.feet_m[..., 1].min() - 0.06, climb.feet_m[..., 1].max() + 0.06
    axes[0, 0].set(xlim=(low, high), ylim=(-0.01, outline[..., 2].max() + 0.02))
    figure.supxlabel("forward, m")
    figure.supylabel("up, m")
    figure.savefig(path, dpi=70)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--recipe", default="published-50", help=f"of {', '.join(bundled())}")
    parser.add_argument("--figure", type=Path)
    parser.add_argument("--playback", type=Path)
    arguments = parser.parse_args()
    walker = Walker.of(load_robot("aibo"))
    if arguments.figure or arguments.playback:
        climb = plan(walker, load_recipe(arguments.recipe))
        if arguments.figure:
            draw(climb, arguments.figure)
        if arguments.playback:
            write_playback(climb, arguments.playback)
        return
    climbs = {name: plan(walker, load_recipe(name)) for name in bundled()}
    margin_table(climbs)
    for name in bundled():
        if not name.startswith("published"):
            print(f"{name}:\n")
            footfall_table(climbs[name])
    time_table(walker, arguments.recipe)


if __name__ == "__main__":
    main()
