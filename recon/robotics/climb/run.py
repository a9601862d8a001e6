"""A robot climbs a step by potential fields, if need be after an animal's motion: tables, report, figures, playback."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, get_args

import numpy as np

from recon.base.arrays import Array
from recon.base.errors import InputError, Problem, all_of
from recon.base.files import name_seen_from, require_free_folder, seen_from, sole_writer, staged_results
from recon.fit.results import read_results
from recon.io.table import write_rows
from recon.robotics.climb import Climb, Walker, check, load_recipe, plan, raised, scaled
from recon.robotics.climb.margins import RULES, margins
from recon.robotics.climb.motion import before, robot_motion
from recon.robotics.climb.plan import Method
from recon.robotics.robot.reference import reference_of
from recon.robotics.robot.retarget import RobotMotion
from recon.robotics.robot.retarget_clip import solve, write_tables
from recon.robotics.robot.robot_file import load_robot
from recon.show.report import to_json

REPORT = "report.json"
METHODS = get_args(Method)


@dataclass(frozen=True, eq=False)
class ClimbRun:
    """margins: the least of each rule in every frame (T,), in m and rad; motion: the robot's, with what comes before
    the climb, which begins at start_s; frame: the one whose field is drawn."""

    climb: Climb
    margins: Mapping[str, Array]
    motion: RobotMotion
    start_s: float
    frame: int
    report: dict[str, Any]


def run_climb(
    recipe: str | Path,
    out: Path,
    robot: str | Path | None = None,
    height_m: float | None = None,
    method: str = "solve",
    at_s: float | None = None,
    after: Path | None = None,
    figures: bool = True,
    overwrite: bool = False,
) -> ClimbRun:
    """`recon climb`. Raises InputError.

    robot: another than the recipe's: lengths are in proportion to its legs; height_m: of the step, with the heights of
    the footfalls in proportion; at_s: when its field is drawn, None: where a margin is least; after: a folder of
    results, whose animal's motion the robot follows up to the step.
    """
    read, results, *_ = all_of(
        lambda: load_recipe(recipe),
        lambda: None if after is None else read_results(after),
        lambda: _check(height_m, method),
        lambda: require_free_folder(out, (REPORT,), overwrite),
    )
    machine, own = all_of(lambda: load_robot(robot or read.robot), lambda: load_robot(read.robot))
    walker = Walker.of(machine)
    read = scaled(read, _reach(walker) / _reach(Walker.of(own)))
    climb = plan(walker, read if height_m is None else raised(read, height_m), "ride" if method == "ride" else "solve")
    if at_s is not None and not 0 <= at_s <= climb.time_s[-1]:
        raise InputError(Problem("--at", "time", f"{at_s:g} s", f"0 to {climb.time_s[-1]:.2f} s, as long as it takes"))
    with sole_writer(out):
        require_free_folder(out, (REPORT,), overwrite)
        motion, start_s = robot_motion(climb, machine), 0.0
        if results is not None:
            run = solve(reference_of(results), machine).motion.clip
            motion, start_s = before(run, motion, climb.recipe.step, climb.recipe.fps)
        name, origin = name_seen_from(out, str(recipe)), after and seen_from(out, after)
        solved = _solved(climb, motion, start_s, at_s, method, name, origin)
        with staged_results(out) as staging:
            write(solved, staging, figures)
    return solved


def _check(height_m: float | None, method: str) -> None:
    problems = []
    if height_m is not None and not (np.isfinite(height_m) and height_m > 0):
        problems.append(Problem("--height", "step", f"{height_m:g} m", "a height above 0"))
    if method not in METHODS:
        problems.append(Problem("--method", "method", repr(method), " or ".join(METHODS)))
    if problems:
        raise InputError(problems)


def _reach(walker: Walker) -> float:
    return float(np.mean([leg.geometry.reach_m for leg in walker.legs]))


def _solved(
    climb: Climb, motion: RobotMotion, start_s: float, at_s: float | None, method: str, name: str, after: str | None
) -> ClimbRun:
    found = margins(climb.walker, climb.recipe.step, climb.torso, climb.feet_m, climb.lifted)
    least = {rule: values.min(axis=-1) for rule, values in found.items()}
    frame = int(_tightest(least).argmin()) if at_s is None else int(np.abs(climb.time_s - at_s).argmin())
    report = _report(climb, method, name, frame)
    if after is not None:
        count = int((motion.time_s < start_s).sum())
        report["after"] = {
            "results": after,
            "scale": motion.scale,
            "slower": motion.slower,
            "climb_starts_s": start_s,
            "out_of_reach_share": float(motion.short[:count].any(axis=1).mean()),
        }
    return ClimbRun(climb, least, motion, start_s, frame, report)


def _tightest(least: Mapping[str, Array]) -> Array:
    """(T,): of all rules, in units of their kind, so that they can be compared."""
    return np.min([least[name] / rule.scale for name, rule in RULES.items()], axis=0)


def _report(climb: Climb, method: str, name: str, frame: int) -> dict[str, Any]:
    found, recipe = check(climb), climb.recipe
    return {
        "schema": {"name": "recon.climb", "version": 1},
        "robot": climb.walker.name,
        "recipe": {"name": name, "about": recipe.about, "degrees_of_freedom": len(recipe.motion.dofs)},
        "step_m": recipe.step.height_m,
        "edge_m": recipe.step.edge_m,
        "method": method,
        "valid": found.valid,
        "problems": found.problems(),
        "least_margins": {
            rule: {
                "what": row.what,
                "value": row.value,
                "unit": row.unit,
                "at_s": float(climb.time_s[row.frame]),
                "lifted": row.lifted,
            }
            for rule, row in found.rows.items()
        },
        "frames": len(climb),
        "duration_s": float(climb.time_s[-1]),
        "evaluations_per_frame": float(climb.evaluations.mean()),
        "settled_share": float(climb.settled.mean()),
        "largest_pitch_rad": float(climb.pitch_rad.max()),
        "rate_share": found.rate_share,
        "field_drawn_at_s": float(climb.time_s[frame]),
    }


# -- what is written -------------------------------------------------------------------------------------------------


def write(solved: ClimbRun, folder: Path, figures: bool = True) -> None:
    """Everything, into a folder that there is."""
    from recon.robotics.robot.playback import write_robot

    climb = solved.climb
    write_tables(solved.motion, folder, "")
    names = [f"{rule}_{'rad' if RULES[rule].unit == 'deg' else 'm'}" for rule in RULES]
    columns = np.column_stack([climb.time_s, *(solved.margins[rule] for rule in RULES)])
    rows = [["" if np.isinf(x) else x for x in row] for row in columns.tolist()]
    write_rows(folder / "margins.csv", [["time_s", *names]], rows)
    (folder / REPORT).write_text(to_json(solved.report), encoding="utf-8")
    title = f"{climb.walker.name} climbs a step of {1000 * climb.recipe.step.height_m:.0f} mm"
    title += ", after an animal's motion" if "after" in solved.report else ""
    path = folder / "climb.rrd"
    write_robot(solved.motion, path, step=climb.recipe.step, more=_curves(solved), title=title)
    if figures:
        from recon.robotics.climb import plots
        from recon.show.plots.style import save

        save(plots.climb_footfalls(climb), folder, "footfalls")
        save(plots.climb_margins(climb, solved.margins), folder, "margins")
        save(plots.climb_field(climb, solved.frame), folder, "field")


def _curves(solved: ClimbRun) -> list[Any]:
    """The least margin and the pitch; nothing before the climb."""
    from recon.show.view.scene import LIMB_COLOURS
    from recon.show.view.series import TimePlot

    empty = np.full(len(solved.motion.time_s) - len(solved.climb), np.nan)
    pitch = np.degrees(solved.climb.pitch_rad)
    return [
        TimePlot(name, title, (name,), LIMB_COLOURS[:1], np.concatenate([empty, values])[:, None])
        for name, title, values in (
            ("margin", "least margin, in units of its kind", _tightest(solved.margins)),
            ("pitch", "pitch, degrees, nose up", pitch),
        )
    ]
