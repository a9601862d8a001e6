"""Test labelling without a detector: the choice of frames, saving after every click, and refused inputs."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from command_line import refusal, refused

from recon.api.label_frames import LabelSession, choose_frames, frames_by_gain
from recon.fit.motion import Motion
from recon.io.formats import read_keypoints
from recon.io.video import video_writer
from recon.keypoint_net.labels import read_labels

NAMES = ("nose", "tail")


@pytest.fixture(scope="module")
def film(tmp_path_factory) -> Path:
    """Write thirty frames in three scenes of ten, with a bright bar at the left, in the middle and at the right."""
    path = tmp_path_factory.mktemp("film") / "run.avi"
    with video_writer(path, (64, 48), 25.0) as write:
        for number in range(30):
            picture = np.zeros((48, 64, 3), np.uint8)
            picture[:, 20 * (number // 10) : 20 * (number // 10) + 20] = 200
            write(picture)
    return path


@pytest.fixture
def session(film: Path, tmp_path: Path) -> LabelSession:
    pytest.importorskip("tables")
    return LabelSession.open(film, tmp_path, NAMES, "me", 3)


def test_chosen_frames_cover_every_scene_and_are_reproducible(film: Path):
    chosen = choose_frames(film, 3)
    assert [number // 10 for number in chosen] == [0, 1, 2]
    assert choose_frames(film, 3) == chosen
    assert choose_frames(film, 100) == [*range(30)]
    assert len(choose_frames(film, 12)) == 12  # the film has fewer than 12 different pictures


def test_with_a_result_the_most_useful_frames_are_chosen(small_motion: Motion):
    """If a result is given, the chosen frames are those whose labels reduce the error most.

    A neighbour of a chosen frame adds little. Frames are numbered as in the keypoint file.
    """
    gain_m2 = np.zeros((1, len(small_motion.frames), len(small_motion.names)))
    gain_m2[0, [0, 1], 4] = 3.0, 2.9
    gain_m2[0, 5, :2] = 1.0, 1.5
    gain_m2[0, 4, 0] = np.nan
    motion = replace(small_motion, correction_gain_m2=gain_m2)
    assert frames_by_gain(motion, 0, 2) == [10, 15]
    assert frames_by_gain(motion, 0, 100) == [10, 15, 11]  # frames whose labels would lower no error are left out
    with refusal(("--result", "method")):
        frames_by_gain(replace(motion, correction_gain_m2=None), 0, 2)


def test_preferred_frames_come_first_and_others_differ(film: Path, tmp_path: Path):
    pytest.importorskip("tables")
    session = LabelSession.open(film, tmp_path, NAMES, "me", 4, None, [7, 3])
    assert {3, 7} < {*session.frames}
    assert len(session.frames) == 4
    assert {number // 10 for number in session.frames} > {0}


def test_saved_labels_are_read_for_training(session: LabelSession, tmp_path: Path):
    first, second, third = session.frames
    assert session.save([[first, 0, 10.0, 20.5], [first, 1, 30.0, 20.0], [third, 1, 5.0, 6.0]]) == 3
    labels = read_labels(tmp_path)
    assert labels.names == NAMES
    assert labels.numbers.tolist() == [first, third]
    assert labels.xy_px[0].tolist() == [[10.0, 20.5], [30.0, 20.0]]
    assert np.isnan(labels.xy_px[1, 0]).all()
    assert labels.pictures[1].shape == (48, 64, 3)
    assert session.picture(second) is not None
    assert session.picture(second + 1) is None


def test_the_next_session_continues_with_earlier_labels(session: LabelSession, film: Path, tmp_path: Path):
    session.save([[session.frames[1], 0, 10.0, 20.0]])
    again = LabelSession.open(film, tmp_path, NAMES, "me", 3)
    assert again.points_px == session.points_px
    assert again.frames == session.frames
    again.save([])
    assert not read_keypoints(again.output.folder / "CollectedData_me.csv").present.any()
    with refusal(("CollectedData_me.csv", "bodyparts", "nose, tail", "paw")):
        LabelSession.open(film, tmp_path, ("paw",), "me", 3)


def test_labels_from_elsewhere_are_not_replaced(session: LabelSession, film: Path, tmp_path: Path):
    session.save([[session.frames[0], 0, 10.0, 20.0]])
    table = session.output.folder / "CollectedData_me.csv"
    table.write_text("mine")
    with refusal(("CollectedData_me.csv", "file")):
        session.save([[session.frames[0], 0, 11.0, 20.0]])
    assert table.read_text() == "mine"
    assert session.points_px == {(session.frames[0], 0): (10.0, 20.0)}
    with refusal(("CollectedData_me.csv", "file")):
        LabelSession.open(film, tmp_path, NAMES, "me", 3)


@pytest.mark.parametrize(
    "row",
    [
        [-1, 0, 1.0, 1.0],
        ["0", 0, 1.0, 1.0],
        [0, 2, 1.0, 1.0],
        [0, 0, 64.0, 1.0],
        [0, 0, float("nan"), 1.0],
        [0, 0, 10**400, 1.0],
        [0],
        "x",
    ],
)
def test_invalid_labels_are_not_saved(session: LabelSession, row: object):
    if isinstance(row, list) and row[0] == 0:
        row[0] = session.frames[0]
    with refusal(("labels", "row 1")):
        session.save([row])
    assert not (session.output.folder / "CollectedData_me.csv").exists()


@pytest.mark.parametrize("names", [(), ("nose", "nose"), ("nose", "")])
def test_invalid_keypoint_names_are_refused(film: Path, tmp_path: Path, names: tuple[str, ...]):
    pytest.importorskip("tables")
    with refusal(("--names", "names")):
        LabelSession.open(film, tmp_path, names, "me", 3)


def test_a_scorer_outside_the_folder_is_refused(film: Path, tmp_path: Path):
    out = tmp_path / "project"
    refused(("label", film, "--out", out, "--scorer", "../me"), ("labels", "scorer", "../me", "a file name"))
    refused(("label", tmp_path / "none.mp4", "--out", out), ("none.mp4", "video", "no such file"))
    refused(("label", film, "--out", out, "--first-frame", "3"), ("--result", "result", "nothing"))
    assert not out.exists()
