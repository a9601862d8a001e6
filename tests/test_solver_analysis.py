"""`recon solver`: the problem at the solution against the report and scipy, and what is shown."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from command_line import run
from scipy.sparse import load_npz

from recon.base.errors import InputError
from recon.base.manifest import write_manifest
from recon.fit.motion import Motion
from recon.show import plots
from recon.show.report import build_report
from recon.thesis import SolverRecord, read_solver
from recon.thesis import plots as solver_plots
from recon.thesis.inspection import TABLES, solver_figures, write_tables
from recon.workflows.settings import read_settings

SAMPLES = Path(__file__).parents[1] / "data" / "samples"


@pytest.fixture(scope="module")
def frame(frame_results) -> SolverRecord:
    return read_solver(Motion.load(frame_results), frame_results)


@pytest.fixture(scope="module")
def whole(whole_results) -> SolverRecord:
    return read_solver(Motion.load(whole_results), whole_results)


@pytest.fixture(scope="module")
def chain(chain_results) -> SolverRecord:
    return read_solver(Motion.load(chain_results), chain_results)


def test_the_frame_methods_problem_is_the_reports(frame):
    """To the rounding of the unknowns in report.json, some 1e-9 times the curvature."""
    frames = build_report(frame.motion)["frames"]
    gradient = np.array([of_frame["gradient"] for of_frame in frames])
    curvature = frame.problem.column_norm.max() ** 2
    np.testing.assert_allclose(frame.problem.gradient, gradient, atol=1e-8 * curvature)
    for t, of_frame in enumerate(frames):
        assert {name: cost[t] for name, cost in frame.problem.cost.items() if name in of_frame["cost_shares"]} == {
            name: pytest.approx(0.5 * share * of_frame["squared_norm"], rel=1e-5, abs=1e-6)
            for name, share in of_frame["cost_shares"].items()
        }
    np.testing.assert_allclose(frame.optimality, frame.of_frames("optimality"), atol=1e-8 * curvature)
    assert frame.step_norm[3] == pytest.approx(frames[3]["step_norm"])


def test_limits_passed_are_counted_as_in_the_report(frame):
    limits = build_report(frame.motion)["limits"]
    for kind, passed in frame.active.items():
        assert passed.sum() == sum(row["passed"] for row in limits[kind].values())
    assert frame.active["rates"].sum() > 0


@pytest.mark.parametrize("name", ["whole", "chain"])
def test_the_trajectory_methods_problem_is_that_of_its_last_round(name, request):
    """But for the contacts, which follow from the solution once more: a weight that the prior lost moves them."""
    record = request.getfixturevalue(name)
    told = build_report(record.motion)["convergence"]["cost_by_term"]
    found = {term: cost.sum() for term, cost in record.problem.cost.items()}
    near = {term: 0.02 if term in ("stance", "ground") else 0.004 for term in told}
    assert found == {term: pytest.approx(cost, rel=near[term]) for term, cost in told.items()}
    assert found["reprojection"] == pytest.approx(told["reprojection"], rel=1e-4)
    # A minimum: the next step is of hundredths of a radian and lowers the cost by next to nothing.
    assert 0 < record.step_norm.max() < 0.02
    assert 0 < -0.5 * np.sum(record.problem.step * record.problem.gradient) < 1e-4 * sum(found.values())


def test_limits_are_those_of_a_chain(whole, chain):
    assert whole.limits == {}
    assert [*chain.limits] == ["ranges", "rates"]


@pytest.mark.parametrize("name", ["whole", "frame"])
def test_jacobian_in_the_file_gives_gradient_and_norms(name, request, tmp_path):
    record = request.getfixturevalue(name)
    path = tmp_path / "jacobian.npz"
    record.problem.write_jacobian(path)
    J, T, D = load_npz(path), len(record.motion.frames), len(record.problem.unknowns)
    with np.load(path) as file:
        assert J.shape == (len(file["residual"]), T * D)
        assert len(file["term"]) == len(file["clip_row"]) == len(J.toarray())
        np.testing.assert_allclose((J.T @ file["residual"]).reshape(T, D), record.problem.gradient, atol=1e-9)
        assert tuple(file["unknowns"]) == record.problem.unknowns
    norms = np.linalg.norm(J.toarray(), axis=0).reshape(T, D)
    np.testing.assert_allclose(norms, record.problem.column_norm)


def test_rotation_and_length(frame, whole):
    unknowns = build_report(frame.motion)["frames"][2]["unknowns"]
    assert [values[2] for values in frame.rotation_rad.values()] == pytest.approx(unknowns[-4:-1])
    assert frame.length["base_length_m"][2] == pytest.approx(unknowns[-1])
    np.testing.assert_allclose(np.exp(1j * whole.rotation_rad["yaw"]), np.exp(1j * whole.motion.states[:, 3]))
    assert np.abs(whole.rotation_rad["yaw"]).max() < np.pi
    assert set(whole.length["size"]) == {whole.motion.size}


def test_tables(whole, frame, tmp_path):
    for record in (whole, frame):
        write_tables(record, tmp_path)
        tables = {name: pd.read_csv(tmp_path / name) for name in TABLES}
        frames, errors = tables["solver_frames.csv"], tables["image_errors.csv"]
        np.testing.assert_array_equal(frames["frame"], record.motion.frames)
        np.testing.assert_array_equal(frames["optimality"], record.optimality)
        assert (tmp_path / "solver_frame.csv").exists() == record.motion.jitters
        assert len(tables["solver_unknowns.csv"]) == len(record.problem.unknowns)
        told = build_report(record.motion)["summary"]["reprojection_px"]["mean"]
        assert np.nanmean(errors.iloc[:, 2:]) == pytest.approx(told, rel=1e-6)
    assert frames["iterations"].sum() == frame.summary()["iterations"]
    assert frames["rates_passed"].sum() == frame.active["rates"].sum()


def test_figures(whole, frame, chain):
    assert [len(solver_plots.solver_search(record).axes) for record in (whole, chain, frame)] == [3, 4, 5]
    cost, *_ = solver_plots.solver_search(frame).axes
    np.testing.assert_array_equal(cost.lines[0].get_ydata(), frame.problem.cost["reprojection"])
    rows = solver_plots.solver_root(frame).axes
    assert [axes.get_ylabel() for axes in rows] == ["xi (°)", "psi (°)", "zeta (°)", "base length (m)"]
    np.testing.assert_allclose(rows[2].lines[0].get_ydata(), np.degrees(frame.rotation_rad["zeta"]))
    heat, _ = solver_plots.image_errors(whole).axes
    shown = np.ma.filled(heat.collections[0].get_array(), np.nan)
    np.testing.assert_array_equal(shown, whole.image_error_px["synthetic pinhole"])
    gradient, norm = solver_plots.solver_unknowns(whole).axes
    np.testing.assert_allclose(norm.lines[0].get_xdata(), np.median(whole.problem.column_norm, axis=0))
    assert [label.get_text() for label in gradient.get_yticklabels()] == [*whole.problem.unknowns]


def test_the_search_of_a_frame_ends_where_the_fit_did(frame):
    """And its dampings make the steps that were taken."""
    search = frame.search
    row = int(np.argmax(frame.of_frames("function_evaluations")))
    assert search.frame == row
    assert search.cost[-1] == pytest.approx(sum(cost[row] for cost in frame.problem.cost.values()), rel=1e-6)
    assert search.evaluations[-1] == frame.of_frames("function_evaluations")[row]
    assert (np.diff(search.evaluations) > 0).all()
    assert search.damping.max() > 1e-5
    np.testing.assert_allclose(np.linalg.norm(search.jacobian, axis=0), frame.problem.column_norm[row], rtol=1e-3)
    free, held = (
        np.ptp(s.chain_states[:, s.chain.euler_slice], axis=0) for s in (frame.motion.solution, frame.otherwise)
    )
    assert held.max() < 1e-12 < 0.05 < free.max()


def test_the_frame_that_is_looked_into_has_a_pose(frame_results, whole_results):
    motion = Motion.load(frame_results)
    assert read_solver(motion, frame_results, int(motion.frames[4])).search.frame == 4
    with pytest.raises(InputError, match="expected one with a pose, from 0 to 29"):
        read_solver(motion, frame_results, 99)
    with pytest.raises(InputError, match="all frames were solved at once"):
        read_solver(Motion.load(whole_results), whole_results, 3)


def test_figures_of_the_frame_method(frame):
    bars = solver_plots.solver_evaluations(frame).axes[0].containers
    assert sum(bar.get_height() for one in bars for bar in one) == frame.of_frames("function_evaluations").sum()
    above, below = solver_plots.solver_frame(frame).axes
    np.testing.assert_array_equal(above.lines[0].get_ydata(), frame.search.cost)
    assert below.lines[0].get_ydata().max() == frame.search.damping.max()
    jacobian, *_ = solver_plots.solver_matrices(frame).axes
    assert jacobian.images[0].get_array().shape == frame.search.jacobian.shape
    *_, errors = solver_plots.solver_rotation(frame).axes
    shown = np.nanmean(errors.lines[0].get_ydata())
    assert shown == pytest.approx(
        np.nanmean([np.nanmean(column) for e in frame.image_error_px.values() for column in e.T])
    )


def test_figures_are_written(chain, small_pictures, tmp_path):
    for name, draw in solver_figures(chain).items():
        plots.save(draw(), tmp_path, name)
    stems = ("image_errors", "solver_root", "solver_search", "solver_unknowns")
    assert {path.name for path in tmp_path.iterdir()} == {f"{stem}.{end}" for stem in stems for end in ("png", "svg")}


def test_command_writes_all_of_it(of_results):
    printed, folder = of_results("recon solver results/clip --no-figures")
    solver = folder / "results" / "clip" / "solver"
    files = {path.name for path in solver.iterdir()}
    assert {*TABLES, "jacobian.npz"} <= files
    assert f"{len(files)} files" in printed
    summary = json.loads((solver / "solver.json").read_text(encoding="utf-8"))
    assert summary["status"] == "converged"


@pytest.mark.parametrize(
    ("change", "told"),
    [({"prior": "gone.npz"}, "prior"), ({"prior": "none"}, "prior: found none"), (None, "no such file")],
)
def test_settings_that_are_not_those_of_the_fit(whole_results, tmp_path, change, told):
    folder = tmp_path / "clip"
    shutil.copytree(whole_results, folder)
    settings = read_settings(whole_results / "config.toml", {})
    if change is None:
        (folder / "config.toml").unlink()
    else:
        (folder / "config.toml").write_text(replace(settings, **change).to_toml(folder), encoding="utf-8")
        write_manifest(folder)
    with pytest.raises(InputError, match=told):
        read_solver(Motion.load(folder), folder)
    assert run("solver", folder, "--no-figures").code == 2
    assert not (folder / "solver").exists() or not any((folder / "solver").iterdir())
