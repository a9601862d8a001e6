"""Test `recon analyse` against independent arithmetic, and its files and messages."""

from __future__ import annotations

import json
import re
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from command_line import refusal, refused, run, says
from figure_texts import beyond_axes, cut_off
from scipy.spatial.transform import Rotation

from recon import ClipAnalysis, analyse
from recon.api.analyse import DEFAULT_FIGURES, figures_of, notes, summarise
from recon.fit import constants
from recon.fit.motion import Motion
from recon.gait.clip import POSE_ERROR_TIME, error_time_s, limb_chains
from recon.gait.kinematics import at_frames
from recon.io.positions import read_pose3d
from recon.show.plots import style
from recon.show.report import build_report
from recon.show.sentences import result_sentences
from recon.show.tables import TABLES, angle_rates, joints, reference, write_analysis

SAMPLES = Path(__file__).parents[2] / "data" / "samples"


@pytest.fixture(scope="module")
def whole(whole_analysis: ClipAnalysis) -> ClipAnalysis:
    return whole_analysis


@pytest.fixture(scope="module")
def one_sided(frame_results) -> ClipAnalysis:
    return analyse(Motion.load(frame_results))


@pytest.fixture(scope="module")
def chain(chain_results) -> ClipAnalysis:
    return analyse(Motion.load(chain_results))


@pytest.fixture(scope="module")
def tables(whole, tmp_path_factory) -> dict[str, pd.DataFrame]:
    folder = tmp_path_factory.mktemp("tables")
    write_analysis(whole, folder)
    assert {path.name for path in folder.iterdir()} == {*TABLES}
    return {path.stem: pd.read_csv(path) for path in folder.iterdir()}


def test_velocities_are_central_differences_to_third_order(whole, tables):
    position = whole.pose.xyz_m[:, whole.pose.names.index("spine")]
    central = (position[2:] - position[:-2]) * 30
    found = tables["velocities"][[f"spine_v{axis}_m_s" for axis in "xyz"]].to_numpy()
    assert np.abs(found[2:-2] - central[1:-1]).max() < 0.06
    np.testing.assert_array_equal(tables["velocities"]["frame"], np.arange(60))
    # The distance is the sum of the steps on the fine grid.
    path = tables["reference"][["x_m", "y_m", "z_m"]].to_numpy()
    row = tables["joints"].set_index("joint").loc["spine"]
    assert row["distance_m"] == pytest.approx(np.linalg.norm(np.diff(path, axis=0), axis=1).sum())
    assert row["mean_speed_m_s"] == pytest.approx(row["distance_m"] / (59 / 60), abs=1e-4)
    peak = tables["reference"]["speed_m_s"].idxmax()
    assert row["peak_speed_m_s"] == tables["reference"]["speed_m_s"][peak]
    assert row["peak_speed_sigma_m_s"] == tables["reference"]["speed_sigma_m_s"][peak]
    assert row["peak_speed_time_s"] == pytest.approx(tables["reference"]["time_s"][peak])


def test_tables_have_the_decimals_of_their_units(whole, tables):
    exact = reference(whole)
    for column, digits in {"speed_m_s": 4, "x_m": 5, "time_s": 6, "ax_m_s2": 3}.items():
        np.testing.assert_array_equal(tables["reference"][column], np.round(exact[column], digits))
    flexion = tables["joint_flexion"].filter(like="_deg").to_numpy()
    np.testing.assert_array_equal(flexion, np.round(flexion, 3))


def test_stated_velocity_errors_are_as_large_as_true_errors(whole):
    truth = read_pose3d(SAMPLES / "whole_truth.csv").xyz_m
    z = []
    for j, moved in enumerate(whole.joints.values()):
        series = at_frames(moved.series)
        true = (truth[2:, j] - truth[:-2, j]) * 30
        z.append((series.rate[1:-1] - true) / series.rate_sigma[1:-1])
    assert 0.3 < np.sqrt(np.mean(np.square(z))) < 1.5


def test_errors_of_a_slower_animal_last_longer(whole):
    # Errors of poses last at most as long as errors of detections, which is also the value without a pose.
    pose_m = whole.motion.upright.xyz_m
    runs_s = error_time_s(pose_m, 120.0)
    assert error_time_s(pose_m, 60.0) == pytest.approx(np.sqrt(2) * runs_s)
    assert error_time_s(pose_m, 1.0) == error_time_s(np.full_like(pose_m, np.nan), 60.0) == constants.ERROR_TIME_S
    size, position, pose = (error.correlation_s for error in whole.errors)
    assert size == np.inf
    assert position > pose == pytest.approx(POSE_ERROR_TIME * error_time_s(pose_m, whole.motion.fps))


