"""What the optimiser did: cost, optimality and steps over time, errors in the picture, gradient and Jacobian."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from recon.base.arrays import Array, mean
from recon.show.plots.style import (
    GREY,
    MOST_DOTS,
    PAGE_MM,
    PALE,
    SMALL,
    add_legend,
    blank,
    dots,
    drawing,
    legend_shape,
    look,
    plain_logarithm,
)
from recon.thesis.frame import FrameSearch
from recon.thesis.solver import CAMERA_ANGLES, SolverRecord, frame_solution, named_unknowns, trajectory_solution

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_LEAST = 1e-12
"""The least value that is drawn on a logarithmic axis."""
_DECADES = 1e-6
"""The least of a logarithmic axis, of its most: what is less hardly matters."""
_UNDAMPED = 1e-8
"""Below it a step is Gauss and Newton's."""
EXIT_FLAGS = {
    0: "evaluations used up",
    1: "gradient small",
    2: "cost settled",
    3: "step small",
    4: "cost and step settled",
}
"""The words for the exit flags of scipy's `least_squares`."""
NAMES = {"base_length_m": "base length (m)", "size": "size"}


def solver_search(record: SolverRecord) -> Figure:
    """Over time: cost by term, the largest part of the gradient, the steps' length, iterations and limits passed."""
    time_s, cost = record.motion.time_s, record.problem.cost
    step = "last step (rad, m)" if record.motion.jitters else "next step (rad, m)"
    panels = [("cost", "cost (½σ²)"), ("optimality", "max |gradient|"), ("step", step)]
    if record.motion.jitters:
        panels.append(("iterations", "iterations"))
    if record.limits:
        panels.append(("limits", "limits passed"))
    names = [name if np.nansum(of_term) > 0 else f"{name}: 0" for name, of_term in cost.items()]
    with drawing(48 + 27 * (len(panels) - 1) + 14 + legend_shape(names)[1], title=_outcome(record)) as figure:
        shares = [1.8] + [1.0] * (len(panels) - 1)
        rows = figure.subplots(len(panels), 1, sharex=True, squeeze=False, height_ratios=shares)[:, 0]
        for axes, (name, label) in zip(rows, panels, strict=True):
            axes.set_ylabel(label)
            if name == "cost":
                _logarithmic(axes, time_s, [*cost.values()])
            elif name in ("optimality", "step"):
                _logarithmic(axes, time_s, [record.optimality if name == "optimality" else record.step_norm])
            elif name == "iterations":
                axes.bar(time_s, record.of_frames("iterations"), 0.7 / record.motion.fps, color=look(0)["color"])
            else:
                for i, (limit, count) in enumerate(record.active.items()):
                    axes.step(time_s, count, where="mid", label=limit, **look(i))
                axes.set_ylim(0, 1.6 * max(1.0, *(count.max() for count in record.active.values())))
                axes.yaxis.get_major_locator().set_params(integer=True)
                axes.legend(loc="upper right", ncols=2)
        rows[-1].set_xlabel("time (s)")
        figure.align_ylabels()
        add_legend(figure, rows[0].lines, names)
    return figure


def solver_root(record: SolverRecord) -> Figure:
    """The root's rotation and the base length, or the size, over time."""
    shown = {f"{name} (°)": (np.degrees(values), 2.0) for name, values in record.rotation_rad.items()}
    shown |= {NAMES[name]: (values, 0.02) for name, values in record.length.items()}
    with drawing(24 * len(shown) + 14) as figure:
        rows = figure.subplots(len(shown), 1, sharex=True)
        for axes, (label, (values, least)) in zip(rows, shown.items(), strict=True):
            axes.plot(record.motion.time_s, values, **dots(len(values), 2.2), **look(0))
            axes.set_ylabel(label)
            axes.ticklabel_format(useOffset=False)
            axes.margins(y=0.15)
            low, high = axes.get_ylim()
            if high - low < least:  # what does not move should not look as if it did
                axes.set_ylim((low + high - least) / 2, (low + high + least) / 2)
        figure.align_ylabels()
        rows[-1].set_xlabel("time (s)")
    return figure


