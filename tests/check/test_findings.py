"""Test that each code of a finding has a severity, a text, and a line in docs/findings.md."""

from __future__ import annotations

import ast
import inspect
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from command_line import says

from recon import Motion
from recon.check import rules
from recon.check.codes import CODES, FAULTS, FLAG_OF, FLAGS, finding, sentence
from recon.check.rules import detections_not_explained, findings_of, likelihoods_low, no_pose
from recon.check.verdict import add_verdict
from recon.fit.result import Finding
from recon.show.sections.keypoints import keypoint_lines, keypoints_data

ROOT = Path(__file__).resolve().parents[2]
DOCS = ROOT / "docs" / "findings.md"
AGAINST = {"error_px": 31.4, "level": 5.24}
SENTENCES = {
    "gross_outliers": ("in frame 10 are gross outliers", {}),
    "detections_frozen": ("20 of 40 frames repeat", {"count": 20, "frames_total": 40}),
    "detections_repeated": ("with --fps 30", {"times": 2, "given_hz": 60.0, "other_hz": 30.0}),
    "detections_curved": ("62 % of the points lie exactly on smooth curves", {"share": 0.62}),
    "detections_interpolated": ("75 % of the points lie on a straight line", {"share": 0.75}),
    "frames_dropped": ("In 25 % of the frames the animal moves about twice as far", {"share": 0.25}),
    "far_side_copied": ("100 % of the points of one side", {"share": 1.0}),
    "points_identical": ("nose, l_eye have the same coordinates", {"points": ("nose", "l_eye"), "count": 12}),
    "point_frozen": ("spine keeps its coordinates to the last digit in frame 10", {"points": ("spine",)}),
    "points_interpolated": ("spine moves on a straight line at an even speed in frame 10", {"points": ("spine",)}),
    "points_jump": ("3 of 900 positions jump away", {"points": ("spine",), "count": 3, "points_total": 900}),
    "sides_swap": ("Left and right of the hind legs look swapped in frame 10", {"part": "the hind legs"}),
    "sides_exchanged": ("95 % of the left points, over all frames, are on the animal's right", {"share": 0.95}),
    "unit_unlikely": ("would be 1.2e+03 m long: the numbers look like mm", {"extent_m": 1200.0, "unit": "mm"}),
    "up_unlikely": ("along y, not along z", {"axis": "y"}),
    "lengths_drift": ("change together by 20 %", {"share": 0.2}),
    "lengths_change": (
        "between nose, l_eye differs by 40 % from its usual length",
        {"points": ("nose", "l_eye"), "share": 0.4},
    ),
    "gravity_unlikely": (
        "accelerates downwards by 39.2 ± 1.0 m/s², not by 9.8",
        {"acceleration_m_s2": 39.2, "sigma_m_s2": 1.0, "given_hz": 120.0, "advice": "Check --fps."},
    ),
    "feet_slide": (
        "Standing feet move at -3 m/s while the body moves at 0.1 m/s",
        {"slide_m_s": -3.0, "speed_m_s": 0.1},
    ),
    "joint_beyond_range": (
        "The left elbow bends to -50 degrees in frame 10, beyond its possible range of -20 to 165",
        {"joint": "left elbow", "angle_rad": -0.873, "low_rad": -0.349, "high_rad": 2.88},
    ),
    "unit_not_stated": ("read in mm, which makes the animal 1.2 m long", {"unit": "mm", "extent_m": 1.2}),
    "frame_rate_not_stated": ("does not state its frame rate", {}),
    "same_keypoints": ("points of cam1, cam2 are the same", {"share": 1.0, "cameras": ("cam1", "cam2")}),
    "missing_as_constant": ("12 points are stored as (-1, -1)", {"x_px": -1.0, "y_px": -1.0, "count": 12}),
    "picture_turned": ("turned by 90 degrees", {"degrees": 90}),
    "world_not_z_up": (
        "-y seems to point up instead of z: heights and the ground are wrong. Give --set up=-y;",
        {"axis": "-y"},
    ),
    "animal_still": ("still (0.02 m/s), but the prior", {"speed_m_s": 0.02}),
    "no_strides": ("still (0.02 m/s): the clip has no strides to measure.", {"speed_m_s": 0.02}),
    "time_reversed": ("runs backwards at 7.5 m/s", {"speed_m_s": 7.5}),
    "treadmill": ("--set belt-speed-m-s=1.4", {"slide_m_s": 1.4, "speed_m_s": 0.2}),
    "camera_moves": ("the slowest feet move at -7.0 m/s", {"slide_m_s": -7.0, "speed_m_s": 0.3}),
    "keypoints_undistorted": ("fits clearly better without the lens", {}),
    "halves_apart": (
        "seems 2.5 frames late relative to its fore half (3.1 standard deviations): the points of its fore half may",
        {"late_frames": 2.5, "sigmas": 3.1, "foreign": "fore half"},
    ),
    "focal_length": (
        "of about 0.7 times the given one better (by 1.2 standard deviations): distance, position and speed may be "
        "wrong. With a focal length at the end of its 90 % interval, poses would change by 12 mm and positions by "
        "4.0 m. Check the focal length",
        {"factor": 0.67, "sigmas": 1.23, "pose_effect_m": 0.012, "position_effect_m": 4.0},
    ),
    "picture_zooms": ("better if the picture zooms in: distance", {"way": "in"}),
    "path_jolts": ("implausible for an animal (its heading)", {"of": "heading", "cost": 1.2}),
    "ground_elsewhere": ("are at z = 0.47 ± 0.04 m", {"height_m": 0.47, "sigma_m": 0.04}),
    "camera_unit": (
        "is 100 times as high above the world's origin as above the animal's feet",
        {"unit": "cm", "times": 100.2},
    ),
    "subject_unlike_species": ("are 1.50 times those", {"times": 1.5, "expected_sigma": 0.1}),
    "keypoints_normalised": ("fractions of the picture size, from 0 to 1", {}),
    "keypoints_y_up": ("seems to be counted from the bottom of the picture", {}),
    "upside_down": ("contradict each other: the animal runs upside down", {}),
    "turned_either_way": (
        "equally well: x points up, the picture is turned. Correct",
        {"causes": ("x points up", "the picture is turned")},
    ),
    "rotation_transposed": ("likely if the camera file's rotation is transposed", {}),
    "pose_inverted": ("from the camera to the world", {}),
    "picture_upside_down": ("upside down in the picture", {}),
    "smaller_video": ("a video 2 times smaller than", {"times": 2}),
    "other_camera_named": (
        "file's name says cam3, but the camera is cam1: with the wrong camera",
        {"other": "cam3", "given": "cam1"},
    ),
    "another_camera_fits": (
        "fits cam2, cam5 of the camera file better than cam1: if",
        {"given": "cam1", "others": ("cam2", "cam5")},
    ),
    "lens_assumed": (
        "most lenses that show 118 degrees, such as those of action cameras, are fisheye lenses. With a fisheye lens, "
        "poses would change by 57 mm and positions by 2.2 m. State the lens with --set lens=fisheye",
        {"hfov_deg": 118.2, "pose_effect_m": 0.057, "position_effect_m": 2.2},
    ),
    "left_right_swap": (
        "look swapped in frame 10, in the fore legs. Look at the video",
        {"part": "the fore legs"},
    ),
    "left_right_swap_possible": (
        "may be swapped in frame 10, in the fore legs, or",
        {"part": "the fore legs"},
    ),
    "left_right_swap_mended": ("were swapped in frame 10, in all keypoints, and", {"part": "all keypoints"}),
    "clip_swapped_back": ("were swapped in frame 10, in all keypoints, and", {"part": "all keypoints"}),
    "frame_rate_stated": ("file says 60 frames per second, but --fps is 30", {"other_hz": 60.0, "given_hz": 30.0}),
    "frame_rate": ("about 60 frames per second, not 30", {"other_hz": 60.0, "given_hz": 30.0}),
    "no_pose": ("too few points were detected in every frame", {}),
    "no_pose_unit": (
        "in cm the cameras stand 5.12 m apart, in mm 0.51 m",
        {"apart_m": 512.3, "times": 5100.0, "in_cm_m": 5.123, "in_mm_m": 0.5123},
    ),
    "likelihoods_low": ("67 % of the points of cam1 have a likelihood below 0.5", {"share": 0.667, "limit": 0.5}),
    "no_pose_diverged": ("too far away to be seen", {}),
    "cameras_apart_in_time": (
        "No two cameras see a point at the same time, so nothing can be triangulated. Check --set offset-s",
        {},
    ),
    "cameras_exchanged": ("The files of cam1, cam2 look exchanged", {"cameras": ("cam1", "cam2"), **AGAINST}),
    "cameras_disagree": (
        "cam1, cam2 contradict each other (an error of 31 px, 5.2 times the expected error)",
        {"cameras": ("cam1", "cam2"), **AGAINST},
    ),
    "camera_turned": (
        "cam1 looks turned by about 5.0 degrees relative to the other cameras (an error of 31 px, 5.2 times "
        "the expected error). Without this fault, poses would change by 12 mm and positions by 40 mm. Check",
        {"turn_rad": np.radians(5.0), **AGAINST, "pose_effect_m": 0.012, "position_effect_m": 0.04},
    ),
    "camera_late": ("cam1 is 2.5 frames early relative to", {"late_frames": -2.5, "offset_s": 0.1, **AGAINST}),
    "camera_off": ("cam1 contradicts the other cameras (an error of 31 px", AGAINST),
    "cameras_not_refined": ("would be 62.8 px off instead of 5.4", {"before_px": 5.4, "after_px": 62.8}),
    "camera_left_its_pose": ("cam1 would be turned by 17 degrees", {"turn_deg": 17.2}),
    "cameras_as_calibrated": ("keep their calibrated poses: refined poses fit no better", {}),
    "cameras_out_of_step": ("by 1.5 frames or more", {"cameras": ("cam1", "cam2"), "apart_frames": 1.5}),
    "fit_explains_little": ("are 2.4 standard deviations or more away from the pose", {"sigmas": 2.41}),
    "motion_unexplained": (
        "the prior cats (misfit 3.1, where 1 is usual), and 17 % of the detections disagree",
        {"prior": "cats", "misfit": 3.1, "share": 0.17},
    ),
    "motion_unlike_prior": (
        "prior cats was learned from (misfit 2.5, where 1 is usual and 2 the limit). "
        "The prior has 16 % of its usual weight",
        {"prior": "cats", "misfit": 2.5, "limit": 2.0, "weight": 0.16},
    ),
    "ground_above_camera": ("0.52 ± 0.03 m above cam1", {"height_m": 0.52, "sigma_m": 0.03}),
    "frames_not_converged": ("2 of 9 frames did not converge", {"count": 2, "frames_total": 9}),
    "not_converged": ("the worst part of the clip (--frames 3:9).", {"part": "--frames 3:9"}),
    "size_impossible": (
        "comes out 0.42 times as large as expected, which is impossible",
        {"size": 0.42, "expected_sigma": 0.1},
    ),
    "size_unexpected": ("comes out 0.70 times as large as usual, where 1 ± 0.1", {"size": 0.7, "expected_sigma": 0.1}),
    "pair_disagrees": (
        "agree better. Check both poses, and that the two keypoint files are not exchanged, or give the animal's "
        "lengths (--subject).",
        {"cameras": ("cam1", "cam2"), "log_likelihood_ratio": 9.06},
    ),
    "pair_refined": (
        "turned by 3.0 degrees and moved by 50 mm, and the result uses that pose, which is in cameras.toml",
        {"cameras": ("cam1", "cam2"), "turn_rad": 0.0524, "shift_m": 0.05},
    ),
    "pair_adjusted": (
        "with cam1 turned by 0.3 degrees and moved by 20 mm, within the usual errors of calibrations",
        {"cameras": ("cam1", "cam2"), "turn_rad": 0.00524, "shift_m": 0.02},
    ),
    "pair_or_lengths": ("cam1, cam2 do not fit the lengths of this skeleton", {"cameras": ("cam1", "cam2")}),
    "too_fast": ("at 41 m/s, faster than any animal", {"speed_m_s": 41.2}),
    "second_solution": ("up to 0.30 m away", {"count": 2, "frames_total": 9, "apart_m": 0.3}),
    "frames_flagged": (
        '42 of 42 frames with a pose have a flag, most of them "data poor": few joints. A camera',
        {"count": 42, "frames_total": 42, "flag": "data poor", "meaning": "few joints"},
    ),
    "few_frames": ("A clip of 1 frame shows little", {"count": 1}),
    "many_outliers": ("51 detections (57 %) disagree", {"count": 51, "share": 0.566}),
    "many_left_out": (
        "40 % of the detections were left out or disagree with the pose (9 outliers)",
        {"share": 0.4, "reasons": "9 outliers"},
    ),
    "clock_drifts": (
        "drift from those of the other cameras by +0.9 frames over the clip, as if this camera ran at 59.06 frames",
        {"drift_frames": 0.95, "rate_hz": 59.06, "given_hz": 60.0},
    ),
    "picture_stretched": ("looks stretched to 1.33 times its width", {"factor": 1.33, "sigmas": 4.0}),
    "keypoints_do_not_fit": (
        "75 % of the 40 detections of nose, l_eye disagree",
        {"share": 0.75, "used": 40, "keypoints": ("nose", "l_eye")},
    ),
    "angles_unusual": ("2.3 times the usual cost", {"times": 2.3}),
    "at_range_limits": ("2 of 9 frames have angles beyond", {"count": 2, "frames_total": 9}),
    "up_from_feet": (
        "in addition to their intervals. The ground is at z = 0, and the first camera is 1.9 m above it",
        {"height_m": 1.9, "sigma_rad": np.radians(1.5), "up": "0.000,-0.900,0.400"},
    ),
    "camera_taken_level": ("the camera is. Give the direction with --set up", {"option": "--set up"}),
    "reference_unlike": ("410 mm from the reference, 61 % of", {"left_mm": 410.2, "share": 0.61}),
    "reference_rotated": (
        "by 90° reduces MPJPE from 410.2 to 20.0 mm",
        {"turn_rad": np.pi / 2, "error_mm": 410.2, "left_mm": 20.0},
    ),
    "reference_swapped": (
        "rotating the whole clip by 90° reduces MPJPE from 410.2",
        {"turn_rad": np.pi / 2, "error_mm": 410.2, "left_mm": 20.0},
    ),
    "reference_mirrored": ("left-handed axes", {"error_mm": 410.2, "left_mm": 20.0}),
    "reference_scaled": (
        "A scale of 0.001 and",
        {"factor": 0.001, "turn_rad": 0.0, "error_mm": 410.2, "left_mm": 20.0},
    ),
    "reference_elsewhere": ("about (1.00, 2.00, 3.00) m from the reference", {"x_m": 1.0, "y_m": 2.0, "z_m": 3.0}),
    "flight_against_gravity": ("upwards by 3.1 ± 1.2 m/s², where free", {"up_m_s2": 3.1, "sigma_m_s2": 1.2}),
    "camera_agreement": ("Cameras agree up to 1.6 times", {"max_level": 1.6, **AGAINST}),
}


