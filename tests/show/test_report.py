"""Test that the report is plain JSON and complete, and that its counts are right."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from io import StringIO
from pathlib import Path

import numpy as np
import pytest
from command_line import says
from motions import with_first
from rich.console import Console

from recon.base.arrays import to_plain
from recon.base.numbers import plus_minus
from recon.check.codes import finding, sentence
from recon.check.rules import findings_of
from recon.fit.result import MotionSegment, SecondCamera
from recon.show import report as reports
from recon.show.console import FRONT, TO_DO, console_summary, reason_finding
from recon.show.plain import write_report
from recon.show.report import SCHEMA_VERSION, is_unsolved
from recon.thesis.solution import in_world

DOCS = Path(__file__).resolve().parents[2] / "docs" / "report.md"


def build_report(motion, settings=None, timing_s=None):
    """Return the report of a motion, with the findings recomputed."""
    motion = replace(motion, settings=settings or {}, timing_s=timing_s or {})
    return reports.build_report(replace(motion, findings=findings_of(motion)))


def summary_lines(report):
    return [(label, text) for label, text in report["lines"]]


def codes(report):
    return [one["code"] for one in report["findings"]]


def numbers(report, code):
    """Return the numbers of a report's finding with a code."""
    (found,) = (one["numbers"] for one in report["findings"] if one["code"] == code)
    return found


@pytest.fixture(scope="module")
def report(small_motion):
    return build_report(small_motion, {"form": "deadband", "base_length_m": None}, {"solve_s": 0.3})


@pytest.fixture(scope="module")
def trajectory(small_trajectory):
    return build_report(small_trajectory, {"subject": None, "size_sigma": None}, {"solve_s": 0.5})


def with_solution(motion, **changes):
    return replace(motion, solution=replace(motion.solution, **changes))


def with_states(motion, states, reports=None):
    """Return a motion of the frame method whose chain has other states."""
    was = motion.solution
    covariance = np.tile(np.eye(states.shape[1]), (len(states), 1, 1))
    told = {name: getattr(was, name) for name in ("travel", "objectives", "fps")} | {"reports": reports or was.reports}
    return replace(motion, solution=in_world(was.views[0], was.chain, states, covariance, **told))


@pytest.mark.parametrize("method", ["frame", "trajectory"])
def test_is_plain_json_that_reads_back(method, request, tmp_path):
    report = request.getfixturevalue("report" if method == "frame" else method)
    write_report(report, tmp_path / "report.json")
    text = (tmp_path / "report.json").read_text(encoding="utf-8")
    assert json.loads(text, parse_constant=lambda name: pytest.fail(name)) == report
    assert len(text) < 300_000 / 30 * 8
    assert report["method"] == method
    assert report["schema"] == {"name": "recon.fit.report", "version": SCHEMA_VERSION}


def test_text_with_brackets_and_lists_is_unchanged(tmp_path):
    report = {"a": "x [ y\nz ] [", "b": [1.5, None], "c": ["[ \\n ]", 'q"']}
    write_report(report, tmp_path / "report.json")
    text = (tmp_path / "report.json").read_text(encoding="utf-8")
    assert json.loads(text) == report
    assert '"b": [ 1.5, null ]' in text


def test_to_plain():
    given = {"a": np.float64(np.nan), "b": (np.int64(2), True, np.bool_(False)), "p": Path("x"), "f": 0.1 + 0.2}
    assert to_plain(given) == {"a": None, "b": [2, True, False], "p": "x", "f": 0.3}


def test_frames(small_motion):
    assert list(small_motion.flags) == [(), (), (), ("no data",), ("outliers",), ("few points",)]


def test_summary_adds_up(report, small_motion):
    summary = report["summary"]
    assert summary["frames"] == 6
    assert summary["frames_converged"] + summary["frames_not_converged"] + summary["frames_no_data"] == 6
    assert summary["frames_no_data"] == 1
    assert summary["detections"] == 41
    errors = np.sort(small_motion.pictures[0].distance_px[np.isfinite(small_motion.pictures[0].distance_px)])
    assert summary["reprojection_px"]["mean"] == pytest.approx(errors.mean())
    assert summary["reprojection_px"]["mean_best_90_percent"] == pytest.approx(errors[:37].mean())
    assert summary["reprojection_px"]["worst_joint"] == "neck_base"


def test_a_diverged_frame_is_flagged_and_not_in_the_medians(small_motion):
    states, reports = small_motion.solution.chain_states.copy(), list(small_motion.solution.reports)
    states[2] = np.nan
    reports[2] = replace(reports[2], status="not_converged", in_view=False)
    motion = with_states(small_motion, states, tuple(reports))
    report = build_report(motion, {})
    assert motion.flags[2] == ("diverged", "not converged")
    assert report["summary"]["frames_diverged"] == 1
    assert numbers(report, "frames_not_converged") == {"count": 1, "frames_total": 6}


