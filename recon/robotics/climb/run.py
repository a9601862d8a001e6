"""A robot climbs a step by potential fields, if need be after an animal's motion: tables, report, figures, playback."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation, Slerp

from recon.base.arrays import Array
from recon.base.errors import InputError, Problem, all_of
from recon.base.files import name_seen_from, require_free_folder, seen_from, sole_writer, staged_results
from recon.check import usable
from recon.fit.motion import Motion
from recon.io.table import write_rows
from recon.robotics.climb import plots
from recon.robotics.climb.check import RULES, ClimbCheck
from recon.robotics.climb.plan import LABELS, LEGS, NONE, Climb, Walker, plan
from recon.robotics.climb.recipe import Step, load_recipe, raised, scaled
from recon.robotics.robot.playback import write_robot
from recon.robotics.robot.quadruped import LEGS as ROBOT_LEGS
from recon.robotics.robot.quadruped import Quadruped
from recon.robotics.robot.reference import reference_of
from recon.robotics.robot.retarget import RobotMotion, posed, retarget
from recon.robotics.robot.retarget_clip import write_tables
from recon.robotics.robot.robot_file import load_robot
from recon.robotics.settings import ClimbSettings
from recon.show.plots.style import save
from recon.show.report import to_json
from recon.show.view.scene import LIMB_COLOURS, TimePlot

REPORT = "report.json"
TURNED = np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
"""From the climb's axes (right, forwards, up) to the robot's (forwards, left, up)."""
ROOM_M = 0.01
"""Between the step's edge and the foremost foot of what comes before a climb."""
PART_S, PACE, LIFT = 0.4, 0.95, 0.1
"""For the steps into a climb's stance: the time for each, unless joints are too slow; the share of their rates that is
used; how high a foot rises, of the standing height."""
IN_TURN = ("LH", "LF", "RH", "RF")


def run_climb(settings: ClimbSettings) -> dict[str, Any]:
    """`recon climb`: what report.json says. Raises InputError."""
    out, after = settings.out, settings.after
    recipe, results, _ = all_of(
        lambda: load_recipe(settings.recipe),
        lambda: None if after is None else usable(Motion.load(after), after, settings.anyway),
        lambda: require_free_folder(out, (REPORT,), settings.overwrite),
    )
    machine, own = all_of(lambda: load_robot(settings.robot or recipe.robot), lambda: load_robot(recipe.robot))
    recipe = scaled(recipe, _reach(machine) / _reach(own))
    climb = plan(Walker(machine), recipe if settings.height is None else raised(recipe, settings.height))
    if settings.at is not None and not 0 <= settings.at <= climb.time_s[-1]:
        longest = f"0 to {climb.time_s[-1]:.2f} s, as long as it takes"
        raise InputError(Problem("--at", "time", f"{settings.at:g} s", longest))
    found = ClimbCheck(climb)
    frame = int(found.tightest.argmin() if settings.at is None else np.abs(climb.time_s - settings.at).argmin())
    with sole_writer(out):
        require_free_folder(out, (REPORT,), settings.overwrite)
        motion, report = robot_motion(climb), _report(found, settings, frame)
        if results is not None and after is not None:
            run = retarget(reference_of(results), machine).clip
            motion, start_s = before(run, motion, climb.recipe.step, climb.recipe.fps)
            report["after"] = {
                "results": seen_from(out, after),
                "scale": motion.scale,
                "slower": motion.slower,
                "climb_starts_s": start_s,
                "out_of_reach_share": float(motion.short[motion.time_s < start_s].any(axis=1).mean()),
            }
        with staged_results(out) as staging:
            _write(found, motion, report, staging)
            if settings.figures:
                save(plots.climb_footfalls(climb), staging, "footfalls")
                save(plots.climb_margins(found), staging, "margins")
                save(plots.climb_field(climb, frame), staging, "field")
    return report


def _reach(robot: Quadruped) -> float:
    """The mean reach of the legs, from the first joint on."""
    return float(np.mean([leg.chain.lengths_m.sum() for leg in robot.legs.values()]))


def _report(found: ClimbCheck, settings: ClimbSettings, frame: int) -> dict[str, Any]:
    climb, recipe = found.climb, found.climb.recipe
    return {
        "schema": {"name": "recon.climb", "version": 1},
        "robot": climb.walker.robot.name,
        "recipe": {
            "name": name_seen_from(settings.out, settings.recipe),
            "about": recipe.about,
            "degrees_of_freedom": recipe.dofs,
        },
        "step_m": recipe.step.height_m,
        "edge_m": recipe.step.edge_m,
        "valid": not found.problems(),
        "problems": found.problems(),
        "least_margins": {
            rule: {
                "what": RULES[rule].what,
                "value": value,
                "unit": RULES[rule].unit,
                "at_s": float(climb.time_s[k]),
                "lifted": "none" if climb.lifted[k] == NONE else LEGS[climb.lifted[k]],
            }
            for rule, (value, k) in found.least.items()
        },
        "frames": len(climb),
        "duration_s": float(climb.time_s[-1]),
        "evaluations_per_frame": float(climb.evaluations.mean()),
        "settled_share": float(climb.settled.mean()),
        "largest_pitch_rad": float(climb.pitch_rad.max()),
        "rate_share": found.rate_share,
        "field_drawn_at_s": float(climb.time_s[frame]),
    }