def test_each_finding_with_an_effect_has_a_clause_for_the_expected_error():
    """The expected error that an effect increases says "if the focal length is wrong", not the finding's code."""
    with_effect = {code for code, (_, text) in CODES.items() if "effect}" in text}
    without_text = {"left_right_swap_possible", "clock_drifts"}  # their messages do not state the effect
    assert {*FAULTS} == with_effect | without_text
    assert all(clause[0].islower() and not clause.endswith(".") for clause in FAULTS.values())


@pytest.mark.parametrize("code", CODES)
def test_every_code_has_its_sentence(code):
    words, numbers = SENTENCES[code]
    one = finding(code, (10, 11), "cam1", **numbers)
    assert one.severity == CODES[code][0]
    assert words in sentence(one)
    assert sentence(one).endswith((".", "?"))


def test_only_with_one_camera_a_swap_is_said_to_be_in_the_pose():
    """With several cameras, the others may keep the pose right, and the fit states by how much it would change."""
    swap = finding("left_right_swap", (10, 11), "cam1", part="the fore legs")
    assert "in the fore legs. They are swapped in the pose too. Look" in sentence(swap, named=False)
    assert "pose" not in sentence(swap)
    weighed = replace(swap, numbers=swap.numbers | {"pose_effect_m": 0.012, "position_effect_m": 0.004})
    assert "Without this fault, poses would change by 12 mm and positions by 4 mm. Look" in sentence(weighed)