def test_outliers_are_counted(report):
    rows = {row["name"]: row["outliers"] for row in report["keypoints"] if row["outliers"]}
    assert rows == {"neck_base": 1}
    assert report["summary"]["outliers"] == 1


def test_keypoints(report, small_motion):
    rows = {row["name"]: row for row in report["keypoints"]}
    assert list(rows) == [*small_motion.names, "nose"]
    for row in rows.values():
        assert row["used"] + row["missing"] + row["rejected"] == row["frames"] == 6
    assert rows["spine"]["rejected"] == 1
    assert rows["neck_base"]["outliers"] == 1
    assert rows["nose"]["joint"] is None
    assert report["unused_keypoints"] == ["nose"]
    assert report["missing_keypoints"] == []
    assert sum(r["used"] for r in rows.values() if r["joint"]) == report["summary"]["detections"]


def test_a_keypoint_that_the_file_lacks(small_motion):
    counts = {name: of for name, of in small_motion.cleaning.keypoints.items() if name != "spine"}
    names = tuple(name for name in small_motion.sources[0].file_names if name != "spine")
    motion = with_first(small_motion, cleaning=replace(small_motion.cleaning, keypoints=counts), file_names=names)
    report = build_report(motion, {})
    row = report["keypoints"][small_motion.names.index("spine")]
    assert (row["in_file"], row["used"], row["joint"]) == (False, None, "J9")
    assert report["missing_keypoints"] == ["spine"]


def test_the_scale_is_not_reported_as_measured(report):
    base = report["assumptions"]["base_length"]
    assert (base["nominal_m"], base["sigma_m"], base["measured"]) == (0.203, 0.02, False)
    assert base["data_share"] < 0.01
    assert report["assumptions"]["camera_level"] is True


def test_the_report_has_the_given_prior_of_the_base_length(small_motion):
    base = build_report(small_motion, {"base_length_m": 0.175, "base_sigma_m": 0.001})["assumptions"]["base_length"]
    assert (base["nominal_m"], base["sigma_m"]) == (0.175, 0.001)


def test_limits_are_counted(small_motion):
    skeleton, states = small_motion.solution.chain, small_motion.solution.chain_states.copy()
    theta, phi = skeleton.theta_slice.start, skeleton.phi_slice.start
    states[small_motion.solved, : 2 * skeleton.n_angles] = np.r_[skeleton.theta.mean_rad, skeleton.phi.mean_rad]
    states[1, theta + 3] += skeleton.theta.tolerance_rad[3] + 0.1
    states[[1, 2], phi] -= skeleton.phi.tolerance_rad[0] + 0.2
    motion = with_states(small_motion, states)
    ranges, rates = motion.solution.beyond_range_rad, motion.solution.beyond_rate_rad_s
    assert np.isfinite(rates).all(axis=1).sum() == 4
    assert ranges[1, theta + 3] == pytest.approx(0.1)
    assert ranges[1:3, phi] == pytest.approx(0.2)
    assert (ranges > 0).sum() == 3
    # theta_1 changes by 0.55 rad and back in 1/30 s; phi_6 changes by 0.7 rad, and back over two intervals.
    change = skeleton.theta.tolerance_rad[3] + 0.1
    excess = 2 * np.sin(change / 2) * 30 - skeleton.theta.max_rate_rad_s[3]
    assert (rates[:, theta + 3] > 0).sum() == 2
    assert np.nanmax(rates[:, theta + 3]) == pytest.approx(excess)
    assert (rates[:, phi] > 0).sum() == 2 - (2 * np.sin(0.35) * 15 < skeleton.phi.max_rate_rad_s[0])
    assert [("at range limit" in flags, "at rate limit" in flags) for flags in motion.flags][:3] == [
        *((False, False), (True, True), (True, True))
    ]


def test_root_path(report):
    path, exact = report["root_path"], report["root_path"]["exact"]
    assert exact["distance_m"] == pytest.approx(1.5, abs=0.02)
    assert exact["peak_speed_m_s"] >= exact["mean_speed_m_s"] == pytest.approx(9, abs=0.1)
    assert exact["smoothing_m"] is None
    assert path["smoothed"] is None  # too few consecutive frames to measure the jitter
    assert report["travel"]["median_speed_m_s"] == pytest.approx(9, abs=1)
    assert abs(report["travel"]["heading_to_picture_rad"]) < 0.1


