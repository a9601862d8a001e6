"""A robot climbs a step by potential fields: tables, report, figures, playback."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from recon.base.errors import all_of
from recon.base.files import name_seen_from, require_free_folder, sole_writer, staged_results
from recon.io.writing import write_rows
from recon.show.plots.style import COLOURS, GREY, PALE, SMALL, add_legend, drawing, save
from recon.show.report import to_json
from recon.show.view.scene import LIMB_COLOURS, TimePlot
from recon.wings.robotics.climb.plan import NONE, RULES, Climb, load_recipe, plan, raised
from recon.wings.robotics.robot.physics import margins_figure
from recon.wings.robotics.robot.playback import write_robot
from recon.wings.robotics.robot.quadruped import LEGS
from recon.wings.robotics.robot.retarget_clip import write_tables
from recon.wings.robotics.robot.robot_file import load_robot
from recon.wings.robotics.settings import ClimbSettings

REPORT = "report.json"
_COLUMNS = 4


def run_climb(settings: ClimbSettings) -> dict[str, Any]:
    """`recon climb`: what report.json says. Raises InputError."""
    out = settings.out
    recipe, _ = all_of(
        lambda: load_recipe(settings.recipe), lambda: require_free_folder(out, (REPORT,), settings.overwrite)
    )
    climb = plan(load_robot(recipe.robot), recipe if settings.height is None else raised(recipe, settings.height))
    report = _report(climb, settings)
    with sole_writer(out):
        require_free_folder(out, (REPORT,), settings.overwrite)
        with staged_results(out) as staging:
            _write(climb, report, staging)
            if settings.figures:
                save(climb_footfalls(climb), staging, "footfalls")
                shown = {
                    rule.what: (climb.margins[name] * rule.per_unit, 0.0, rule.unit) for name, rule in RULES.items()
                }
                save(margins_figure(climb.motion.time_s, shown, _title(climb)), staging, "margins")
    return report


def _report(climb: Climb, settings: ClimbSettings) -> dict[str, Any]:
    recipe, time_s = climb.recipe, climb.motion.time_s
    return {
        "schema": {"name": "recon.climb", "version": 1},
        "robot": climb.motion.robot.name,
        "recipe": {
            "name": name_seen_from(settings.out, settings.recipe),
            "about": recipe.about,
            "degrees_of_freedom": recipe.dofs,
        },
        "step_m": recipe.step.height_m,
        "edge_m": recipe.step.edge_m,
        "valid": not climb.problems(),
        "problems": climb.problems(),
        "least_margins": {
            rule: {
                "what": RULES[rule].what,
                "value": value,
                "unit": RULES[rule].unit,
                "at_s": float(time_s[k]),
                "lifted": _lifted(climb, k) or "none",
            }
            for rule, (value, k) in climb.least.items()
        },
        "frames": len(time_s),
        "duration_s": float(time_s[-1]),
        "evaluations_per_frame": float(climb.evaluations.mean()),
        "settled_share": float(climb.settled.mean()),
        "largest_pitch_rad": float(climb.pitch_rad.max()),
        "rate_share": float(climb.motion.rate_share.max()),
    }


def _lifted(climb: Climb, frame: int) -> str:
    """The leg that is up, empty where none is."""
    leg = int(climb.lifted[frame])
    return "" if leg == NONE else LEGS[leg]


def _write(climb: Climb, report: dict[str, Any], folder: Path) -> None:
    write_tables(climb.motion, folder, "")
    names = [f"{rule}_{'rad' if RULES[rule].unit == 'deg' else 'm'}" for rule in RULES]
    columns = np.column_stack([climb.motion.time_s, *climb.margins.values()])
    rows = [["" if np.isinf(x) else x for x in row] for row in columns.tolist()]
    write_rows(folder / "margins.csv", [["time_s", *names]], rows)
    (folder / REPORT).write_text(to_json(report), encoding="utf-8")
    curves = [
        TimePlot(name, text, (name,), LIMB_COLOURS[:1], values[:, None])
        for name, text, values in (
            ("margin", "centre of mass inside the planted feet, mm", 1000 * climb.margins["support"]),
            ("pitch", "pitch, degrees, nose up", np.degrees(climb.pitch_rad)),
        )
    ]
    write_robot(climb.motion, folder / "climb.rrd", step=climb.recipe.step, more=curves, title=_title(climb))


def _title(climb: Climb) -> str:
    return f"{climb.motion.robot.name} climbs a step of {1000 * climb.recipe.step.height_m:.0f} mm"


# -- figures ---------------------------------------------------------------------------------------------------------


def climb_footfalls(climb: Climb) -> Figure:
    """The robot from the right: at first, in the middle of every footfall, and in the end."""
    frames = [0]
    for k in np.unique(climb.footfall):
        up = np.flatnonzero((climb.footfall == k) & (climb.lifted != NONE))
        frames.append(int(up[len(up) // 2]))
    frames.append(len(climb.lifted) - 1)
    rows, dashed, step = -(-len(frames) // _COLUMNS), (0, (2, 1)), climb.recipe.step
    legs = {label: climb.motion.points(label)[..., [0, 2]] for label in LEGS}
    ends = climb.motion.feet_m[..., 0].min() - 0.05, climb.motion.feet_m[..., 0].max() + 0.05
    with drawing(24.0 * rows + 20, title=_title(climb)) as figure:
        panels = np.ravel(figure.subplots(rows, _COLUMNS, sharex=True, sharey=True, squeeze=False))
        for axes, frame in zip(panels, frames, strict=False):
            ground = [ends[0], step.edge_m, step.edge_m, ends[1]]
            axes.plot(ground, [0, 0, step.height_m, step.height_m], color=GREY, lw=1)
            up = _lifted(climb, frame)
            for label, of_leg in legs.items():
                line = dashed if label == up else "-"
                axes.plot(*of_leg[frame].T, marker="o", ms=2, color=COLOURS[label[0] == "R"], ls=line)
            hips = np.array([legs[label][frame, 0] for label in ("LF", "LH", "RH", "RF", "LF")])
            axes.plot(*hips.T, color=COLOURS[2], lw=2)
            text = f"{climb.motion.time_s[frame]:.1f} s, {up or 'all planted'}"
            axes.set_title(text, fontsize=SMALL, pad=2)
            axes.set_aspect("equal")
        for axes in panels[len(frames) :]:
            axes.set_axis_off()
        for axes in panels[len(frames) - _COLUMNS : len(frames)]:
            axes.tick_params(labelbottom=True)
            axes.set_xlabel("forward (m)")
        figure.supylabel("up (m)", fontsize=8)
        lines = [Line2D([], [], color=colour) for colour in COLOURS[:2]]
        lines.append(Line2D([], [], color=PALE, ls=dashed))
        add_legend(figure, lines, ["left legs", "right legs", "foot that is up"])
    return figure
