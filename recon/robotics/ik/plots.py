"""Figures of inverse kinematics: ways to a target or along a path, degrees of closure, fitted parameters, by method."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
import pandas as pd

from recon.base.arrays import Array
from recon.robotics.ik.chain import SerialChain
from recon.robotics.ik.drive import TOLERANCE_M, Run
from recon.robotics.ik.fit import PARAMETERS
from recon.show.plots.style import (
    COLOURS,
    GREY,
    MARKERS,
    PALE,
    SMALL,
    WIDTH_MM,
    add_legend,
    drawing,
    grid_shape,
    legend_shape,
    look,
    plain_logarithm,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


VIEWS = {
    "UVW": (("side", 0, 1, "forwards (m)", "down (m)"), ("top", 0, 2, "forwards (m)", "to the left (m)")),
    "xyz": (("side", 0, 2, "forwards (m)", "up (m)"), ("top", 0, 1, "forwards (m)", "to the left (m)")),
}
"""The views of the base frames of `recon.robotics.ik.animal`: name, coordinates, and what the axes are called."""
_ROOM = 0.06
_NONE_MM = 0.001
"""From a path: nothing."""


def task_space(
    moves: Mapping[str, Run],
    chain: SerialChain,
    target_m: Array | None = None,
    path_m: Array | None = None,
    base: Literal["UVW", "xyz"] = "UVW",
) -> Figure:
    """The end effector's paths by method: in the plane, or in space from the side and from above, with the chain as it
    stood at first and, of every method, at last.

    target_m (dim,) is a cross, path_m (K, dim) the way that was to be followed. base: what the coordinates mean,
    forwards, down and left or forwards, left and up; two are U and V.
    """
    from matplotlib.lines import Line2D

    labels, first = [f"{name}{_outcome(move)}" for name, move in moves.items()], next(iter(moves.values()))
    begins = {"marker": "o", "mfc": "w", "mec": "k", "ms": 5, "linestyle": ""}
    aim = {"marker": "+", "color": "k", "ms": 10, "mew": 1.2, "linestyle": ""}
    stood = {"color": GREY, "lw": 2.2, "alpha": 0.5, "marker": "o", "ms": 2}
    marks = [Line2D([], [], label="start", **begins), Line2D([], [], label="chain at the start", **stood)]
    if target_m is not None:
        marks.append(Line2D([], [], label="target", **aim))
    if path_m is not None:
        marks.append(Line2D([], [], label="path to follow", color=PALE, lw=3.5))
    with drawing(92 + legend_shape([*labels, *(str(mark.get_label()) for mark in marks)])[1]) as figure:
        views = VIEWS[base][: chain.dim - 1]
        panels = np.ravel(figure.subplots(1, len(views), squeeze=False))
        for axes, (view, i, j, across, upwards) in zip(panels, views, strict=True):
            axes.plot(*chain.positions(first.q[0])[:, [i, j]].T, **stood, zorder=1)
            if path_m is not None:
                axes.plot(path_m[:, i], path_m[:, j], color=PALE, lw=3.5, zorder=1, gid="path")
            for k, move in enumerate(moves.values()):
                style = look(k)
                last = chain.positions(move.q[-1])[:, [i, j]]
                axes.plot(*last.T, **style, marker="o", ms=2, lw=0.7, alpha=0.8, zorder=2)
                axes.plot(move.end_m[:, i], move.end_m[:, j], **style, zorder=3, label=labels[k])
                axes.plot(*move.end_m[-1, [i, j]], "o", ms=3.5, color=style["color"], zorder=4)
            axes.plot(*first.end_m[0, [i, j]], **begins, zorder=5)
            if target_m is not None:
                axes.plot(*np.asarray(target_m)[[i, j]], **aim, zorder=5, gid="target")
            axes.set_xlabel(across)
            axes.set_ylabel(upwards)
            axes.set_aspect("equal", adjustable="datalim")
            axes.margins(_ROOM)
            if upwards.startswith("down"):
                axes.invert_yaxis()
            if chain.dim == 3:
                axes.set_title(view, loc="left", fontsize=SMALL, color=GREY)
        handles, _ = panels[0].get_legend_handles_labels()
        add_legend(figure, [*handles, *marks], [*labels, *(str(mark.get_label()) for mark in marks)])
    return figure


def joint_space(moves: Mapping[str, Run], names: Sequence[str]) -> Figure:
    """Each joint's angle (deg) by method, over the iterations to a target or the time along a path. names (n,)."""
    n, driven = len(names), any(move.driven for move in moves.values())
    least, aspect = (3, 0.62) if n <= 6 else (5, 0.9)
    rows, columns = grid_shape(n, WIDTH_MM, aspect, least)
    labels = [f"{name}{_outcome(move)}" for name, move in moves.items()]
    with drawing(rows * aspect * WIDTH_MM / columns + 14 + legend_shape(labels)[1]) as figure:
        panels = figure.subplots(rows, columns, sharex=True, squeeze=False).ravel()
        for joint, axes in enumerate(panels[:n]):
            for k, move in enumerate(moves.values()):
                along = np.arange(len(move.q)) if driven else move.time_s
                axes.plot(along, np.degrees(move.q[:, joint]), **look(k))
            axes.set_title(names[joint], fontsize=SMALL, pad=2)
            axes.locator_params(axis="y", nbins=4)
        for axes in panels[n:]:
            axes.set_axis_off()
        for axes in panels[max(0, n - columns) : n]:
            axes.set_xlabel("iteration" if driven else "time (s)")
            axes.tick_params(labelbottom=True)
        figure.supylabel("angle (deg)", fontsize=8)
        add_legend(figure, panels[0].get_lines(), labels)
    return figure