def test_smoothed_root_path(small_motion):
    chain = small_motion.solution.chain
    states = np.tile(small_motion.solution.chain_states[0], (6, 1))
    rotation = chain.pose(states[:1]).rotation[0]
    jitter = 0.01 * np.array([1, -1, 1, -1, 1, -1])
    states[:, chain.position_slice] += np.stack([0.3 * np.arange(6), 0 * jitter, jitter], axis=1) @ rotation
    path = build_report(with_states(small_motion, states), {})["root_path"]
    assert path["smoothed"]["smoothing_m"] == path["jitter_m"]
    np.testing.assert_allclose(path["jitter_m"][:2], 0, atol=1e-6)
    assert path["smoothed"]["distance_m"] == pytest.approx(1.5, abs=5e-3)
    assert path["exact"]["distance_m"] > path["smoothed"]["distance_m"]
    assert path["smoothed"].keys() == path["exact"].keys()


def test_a_report_without_any_pose(small_motion):
    states = np.full_like(small_motion.solution.chain_states, np.nan)
    report = build_report(with_states(small_motion, states, (None,) * 6), {})
    json.dumps(report, allow_nan=False)
    assert report["summary"]["frames_no_data"] == 6
    assert report["summary"]["reprojection_px"]["worst_joint"] is None
    assert dict(summary_lines(report))["heading"]


def test_assumptions_about_a_file_are_in_the_summary(small_motion):
    """A note on a file, such as a missing header row, is in the summary once."""
    cleaning = replace(small_motion.cleaning, notes=("The header's first row is missing.",))
    lines = summary_lines(build_report(with_first(small_motion, cleaning=cleaning), {}))
    assert [value for label, value in lines if label == "note"] == ["The header's first row is missing."]


def test_console_summary(report):
    out = StringIO()
    Console(file=out, width=120).print(console_summary(report))
    text = out.getvalue()
    for expected in ("glide.csv", "5 of 6 converged", "all of the skeleton's 9 used; not used: nose", "9.0 m/s"):
        assert expected in text
    lines = str(summary_lines(report))
    assert "neck_base" in lines
    assert "0.203 m" in lines
    assert 10 <= len(summary_lines(report)) <= 16


def test_frames_of_a_trajectory(small_trajectory, two_cameras):
    """Flags, detections, weights and uncertainty of each frame are in the motion, not in the report."""
    motion = small_trajectory
    assert motion.frames.tolist() == list(range(10, 18))
    assert motion.flags == ((), (), (), ("no data",), (), ("data poor", "ambiguous depth"), (), ())
    assert motion.detections.tolist() == [23, 23, 23, 0, 23, 23, 23, 23]
    assert np.isnan(motion.mean_weight[3])
    assert motion.relative_rms_m[0] == pytest.approx(np.sqrt(2 * 0.02**2 + 0.08**2))
    assert two_cameras.detections[5] == 47
    off_px = two_cameras.pictures[1].image_error_px[5, two_cameras.names.index("tail_base"), 0]
    assert off_px == pytest.approx(-200)


def test_summary_of_a_trajectory_adds_up(trajectory):
    summary = trajectory["summary"]
    assert (summary["frames"], summary["frames_with_pose"], summary["frames_flagged"]) == (8, 8, 2)
    assert summary["flags"] == {
        "no data": 1,
        "diverged": 0,
        "data poor": 1,
        "ambiguous depth": 1,
        "left-right swap": 0,
        "gross outliers": 0,
    }
    assert summary["detections"] == 7 * 23
    assert summary["reprojection_px"]["mean"] == pytest.approx(300 / (7 * 23))
    assert summary["reprojection_px"]["worst_joint"] == "nose"
    assert summary["mean_weight"] == pytest.approx(1 - 0.95 / (7 * 23))


def test_keypoints_of_a_trajectory(trajectory, small_trajectory):
    rows = {row["name"]: row for row in trajectory["keypoints"]}
    assert list(rows) == [*small_trajectory.names, "ear"]
    assert (rows["nose"]["noise_px"], rows["nose"]["outliers"]) == (10, 1)
    assert rows["nose"]["mean_weight"] == pytest.approx((6 + 0.05) / 7)
    assert rows["ear"]["joint"] is rows["ear"]["noise_px"] is rows["ear"]["mean_weight"] is None
    assert (rows["r_eye"]["in_file"], rows["r_eye"]["mean_weight"]) == (False, None)
    assert trajectory["missing_keypoints"] == ["r_eye"]