def test_a_finding_of_an_earlier_version_has_a_sentence():
    assert sentence(finding("not_converged")).endswith("(--frames).")


def test_each_code_in_the_source_has_an_entry_and_each_entry_is_used():
    """A code without an entry would otherwise be noticed only when its rule yields a finding for the first time."""
    sources = [path.read_text(encoding="utf-8") for path in (ROOT / "recon").rglob("*.py")]
    trees = [ast.parse(text) for text in sources if "finding(" in text]
    nodes = [node for tree in trees for node in ast.walk(tree)]
    calls = [n for n in nodes if isinstance(n, ast.Call) and isinstance(n.func, ast.Name) and n.func.id == "finding"]
    texts = [n.value for call in calls for n in ast.walk(call.args[0]) if isinstance(n, ast.Constant)]
    assert len(texts) > len(CODES) / 2
    assert {*texts} <= {*CODES}
    assert not [code for code in CODES if not any(f'"{code}"' in text for text in sources)]


def test_each_rule_is_listed():
    functions = inspect.getmembers(rules, inspect.isfunction)
    yielding = [f for _, f in functions if f.__annotations__.get("return") == "Iterator[Finding]"]
    assert {*yielding} == {*rules.RULES, *rules.TRAJECTORY_RULES, no_pose}