def test_speed_is_proportional_to_size(whole):
    solution, size_given = whole.motion.solution, whole.moved(whole.reference, with_size=False).series
    series = whole.reference_motion.series
    by_size = series.rate_sigma**2 - size_given.rate_sigma**2
    np.testing.assert_allclose(by_size, (solution.size_sigma / solution.size * series.rate) ** 2, rtol=1e-6, atol=1e-9)
    np.testing.assert_array_equal(series.rate, size_given.rate)


def test_uncertainty_of_position_does_not_widen_angles(whole):
    """Standard deviations of angles exclude the error of the position, which would multiply them several times."""
    knee = whole.angles["l_back_knee"]
    assert np.degrees(np.median(knee.series.value_sigma)) < 30
    points = whole.pose.xyz_m[:, [whole.pose.names.index(n) for n in ("l_hip", "l_back_knee", "l_back_ankle")]]
    u, v = points[:, 0] - points[:, 1], points[:, 2] - points[:, 1]
    cosine = np.sum(u * v, axis=1) / np.linalg.norm(u, axis=1) / np.linalg.norm(v, axis=1)
    np.testing.assert_allclose(knee.series.value[::10, 0], np.arccos(cosine), atol=1e-9)


def test_chains_begin_with_the_trunk(whole, one_sided):
    chains = limb_chains(whole.motion)
    assert chains["trunk"] == ("tail_base", "spine", "neck_base")
    assert chains["left hind leg"][:3] == ("spine", "tail_base", "l_hip")
    assert chains["right front leg"][:3] == ("spine", "neck_base", "r_shoulder")
    assert "eyes" not in chains
    assert limb_chains(one_sided.motion) == {
        "hind leg": ("spine", "tail_base", "r_back_knee", "r_back_ankle", "r_back_paw"),
        "spine": ("tail_base", "spine", "neck_base"),
        "front leg": ("spine", "neck_base", "r_front_knee", "r_front_ankle", "r_front_paw"),
    }


def test_events_are_near_the_events_of_the_true_joints(whole, tables):
    """Every true stance is found, with its ends within two frames."""
    assert whole.gait.name.name == "transverse gallop"
    table = tables["stances"]
    ground = table[(table.begins == "yes") & (table.ends == "yes")]
    assert len(ground) >= 10
    np.testing.assert_allclose(ground["start_frame"], 60 * ground["start_s"], atol=4e-5)
    np.testing.assert_allclose(ground["duration_s"], ground["end_s"] - ground["start_s"], atol=2e-6)
    # In the middle of its stance, a foot has less than a quarter of the body's speed.
    tracks = whole.gait.tracks
    for row in ground.to_dict("records"):
        at = int(np.argmin(np.abs(tracks.time_s - (row["start_s"] + row["end_s"]) / 2)))
        of_foot = tracks.foot_speed_m_s[at, tracks.feet.index(row["foot"])]
        assert of_foot < 0.25 * whole.joints["spine"].speed_m_s[at]


def test_strides_and_closures(whole, tables):
    strides = tables["strides"]
    assert (strides["frequency_hz"] * strides["duration_s"]).to_numpy() == pytest.approx(1.0, abs=1e-4)
    row = tables["gait"].iloc[0]
    of_method = strides
    assert row["strides"] == len(of_method)
    assert row["stride_length_m"] == pytest.approx(of_method["length_m"].mean(), abs=1e-5)
    assert whole.stride is not None
    closures = tables["closures"].set_index("angle")
    assert {*closures.index} == {*whole.motion.posture_names}
    angle = whole.skeleton_angles["l_hind_thigh_pitch"].series
    inside = (angle.time_s >= whole.stride.start_s - 1e-9) & (angle.time_s <= whole.stride.end_s + 1e-9)
    path = angle.value[inside, 0]
    expected = 100 * (1 - abs(path[-1] - path[0]) / np.ptp(path))
    assert closures.loc["l_hind_thigh_pitch", "closure_angle_percent"] == pytest.approx(expected, abs=1e-5)


