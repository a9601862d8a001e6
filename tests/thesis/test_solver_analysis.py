"""Test that the tables of `recon solver` agree with the report and with scipy, and test its output."""

from __future__ import annotations

import json
import shutil

import numpy as np
import pandas as pd
import pytest
from command_line import refusal, refused, run, says
from figure_texts import cut_off
from matplotlib.figure import Figure
from scipy.sparse import load_npz
from shortcuts import solve_frames_once

from recon.base.outputs import RECORD
from recon.fit.motion import Motion
from recon.show.report import build_report
from recon.thesis import figures as solver_plots
from recon.thesis.inspect import EXIT_FLAGS, TABLES, SolverRecord, read_solver
from recon.thesis.solver import FrameSolver


@pytest.fixture(scope="module")
def frame(frame_results) -> SolverRecord:
    with pytest.MonkeyPatch.context() as patch:
        solve_frames_once(patch)
        return read_solver(Motion.load(frame_results), frame_results)


def test_costs_agree_with_the_reports_of_the_fit(frame):
    for row, told in enumerate(frame.solution.reports):
        costs = {name: cost[row] for name, cost in frame.cost.items() if name in told.cost_shares}
        assert costs == {
            name: pytest.approx(0.5 * fraction * told.squared_norm, rel=1e-5, abs=1e-6)
            for name, fraction in told.cost_shares.items()
        }
    # at a minimum, the gradient is small relative to the Jacobian's columns
    assert (frame.optimality < 1e-3 * frame.column_norm.max(axis=1)).all()


def test_limits_passed_are_counted(frame):
    assert frame.active["ranges"].sum() == (frame.solution.beyond_range_rad > 0).sum()
    assert frame.active["rates"].sum() > 0


def test_jacobian_in_the_file_gives_gradient_and_norms(frame, tmp_path):
    path = tmp_path / "jacobian.npz"
    frame.write_jacobian(path)
    J, T, D = load_npz(path), len(frame.motion.frames), len(frame.unknowns)
    with np.load(path) as file:
        assert J.shape == (len(file["residual"]), T * D)
        assert len(file["term"]) == len(file["clip_row"]) == len(J.toarray())
        np.testing.assert_allclose((J.T @ file["residual"]).reshape(T, D), frame.gradient, atol=1e-9)
        assert tuple(file["unknowns"]) == frame.unknowns
    norms = np.linalg.norm(J.toarray(), axis=0).reshape(T, D)
    np.testing.assert_allclose(norms, frame.column_norm)


