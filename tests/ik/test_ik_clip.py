"""Test `recon ik`, from the chain of a fitted clip to files and messages."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from command_line import refusal, refused, run, says
from scipy.interpolate import CubicSpline
from shortcuts import shorten_cost_study

from recon.cli.ik import CLOSES_PERCENT
from recon.fit.motion import Motion
from recon.gait.clip import ClipAnalysis
from recon.gait.gait import STRIDE_WORDS, pose_gait
from recon.ik.clip import run_ik
from recon.ik.drive import drive_to
from recon.ik.figures import parameter_series
from recon.ik.limb import (
    animal_portraits,
    cost_of,
    fit_parameter_series,
    fit_parameters,
    follow_stride,
    limb_of,
    methods_of,
    stride_duration_range_s,
    stride_of,
)
from recon.ik.methods import LeastNorm, damped_least_squares, weighted_least_norm
from recon.ik.parameters import EQUAL_WEIGHT_PULL, SEARCH_RANGE, Frames, explained_by, fits, rates_of
from recon.ik.settings import METHODS, IkSettings
from recon.io.common import Pose3D
from recon.testing.gallop import RISE_S, START_STRIDES_HZ, TOP_STRIDES_HZ, gallop

pytestmark = pytest.mark.usefixtures("small_pictures")


@pytest.fixture
def folder(whole_results, tmp_path) -> Path:
    """Return a writable copy of the whole animal's results folder."""
    return Path(shutil.copytree(whole_results, tmp_path / "fit"))


def compared_in(dim: int, whole_results: Path, folder: Path) -> Path:
    shutil.copytree(whole_results, folder)
    done = run("ik", folder, "--compare", "--dim", dim, "--no-limits", "--no-figures")
    assert (done.code, done.err) == (0, "")
    return folder


@pytest.fixture(scope="module")
def compared(whole_results, tmp_path_factory) -> Path:
    """Return the folder with the results of both tasks by all methods, in the plane; tests must not change it."""
    return compared_in(2, whole_results, tmp_path_factory.mktemp("compared") / "fit")


def ends(limb) -> np.ndarray:
    return np.array([limb.chain.end(x) for x in limb.q])


@pytest.mark.parametrize("foot", ["LF", "r_front_paw", "LH"])
def test_chain_of_a_whole_animal_ends_at_its_foot(whole_results, foot):
    # Compare the end of the chain with the foot's position relative to the root, in the axes of travel.
    results = Motion.load(whole_results)
    limb = limb_of(results, foot)
    name = results.foot_names.get(foot, foot)
    at = results.names.index
    root, paw = results.upright.xyz_m[:, at("spine")], results.upright.xyz_m[:, at(name)]
    ahead = (root[-1] - root[0]) * (1, 1, 0) / np.linalg.norm((root[-1] - root[0])[:2])
    left = np.cross([0, 0, 1], ahead)
    expected = (paw - root) @ np.stack([ahead, left, [0, 0, 1]], axis=1)
    assert limb.base == "xyz"
    assert limb.foot == name
    np.testing.assert_allclose(ends(limb), expected, atol=1e-6)


def test_planar_chain_of_a_whole_animal(whole_results):
    results = Motion.load(whole_results)
    limb = limb_of(results, "LF", dim=2)
    assert limb.chain.names[:3] == ("spine", "neck_base", "l_shoulder")
    at = results.names.index
    base, paw = results.upright.xyz_m[:, at("spine")], results.upright.xyz_m[:, at("l_front_paw")]
    down = base[:, 2] - paw[:, 2]
    # Lengths are medians of projected lengths, so the foot's position is exact up to the misfit.
    assert np.median(np.abs(ends(limb)[:, 1] - down)) < 2 * limb.misfit_m
    assert limb.misfit_m < 0.05


@pytest.mark.parametrize("dim", [2, 3])
def test_chain_of_the_8u_skeleton(frame_results, dim):
    results = Motion.load(frame_results)
    limb = limb_of(results, dim=dim)
    assert limb.foot == "r_front_paw"
    assert limb.chain.n == 5 * (dim - 1)
    root, paw = results.upright.xyz_m[:, 0], results.upright.xyz_m[:, results.names.index("r_front_paw")]
    if dim == 3:
        # The base length is its median over the clip.
        base = results.solution.chain_states[:, -1]
        scaled = np.linalg.norm(paw - root, axis=1) * np.median(base) / base
        np.testing.assert_allclose(np.linalg.norm(ends(limb), axis=1), scaled, rtol=1e-6)
    with refusal(("--foot", "foot", "'RH'", "RF (r_front_paw)")):
        limb_of(results, "RH")