def test_closures_have_sigma_and_information_fraction(whole, tables):
    closures = tables["closures"].set_index("angle")
    assert dict(closures["data_share"]) == pytest.approx(whole.motion.data_shares, abs=1e-5)
    assert closures["closure_angle_sigma_percent"].between(5, 35).all()
    assert closures["closure_plane_sigma_percent"].between(5, 35).all()
    angles = tables["joint_angles"].set_index("angle")
    assert angles.loc["head_roll", "data_share"] == closures.loc["head_roll", "data_share"] < 0.1
    assert angles.loc["spine_flexion", ["data_share"]].isna().all()


@pytest.mark.parametrize("fit", ["one_sided", "chain"])
def test_transverse_angles_are_not_visible_from_the_side(fit, request):
    found = request.getfixturevalue(fit)
    phis = [name for name in found.motion.posture_names if name.startswith("phi")]
    assert {*phis} < {*found.not_measured}
    assert not any(name.startswith("theta") for name in found.not_measured)
    # Without the path, which couples the frames, these information fractions are at most 0.015.
    assert max(found.motion.data_shares[name] for name in phis) < {"one_sided": 0.03, "chain": 0.02}[fit]
    assert summarise(found, "clip")["angles"]["not_measured"] == [*found.not_measured]
    assert f"grey in figures: {', '.join(found.not_measured)}." in [*notes(found)][fit == "one_sided"]


def test_strides_slower_than_a_free_leg_swing_are_noted(whole):
    moved, gait = whole.reference_motion, whole.gait
    slow = replace(gait, stride_frequency_hz=0.4)
    swing_s = 2 * np.pi * np.sqrt(2 * gait.tracks.leg_m / (3 * 9.81))
    said = f"Strides last 2.5 s, longer than one period of a leg that swings freely ({swing_s:.1f} s)"
    *_, last = result_sentences(whole.motion, moved, slow, None)
    assert last.startswith(said)
    assert not any("swings" in sentence for sentence in result_sentences(whole.motion, moved, gait, None))


@pytest.mark.parametrize("fit", ["one_sided", "chain", "whole"])
def test_strides_have_the_frequency_of_the_sample(fit, request):
    """The sample gallops at 3.2 to 3.4 strides per second."""
    found = request.getfixturevalue(fit)
    if found.gait.strides:
        assert 0.285 < found.stride.end_s - found.stride.start_s < 0.335
        assert found.gait.stride_frequency_hz == pytest.approx(3.3, rel=0.05)
    else:
        assert found.stride is None


def test_a_stride_can_be_given(chain_results, tmp_path):
    done = run("analyse", chain_results, "--stride", "0.31:0.62", "--out", tmp_path / "a", "--no-figures", "--json")
    stride = json.loads(done.out)["stride"]
    # It begins at the nearest of 30 frames a second, as in inverse kinematics.
    assert stride == {"foot": "", "start_s": 0.3, "end_s": pytest.approx(0.61), "by": "given"}
    assert {*pd.read_csv(tmp_path / "a" / "closures.csv").start_s} == {0.3}


def test_vector_field_of_a_knee(whole, tables):
    """The speed of a knee about the hip is the length of the thigh times the rate of its angle, in the plane."""
    field = tables["vector_field"]
    rows = field[(field.limb == "left hind leg") & (field.link == "l_back_knee-l_back_ankle")]
    radius, dtheta, dr = (rows[name].to_numpy() for name in ("radius_m", "dtheta_rad_s", "dr_m_s"))
    np.testing.assert_allclose(rows["speed_m_s"], np.hypot(dr, radius * dtheta), atol=2e-4)
    means = tables["vector_field_means"].set_index("link")
    assert means.loc["l_back_knee-l_back_ankle", "speed_m_s"] == pytest.approx(rows["speed_m_s"].mean(), abs=1e-4)
    assert means.loc["l_back_knee-l_back_ankle", "frames"] == 60
    # The error of the speed is the radius times the error of the rate, since links are rigid and in the plane.
    about = rows["speed_sigma_m_s"] / (radius * rows["dtheta_sigma_rad_s"])
    assert about.median() == pytest.approx(1.0, abs=0.02)
    assert 1.0 < means.loc["l_back_knee-l_back_ankle", "speed_sigma_m_s"] < 2.5