def test_the_size_states_its_source(trajectory, small_trajectory):
    size = trajectory["size"]
    assert (size["factor"], size["sigma"], size["prior_sigma"], size["measured"]) == (1, 0.06, 0.1, False)
    assert size["data_share"] == pytest.approx(1 - 0.36)
    measured = with_solution(
        small_trajectory, body=replace(small_trajectory.body, subject="jules"), size_prior_sigma=0.06
    )
    given = build_report(measured, {"subject": "jules"})
    assert (given["size"]["prior_sigma"], given["size"]["data_share"]) == (0.06, 0)
    assert given["size"]["measured"] is True
    assumed = build_report(with_solution(small_trajectory, size_prior_sigma=0.06), {})
    assert assumed["size"]["measured"] is False
    seen = build_report(with_solution(small_trajectory, size_from=("prior", "views")), {})
    tall = build_report(small_trajectory, {"height_m": 0.8})
    assert seen["size"]["measured"] is tall["size"]["measured"] is True
    assert says(dict(summary_lines(seen))["size"], "the positions of the cameras")
    assert dict(summary_lines(tall))["size"] == "as given (height at the withers, --height-m 0.8), ±6 %"
    odd = build_report(with_solution(small_trajectory, size=0.7), {})
    assert numbers(odd, "size_unexpected") == {"size": 0.7, "expected_sigma": 0.1}
    odder = build_report(with_solution(small_trajectory, size=0.6), {})
    assert numbers(odder, "size_impossible") == {"size": 0.6, "expected_sigma": 0.1}


def test_ground_and_stances(trajectory, small_trajectory, world_trajectory):
    (segment,) = small_trajectory.solution.segments
    ground, below = trajectory["segments"][0]["ground"], small_trajectory.below_m(segment)[2]
    assert (ground["frame"], ground["sigma_m"], ground["slope"]) == ("level", 0.03, [0, 0.02])
    feet = {"LF": "l_front_paw", "RF": "r_front_paw", "LH": "l_back_paw", "RH": "r_back_paw"}
    assert trajectory["skeleton"]["feet"] == feet
    assert ground["height_m"] == pytest.approx(below) == -ground["camera_height_m"]
    feet = ("l_front_paw", "r_front_paw", "l_back_paw", "r_back_paw")
    assert trajectory["stances"] == {foot: [] for foot in feet}  # the feet never stand
    ground = build_report(world_trajectory, {})["segments"][0]["ground"]
    assert (ground["frame"], ground["height_m"]) == ("world", pytest.approx(3 + below))
    assert ground["slope"] == pytest.approx([0.02, 0])  # away from this camera is along x
    unknown = with_solution(small_trajectory, segments=(replace(segment, ground=None),))
    for settings, text in (({}, "not found"), ({"ground": "none"}, "not looked for")):
        report = build_report(unknown, settings)
        assert report["segments"][0]["ground"] is None
        assert dict(summary_lines(report))["ground"] == text


def test_every_segment_keeps_its_ground(small_trajectory):
    """The ground of the second segment is 0.4 m lower, and there is no ground between the segments."""
    solution = small_trajectory.solution
    ground = solution.segments[0].ground
    states = solution.states.copy()
    states[3:5] = np.nan
    first, second = (
        MotionSegment(slice(0, 3), ground),
        MotionSegment(slice(5, 8), replace(ground, height_m=ground.height_m - 0.4)),
    )
    report = build_report(with_solution(small_trajectory, states=states, segments=(first, second)), {})
    assert [segment["frames"] for segment in report["segments"]] == [[10, 13], [15, 18]]
    one, other = (segment["ground"] for segment in report["segments"])
    assert one["middle_m"] == pytest.approx([-1.2, 9.0])
    assert other["middle_m"] == pytest.approx([0.3, 9.0])
    assert other["height_m"] == pytest.approx(one["height_m"] - 0.4)
    higher = MotionSegment(slice(0, 3), replace(ground, height_m=ground.height_m + 2.0))
    above = build_report(with_solution(small_trajectory, states=states, segments=(higher, second)), {})
    said = f"{-above['segments'][0]['ground']['camera_height_m']:.2f} ± 0.03 m above the camera"
    assert dict(summary_lines(above))["ground"].startswith(said)
    (found,) = (one for one in above["findings"] if one["code"] == "ground_above_camera")
    assert found["frames"] == [10, 13]
    assert says(found["text"], said)
    heights = [f"{segment['camera_height_m']:.2f} ± 0.03 m below the camera" for segment in (one, other)]
    text = dict(summary_lines(report))["ground"]
    assert text.startswith(f"{heights[0]} (frames 10 to 12), {heights[1]} (frames 15 to 17); stances")
    assert any("2 segments" in sentence for sentence in report["assumptions"]["sentences"])
    segments = (replace(first, ground=None), second)
    report = build_report(with_solution(small_trajectory, states=states, segments=segments), {})
    assert report["segments"][0]["ground"] is None
    assert report["segments"][1]["ground"] == other


def test_prior(trajectory):
    assert trajectory["prior"]["name"] == "running-cheetah"
    assert trajectory["prior"]["mean_data_share"] == pytest.approx(0.7)
    assert trajectory["convergence"]["cost_by_term"] == {"reprojection": 120, "pose prior": 30}