@pytest.mark.parametrize("dim", [2, 3])
def test_joints_of_the_8u_chain_have_the_names_of_the_analysis(frame_results, tmp_path, dim):
    # A stride starts in the animal's pose, so its first row has the angles of `recon analyse` under the same names.
    ask = ("--method", "damped", "--follow", "stride", "--dim", dim, "--stride", "0.4333:0.735", "--no-figures")
    assert run("ik", frame_results, *ask, "--out", tmp_path / "ik").code == 0
    start, motion = pd.read_csv(tmp_path / "ik" / "follow_damped.csv").iloc[0], Motion.load(frame_results)
    names = [f"{name}_rad" for name in motion.posture_names]
    angles = dict(zip(names, motion.posture_rad[np.abs(motion.time_s - 13 / 30).argmin()], strict=True))
    joints = [f"theta_{k}" for k in (1, 2, 3, 4)]
    assert [c for c in start.index if c.startswith("theta") and c.endswith("_rad")] == [
        f"{joint}_rad" for joint in ("theta_9", *joints)
    ]
    # The first link differs, because the skeleton measures it from its own axis, and the plane has no roll.
    found, expected = ([row[f"{joint}_rad"] for joint in joints] for row in (start, angles))
    np.testing.assert_allclose(found, expected, atol=0.1)
    assert np.ptp(expected) > 1


@pytest.mark.parametrize("limits", [(), ("--no-limits",)])
def test_the_limit_that_keeps_a_path_from_closing_is_named(frame_results, tmp_path, limits):
    ask = ("--method", "extended-energy", "--follow", "stride", "--dim", "2", "--no-figures", *limits)
    done = run("ik", frame_results, *ask, "--stride", "0.3667:0.667", "--out", tmp_path / "a")
    row = json.loads((tmp_path / "a" / "ik.json").read_text(encoding="utf-8"))["along_stride"]["extended-energy"]
    if limits:
        assert row["least_closure_angle_percent"] > 99
        assert (row["limits_hit"], row["first_limit"]) == ([], "")
        assert "stopped by" not in done.out
        return
    assert row["least_closure_angle_percent"] < CLOSES_PERCENT
    closures = row["closure_angle_percent"]
    joint = row["limits_hit"][0]
    least = min(closures, key=closures.get)
    assert least in row["limits_hit"]
    assert closures[least] == row["least_closure_angle_percent"]
    chain = limb_of(Motion.load(frame_results), dim=2).chain
    at = chain.names.index(joint)
    side, limit = ("upper", chain.upper_rad[at]) if "upper" in row["first_limit"] else ("lower", chain.lower_rad[at])
    assert row["first_limit"].startswith(f"{joint} at its {side} limit of {limit:.2f} rad (step ")
    said = " ".join(done.out.split())
    assert says(said, "extended-energy does not close", row["first_limit"])
    assert pd.read_csv(tmp_path / "a" / "follow.csv")["first_limit"].iloc[0] == row["first_limit"]


def test_fitted_parameters_explain_part_of_the_rates(whole_results):
    limb = limb_of(Motion.load(whole_results))
    parameters = fit_parameters(limb)
    assert set(parameters) == set(fits())
    least = parameters["least-norm"].explained
    for name in ("weighted", "gradient-projection", "damped"):
        assert parameters[name].explained >= least - 1e-9
    assert np.mean(parameters["weighted"].parameter) == pytest.approx(1.0)
    fitted = methods_of(limb, METHODS, parameters, fitted=True)
    assert fitted["damped"] is parameters["damped"].method
    assert methods_of(limb, METHODS, parameters)["damped"] != fitted["damped"]