def test_tables(frame, tmp_path):
    for name, table in frame.tables().items():
        table.to_csv(tmp_path / name, index=False)
    read = {name: pd.read_csv(tmp_path / name) for name in TABLES}
    frames, unknowns, errors, search, variables, gradient, paths = read.values()
    np.testing.assert_array_equal(frames["frame"], frame.motion.frames)
    np.testing.assert_array_equal(frames["optimality"], frame.optimality)
    told = build_report(frame.motion)
    xyz_and_base = frames.loc[2, ["xi_rad", "psi_rad", "zeta_rad", "base_length_m"]]
    assert xyz_and_base.tolist() == pytest.approx(frame.solution.chain_states[2, -4:])
    J = len(frame.motion.names)
    distance, offset = np.split(errors.iloc[:, 2:].to_numpy(), [J], axis=1)
    np.testing.assert_allclose(np.hypot(offset[:, ::2], offset[:, 1::2]), distance)
    assert np.nanmean(distance) == pytest.approx(told["summary"]["reprojection_px"]["mean"], rel=1e-6)
    np.testing.assert_allclose(frames["squared_norm"], 2 * frame.cost.sum(axis=1), rtol=1e-9)
    assert frames.loc[2, "jacobian_sparsity"] == np.mean(frame.jacobian(2) == 0)
    assert frames.loc[2, "jacobian_mean_abs"] == pytest.approx(np.abs(frame.jacobian(2)).mean())
    summary, evaluations = frame.summary(), frames["function_evaluations"]
    assert frames["iterations"].sum() == summary["iterations"]
    assert summary["evaluations_by_frame"] == {
        "median": evaluations.median(),
        "min": evaluations.min(),
        "max": evaluations.max(),
    }
    assert summary["worst_joint"]["mean_px"] == pytest.approx(np.nanmean(distance, axis=0).max())
    assert {*frames["optimizer_message"]} <= {*EXIT_FLAGS.values()}
    assert frames["rates_passed"].sum() == frame.active["rates"].sum()
    assert unknowns["rates_passed"].sum() == frames["rates_passed"].sum()
    assert unknowns.loc[14:, "rates_passed"].sum() == 0  # only the angles, unknowns 0 to 13, have limited rates
    np.testing.assert_allclose(unknowns["column_norm_median"], np.median(frame.column_norm, axis=0))
    assert search["cost"].tolist() == pytest.approx(frame.search.costs.tolist())
    assert search["step"].iloc[:-1].tolist() == pytest.approx(frame.search.step_norms.tolist())
    order = "th6 th7 th8 th1 th2 th3 th4 ph6 ph7 ph8 ph1 ph2 ph3 ph4 x0 y0 z0 xi psi zeta base_length f1 f2 f3 f4 f5"
    assert variables.columns.tolist() == ["frame", "time_s", *order.split()]
    np.testing.assert_allclose(variables.iloc[:, 2:23], frame.solution.chain_states)
    np.testing.assert_allclose(variables["f1"], frame.cost["reprojection"])
    np.testing.assert_allclose(gradient.iloc[:, 1:], frame.gradient)
    points_m = frame.solution.chain.pose(frame.solution.chain_states).joints_m[:, 0]
    np.testing.assert_allclose(paths[["x_free_m", "y_free_m", "z_free_m"]], points_m)
    assert np.abs(paths["z_fixed_m"] - paths["z_free_m"]).max() > 0.01


@pytest.fixture(scope="module")
def figures(frame) -> dict[str, Figure]:
    return {draw.__name__: draw(frame) for draw in solver_plots.FIGURES}


@pytest.mark.slow
def test_figures(frame, figures):
    cost, *others = figures["solver_search"].axes
    assert len(others) == 4
    np.testing.assert_array_equal(cost.lines[0].get_ydata(), frame.cost["reprojection"])
    rows = figures["solver_rotation"].axes
    assert [axes.get_ylabel() for axes in rows[:4]] == ["xi (°)", "psi (°)", "zeta (°)", "base length (m)"]
    np.testing.assert_allclose(rows[2].lines[0].get_ydata(), np.degrees(frame.solution.unknown("zeta")))
    heat, _ = figures["image_errors"].axes
    shown = np.ma.filled(heat.images[0].get_array(), np.nan)
    np.testing.assert_array_equal(shown, frame.image_error_px.T)
    assert heat.images[0].get_extent()[:2] == [frame.motion.frames[0] - 0.5, frame.motion.frames[-1] + 0.5]
    assert heat.xaxis.get_major_ticks()[0].tick1line.get_markersize() > 0
    gradient, norm = figures["solver_unknowns"].axes
    np.testing.assert_allclose(norm.lines[0].get_xdata(), np.median(frame.column_norm, axis=0))
    assert [label.get_text() for label in gradient.get_yticklabels()] == [*frame.unknowns]


def test_the_search_of_a_frame_ends_where_the_fit_did(frame):
    search = frame.search
    row = int(np.argmax(frame.solution.reported("function_evaluations")))
    assert search.problem.frame == row
    assert search.costs[-1] == pytest.approx(frame.cost.loc[row].sum(), rel=1e-6)
    spent = frame.solution.reported("function_evaluations") - frame.solution.reported("first_evaluations")
    assert search.evaluations_at[-1] == spent[row]
    assert (np.diff(search.evaluations_at) > 0).all()
    assert (search.damping >= 0).all()
    np.testing.assert_allclose(
        np.linalg.norm(search.problem.at(search.x)[1], axis=0), frame.column_norm[row], rtol=1e-3
    )
    free, held = (
        np.ptp(s.chain_states[:, s.chain.euler_slice], axis=0) for s in (frame.motion.solution, frame.other_solution)
    )
    assert held.max() < 1e-12 < 0.05 < free.max()