def test_the_summary_says_what_was_not_checked_without_a_prior(small_trajectory):
    def said(name: str) -> str:
        return " ".join(text for _, text in build_report(with_solution(small_trajectory, prior=name), {})["lines"])

    assert says(said("none"), "swaps", "frame rate were not checked", "prior")
    assert "not checked" not in said("running-cheetah")


def test_a_motion_unlike_the_prior_is_reported(trajectory, small_trajectory):
    """A motion unlike the prior is reported with the misfit of the worst segment."""
    assert (trajectory["prior"]["prior_misfit"], trajectory["prior"]["weight"]) == (None, 1)
    assert "motion_unlike_prior" not in codes(trajectory)
    (segment,) = small_trajectory.solution.segments
    segments = (
        replace(segment, rows=slice(0, 4), prior_misfit=0.8),
        replace(segment, rows=slice(4, 8), prior_misfit=2.5, prior_weight=0.16, unlike_prior=True),
    )
    report = build_report(with_solution(small_trajectory, segments=segments), {})
    prior = report["prior"]
    assert (prior["prior_misfit"], prior["weight"]) == (2.5, 0.16)
    assert codes(report)[0] == "motion_unlike_prior"
    found = {"prior": "running-cheetah", "misfit": 2.5, "limit": 2, "weight": 0.16}
    assert numbers(report, "motion_unlike_prior") == found


def test_alternative(trajectory, small_trajectory):
    found = trajectory["alternative"]
    assert found == {"cost_difference": 3.5, "frames": 8, "mean_m": pytest.approx(0.65 / 8), "max_m": 0.3}
    assert numbers(trajectory, "second_solution") == {"count": 1, "frames_total": 8, "apart_m": 0.3}
    none = with_solution(small_trajectory, alternative_m=np.full(8, np.nan), flags=((),) * 8)
    report = build_report(none, {})
    assert report["alternative"] is None
    assert "second_solution" not in codes(report)
    assert dict(summary_lines(report))["alternative"].startswith("no other pose")


def test_path_and_heading_of_a_trajectory(trajectory, world_trajectory):
    path = trajectory["root_path"]
    assert (path["joint"], path["keypoint"], path["smoothed"]) == ("spine", "spine", None)
    assert path["exact"]["mean_speed_m_s"] == pytest.approx(9)
    assert path["exact"]["distance_m"] == pytest.approx(2.1)
    assert trajectory["heading"]["heading_to_picture_rad"] == pytest.approx(0, abs=1e-9)


def test_the_upward_direction_is_an_assumption_unless_known(trajectory, small_trajectory, world_trajectory):
    assert (trajectory["assumptions"]["camera_level"], trajectory["assumptions"]["camera_tilt_rad"]) == (True, 0)
    known = build_report(world_trajectory, {})
    assert (known["assumptions"]["camera_level"], known["assumptions"]["camera_tilt_rad"]) == (False, None)
    assert known["skeleton"]["states_frame"] == "world"
    given = with_first(small_trajectory, camera=replace(small_trajectory.camera, tilt_rad=0.1))
    given = build_report(given, {})
    assert (given["assumptions"]["camera_level"], given["assumptions"]["camera_tilt_rad"]) == (False, 0.1)
    assert any("look down by 5.73 degrees" in sentence for sentence in given["assumptions"]["sentences"])
    for report, warned in ((trajectory, True), (known, False), (given, False)):
        assert ("camera_taken_level" in codes(report)) == warned


def test_a_trajectory_that_did_not_converge_has_warnings(small_trajectory):
    report = build_report(with_solution(small_trajectory, status="not_converged"), {})
    assert numbers(report, "not_converged") == {"part": "--frames"}
    assert numbers(report, "few_frames") == {"count": 8}


@pytest.mark.parametrize(("poor", "part"), [(3, "--frames {}:{}, the longest part"), (5, "--frames")])
def test_a_fit_that_did_not_converge_names_the_part_with_enough_detections(small_trajectory, poor, part):
    flags = (("no data", "data poor"),) * poor + (("ambiguous depth",),) * (8 - poor)
    report = build_report(with_solution(small_trajectory, status="not_converged", flags=flags), {})
    frames = small_trajectory.frames
    assert numbers(report, "not_converged")["part"].startswith(part.format(frames[poor], frames[-1] + 1))
    assert ("longest" in numbers(report, "not_converged")["part"]) == (poor == 3)


