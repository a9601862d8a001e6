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
    dots,
    drawing,
    legend_shape,
    look,
    plain_logarithm,
)
from recon.thesis.frame import CAMERA_ANGLES
from recon.thesis.solver import SolverRecord

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_LEAST = 1e-12
"""The least that is drawn on a logarithmic axis."""
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
"""What the status of scipy's `least_squares` means."""


def solver_search(record: SolverRecord) -> Figure:
    """Over time: cost by term, the largest part of the gradient, the steps' length, how often the residuals were
    evaluated, coloured by why MINPACK ended, and limits passed."""
    time_s, names = record.motion.time_s, [n if np.nansum(c) > 0 else f"{n}: 0" for n, c in record.cost.items()]
    with drawing(170 + legend_shape(names)[1], title=_outcome(record)) as figure:
        rows = figure.subplots(5, 1, sharex=True, height_ratios=(1.8, 1, 1, 1, 1))
        cost, optimality, step, evaluations, limits = rows
        _logarithmic(cost, time_s, [*record.cost.values()])
        _logarithmic(optimality, time_s, [record.optimality])
        _logarithmic(step, time_s, [record.solution.reported("step_norm")])
        flags, spent = (record.solution.reported(name) for name in ("optimizer_status", "function_evaluations"))
        for i, flag in enumerate(np.unique(flags[np.isfinite(flags)]).astype(int).tolist()):
            ended, style = flags == flag, {"color": look(i)["color"], "label": f"{flag}: {EXIT_FLAGS[flag]}"}
            evaluations.bar(time_s[ended], spent[ended], 0.7 / record.motion.fps, **style)
        evaluations.margins(y=0.6)
        evaluations.legend(loc="upper right", ncols=3)
        for i, (limit, count) in enumerate(record.active.items()):
            limits.step(time_s, count, where="mid", label=limit, **look(i))
        limits.set_ylim(0, 1.6 * max(1.0, *(count.max() for count in record.active.values())))
        limits.yaxis.get_major_locator().set_params(integer=True)
        limits.legend(loc="upper right", ncols=2)
        labels = ("cost (½σ²)", "max |gradient|", "last step (rad, m)", "evaluations", "limits passed")
        _over_time(figure, rows, labels)
        add_legend(figure, cost.lines, names)
    return figure


def image_errors(record: SolverRecord) -> Figure:
    """Distances of detections from reprojections, joints x frames; white: not detected."""
    from matplotlib.colors import LogNorm

    names, frames, values = record.motion.names, record.motion.frames, record.image_error_px.T
    with drawing(min(4.0 * len(names) + 8, PAGE_MM - 20) + 14) as figure:
        axes = figure.subplots()
        image = axes.pcolormesh(
            np.append(frames, frames[-1] + 1) - 0.5,
            np.arange(len(names) + 1) - 0.5,
            values,
            norm=LogNorm(0.5, max(float(np.nanmax(values, initial=0.0)), 10.0)),
            rasterized=len(frames) > MOST_DOTS,  # as lines, thousands of cells take seconds and megabytes
        )
        axes.set_yticks(range(len(names)), names)
        axes.set_ylim(len(names) - 0.5, -0.5)
        axes.tick_params(axis="y", length=0)
        axes.set_title(f"{record.motion.pictures[0].name}: mean {mean(values):.1f} px", loc="left")
        bar = figure.colorbar(image, ax=axes, label="error in the picture (px)", extend="min", aspect=40, pad=0.01)
        plain_logarithm(bar.ax.yaxis)
        axes.set_xlabel("frame")
    return figure


def solver_unknowns(record: SolverRecord) -> Figure:
    """Parts of the gradient by every unknown, and norms of the Jacobian's columns, over the frames."""
    names = record.unknowns
    says = "dots: median of the frames, lines: from the least to the most"
    with drawing(min(4.0 * len(names) + 20, PAGE_MM), title=says) as figure:
        panels = figure.subplots(1, 2, sharey=True)
        given = (np.abs(record.gradient), "|gradient|"), (record.column_norm, "norm of the Jacobian's column")
        for axes, (values, label) in zip(panels, given, strict=True):
            known = values[record.solved]
            low, middle, high = (np.maximum(f(known, axis=0), _LEAST) for f in (np.min, np.median, np.max))
            at = np.arange(len(names))
            axes.hlines(at, low, high, color=GREY, lw=1.0)
            axes.plot(middle, at, "o", ms=3.5, color=look(0)["color"])
            axes.set_xscale("log")
            axes.set_xlim(left=max(axes.get_xlim()[0], _DECADES * float(high.max())))
            plain_logarithm(axes.xaxis)
            axes.set_xlabel(label)
            axes.tick_params(axis="y", length=0)
            axes.grid(color=PALE, lw=0.4)
            axes.set_axisbelow(True)
        panels[0].set_yticks(range(len(names)), names, fontsize=SMALL)
        panels[0].set_ylim(len(names) - 0.5, -0.5)
    return figure


