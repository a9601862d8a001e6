"""The command `recon solver`: what the optimiser of the frame method did, its tables and its figures.

It minimises half the squared norm of residuals r, divided by their standard deviations, with a Jacobian J; of robust
terms r and J are as the solver weighs them, so that J'r is the gradient and J'J the curvature. Columns of the tables:
docs/solver.md.
"""

from __future__ import annotations

import io
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure
from matplotlib.image import AxesImage
from scipy.sparse import block_diag
from threadpoolctl import threadpool_limits

from recon.base import Progress
from recon.base.arrays import Array, mean
from recon.base.errors import InputError, Problem
from recon.base.files import read_manifest, require_free_folder, sole_writer, staged_folder, write_bytes
from recon.base.settings import Integer, Option, Settings
from recon.fit.motion import Motion
from recon.show.plain import to_json
from recon.show.plots import style
from recon.thesis.frame import FrameOptions, FrameSearch, FrameSolution, FrameSolver, solve_frames
from recon.workflows.cli import Answer
from recon.workflows.clip_results import CONFIG, read_config

FOLDER, SUMMARY, JACOBIAN = "solver", "solver.json", "jacobian.npz"
"""By default the folder lies in the results' own."""
TABLES = ("solver_frames.csv", "solver_unknowns.csv", "image_errors.csv", "solver_frame.csv")
COUNTS = ("iterations", "function_evaluations", "starts", "optimizer_status")
CAMERA_ANGLES = ("xi", "psi", "zeta")
FIGURES_BEGIN = 0.5
"""Share of the progress before the figures."""


class _SolverSettings(Settings):
    """What `recon solver` is told."""

    folder: Annotated[Path, Option(argument="DIR")]
    """Folder of results of recon frame, as in results/clip."""
    out: Path | None = None
    """Folder for tables and figures. (default: solver in DIR)"""
    frame: Integer | None = None
    """The frame whose search is shown. (default: the one with most evaluations)"""
    figures: bool = True
    """PNG and SVG beside the tables."""
    overwrite: bool = False
    """Replace earlier tables."""


def solver(settings: _SolverSettings, progress: Progress) -> Answer:
    """What the optimiser of `recon frame` did: cost, gradient, Jacobian, limits.

    Writes tables (CSV), the Jacobian (NPZ) and figures (PNG, SVG).

    Example: recon solver results/clip
    """
    out = settings.folder / FOLDER if settings.out is None else settings.out
    motion = Motion.load(settings.folder)
    with sole_writer(out):
        require_free_folder(out, (SUMMARY, *TABLES, JACOBIAN), settings.overwrite, "what the optimiser did")
        progress("problem", 0.1)
        with threadpool_limits(1, user_api="blas"):  # of small matrices, threads cost more than they bring
            record = read_solver(motion, settings.folder, settings.frame)
            summary = record.summary()
        progress("tables", FIGURES_BEGIN - 0.1)
        with staged_folder(out) as staging:
            for name, table in record.tables().items():
                table.to_csv(staging / name, index=False, lineterminator="\n")
            record.write_jacobian(staging / JACOBIAN)
            (staging / SUMMARY).write_text(to_json(summary), encoding="utf-8")
        if settings.figures:
            with staged_folder(out) as staging:
                for done, draw in enumerate(FIGURES):
                    progress(f"figures: {draw.__name__}", FIGURES_BEGIN + (1.0 - FIGURES_BEGIN) * done / len(FIGURES))
                    style.save(draw(record), staging, draw.__name__)
    return Answer(summary, [f"{len(TABLES) + 2 + 2 * len(FIGURES) * settings.figures} files are in {out}."])


# -- what it did ------------------------------------------------------------------------------------------------------


