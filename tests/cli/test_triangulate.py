"""Test `recon triangulate`: its points, covariances and summary, which other commands read."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest

from recon import InputError, read_pose3d, triangulate
from recon.api.triangulation import COVARIANCES
from recon.gait.evaluation import POSE3D, TRIANGULATED
from recon.io.calibration import read_cameras
from recon.io.camera_files import write_cameras
from recon.io.deeplabcut import write_csv
from recon.io.formats import read_keypoints
from recon.testing.rigs import write_rig_clip
from recon.testing.walkers import walking_person
from tests.command_line import run, says

FPS, FRAMES = 50.0, 16


@pytest.fixture(scope="module")
def clip(tmp_path_factory):
    folder = tmp_path_factory.mktemp("rig")
    centres_m = [(4, 0, 1.5), (-2, 3.5, 1.2), (-2, -3.5, 1.8), (0, 4, 2.0)]
    files, truth = write_rig_clip(
        folder, "human-25", walking_person(FRAMES, FPS), FPS, np.array(centres_m), 1.0, 0.8, 2.0
    )
    write_csv(truth, folder / "truth.csv")
    return folder, files, truth


def command(clip, out, *more):
    _, files, _ = clip
    cameras = [files[f"cam{i}"] for i in (1, 2, 3, 4)]
    return run("triangulate", *cameras, "--camera", files["rig"], "--fps", 50, "--out", out, *more)


def test_triangulated_points_are_near_the_true_markers(clip, tmp_path):
    ended = command(clip, tmp_path / "points")
    assert ended.code == 0, ended.err
    pose = read_pose3d(tmp_path / "points" / POSE3D)
    _, _, truth = clip
    error_m = np.linalg.norm(pose.xyz_m - truth.xyz_m, axis=-1)
    # Keypoints lie off the markers by half of 30 mm along each axis; the noise is about 5 mm.
    assert np.isfinite(error_m).mean() > 0.95
    assert 0.015 < np.nanmedian(error_m) < 0.04
    middle_m = np.nanmean(pose.xyz_m - truth.xyz_m, axis=0, keepdims=True)
    assert np.nanmedian(np.linalg.norm(pose.xyz_m - truth.xyz_m - middle_m, axis=-1)) < 0.02


def test_covariances_and_summary_are_written(clip, tmp_path):
    out = tmp_path / "points"
    assert command(clip, out, "--json").code == 0
    summary = json.loads((out / TRIANGULATED).read_text())
    assert summary["frames"] == FRAMES
    assert summary["share_known"] > 0.95
    assert list(summary["cameras"]) == ["cam1", "cam2", "cam3", "cam4"]
    assert 1.5 < np.median(list(summary["sigma_px"].values())) < 2.5
    lines = (out / COVARIANCES).read_text().splitlines()
    assert lines[1].startswith("coords,xx,xy,xz,yy,yz,zz")
    variances = [float(cell) for cell in lines[2].split(",")[1:7:1] if cell]
    assert all(np.isfinite(variances))


@pytest.mark.slow
def test_other_commands_read_the_points(clip, tmp_path):
    out = tmp_path / "points"
    assert command(clip, out, "--smooth").code == 0
    folder, _, _ = clip
    for scored in (out / POSE3D, out):
        ended = run("evaluate", scored, folder / "truth.csv", "--json")
        assert ended.code == 0, ended.err
        assert 10 < json.loads(ended.out)["mpjpe_mm"] < 40
    assert run("convert", out / POSE3D, tmp_path / "points.trc", "--fps", 50).code == 0


def test_files_of_a_user_are_not_replaced(clip, tmp_path):
    out = tmp_path / "points"
    out.mkdir()
    (out / POSE3D).write_text("mine")
    ended = command(clip, out, "--overwrite")
    assert ended.code == 2
    assert (out / POSE3D).read_text() == "mine"
    assert command(clip, tmp_path / "other").code == 0
    assert command(clip, tmp_path / "other").code == 2
    assert command(clip, tmp_path / "other", "--overwrite").code == 0


def test_one_file_is_refused(clip, tmp_path):
    _, files, _ = clip
    ended = run("triangulate", files["cam1"], "--camera", files["rig"], "--fps", 50, "--out", tmp_path / "points")
    assert ended.code == 2
    assert "two or more cameras" in ended.err
    assert not (tmp_path / "points").exists()


def test_a_copy_of_another_cameras_file_is_refused(clip, tmp_path):
    _, files, _ = clip
    copied = tmp_path / "cam2.csv"
    copied.write_bytes(files["cam1"].read_bytes())
    options = ["--camera", files["rig"], "--fps", 50, "--out", tmp_path / "points"]
    ended = run("triangulate", files["cam1"], copied, files["cam3"], *options)
    assert ended.code == 2
    assert says(ended.err, "same points from cam1 and cam2")
    assert not (tmp_path / "points").exists()


def test_points_triangulated_from_python_are_near_the_truth(clip):
    _, files, truth = clip
    keypoints = [read_keypoints(files[f"cam{i}"], None, FPS) for i in (1, 2)]
    cameras = read_cameras((files["rig"],), None)
    result = triangulate(keypoints, cameras[:2])
    error_m = np.linalg.norm(result.points_m - truth.xyz_m, axis=-1)
    assert np.nanmedian(error_m) < 0.05
    assert result.covariance_m2.shape == (FRAMES, len(truth.names), 3, 3)
    assert result.pose3d.names == truth.names
    with pytest.raises(InputError, match="two or more"):
        triangulate(keypoints[:1], cameras[:1])


def test_a_calibration_in_millimetres_is_refused(clip, tmp_path):
    _, files, _ = clip
    cameras = [
        replace(c, translation_m=1000 * np.asarray(c.translation_m)) for c in read_cameras((files["rig"],), None)
    ]
    write_cameras(cameras, tmp_path / "in_mm.toml")
    in_mm = {**files, "rig": tmp_path / "in_mm.toml"}
    refused = command((None, in_mm, None), tmp_path / "points")
    assert (refused.code, refused.out) == (2, "")
    assert says(refused.err, "--camera-unit: found m, in which the animal is", "mm (1.")
    assert command((None, in_mm, None), tmp_path / "points", "--camera-unit", "mm").code == 0
