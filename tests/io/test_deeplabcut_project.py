"""Test DeepLabCut's projects, given as a folder or as config.yaml, and poses of FMPose3D."""

from __future__ import annotations

import json
from pathlib import Path
from shutil import copy

import cv2
import numpy as np
import pandas as pd
import pytest
from command_line import refusal, run, says
from networks import NAMES, grey, write_labels

from recon import evaluate_files, find_clips
from recon.animal.naming import load_names
from recon.api.model_settings import SkeletonDraftSettings
from recon.cli.models import skeleton_from_keypoints
from recon.io.deeplabcut_project import find_project, predictions
from recon.io.formats import read_keypoints
from recon.io.positions import read_pose3d
from recon.keypoint_net.labels import read_labels
from recon.testing.detectors import ANIMAL3D, split_names

SAMPLE = Path(__file__).parents[2] / "data" / "samples" / "whole.csv"
CAMERA = {"hfov_deg": 60.0, "image_size_px": (1920, 1080), "fps": 60.0}
CONFIG = r"""
    # Project definitions (do not edit)
Task: horse
scorer: me
multianimalproject: false
identity:

video_sets:
  ? C:\Users\me\a path that is so long that it is written in two lines\horse-me-2026-05-01\videos\run1.mp4
  : crop: 0, 1920, 0, 1080
  C:\Users\me\run2.mp4:
    crop: 0, 1920, 0, 1080
bodyparts:
- nose
- 'l_eye'
- neck_base  # where the neck begins
- tail_base
- l_front_paw
- r_front_paw
start: 0
skeleton:
- - nose
  - l_eye
default_net_type: resnet_50
"""
NETWORK = "DLC_resnet50_horseMay1shuffle1_100000"


@pytest.fixture
def project(tmp_path: Path) -> Path:
    folder = tmp_path / "horse-me-2026-05-01"
    (folder / "videos").mkdir(parents=True)
    (folder / "config.yaml").write_text(CONFIG, encoding="utf-8")
    return folder


@pytest.mark.parametrize("name", ["", "config.yaml"])
def test_a_skeleton_of_a_project(project, tmp_path, name):
    out = tmp_path / "a.toml"
    found = skeleton_from_keypoints(SkeletonDraftSettings(keypoints=project / name, out=out)).data
    assert [*found["keypoints"]] == ["nose", "l_eye", "neck_base", "tail_base", "l_front_paw", "r_front_paw"]
    assert found["without_place"] == ()
    assert 'keypoints of "horse-me-2026-05-01"' in out.read_text(encoding="utf-8")


def test_a_configuration(project):
    config = project / "config.yaml"
    found = find_project(config)
    assert found is not None
    assert (found.scorer, len(found.bodyparts)) == ("me", 6)
    assert [video[-8:] for video in found.video_sets] == ["run1.mp4", "run2.mp4"]
    several = "bodyparts: MULTI!\nmultianimalbodyparts: [nose, tail_base]\nindividuals:\n- bella\n- rex"
    config.write_text(f"Task: dogs\nscorer: me\n{several}\n", encoding="utf-8")
    found = find_project(project)
    assert found is not None
    assert found.bodyparts == ("nose", "tail_base")
    config.write_text("camera_matrix: 1\n", encoding="utf-8")
    assert find_project(config) is None
    config.write_text("Task: dogs\nscorer: me\nbodyparts:\n", encoding="utf-8")
    with refusal(("config.yaml", "bodyparts", "no names")):
        skeleton_from_keypoints(SkeletonDraftSettings(keypoints=config, out=project / "a.toml"))


@pytest.mark.parametrize("name", ["", "config.yaml"])
def test_labels_of_a_project(project, name):
    """A project's labels are the labels of its scorer, even if another person labelled a folder too."""
    with refusal((project, "label files", "none", "labeled-data")):
        read_labels(project / name)
    for folder, people in (("run1", ("another", "me")), ("run2", ("another",))):
        for person in people:
            path = project / "labeled-data" / folder / f"CollectedData_{person}.csv"
            write_labels(path, ["img1.png"], np.full((1, 3, 2), 7.0 if person == "me" else 5.0), NAMES)
        cv2.imwrite(str(path.parent / "img1.png"), grey(9))
    assert read_labels(project / name).xy_px[:, 0, 0].tolist() == [7.0, 5.0]


def test_clips_of_a_project(project):
    with refusal(("config.yaml", "predictions", f"no tables in {project / 'videos'}", "videos/run1DLC_*.h5")):
        find_clips([project], CAMERA)
    for name in (f"run1{NETWORK}", f"run1{NETWORK}_filtered", f"run1{NETWORK}_skeleton", f"run2{NETWORK}"):
        copy(SAMPLE, project / "videos" / f"{name}.csv")
    for given in (project, project / "config.yaml"):
        clips, notes = find_clips([given], CAMERA)
        assert {clip.name: clip.settings.keypoints[0].stem for clip in clips} == {
            "run1": f"run1{NETWORK}",
            "run2": f"run2{NETWORK}",
        }
        assert says(notes[1], f"same videos were left out: run1{NETWORK}_filtered.csv")
    copy(SAMPLE, project / "videos" / "run2DLC_HrnetW32_horseMay1shuffle2_snapshot_200.csv")
    with refusal(("config.yaml", "predictions of run2", ["2 networks", "DLC_HrnetW32_horseMay1shuffle2_snapshot_200"])):
        find_clips([project], CAMERA)
    with refusal((project, "file", "DeepLabCut", "videos/run1DLC_*.h5")):
        read_keypoints(project)