def read_solver(motion: Motion, folder: Path, frame: int | None = None) -> SolverRecord:
    """folder: of the results that the motion was loaded from, for the fit's settings. frame: whose search is looked
    into, by default that with most evaluations. Raises InputError where settings are no longer there, for results of
    the other method, and for a frame without a pose."""
    if not isinstance(motion.solution, FrameSolution):
        raise InputError(Problem(folder, "results", "a fit of all frames at once", "results of recon frame"))
    solution = motion.solution
    read_manifest(folder).require(CONFIG)
    options = FrameOptions.of(read_config(folder / CONFIG, {}).plain())
    solved = np.flatnonzero(motion.solved)
    if not len(solved):
        raise InputError(Problem(folder, "frames", "none with a pose", "one at least"))
    if frame is None:
        row = int(solved[np.argmax(solution.reported("function_evaluations")[solved])])
    elif frame in motion.frames[solved]:
        row = int(np.flatnonzero(motion.frames == frame)[0])
    else:
        expected = f"one with a pose, from {motion.frames[solved[0]]} to {motion.frames[solved[-1]]}"
        raise InputError(Problem("--frame", "frame", str(frame), expected))
    given = solution.views[0], solution.chain, motion.fps
    again = FrameSolver(*given, options, np.where(motion.solved[:, None], solution.chain_states, np.nan))
    other = "free" if options.camera_rotation == "fixed" else "fixed"
    otherwise = solve_frames(*given, replace(options, camera_rotation=other))
    sigma_px = solution.reported("sigma_px")
    rows = {t: again.problem(t, sigma_px[t]).by_term(again.states[t]) for t in solved.tolist()}
    return SolverRecord(motion, solution, rows, again.search(row)[0], otherwise)