def distances(moves: Mapping[str, Run]) -> Figure:
    """Distance (mm) to the target over the iterations, by method; a ring where it was reached, a cross where not. Or
    from the path over its points."""
    from matplotlib.ticker import MaxNLocator

    labels = [f"{name}: {_figure(move)}{_outcome(move)}" for name, move in moves.items()]
    driven = any(move.driven for move in moves.values())
    with drawing(72 + legend_shape(labels)[1]) as figure:
        axes, handles = figure.subplots(), []
        for k, move in enumerate(moves.values()):
            style, distance_mm = look(k), 1000 * move.distance_m
            handles += axes.plot(distance_mm, **style)
            if driven:
                end = {"marker": "o", "mfc": "w", "ms": 5} if move.reached else {"marker": "X", "ms": 7}
                axes.plot(move.iterations, distance_mm[-1], **end, color=style["color"], mec=style["color"], zorder=4)
        axes.set_yscale("log", nonpositive="clip")
        if driven:
            axes.axhline(1000 * TOLERANCE_M, color=GREY, lw=0.8, zorder=1, gid="tolerance")
            axes.annotate(
                f"{1000 * TOLERANCE_M:g} mm",
                (0, 1000 * TOLERANCE_M),
                (2, 2),
                xycoords=("axes fraction", "data"),
                textcoords="offset points",
                fontsize=SMALL,
                color=GREY,
            )
        else:
            axes.set_ylim(bottom=_NONE_MM)
        axes.set_xlabel("iteration" if driven else "point of the path")
        axes.set_ylabel(f"distance {'to the target' if driven else 'from the path'} (mm)")
        axes.xaxis.set_major_locator(MaxNLocator("auto", integer=True, steps=[1, 2, 5, 10]))
        axes.yaxis.set_major_formatter("{x:g}")
        add_legend(figure, handles, labels)
    return figure


def _figure(move: Run) -> str:
    return str(move.iterations) if move.driven else f"{1000 * float(np.max(move.distance_m)):.3g} mm"


def _outcome(move: Run) -> str:
    """What did not go as it should, in a few words."""
    if not move.note:
        return ""
    what = move.note.split(":")[0].split(" (")[0]
    return f" (not reached, {what})" if move.driven else f" ({what})"


# -- closures and parameters ------------------------------------------------------------------------------------------

_ROW = 0.7
"""The height of a joint's row, all methods together."""