@pytest.mark.parametrize("dim", [2, pytest.param(3, marks=pytest.mark.slow)])
def test_all_methods_reach_the_target_and_follow_the_stride(dim, whole_results, request, tmp_path):
    folder = request.getfixturevalue("compared") if dim == 2 else compared_in(3, whole_results, tmp_path / "fit")
    summary = json.loads((folder / "ik" / "ik.json").read_text(encoding="utf-8"))
    assert summary["stride"]["how"] == "gait"  # the sample has complete strides
    assert {*summary["to_target"]} == {*summary["along_stride"]} == {*METHODS}
    assert summary["base_at"] == ("spine" if dim == 2 else "the beginning of rear_trunk")
    target = np.array(summary["target_m"])
    for name in METHODS:
        row = summary["to_target"][name]
        table = pd.read_csv(folder / "ik" / f"target_{name}.csv")
        assert len(table) == row["iterations"] + 1
        end = table[[f"end_{axis}_m" for axis in ("UV" if dim == 2 else "xyz")]].to_numpy()
        np.testing.assert_allclose(np.linalg.norm(end - target, axis=1), table["distance_m"], atol=1e-9)
        assert (table["distance_m"].iloc[-1] <= 0.003) == row["reached"]
    assert sum(row["reached"] for row in summary["to_target"].values()) >= 8
    closures = pd.read_csv(folder / "ik" / "closures.csv", index_col="joint")
    assert list(closures.index) == summary["joints"]
    # One turn: least norm drifts, the extended Jacobian does not.
    assert summary["along_stride"]["extended-energy"]["least_closure_angle_percent"] > 99
    assert summary["along_stride"]["least-norm"]["least_closure_angle_percent"] < 90
    assert closures["extended-energy_angle"].min() > 99
    assert summary["along_stride"]["least-norm"]["worst_error_m"] < 0.003
    assert pd.read_csv(folder / "ik" / "target.csv").set_index("method").loc["damped", "reached"] == "yes"


def test_rates_for_control_are_continuous_on_a_closed_path(compared):
    # Every method and joint has rates over the animal's time, and on a closed path both ends have the same rates.
    motion = Motion.load(compared)
    limb = limb_of(motion, dim=2)
    stride = stride_of(motion, limb)
    begins_s = limb.first_s + stride.start_s
    for name in METHODS:
        table = pd.read_csv(compared / "ik" / f"follow_{name}.csv")
        time_s = table["time_s"].to_numpy()
        assert time_s[[0, -1]] == pytest.approx([begins_s, begins_s + stride.end_s - stride.start_s])
        for joint in limb.chain.names:
            angle, rate, acceleration = (
                table[f"{joint}_{what}"].to_numpy() for what in ("rad", "rate_rad_s", "acceleration_rad_s2")
            )
            np.testing.assert_allclose(rate[1:-1], np.gradient(angle, time_s)[1:-1], atol=1e-6)
            bend = np.diff(angle, 2) / stride.interval_s**2
            np.testing.assert_allclose(acceleration[1:-1], bend, atol=1e-3)
            if name == "extended-energy":
                assert abs(rate[0] - rate[-1]) < 0.01 * np.ptp(rate)
                assert abs(acceleration[0] - acceleration[-1]) < 0.1 * np.abs(acceleration).max()
    drive = json.loads((compared / "ik" / "ik.json").read_text(encoding="utf-8"))["to_target"]["damped"]
    target = pd.read_csv(compared / "ik" / "target_damped.csv")
    assert target["time_s"].iloc[-1] == pytest.approx(drive["iterations"] / 90)


@pytest.mark.slow
def test_a_comparison_has_a_figure_of_each_method(of_results):
    _, ran_in = of_results("recon ik results/clip --compare")
    for name in METHODS[:2]:
        assert (ran_in / "results" / "clip" / "ik" / f"follow_phase_{name}.svg").is_file()