@dataclass(frozen=True, eq=False)
class SolverRecord:
    """What `recon solver` shows, of T frames with D unknowns each. Arrays are NaN in frames without a pose."""

    motion: Motion
    solution: FrameSolution
    rows: dict[int, dict[str, tuple[Array, Array]]]
    """Residuals (M,) and Jacobian (M, D) at the solution, by row of the clip and term, the frame before being held."""
    search: FrameSearch
    """How the frame that is looked into was solved."""
    otherwise: FrameSolution
    """The clip with the camera's rotation held still, or free where the fit held it."""

    @property
    def frame(self) -> int:
        """The number of the frame that is looked into."""
        return int(self.motion.frames[self.search.problem.frame])

    @property
    def unknowns(self) -> tuple[str, ...]:
        """(D,): the names of the chain's unknowns."""
        return self.solution.chain.state_names

    @cached_property
    def cost(self) -> pd.DataFrame:
        """Half the squared residuals by term."""
        costs = {t: {term: 0.5 * np.sum(r**2) for term, (r, _) in terms.items()} for t, terms in self.rows.items()}
        return pd.DataFrame.from_dict(costs, orient="index").fillna(0.0).reindex(range(len(self.motion.frames)))

    @cached_property
    def gradient(self) -> Array:
        """The gradient of the cost in each frame (T, D)."""
        return self._by_frame({t: np.sum([J.T @ r for r, J in of.values()], axis=0) for t, of in self.rows.items()})

    @cached_property
    def column_norm(self) -> Array:
        """Norms of the Jacobian's columns (T, D)."""
        return self._by_frame({t: np.linalg.norm(self.jacobian(t), axis=0) for t in self.rows})

    def jacobian(self, row: int) -> Array:
        """(M, D), of a row of the clip."""
        return np.concatenate([J for _, J in self.rows[row].values()])

    def _by_frame(self, found: dict[int, Array]) -> Array:
        whole = np.full((len(self.motion.frames), len(self.unknowns)), np.nan)
        whole[[*found]] = np.array([*found.values()])
        return whole

    @property
    def optimality(self) -> Array:
        """(T,): the largest part of the gradient."""
        return np.abs(self.gradient).max(axis=1)

    @property
    def image_error_px(self) -> Array:
        """(T, J): from detections to reprojections, NaN without one of them."""
        return self.motion.pictures[0].distance_px

    @property
    def active(self) -> dict[str, Array]:
        """How many angles lie beyond their expected ranges, and rates beyond their limits, by name (T,)."""
        limits = {"ranges": self.solution.beyond_range_rad, "rates": self.solution.beyond_rate_rad_s}
        return {name: (beyond > 0).sum(axis=1) for name, beyond in limits.items()}

    def summary(self) -> dict[str, object]:
        """The figures that solver.json holds."""
        return {
            "cost_by_term": {name: float(c) for name, c in self.cost.sum().items()},
            "largest_gradient": float(np.nanmax(self.optimality)),
            "largest_step": float(np.nanmax(self.solution.reported("step_norm"))),
            "limits_passed": {name: int(count.sum()) for name, count in self.active.items()},
            "iterations": int(np.nansum(self.solution.reported("iterations"))),
            "frames_converged": self.solution.status.count("converged"),
        }

    def tables(self) -> dict[str, pd.DataFrame]:
        """Every table by the name of its file (`TABLES`)."""
        motion, solution, search = self.motion, self.solution, self.search
        frames: dict[str, Any] = {"frame": motion.frames, "time_s": motion.time_s}
        frames |= {name: solution.reported(name) for name in COUNTS}
        frames |= {"optimality": self.optimality, "last_step": solution.reported("step_norm")}
        frames |= {f"cost_{str(term).replace(' ', '_')}": cost for term, cost in self.cost.items()}
        frames |= {f"{limit}_passed": count for limit, count in self.active.items()}
        frames |= {f"{name}_rad": solution.unknown(name) for name in CAMERA_ANGLES}
        frames["base_length_m"] = solution.unknown("base_length_m")

        gradient, norm = np.abs(self.gradient[motion.solved]), self.column_norm[motion.solved]
        unknowns = {"unknown": self.unknowns}
        unknowns |= {"gradient_median": np.median(gradient, 0), "gradient_max": gradient.max(0)}
        unknowns |= {f"column_norm_{f.__name__}": f(norm, axis=0) for f in (np.min, np.median, np.max)}
        errors = {"camera": motion.pictures[0].name, "frame": motion.frames}
        errors |= {f"{name}_px": of_joint for name, of_joint in zip(motion.names, self.image_error_px.T, strict=True)}
        points = {"frame": self.frame, "point": range(len(search.points))}
        points |= {"evaluations": search.evaluations_at, "cost": search.costs, "damping": [*search.damping, np.nan]}
        return dict(zip(TABLES, map(pd.DataFrame, (frames, unknowns, errors, points)), strict=True))

    def write_jacobian(self, path: Path) -> None:
        """As NPZ that `scipy.sparse.load_npz` reads as a matrix (M, T D), column t D + d: the unknown d of row t of the
        clip; with it unknowns (D,), and of every row its residual, term, and the frame that it stands for."""
        empty = np.zeros((0, len(self.unknowns)))
        every = range(len(self.motion.frames))
        matrix = block_diag([self.jacobian(t) if t in self.rows else empty for t in every], "csr")
        told = [(t, term, r) for t, found in self.rows.items() for term, (r, _) in found.items()]
        made = io.BytesIO()
        np.savez_compressed(
            made,
            format=np.array(b"csr"),
            shape=np.array(matrix.shape),
            indptr=matrix.indptr,
            indices=matrix.indices,
            data=matrix.data,
            residual=np.concatenate([r for _, _, r in told]),
            term=np.repeat([term for _, term, _ in told], [len(r) for _, _, r in told]),
            clip_row=np.repeat([t for t, _, _ in told], [len(r) for _, _, r in told]),
            unknowns=np.array(self.unknowns),
        )
        write_bytes(path, made.getvalue())


