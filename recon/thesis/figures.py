"""Draw figures of the frame method's optimisation (`recon.thesis.inspect`)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure
from matplotlib.image import AxesImage

from recon.base.arrays import Array, mean
from recon.show.plots import style
from recon.thesis.inspect import CAMERA_ANGLES, EXIT_FLAGS, PUBLISHED, SolverRecord

_MIN_DRAWN = 1e-12
"""Smallest value drawn on a logarithmic axis."""
_DECADES = 1e-6
"""Lower end of a logarithmic axis relative to its upper end."""
_CONFIGURATIONS = 12
"""Largest number of frames whose configurations are drawn."""
_UNDAMPED = 1e-8
"""Damping lambda below which a step counts as a Gauss-Newton step."""


def solver_search(record: SolverRecord) -> Figure:
    """Draw how the search for the pose went in each frame.

    The panels are the cost by term, the largest component of the gradient, the length of the last step, the evaluations
    of the residuals, coloured by MINPACK's exit flag, and the limits that were exceeded.
    """
    status = record.solution.status
    title = f"{status.count('converged')} of {len(status)} frames converged"
    time_s = record.motion.time_s
    names = [_term_label(str(name)) + ("" if cost.sum() > 0 else ": 0") for name, cost in record.cost.items()]
    with style.drawing(170 + style.legend_shape(names)[1], title=title) as figure:
        rows = figure.subplots(5, 1, sharex=True, height_ratios=(1.8, 1, 1, 1, 1))
        cost, optimality, step, evaluations, limits = rows
        _logarithmic(cost, time_s, [*record.cost.to_numpy().T])
        _logarithmic(optimality, time_s, [record.optimality])
        _logarithmic(step, time_s, [record.solution.reported("step_norm")])
        flags, counts = (record.solution.reported(name) for name in ("optimizer_status", "function_evaluations"))
        for i, flag in enumerate(np.unique(flags[np.isfinite(flags)]).astype(int).tolist()):
            frames, look = flags == flag, {"color": style.look(i)["color"], "label": f"{flag}: {EXIT_FLAGS[flag]}"}
            evaluations.bar(time_s[frames], counts[frames], 0.7 / record.motion.fps, **look)
        evaluations.margins(y=0.6)
        evaluations.legend(loc="upper right", ncols=3)
        for i, (limit, count) in enumerate(record.active.items()):
            limits.step(time_s, count, where="mid", label=limit, **style.look(i))
        limits.set_ylim(0, 1.6 * max(1.0, *(count.max() for count in record.active.values())))
        limits.yaxis.get_major_locator().set_params(integer=True)
        limits.legend(loc="upper right", ncols=2)
        labels = ("cost (½σ²)", "max |gradient|", "last step (rad, m)", "evaluations", "limits passed")
        _over_time(figure, rows, labels)
        style.add_legend(figure, cost.lines, names)
    return figure


def image_errors(record: SolverRecord) -> Figure:
    """Draw the reprojection errors as colours, with joints as rows, frames as columns, and missing points white."""
    names, frames, values = record.motion.names, record.motion.frames, record.image_error_px.T
    with style.drawing(min(4.0 * len(names) + 8, style.PAGE_MM - 20) + 14) as figure:
        axes = figure.subplots()
        largest = max(float(np.nanmax(values, initial=0.0)), 10.0)
        image = _logarithmic_image(figure, axes, values, 0.5, largest, "reprojection error (px)")
        image.set_extent((frames[0] - 0.5, frames[-1] + 0.5, len(names) - 0.5, -0.5))
        axes.set_yticks(range(len(names)), names)
        axes.tick_params(axis="y", length=0)
        axes.set_title(f"{record.motion.pictures[0].name}: mean {mean(values):.1f} px", loc="left")
        axes.set_xlabel("frame")
    return figure


def solver_unknowns(record: SolverRecord) -> Figure:
    """Draw each unknown's gradient, and the norm of its column of the Jacobian, as medians and ranges."""
    names = record.unknowns
    title = "dots: median over the frames, lines: minimum to maximum"
    with style.drawing(min(4.0 * len(names) + 20, style.PAGE_MM), title=title) as figure:
        panels = figure.subplots(1, 2, sharey=True)
        shown = (np.abs(record.gradient), "|gradient|"), (record.column_norm, "norm of the Jacobian's column")
        for axes, (values, label) in zip(panels, shown, strict=True):
            solved = values[record.motion.solved]
            low, middle, high = (np.maximum(f(solved, axis=0), _MIN_DRAWN) for f in (np.min, np.median, np.max))
            rows = np.arange(len(names))
            axes.hlines(rows, low, high, color=style.GREY, lw=1.0)
            axes.plot(middle, rows, "o", ms=3.5, color=style.look(0)["color"])
            axes.set_xscale("log")
            axes.set_xlim(left=max(axes.get_xlim()[0], _DECADES * float(high.max())))
            style.plain_logarithm(axes.xaxis)
            axes.set_xlabel(label)
            axes.tick_params(axis="y", length=0)
            axes.grid(color=style.PALE, lw=0.4)
            axes.set_axisbelow(True)
        panels[0].set_yticks(range(len(names)), names, fontsize=style.SMALL)
        panels[0].set_ylim(len(names) - 0.5, -0.5)
    return figure