def test_the_frame_methods_path_has_the_true_speed(one_sided):
    """The path of the frame method has the speed of the true joints within its intervals."""
    truth = read_pose3d(SAMPLES / "noisy_truth.csv")
    true = truth.xyz_m[:, truth.names.index("tail_base")]
    speed = np.linalg.norm(true[2:] - true[:-2], axis=1) * 15
    moved = one_sided.joints["tail_base"]
    error = moved.speed_m_s[10:-10:10] - speed
    assert np.sqrt(np.mean(error**2)) < 0.8
    assert np.mean(np.abs(error) < 1.645 * moved.speed_sigma_m_s[10:-10:10]) >= 0.8
    np.testing.assert_allclose(
        one_sided.pose.xyz_m[:, 0], one_sided.joints[one_sided.pose.names[0]].series.value[::10], atol=1e-12
    )


def test_without_a_path_the_straight_run_has_the_speed(frame_results, one_sided):
    """Without a path, the speed is computed for a straight run, as in the fit's summary, and is right to 10 %."""
    motion = Motion.load(frame_results)
    as_text = dict(build_report(motion)["lines"])
    assert as_text["speed"].startswith("at most 15.4 m/s")
    assert as_text["speed"].endswith("over a path of 13.4 m")
    assert summarise(one_sided, "clip")["speed"]["doubt"] is None
    free = replace(motion.solution, path=None)  # as with path=free
    as_text = dict(build_report(replace(motion, solution=free))["lines"])
    assert as_text["speed"].startswith("about 14 m/s if the animal ran straight; not known more closely: ")


def test_too_few_poses_are_refused(frame_results):
    motion = Motion.load(frame_results)
    joints_m = motion.solution.joints_m.copy()
    joints_m[3:] = np.nan
    with refusal(("noisy.csv", "frames", "3 frames", "at least 4")):
        analyse(replace(motion, solution=replace(motion.solution, joints_m=joints_m)))
    joints_m[3] = motion.solution.joints_m[3]
    found = analyse(replace(motion, solution=replace(motion.solution, joints_m=joints_m)))
    assert not np.isfinite(found.pose.xyz_m).any()
    assert found.end_effector is None
    assert found.stride is None


def test_a_motion_is_analysed_without_a_folder(small_trajectory):
    """A motion that was just fitted is analysed without any folder."""
    found = analyse(small_trajectory)
    assert found.joints["spine"].mean_speed_m_s == pytest.approx(9.0, abs=0.05)
    moved, off = found.reference_motion, {"peak_speed_m_s": 10.0, "peak_speed_sigma_m_s": 11.0}
    assert says(next(result_sentences(found.motion, moved, None, None)), "at most", "m/s (90 %:", "to")
    uncertain = replace(moved, peak_speed_m_s=10.0, peak_speed_sigma_m_s=9.0)
    assert next(result_sentences(found.motion, uncertain, None, None)).endswith("(90 %: at most 24).")
    exact = replace(moved, peak_speed_sigma_m_s=np.nan)
    assert next(result_sentences(found.motion, exact, None, None)).endswith(" m/s.")
    assert next(result_sentences(found.motion, replace(moved, **off), None, None)).endswith(" m/s on average.")


FIGURES = (
    "forces",
    "body_fixed",
    "body_fixed_left_front_leg",
    "body_fixed_left_hind_leg",
    "body_fixed_right_front_leg",
    "body_fixed_right_hind_leg",
    "body_fixed_spine",
    "composites",
    "footfalls",
    "joint_flexion",
    "observability",
    "phase_portraits",
    "phase_portraits_all",
    "side_view",
    "speed",
    "vector_field_head",
    "vector_field_left_front_leg",
    "vector_field_left_hind_leg",
    "vector_field_right_front_leg",
    "vector_field_right_hind_leg",
    "vector_field_tail",
    "vector_field_trunk",
)


QUICK_FIGURES = ("forces", "footfalls", "side_view", "speed")


@pytest.mark.parametrize(
    "name",
    [pytest.param(name, marks=[pytest.mark.slow] * (name not in QUICK_FIGURES)) for name in FIGURES],
)
def test_each_figure_is_drawn_with_all_its_text(name, whole):
    """The files `test_plots.py`, `test_configurations.py` and `test_figure_for_print.py` check what figures show."""
    figure = figures_of(whole)[name]()
    assert cut_off(figure) == []
    assert figure.get_size_inches()[1] / style.MM < 275
    assert all(axes.has_data() or axes.texts for axes in figure.axes if axes.axison)  # a panel without data says why