@pytest.mark.slow
def test_weighted_cost_factor_and_parameters_of_each_frame(folder):
    asked = {"target": "stride-max", "compare": True, "dim": 2, "fitted": True, "figures": False}
    done = run_ik(IkSettings(folder=folder, **asked, cost="energy,pose=0.5", alpha=0.5))
    limb, cost = done.limb, cost_of(done.limb, "energy,pose=0.5")
    q = limb.q[0]
    assert cost.value(q) == pytest.approx(
        np.sum((limb.chain.joint_lengths_m * q) ** 2) + 0.5 * np.sum((q - np.nanmean(limb.q, axis=0)) ** 2)
    )
    assert cost_of(limb, "energy").value(q) == pytest.approx(np.sum((limb.chain.joint_lengths_m * q) ** 2))
    # Half of each step (alpha 0.5) takes more iterations, and the file contains the reason.
    assert all(done.runs["target"][name].reached for name in ("extended", "least-norm"))
    usual = drive_to(limb.chain, done.runs["target"]["least-norm"].q[0], done.target_m, LeastNorm())
    assert done.runs["target"]["least-norm"].iterations > 1.5 * usual.iterations
    assert done.summary["parameters"]["alpha"] == 0.5
    table = pd.read_csv(folder / "ik" / "parameters.csv")
    times = table["time_s"].to_numpy()
    assert done.series is not None
    assert len(times) == len(done.stride.q)
    assert times[0] == pytest.approx(limb.first_s + done.stride.start_s)
    np.testing.assert_allclose(np.diff(times), 1 / limb.fps)
    weights = table[[f"weighted_{joint}" for joint in limb.chain.names]].to_numpy()
    np.testing.assert_allclose(weights.mean(axis=1), 1.0)
    # Weights fitted to each configuration explain at least as much as least norm.
    assert (table["weighted_explained"] > table["least-norm_explained"] - 1e-9).all()
    assert table["damped_lambda_m"].between(*SEARCH_RANGE).all()


@pytest.mark.slow
def test_online_parameters_come_from_the_three_frames_before(folder):
    # The parameters are tested on the pose and the rates of the animal in the frame itself.
    asked = {"follow": "stride", "compare": True, "dim": 2, "figures": False, "limits": False}
    done = run_ik(IkSettings(folder=folder, **asked, online=True))
    limb, stride, series = done.limb, done.stride, done.series
    assert series is not None
    first, known = round(stride.start_s * limb.fps), np.arange(len(limb.q)) / limb.fps
    dq = CubicSpline(known, limb.q)(known, 1)
    dx = np.array([limb.chain.jacobian(q) @ rate for q, rate in zip(limb.q, dq, strict=True)])
    frames = Frames.without_gaps(limb.chain, limb.q, dx, dq)
    for t in (5, len(stride.q) - 1):
        fit = fits(pull=EQUAL_WEIGHT_PULL)["weighted"](frames[first + t - 3 : first + t])
        np.testing.assert_allclose(series[[f"weighted_{joint}" for joint in limb.chain.names]].iloc[t], fit.parameter)
        now = frames[first + t : first + t + 1]
        assert series["weighted_explained"].iloc[t] == pytest.approx(explained_by(rates_of(fit.method, now), now.dq))
    # The first step is the step that these weights give.
    run, least = done.runs["follow"]["weighted"], done.runs["follow"]["least-norm"]
    weights = series[[f"weighted_{joint}" for joint in limb.chain.names]].iloc[0].to_numpy()
    towards = (stride.path_m[1] - stride.path_m[0]) / stride.interval_s
    expected = weighted_least_norm(weights).rates(limb.chain, run.q[0], towards / 10).dq * 10
    np.testing.assert_allclose(run.dq[0], expected, rtol=1e-9)
    off = np.sqrt(np.nanmean((least.q[::10][: len(stride.q)] - stride.q) ** 2))
    assert done.summary["along_stride"]["least-norm"]["joints_off_rad"] == pytest.approx(off)
    assert done.summary["parameters"]["used"].startswith("refitted")


@pytest.mark.slow
def test_one_method_reaches_a_given_target(folder):
    done = run(
        "ik", folder, "--method", "least-norm", "--target", "0.7,0.1,-0.4", "--foot", "RF", "--out", folder / "x"
    )
    assert done.code == 0
    summary = json.loads((folder / "x" / "ik.json").read_text(encoding="utf-8"))
    assert summary["target_m"] == [0.7, 0.1, -0.4]
    assert {*summary["to_target"]} == {"least-norm"}
    assert summary["along_stride"] == {}
    for figure in ("target_task_space", "target_joint_space"):
        assert (folder / "x" / f"{figure}.svg").is_file()
    far = run("ik", folder, "--method", "damped", "--target", "5,0,0", "--out", folder / "y", "--no-figures")
    assert far.code == 0
    assert "unreachable" in " ".join(far.out.split())