def test_tracked_animals_of_a_project(project):
    ends = ("_sk.h5", "_el.h5", "_el_filtered.h5", "_el.csv", ".h5")
    for end in ends:
        (project / "videos" / f"pair{NETWORK}{end}").touch()
    found = find_project(project)
    assert found is not None
    chosen, left_out = predictions(found)
    assert (chosen["pair"].name, len(left_out)) == (f"pair{NETWORK}_el.h5", 4)


AS_WRITTEN = split_names(
    "left_eye,right_eye,nose,neck,root_of_tail,left_shoulder,left_elbow,left_front_paw,right_shoulder,right_elbow,"
    "right_front_paw,left_hip,left_knee,left_back_paw,right_hip,right_knee,right_back_paw,withers,throat,left_ear,"
    "right_ear,mouth,chin,left_hock,right_hock,tail_tip"
)


@pytest.fixture
def of_fmpose3d(tmp_path: Path) -> Path:
    """Write the sample's true poses as FMPose3D does.

    The points of Animal3D have DeepLabCut's wrong names. They are relative to the tail's base, in a camera's axes and
    another unit. Frame 5 is empty.
    """
    truth, by = read_pose3d(SAMPLE.with_name("whole_truth.csv")), load_names("animal3d").names
    xyz = 3.0 * truth.of_joints([by.get(name, name) for name in ANIMAL3D])
    xyz = (xyz - xyz[:, [ANIMAL3D.index("tail_base")]]) @ np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])
    poses = np.nan_to_num(xyz).tolist()
    poses[5] = []
    content = {"model": "fmpose3d_animals", "bodyparts": AS_WRITTEN, "poses_3d": poses}
    path = tmp_path / "run_DLC_fmpose3d_animals_3d.json"
    path.write_text(json.dumps(content), encoding="utf-8")
    table = pd.DataFrame()
    for k, name in enumerate(AS_WRITTEN):  # DeepLabCut inserts each new keypoint before the earlier ones
        columns = pd.MultiIndex.from_product(
            [["DLC_fmpose3d_animals_3d"], [name], ["x", "y", "z"]], names=["scorer", "bodyparts", "coords"]
        )
        points = np.nan_to_num(xyz[:, k])
        points[5] = np.nan
        table = pd.concat([pd.DataFrame(points, columns=columns), table], axis=1)
    table.to_hdf(path.with_suffix(".h5"), key="df_with_missing", mode="w", format="table")
    return path


@pytest.mark.parametrize("suffix", [".json", ".h5"])
def test_poses_of_fmpose3d(of_fmpose3d, suffix):
    truth, path = SAMPLE.with_name("whole_truth.csv"), of_fmpose3d.with_suffix(suffix)
    pose = read_pose3d(path)
    assert {*pose.names} == {*ANIMAL3D}
    assert ["FMPose3D" in note for note in pose.notes[:2]] == [True, True]
    assert [says(note, "right_mouth in 59 frames", "missing") for note in pose.notes[2:]] == [True] * (suffix == ".h5")
    found = evaluate_files(path, truth, rename="animal3d")
    assert (len(found.names), found.frames_not_scored) == (19, 1)
    assert found.pa_mpjpe_m.mean < 1e-6 < 0.1 < found.scale_mpjpe_m.mean
    plain = evaluate_files(path, truth)
    assert plain.names == tuple(name for name in pose.names if name in ("nose", "tail_base"))
    assert any(says(note, "--rename animal3d", "19 joints", "instead of 2") for note in plain.notes)
    assert json.loads(run("evaluate", path, truth, "--rename", "animal3d", "--json").out)["pa_mpjpe_mm"] < 1e-3


def test_poses_of_the_demo_of_fmpose3d(of_fmpose3d, tmp_path):
    """FMPose3D's demo writes a file for each picture, such as `pose3D/0000_3D.npz`, with Animal3D's points."""
    truth, poses = SAMPLE.with_name("whole_truth.csv"), read_pose3d(of_fmpose3d)
    xyz = poses.xyz_m[:, [poses.names.index(name) for name in ANIMAL3D]]
    for frame in (3, 4, 7):
        np.savez_compressed(tmp_path / f"{frame:04d}_3D.npz", pose3d=xyz[frame].astype("f4"))
    found = evaluate_files(tmp_path / "0004_3D.npz", truth, rename="animal3d")
    assert (found.frames.tolist(), len(found.names)) == ([3, 4, 7], 19)
    assert found.pa_mpjpe_m.mean < 1e-4 < 0.1 < found.scale_mpjpe_m.mean
    assert read_pose3d((tmp_path / "0004_3D.npz").rename(tmp_path / "one.npz")).frames.tolist() == [0]
    np.savez(tmp_path / "0009_3D.npz", pose3d=xyz[9, :17])
    with refusal(("0009_3D.npz", "pose3d", "(17, 3)", "26")):  # also if another file of the folder is given
        read_pose3d(tmp_path / "0003_3D.npz")
    np.savez(tmp_path / "0009_3D.npz", pose3d=xyz[9])
    (tmp_path / "0009_3D.npz").rename(tmp_path / "3_3D.npz")
    with refusal(("0003_3D.npz", "frames", "3 after 3", "increasing")):
        read_pose3d(tmp_path / "0003_3D.npz")


def test_a_faulty_file_of_fmpose3d(of_fmpose3d):
    content = json.loads(of_fmpose3d.read_text(encoding="utf-8"))
    for change, field, found in (
        ({"poses_3d": []}, "points", "no frames"),
        ({"bodyparts": ["nose"]}, "content", "cannot be read"),
        ({"bodyparts": None}, "content", "cannot be read"),
    ):
        of_fmpose3d.write_text(json.dumps(content | change), encoding="utf-8")
        with refusal((of_fmpose3d, field, found)):
            read_pose3d(of_fmpose3d)