def solver_frame(record: SolverRecord) -> Figure:
    """Draw the objective, the damping and the step at each accepted point of the search in one frame.

    The damping is left out if every step is a Gauss-Newton step.
    """
    search = record.search
    title = f"frame {record.frame}: {len(search.damping)} steps, {search.evaluations_at[-1]} evaluations"
    shown = {"objective (½σ²)": search.costs, "step (rad, m)": search.step_norms.clip(_MIN_DRAWN)}
    if (search.damping > _UNDAMPED).any():
        shown[f"damping λ\n({_UNDAMPED:g}: none)"] = search.damping.clip(_UNDAMPED)
    else:
        title += ", no damping"
    with style.drawing(20 + 30 * len(shown), title=title) as figure:
        rows = figure.subplots(len(shown), 1, sharex=True)
        for i, (axes, values) in enumerate(zip(rows, shown.values(), strict=True)):
            axes.plot(np.arange(len(values)), values, **style.dots(len(values), 3.0), **style.look(i))
            axes.set_yscale("log")
            style.plain_logarithm(axes.yaxis)
            axes.xaxis.get_major_locator().set_params(integer=True)
        _over_time(figure, rows, [*shown], "accepted point")
    return figure


def solver_matrices(record: SolverRecord) -> Figure:
    """Draw the Jacobian J of one frame's residuals at the minimum, and J'J, with zeros in white."""
    search, names = record.search, record.unknowns
    parts = search.problem.by_term(search.x)
    counts, J = np.array([len(r) for r, _ in parts.values()]), np.concatenate([J for _, J in parts.values()])
    with style.drawing(140, title=f"frame {record.frame}, at the minimum") as figure:
        panels = figure.subplots(1, 2)
        for axes, (matrix, label) in zip(panels, ((J, "|J|"), (J.T @ J, "|J'J|")), strict=True):
            size = np.where(matrix == 0, np.nan, np.abs(matrix))
            largest = float(np.nanmax(size, initial=1.0))
            _logarithmic_image(figure, axes, size, _DECADES * largest, largest, label)
            axes.set_xticks(range(len(names)), names, rotation=90, fontsize=style.SMALL)
            axes.tick_params(length=0)
        labels = [_term_label(name) for name in parts]
        panels[0].set_yticks(np.cumsum(counts) - counts / 2 - 0.5, labels, fontsize=style.SMALL)
        panels[1].set_yticks(range(len(names)), names, fontsize=style.SMALL)
    return figure


def solver_rotation(record: SolverRecord) -> Figure:
    """Draw the camera's angles, the base length and the reprojection error, with an estimated and a fixed rotation."""
    (view,) = record.other_solution.views
    labels, names = (*(f"{name} (°)" for name in CAMERA_ANGLES), "base length (m)", "error (px)"), []
    with style.drawing(24 * len(labels) + 20) as figure:
        rows = figure.subplots(len(labels), 1, sharex=True)
        solutions = (record.solution, "as fitted"), (record.other_solution, "otherwise")
        for i, (solution, label) in enumerate(solutions):
            distance_px = np.linalg.norm(view.xy_px - view.project(solution.joints_m)[0], axis=2)
            angles = [np.degrees(solution.unknown(name)) for name in CAMERA_ANGLES]
            is_fixed = max(float(np.nanmax(angle) - np.nanmin(angle)) for angle in angles) < _MIN_DRAWN
            names.append(f"{label}: {'fixed' if is_fixed else 'free'}")
            error_px = np.array([mean(frame_px) for frame_px in distance_px])
            for axes, values in zip(rows, (*angles, solution.unknown("base_length_m"), error_px), strict=True):
                axes.plot(record.motion.time_s, values, **style.dots(len(values), 2.2), **style.look(i))
                axes.ticklabel_format(useOffset=False)
        low, high = rows[3].get_ylim()
        if high - low < 0.02:  # a constant length should not look as if it varied
            rows[3].set_ylim((low + high) / 2 - 0.01, (low + high) / 2 + 0.01)
        _over_time(figure, rows, labels)
        style.add_legend(figure, rows[0].lines, names)
    return figure


