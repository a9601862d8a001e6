"""Test that the severity of a finding depends on its effect on the result."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from recon.animal.prior import prior_from_body
from recon.check.codes import by_effect, finding, sentence
from recon.check.inputs import GROSS_REASON, _rate_findings
from recon.check.rules import frames_flagged, likelihoods_low, many_left_out, many_outliers, pair_disagrees
from recon.check.verdict import add_verdict, frame_rms_m
from recon.clip import leave_out
from recon.fit.clip_problem import ClipProblem, TrajectoryOptions
from recon.fit.result import SecondCamera

TRUNK_M = 0.7
AGAINST = {"error_px": 31.4, "level": 5.24, "late_frames": -2.5}


def late(pose_m: float, position_m: float):
    return finding("camera_late", camera="cam1", **AGAINST, pose_effect_m=pose_m, position_effect_m=position_m)


@pytest.mark.parametrize(
    ("pose_m", "position_m", "severity"),
    [
        (0.01, 0.02, "note"),
        (0.01, 0.036, "warning"),
        (0.036, 0.01, "warning"),
        (0.141, 0.01, "error"),
        (0.01, 0.141, "error"),
        (np.nan, np.nan, "error"),
    ],
)
def test_an_effect_below_the_limit_is_not_an_error(pose_m, position_m, severity):
    assert by_effect(late(pose_m, position_m), TRUNK_M).severity == severity


@pytest.mark.parametrize(
    ("pose_m", "position_m", "severity"),
    [(0.024, 0.18, "note"), (0.054, 0.29, "warning"), (0.024, 0.41, "error"), (0.15, 0.18, "error")],
)
def test_an_effect_within_the_uncertainty_of_positions_is_not_an_error(pose_m, position_m, severity):
    assert by_effect(late(pose_m, position_m), TRUNK_M, position_sigma_m=0.4).severity == severity


def test_a_finding_without_an_effect_keeps_its_severity():
    assert by_effect(finding("camera_late", camera="cam1", **AGAINST), TRUNK_M).severity == "error"
    assert by_effect(replace(late(1.0, 1.0), severity="note"), TRUNK_M).severity == "note"
    assert by_effect(finding("left_right_swap", part="all keypoints"), TRUNK_M).severity == "warning"


def test_a_sentence_states_the_effect_if_it_is_known():
    effect = "Without this fault, poses would change by 12 mm and positions by 40 mm."
    assert f"(an error of 31 px, 5.2 times the expected error). {effect}" in sentence(late(0.012, 0.04))
    assert "poses would change by 8 mm and positions by 4.7 m." in sentence(late(0.008, 4.661))
    assert "error). Measure the time offset with --set find-offsets=true" in sentence(late(np.nan, np.nan))


def test_a_finding_on_the_frame_rate_states_the_speed(small_trajectory):
    """A finding on the frame rate states the speed, because poses and positions hardly change with the rate."""
    body, solution = small_trajectory.body, small_trajectory.solution
    clip = ClipProblem.from_views(solution.views, body, prior_from_body(body), 30.0, TrajectoryOptions())
    (found,) = _rate_findings(clip, solution, 83.0, is_known=False)
    root_m = solution.states[solution.longest_segment.rows][:, :2]
    speed_m_s = 30.0 * np.nanmean(np.linalg.norm(np.diff(root_m, axis=0), axis=1))
    assert found.numbers["given_speed_m_s"] == pytest.approx(speed_m_s)
    assert found.numbers["other_speed_m_s"] == pytest.approx(speed_m_s * 83 / 30)
    rate = finding("frame_rate", given_hz=30.0, other_hz=83.0, pose_effect_m=0.01, position_effect_m=0.1)
    said = sentence(replace(rate, numbers={**rate.numbers, "given_speed_m_s": 4.34, "other_speed_m_s": 12.01}))
    assert "by the same factor. The animal's speed would be 12 m/s, not 4.3 m/s. Check --fps" in said
    assert "positions by" not in said


def test_the_intervals_of_the_verdict_contain_the_effect(small_trajectory):
    plain = add_verdict(small_trajectory).verdict
    noted = add_verdict(replace(small_trajectory, findings=(replace(late(0.3, 0.4), severity="note"),))).verdict
    assert noted.pose_m.expected == pytest.approx(plain.pose_m.expected)
    assert noted.pose_m.low == pytest.approx(plain.pose_m.low)
    assert noted.pose_m.high == pytest.approx(np.hypot(plain.pose_m.high, 0.3))
    assert noted.position_m.high == pytest.approx(np.hypot(plain.position_m.high, 0.4))


def test_evidence_against_a_known_frame_rate_is_a_note(small_trajectory):
    body, solution = small_trajectory.body, small_trajectory.solution
    clip = ClipProblem.from_views(solution.views, body, prior_from_body(body), 120.0, TrajectoryOptions())
    assert [item.severity for item in _rate_findings(clip, solution, 83.0, is_known=False)] == ["error"]
    assert [item.severity for item in _rate_findings(clip, solution, 83.0, is_known=True)] == ["note"]


def test_a_pair_with_a_rough_skeleton_has_only_a_note(small_trajectory):
    solution = small_trajectory.solution
    pair = SecondCamera(misplaced=9.0, late=1.0, late_frames=0.1)
    segments = tuple(replace(segment, second_camera=pair) for segment in solution.segments)
    motion = replace(small_trajectory, solution=replace(solution, segments=segments))

    def of(skeleton: str):
        (item,) = pair_disagrees(replace(motion, settings=dict(motion.settings) | {"skeleton": skeleton}))
        return item.code, item.severity

    assert of("cheetah-24") == ("pair_disagrees", "warning")
    assert of("quadruped") == ("pair_or_lengths", "note")


@pytest.mark.parametrize(
    ("flag", "share", "is_named"),
    [
        ("data poor", 0.25, False),
        ("data poor", 0.5, True),
        ("ambiguous depth", 0.25, False),
        ("ambiguous depth", 0.5, True),
        ("gross outliers", 0.5, True),
    ],
)
def test_flagged_frames_are_reported_if_more_than_a_third(small_trajectory, flag, share, is_named):
    T = len(small_trajectory.flags)
    flags = tuple((flag,) if t < share * T else () for t in range(T))
    motion = replace(small_trajectory, solution=replace(small_trajectory.solution, flags=flags))
    found = [*frames_flagged(motion)]
    assert [item.numbers["flag"] for item in found] == [flag] * is_named
    assert [item.severity for item in found] == ["warning"] * is_named


@pytest.mark.parametrize(("used", "rejected", "count"), [(70, 30, 0), (60, 40, 1)])
def test_detections_left_out_are_reported_if_more_than_a_third(small_trajectory, used, rejected, count):
    (source,) = small_trajectory.sources
    keypoints = {
        name: dict.fromkeys(numbers, 0) | {"used": used, "rejected": rejected}
        for name, numbers in source.cleaning.keypoints.items()
    }
    source = replace(source, cleaning=replace(source.cleaning, keypoints=keypoints))
    found = [*likelihoods_low(replace(small_trajectory, sources=(source,)))]
    assert [item.severity for item in found] == ["warning"] * count


def without_frames(motion, rows, reason=GROSS_REASON):
    """Return the motion with all detections of some frames left out for a reason, by default as gross outliers."""
    (source,) = motion.sources
    points = source.keypoints.present & np.isin(np.arange(len(motion.frames)), rows)[:, None]
    keypoints, cleaning = leave_out(source.keypoints, source.cleaning, points, reason)
    return replace(motion, sources=(replace(source, keypoints=keypoints, cleaning=cleaning),))


def test_gross_outlier_frames_count_as_outliers(small_trajectory):
    assert not [*many_outliers(small_trajectory)]
    (item,) = many_outliers(without_frames(small_trajectory, [0, 1, 2, 4]))
    assert item.severity == "warning"
    assert item.numbers["share"] == pytest.approx(4 / 7, abs=0.03)
    assert not [*likelihoods_low(without_frames(small_trajectory, [0, 1, 2, 4]))]


def test_detections_left_out_for_several_reasons_are_named_together(small_trajectory):
    far = without_frames(small_trajectory, [0, 1, 2], "far outside the picture")
    (item,) = many_left_out(far)
    assert item.severity == "warning"
    assert "69 far outside" in str(item.numbers["reasons"])
    assert item.numbers["share"] == pytest.approx(69 / 161, abs=0.05)
    assert not [*many_left_out(small_trajectory)]


def test_errors_of_frames_agree_with_the_error_of_the_clip(small_trajectory):
    judged = add_verdict(small_trajectory)
    assert judged.verdict is not None
    assert judged.verdict.pose_m is not None
    rms_m = frame_rms_m(judged)[judged.solved]
    assert rms_m.mean() == pytest.approx(judged.verdict.pose_m.expected / 0.92)
    assert frame_rms_m(small_trajectory) == pytest.approx(small_trajectory.relative_rms_m, nan_ok=True)