def test_the_name_of_a_single_camera_is_not_stated():
    one = finding("keypoints_y_up", camera="cam1")
    assert sentence(one) == f"cam1: {sentence(one, named=False)}"
    above = finding("ground_above_camera", camera="cam1", height_m=0.5, sigma_m=0.1)
    assert "0.10 m above the camera" in sentence(above, named=False)
    of_mouse = finding("ground_above_camera", camera="cam1", height_m=0.05, sigma_m=0.004)
    assert "50 ± 4 mm above the camera" in sentence(of_mouse, named=False)
    several = finding("gross_outliers", (10, 13))
    assert "in frames 10 to 12 " in sentence(several)
    assert "in the whole clip" in sentence(finding("gross_outliers"))


def test_findings_come_in_the_order_of_their_codes(small_trajectory):
    given = [(one.severity, one.code) for one in findings_of(small_trajectory)]
    order, severities = [*CODES], ["error", "warning", "note"]
    assert given == sorted(given, key=lambda item: (severities.index(item[0]), order.index(item[1])))
    assert {"few_frames", "second_solution", "camera_taken_level"} <= {code for _, code in given}


def test_a_list_of_names_is_shown_and_saved_like_a_tuple():
    listed, paired = (
        finding("keypoints_do_not_fit", keypoints=names) for names in (["nose", "tail"], ("nose", "tail"))
    )
    assert listed == paired