def test_the_summary_states_a_distance_that_is_hardly_known(small_trajectory):
    away = small_trajectory.pictures[0].distance_m.mean()
    for fraction, size_sigma, expected in (
        (0.05, 0.02, None),
        (0.2, 0.02, "hardly determine"),
        (0.2, 0.15, "as uncertain as the animal's size"),
    ):
        covariance = np.broadcast_to(np.eye(3) * (fraction * away) ** 2, small_trajectory.solution.covariance_m2.shape)
        motion = with_solution(small_trajectory, covariance_m2=covariance, size_sigma=size_sigma)
        lines = summary_lines(build_report(motion, {}))
        if expected is None:
            assert "distance" not in dict(lines)
        else:
            assert [label for label, _ in lines][:3] == ["clip", "frames", "distance"]
            assert f"{plus_minus(away, fraction * away, 'm')} from the camera" in dict(lines)["distance"]
            assert expected in dict(lines)["distance"]


@pytest.mark.parametrize(
    ("lags", "left_frames", "second", "warned"),
    [
        ((-0.4, 0.5), 0.21, None, False),
        ((-0.4, 0.5), 0.21, SecondCamera(1.0, 0.5, 3.0), False),
        ((-0.4, 0.5), 0.21, SecondCamera(-1.0, 0.5, 3.0), True),
        ((-0.4, 0.5), 0.26, None, True),
        ((0.8, -0.7), 0.21, None, True),
    ],
)
def test_cameras_that_seem_out_of_step_are_reported(two_cameras, lags, left_frames, second, warned):
    """Cameras that seem to be out of step are reported.

    A lag has an expected standard deviation of 0.29 frames, and the difference of two lags 0.41. `left_frames` is the
    standard deviation after the fit. If it is nearly as large, the estimate is only a part of the lag.
    """
    both = zip(two_cameras.solution.views, two_cameras.sources, lags, strict=True)
    views = tuple(replace(view, offset_frames=source.offset_frames + lag) for view, source, lag in both)
    segments = tuple(replace(segment, second_camera=second) for segment in two_cameras.solution.segments)
    told = {"views": views, "time_offset_sigma_frames": np.full(2, left_frames), "segments": segments}
    report = build_report(with_solution(two_cameras, **told), {})
    assert ("cameras_out_of_step" in codes(report)) == warned
    if lags[0] > 0:
        found = numbers(report, "cameras_out_of_step")
        assert found == {"cameras": ["cam2", "cam1"], "apart_frames": pytest.approx(1.5)}


def shifted(motion, keypoints):
    """Return a motion in which the detections of some keypoints are moved by 500 px in all pictures."""
    sources = []
    for source in motion.sources:
        xy_px = source.keypoints.xy_px.copy()
        xy_px[:, keypoints] += 500.0
        sources.append(replace(source, keypoints=replace(source.keypoints, xy_px=xy_px)))
    return replace(motion, sources=tuple(sources))


def test_a_keypoint_that_does_not_fit_is_reported(two_cameras):
    """Keypoints that do not fit in any camera are reported, several of them in one line."""
    column = two_cameras.names.index("l_shoulder")
    report = build_report(shifted(two_cameras, [column]), {})
    assert numbers(report, "keypoints_do_not_fit") == {"keypoints": ["l_shoulder"], "share": 1, "used": 13}
    assert "many_outliers" not in codes(report)
    many = build_report(shifted(two_cameras, [*range(12)]), {})
    named = [name for name in two_cameras.names[:12] if name != "r_eye"]
    assert numbers(many, "keypoints_do_not_fit")["keypoints"] == named
    assert numbers(many, "many_outliers")["share"] == pytest.approx(0.5, abs=0.05)


def test_no_pose_at_all(small_trajectory):
    solution = small_trajectory.solution
    arrays = {
        name: np.full_like(getattr(solution, name), np.nan)
        for name in ("states", "joints_m", "covariance_m2", "relative_covariance_m2", "alternative_m", "contact")
    } | {
        "noise_px": np.full((1, 8, 24), np.nan),
        "weight": np.full((1, 8, 24), np.nan),
        "data_share": np.full(24, np.nan),
    }
    motion = with_solution(
        small_trajectory, **arrays, segments=(), flags=(("no data",),) * 8, starts=0, status="not_converged"
    )
    report = build_report(motion, {})
    json.dumps(report, allow_nan=False)
    assert is_unsolved(report)
    assert codes(report) == ["no_pose"]
    lines = dict(summary_lines(report))
    assert lines["frames"] == "0 of 8 with a pose, 8 flagged (8 no data)"
    assert "nan" not in str(lines)