def image_errors(record: SolverRecord) -> Figure:
    """Distances of detections from reprojections, joints x frames, one panel for each camera; white: not detected."""
    errors, names = record.image_error_px, record.motion.names
    frames = record.motion.frames
    known = np.concatenate([one[np.isfinite(one)] for one in errors.values()])
    top = max(float(np.max(known, initial=0.0)), 10.0)
    height = min(4.0 * len(names) + 8, PAGE_MM - 20)
    with drawing(height * len(errors) + 14) as figure:
        import matplotlib as mpl
        from matplotlib.colors import LogNorm

        panels = figure.subplots(len(errors), 1, squeeze=False)[:, 0]
        for axes, (camera, values) in zip(panels, errors.items(), strict=True):
            edges = np.append(frames, frames[-1] + 1) - 0.5
            image = axes.pcolormesh(
                edges,
                np.arange(len(names) + 1) - 0.5,
                values,
                cmap=mpl.colormaps["viridis"],
                norm=LogNorm(0.5, top),
                rasterized=len(frames) > MOST_DOTS,  # as lines, thousands of cells take seconds and megabytes
            )
            axes.set_yticks(range(len(names)), names)
            axes.set_ylim(len(names) - 0.5, -0.5)
            axes.tick_params(axis="y", length=0)
            axes.set_title(f"{camera}: mean {mean(values):.1f} px", loc="left")
            bar = figure.colorbar(image, ax=axes, label="error in the picture (px)", extend="min", aspect=40, pad=0.01)
            plain_logarithm(bar.ax.yaxis)
        panels[-1].set_xlabel("frame")
    return figure


def solver_unknowns(record: SolverRecord) -> Figure:
    """A figure of every unknown: parts of the gradient, and norms of the Jacobian's columns, over the frames."""
    names, problem = record.problem.unknowns, record.problem
    says = "dots: median of the frames, lines: from the least to the most"
    with drawing(min(4.0 * len(names) + 20, PAGE_MM), title=says) as figure:
        panels = figure.subplots(1, 2, sharey=True)
        given = (np.abs(problem.gradient), "|gradient|"), (problem.column_norm, "norm of the Jacobian's column")
        for axes, (values, label) in zip(panels, given, strict=True):
            known = values[problem.solved]
            axes.set_xlabel(label)
            if not len(known):
                blank(axes)
                continue
            low, middle, high = (np.maximum(f(known, axis=0), _LEAST) for f in (np.min, np.median, np.max))
            at = np.arange(len(names))
            axes.hlines(at, low, high, color=GREY, lw=1.0)
            axes.plot(middle, at, "o", ms=3.5, color=look(0)["color"], label="median of the frames")
            axes.set_xscale("log")
            axes.set_xlim(left=max(axes.get_xlim()[0], _DECADES * float(high.max())))
            plain_logarithm(axes.xaxis)
            axes.tick_params(axis="y", length=0)
            axes.grid(color=PALE, lw=0.4)
            axes.set_axisbelow(True)
        panels[0].set_yticks(range(len(names)), names, fontsize=SMALL)
        panels[0].set_ylim(len(names) - 0.5, -0.5)
    return figure


def solver_evaluations(record: SolverRecord) -> Figure:
    """How often the residuals were evaluated in each frame, coloured by why MINPACK ended."""
    flags, spent = record.of_frames("optimizer_status"), record.of_frames("function_evaluations")
    ended, time_s = [int(flag) for flag in np.unique(flags[np.isfinite(flags)])], record.motion.time_s
    with drawing(52, title=_outcome(record)) as figure:
        axes = figure.subplots()
        bars = [
            axes.bar(time_s[flags == flag], spent[flags == flag], 0.7 / record.motion.fps, color=look(i)["color"])
            for i, flag in enumerate(ended)
        ]
        axes.set_ylabel("evaluations")
        axes.set_xlabel("time (s)")
        add_legend(figure, bars, [f"{flag}: {EXIT_FLAGS.get(flag, 'ended otherwise')}" for flag in ended])
    return figure


def solver_frame(record: SolverRecord) -> Figure:
    """Within the frame that is looked into: objective and damping from one accepted point to the next."""
    search, frame = _looked_into(record)
    title = f"frame {frame}: {len(search.damping)} steps, {search.evaluations[-1]} evaluations"
    with drawing(80, title=title) as figure:
        above, below = figure.subplots(2, 1, sharex=True)
        above.plot(np.arange(len(search.cost)), search.cost, **dots(len(search.cost), 3.0), **look(0))
        above.set_ylabel("objective (½σ²)")
        damping = np.maximum(search.damping, _UNDAMPED)
        below.plot(np.arange(len(damping)), damping, **dots(len(damping), 3.0), **look(1))
        below.set_ylabel(f"damping λ ({_UNDAMPED:g}: none)")
        below.set_xlabel("accepted point")
        for axes in (above, below):
            axes.set_yscale("log")
            plain_logarithm(axes.yaxis)
            axes.xaxis.get_major_locator().set_params(integer=True)
        figure.align_ylabels()
    return figure