@pytest.mark.slow
@pytest.mark.parametrize("fit", ["one_sided", "chain", "whole"])
def test_axes_show_all_data_and_text_of_each_figure(fit, request):
    figures = {name: draw() for name, draw in figures_of(request.getfixturevalue(fit)).items()}
    assert {name: texts for name, figure in figures.items() if (texts := cut_off(figure))} == {}
    assert {name: lines for name, figure in figures.items() if (lines := beyond_axes(figure))} == {}


@pytest.mark.parametrize("name", ["speed", *(pytest.param(n, marks=pytest.mark.slow) for n in FIGURES if n != "speed")])
def test_each_figure_can_be_saved(name, whole, tmp_path):
    figures_of(whole)[name]().savefig(tmp_path / "figure.svg")  # as PNG too: test_plots.py
    assert (tmp_path / "figure.svg").stat().st_size > 5000


def test_an_uncertain_acceleration_is_stated_in_words(whole):
    """The figure of an acceleration that is hardly known states this in the words of the page."""
    why = whole.reference_motion.why_no_acceleration
    figure = figures_of(whole)["speed"]()
    assert [axes.get_ylabel() for axes in figure.axes] == ["speed (m/s)"]
    assert says(figure.get_suptitle(), "acceleration", "not shown")
    assert figure.get_suptitle() == why
    known = np.full_like(whole.reference_motion.acceleration_sigma_m_s2, 1e-3)
    assert replace(whole.reference_motion, acceleration_sigma_m_s2=known).why_no_acceleration == ""


# Command line


def test_command_writes_tables_figures_and_plots(of_results, whole_results, monkeypatch):

    printed, ran_in = of_results("recon analyse results/clip")
    monkeypatch.chdir(ran_in)
    folder = Path("results/clip")
    results = {path.name: path.read_bytes() for path in whole_results.iterdir()}
    for name in ("config.toml", "manifest.json"):  # the copy's paths are relative to its own folder
        results[name] = (folder / name).read_bytes()
        assert (folder / name).stat().st_mtime_ns < (folder / "analysis").stat().st_mtime_ns
    assert "transverse gallop" in printed
    assert "at most 16" in printed
    assert says(printed, "Peak vertical force of a foot: 2.", "body weights (90 %: 1.", "forces.csv")
    labels = [line.partition(": ")[0] for line in printed.splitlines() if ": " in line and not line.startswith("note")]
    assert len(set(labels)) == len(labels)
    written = {path.name for path in (folder / "analysis").iterdir()}
    assert {*TABLES, "analysis.json"} <= written
    assert {path.name: path.read_bytes() for path in folder.iterdir() if path.is_file()} == results
    assert f"playback: recon view {folder}\n" in printed
    assert {name for name in written if name.endswith((".png", ".svg"))} == {
        f"{figure}.{suffix}" for figure in DEFAULT_FIGURES for suffix in ("png", "svg")
    }
    summary = json.loads((folder / "analysis" / "analysis.json").read_text(encoding="utf-8"))
    assert summary["gait"]["name"] == "transverse gallop"
    assert summary["speed"]["peak_m_s"] == pytest.approx(16.05, abs=0.3)


@pytest.mark.usefixtures("remembered_analyses")
def test_command_replaces_an_analysis_only_with_overwrite(of_results, tmp_path, monkeypatch):
    _, ran_in = of_results("recon analyse results/clip")
    monkeypatch.chdir(shutil.copytree(ran_in, tmp_path / "ran"))
    folder = Path("results/clip")
    summary = json.loads((folder / "analysis" / "analysis.json").read_text(encoding="utf-8"))
    refused(["analyse", folder], ("--out", "folder", ["analysis.json", folder / "analysis"], "--overwrite"))
    as_json = run("analyse", folder, "--overwrite", "--no-figures", "--json")
    assert json.loads(as_json.out) == summary


def test_command_reports_missing_results(frame_results, tmp_path):
    folder = shutil.copytree(frame_results, tmp_path / "fit")
    done = run("analyse", folder, "--out", tmp_path / "a", "--no-figures")
    assert done.code == 0
    assert says(" ".join(done.out.split()), "Only the feet", "smoothed")
    refused(["analyse", tmp_path / "nothing"], (tmp_path / "nothing", "folder", "no such folder", "recon fit"))
    refused(["analyse", SAMPLES / "whole.csv"], (SAMPLES / "whole.csv", "folder", "a file", "recon fit"))