def test_console_summary_of_a_trajectory(trajectory):
    """The console summary of a trajectory has the conclusions, without the details of the page."""
    out = StringIO()
    Console(file=out, width=160).print(console_summary(trajectory))
    shown = out.getvalue()
    for text in (
        "run.csv, frames 10 to 17 at 30 fps",
        "8 of 8 with a pose, 2 flagged (some for several reasons: 1 no data, 1 data poor, 1 ambiguous depth)",
        "161 used, 31 missing",
        "23 of the skeleton's 24 used; missing: r_eye; not used: ear",
        "9.0 m/s on average",
        "not measured: all metres and m/s assume average size (cheetah, ±10 %)",
        "is assumed to be level",
    ):
        assert text in shown
    lines = str(summary_lines(trajectory))
    for text in (
        "in the picture's plane",
        "70 % of the pose rests on the video, 30 % on running-cheetah",
        "stances: l_front_paw 0, r_front_paw 0",
        "fits nearly as well",
    ):
        assert text in lines
        assert text not in shown


def test_the_summary_states_how_the_upward_direction_was_found(small_trajectory):
    said = finding("up_from_feet", up="0,1,0", height_m=1.9, sigma_rad=0.12)
    lines = build_report(replace(small_trajectory, findings=(said,)), {})["lines"]
    assert ["assumed", sentence(said)] in lines
    assert "assumed" in FRONT


@pytest.mark.parametrize("level", ["use", "check", "do not use"])
def test_a_summary_begins_with_the_verdict_and_what_to_do(trajectory, level):
    report = trajectory | {
        "verdict": {"level": level, "reason": "It is so."},
        "lines": [["verdict", f"{level}: It is so."], ["expected", "pose error 40 mm"], *trajectory["lines"]],
    }
    out = StringIO()
    Console(file=out, width=160).print(console_summary(report))
    first, second, third, *_ = out.getvalue().splitlines()
    assert first.split() == ["verdict", *level.split()[:-1], f"{level.split()[-1]}:", "It", "is", "so."]
    assert second.startswith("expected")
    assert third.strip() == f"to do       {TO_DO[level]}" if level in TO_DO else third.split()[0] not in ("to", "use")


def test_a_terminal_names_the_two_notes_with_the_largest_effect(trajectory):
    effects_m = {"First": 0.02, "Second": 1.5, "Third": 0.3, "Fourth": None}
    findings = [
        {
            "code": "picture_zooms",
            "severity": "note",
            "text": f"{name} thing. Look at it.",
            "numbers": {"pose_effect_m": 0.01, "position_effect_m": effect_m},
        }
        for name, effect_m in effects_m.items()
    ]
    stated = {"level": "use", "reason": "It is so.", "reason_code": "picture_zooms"}  # with its effect
    for verdict in ({"level": "use", "reason": "It is so."}, {"level": "check", "reason": "It is so."}, stated):
        out = StringIO()
        Console(file=out, width=160).print(console_summary(trajectory | {"verdict": verdict, "findings": findings}))
        notes = [line.split(maxsplit=1)[1].strip() for line in out.getvalue().splitlines() if line.startswith("note ")]
        if verdict["level"] == "check":
            assert notes == []
        elif verdict is stated:
            assert notes == ["Second thing.", "Third thing."]
        else:
            assert notes == ["Second thing (position by up to 1.5 m).", "Third thing (position by up to 0.30 m)."]


@pytest.mark.parametrize(
    ("code", "index"),
    [
        ("cameras_out_of_step", 1),  # the first of two cameras out of step
        ("keypoints_do_not_fit", 3),
        ("picture_zooms", None),  # a note that widens the expected error is listed like other notes
        ("no_fault", None),
        ("", None),
    ],
)
def test_the_verdicts_finding_is_found_by_its_code_and_not_listed_again(trajectory, code, index):
    rows = [("picture_zooms", "note"), *[("cameras_out_of_step", "warning")] * 2, ("keypoints_do_not_fit", "note")]
    findings = [
        {"code": name, "severity": severity, "text": f"Finding {i}.", "numbers": {}}
        for i, (name, severity) in enumerate(rows)
    ]
    verdict = {"level": "use", "reason": "Good except for this: ...", "reason_code": code}
    report = trajectory | {"verdict": verdict, "findings": findings}
    assert reason_finding(report) == index
    assert reason_finding(report | {"verdict": None}) is None
    out = StringIO()
    Console(file=out, width=160).print(console_summary(report))
    assert [i for i in range(4) if f"Finding {i}." in out.getvalue()] == [i for i in range(4) if i != index]


@pytest.mark.parametrize("listed", ["", "; missing: nose"])
def test_a_terminal_omits_keypoints_if_all_are_used(trajectory, listed):
    lines = [["keypoints", f"all of the skeleton's 24 used{listed}"], ["detections", "9 used"]]
    out = StringIO()
    Console(file=out, width=160).print(console_summary(trajectory | {"lines": lines}))
    assert ("the skeleton's 24" in out.getvalue()) == bool(listed)
    assert "9 used" in out.getvalue()


def test_lines_of_a_trajectory(trajectory):
    assert "side" not in dict(summary_lines(trajectory))
    assert 10 <= len(summary_lines(trajectory)) <= 19