def solver_gradient(record: SolverRecord) -> Figure:
    """Draw gradient and norms of the Jacobian's columns by unknown and frame, with zeros in white."""
    names, frames = record.unknowns, record.motion.frames
    with style.drawing(170) as figure:
        panels = figure.subplots(2, 1, sharex=True)
        shown = (np.abs(record.gradient), "|gradient|"), (record.column_norm, "norm of the Jacobian's column")
        for axes, (values, label) in zip(panels, shown, strict=True):
            size = np.where(values == 0, np.nan, values).T
            largest = float(np.nanmax(size, initial=_MIN_DRAWN))
            image = _logarithmic_image(figure, axes, size, _DECADES * largest, largest, label)
            image.set_extent((frames[0] - 0.5, frames[-1] + 0.5, len(names) - 0.5, -0.5))
            axes.set_yticks(range(len(names)), names, fontsize=style.SMALL)
            axes.tick_params(axis="y", length=0)
        panels[-1].set_xlabel("frame")
    return figure


def reference_path(record: SolverRecord) -> Figure:
    """Draw the path of the reference joint in the camera frame, for a free and a fixed camera rotation."""
    labels = ("x, to the right (m)", "y, down (m)", "z, depth (m)")
    names = [f"rotation {name}" for name in record.solutions]
    with style.drawing(110) as figure:
        rows = figure.subplots(3, 1, sharex=True)
        for i, solution in enumerate(record.solutions.values()):
            points_m = solution.chain.pose(solution.chain_states).joints_m[:, 0]
            for axes, values in zip(rows, points_m.T, strict=True):
                axes.plot(record.motion.time_s, values, **style.dots(len(values), 2.2), **style.look(i))
        _over_time(figure, rows, labels)
        style.add_legend(figure, rows[0].lines, names)
    return figure


def configurations(record: SolverRecord) -> Figure:
    """Draw detected poses in grey and reprojected poses in colour over each other, in up to twelve frames."""
    motion, picture = record.motion, record.motion.pictures[0]
    solved = np.flatnonzero(motion.solved)
    rows = solved[np.unique(np.linspace(0, len(solved) - 1, min(len(solved), _CONFIGURATIONS)).astype(int))]
    n_columns = 4
    n_rows = -(-len(rows) // n_columns)
    with style.drawing(42 * n_rows + 14) as figure:
        panels = np.ravel(figure.subplots(n_rows, n_columns, squeeze=False))
        for axes, row in zip(panels, rows.tolist(), strict=False):
            for along in motion.limbs.values():
                joints = [*along]
                axes.plot(*picture.detected_px[row, joints].T, "-o", color=style.GREY, lw=2.0, ms=3.0, gid="detected")
                axes.plot(*picture.reprojected_px[row, joints].T, "-o", color=style.look(1)["color"], lw=1.0, ms=1.8)
            axes.set_title(f"frame {motion.frames[row]}: {mean(picture.distance_px[row]):.1f} px", fontsize=style.SMALL)
            axes.set_aspect("equal", adjustable="datalim")
            axes.invert_yaxis()
            axes.tick_params(labelsize=style.SMALL - 2)
        for axes in panels[len(rows) :]:
            axes.set_axis_off()
        figure.supxlabel("x (px)\ngrey: detected   coloured: reprojected", fontsize=8)
        figure.supylabel("y (px)", fontsize=8)
    return figure


FIGURES = (
    solver_search,
    solver_unknowns,
    image_errors,
    configurations,
    solver_frame,
    solver_matrices,
    solver_gradient,
    solver_rotation,
    reference_path,
)
"""Functions that draw the figures of `recon solver`, each of which is saved under its function's name."""


def _term_label(term: str) -> str:
    """Return the label of a term of the objective, such as "f1 reprojection" for a published term."""
    published = next((name for name, published_term in PUBLISHED.items() if published_term == term), None)
    return term if published is None else f"{published} {term}"


def _over_time(figure: Figure, rows: Sequence[Axes], labels: Sequence[str], across: str = "time (s)") -> None:
    for axes, label in zip(rows, labels, strict=True):
        axes.set_ylabel(label)
    rows[-1].set_xlabel(across)
    figure.align_ylabels()


def _logarithmic_image(figure: Figure, axes: Axes, values: Array, low: float, high: float, label: str) -> AxesImage:
    """Draw a matrix as colours on a logarithmic scale, with NaN in white."""
    image = axes.imshow(values, aspect="auto", norm=LogNorm(low, high), interpolation="none")
    bar = figure.colorbar(image, ax=axes, label=label, extend="min", aspect=40, pad=0.02)
    style.plain_logarithm(bar.ax.yaxis)
    return image


def _logarithmic(axes: Axes, time_s: Array, curves: Sequence[Array]) -> None:
    for i, values in enumerate(curves):
        axes.plot(
            time_s, np.where(values > _MIN_DRAWN, values, np.nan), **style.dots(len(time_s), 2.2), **style.look(i)
        )
    axes.set_yscale("log")
    low, high = axes.get_ylim()
    axes.set_ylim(max(low, _DECADES * high), high)
    style.plain_logarithm(axes.yaxis)
