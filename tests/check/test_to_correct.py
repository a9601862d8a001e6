"""Test the list of detections that are worth correcting by hand."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from recon import Motion
from recon.check.to_correct import _by_gain, _spread, to_correct
from recon.clip import leave_out
from recon.show import tables


def test_detections_far_from_their_expected_positions_come_first(small_trajectory: Motion):
    first = to_correct(small_trajectory)[0]
    assert (first.frame, first.keypoint, first.reason) == (14, "nose", "far")
    assert first.distance_px == pytest.approx(300.0)
    assert first.found_px is not None
    assert first.expected_px[1] - first.found_px[1] == pytest.approx(300.0)


def test_far_detections_are_sorted_by_gain():
    gain_m2 = np.zeros((1, 3, 2))
    distance_px = np.array([[[300.0, 5.0], [80.0, np.nan], [90.0, 70.0]]])
    is_far = np.isfinite(distance_px) & (distance_px > 10)
    gain_m2[0, 2, 1] = 4e-5
    gain_m2[0, 1, 0] = np.nan
    assert _by_gain(gain_m2, distance_px, distance_px > 0, is_far, limit=3) == [(0, 2, 1), (0, 0, 0), (0, 2, 0)]
    assert _by_gain(gain_m2, distance_px, distance_px > 75, is_far, limit=9) == [
        *((0, 0, 0), (0, 2, 0), (0, 1, 0), (0, 2, 1)),
    ]


def test_missing_keypoints_are_sorted_by_gain(small_trajectory: Motion):
    gain_m2 = np.zeros((1, 8, 24))
    eye = small_trajectory.joints.index("r_eye")
    gain_m2[0, 2, eye], gain_m2[0, 6, eye] = 1e-5, 4e-5
    motion = replace(small_trajectory, correction_gain_m2=gain_m2)
    rows = [row for row in to_correct(motion) if row.reason == "missing"]
    assert [row.frame for row in rows] == [16, 12]
    assert rows[0].found_px is None
    assert np.isnan(rows[0].distance_px)
    error_m2 = 0.02**2 + 0.08**2 + 0.02**2
    assert rows[0].error_fall_m == pytest.approx(error_m2**0.5 - (error_m2 - 4e-5) ** 0.5)


def test_a_detection_that_was_left_out_is_listed_with_its_position(small_trajectory: Motion):
    (source,) = small_trajectory.sources
    points = np.zeros(source.keypoints.present.shape, dtype=bool)
    points[1, 0] = True
    keypoints, cleaning = leave_out(source.keypoints, source.cleaning, points, "of another animal")
    motion = replace(small_trajectory, sources=(replace(source, keypoints=keypoints, cleaning=cleaning),))
    row = next(row for row in to_correct(motion) if row.reason == "left out")
    assert (row.frame, row.keypoint) == (11, small_trajectory.names[0])
    assert row.found_px == pytest.approx(source.keypoints.xy_px[1, 0].tolist())


def test_the_ellipse_is_the_joints_covariance_in_the_picture(small_trajectory: Motion):
    """About 10 m away, a focal length of 1536 px turns 0.054 m across the line of sight into about 9 px."""
    major, minor, angle_deg = to_correct(small_trajectory)[0].ellipse_px
    focal_px = small_trajectory.camera.matrix[0, 0]
    assert minor == pytest.approx(focal_px * np.hypot(0.05, 0.02) / 9.0, rel=0.1)
    assert major >= minor
    assert 0 <= angle_deg < 180


def test_the_frame_is_numbered_as_in_the_cameras_own_file(small_trajectory: Motion):
    (source,) = small_trajectory.sources
    motion = replace(small_trajectory, sources=(replace(source, offset_s=3 / 30.0),))
    assert to_correct(motion)[0].frame == 14 - 3


def test_a_correction_lowers_the_gain_of_neighbouring_frames():
    gain_m2 = np.array([[[4.0, 1.0], [3.9, 0.9], [3.8, 0.8], [0.1, 0.7]]])
    cells = _spread(gain_m2, gain_m2 > 0, tau=2.0, limit=4)
    assert cells[0] == (0, 0, 0)
    assert (0, 1, 0) not in cells[:3]


def test_the_table_is_read_as_it_was_written(small_trajectory: Motion, tmp_path: Path):
    tables.to_correct(small_trajectory, tmp_path / "to_correct.csv")
    table = pd.read_csv(tmp_path / "to_correct.csv")
    assert [*table.columns] == [*tables.TO_CORRECT_COLUMNS]
    assert table.iloc[0][["rank", "frame", "keypoint", "reason"]].tolist() == [1, 14, "nose", "far"]