@pytest.mark.usefixtures("remembered_analyses")
def test_quiet_prints_nothing_and_many_stances_are_not_listed(whole_results, tmp_path, monkeypatch):
    quiet = run("analyse", whole_results, "--out", tmp_path / "a", "--no-figures", "--quiet")
    assert (quiet.code, quiet.out, quiet.err) == (0, "", "")
    monkeypatch.setattr("recon.cli.analyse.MAX_STANCES", 3)
    many = run("analyse", whole_results, "--out", tmp_path / "b", "--no-figures")
    assert "LH l_back_paw" not in many.out
    strides = r"Strides are 4\.\d m \(90 %: 3\.\d to \d\.\d\) long, 3\.\d+ Hz \(90 %: \d[.\d]* to \d[.\d]*\)"
    averaged = rf"{strides}, averaged over [5-9] strides \(\d to \d of each foot\); a foot"
    assert re.search(averaged, " ".join(many.out.split())), many.out


def test_known_standard_deviations_of_angles_are_in_the_table(whole, one_sided):
    with_sigma = {"spine_flexion_sigma_rad", "spine_flexion_rate_sigma_rad_s"}
    assert with_sigma <= {*angle_rates(whole)}
    columns = angle_rates(one_sided)
    assert not with_sigma & {*columns}
    assert {"spine_flexion_rad", f"{one_sided.motion.posture_names[0]}_sigma_rad"} <= {*columns}


def test_the_back_bends_at_the_spine_of_the_anatomy(whole):
    """The back bends at the spine of the anatomy, even if a marker on the skin above it follows in the trunk's limb."""
    solution, body = whole.motion.solution, whole.motion.body
    limbs = body.limbs | {"trunk": ("tail_base", "spine", "r_shoulder", "neck_base")}
    assert body.limbs["trunk"] == body.anatomy["spine"] == ("tail_base", "spine", "neck_base")
    longer = replace(whole.motion, solution=replace(solution, body=replace(body, limbs=limbs)))
    found = analyse(longer).angles["spine_flexion"]
    np.testing.assert_array_equal(found.series.value, whole.angles["spine_flexion"].series.value)


def test_a_back_of_one_segment_has_no_flexion(whole):
    """A back of one segment has no flexion, even if it rolls and seems to bend in the vertical plane."""
    solution, rolls = whole.motion.solution, Rotation.from_euler("x", np.linspace(0.0, 0.5, 60)[:, None]).as_matrix()
    stiff_m = np.einsum("tab,jb->tja", rolls, solution.joints_m[0])
    stiff = analyse(replace(whole.motion, solution=replace(solution, joints_m=stiff_m)))
    assert {*whole.angles} - {*stiff.angles} == {"spine_flexion"}


@pytest.mark.usefixtures("remembered_analyses")
def test_tables_are_written_even_if_figures_fail(whole_results, tmp_path, monkeypatch):
    def full(*args: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("recon.api.analyse.write_figures", full)
    done = run("analyse", whole_results, "--out", tmp_path / "a")
    assert done.code == 2
    assert "No space left on device" in done.err
    written = {*TABLES, "analysis.json", ".recon.json"}
    assert {path.name for path in (tmp_path / "a").iterdir()} == written


def test_unknown_speeds_are_not_in_tables_and_drawn_grey(whole, one_sided):
    """Speeds of the frame method that are not known are missing from the tables and grey in figures."""
    columns, rows = joints(whole)
    assert {row[-1] for row in rows} == {"yes"}
    assert np.isfinite([row[1] for row in rows]).all()
    motion = one_sided.motion
    path = motion.solution.path
    uncertain = replace(path, covariance=100 * path.covariance)
    spoilt = replace(motion, solution=replace(motion.solution, path=uncertain))
    found = analyse(spoilt)
    assert found.why_no_speed is not None
    columns, rows = joints(found)
    assert columns[-1] == "known"
    assert all(row[-1] == "no" and np.isnan(row[1:-1]).all() for row in rows)
    figure = figures_of(found)["speed"]()
    assert "not known" in figure.legends[0].get_texts()[0].get_text()
    low, high = summarise(found, "clip")["speed"]["net_acceleration_interval_m_s2"]
    known_low, known_high = summarise(one_sided, "clip")["speed"]["net_acceleration_interval_m_s2"]
    assert high - low > known_high - known_low


def test_the_summary_and_the_analysis_have_the_same_stances(whole):
    report = build_report(whole.motion)
    for foot, joint in whole.motion.foot_names.items():
        own = [s for s in whole.gait.stances if s.foot == foot]
        assert report["stances"][joint] == [[round(s.start_row), round(s.end_row) + 1] for s in own]