def solver_frame(record: SolverRecord) -> Figure:
    """Within the frame that is looked into: objective and damping from one accepted point to the next."""
    search = record.search
    title = f"{_looked_into(record)}: {len(search.damping)} steps, {search.evaluations[-1]} evaluations"
    labels = ("objective (½σ²)", f"damping λ ({_UNDAMPED:g}: none)")
    with drawing(80, title=title) as figure:
        rows = figure.subplots(2, 1, sharex=True)
        for i, (axes, values) in enumerate(zip(rows, (search.cost, search.damping.clip(_UNDAMPED)), strict=True)):
            axes.plot(np.arange(len(values)), values, **dots(len(values), 3.0), **look(i))
            axes.set_yscale("log")
            plain_logarithm(axes.yaxis)
            axes.xaxis.get_major_locator().set_params(integer=True)
        _over_time(figure, rows, labels, "accepted point")
    return figure


def solver_matrices(record: SolverRecord) -> Figure:
    """The Jacobian of the frame that is looked into at its minimum, residuals x unknowns, and J'J; white is zero."""
    from matplotlib.colors import LogNorm

    search, names = record.search, record.unknowns
    counts = np.array([*search.rows.values()])
    with drawing(140, title=f"{_looked_into(record)}, at the minimum") as figure:
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
    """The camera's rotation held still beside free: its angles, the base length, and the mean error in the picture,
    over time."""
    (view,) = record.otherwise.views
    labels, names = (*(f"{name} (°)" for name in CAMERA_ANGLES), "base length (m)", "error (px)"), []
    with drawing(24 * len(labels) + 20) as figure:
        rows = figure.subplots(len(labels), 1, sharex=True)
        for i, (solution, which) in enumerate(((record.solution, "as fitted"), (record.otherwise, "otherwise"))):
            off_px = np.linalg.norm(view.xy_px - view.project(solution.joints_m)[0], axis=2)
            angles = [np.degrees(solution.unknown(name)) for name in CAMERA_ANGLES]
            still = max(float(np.nanmax(angle) - np.nanmin(angle)) for angle in angles) < _LEAST
            names.append(f"{which}: {'held still' if still else 'free'}")
            error_px = np.array([mean(of_frame) for of_frame in off_px])
            for axes, values in zip(rows, (*angles, solution.unknown("base_length_m"), error_px), strict=True):
                axes.plot(record.motion.time_s, values, **dots(len(values), 2.2), **look(i))
                axes.ticklabel_format(useOffset=False)
        low, high = rows[3].get_ylim()
        if high - low < 0.02:  # a length that does not move should not look as if it did
            rows[3].set_ylim((low + high) / 2 - 0.01, (low + high) / 2 + 0.01)
        _over_time(figure, rows, labels)
        add_legend(figure, rows[0].lines, names)
    return figure


FIGURES = (solver_search, solver_unknowns, image_errors, solver_frame, solver_matrices, solver_rotation)
"""What is drawn, each under its name."""


def _looked_into(record: SolverRecord) -> str:
    return f"frame {record.motion.frames[record.search.frame]}"


def _over_time(figure: Figure, rows: Sequence[Axes], labels: Sequence[str], across: str = "time (s)") -> None:
    for axes, label in zip(rows, labels, strict=True):
        axes.set_ylabel(label)
    rows[-1].set_xlabel(across)
    figure.align_ylabels()


def _logarithmic(axes: Axes, time_s: Array, curves: Sequence[Array]) -> None:
    for i, values in enumerate(curves):
        axes.plot(time_s, np.where(values > _LEAST, values, np.nan), **dots(len(time_s), 2.2), **look(i))
    axes.set_yscale("log")
    low, high = axes.get_ylim()
    axes.set_ylim(max(low, _DECADES * high), high)
    plain_logarithm(axes.yaxis)


def _outcome(record: SolverRecord) -> str:
    status = record.solution.status
    return f"{status.count('converged')} of {len(status)} frames converged, each solved by itself"
