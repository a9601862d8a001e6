"""Test the verdict on a clip, which follows from the findings and the expected error."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from recon.check.codes import finding, sentence
from recon.check.verdict import (
    LIMIT_OF_TRUNK,
    NOT_ALL_CHECKED,
    NOTHING_AGAINST,
    _verdict,
    add_verdict,
    evidence_of,
    expected_pose_of_trunk,
    expected_position,
    reason_in_list,
    usable,
    verdict_lines,
)
from recon.fit.motion import Motion
from recon.fit.result import ExpectedError, Verdict
from recon.io.deeplabcut import write_csv
from recon.io.video import video_writer
from recon.show.sections import inputs as input_sections
from tests.command_line import refused, run, says


def level(motion: Motion) -> str:
    verdict = add_verdict(motion).verdict
    assert verdict is not None
    return verdict.level


def test_the_most_serious_finding_decides(small_trajectory):
    warned = replace(small_trajectory, findings=(finding("ground_above_camera", height_m=1.0, sigma_m=0.1),))
    assert level(warned) in ("check", "do not use")
    wrong = add_verdict(replace(small_trajectory, findings=(finding("keypoints_y_up"), *warned.findings)))
    assert wrong.verdict.level == "do not use"
    assert wrong.verdict.reason == sentence(finding("keypoints_y_up"), named=False)
    assert wrong.verdict.pose_m is wrong.verdict.position_m is None
    assert verdict_lines(wrong.verdict) == (f"do not use: {wrong.verdict.reason}",)


def test_of_several_errors_the_cause_is_the_reason(small_trajectory):
    numbers = {"cameras": ("one", "two"), "error_px": 200.0, "level": 40.0}
    follows = finding("frame_rate", other_hz=46.0, given_hz=60.0), finding("too_fast", speed_m_s=50.0)
    warned = finding("ground_elsewhere", height_m=1.0, sigma_m=0.1)
    numbered = finding("cameras_exchanged", **numbers)
    both, alone = (
        add_verdict(replace(small_trajectory, findings=(warned, *more))) for more in ((*follows, numbered), follows)
    )
    assert {one.code for one in both.findings if one.severity != "note"} >= {"cameras_exchanged", "few_frames"}
    assert not {"frame_rate", "too_fast", "ground_elsewhere"} & {one.code for one in both.findings}
    assert "exchanged" in both.verdict.reason
    assert [one.code for one in alone.findings][:2] == ["frame_rate", "too_fast"]
    assert "ground_elsewhere" in {one.code for one in alone.findings}


def test_expected_errors_are_marked_if_there_is_a_warning(whole_results):
    warned = finding("ground_elsewhere", height_m=1.0, sigma_m=0.1)
    verdict = add_verdict(replace(Motion.load(whole_results), findings=(warned,))).verdict
    assert verdict is not None
    assert (verdict.level, verdict.warned) == ("check", True)
    assert verdict.lines[1].startswith("apart from that, pose error")


def test_a_clip_to_be_used_names_keypoints_that_do_not_fit(whole_results):
    named = finding("keypoints_do_not_fit", keypoints=("l_hip",), share=0.8, used=40)
    verdict = add_verdict(replace(Motion.load(whole_results), findings=(named,))).verdict
    assert verdict is not None
    assert says(verdict.lines[0], "use: Good", "80 % of the 40 detections", "l_hip")


def test_expected_errors(small_trajectory):
    evidence = evidence_of(small_trajectory)
    solution = small_trajectory.solution
    rear, front = small_trajectory.forward
    trunk = np.linalg.norm(solution.joints_m[:, front] - solution.joints_m[:, rear], axis=-1).mean()
    assert evidence.trunk_m == pytest.approx(trunk)
    pose, position = expected_pose_of_trunk(evidence), expected_position(evidence)
    assert 0 < pose.low < pose.expected < pose.high
    assert pose.expected / pose.low == pytest.approx(pose.high / pose.expected)
    assert 0 < position.low < position.expected < position.high
    verdict = add_verdict(small_trajectory).verdict
    assert verdict.pose_m == pose.times(evidence.trunk_m)
    assert verdict.pose_of_trunk == pose
    twice = replace(solution, relative_covariance_m2=4 * solution.relative_covariance_m2)
    less_sure = evidence_of(replace(small_trajectory, solution=replace(twice, size_sigma=2 * solution.size_sigma)))
    assert less_sure.posterior_m == pytest.approx(2 * evidence.posterior_m)
    assert expected_pose_of_trunk(less_sure).expected > 1.5 * pose.expected


def test_undetected_joints_make_the_error_larger_and_less_certain(small_trajectory):
    solution, evidence = small_trajectory.solution, evidence_of(small_trajectory)
    hidden = replace(solution, data_share=np.zeros_like(solution.data_share))
    less = evidence_of(replace(small_trajectory, solution=hidden))
    assert 0 < evidence.unseen < less.unseen == pytest.approx(1)
    pose, wider = expected_pose_of_trunk(evidence), expected_pose_of_trunk(less)
    assert wider.expected > pose.expected
    assert wider.high / wider.low > 2 * pose.high / pose.low


def test_an_interval_that_begins_at_zero_is_stated_in_words():
    assert ExpectedError(0.48, 0.033, 1.2).in_words == "0.5 m (90 %: at most 1.2)"
    assert "pose_m=ExpectedError(0.48, 90 %: 0.033 to 1.2)" in repr(Verdict("use", "", ExpectedError(0.48, 0.033, 1.2)))
    assert ExpectedError(0.59, 0.04, 4.02).in_words == "0.6 m (90 %: at most 4.0)"
    assert ExpectedError(0.046, 0.031, 0.067).in_words == "46 mm (90 %: 31 to 67)"
    assert ExpectedError(0.004, 0.003, 0.006).in_words == "4.0 mm (90 %: 3.0 to 6.0)"
    assert ExpectedError(12.3, 8.0, 20.0).in_words == "12 m (90 %: 8 to 20)"


@pytest.mark.parametrize(("effect_m", "named"), [(5.0, True), (0.001, False)])
def test_a_finding_that_dominates_an_interval_is_named(whole_results, effect_m, named):
    noted = finding("focal_length", factor=0.8, sigmas=0.8, pose_effect_m=0.001, position_effect_m=effect_m)
    verdict = add_verdict(replace(Motion.load(whole_results), findings=(replace(noted, severity="note"),))).verdict
    assert verdict is not None
    assert verdict.pose_m is not None
    assert verdict.position_m is not None
    assert (verdict.pose_m.widened_by, verdict.position_m.widened_by) == ("", "focal_length" if named else "")
    assert verdict.position_m.widened_if == ("the focal length is wrong" if named else "")
    assert verdict.lines[1].endswith(", if the focal length is wrong)") == named
    assert "focal_length" not in " ".join(verdict.lines)
    older = replace(verdict.position_m, widened_if="")  # in results that do not have the clause
    assert ("if the finding focal_length is right)" in older.in_words) == named
    assert verdict.position_m.high > effect_m


def test_the_summary_states_what_one_camera_cannot_determine(small_trajectory):
    motion = replace(add_verdict(small_trajectory), settings={**small_trajectory.settings, "focal_sigma": 0.1})
    known = replace(Verdict("use", "It is so."), position_m=ExpectedError(0.1, 0.05, 0.2))
    said = dict(input_sections.verdict_lines(replace(motion, verdict=known), {}))["assumed"]
    assert says(
        said, "pinhole", "px ± 10 %", "a static camera", "30 frames per second", "expected size ±", "One camera"
    )
    given = replace(motion, verdict=known, settings={"hfov_deg": None})
    assert says(dict(input_sections.verdict_lines(given, {}))["assumed"], "px ± 2 %")
    assert "assumed" not in dict(
        input_sections.verdict_lines(replace(motion, verdict=known, sources=2 * motion.sources), {})
    )


@pytest.mark.parametrize("name", ["posterior_m", "misfit", "distance_m", "end_on", "unseen", "slowness"])
def test_worse_evidence_increases_the_expected_error(small_trajectory, name):
    evidence = evidence_of(small_trajectory)
    worse = replace(evidence, **{name: 1.0 if name in ("end_on", "unseen") else 3 * getattr(evidence, name)})
    assert expected_pose_of_trunk(worse).expected > expected_pose_of_trunk(evidence).expected


def test_a_low_frame_rate_increases_the_expected_error(small_trajectory):
    solution = replace(small_trajectory.solution, prior="running-cheetah")
    assert evidence_of(replace(small_trajectory, solution=solution)).slowness == pytest.approx(60 / 30)
    assert evidence_of(replace(small_trajectory, solution=replace(solution, prior="none"))).slowness == 1.0


def test_without_a_learned_prior_the_reason_names_what_was_not_checked(small_trajectory):
    """If the prior was not learned, the reason says that the frame rate was not checked."""
    for prior, reason in (("none", NOT_ALL_CHECKED), ("running-cheetah", NOTHING_AGAINST)):
        solution = replace(small_trajectory.solution, prior=prior)
        assert _verdict(replace(small_trajectory, solution=solution, findings=())).reason == reason


NOTE = replace(finding("picture_zooms", way="out"), severity="note")
AGREES = finding("camera_agreement", camera="a", error_px=1.0, level=1.0, max_level=2.0)


@pytest.mark.parametrize(
    ("prior", "notes", "reason"),
    [
        ("running-cheetah", (AGREES,), NOTHING_AGAINST),
        ("running-cheetah", (NOTE,), "No check found a fault that spoils the result; 1 note is in the report."),
        (
            "running-cheetah",
            (NOTE, AGREES),
            "No check found a fault that spoils the result; 2 notes are in the report.",
        ),
        (
            "none",
            (NOTE,),
            "No check that ran found a fault that spoils the result; 1 note is in the report, and frame rate, swaps, "
            "lens and zoom were not checked.",
        ),
    ],
)
def test_with_notes_the_reason_does_not_say_that_no_check_found_a_fault(small_trajectory, prior, notes, reason):
    solution = replace(small_trajectory.solution, prior=prior)
    verdict = _verdict(replace(small_trajectory, solution=solution, findings=notes))
    assert verdict.level == "use"
    assert verdict.reason == reason
    assert reason_in_list(verdict.reason, verdict.reason_code) == (reason if prior == "none" else "")
    assert reason_in_list(verdict.reason, "") == reason  # a table of an earlier version


@pytest.mark.parametrize(("prior", "some"), [("running-cheetah", ""), ("none", " that ran")])
def test_a_note_on_the_position_is_in_the_reason(small_trajectory, prior, some):
    """A note that positions may be wrong is in the reason, because "use" alone would seem to include positions."""
    solution = replace(small_trajectory.solution, prior=prior)
    note = replace(finding("picture_zooms", way="out", pose_effect_m=0.001, position_effect_m=9.0), severity="note")
    verdict = _verdict(replace(small_trajectory, solution=solution, findings=(note,)))
    assert verdict.level == "use"
    assert verdict.reason.startswith(
        f"No check{some} found a fault that spoils the poses. Positions may be off by up to 9.0 m if the camera zooms; "
        "1 note"
    )
    assert verdict.reason_code == "picture_zooms"
    assert reason_in_list(verdict.reason, verdict.reason_code) == verdict.reason


def test_an_uncertain_pose_is_not_to_be_used(small_trajectory):
    solution = small_trajectory.solution
    vague = replace(solution, relative_covariance_m2=1e4 * solution.relative_covariance_m2)
    verdict = add_verdict(replace(small_trajectory, solution=vague)).verdict
    assert verdict.level == "do not use"
    assert verdict.pose_of_trunk.expected > LIMIT_OF_TRUNK
    assert says(verdict.reason, "too uncertain")


def test_a_pose_without_an_expected_error_is_not_to_be_used(small_trajectory):
    solution = small_trajectory.solution
    unknown = replace(solution, relative_covariance_m2=np.full_like(solution.relative_covariance_m2, np.nan))
    verdict = add_verdict(replace(small_trajectory, solution=unknown)).verdict
    assert verdict is not None
    assert (verdict.level, verdict.pose_m) == ("do not use", None)


def test_no_pose_is_not_to_be_used(small_trajectory):
    nowhere = np.full_like(small_trajectory.solution.joints_m, np.nan)
    motion = replace(small_trajectory, solution=replace(small_trajectory.solution, joints_m=nowhere))
    assert add_verdict(motion).verdict.level == "do not use"


def test_words_are_in_the_unit_that_fits(small_trajectory):
    said, errors = verdict_lines(add_verdict(small_trajectory).verdict)
    assert said.split(":")[0] in ("use", "check", "do not use")
    assert "pose error" in errors
    assert "of the trunk's length; position error" in errors
    assert verdict_lines(None) == ()


def test_the_verdict_is_saved_and_loaded(small_trajectory, tmp_path):
    motion = add_verdict(small_trajectory)
    motion.save(tmp_path)
    assert Motion.load(tmp_path).verdict == motion.verdict


def test_commands_refuse_a_clip_that_is_not_to_be_used(small_trajectory, tmp_path):
    wrong = add_verdict(replace(small_trajectory, findings=(finding("keypoints_y_up"),)))
    wrong.save(tmp_path / "clip")
    truth, video, out = tmp_path / "truth.csv", tmp_path / "clip.mp4", tmp_path / "out"
    write_csv(wrong.upright, truth)
    with video_writer(video, (1920, 1080), 60.0) as write:
        write(np.zeros((1080, 1920, 3), np.uint8))
    for command in (
        ("analyse", tmp_path / "clip", "--out", out),
        ("convert", tmp_path / "clip", out.with_suffix(".trc")),
        ("evaluate", tmp_path / "clip", truth),
        ("overlay", tmp_path / "clip", "--video", video, "--out", out.with_suffix(".mp4")),
        ("ik", tmp_path / "clip", "--compare", "--out", out),
        ("retarget", tmp_path / "clip", "--robot", "a1", "--out", out),
        ("prior", "fit", tmp_path / "clip", "--out", out.with_suffix(".npz")),
    ):
        refused(command, (tmp_path / "clip", "verdict", ["do not use", wrong.verdict.reason.rstrip(".")], "--anyway"))
    assert sorted(path.name for path in tmp_path.iterdir()) == ["clip", "clip.mp4", "truth.csv"]
    anyway = run("evaluate", tmp_path / "clip", truth, "--anyway")
    assert anyway.out.startswith(f"do not use: {wrong.verdict.reason}")
    assert usable(wrong, tmp_path, anyway=True) is wrong
    assert usable(replace(wrong, verdict=None), tmp_path, anyway=False).verdict is None