def test_an_unexplained_motion_is_no_evidence_of_a_treadmill(small_trajectory):
    belt = finding("treadmill", slide_m_s=3.0, speed_m_s=0.1)
    unexplained = finding("motion_unexplained", prior="cats", misfit=3.1, share=0.17)

    def codes(*findings: Finding) -> set[str]:
        return {item.code for item in findings_of(replace(small_trajectory, findings=findings))}

    assert "treadmill" in codes(belt)
    assert codes(belt, unexplained) == codes(unexplained)


def test_a_clip_with_a_flag_on_every_frame_is_reported(whole_results):
    motion = Motion.load(whole_results)

    def named(*flags: str) -> list[str]:
        solution = replace(motion.solution, flags=(flags,) * len(motion.frames))
        verdict = add_verdict(replace(motion, findings=(), solution=solution)).verdict
        assert verdict is not None
        return [verdict.level, verdict.reason]

    assert named()[0] == named("left-right swap")[0] == "use"  # left-right swaps have their own finding
    level, reason = named("ambiguous depth", "left-right swap")
    assert level == "check"
    flagged = f"of {len(motion.frames)} frames with a pose have a flag"
    assert says(reason, flagged, "ambiguous depth", "from the front or the back")


def test_findings_are_saved_with_a_motion(small_trajectory, tmp_path):
    motion = replace(small_trajectory, findings=findings_of(small_trajectory))
    motion.save(tmp_path)
    assert Motion.load(tmp_path).findings == motion.findings