def closures(found: Mapping[str, Mapping[str, Array]], names: Sequence[str]) -> Figure:
    """Closure of each joint's path (percent) by method, as `Run.closures` gives it: of the angle, and in the
    (angle, rate) plane. names (n,).

    A joint that does not move has no closure and no mark.
    """
    n = len(names)
    with drawing(max(6.0, 1.5 * len(found)) * n + 20 + legend_shape([*found])[1]) as figure:
        panels = figure.subplots(1, 2, sharey=True)
        for axes, kind in zip(panels, ("angle", "plane"), strict=True):
            for k, (name, values) in enumerate(found.items()):
                rows = np.arange(n) + _ROW * ((k + 0.5) / len(found) - 0.5)
                colour = COLOURS[k % len(COLOURS)]
                axes.plot(
                    values[kind],
                    rows,
                    linestyle="",
                    marker=MARKERS[k % len(MARKERS)],
                    color=colour,
                    mfc=colour if k < len(COLOURS) else "w",
                    ms=4,
                    label=name,
                    clip_on=False,
                )
            for row in np.flatnonzero(~np.isfinite([values[kind] for values in found.values()]).any(axis=0)):
                axes.text(1.5, row, "does not move", va="center", fontsize=SMALL, color=GREY)
            for row in range(1, n):
                axes.axhline(row - 0.5, color=PALE, lw=0.5, zorder=0)
            axes.set_xlim(0, 100)
            axes.grid(axis="x", color=PALE, lw=0.4)
            axes.set_axisbelow(True)
            axes.set_xlabel("of the angle (%)" if kind == "angle" else "in the (angle, rate) plane (%)")
        panels[0].set_yticks(range(n), names)
        panels[0].set_ylim(n - 0.5, -0.5)
        add_legend(figure, *panels[0].get_legend_handles_labels())
    return figure


def parameter_series(table: pd.DataFrame) -> Figure:
    """Over the times of a stride, of a table of `fit_parameter_series`: the share of the joint rates that each method
    explains, the factor alpha with which it would explain the most, and the parameters that are found, of the weights
    one for each joint."""
    time_s = table["time_s"].to_numpy()
    columns = [str(column) for column in table]
    names = [column.removesuffix("_explained") for column in columns if column.endswith("_explained")]
    weights = [c for c in columns if c.startswith("weighted_") and not c.endswith(("_explained", "_alpha"))]
    joints = [column.removeprefix("weighted_") for column in weights]
    single = [name for name in PARAMETERS if name in names]
    rows = 1 + -(-len(single) // 2)
    with drawing(38 * (rows + bool(joints)) + 18 + legend_shape(names)[1] + legend_shape(joints)[1]) as figure:
        parts: Any = figure.subfigures(2, 1, height_ratios=(rows, 1.15)) if joints else (figure, None)
        upper, lower = parts
        panels = np.ravel(upper.subplots(rows, 2, sharex=True, squeeze=False))
        for k, name in enumerate(names):
            panels[0].plot(time_s, 100 * table[f"{name}_explained"], **look(k), label=name)
            panels[1].plot(time_s, table[f"{name}_best_alpha"], **look(k))
            if name in PARAMETERS:
                axes, (column, label) = panels[2 + single.index(name)], PARAMETERS[name]
                values = table[f"{name}_{column}"].to_numpy()
                axes.plot(time_s, values, **look(k), marker="o", ms=2)
                if name.endswith("damped"):
                    _logarithmic(axes, values)
                axes.set_title(label, loc="left", fontsize=SMALL, color=GREY)
        panels[0].set_title("explained of the joint rates (%)", loc="left", fontsize=SMALL, color=GREY)
        panels[0].set_ylim(0, 105)
        panels[1].set_title("best factor alpha on the rates", loc="left", fontsize=SMALL, color=GREY)
        for axes in panels[2 + len(single) :]:
            axes.set_axis_off()
        for axes in panels[2 * (rows - 1) :]:
            axes.set_xlabel("time (s)")
        add_legend(upper, *panels[0].get_legend_handles_labels())
        if lower is not None:
            _weights(lower.subplots(), time_s, table[weights].to_numpy())
            add_legend(lower, lower.axes[0].get_lines(), joints)
    return figure


def _weights(axes: Axes, time_s: Array, weights: Array) -> None:
    for k, of_joint in enumerate(weights.T):
        axes.plot(time_s, of_joint, **look(k))
    _logarithmic(axes, weights)
    axes.set_xlabel("time (s)")
    axes.set_title("weights, mean 1; large: a joint that is spared", loc="left", fontsize=SMALL, color=GREY)


def _logarithmic(axes: Axes, values: Array) -> None:
    """Without powers in the ticks, and no axis within less than a power of ten."""
    axes.set_yscale("log")
    axes.set_ylim(values.min() / 3, values.max() * 4)
    plain_logarithm(axes.yaxis)