def true_stride_s(start_s: float) -> float:
    """Return the duration of a stride of the samples' simulated gallop from its formula, seconds."""
    time_s = np.linspace(0, 3, 30001)
    phase = TOP_STRIDES_HZ * time_s + RISE_S * (TOP_STRIDES_HZ - START_STRIDES_HZ) * (np.exp(-time_s / RISE_S) - 1)
    return float(np.interp(np.interp(start_s, time_s, phase) + 1, phase, time_s)) - start_s


@pytest.mark.parametrize(
    ("fit", "dim"),
    [
        ("frame_results", 2),
        ("whole_results", 3),
        *(
            pytest.param(fit, dim, marks=pytest.mark.slow)
            for fit, dim in (
                ("frame_results", 3),
                ("chain_results", 2),
                ("chain_results", 3),
                ("whole_results", 2),
            )
        ),
    ],
)
def test_the_stride_has_its_true_duration_and_can_be_followed(fit, dim, request):
    # Both skeletons, both methods of fitting and all feet with a chain are tested.
    results = Motion.load(request.getfixturevalue(fit))
    feet = ["RF"] if len(results.foot_names) == 2 else list(results.foot_names)
    for foot in feet:
        limb = limb_of(results, foot, dim)
        stride = stride_of(results, limb)
        assert stride.origin == ("gait" if results.chain is None else "end effector")
        assert stride.end_s - stride.start_s == pytest.approx(
            true_stride_s(stride.start_s), rel=0.08 if results.jitters else 0.05
        )
        assert follow_stride(limb.chain, stride, damped_least_squares()).distance_m.max() < 0.005
        assert stride.gap_percent < 16


@pytest.mark.parametrize("fit", ["frame_results", pytest.param("chain_results", marks=pytest.mark.slow)])
def test_analysis_and_both_dimensions_use_the_same_stride(fit, request, tmp_path):
    folder = request.getfixturevalue(fit)
    results = Motion.load(folder)
    stride = ClipAnalysis(results).stride
    assert (stride.foot, stride.at) == ("RF", "end effector")
    for dim in (2, 3):
        limb = limb_of(results, dim=dim)
        path = stride_of(results, limb)
        assert limb.first_s + path.start_s == pytest.approx(stride.start_s)
        assert path.end_s - path.start_s == pytest.approx(stride.duration_s)
        assert path.gap_percent < 16
    done = run("ik", folder, "--follow", "stride", "--no-figures", "--out", tmp_path / "a")
    assert says(" ".join(done.out.split()), "between two rearmost positions of the foot")


@pytest.mark.parametrize(
    ("frames", "how"), [(slice(0, 13), "return"), (slice(2, 14), "gait"), (slice(0, 8), "whole clip")]
)
def test_analysis_and_both_dimensions_use_the_same_frames_of_a_short_clip(frame_results, frames, how):
    # If no stride is complete, the frames are the nearest return, or the whole clip if the foot does not return.
    motion = Motion.load(frame_results)
    states, joints_m = (np.full_like(values, np.nan) for values in (motion.states, motion.solution.joints_m))
    states[frames], joints_m[frames] = motion.states[frames], motion.solution.joints_m[frames]
    short = replace(motion, solution=replace(motion.solution, states=states, joints_m=joints_m))
    analysis = ClipAnalysis(short)
    portrait = analysis.portraits["theta_1"]
    moving = portrait.time_s[np.isfinite(portrait.angle_rad)]
    for dim in (2, 3):
        limb = limb_of(short, dim=dim)
        stride = stride_of(short, limb)
        assert stride.origin == how
        assert limb.first_s + np.array([stride.start_s, stride.end_s]) == pytest.approx(moving[[0, -1]], abs=0.1 / 30)
        shown = animal_portraits(short, limb, stride)["theta_1"]
        assert shown.time_s == pytest.approx(moving)
    assert bool(analysis.closures) == (how != "whole clip")