def test_findings_are_plain_data():
    one = finding("many_outliers", count=51, share=0.5)
    assert one == Finding("many_outliers", "warning", None, None, {"count": 51, "share": 0.5})


def test_every_code_and_every_flag_is_documented():
    rows = re.findall(r"^\| (\**)`([\w -]+)`", DOCS.read_text(encoding="utf-8"), flags=re.MULTILINE)
    assert {*CODES, *FLAGS} <= {code for _, code in rows}
    errors = {code for code, (severity, _) in CODES.items() if severity == "error"}
    assert {code for bold, code in rows if bold} == errors
    assert {*FLAG_OF} <= {*CODES}
    assert {*FLAG_OF.values()} <= {*FLAGS}


def test_cameras_in_another_unit_and_low_likelihoods_are_reported(small_trajectory):
    motion = small_trajectory
    view, source = motion.solution.views[0], motion.sources[0]
    moved = view.T_camera_world.copy()
    moved[:3, 3] += (3000.0, 0.0, 0.0)
    away = replace(view, T_camera_world=moved)
    flags = (("diverged",),) * len(motion.frames)
    solution = replace(motion.solution, views=(view, away), flags=flags, states=motion.states * np.nan)
    (one,) = no_pose(replace(motion, solution=solution))
    assert one.code == "no_pose_unit"
    assert one.numbers["in_mm_m"] == pytest.approx(3.0, abs=1e-6)
    counts = {
        name: {**of, "used": of["frames"] // 4, "rejected": of["frames"] // 2}
        for name, of in source.cleaning.keypoints.items()
    }
    cleaning = replace(source.cleaning, keypoints=counts)
    unlikely = replace(motion, sources=(replace(source, cleaning=cleaning),))
    (low,) = likelihoods_low(unlikely)
    said = dict(keypoint_lines(replace(unlikely, findings=(low,)), keypoints_data(unlikely)))["detections"]
    assert says(said, "92 (36 % of", "left out")
    assert low.numbers["share"] == pytest.approx(2 / 3, abs=0.05)
    assert not [*likelihoods_low(motion)]


def test_a_misfit_hidden_by_the_noise_is_compared_with_usual_detectors(small_trajectory):
    """A misfit of 100 px is reported although the estimated noise is 100 px, because usual detectors are better."""
    xy_px = small_trajectory.sources[0].keypoints.xy_px + 100.0
    keypoints = replace(small_trajectory.sources[0].keypoints, xy_px=xy_px)
    source, solution = replace(small_trajectory.sources[0], keypoints=keypoints), small_trajectory.solution
    views = tuple(replace(view, xy_px=view.xy_px + 100.0) for view in solution.views)
    solution = replace(solution, noise_px=np.full_like(solution.noise_px, 150.0), views=views)
    (item,) = detections_not_explained(replace(small_trajectory, sources=(source,), solution=solution))
    assert item.numbers["sigmas"] > 10
    assert not [*detections_not_explained(small_trajectory)]