# -- figures ----------------------------------------------------------------------------------------------------------

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
    status = record.solution.status
    title = f"{status.count('converged')} of {len(status)} frames converged, each solved by itself"
    time_s, names = record.motion.time_s, [str(n) if c.sum() > 0 else f"{n}: 0" for n, c in record.cost.items()]
    with style.drawing(170 + style.legend_shape(names)[1], title=title) as figure:
        rows = figure.subplots(5, 1, sharex=True, height_ratios=(1.8, 1, 1, 1, 1))
        cost, optimality, step, evaluations, limits = rows
        _logarithmic(cost, time_s, [*record.cost.to_numpy().T])
        _logarithmic(optimality, time_s, [record.optimality])
        _logarithmic(step, time_s, [record.solution.reported("step_norm")])
        flags, spent = (record.solution.reported(name) for name in ("optimizer_status", "function_evaluations"))
        for i, flag in enumerate(np.unique(flags[np.isfinite(flags)]).astype(int).tolist()):
            ended, drawn = flags == flag, {"color": style.look(i)["color"], "label": f"{flag}: {EXIT_FLAGS[flag]}"}
            evaluations.bar(time_s[ended], spent[ended], 0.7 / record.motion.fps, **drawn)
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
    """Distances of detections from reprojections, joints x frames; white: not detected."""
    names, frames, values = record.motion.names, record.motion.frames, record.image_error_px.T
    with style.drawing(min(4.0 * len(names) + 8, style.PAGE_MM - 20) + 14) as figure:
        axes = figure.subplots()
        most = max(float(np.nanmax(values, initial=0.0)), 10.0)
        image = _logarithmic_image(figure, axes, values, 0.5, most, "error in the picture (px)")
        image.set_extent((frames[0] - 0.5, frames[-1] + 0.5, len(names) - 0.5, -0.5))
        axes.set_yticks(range(len(names)), names)
        axes.tick_params(axis="y", length=0)
        axes.set_title(f"{record.motion.pictures[0].name}: mean {mean(values):.1f} px", loc="left")
        axes.set_xlabel("frame")
    return figure


def solver_unknowns(record: SolverRecord) -> Figure:
    """Parts of the gradient by every unknown, and norms of the Jacobian's columns, over the frames."""
    names = record.unknowns
    says = "dots: median of the frames, lines: from the least to the most"
    with style.drawing(min(4.0 * len(names) + 20, style.PAGE_MM), title=says) as figure:
        panels = figure.subplots(1, 2, sharey=True)
        given = (np.abs(record.gradient), "|gradient|"), (record.column_norm, "norm of the Jacobian's column")
        for axes, (values, label) in zip(panels, given, strict=True):
            known = values[record.motion.solved]
            low, middle, high = (np.maximum(f(known, axis=0), _LEAST) for f in (np.min, np.median, np.max))
            at = np.arange(len(names))
            axes.hlines(at, low, high, color=style.GREY, lw=1.0)
            axes.plot(middle, at, "o", ms=3.5, color=style.look(0)["color"])
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
    """Within the frame that is looked into: objective and damping from one accepted point to the next."""
    search = record.search
    title = f"frame {record.frame}: {len(search.damping)} steps, {search.evaluations_at[-1]} evaluations"
    labels = ("objective (½σ²)", f"damping λ ({_UNDAMPED:g}: none)")
    with style.drawing(80, title=title) as figure:
        rows = figure.subplots(2, 1, sharex=True)
        for i, (axes, values) in enumerate(zip(rows, (search.costs, search.damping.clip(_UNDAMPED)), strict=True)):
            axes.plot(np.arange(len(values)), values, **style.dots(len(values), 3.0), **style.look(i))
            axes.set_yscale("log")
            style.plain_logarithm(axes.yaxis)
            axes.xaxis.get_major_locator().set_params(integer=True)
        _over_time(figure, rows, labels, "accepted point")
    return figure


