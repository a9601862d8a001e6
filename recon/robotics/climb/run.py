"""A robot climbs a step by potential fields, if need be after an animal's motion: tables, report, figures, playback."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from recon.base.arrays import Array
from recon.base.errors import InputError, Problem, all_of
from recon.base.files import name_seen_from, require_free_folder, seen_from, sole_writer, staged_results
from recon.check import usable
from recon.fit.motion import Motion
from recon.io.table import write_rows
from recon.robotics.climb import Climb, Walker, check, load_recipe, plan, plots, raised, scaled
from recon.robotics.climb.margins import RULES, margins
from recon.robotics.climb.motion import before, robot_motion
from recon.robotics.robot.playback import write_robot
from recon.robotics.robot.reference import reference_of
from recon.robotics.robot.retarget import RobotMotion
from recon.robotics.robot.retarget_clip import solve, write_tables
from recon.robotics.robot.robot_file import load_robot
from recon.robotics.settings import ClimbSettings
from recon.show.plots.style import save
from recon.show.report import to_json
from recon.show.view.scene import LIMB_COLOURS, TimePlot

REPORT = "report.json"


def run_climb(settings: ClimbSettings) -> dict[str, Any]:
    """`recon climb`: what report.json says. Raises InputError."""
    out, after = settings.out, settings.after
    recipe, results, _ = all_of(
        lambda: load_recipe(settings.recipe),
        lambda: None if after is None else usable(Motion.load(after), after, settings.anyway),
        lambda: require_free_folder(out, (REPORT,), settings.overwrite),
    )
    machine, own = all_of(lambda: load_robot(settings.robot or recipe.robot), lambda: load_robot(recipe.robot))
    walker = Walker.of(machine)
    recipe = scaled(recipe, _reach(walker) / _reach(Walker.of(own)))
    climb = plan(walker, recipe if settings.height is None else raised(recipe, settings.height), settings.method)
    if settings.at is not None and not 0 <= settings.at <= climb.time_s[-1]:
        longest = f"0 to {climb.time_s[-1]:.2f} s, as long as it takes"
        raise InputError(Problem("--at", "time", f"{settings.at:g} s", longest))
    found = margins(climb.walker, climb.recipe.step, climb.torso, climb.feet_m, climb.lifted)
    least = {rule: values.min(axis=-1) for rule, values in found.items()}
    frame = int(_tightest(least).argmin() if settings.at is None else np.abs(climb.time_s - settings.at).argmin())
    with sole_writer(out):
        require_free_folder(out, (REPORT,), settings.overwrite)
        motion, report = robot_motion(climb, machine), _report(climb, settings, frame)
        if results is not None and after is not None:
            before_it = solve(reference_of(results), machine).motion.clip
            motion, start_s = before(before_it, motion, climb.recipe.step, climb.recipe.fps)
            count = int((motion.time_s < start_s).sum())
            report["after"] = {
                "results": seen_from(out, after),
                "scale": motion.scale,
                "slower": motion.slower,
                "climb_starts_s": start_s,
                "out_of_reach_share": float(motion.short[:count].any(axis=1).mean()),
            }
        with staged_results(out) as staging:
            _write(climb, least, motion, report, staging)
            if settings.figures:
                save(plots.climb_footfalls(climb), staging, "footfalls")
                save(plots.climb_margins(climb, least), staging, "margins")
                save(plots.climb_field(climb, frame), staging, "field")
    return report


def _reach(walker: Walker) -> float:
    return float(np.mean([leg.geometry.reach_m for leg in walker.legs]))


def _tightest(least: Mapping[str, Array]) -> Array:
    """(T,): of all rules, in units of their kind, so that they can be compared."""
    return np.min([least[name] / rule.scale for name, rule in RULES.items()], axis=0)


def _report(climb: Climb, settings: ClimbSettings, frame: int) -> dict[str, Any]:
    found, recipe = check(climb), climb.recipe
    name = name_seen_from(settings.out, settings.recipe)
    return {
        "schema": {"name": "recon.climb", "version": 1},
        "robot": climb.walker.name,
        "recipe": {"name": name, "about": recipe.about, "degrees_of_freedom": len(recipe.motion.dofs)},
        "step_m": recipe.step.height_m,
        "edge_m": recipe.step.edge_m,
        "method": settings.method,
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


def _write(climb: Climb, least: Mapping[str, Array], motion: RobotMotion, report: dict[str, Any], folder: Path) -> None:
    write_tables(motion, folder, "")
    names = [f"{rule}_{'rad' if RULES[rule].unit == 'deg' else 'm'}" for rule in RULES]
    columns = np.column_stack([climb.time_s, *(least[rule] for rule in RULES)])
    rows = [["" if np.isinf(x) else x for x in row] for row in columns.tolist()]
    write_rows(folder / "margins.csv", [["time_s", *names]], rows)
    (folder / REPORT).write_text(to_json(report), encoding="utf-8")
    title = f"{climb.walker.name} climbs a step of {1000 * climb.recipe.step.height_m:.0f} mm"
    title += ", after an animal's motion" if "after" in report else ""
    # The least margin and the pitch; nothing before the climb.
    empty = np.full(len(motion.time_s) - len(climb), np.nan)
    curves = [
        TimePlot(name, text, (name,), LIMB_COLOURS[:1], np.concatenate([empty, values])[:, None])
        for name, text, values in (
            ("margin", "least margin, in units of its kind", _tightest(least)),
            ("pitch", "pitch, degrees, nose up", np.degrees(climb.pitch_rad)),
        )
    ]
    write_robot(motion, folder / "climb.rrd", step=climb.recipe.step, more=curves, title=title)
