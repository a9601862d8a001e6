"""A climb by potential fields: its footfalls, its margins, and the field at one configuration."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from recon.robotics.climb.check import RULES, ClimbCheck
from recon.robotics.climb.fields import Torso, evaluate, leg_forces, leg_vectors
from recon.robotics.climb.plan import AROUND, LEGS, Climb
from recon.show.plots.style import COLOURS, GREY, PALE, SMALL, add_legend, drawing

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

LEFT, RIGHT, TORSO = COLOURS[0], COLOURS[1], COLOURS[2]
_COLUMNS = 4
_AROUND_M, _AROUND_RAD, _GRID = 0.35, 0.35, 41
"""How far around the torso its field is drawn, of the hips' height, and how finely."""


def climb_footfalls(climb: Climb) -> Figure:
    """The robot from the right: at first, in the middle of every footfall, and in the end."""
    frames = [0]
    for k in range(len(climb.recipe.footfalls)):
        up = np.flatnonzero((climb.footfall == k) & (climb.lifted >= 0))
        frames.append(int(up[len(up) // 2]))
    frames.append(len(climb) - 1)
    rows = -(-len(frames) // _COLUMNS)
    with drawing(24.0 * rows + 20, title=_title(climb)) as figure:
        panels = np.ravel(figure.subplots(rows, _COLUMNS, sharex=True, sharey=True, squeeze=False))
        for axes, frame in zip(panels, frames, strict=False):
            _robot(axes, climb, frame, (1, 2))
            up = int(climb.lifted[frame])
            what = "all planted" if up < 0 else LEGS[up]
            axes.set_title(f"{climb.time_s[frame]:.1f} s, {what}", fontsize=SMALL, pad=2)
            axes.set_aspect("equal")
        for axes in panels[len(frames) :]:
            axes.set_axis_off()
        for axes in panels[len(frames) - _COLUMNS : len(frames)]:
            axes.tick_params(labelbottom=True)
            axes.set_xlabel("forward (m)")
        figure.supylabel("up (m)", fontsize=8)
        _sides(figure)
    return figure


def climb_margins(found: ClimbCheck) -> Figure:
    """The least margin of each rule in every frame; bands are where a foot is up."""
    climb = found.climb
    with drawing(130.0, title=f"{_title(climb)}: distance from what it must not do") as figure:
        panels = np.ravel(figure.subplots(-(-len(RULES) // 2), 2, sharex=True))
        for axes, (name, rule) in zip(panels, RULES.items(), strict=True):
            values = np.where(np.isfinite(found.margins[name]), found.margins[name], np.nan) * rule.per_unit
            for leg in range(4):
                colour = RIGHT if climb.walker.side[leg] > 0 else LEFT
                axes.fill_between(
                    climb.time_s,
                    0,
                    1,
                    climb.lifted == leg,
                    transform=axes.get_xaxis_transform(),
                    color=colour,
                    alpha=0.1,
                    lw=0,
                )
            axes.axhline(0, color=GREY, lw=0.8)
            axes.plot(climb.time_s, values, color="k", lw=0.9)
            least = int(np.nanargmin(values))
            axes.plot(climb.time_s[least], values[least], "o", ms=3, color="k")
            axes.set_title(f"{rule.what}: least {values[least]:.1f} {rule.unit}", fontsize=SMALL, loc="left", pad=2)
            axes.set_ylabel(rule.unit, fontsize=SMALL)
            axes.set_ylim(min(0.0, float(np.nanmin(values)) * 1.1), None)
        for axes in panels[-2:]:
            axes.set_xlabel("time (s)")
    return figure


def climb_field(climb: Climb, frame: int) -> Figure:
    """Energy of the torso's places around where it is, from the right and from above, everything else as it is, and
    by its pitch; arrows are the force on the torso, thick ones that of each leg at its hip."""
    stand = climb.stand(frame)
    size = _AROUND_M * float(climb.position_m[:, 2].mean())
    here = Torso(climb.position_m[frame], climb.rotation[frame])
    with drawing(74.0) as figure:
        up = int(climb.lifted[frame])
        what = "all feet planted" if up < 0 else f"{LEGS[up]} foot up"
        figure.suptitle(f"{_title(climb)}: the field at {climb.time_s[frame]:.2f} s, {what}")
        panels = figure.subplots(1, 3, width_ratios=(5, 4, 3))
        offsets, every = np.linspace(-size, size, _GRID), slice(0, None, 8)
        for axes, view, names in zip(panels, ((1, 2), (0, 1)), (("forward", "up"), ("right", "forward")), strict=False):
            step = np.zeros((_GRID, _GRID, 6))
            step[..., view[0]], step[..., view[1]] = offsets[None, :], offsets[:, None]
            energy, wrench, _ = evaluate(stand, here.moved(step))
            above = energy - energy.min()
            at = [here.position_m[k] + offsets for k in view]
            shown = np.log10(above + 1e-3 * np.median(above))
            light = {"cmap": "Greys", "vmax": shown.max() + np.ptp(shown)}
            axes.pcolormesh(*at, shown, **light, shading="gouraud", zorder=0, rasterized=True)  # 20 MB as an SVG else
            force = wrench[every, every][..., list(view)]
            force = force / np.linalg.norm(force, axis=-1, keepdims=True)
            axes.quiver(*(a[every] for a in at), force[..., 0], force[..., 1], color=GREY, width=0.006, scale=16)
            _robot(axes, climb, frame, view)
            _leg_forces(axes, climb, frame, view, size)
            axes.plot(*here.position_m[list(view)], "o", ms=4, color="k", zorder=6)
            wide = 0.75 * max(np.ptp(climb.walker.hips_m[:, 1]), np.ptp(climb.walker.hips_m[:, 0])) + size
            axes.set_xlim(here.position_m[view[0]] - wide, here.position_m[view[0]] + wide)
            if view == (0, 1):
                axes.set_ylim(here.position_m[1] - wide, here.position_m[1] + wide)
            else:
                axes.set_ylim(-0.05 * wide, here.position_m[2] + 1.1 * size)
            axes.set_aspect("equal")
            axes.set_xlabel(f"{names[0]} (m)")
            axes.set_ylabel(f"{names[1]} (m)")
        panels[0].set_title("darker: more energy;  grey: force on the torso", fontsize=SMALL, pad=4)
        turns = np.linspace(-_AROUND_RAD, _AROUND_RAD, _GRID)
        step = np.zeros((_GRID, 6))
        step[:, 3] = turns
        energy = evaluate(stand, here.moved(step))[0]
        pitch = np.degrees(climb.pitch_rad[frame] + turns)
        panels[2].plot(pitch, 1000 * (energy - energy.min()), color="k")
        panels[2].plot(pitch[_GRID // 2], 1000 * (energy[_GRID // 2] - energy.min()), "o", ms=4, color="k")
        panels[2].set_xlabel("pitch, nose up (deg)")
        panels[2].set_ylabel("energy above the least (1/1000)")
        _sides(figure)
    return figure


def _leg_forces(axes: Axes, climb: Climb, frame: int, view: tuple[int, int], size: float) -> None:
    rotation = climb.rotation[frame]
    r = leg_vectors(Torso(climb.position_m[frame], rotation), climb.walker.hips_m, climb.feet_m[frame])
    forces = leg_forces(climb.stand(frame), r).sum(axis=0) @ rotation.T
    hips = climb.position_m[frame] + climb.walker.hips_m @ rotation.T
    ways = forces / np.linalg.norm(forces, axis=1).max() * size
    colours = [RIGHT if side > 0 else LEFT for side in climb.walker.side]
    i, j = view
    axes.quiver(
        hips[:, i],
        hips[:, j],
        ways[:, i],
        ways[:, j],
        color=colours,
        angles="xy",
        scale_units="xy",
        scale=1,
        width=0.012,
        zorder=5,
    )


def _robot(axes: Axes, climb: Climb, frame: int, view: tuple[int, int]) -> None:
    """Legs, torso and ground."""
    _, _, hips, knees = climb.posture
    i, j = view
    step, ends = climb.recipe.step, climb.feet_m[..., 1]
    first, last = float(ends.min()) - 0.05, float(ends.max()) + 0.05
    if view == (1, 2):
        axes.plot([first, step.edge_m, step.edge_m, last], [0, 0, step.height_m, step.height_m], color=GREY, lw=1)
    else:
        axes.axhline(step.edge_m, color=GREY, lw=1)
    for leg in range(4):
        chain = np.array([hips[frame, leg], knees[frame, leg], climb.feet_m[frame, leg]])
        colour = RIGHT if climb.walker.side[leg] > 0 else LEFT
        dashed = (0, (2, 1)) if climb.lifted[frame] == leg else "-"
        axes.plot(chain[:, i], chain[:, j], marker="o", ms=2, color=colour, ls=dashed)
    outline = hips[frame, [*AROUND, AROUND[0]]]
    axes.plot(outline[:, i], outline[:, j], color=TORSO, lw=2)


def _sides(figure: Figure) -> None:
    from matplotlib.lines import Line2D

    lines = [Line2D([], [], color=colour) for colour in (LEFT, RIGHT)]
    lines.append(Line2D([], [], color=PALE, ls=(0, (2, 1))))
    add_legend(figure, lines, ["left legs", "right legs", "foot that is up"])


def _title(climb: Climb) -> str:
    return f"{climb.walker.robot.name}, step of {1000 * climb.recipe.step.height_m:.0f} mm"