def test_jitter_across_the_direction_of_travel_does_not_affect_the_return(frame_results, monkeypatch):
    # Only the motion in the plane of travel counts, because one camera hardly shows the motion across it.
    monkeypatch.setattr(ClipAnalysis, "gait", None)  # the jitter would be detected as footfalls
    motion = Motion.load(frame_results)
    states, joints_m = (np.full_like(values, np.nan) for values in (motion.states, motion.solution.joints_m))
    states[:13], joints_m[:13] = motion.states[:13], motion.solution.joints_m[:13]
    expected = ClipAnalysis(replace(motion, solution=replace(motion.solution, states=states, joints_m=joints_m))).stride
    foot = motion.names.index(motion.foot_names["RF"])
    across = np.cross(motion.camera.up, motion.solution.joints_m[12, 0] - motion.solution.joints_m[0, 0])
    joints_m[:13, foot] += np.where(np.arange(13)[:, None] % 4 < 2, 0.3, -0.3) * across / np.linalg.norm(across)
    restless = ClipAnalysis(replace(motion, solution=replace(motion.solution, states=states, joints_m=joints_m))).stride
    assert restless.at == expected.at == "return"
    assert restless.end_s - restless.start_s == pytest.approx(expected.end_s - expected.start_s, rel=0.15)


def test_analyse_and_ik_describe_the_nearest_return_in_the_same_words(frame_results, tmp_path):
    folder, motion = tmp_path / "fit", Motion.load(frame_results)
    states, joints_m = motion.states.copy(), motion.solution.joints_m.copy()
    states[13:] = joints_m[13:] = np.nan
    short = replace(motion, solution=replace(motion.solution, states=states, joints_m=joints_m))
    short.save(folder)
    start_s = ClipAnalysis(short).stride.start_s
    follow = "--follow", "stride", "--dim"
    for i, arguments in enumerate((("analyse",), ("ik", *follow, "2"), ("ik", *follow, "3"))):
        done = run(*arguments, folder, "--no-figures", "--out", tmp_path / str(i))
        assert says(" ".join(done.out.split()), f"{start_s:.3f} to", f"s, {STRIDE_WORDS['return'].ends}")


def test_a_given_stride_is_used(frame_results, tmp_path):
    ask = ("--follow", "stride", "--no-figures", "--json")
    done = run("ik", frame_results, *ask, "--stride", "0.4333:0.735", "--out", tmp_path / "a")
    stride = json.loads(done.out)["stride"]
    assert (stride["how"], stride["start_s"], stride["end_s"]) == (
        "given",
        pytest.approx(13 / 30),
        pytest.approx(0.735, abs=1e-4),
    )
    for given, *expected in (("0.4", "stride", "'0.4'", "START:END"), ("0.5:3", "times", "0.5:3", "0.000 and 0.967 s")):
        for command in (("ik", *ask), ("analyse",), ("retarget", "--robot", "a1")):
            args = (command[0], frame_results, *command[1:], "--stride", given, "--out", tmp_path / "b")
            refused(args, ("--stride", *expected))


def test_duration_range_of_a_stride_in_a_clip_without_a_complete_stride():
    # The first stride of the cut gallop can last 0.31 s.
    for frames, at_most in ((16, 0.4), (11, np.inf)):
        clip = gallop(fps=30, n_frames=frames)
        gait = pose_gait(Pose3D(clip.names, clip.truth_m, np.arange(frames)), 30)
        least_s, most_s = stride_duration_range_s(gait)
        assert 0.08 < least_s < true_stride_s(0) < most_s
        assert most_s <= at_most
        longer_than_the_clip = stride_duration_range_s(replace(gait, stride_s=1.2 * frames / 30))
        assert longer_than_the_clip == stride_duration_range_s(replace(gait, stride_s=np.nan))


def test_a_clip_without_a_stride_is_reported(frame_results, tmp_path):
    folder, motion = tmp_path / "fit", Motion.load(frame_results)
    states, joints_m = motion.states.copy(), motion.solution.joints_m.copy()
    states[9:] = joints_m[9:] = np.nan  # frames without a pose
    replace(motion, solution=replace(motion.solution, states=states, joints_m=joints_m)).save(folder)
    done = run_ik(IkSettings(folder=folder, follow="stride", dim=2, out=tmp_path / "a", figures=False))
    assert done.summary["stride"]["how"] in ("return", "whole clip")
    assert done.runs["follow"]["damped"].distance_m.max() < 0.02


