"""Test epipolar lines: the possible positions in one picture of a keypoint that another camera sees."""

from __future__ import annotations

import numpy as np
import pytest

from recon import Motion
from recon.api.epipolar import epipolar_lines_px


def distance_px(line: np.ndarray, point: np.ndarray) -> float:
    """Return the distance of a point from a polyline, px."""
    starts, steps = line[:-1], np.diff(line, axis=0)
    fraction = np.clip(((point - starts) * steps).sum(axis=1) / (steps**2).sum(axis=1), 0, 1)
    return float(np.linalg.norm(starts + fraction[:, None] * steps - point, axis=1).min())


def test_a_keypoint_lies_on_the_line_of_the_other_camera(two_cameras: Motion):
    j = two_cameras.names.index("nose")
    true_px = two_cameras.pictures[0].reprojected_px[4, j]
    ((name, line),) = epipolar_lines_px(two_cameras, 0, 4, j, {}).items()
    assert name == "cam2"
    assert distance_px(line, true_px) < 1.0
    moved = two_cameras.pictures[1].detected_px[4, j] + [0.0, 80.0]
    ((_, line),) = epipolar_lines_px(two_cameras, 0, 4, j, {1: tuple(moved)}).items()
    assert distance_px(line, true_px) > 20.0


@pytest.mark.parametrize("row", [0, 4])
def test_a_camera_that_does_not_see_the_keypoint_has_no_line(two_cameras: Motion, row: int):
    hidden = {} if row == 0 else {1: None}
    assert epipolar_lines_px(two_cameras, 0, row, two_cameras.names.index("nose"), hidden) == {}