def _write(found: ClimbCheck, motion: RobotMotion, report: dict[str, Any], folder: Path) -> None:
    climb, least = found.climb, found.margins
    write_tables(motion, folder, "")
    names = [f"{rule}_{'rad' if RULES[rule].unit == 'deg' else 'm'}" for rule in RULES]
    columns = np.column_stack([climb.time_s, *(least[rule] for rule in RULES)])
    rows = [["" if np.isinf(x) else x for x in row] for row in columns.tolist()]
    write_rows(folder / "margins.csv", [["time_s", *names]], rows)
    (folder / REPORT).write_text(to_json(report), encoding="utf-8")
    title = f"{climb.walker.robot.name} climbs a step of {1000 * climb.recipe.step.height_m:.0f} mm"
    title += ", after an animal's motion" if "after" in report else ""
    # The least margin and the pitch; nothing before the climb.
    empty = np.full(len(motion.time_s) - len(climb), np.nan)
    curves = [
        TimePlot(name, text, (name,), LIMB_COLOURS[:1], np.concatenate([empty, values])[:, None])
        for name, text, values in (
            ("margin", "least margin, in units of its kind", found.tightest),
            ("pitch", "pitch, degrees, nose up", np.degrees(climb.pitch_rad)),
        )
    ]
    write_robot(motion, folder / "climb.rrd", step=climb.recipe.step, more=curves, title=title)


# -- as a motion of the robot, in the axes of retargeted ones, and after another motion --------------------------------


def robot_motion(climb: Climb) -> RobotMotion:
    """A foot that is out of reach, or beyond a joint's limits, is drawn in."""
    order = [LABELS.index(label) for label in ROBOT_LEGS]
    rotation = Rotation.from_matrix(TURNED @ climb.rotation @ TURNED.T)
    pose = RigidTransform.from_components(climb.position_m @ TURNED.T, rotation)
    standing = climb.lifted[:, None] != np.array(order)
    return posed(climb.walker.robot, climb.time_s, pose, climb.feet_m[:, order] @ TURNED.T, standing)


def before(run: RobotMotion, climb: RobotMotion, step: Step, fps: float) -> tuple[RobotMotion, float]:
    """A motion along x and then a climb's, in one, and when the climb begins.

    The run ends where no foot of it comes nearer to the step's edge than `ROOM_M`. Between them the feet that are up
    come down, and then step one after the other to the climb's first stance, while the body moves to its first pose:
    no forces, and nothing says that it would keep its balance there.
    """
    at = np.arange(0.0, float(run.time_s[-1]), 1 / fps)
    rows = np.append(np.searchsorted(run.time_s, at), len(run.time_s) - 1)
    shift = np.array([step.edge_m - ROOM_M - run.feet_m[..., 0].max(), 0.0, 0.0])
    shift[1] = climb.pose.translation[0, 1] - run.pose.translation[-1, 1]
    place = RigidTransform.from_components(run.pose.translation[rows] + shift, run.pose.rotation[rows])
    feet = run.feet_m[rows] + shift
    first = posed(run.robot, np.append(at, run.time_s[-1]), place, feet, run.standing[rows])
    between = _settling(first, climb, fps)
    parts = [first, between, climb]
    starts = np.cumsum([0.0, first.time_s[-1] + 1 / fps, between.time_s[-1] + 1 / fps])
    whole = replace(
        climb,
        scale=run.scale,
        slower=run.slower,
        time_s=np.concatenate([part.time_s + start for part, start in zip(parts, starts, strict=True)]),
        pose=RigidTransform.concatenate([part.pose for part in parts]),
        **{
            name: np.concatenate([getattr(part, name) for part in parts])
            for name in ("angles_rad", "feet_m", "standing", "short")
        },
    )
    return whole, float(starts[2])


def _settling(run: RobotMotion, climb: RobotMotion, fps: float) -> RobotMotion:
    """From the last sample of a run to the first of a climb, as slow as the joints' rates ask for."""
    count = int(np.ceil(PART_S * fps))
    share = np.arange(1, 5 * count) / (5 * count)
    ends = RigidTransform.concatenate([run.pose[-1], climb.pose[0]])
    smooth = (1 - np.cos(np.pi * share)) / 2
    pose = RigidTransform.from_components(
        ends.translation[0] + smooth[:, None] * (ends.translation[1] - ends.translation[0]),
        Slerp([0.0, 1.0], ends.rotation)(smooth),
    )
    feet, standing = np.empty((len(share), 4, 3)), np.ones((len(share), 4), bool)
    start, goal = run.feet_m[-1], climb.feet_m[0]
    for k, label in enumerate(ROBOT_LEGS):
        part = np.clip(5 * share - 1 - IN_TURN.index(label), 0.0, 1.0)
        feet[:, k] = start[k] + ((1 - np.cos(np.pi * part)) / 2)[:, None] * (goal[k] - start[k])
        feet[:, k, 2] = start[k, 2] * np.clip(1 - 5 * share, 0.0, 1.0) + _rise(part, run.robot)
        standing[:, k] = feet[:, k, 2] <= 0
    motion = posed(run.robot, np.arange(len(share)) / fps, pose, feet, standing)
    slower = max(1.0, float(motion.rate_share.max()) / PACE)
    return replace(motion, time_s=slower * motion.time_s)


def _rise(part: Array, robot: Quadruped) -> Array:
    return np.where(part < 1, LIFT * robot.stand_m * np.sin(np.pi * part), 0.0)
