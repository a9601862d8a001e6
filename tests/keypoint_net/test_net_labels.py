"""Test the reading of labels with their pictures, the splits, and the messages about unusable input."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
from command_line import refusal, says
from networks import NAMES, grey, write_labels

from recon import InputError
from recon.io.video import video_writer
from recon.keypoint_net.labels import (
    PARTS,
    body_length_px,
    frames_by_part,
    read_labels,
    resize,
    scale_points,
    sides,
    split_labels,
)


@pytest.fixture
def clip(tmp_path: Path) -> tuple[Path, Path]:
    """Write a video of ten frames, whose grey level is ten times the frame, and labels 50 to 57 for frames 0 to 7."""
    video = tmp_path / "run.avi"
    with video_writer(video, (64, 48), 25.0) as write:
        for number in range(10):
            write(grey(10 * number))
    xy = np.arange(8 * 6, dtype=float).reshape(8, 3, 2) % 40
    xy[2, 1] = np.nan
    xy[3, 0, 0] = np.nan
    return video, write_labels(tmp_path / "labels.csv", [f"labeled-data/run/{50 + n:04d}.png" for n in range(8)], xy)


def test_image_names_select_the_frames_of_a_video(clip):
    labels = read_labels(*clip, first_frame=50)
    assert labels.names == NAMES
    assert labels.numbers.tolist() == list(range(50, 58))
    assert labels.images[3] == "labeled-data/run/0053.png"
    assert [round(float(p.mean()) / 10) for p in labels.pictures] == list(range(8))


def test_a_label_without_one_coordinate_is_missing(clip):
    labels = read_labels(*clip, first_frame=50)
    assert np.argwhere(~labels.labelled).tolist() == [[2, 1], [3, 0]]


@pytest.mark.parametrize(
    ("first_frame", "expected"),
    [
        (0, ("run.avi", "frames", "10 decodable frames", ["8 labelled frames", "--first-frame"])),
        (51, ("--first-frame", "number", 51, "at most 50")),
    ],
)
def test_labels_without_a_frame_are_refused(clip, first_frame, expected):
    with refusal(expected):
        read_labels(*clip, first_frame=first_frame)


def test_a_project_folder_is_read(tmp_path):
    for folder, levels in (("a", (10, 20)), ("b", (30, 40, 50))):
        names = [f"img{n:03d}.png" for n in range(len(levels))]
        xy = np.full((len(levels), 3, 2), 5.0)
        path = tmp_path / "labeled-data" / folder / "CollectedData_me.csv"
        write_labels(path, [f"labeled-data,{folder},{n}" for n in names], xy)
        # Three index columns, as newer versions write them.
        text = path.read_text(encoding="utf-8").splitlines()
        path.write_text("\n".join([row.replace(",", ",,,", 1) for row in text[:3]] + text[3:]) + "\n", encoding="utf-8")
        for name, level in zip(names, levels, strict=True):
            cv2.imwrite(str(path.parent / name), grey(level))
    labels = read_labels(tmp_path)
    assert [int(p.mean()) for p in labels.pictures] == [10, 20, 30, 40, 50]
    assert labels.clip.tolist() == [0, 0, 1, 1, 1]
    assert labels.images[4] == "labeled-data/b/img002.png"


def test_a_project_without_its_pictures_is_refused(tmp_path):
    folder = tmp_path / "labeled-data" / "a"
    write_labels(folder / "CollectedData_me.csv", ["img0.png", "img1.png"], np.arange(1.0, 13.0).reshape(2, 3, 2))
    cv2.imwrite(str(folder / "img0.png"), grey(9))
    (folder / "img1.png").write_bytes(b"no picture")
    write_labels(
        tmp_path / "labeled-data" / "b" / "CollectedData_me.csv", ["img7.png"], np.arange(1.0, 7.0).reshape(1, 3, 2)
    )
    with pytest.raises(InputError) as error:
        read_labels(tmp_path)
    unread, missing = (problem.found for problem in error.value.problems)
    assert (says(unread, "cannot be read"), says(missing, "no such picture")) == (True, True)


def test_folders_with_different_keypoints_are_refused(tmp_path):
    for folder, names in (("a", NAMES), ("b", ("nose", "tail"))):
        path = tmp_path / "labeled-data" / folder
        write_labels(path / "CollectedData_me.csv", ["img0.png"], np.ones((1, len(names), 2)), names)
        cv2.imwrite(str(path / "img0.png"), grey(9))
    with refusal((f"{tmp_path}/labeled-data/b/CollectedData_me.csv", "bodyparts", "nose, tail", ", ".join(NAMES))):
        read_labels(tmp_path)


@pytest.mark.parametrize(
    ("content", "expected"),
    [
        ("", ("file", "empty")),
        ("a,b\n1,2\n", ("format", "another kind", "DeepLabCut's")),
        ("scorer,me,me\nbodyparts,nose,nose\ncoords,x,y\nimg0.png,,\n", ("labels", "empty cells")),
        ("scorer,me,me\nbodyparts,nose,nose\ncoords,x,y\n", ("points", "no frames")),
    ],
)
def test_label_files_without_labels_are_refused(clip, tmp_path, content, expected):
    path = tmp_path / "bad.csv"
    path.write_text(content, encoding="utf-8")
    with refusal((path, *expected)):
        read_labels(clip[0], path)


def test_labels_outside_their_pictures_are_refused(clip, tmp_path):
    xy = np.array([[[50.0, 60.0], [52, 62], [54, 64]]])
    path = write_labels(tmp_path / "larger.csv", ["img50.png"], xy)
    with refusal((path, "labels", ["3 of 3 points", "nose in img50.png"])):
        read_labels(clip[0], path, first_frame=50)


def test_a_file_that_is_no_video_is_refused(clip, tmp_path):
    path = tmp_path / "bad.mp4"
    path.write_bytes(b"not a video")
    with refusal(("bad.mp4", "video", "cannot be decoded")):
        read_labels(path, clip[1], first_frame=50)
    with refusal(("--labels", "file", "none", "run.avi")):
        read_labels(clip[0])
    with refusal(("nowhere", "data", "nothing there")):
        read_labels(tmp_path / "nowhere")


@pytest.mark.parametrize("scale", [0.3, 0.5, 0.75, 1.5])
def test_points_stay_on_their_pixels_when_a_picture_is_scaled(scale):
    y, x = np.mgrid[:90, :120]
    at = np.array([50.4, 41.7])
    blob = 250 * np.exp(-0.5 * ((x - at[0]) ** 2 + (y - at[1]) ** 2) / 5.0**2)
    small = resize(np.repeat(blob[..., None], 3, axis=2).astype(np.uint8), scale).astype(float)[..., 0]
    y, x = np.mgrid[: small.shape[0], : small.shape[1]]
    found = np.array([(small * x).sum(), (small * y).sum()]) / small.sum()
    np.testing.assert_allclose(found, scale_points(at, scale), atol=0.05)
    np.testing.assert_allclose(scale_points(scale_points(at, scale), 1 / scale), at)


@pytest.mark.parametrize(
    ("names", "partners"),
    [
        (("nose", "left_paw", "right_paw"), (0, 2, 1)),
        (("Nearknee", "Offknee", "Girth"), (1, 0, 2)),
        (("l_eye", "r_eye", "tail", "l_ear"), (1, 0, 2, 3)),
        (("paw_l", "paw_r", "PawLeft", "PawRight"), (1, 0, 3, 2)),
        (("pawFL", "pawFR", "pawRL", "pawRR"), (1, 0, 3, 2)),
        (("LF_Hoof", "RF_Hoof", "lr-hoof", "rr-hoof"), (1, 0, 3, 2)),
        (("LEye", "REye", "wing1_L", "wing1_R"), (1, 0, 3, 2)),
        (("hip", "eye", "collar"), (0, 1, 2)),
    ],
)
def test_counterparts_on_the_other_side(names, partners):
    assert sides(names) == partners


def test_the_body_length_comes_from_whole_animals():
    xy = np.full((4, 3, 2), np.nan)
    xy[:3] = [[0, 0], [30, 40], [10, 10]]
    xy[2] *= 2
    xy[3, :2] = [[0, 0], [1, 1]]  # an animal that is half out of the picture
    assert body_length_px(xy) == pytest.approx(50)


def test_splits_are_disjoint_blocks_and_repeatable(clip):
    labels = read_labels(*clip, first_frame=50)
    split = split_labels(labels, "0.25", "55:57", seed=3)
    assert split["test"].tolist() == [5, 6]
    assert sorted(np.concatenate([split[part] for part in PARTS])) == list(range(8))
    assert len(split["validation"]) == 2
    again = split_labels(labels, "0.25", "55:57", seed=3)
    assert all(np.array_equal(split[part], again[part]) for part in PARTS)
    assert frames_by_part(labels, split)["test"] == {labels.clips[0]: ["55-56"]}


def test_splits_without_training_pictures_are_refused(clip):
    labels = read_labels(*clip, first_frame=50)
    with refusal(("--validation", "frames", "90:", "50 to 57")):
        split_labels(labels, "90:", "0", seed=0)
    with refusal(("--validation, --test", "split", 8)):
        split_labels(labels, "0", "50:58", seed=0)
    with refusal(("--test", "part", "'many'", "A:B")):
        split_labels(labels, "0.2", "many", seed=0)
    assert len(split_labels(labels, "0.5", "0", seed=0)["validation"]) == 4
    assert split_labels(labels, "0.2", "54:", seed=0)["test"].tolist() == [4, 5, 6, 7]