def test_the_search_of_the_first_frame_is_damped(frame):
    solution = frame.solution
    search, starts = FrameSolver(solution.views[0], solution.chain, frame.motion.fps, frame.options).search(0)
    assert starts == 3
    assert search.damping.max() > 1e-5


@pytest.mark.usefixtures("frames_solved_once")
def test_the_shown_frame_must_have_a_pose(frame_results, whole_results):
    motion = Motion.load(frame_results)
    assert read_solver(motion, frame_results, int(motion.frames[4])).search.problem.frame == 4
    with refusal(("--frame", "frame", 99, "0 to 29")):
        read_solver(motion, frame_results, 99)
    with refusal((whole_results, "results", "all frames", "recon frame")):
        read_solver(Motion.load(whole_results), whole_results)


@pytest.mark.slow
def test_figures_are_drawn_with_all_their_text(figures, tmp_path):
    assert {name: texts for name, figure in figures.items() if (texts := cut_off(figure))} == {}
    for name, figure in figures.items():
        figure.savefig(tmp_path / f"{name}.svg")
        assert (tmp_path / f"{name}.svg").stat().st_size > 5000


@pytest.mark.slow
def test_figures_of_the_frame_method(frame, figures):
    bars = figures["solver_search"].axes[3].containers
    spent = frame.solution.reported("function_evaluations")
    assert sum(bar.get_height() for one in bars for bar in one) == spent.sum()
    above, steps, *damped = figures["solver_frame"].axes
    assert len(steps.lines[0].get_ydata()) == len(frame.search.damping)
    poses = figures["configurations"].axes
    shown = [line for line in poses[0].lines if line.get_gid() == "detected"]
    assert len(shown) == len(frame.motion.limbs)
    np.testing.assert_array_equal(above.lines[0].get_ydata(), frame.search.costs)
    # the damping has a panel unless every step is a Gauss-Newton step
    assert [axes.lines[0].get_ydata().max() for axes in damped] == [x for x in [frame.search.damping.max()] if x > 1e-8]
    jacobian, *_ = figures["solver_matrices"].axes
    assert jacobian.images[0].get_array().shape == frame.search.problem.at(frame.search.x)[1].shape
    *_, errors = figures["solver_rotation"].axes
    shown = np.nanmean(errors.lines[0].get_ydata())
    assert shown == pytest.approx(np.nanmean([np.nanmean(of_frame) for of_frame in frame.image_error_px]))


@pytest.mark.usefixtures("frames_solved_once")
def test_the_command_writes_all_tables_and_figures(frame_results, undrawn, tmp_path):
    out = tmp_path / "solver"
    ended = run("solver", frame_results, "--out", out)
    assert ended.code == 0, ended.err
    files = {path.name for path in out.iterdir() if path.name != RECORD}
    pictures = {f"{draw.__name__}.{end}" for draw in solver_plots.FIGURES for end in ("png", "svg")}
    assert files == {*TABLES, "jacobian.npz", "solver.json", *pictures}
    assert f"{len(files)} files" in ended.out
    assert says(
        " ".join(ended.out.split()),
        "30 of 30 frames converged",
        "iterations",
        "Fractions of the cost: f1",
        "priors and other terms",
    )
    assert json.loads((out / "solver.json").read_text(encoding="utf-8"))["frames_converged"] == 30


def test_missing_settings_are_reported(frame_results, tmp_path):
    folder = tmp_path / "clip"
    shutil.copytree(frame_results, folder)
    (folder / "config.toml").unlink()
    missing = (folder / "config.toml", "file", "no such file")
    with refusal(missing):
        read_solver(Motion.load(folder), folder)
    refused(["solver", folder, "--no-figures"], missing)
    assert not (folder / "solver").exists() or not any((folder / "solver").iterdir())