def solver_matrices(record: SolverRecord) -> Figure:
    """The Jacobian of the frame that is looked into at its minimum, residuals x unknowns, and J'J; white is zero."""
    search, names = record.search, record.unknowns
    parts = search.problem.by_term(search.x)
    counts, J = np.array([len(r) for r, _ in parts.values()]), np.concatenate([J for _, J in parts.values()])
    with style.drawing(140, title=f"frame {record.frame}, at the minimum") as figure:
        panels = figure.subplots(1, 2)
        for axes, (matrix, label) in zip(panels, ((J, "|J|"), (J.T @ J, "|J'J|")), strict=True):
            size = np.where(matrix == 0, np.nan, np.abs(matrix))
            most = float(np.nanmax(size, initial=1.0))
            _logarithmic_image(figure, axes, size, _DECADES * most, most, label)
            axes.set_xticks(range(len(names)), names, rotation=90, fontsize=style.SMALL)
            axes.tick_params(length=0)
        panels[0].set_yticks(np.cumsum(counts) - counts / 2 - 0.5, [*parts], fontsize=style.SMALL)
        panels[1].set_yticks(range(len(names)), names, fontsize=style.SMALL)
    return figure


def solver_rotation(record: SolverRecord) -> Figure:
    """The camera's rotation held still beside free: its angles, the base length, and the mean error in the picture,
    over time."""
    (view,) = record.otherwise.views
    labels, names = (*(f"{name} (°)" for name in CAMERA_ANGLES), "base length (m)", "error (px)"), []
    with style.drawing(24 * len(labels) + 20) as figure:
        rows = figure.subplots(len(labels), 1, sharex=True)
        for i, (solution, which) in enumerate(((record.solution, "as fitted"), (record.otherwise, "otherwise"))):
            off_px = np.linalg.norm(view.xy_px - view.project(solution.joints_m)[0], axis=2)
            angles = [np.degrees(solution.unknown(name)) for name in CAMERA_ANGLES]
            still = max(float(np.nanmax(angle) - np.nanmin(angle)) for angle in angles) < _LEAST
            names.append(f"{which}: {'held still' if still else 'free'}")
            error_px = np.array([mean(of_frame) for of_frame in off_px])
            for axes, values in zip(rows, (*angles, solution.unknown("base_length_m"), error_px), strict=True):
                axes.plot(record.motion.time_s, values, **style.dots(len(values), 2.2), **style.look(i))
                axes.ticklabel_format(useOffset=False)
        low, high = rows[3].get_ylim()
        if high - low < 0.02:  # a length that does not move should not look as if it did
            rows[3].set_ylim((low + high) / 2 - 0.01, (low + high) / 2 + 0.01)
        _over_time(figure, rows, labels)
        style.add_legend(figure, rows[0].lines, names)
    return figure


FIGURES = (solver_search, solver_unknowns, image_errors, solver_frame, solver_matrices, solver_rotation)
"""What is drawn, each under its name."""


def _over_time(figure: Figure, rows: Sequence[Axes], labels: Sequence[str], across: str = "time (s)") -> None:
    for axes, label in zip(rows, labels, strict=True):
        axes.set_ylabel(label)
    rows[-1].set_xlabel(across)
    figure.align_ylabels()


def _logarithmic_image(figure: Figure, axes: Axes, values: Array, least: float, most: float, label: str) -> AxesImage:
    """Rows of values as colours; white: none."""
    image = axes.imshow(values, aspect="auto", norm=LogNorm(least, most), interpolation="none")
    bar = figure.colorbar(image, ax=axes, label=label, extend="min", aspect=40, pad=0.02)
    style.plain_logarithm(bar.ax.yaxis)
    return image


def _logarithmic(axes: Axes, time_s: Array, curves: Sequence[Array]) -> None:
    for i, values in enumerate(curves):
        axes.plot(time_s, np.where(values > _LEAST, values, np.nan), **style.dots(len(time_s), 2.2), **style.look(i))
    axes.set_yscale("log")
    low, high = axes.get_ylim()
    axes.set_ylim(max(low, _DECADES * high), high)
    style.plain_logarithm(axes.yaxis)