@pytest.mark.parametrize(
    ("options", "expected"),
    [
        ((), ("options", "task", "none", "--target, --follow stride, --compare or --costs")),
        (("--follow", "circle"), ("--follow", "follow", "'circle'", "stride")),
        (("--method", "magic", "--target", "stride-max"), ("--method", "method", "'magic'", "least-norm, transpose")),
        (("--target", "1,2"), ("--target", "target", "'1,2'", ["stride-max", "3 coordinates"])),
        (("--target", "here"), ("--target", "target", "'here'", ["stride-max", "3 coordinates"])),
        (("--target", "stride-max", "--foot", "XX"), ("--foot", "foot", "'XX'", "LF (l_front_paw)")),
        (("--target", "stride-max", "--method", "extended"), ("--method", "method", "extended", "--cost")),
        (
            ("--compare", "--cost", "energy,foo=2"),
            ("--cost", "cost", "'foo=2'", "differences, energy, harmonic, pose"),
        ),
        (("--compare", "--alpha", "large"), ("--alpha", "alpha", "'large'", "step, or a number")),
        (("--compare", "--alpha", "0"), ("--alpha", "alpha", 0)),
    ],
)
def test_bad_options_are_reported(whole_results, tmp_path, options, expected):
    refused(["ik", whole_results, "--out", tmp_path / "a", *options], expected)
    assert not (tmp_path / "a").exists()


def test_tables_are_written_if_figures_fail(whole_results, tmp_path, monkeypatch):
    def full(*args: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("recon.ik.clip.write_figures", full)
    done = run("ik", whole_results, "--method", "damped", "--target", "0.7,0.1,-0.4", "--out", tmp_path / "a")
    assert done.code == 2
    assert "No space left on device" in done.err
    assert {"ik.json", "target.csv"} <= {path.name for path in (tmp_path / "a").iterdir()}


def test_earlier_results_are_kept(compared):
    folder = compared
    refused(["ik", folder, "--target", "stride-max", "--no-figures"], ("--out", "folder", folder / "ik", "--overwrite"))


@pytest.mark.slow
def test_costs_behave_as_published(frame_results, tmp_path, monkeypatch):
    # The paths of the pose distance close; the paths of the harmonic map are singular or chaotic.
    shorten_cost_study(monkeypatch)
    options = {"costs": True, "follow": "stride", "dim": 2, "figures": False, "out": tmp_path / "a"}
    solved = run_ik(IkSettings(folder=frame_results, **options))
    costs = pd.read_csv(tmp_path / "a" / "costs.csv", index_col="cost")
    assert list(costs.index) == ["differences", "energy", "harmonic", "pose"]
    assert costs.loc["pose", "outcome"] == "convergent"
    assert costs.loc["harmonic", "outcome"] in ("singular", "chaotic")
    assert costs.loc["harmonic", "growth"] > 1 > costs.loc["pose", "growth"]
    closures = pd.read_csv(tmp_path / "a" / "closures.csv", index_col="joint")
    stride = ClipAnalysis(solved.motion)
    for joint in ("theta_1", "theta_4"):
        assert closures.loc[joint, "animal_angle"] == pytest.approx(stride.closures[joint].angle, abs=10)
    assert {"animal_unscaled", "damped_unscaled"} <= {*closures.columns}


def test_each_frame_has_parameters_and_the_extended_jacobian_an_alpha(frame_results):
    results = Motion.load(frame_results)
    limb = limb_of(results, dim=2)
    series, _ = fit_parameter_series(limb, stride_of(results, limb))
    joints = limb.chain.names
    vector = series[[f"constant-vector_g{k}_{joint}" for k, joint in enumerate(joints, 1)]].to_numpy()
    assert np.isfinite(vector).all()
    assert np.ptp(vector) > 1
    assert series["extended-energy_explained"].max() <= 1
    assert series["extended-energy_best_alpha"].std() > 0
    figure = parameter_series(series, joints)
    assert [axes.get_ylabel().split("\n")[0] for axes in figure.axes][:4] == [
        "damping",
        "weights w,",
        "vector g",
        "k (1/s)",
    ]
    legend = [text.get_text() for text in figure.axes[2].get_legend().get_texts()]
    assert legend == ["g1, theta_9", "g2, theta_1", "g3, theta_2", "g4, theta_3", "g5, theta_4"]
