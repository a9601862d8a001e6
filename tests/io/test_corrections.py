"""Test files of detections that were corrected by hand, and their effect on keypoints."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from recon import InputError, Keypoints
from recon.io.corrections import Correction, read_corrections, with_corrections, write_corrections


@pytest.fixture
def keypoints() -> Keypoints:
    return Keypoints(("nose", "tail"), np.ones((3, 2, 2)), np.full((3, 2), 0.2), np.array([4, 5, 6]), source="a.csv")


def test_what_is_written_reads_back(tmp_path: Path):
    rows = [
        Correction(4, "cam1", "=nose", (1.5, 2.5), (3.25, 4.0), "far", "2026-11-29T10:00:00"),
        Correction(5, "", "tail", None, None),
    ]
    write_corrections(rows, tmp_path / "corrections.csv")
    assert "'=nose" in (tmp_path / "corrections.csv").read_text()
    assert read_corrections(tmp_path / "corrections.csv") == rows


def test_a_corrected_detection_is_certain_and_a_hidden_one_missing(keypoints: Keypoints):
    rows = [
        Correction(5, "", "nose", (1.0, 1.0), (9.0, 8.0)),
        Correction(6, "cam", "tail", (1.0, 1.0), None),
        Correction(5, "cam", "nose", (1.0, 1.0), (7.0, 8.0)),
    ]
    (corrected,) = with_corrections([keypoints], ["cam"], rows, Path("corrections.csv"))
    assert corrected.xy_px[1, 0].tolist() == [7.0, 8.0]
    assert corrected.confidence[1, 0] == 1.0
    assert not corrected.present[2, 1]
    assert corrected.confidence[2, 1] == 0.0
    assert corrected.notes[-1] == "2 detections were corrected by hand (corrections.csv)"
    assert (corrected.corrected, keypoints.corrected) == (2, 0)
    assert (corrected.xy_px[0] == 1.0).all()
    assert keypoints.present.all()


def test_all_unknown_cameras_keypoints_and_frames_are_reported(keypoints: Keypoints):
    rows = [Correction(40, "cam", "nose", None, None), Correction(4, "cam", "ear", None, None)]
    rows.append(Correction(4, "cam9", "nose", None, None))
    with pytest.raises(InputError) as refusal:
        with_corrections([keypoints], ["cam"], rows, Path("corrections.csv"))
    assert [problem.found for problem in refusal.value.problems] == ["cam9", "ear", "40"]
    expected = [problem.expected for problem in refusal.value.problems]
    assert [text.split(" ", 3)[-1] for text in expected] == ["cam", "which are nose, tail", "which are 4 to 6"]


def test_positions_outside_the_picture_are_named(keypoints: Keypoints):
    """A position above the picture is used, and a note names it."""
    rows = [
        Correction(4, "", "nose", None, (9.0, -5.0)),
        Correction(5, "", "nose", None, (-0.5, 19.5)),
        Correction(6, "", "nose", None, None),
    ]
    (corrected,) = with_corrections([keypoints], ["cam"], rows, Path("fix.csv"), [(30, 20)])
    assert corrected.xy_px[0, 0].tolist() == [9.0, -5.0]
    assert [note for note in corrected.notes if "outside" in note] == [
        "1 corrected position lies outside the picture of 30x20 px (frame 4, nose at (9, -5)). If this is not "
        "intended, change fix.csv; empty cells leave a detection out."
    ]
    rows = [Correction(frame, "", name, None, (31.0, 2.0)) for frame in (4, 5) for name in keypoints.names]
    (corrected,) = with_corrections([keypoints], ["cam"], rows, Path("fix.csv"), [(30, 20)])
    assert "4 corrected positions lie outside" in corrected.notes[-1]
    assert corrected.notes[-1].count("frame") == 3
    assert not any("outside" in note for note in with_corrections([keypoints], ["cam"], rows, Path("a"))[0].notes)


@pytest.mark.parametrize(
    "row",
    [
        "4,nose,1",
        "4,nose,600,5,500,25",
        "4.5,nose,1,2",
        "x,nose,1,2",
        "4,,1,2",
        "4,nose,1,",
        "4,nose,nan,2",
        "4,nose,inf,2",
        "99999999999999,nose,1,2",
    ],
)
def test_a_line_that_cannot_be_read_is_named(row: str, tmp_path: Path):
    path = tmp_path / "corrections.csv"
    path.write_text(f"frame,keypoint,now_x_px,now_y_px\n4,nose,1,2\n{row}\n")
    with pytest.raises(InputError) as refusal:
        read_corrections(path)
    assert [problem.field for problem in refusal.value.problems] == ["line 3"]


def test_frames_that_a_spreadsheet_writes(tmp_path: Path):
    path = tmp_path / "corrections.csv"
    path.write_text("sep=;\nframe;keypoint;now_x_px;now_y_px;;\n4.0;nose;1,5;2;;\n;;;;;\n")
    assert read_corrections(path) == [Correction(4, "", "nose", None, (1.5, 2.0))]


def test_corrections_of_another_clip_are_refused(keypoints: Keypoints):
    """Corrections are refused if no keypoint was detected at any of their positions."""
    other = [Correction(4 + i % 3, "", "nose", (50.0 + i, 60.0), (9.0, 8.0)) for i in range(5)]
    with pytest.raises(InputError) as refusal:
        with_corrections([keypoints], ["cam"], other, Path("corrections.csv"))
    assert [(problem.field, problem.found) for problem in refusal.value.problems] == [
        ("was_x_px, was_y_px", "no detection of a.csv at any of the 5 positions")
    ]
    own = [*other, Correction(4, "", "tail", (1.4, 1.0), None)]
    assert with_corrections([keypoints], ["cam"], own, Path("corrections.csv"))[0].corrected == 4
    bare = [replace(row, was_px=None) for row in other]
    assert with_corrections([keypoints], ["cam"], bare, Path("corrections.csv"))[0].corrected == 3


def test_another_table_is_refused(tmp_path: Path):
    (tmp_path / "table.csv").write_text("a,b\n1,2\n")
    with pytest.raises(InputError, match="frame, keypoint, now_x_px"):
        read_corrections(tmp_path / "table.csv")