def solver_matrices(record: SolverRecord) -> Figure:
    """A figure of the frame that is looked into: the Jacobian at its minimum, residuals x unknowns, and J'J; white is
    zero."""
    from matplotlib.colors import LogNorm

    (search, frame), names = _looked_into(record), record.problem.unknowns
    counts = np.array([*search.rows.values()])
    with drawing(140, title=f"frame {frame}, at the minimum") as figure:
        panels = figure.subplots(1, 2)
        J = search.jacobian
        for axes, (matrix, label) in zip(panels, ((J, "|J|"), (J.T @ J, "|J'J|")), strict=True):
            size = np.where(matrix == 0, np.nan, np.abs(matrix))
            most = float(np.nanmax(size, initial=1.0))
            image = axes.imshow(size, aspect="auto", norm=LogNorm(_DECADES * most, most), interpolation="none")
            axes.set_xticks(range(len(names)), names, rotation=90, fontsize=SMALL)
            axes.tick_params(length=0)
            bar = figure.colorbar(image, ax=axes, label=label, extend="min", aspect=40, pad=0.02)
            plain_logarithm(bar.ax.yaxis)
        panels[0].set_yticks(np.cumsum(counts) - counts / 2 - 0.5, [*search.rows], fontsize=SMALL)
        panels[1].set_yticks(range(len(names)), names, fontsize=SMALL)
    return figure


def solver_rotation(record: SolverRecord) -> Figure:
    """The camera's rotation held still beside free: its angles, and the mean error in the picture, over time."""
    assert record.otherwise is not None
    solutions = frame_solution(record.motion), record.otherwise
    (view,) = record.otherwise.views
    labels = (*(f"{name} (°)" for name in CAMERA_ANGLES), "error (px)")
    names = []
    with drawing(24 * len(labels) + 20) as figure:
        rows = figure.subplots(len(labels), 1, sharex=True)
        for i, (solution, which) in enumerate(zip(solutions, ("as fitted", "otherwise"), strict=True)):
            off_px = np.linalg.norm(view.xy_px - view.project(solution.joints_m)[0], axis=2)
            angles = [np.degrees(angle) for angle in named_unknowns(solution, *CAMERA_ANGLES).values()]
            still = max(float(np.nanmax(angle) - np.nanmin(angle)) for angle in angles) < _LEAST
            names.append(f"{which}: {'held still' if still else 'free'}")
            curves = (*angles, np.array([mean(of_frame) for of_frame in off_px]))
            for axes, label, values in zip(rows, labels, curves, strict=True):
                axes.plot(record.motion.time_s, values, **dots(len(values), 2.2), **look(i))
                axes.set_ylabel(label)
        rows[-1].set_xlabel("time (s)")
        figure.align_ylabels()
        add_legend(figure, rows[0].lines, names)
    return figure


def _looked_into(record: SolverRecord) -> tuple[FrameSearch, int]:
    """And its frame's number."""
    assert record.search is not None
    return record.search, int(record.motion.frames[record.search.frame])


def _logarithmic(axes: Axes, time_s: Array, curves: Sequence[Array]) -> None:
    for i, values in enumerate(curves):
        axes.plot(time_s, np.where(values > _LEAST, values, np.nan), **dots(len(time_s), 2.2), **look(i))
    axes.set_yscale("log")
    low, high = axes.get_ylim()
    axes.set_ylim(max(low, _DECADES * high), high)
    plain_logarithm(axes.yaxis)


def _outcome(record: SolverRecord) -> str:
    if record.motion.jitters:
        status = frame_solution(record.motion).status
        return f"{status.count('converged')} of {len(status)} frames converged, each solved by itself"
    found = trajectory_solution(record.motion)
    status = found.status.replace("_", " ")
    return f"all frames at once: {status}, {found.iterations} iterations from {found.starts} starts"