@pytest.fixture(scope="module")
def several(two_cameras):
    first, second = two_cameras.sources
    later = replace(two_cameras, sources=(first, replace(second, offset_s=0.25)))
    return build_report(later, {"subject": None})


def test_one_camera_is_a_list_of_one(trajectory, report):
    for one in (trajectory, report):
        (camera,) = one["cameras"]
        assert camera["points"]["used"] == one["summary"]["detections"]
        assert camera["reprojection_px"]["mean"] == one["summary"]["reprojection_px"]["mean"]
        assert camera["outliers"] == one["summary"]["outliers"] == 1
        assert camera["camera"] == one["input"]["camera"]
    assert trajectory["cameras"][0]["mean_weight"] == trajectory["summary"]["mean_weight"]


def test_cameras(several):
    first, second = several["cameras"]
    assert (first["name"], first["keypoints"], first["offset_s"]) == ("cam1", "run.csv", 0)
    assert (second["name"], second["keypoints"], second["offset_s"]) == ("cam2", "cam2.csv", 0.25)
    assert (first["frames_seen"], second["frames_seen"]) == (7, 6)
    assert first["points"] == {"used": 7 * 23, "missing": 7 + 24, "rejected": 0}
    assert second["points"] == {"used": 6 * 24, "missing": 2 * 24, "rejected": 0}
    assert (first["mean_weight"], second["mean_weight"]) == (pytest.approx(1 - 0.95 / (7 * 23)), 0.5)
    assert second["reprojection_px"] == {"mean": pytest.approx(200 / (6 * 24)), "median": pytest.approx(0, abs=1e-9)}
    assert second["distance_m"] == pytest.approx(8, abs=3)


def test_counts_include_all_cameras(several, two_cameras):
    summary = several["summary"]
    assert summary["detections"] == 7 * 23 + 6 * 24
    assert summary["reprojection_px"]["mean"] == pytest.approx(500 / (7 * 23 + 6 * 24))
    assert summary["mean_weight"] == pytest.approx((7 * 23 - 0.95 + 6 * 24 / 2) / (7 * 23 + 6 * 24))
    assert summary["keypoints"]["missing"] == 0  # the first camera has no r_eye
    assert [camera["outliers"] for camera in several["cameras"]] == [1, 1]
    assert summary["outliers"] == 2
    rows = {row["name"]: row for row in several["keypoints"]}
    assert (rows["nose"]["used"], rows["r_eye"]["used"], rows["nose"]["noise_px"]) == (13, 6, 15)


def test_the_summary_names_the_camera_of_one_keypoint_file(small_trajectory, trajectory):
    of_file = build_report(small_trajectory, {"camera": "cameras.toml"})
    assert dict(of_file["lines"])["clip"] == "run.csv (camera cam1), frames 10 to 17 at 30 fps"
    assert dict(trajectory["lines"])["clip"] == "run.csv, frames 10 to 17 at 30 fps"


def test_console_summary_of_several_cameras(several, two_cameras):
    lines = summary_lines(several)
    assert ("clip", "run.csv, cam2.csv, frames 10 to 17 at 30 fps") in lines
    cameras = [text for label, text in lines if label == "camera"]
    assert cameras[1].startswith("cam2: 6 of 8 frames, 144 points used; 1.4 px mean, 0.0 px median, 1 outlier; ")
    assert " below cam1; stances" in dict(lines)["ground"]
    assert dict(lines)["heading"].endswith(", as cam1 sees it")
    assert several["size"]["from"] == ["prior", "views"]
    assert dict(lines)["size"].endswith("the positions of the cameras")
    sentences = " ".join(several["assumptions"]["sentences"])
    assert says(sentences, "measured by ", ": 1.00 ± ", "cameras are static")


@pytest.mark.parametrize("method", ["report", "trajectory", "several"])
def test_every_field_is_documented(method, request):
    report = request.getfixturevalue(method)
    pages = DOCS.read_text(encoding="utf-8") + DOCS.with_name("findings.md").read_text(encoding="utf-8")
    documented = set(re.findall(r"`([\w -]+)`", pages))
    open_names = {"settings", "timing_s", "camera", "numbers"}  # fields whose own fields the pages do not list
    open_names |= {"states", "total", "cost_by_term", "stances", "flags"}  # fields whose keys are names
    by_name = {*report["skeleton"]["state_names"], *report["skeleton"]["keypoints"]}

    def keys(node):
        if isinstance(node, dict):
            for key, item in node.items():
                yield key
                if key not in open_names or isinstance(item, list):
                    yield from keys(item)
        elif isinstance(node, list):
            for item in node:
                yield from keys(item)

    assert set(keys(report)) - by_name - documented == set()
    assert {*report["summary"].get("flags", ())} <= documented
